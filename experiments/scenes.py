"""Learned scenes with the default filter: the effect of births and false alarms added to the usual
ones, part by part.

Rendered scenes of 20 000 frames and real sequences; the first half is for training, the second for
testing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from experiments import m09_pictures
from experiments.common import Options, in_parallel, table, with_interval, write
from experiments.m09_lessons import LearnedScene, learn
from experiments.m09_runs import (
    ABLATIONS,
    GM,
    SWEEP,
    UM,
    SceneRun,
    SceneScores,
    seconds_per_frame,
    stages_of,
    work,
)
from experiments.m09_scenes import (
    FRAMES,
    HELD_OUT,
    REAL,
    RENDERED,
    SHORT,
    Halves,
    detector_seconds,
    halves,
    picture,
)
from phdtrack.compare.statistics import Interval, interval
from phdtrack.metrics import Scores, pool
from phdtrack.protocols import AnyStages
from phdtrack.state import settings_digest
from phdtrack.types import F8

# Rendered scenes are long: one seed, with intervals over quarters of the frames.
SEEDS = 3
LONG_SEEDS = 1
# Frames of the second half of a rendered scene for the sweep and for other filters.
QUARTER = 2500
RUNS = (UM, GM, *ABLATIONS)
SCORES = ("MODA", "MODP", "MOTA", "MOTP")
# The paper's findings: one run above another.
FINDINGS = (("A2", "A1"), ("A5", "A4"), (GM, "A2"), ("A6", GM))


L = TypeVar("L")
"""The type of a learned scene."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneResults(Generic[L]):
    """The results of a `Study`.

    Attributes
    ----------
    scenes : by name.
    runs_ : scores by run. learned : the learned scene for each scene and seed.
    timings : by scene, seconds per frame of the uniform and of the learned model, block by block,
        and of the detector.
    compared : number of frames of a rendered scene on which uniform rates are compared.
    """

    scenes: Mapping[str, Halves]
    runs_: Mapping[SceneRun, SceneScores]
    learned: Mapping[tuple[str, int], L]
    timings: Mapping[str, tuple[F8, F8, float]]
    compared: int

    def seeds(self, scene: str) -> int:
        """The number of seeds."""
        return sum(name == scene for name, _ in self.learned)

    def runs(self, scene: str, run: str) -> list[SceneScores]:
        """The scores of a run of the default filter on the whole second half, one for each seed."""
        return [self.runs_[SceneRun(scene, seed, run)] for seed in range(1, self.seeds(scene) + 1)]

    def short_run(self, scene: str, run: str) -> SceneScores:
        """The scores on the frames on which uniform rates are compared, for the first seed."""
        return self.runs_[SceneRun(scene, 1, run, frames=self.few(scene))]

    def few(self, scene: str) -> int:
        """The number of frames on which uniform rates are compared; 0: all."""
        return short_of(self.scenes[scene], self.compared)

    def each(
        self,
        scene: str,
        run: str,
        score: str,
        filter_: str = "",
        rates: tuple[float, float] | None = None,
    ) -> list[float]:
        """A score for each seed: of a run of the experiment's filter on all frames, of another
        filter or of other uniform ``rates`` on `few`; empty if there is no such run.
        """
        few = self.few(scene) if filter_ or rates else 0
        keys = [
            SceneRun(scene, seed, run, filter_, rates, few)
            for seed in range(1, self.seeds(scene) + 1)
        ]
        return [float(getattr(self.runs_[key].scores, score)) for key in keys if key in self.runs_]

    def each_short(self, scene: str, run: str, score: str) -> list[float]:
        """A score for each seed, of a run of the experiment's filter on `few` frames."""
        few = self.few(scene)
        seeds = range(1, self.seeds(scene) + 1)
        runs = [self.runs_[SceneRun(scene, seed, run, frames=few)] for seed in seeds]
        return [float(getattr(one.scores, score)) for one in runs]

    def gaps(self, scene: str, one: str, other: str, score: str) -> list[float]:
        """A score of one run minus that of another, for each seed."""
        pairs = zip(self.each(scene, one, score), self.each(scene, other, score), strict=True)
        return [a - b for a, b in pairs]

    def pooled(self, scenes: Sequence[str], run: str) -> list[Scores]:
        """The scores over all ``scenes``: for each seed, or for each quarter of the frames if there
        is one seed.
        """
        each = [self._parts(scene, run) for scene in scenes]
        return [pool(some) for some in zip(*each, strict=True)]

    def _parts(self, scene: str, run: str) -> Sequence[Scores]:
        runs = self.runs(scene, run)
        return [one.scores for one in runs] if len(runs) > 1 else runs[0].blocks

    def gain(self, scenes: Sequence[str], run: str, score: str) -> Interval:
        """A score of a run minus that of the uniform model, pooled over the ``scenes``.

        The mean is that of all frames; the interval is over seeds, or quarters of the frames.
        """
        ours = self.pooled(scenes, run)
        theirs = self.pooled(scenes, UM)
        spread = interval(
            [
                float(getattr(a, score) - getattr(b, score))
                for a, b in zip(ours, theirs, strict=True)
            ]
        )
        whole = [
            pool([one.scores for scene in scenes for one in self.runs(scene, name)])
            for name in (run, UM)
        ]
        seeds = self.seeds(scenes[0]) if score == "false_tracks" else 1
        difference = float(getattr(whole[0], score) - getattr(whole[1], score)) / seeds
        return Interval(difference, spread.half, spread.seeds)

    def mean(self, scene: str, run: str, score: str) -> float:
        """A score's mean over the seeds."""
        return float(np.mean(self.each(scene, run, score)))

    def delay(self, scene: str, run: str, where: str) -> float:
        """Mean delay over all objects and seeds, ``inside`` or ``outside`` where people enter; NaN
        without any.
        """
        each = [delay for one in self.runs(scene, run) for delay in getattr(one, where).values()]
        return float(np.mean(each)) if each else float("nan")

    def sweep(self, scene: str, run: str) -> dict[tuple[float, float], Scores]:
        """Scores of the uniform model by its rates, of the first seed."""
        swept = (one for one in self.runs_ if (one.scene, one.seed, one.run) == (scene, 1, run))
        return {one.rates: self.runs_[one].scores for one in swept if one.rates is not None}

    def groups(self) -> dict[str, tuple[str, ...]]:
        """The scenes one by one, then the rendered ones together, PETS09-S2L1, and the other
        three.
        """
        single: dict[str, tuple[str, ...]] = {name: (name,) for name in self.scenes}
        both = {"all rendered": RENDERED, "all PETS09-S2L1": REAL, "the other three": HELD_OUT}
        return single | {name: some for name, some in both.items() if set(some) <= set(self.scenes)}


