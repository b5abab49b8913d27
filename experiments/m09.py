"""M09's filter, preset ``m09``: particle PHD, mixture extraction, learned densities over the image
[M09 Figs. 14-16].

Each scene is learned on its first half and scored on its second. False alarms are learned from
marks on random frames, births from all tracks of the filter itself with the uniform model.
*printed*: by the paper's recursion alone, and used whole. *GM*: refitted by batch EM, wider, and
mixed with the uniform model in a share chosen on the marked frames (`Judge`), which may be 0 with
few marks. *after*: births from a second pass, whose tracker knows the false alarms. The uniform
model is run untuned, and with the rates that are best on the first half.

Each seed has its own marked frames and particles, and of a rendered scene its own share of the
second half.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from experiments import m09_claims
from experiments.common import (
    Case,
    Options,
    followed,
    pyplot,
    table,
    uniform_density,
    with_error,
    with_scene,
    write,
)
from experiments.m09_lessons import as_lesson, false_alarms, marked_births
from experiments.m09_runs import (
    ABLATIONS,
    AFTER,
    GM,
    PRINTED,
    TUNED,
    TUNED_PRINTED,
    UM,
    UM_PRINTED,
    WORD_BY_WORD,
    SceneRun,
    SceneScores,
    score,
)
from experiments.m09_scenes import HELD_OUT, INDOOR, REAL, RENDERED, Halves, stretch
from experiments.scenes import (
    FINDINGS,
    SCORES,
    SceneResults,
    Study,
    number,
    results,
    scores,
    short_of,
    times,
)
from phdtrack import config
from phdtrack.arrays import iou, to_cxcywh
from phdtrack.label.samples import Marks, shuffled
from phdtrack.label.store import NO_OBJECT
from phdtrack.metrics import evaluate
from phdtrack.models import MeasurementBirth
from phdtrack.models.clutter import BoxClutter
from phdtrack.protocols import AnyStages
from phdtrack.scene import LearnedDensity, grid, learn_recursively
from phdtrack.scene.training import (
    BIRTH_GRID,
    CLUTTER_GRID,
    MIN_SAMPLES,
    births_in,
    measurement_volume,
    state_volume,
    with_prior,
)
from phdtrack.types import F8, Bool, SequenceInfo, Tracks

# Frames of a rendered scene; numbers of seeds, and of those that are run with other numbers of
# marks.
FRAMES = 10_000
SEEDS = 5
MARK_SEEDS = 1
# Frames of a rendered scene on which other numbers of marks, other rates and other filters are
# compared, and those on which the rates of the uniform model are tuned.
COMPARED = 500
# In the paper: numbers of marked false alarms, and of tracks that births are learned from.
PAPER_MARKS = 1800
PAPER_TRACKS = 320
MARKS = (10, 30, 100, 300, 1000, 3000)
# Shares of the learned model to choose from.
SHARES = (0.01, 0.1, 1.0)
# Largest number of marked frames on which a share is chosen, and number of frames that the filter
# runs before each.
JUDGED = 40
LEAD = 25
# The full learned model, regardless of the marked frames.
WHOLE = "whole"
# Births a time unit and false alarms a frame of the uniform model.
SWEEP = tuple((births, rate) for births in (0.003, 0.03) for rate in (1.0, 10.0, 100.0))
# The association alone (M09's DA), multiple hypotheses with the same models, trained and untrained,
# and with M09's own parameters.
# With fixed variances: the paper's filter, untrained and trained, against its MHT.
RIVALS = (
    ("none", UM),
    ("mht", UM),
    ("mht", GM),
    ("fv", UM_PRINTED),
    ("fv", PRINTED),
    ("fv", AFTER),
    ("m09-mht", UM),
)
RUNS = (UM, TUNED, *WORD_BY_WORD, GM, WHOLE, AFTER, *ABLATIONS)


@dataclass(frozen=True, slots=True, eq=False)
class Alarms:
    """False alarms learned from ``marks`` on a number of frames; the chosen ``share`` of the
    learned model.
    """

    clutter: LearnedDensity
    marks: int
    frames: int
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class PaperScene:
    """A learned scene: births from the filter's own tracks and from manual marks, false alarms by
    the number of marks.

    Attributes
    ----------
    births, tracks : from this number of tracks of the uniform model; uniform at the counted rate if
        there are too few.
    hand : births from manual marks.
    alarms : by the number of marks.
    after, tracks_after : births from tracks that know the false alarms of `PAPER_MARKS`.
    real, real_after : how many of the tracks of both passes begin on an object.
    printed : births and false alarms by the recursion alone; None: too few samples.
    tuned : births a time unit and false alarms a frame that are best on the first half.
    """

    births: LearnedDensity
    tracks: int
    hand: LearnedDensity | None
    alarms: Mapping[int, Alarms]
    after: LearnedDensity
    tracks_after: int
    real: int
    real_after: int
    printed: tuple[LearnedDensity | None, LearnedDensity | None]
    tuned: tuple[float, float]

    def at(self, count: int) -> Alarms:
        """The false alarms learned from this number of marks, or from all if there are fewer."""
        return self.alarms[max(known for known in self.alarms if known <= count)]


def uniform(info: SequenceInfo, filter_name: str = "") -> AnyStages:
    """Births and false alarms uniform over the image, with the extraction as one must, and the
    paper's filter or another one.
    """
    return config.build(config.load(preset="m09-extended"), info, filter_name)


def of_paper(one: SceneRun, info: SequenceInfo) -> AnyStages:
    """The paper's filter with uniform births and false alarms: with scaled or with fixed variances,
    and with the printed extraction for runs word by word.
    """
    if one.filter not in ("", "fv"):
        return uniform(info, one.filter)
    printed = config.build(config.load(preset=one.filter or "m09"), info)
    if one.run in WORD_BY_WORD:
        return printed
    return replace(printed, extractor=uniform(info).extractor)


def learn(job: tuple[Halves, int]) -> PaperScene:
    """Learn everything that the runs of a scene need; the seed is that of the marked frames and the
    particles.
    """
    case = job[0].train
    seed = job[1]
    stages = uniform(case.info)
    first = early(followed(stages, case, seed).corrected, case)
    births, tracks = own_births(*first, case, stages.model.rate)
    with TemporaryDirectory() as folder:
        entries = Marks(marked_births(case, Path(folder) / "births.sqlite"), case.table, case.info)
        by_hand = as_lesson(
            entries.birth_states(stages.model.rate), entries.time_watched(stages.model.rate), case
        )
    false = false_detections(case)
    alarms = {}
    judge = Judge(case, stages, false, seed)
    usual = judge.followed(stages, shuffled(len(false), seed)[:JUDGED])
    every = sum(int(one.sum()) for one in false)
    marks = MARKS if seed <= MARK_SEEDS else ()
    for count in sorted({*(count for count in marks if count <= every), min(every, PAPER_MARKS)}):
        looked, marked = marked_boxes(case, false, count, seed)
        clutter = false_alarms(to_cxcywh(marked), len(looked), case).learned
        alarms[count] = Alarms(
            clutter, len(marked), len(looked), judge.share(births, clutter, looked, usual)
        )
    known = alarms[max(count for count in alarms if count <= PAPER_MARKS)]
    # The second pass knows the false alarms; births are uniform still.
    again = early(followed(mixed(stages, None, known.clutter, 1.0), case, seed).corrected, case)
    after, tracks_after = own_births(*again, case, stages.model.rate)
    looked, marked = marked_boxes(case, false, known.marks, seed)
    return PaperScene(
        births,
        tracks,
        by_hand.learned if by_hand else None,
        alarms,
        after,
        tracks_after,
        on_objects(first[0], case),
        on_objects(again[0], case),
        printed_densities(*first, marked, len(looked), case, stages.model.rate),
        tuned_rates(case, seed),
    )


def early(tracks: Tracks, case: Case) -> tuple[Tracks, int]:
    """The first `PAPER_TRACKS` tracks, and the number of frames in which they began."""
    began = {
        int(one): int(tracks.frame[tracks.identity == one].min())
        for one in np.unique(tracks.identity)
    }
    frames = (
        sorted(began.values())[PAPER_TRACKS - 1] if len(began) >= PAPER_TRACKS else case.info.frames
    )
    rows = np.flatnonzero([began[track] <= frames for track in tracks.identity.tolist()])
    return tracks.select(rows), frames


def own_births(tracks: Tracks, frames: int, case: Case, rate: float) -> tuple[LearnedDensity, int]:
    """Births from the beginnings of the tracks of so many frames, uniform at their rate if there
    are too few; and their number.
    """
    states = births_in(tracks, case.info.fps, rate, everything=True)
    time_units = frames / case.info.fps * rate
    lesson = as_lesson(states, time_units, case)
    # One more than counted: none in a few frames does not imply a rate of 0.
    return (
        lesson.learned if lesson else even(states.shape[1] + 1, time_units, case, 6)
    ), states.shape[1]


def on_objects(tracks: Tracks, case: Case) -> int:
    """How many tracks begin on an object: their first box overlaps one by `NO_OBJECT`."""
    count = 0
    for one in np.unique(tracks.identity):
        rows = np.flatnonzero(tracks.identity == one)
        first = rows[tracks.frame[rows].argmin()]
        there = case.truth.xyxy[case.truth.frame == tracks.frame[first]]
        count += bool((iou(tracks.xyxy[[first]], there) >= NO_OBJECT).any())
    return count


def printed_densities(
    tracks: Tracks, frames: int, marked: F8, looked: int, case: Case, rate: float
) -> tuple[LearnedDensity | None, LearnedDensity | None]:
    """Births and false alarms by the recursion (16)-(20) alone, from the paper's grids: over the
    whole image and all sizes, as they come.

    Parameters
    ----------
    tracks, frames : whose beginnings are births, and in how many frames they began.
    marked, looked : (n, 4) false boxes, and on how many frames they were marked.
    case, rate : the first half, and time units a second.
    """
    size = (float(case.info.width), float(case.info.height))
    births = births_in(tracks, case.info.fps, rate, everything=True)
    boxes = to_cxcywh(marked)
    speed = 2 * float(np.abs(births[2:4]).max(initial=0.0)) + 1e-6
    time_units = frames / case.info.fps * rate
    return (
        _recursive(births, state_volume(size, speed), BIRTH_GRID, time_units),
        _recursive(boxes, measurement_volume(*size), CLUTTER_GRID, looked),
    )


def _recursive(
    samples: F8, volume: tuple[F8, F8], counts: tuple[int, int], exposure: float
) -> LearnedDensity | None:
    """A density learned by the recursion from the paper's grid: mean size, zero speed."""
    if samples.shape[1] < MIN_SAMPLES:
        return None
    low, high = volume
    mean = samples.mean(axis=1)
    if len(mean) == 6:
        mean[2:4] = 0
    spread = np.maximum(samples.std(axis=1), 0.01 * (high - low))
    density = learn_recursively(grid(low, high, counts, mean, spread), samples)
    return LearnedDensity(samples.shape[1] / exposure, density, samples.shape[1])


def tuned_rates(case: Case, seed: int) -> tuple[float, float]:
    """Births a time unit and false alarms a frame of the `SWEEP` with the highest MOTA on the first
    half, or on its first `COMPARED` frames.
    """
    part = stretch(case, 1, min(case.info.frames, COMPARED))
    scored = {}
    for rates in SWEEP:
        run = followed(with_rates(part.info, rates), part, seed)
        scored[rates] = evaluate(part.truth, run.corrected, frames=part.info.frames).MOTA
    return max(scored, key=lambda rates: scored[rates])


def with_rates(
    info: SequenceInfo, rates: tuple[float, float], preset: str = "m09-extended"
) -> AnyStages:
    """A preset with other rates of births a time unit and of false alarms a frame."""
    sets = (
        f"birth.births_per_second={uniform(info).model.rate * rates[0]}",
        f"clutter.clutter_per_frame={rates[1]}",
    )
    return config.build(config.load(None, sets, preset), info)


def even(count: float, units: float, case: Case, dim: int) -> LearnedDensity:
    """Births (``dim`` 6) or false alarms (4) uniform over the image and the detected sizes."""
    size = np.array([case.info.width, case.info.height], np.float64)
    still = np.ones(dim - 4)
    p = uniform_density(
        np.concatenate([0 * size, -still, 0 * size]), np.concatenate([size, still, size])
    )
    return with_prior(LearnedDensity(count / units, p), to_cxcywh(case.table.detections.xyxy)[2:])