def short_of(scene: Halves, frames: int = QUARTER) -> int:
    """The number of frames of the second half on which uniform rates are compared: ``frames`` of a
    long scene, 0 for all of a short one.
    """
    return frames if scene.frames > 4 * frames else 0


def runs_of(
    scenes: Mapping[str, Halves], learned: Mapping[tuple[str, int], LearnedScene], quick: bool
) -> list[SceneRun]:
    """All runs, each once."""
    runs = [SceneRun(name, seed, run) for name, seed in learned for run in RUNS]
    for name, scene in scenes.items():
        few = short_of(scene)
        runs += [SceneRun(name, 1, run, frames=few) for run in (UM, GM)]
        runs += [
            SceneRun(name, 1, UM, rates=rates, frames=few)
            for rates in SWEEP[: 2 if quick else len(SWEEP)]
        ]
    return list(dict.fromkeys(runs))


@dataclass(frozen=True, slots=True)
class Study(Generic[L]):
    """The learning and the runs of an experiment.

    Attributes
    ----------
    label : the name of the experiment, for progress.
    learn : learns a scene with a seed.
    runs_of : all runs, from the scenes, the learned scenes and True for the short form.
    stages_of : the stages of a run.
    work : the scores of a run.
    names, frames : of the scenes, and how many frames a rendered one has.
    seeds : numbers of seeds of a rendered and of a real scene. The second half of a rendered one is
        divided among its seeds.
    compared : number of frames of a rendered scene on which uniform rates are compared.
    """

    label: str
    learn: Callable[[tuple[Halves, int]], L]
    runs_of: Callable[[Mapping[str, Halves], Mapping[tuple[str, int], L], bool], list[SceneRun]]
    stages_of: Callable[[SceneRun, Halves, L], AnyStages]
    work: Callable[[tuple[SceneRun, Halves, L]], SceneScores]
    names: tuple[str, ...] = (*RENDERED, *REAL, *HELD_OUT)
    frames: int = FRAMES
    seeds: tuple[int, int] = (LONG_SEEDS, SEEDS)
    compared: int = QUARTER

    def scored(
        self,
        runs: Sequence[SceneRun],
        tested: Mapping[tuple[str, int], Halves],
        learned: Mapping[tuple[str, int], L],
        options: Options,
    ) -> dict[SceneRun, SceneScores]:
        """The scores of all runs; those with the same stages, frames and seed are run once.

        Parameters
        ----------
        runs, tested, learned : the runs; by scene and seed the frames to test on, and what was
            learned.
        options : the number of processes.
        """
        same = {}
        for run in runs:
            key = run.scene, run.seed
            digest = settings_digest(self.stages_of(run, tested[key], learned[key]))
            same[run] = (*key, run.frames, digest)
        first = {key: run for run, key in reversed(same.items())}
        jobs = [
            (run, tested[run.scene, run.seed], learned[run.scene, run.seed])
            for run in first.values()
        ]
        found = dict(zip(first, in_parallel(self.work, jobs, self.label, options), strict=True))
        return {run: found[key] for run, key in same.items()}