def false_detections(case: Case) -> list[Bool]:
    """For each frame, True for detections that overlap no object by `NO_OBJECT`."""
    found = []
    for k in range(1, case.info.frames + 1):
        people = case.truth.xyxy[case.truth.frame == k]
        found.append(iou(case.table.at(k).xyxy, people).max(axis=1, initial=0) < NO_OBJECT)
    return found


def marked_boxes(case: Case, false: Sequence[Bool], count: int, seed: int) -> tuple[list[int], F8]:
    """The frames to mark until ``count`` false alarms are found, and their false boxes (n, 4)."""
    looked = frames_until(false, count, seed)
    return looked, np.concatenate([case.table.at(k).xyxy[false[k - 1]] for k in looked])


def frames_until(false: Sequence[Bool], count: int, seed: int) -> list[int]:
    """Random frames until ``count`` of their detections are false."""
    drawn = shuffled(len(false), seed)
    marks = np.cumsum([int(false[k - 1].sum()) for k in drawn])
    return drawn[: int(np.searchsorted(marks, count)) + 1]


def mixed(
    stages: AnyStages, births: LearnedDensity | None, clutter: LearnedDensity | None, share: float
) -> AnyStages:
    """The stages with a ``share`` of the learned model, and the rest of the uniform one; 0: the
    uniform model.
    """
    if not share:
        return stages
    preset = stages.model
    assert isinstance(preset.birth, MeasurementBirth)
    assert isinstance(preset.clutter, BoxClutter)
    before = preset.birth.births_per_second / preset.rate, preset.clutter.clutter_per_frame
    parts = [
        None if one is None else _laid(one, rate, share)
        for one, rate in zip((births, clutter), before, strict=True)
    ]
    return replace(
        stages, model=with_scene(preset, parts[0], parts[1], None, preset.birth.particles)
    )