def results(study: Study[L], options: Options) -> SceneResults[L]:
    """Learn every scene and do all runs."""
    quick = options.quick
    names = study.names[:1] if quick else study.names
    label = study.label
    scene_jobs = [(name, SHORT if quick else study.frames) for name in names]
    found = in_parallel(halves, scene_jobs, f"{label}, rendering and detecting", options)
    scenes = dict(zip(names, found, strict=True))
    seeds = {name: options.number(study.seeds[name not in RENDERED], 1) for name in names}
    lessons = [(name, seed) for name in names for seed in range(1, seeds[name] + 1)]
    lesson_jobs = [(scenes[name], seed) for name, seed in lessons]
    found_lessons = in_parallel(study.learn, lesson_jobs, f"{label}, learning", options)
    learned = dict(zip(lessons, found_lessons, strict=True))
    tested = {(name, seed): scenes[name].tested_on(seed, seeds[name]) for name, seed in lessons}
    scored = study.scored(study.runs_of(scenes, learned, quick), tested, learned, options)
    # One at a time, without other runs of this command.
    timings = {}
    for name in (name for name in (RENDERED[0], REAL[0]) if name in names):
        both = [
            study.stages_of(SceneRun(name, 1, run), scenes[name], learned[name, 1])
            for run in (UM, GM)
        ]
        timings[name] = (
            *seconds_per_frame(both, scenes[name].test, 400 if quick else 1000),
            detector_seconds(scenes[name]),
        )
    return SceneResults(scenes, scored, learned, timings, study.compared)


def main(options: Options) -> Path:
    """Run everything and write scenes.md and its pictures."""
    found = results(Study("scenes", learn, runs_of, stages_of, work), options)
    draw(found, options.folder)
    return write("scenes", options, **figures(found))


def draw(found: SceneResults, out: Path) -> None:
    """Draw the pictures."""
    rendered_scenes = {name: scene for name, scene in found.scenes.items() if name in RENDERED}
    maps = {
        name: (picture(scene), found.learned[name, 1]) for name, scene in rendered_scenes.items()
    }
    m09_pictures.maps(maps, out / "scenes-maps.png")
    runs = (GM, *ABLATIONS)
    gains = {
        scene: {
            run: {score: found.gain([scene], run, score) for score in ("MODA", "MOTA")}
            for run in runs
        }
        for scene in found.scenes
    }
    m09_pictures.bars(gains, out / "scenes-gains.png")
    sweeps = {
        scene: (
            {rates: one.MOTA for rates, one in found.sweep(scene, UM).items()},
            found.short_run(scene, GM).scores.MOTA,
        )
        for scene in found.scenes
    }
    m09_pictures.sweeps(sweeps, out / "scenes-sweep.png")


def figures(found: SceneResults) -> dict[str, object]:
    """The values of the page's placeholders."""
    return {
        "seeds": max(found.seeds(name) for name in found.scenes),
        "findings": findings(found),
        "gains": gains(found, found.groups(), RUNS),
        "scores": scores(found, RUNS),
        "delays": _delays(found),
        "sweep": _sweep(found),
        "rates": times(found.timings),
        "lessons": _lessons(found),
    }


def number(value: float) -> str:
    """The number with one digit; a dash for NaN."""
    return f"{value:.1f}" if np.isfinite(value) else "–"