def _laid(learned: LearnedDensity, before: float, share: float) -> LearnedDensity:
    """A share of a learned density, and the rest of the uniform rate ``before``."""
    rest = (1 - share) * before
    density = learned.density
    rate = rest + share * learned.rate
    return LearnedDensity(
        rate, replace(density, uniform=(rest + share * learned.rate * density.uniform) / rate)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Judge:
    """Chooses the share of the learned model on the marked frames of ``case``.

    Attributes
    ----------
    case, stages, seed : the training case, and the tracker.
    false : for each frame, which of its detections are false.
    """

    case: Case
    stages: AnyStages
    false: Sequence[Bool]
    seed: int

    def share(
        self, births: LearnedDensity, clutter: LearnedDensity, looked: Sequence[int], usual: F8
    ) -> float:
        """The share among `SHARES` with the most tracked objects minus tracked false alarms on the
        first frames ``looked`` at, as many as ``usual``, which is `followed` of the uniform model,
        has.

        It is 0 unless this exceeds the uniform model's score by more than its standard error.
        """
        judged = looked[: len(usual)]
        best = 0.0
        most = 0.0
        for share in SHARES:
            learned = self.followed(mixed(self.stages, births, clutter, share), judged)
            gain = learned - usual[: len(judged)]
            mean = float(gain.mean())
            error = float(gain.std(ddof=1) / np.sqrt(len(gain))) if len(gain) > 1 else np.inf
            if mean > max(most, error):
                best = share
                most = mean
        return best

    def followed(self, stages: AnyStages, looked: Sequence[int]) -> F8:
        """(n,) number of true detections with a track minus that of false ones, for each marked
        frame.
        """
        whole = self.case.info.frames <= JUDGED * LEAD
        run = followed(stages, self.case, self.seed).corrected if whole else None
        return np.array([self._balance(stages, run, number) for number in looked], np.float64)

    def _balance(self, stages: AnyStages, run: Tracks | None, number: int) -> int:
        first = 1 if run is not None else max(1, number - LEAD)
        tracks = (
            run
            if run is not None
            else followed(stages, stretch(self.case, first, number), self.seed).corrected
        )
        rows = tracks.detection[(tracks.frame == number - first + 1) & (tracks.detection >= 0)]
        return int(np.where(self.false[number - 1][rows], -1, 1).sum())


def stages_of(one: SceneRun, halved: Halves, scene: PaperScene) -> AnyStages:
    """The stages of a run [M09 §V]; a run "GM 100" uses 100 marks."""
    info = halved.test.info
    if one.filter == "m09-mht":
        return config.build(config.load(preset="m09-mht"), info)
    if one.rates is not None or one.run in (TUNED, TUNED_PRINTED):
        preset = "m09" if one.run in WORD_BY_WORD else "m09-extended"
        return with_rates(info, one.rates or scene.tuned, preset)
    stages = of_paper(one, info)
    if one.run in (UM, UM_PRINTED):
        return stages
    run, _, count = one.run.partition(" ")
    alarms = scene.at(int(count) if count else PAPER_MARKS)
    if run == PRINTED:
        return mixed(stages, *scene.printed, 1.0)
    if run == AFTER:
        return mixed(stages, scene.after, alarms.clutter, 1.0)
    if run in ABLATIONS:
        born = even(scene.births.rate, 1.0, halved.train, 6)
        births = {
            "A1": scene.births,
            "A3": born,
            "A4": scene.births,
            "A5": born,
            "A6": scene.hand,
        }.get(run)
        false = (
            alarms.clutter
            if run in ("A2", "A5", "A6")
            else even(alarms.clutter.rate, 1.0, halved.train, 4)
        )
        return mixed(stages, births, None if run == "A1" else false, 1.0)
    return mixed(stages, scene.births, alarms.clutter, 1.0 if run == WHOLE else alarms.share)


def work(job: tuple[SceneRun, Halves, PaperScene]) -> SceneScores:
    """One run, scored."""
    one, halved, scene = job
    return score(one, halved, stages_of(one, halved, scene))


def runs_of(
    scenes: Mapping[str, Halves], learned: Mapping[tuple[str, int], PaperScene], quick: bool
) -> list[SceneRun]:
    """All runs, each once."""
    runs = [SceneRun(name, seed, run) for name, seed in learned for run in RUNS]
    for (name, seed), scene in learned.items():
        few = short_of(scenes[name], COMPARED)
        if seed <= MARK_SEEDS:
            runs += [
                SceneRun(name, seed, f"{run} {count}", frames=few)
                for count in MARKS
                if count in scene.alarms
                for run in (GM, WHOLE)
            ]
        runs += [
            SceneRun(name, seed, run, frames=few) for run in (UM, UM_PRINTED, PRINTED, GM, AFTER)
        ]
        runs += [SceneRun(name, seed, run, filter_, frames=few) for filter_, run in RIVALS]
        runs += [
            SceneRun(name, seed, run, rates=rates, frames=few)
            for run in (UM, UM_PRINTED)
            for rates in SWEEP[: 1 if quick else None]
        ]
    return list(dict.fromkeys(runs))


def main(options: Options) -> Path:
    """Run everything and write m09.md and its pictures."""
    study = Study(
        "m09",
        learn,
        runs_of,
        stages_of,
        work,
        (*RENDERED, *REAL, *HELD_OUT, INDOOR),
        FRAMES,
        (SEEDS, SEEDS),
        COMPARED,
    )
    found = results(study, options)
    learned = found.learned
    curves = {name: curve(found, learned, name) for name in found.scenes}
    draw(curves, found, options.folder / "m09-marks.png")
    draw_sweeps(found, options.folder / "m09-sweep.png")
    return write(
        "m09",
        options,
        m09_claims.claims(found),
        gains=_gains(found),
        scores=scores(found, (*WORD_BY_WORD, UM, TUNED, GM, WHOLE, AFTER)),
        sweep=_sweep(found),
        findings=_findings(found),
        curve=_curves(curves, found),
        delays=_delays(found),
        rivals=_rivals(found),
        lessons=_lessons(learned),
        times=times(found.timings),
        scenes=_listed(name for name in found.scenes if name in RENDERED),
        frames=max(one.frames for one in found.scenes.values()),
        seeds=max(found.seeds(name) for name in found.scenes),
        pairs=len(SWEEP),
        compared=COMPARED,
        paper_marks=PAPER_MARKS,
        paper_tracks=PAPER_TRACKS,
    )


def _listed(names: Iterable[str]) -> str:
    """Names as code, with commas between them."""
    return ", ".join(f"`{name}`" for name in names)


def _hide_unused(axes: Any, used: int) -> None:
    """Hide the panels after the first ``used``, which have nothing to show."""
    for axis in axes.ravel()[used:]:
        axis.set_visible(False)


def draw_sweeps(found: SceneResults, path: Path) -> None:
    """Draw MOTA of the uniform model over its rate of false alarms, a curve for each rate of
    births, and that of the learned models [M09 Fig. 15].
    """
    plt = pyplot()
    across = min(3, len(found.scenes))
    down = -(-len(found.scenes) // across)
    figure, axes = plt.subplots(
        down, across, figsize=(3.6 * across, 2.7 * down), squeeze=False, layout="constrained"
    )
    for axis, name in zip(axes.ravel(), found.scenes, strict=False):
        swept = {rates: found.each(name, UM, "MOTA", rates=rates) for rates in SWEEP}
        for births in sorted({rates[0] for rates in swept}):
            own = {rates[1]: each for rates, each in swept.items() if rates[0] == births and each}
            means = [float(np.mean(each)) for each in own.values()]
            errors = [_standard_error(each) for each in own.values()]
            label = f"UM, {births:g} births"
            axis.errorbar(list(own), means, errors, fmt="o-", ms=3, capsize=2, label=label)
        for run, style in ((PRINTED, "--"), (AFTER, "-")):
            each = found.each_short(name, run, "MOTA")
            mean = float(np.mean(each))
            error = _standard_error(each)
            axis.axhline(mean, color="k", lw=1, ls=style, label=run)
            axis.axhspan(mean - error, mean + error, color="k", alpha=0.12, lw=0)
        axis.set(xscale="log", xlabel="false alarms a frame", ylabel="MOTA", title=name)
        axis.grid(alpha=0.3)
    _hide_unused(axes, len(found.scenes))
    axes[0, 0].legend(fontsize=7)
    figure.savefig(path, dpi=75)
    plt.close(figure)


def _standard_error(values: Sequence[float]) -> float:
    """The standard error of the mean; 0 of a single value, which has none."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


# MOTA minus UM's with the chosen share and with the full learned model, and the mean share, by the
# number of marks.
Curve = Mapping[int, tuple[float, float, float]]


def curve(found: SceneResults, learned: Mapping[tuple[str, int], PaperScene], name: str) -> Curve:
    """The gain for each number of marks, on the frames of the comparison: means over seeds."""
    few = found.few(name)
    seeds = [seed for scene, seed in learned if scene == name and seed <= MARK_SEEDS]
    out = {}
    for count in (
        count for count in MARKS if all(count in learned[name, seed].alarms for seed in seeds)
    ):
        gains = []
        for seed in seeds:
            base = found.runs_[SceneRun(name, seed, UM, frames=few)].scores.MOTA
            each = [
                found.runs_[SceneRun(name, seed, f"{run} {count}", frames=few)].scores.MOTA - base
                for run in (GM, WHOLE)
            ]
            gains.append((*each, learned[name, seed].alarms[count].share))
        chosen, whole, share = (float(value) for value in np.mean(gains, axis=0))
        out[count] = chosen, whole, share
    return out


def draw(curves: Mapping[str, Curve], found: SceneResults, path: Path) -> None:
    """Draw MOTA minus UM's over the number of marks, a panel for each scene."""
    plt = pyplot()
    across = min(3, len(curves))
    down = -(-len(curves) // across)
    figure, axes = plt.subplots(
        down, across, figsize=(3.6 * across, 2.7 * down), squeeze=False, layout="constrained"
    )
    for axis, (name, values) in zip(axes.ravel(), curves.items(), strict=False):
        axis.plot(
            list(values),
            [one[0] for one in values.values()],
            "o-",
            label="share chosen by the marks",
        )
        axis.plot(
            list(values), [one[1] for one in values.values()], "s--", label="all that was learned"
        )
        axis.axhline(0, color="k", lw=0.8)
        axis.set(xscale="log", xlabel="marks", ylabel="MOTA less UM's", title=name)
        axis.set_xticks(list(values), [str(count) for count in values])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    _hide_unused(axes, len(curves))
    axes[0, 0].legend(fontsize=7)
    figure.savefig(path, dpi=75)
    plt.close(figure)


def _delays(found: SceneResults) -> str:
    rows = []
    for scene in found.scenes:
        for run in (*WORD_BY_WORD, UM, TUNED, GM, AFTER):
            rows.append(
                (
                    scene,
                    run,
                    *(number(found.delay(scene, run, where)) for where in ("inside", "outside")),
                )
            )
    return table(("scene", "run", "inside", "outside"), rows)


def _curves(curves: Mapping[str, Curve], found: SceneResults) -> str:
    rows = []
    for name, values in curves.items():
        base = np.mean(found.each_short(name, UM, "MOTA")[:MARK_SEEDS])
        cells = [
            "{:+.3f}, {:+.3f} ({:.2g})".format(*values[count]) if count in values else "–"
            for count in MARKS
        ]
        rows.append((name, float(base), *cells))
    return table(("scene", "UM", *(f"{count} marks" for count in MARKS)), rows)


def _sweep(found: SceneResults) -> str:
    rows = []
    for scene in found.scenes:
        for plain, learned in ((UM_PRINTED, PRINTED), (UM, AFTER)):
            births, clutter = rates = m09_claims.best_rates(found, scene, plain)
            cells = []
            for score_ in ("MODA", "MOTA"):
                best = found.each(scene, plain, score_, rates=rates)
                ours = found.each_short(scene, learned, score_)
                gap = [a - b for a, b in zip(ours, best, strict=True)]
                cells += [f"{np.mean(best):.3f}", with_error(gap, sign="+")]
            rows.append((scene, learned, f"{births:g}", f"{clutter:g}", *cells))
    header = (
        "scene",
        "learned",
        "births",
        "clutter",
        *(f"{score_}{words}" for score_ in ("MODA", "MOTA") for words in _BESIDE_BEST),
    )
    return table(header, rows)


_BESIDE_BEST = (" of the best UM", ", learned less it")


def _gains(found: SceneResults) -> str:
    """Scores of the runs less those of the uniform model with the same extraction, with standard
    errors over the seeds.
    """
    rows = []
    for scene in found.scenes:
        for run in RUNS:
            plain = UM_PRINTED if run in WORD_BY_WORD else UM
            if run != plain:
                gaps = (with_error(found.gaps(scene, run, plain, one), sign="+") for one in SCORES)
                false_tracks = with_error(found.gaps(scene, run, plain, "false_tracks"), 1, "+")
                rows.append((scene, run, *gaps, false_tracks))
    header = ("scene", "run", *(f"{score_}, less UM" for score_ in SCORES), "false tracks, less UM")
    return table(header, rows)


def _findings(found: SceneResults) -> str:
    """MOTA of one run minus that of another, with standard errors over the seeds."""
    pairs = (*FINDINGS, (AFTER, "A2"), (AFTER, GM), ("A6", AFTER))
    rows = [
        (scene, *(with_error(found.gaps(scene, a, b, "MOTA"), sign="+") for a, b in pairs))
        for scene in found.scenes
    ]
    return table(("scene", *(f"{a} less {b}" for a, b in pairs)), rows)


_TRACKERS = {
    "": "PROP",
    "none": "DA",
    "mht": "MHT",
    "fv": "PROP, fixed variances",
    "m09-mht": "MHT, M09's own parameters",
}


def _rivals(found: SceneResults) -> str:
    rows = []
    for scene in found.scenes:
        for filter_, run in (("", UM_PRINTED), ("", PRINTED), ("", UM), ("", AFTER), *RIVALS):
            keys = (*SCORES, "false_tracks")
            if filter_:
                values = [found.each(scene, run, key, filter_) for key in keys]
            else:
                values = [found.each_short(scene, run, key) for key in keys]
            if all(values):
                taught = "–" if filter_ in ("none", "m09-mht") else run
                digits = (*(3 for _ in SCORES), 1)
                cells = (with_error(each, some) for each, some in zip(values, digits, strict=True))
                rows.append((scene, _TRACKERS[filter_], taught, *cells))
    return table(("scene", "tracker", "taught", *SCORES, "false tracks"), rows)


def _lessons(learned: Mapping[tuple[str, int], PaperScene]) -> str:
    rows = []
    for (name, seed), scene in learned.items():
        if seed == 1:
            most = scene.at(PAPER_MARKS)
            births = scene.births
            hand = f"{scene.hand.rate:.4f}" if scene.hand else "too few"
            false = most.clutter
            rows.append(
                (
                    name,
                    most.marks,
                    most.frames,
                    f"{false.rate:.2f}",
                    len(false.density),
                    f"{false.density.uniform:.2f}",
                    f"{most.share:g}",
                    scene.tracks,
                    f"{births.rate:.4f}",
                    len(births.density),
                    f"{births.density.uniform:.2f}",
                    hand,
                    f"{scene.real} of {scene.tracks}",
                    f"{scene.real_after} of {scene.tracks_after}",
                    f"{scene.after.rate:.4f}",
                    "{:g}, {:g}".format(*scene.tuned),
                )
            )
    header = (
        "scene",
        "marks",
        "frames",
        "r̄",
        "places",
        "α_u",
        "share",
        "tracks",
        "s̄",
        "places",
        "α_u",
        "s̄ by hand",
        "begin on an object",
        "after",
        "s̄ after",
        "UM tuned: births, clutter",
    )
    return table(header, rows)