def findings(found: SceneResults) -> str:
    """MOTA of one run minus that of another, scene by scene."""
    rows = [
        (
            scene,
            *(
                f"{found.mean(scene, a, 'MOTA') - found.mean(scene, b, 'MOTA'):+.3f}"
                for a, b in FINDINGS
            ),
        )
        for scene in found.scenes
    ]
    return table(("scene", *(f"{a} less {b}" for a, b in FINDINGS)), rows)


def gains(found: SceneResults, groups: Mapping[str, Sequence[str]], runs: Sequence[str]) -> str:
    """Scores of the runs less those of the uniform model, for each group of scenes."""
    rows = [
        (
            group,
            run,
            *(with_interval(found.gain(some, run, score), sign="+") for score in SCORES),
            with_interval(found.gain(some, run, "false_tracks"), 0, "+"),
        )
        for group, some in groups.items()
        for run in runs
        if run != UM
    ]
    return table(
        ("scene", "run", *(f"{score}, less UM" for score in SCORES), "false tracks, less UM"), rows
    )


def scores(found: SceneResults, runs: Sequence[str]) -> str:
    """The scores and errors of the runs, scene by scene."""
    keys = ("misses", "false_positives", "id_switches", "false_tracks")
    rows = []
    for scene in found.scenes:
        for run in runs:
            counts = (round(found.mean(scene, run, key)) for key in keys)
            rows.append((scene, run, *(found.mean(scene, run, score) for score in SCORES), *counts))
    header = ("scene", "run", *SCORES, "misses", "false boxes", "switches", "false tracks")
    return table(header, rows)


def _delays(found: SceneResults) -> str:
    rows = []
    for scene in found.scenes:
        for run in RUNS:
            each = found.runs(scene, run)
            counts = (
                round(float(np.mean([len(getattr(one, where)) for one in each])))
                for where in ("inside", "outside")
            )
            late = (number(found.delay(scene, run, where)) for where in ("inside", "outside"))
            live = (
                float(np.mean([getattr(one.live, score) for one in each]))
                for score in ("MOTA", "false_positives")
            )
            rows.append((scene, run, *late, *counts, next(live), round(next(live))))
    header = (
        "scene",
        "run",
        "delay inside",
        "outside",
        "people found, inside",
        "outside",
        "live MOTA",
        "live false boxes",
    )
    return table(header, rows)


def _sweep(found: SceneResults) -> str:
    rows = []
    for scene in found.scenes:
        learned = found.short_run(scene, GM).scores
        (births, clutter), best = max(found.sweep(scene, UM).items(), key=lambda item: item[1].MOTA)
        missed = (one.misses / one.truth_boxes for one in (best, learned))
        gap = f"{learned.MOTA - best.MOTA:+.3f}"
        rows.append((scene, f"{births:g}", f"{clutter:g}", best.MOTA, learned.MOTA, gap, *missed))
    header = (
        "scene",
        "births",
        "clutter",
        "best MOTA",
        "GM",
        "GM less best",
        "best misses",
        "GM misses",
    )
    return table(header, rows)


def times(timings: Mapping[str, tuple[F8, F8, float]]) -> str:
    """A table of seconds a frame: uniform, learned, and the detector; medians over blocks."""
    rows = []
    for scene, (*both, detector) in timings.items():
        uniform, learned = (float(np.median(each)) for each in both)
        cells = (f"{1e3 * each:.2f}" for each in (uniform, learned, detector))
        whole = (detector + learned) / (detector + uniform)
        rows.append((scene, *cells, f"{learned / uniform:.2f}", f"{whole:.3f}"))
    header = (
        "scene",
        "UM, ms a frame",
        "GM, ms a frame",
        "the detector",
        "GM over UM",
        "with the detector",
    )
    return table(header, rows)


def _lessons(found: SceneResults) -> str:
    rows = []
    for name in found.scenes:
        one = found.learned[name, 1]
        births, hand = (
            (f"{part.rate:.4f}", part.samples, len(part.density)) if part else ("–", "too few", "–")
            for part in (one.births, one.hand)
        )
        gains = (number(gain) for gain in one.gains)
        followed = f"{one.seen.share:.0%}" if one.seen else "–"
        clutter = (f"{one.clutter.rate:.2f}", one.clutter.samples, len(one.clutter.density))
        rows.append((name, *clutter, followed, *births, *hand, *gains))
    header = (
        "scene",
        "r̄",
        "boxes marked",
        "places",
        "followed",
        "s̄",
        "tracks",
        "places",
        "s̄ by hand",
        "marks",
        "places",
        "gain of false alarms",
        "of births",
        "by hand",
    )
    return table(header, rows)
