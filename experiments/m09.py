"""M09 Figs. 7, 8, 11, 14-16: births and false alarms learned from a scene, against uniform ones, part by part.

    phdtrack reproduce m09

Scenes of 20 000 rendered frames and real sequences; the first half teaches, the second tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments import m09_learner, m09_pictures, m09_places, m09_words
from experiments.common import Kept, Options, in_parallel, table, write
from experiments.m09_lessons import Course, Taught, learn
from experiments.m09_runs import (
    ABLATIONS,
    GM,
    GM_IMAGE,
    IMAGE,
    IMAGE_SWEEP,
    LOCAL_SWEEP,
    PHD,
    UM,
    Job,
    Outcome,
    Race,
    race,
    work,
)
from experiments.m09_scenes import (
    FRAMES,
    HELD_OUT,
    PETS,
    REAL,
    RENDERED,
    SHORT,
    Footage,
    detected_in,
    picture,
    rendered,
)
from phdtrack.compare.statistics import Interval, interval
from phdtrack.metrics import Scores, pool

# Rendered scenes are long: one seed, whose intervals are over quarters of the stretch.
SEEDS, LONG_SEEDS, LEARNER_SEEDS = 3, 1, 8
# Of the second half of a rendered scene, for the sweep and for other filters.
QUARTER = 2500
RUNS = (UM, IMAGE, GM, GM_IMAGE, *ABLATIONS)
# Filter and run; nothing else than the filter differs.
RIVALS = ((UM, "none"), (UM, "mht"), (GM, "mht"), (UM, "gm-phd"), (GM, "gm-phd"), (UM, "particle-phd"), (GM, "particle-phd"))
RACES = (PHD, "gm-phd", "mht", "particle-phd")
SCORES = ("MODA", "MODP", "MOTA", "MOTP")


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """All runs; ``scenes`` by name, what each has ``taught`` at each seed."""

    scenes: dict[str, Footage]
    outcomes: dict[Job, Outcome]
    taught: dict[Course, Taught]
    races: dict[Race, tuple[float, float, float]]

    def course(self, scene: str, seed: int = 1) -> Course:
        """What is learned of a scene at a seed."""
        return Course(self.scenes[scene], seed)

    def seeds(self, scene: str) -> int:
        """How many seeds there are."""
        return sum(course.footage == self.scenes[scene] for course in self.taught)

    def runs(self, scene: str, run: str) -> list[Outcome]:
        """The outcomes of a run of the default filter on the whole second half, one for each seed."""
        return [self.outcomes[Job(self.course(scene, seed), run)] for seed in range(1, self.seeds(scene) + 1)]

    def beside(self, scene: str, run: str, filter_: str = PHD) -> Outcome:
        """The outcome on the stretch on which filters and uniform rates are compared, of the first seed."""
        return self.outcomes[Job(self.course(scene), run, filter_, frames=short_of(self.scenes[scene]))]

    def pooled(self, scenes: Sequence[str], run: str) -> list[Scores]:
        """The scores over all ``scenes``: for each seed, or for each quarter of the stretch where there is one seed."""
        each = [self._parts(scene, run) for scene in scenes]
        return [pool(some) for some in zip(*each, strict=True)]

    def _parts(self, scene: str, run: str) -> Sequence[Scores]:
        runs = self.runs(scene, run)
        return [one.scores for one in runs] if len(runs) > 1 else runs[0].blocks

    def gain(self, scenes: Sequence[str], run: str, score: str) -> Interval:
        """A score of a run less that of the uniform model, pooled over the ``scenes``.

        The mean is that of all frames; the interval is over seeds, or quarters of the stretch.
        """
        ours, theirs = self.pooled(scenes, run), self.pooled(scenes, UM)
        spread = interval([float(getattr(a, score) - getattr(b, score)) for a, b in zip(ours, theirs, strict=True)])
        whole = [pool([one.scores for scene in scenes for one in self.runs(scene, name)]) for name in (run, UM)]
        seeds = self.seeds(scenes[0]) if score == "false_tracks" else 1
        difference = float(getattr(whole[0], score) - getattr(whole[1], score)) / seeds
        return Interval(difference, spread.half, spread.count)

    def mean(self, scene: str, run: str, score: str) -> float:
        """A score's mean over the seeds."""
        return float(np.mean([getattr(one.scores, score) for one in self.runs(scene, run)]))

    def delay(self, scene: str, run: str, where: str) -> float:
        """Mean delay over all objects and seeds, ``inside`` or ``outside`` the places where people enter; NaN of nobody."""
        each = [delay for one in self.runs(scene, run) for delay in getattr(one, where).values()]
        return float(np.mean(each)) if each else float("nan")

    def delayed(self, scene: str) -> tuple[float, float, int, int]:
        """Of those who enter and whom UM and GM both find: mean delays of both, how many each finds, over all seeds."""
        pairs = [(a.inside, b.inside) for a, b in zip(self.runs(scene, UM), self.runs(scene, GM), strict=True)]
        both = np.array([(a[who], b[who]) for a, b in pairs for who in a.keys() & b.keys()]).reshape(-1, 2)
        late = both.mean(axis=0) if len(both) else np.full(2, np.nan)
        return float(late[0]), float(late[1]), sum(len(a) for a, _ in pairs), sum(len(b) for _, b in pairs)

    def sweep(self, scene: str, run: str) -> dict[tuple[float, float], Scores]:
        """Scores of the uniform model by its rates, of the first seed."""
        swept = (job for job in self.outcomes if job.course == self.course(scene) and job.run == run)
        return {job.rates: self.outcomes[job].scores for job in swept if job.rates is not None}

    def groups(self) -> dict[str, tuple[str, ...]]:
        """The scenes one by one, then the rendered ones together, PETS09-S2L1, and those that nothing was chosen on."""
        single: dict[str, tuple[str, ...]] = {name: (name,) for name in self.scenes}
        both = {"all rendered": RENDERED, "all PETS09-S2L1": REAL, "all held out": HELD_OUT}
        return single | {name: some for name, some in both.items() if set(some) <= set(self.scenes)}


def short_of(scene: Footage) -> int:
    """How many frames of the second half filters and uniform rates are compared on; 0: all."""
    return QUARTER if scene.frames > 4 * QUARTER else 0


def jobs_of(courses: Sequence[Course], quick: bool) -> list[Job]:
    """All runs, each once."""
    jobs = [Job(course, run) for course in courses for run in RUNS]
    for first in (course for course in courses if course.seed == 1):
        few = short_of(first.footage)
        jobs += [Job(first, run, name, frames=few) for run, name in ((UM, PHD), (GM, PHD), *RIVALS)]
        for run, rates in ((UM, LOCAL_SWEEP), (IMAGE, IMAGE_SWEEP)):
            jobs += [Job(first, run, PHD, each, few) for each in rates[: 2 if quick else len(rates)]]
    return list(dict.fromkeys(jobs))


def main(options: Options | None = None) -> Path:
    """Run everything and write m09.md and its pictures."""
    options = options or Options()
    if options.folder is not None:
        return _main(options, options.folder)
    # Rendered frames are looked at once, however many runs there are.
    with TemporaryDirectory() as folder:
        return _main(options, Path(folder))


def _main(options: Options, folder: Path) -> Path:
    quick = options.quick
    frames = SHORT if quick else FRAMES
    in_parallel(rendered, [(name, frames) for name in RENDERED[: 1 if quick else 3]], "m09, rendering", folder)
    scenes = [Footage(name, frames, str(folder)) for name in RENDERED[: 1 if quick else 3]]
    if not quick:
        in_parallel(detected_in, [PETS], "m09, detecting", folder)
        scenes += [Footage(name, 0, str(folder)) for name in (*REAL, *HELD_OUT)]
    courses = [
        Course(scene, seed)
        for scene in scenes
        for seed in range(1, 1 + options.number(LONG_SEEDS if scene.frames else SEEDS, 1))
    ]
    taught = dict(zip(courses, in_parallel(learn, courses, "m09, learning", folder), strict=True))
    jobs = jobs_of(courses, quick)
    outcomes = dict(zip(jobs, in_parallel(work, jobs, "m09", folder), strict=True))
    races = {one: Kept(race, folder)(one) for one in races_of(scenes, quick)}
    places = m09_places.jobs_of(quick, options.number(SEEDS, 1))
    learner = m09_learner.jobs_of(quick, options.number(LEARNER_SEEDS, 2))
    found = Found({scene.name: scene for scene in scenes}, outcomes, taught, races)
    crossed = dict(zip(places, in_parallel(m09_places.work, places, "m09, places", folder), strict=True))
    mixtures = dict(zip(learner, in_parallel(m09_learner.work, learner, "m09, learner", folder), strict=True))
    draw(found, options.out)
    return write("m09.md", page(found, crossed, mixtures), options.out)


def races_of(scenes: Sequence[Footage], quick: bool) -> list[Race]:
    """Which filters are timed on which scenes: one at a time, each alone on the machine as far as this command goes."""
    timed = [scene for scene in scenes if scene.name in (RENDERED[0], REAL[0])]
    return [
        Race(Course(scene, 1), name, 400 if quick else 1000)
        for scene in timed
        for name in RACES[: 1 if quick else len(RACES)]
    ]


def draw(found: Found, out: Path) -> None:
    """The pictures."""
    out.mkdir(parents=True, exist_ok=True)
    shown = {name: scene for name, scene in found.scenes.items() if name in RENDERED}
    maps = {name: (picture(scene), found.taught[found.course(name)]) for name, scene in shown.items()}
    m09_pictures.maps(maps, out / "m09-maps.png")
    runs = (GM, *ABLATIONS)
    gains = {
        scene: {run: {score: found.gain([scene], run, score) for score in ("MODA", "MOTA")} for run in runs}
        for scene in found.scenes
    }
    m09_pictures.bars(gains, out / "m09-gains.png")
    kinds = {"around detections": UM, "over the image": IMAGE}
    sweeps = {
        scene: (
            {kind: {rates: one.MOTA for rates, one in found.sweep(scene, run).items()} for kind, run in kinds.items()},
            found.beside(scene, GM).scores.MOTA,
        )
        for scene in found.scenes
    }
    m09_pictures.sweeps(sweeps, out / "m09-sweep.png")


def page(
    found: Found,
    places: dict[m09_places.Job, m09_places.Outcome],
    mixtures: dict[m09_learner.Job, m09_learner.Outcome],
) -> str:
    """The page of results."""
    text = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    return text.format(
        seeds=max(found.seeds(name) for name in found.scenes),
        verdict=m09_words.verdict(found),
        findings=m09_words.findings(found),
        crossing=m09_words.crossing(places),
        gains=_gains(found),
        scores=_scores(found),
        delays=_delays(found),
        sweep=_sweep(found),
        rivals=_rivals(found),
        rates=_rates(found),
        lessons=_lessons(found),
        places=m09_places.summary(list(places), places),
        learner=m09_learner.summary(list(mixtures), mixtures),
    )


def shown(value: Interval, digits: int = 3) -> str:
    """A difference with half its interval, where there is one."""
    mean = f"{value.mean:+.{digits}f}"
    return mean if not np.isfinite(value.half) else f"{mean} ± {value.half:.{digits}f}"


def number(value: float) -> str:
    """With one digit, or a dash for none."""
    return f"{value:.1f}" if np.isfinite(value) else "–"


def _gains(found: Found) -> str:
    rows = [
        (
            group,
            run,
            *(shown(found.gain(some, run, score)) for score in SCORES),
            shown(found.gain(some, run, "false_tracks"), 0),
        )
        for group, some in found.groups().items()
        for run in RUNS
        if run != UM
    ]
    return table(("scene", "run", *(f"{score}, less UM" for score in SCORES), "false tracks, less UM"), rows)


def _scores(found: Found) -> str:
    keys = ("misses", "false_positives", "id_switches", "false_tracks")
    rows = []
    for scene in found.scenes:
        for run in RUNS:
            counts = (round(found.mean(scene, run, key)) for key in keys)
            rows.append((scene, run, *(found.mean(scene, run, score) for score in SCORES), *counts))
    header = ("scene", "run", *SCORES, "misses", "false boxes", "switches", "false tracks")
    return table(header, rows)


def _delays(found: Found) -> str:
    rows = []
    for scene in found.scenes:
        for run in RUNS:
            each = found.runs(scene, run)
            counts = (round(float(np.mean([len(getattr(one, where)) for one in each]))) for where in ("inside", "outside"))
            late = (number(found.delay(scene, run, where)) for where in ("inside", "outside"))
            live = (float(np.mean([getattr(one.live, score) for one in each])) for score in ("MOTA", "false_positives"))
            rows.append((scene, run, *late, *counts, next(live), round(next(live))))
    header = ("scene", "run", "delay inside", "outside", "people found, inside", "outside", "live MOTA", "live false boxes")
    return table(header, rows)


def _sweep(found: Found) -> str:
    rows = []
    for scene in found.scenes:
        learned = found.beside(scene, GM).scores
        for kind, run in (("around detections", UM), ("over the image", IMAGE)):
            sweep = found.sweep(scene, run)
            (births, clutter), best = max(sweep.items(), key=lambda item: item[1].MOTA)
            missed = (one.misses / one.truth_boxes for one in (best, learned))
            gap = f"{learned.MOTA - best.MOTA:+.3f}"
            rows.append((scene, kind, len(sweep), f"{births:g}", f"{clutter:g}", best.MOTA, learned.MOTA, gap, *missed))
    header = (
        "scene",
        "uniform",
        "settings",
        "births",
        "clutter",
        "best MOTA",
        "GM",
        "GM less best",
        "best misses",
        "GM misses",
    )
    return table(header, rows)


def _rivals(found: Found) -> str:
    rows = []
    for scene in found.scenes:
        for run, name in ((UM, PHD), (GM, PHD), *RIVALS):
            one = found.beside(scene, run, name)
            values = [float(getattr(one.scores, score)) for score in SCORES]
            scores = [value if np.isfinite(value) else "–" for value in values]
            rows.append((scene, name, "–" if name == "none" else run, *scores, one.scores.IDF1, one.scores.false_tracks))
    return table(("scene", "filter", "run", *SCORES, "IDF1", "false tracks"), rows)


def _rates(found: Found) -> str:
    rows = []
    for one, seconds in found.races.items():
        uniform, learned, detector = seconds
        times = (f"{1e3 * each:.2f}" for each in seconds)
        whole = (detector + learned) / (detector + uniform)
        rows.append((one.course.footage.name, one.filter, *times, f"{learned / uniform:.2f}", f"{whole:.3f}"))
    header = ("scene", "filter", "UM, ms a frame", "GM, ms a frame", "the detector", "GM over UM", "with the detector")
    return table(header, rows)


def _lessons(found: Found) -> str:
    rows = []
    for name in found.scenes:
        one = found.taught[found.course(name)]
        births, hand = (
            (f"{part.rate:.4f}", part.samples, len(part.density)) if part else ("–", "too few", "–")
            for part in (one.births, one.hand)
        )
        gains = (number(gain) for gain in one.gains)
        followed = f"{one.seen.share:.0%}" if one.seen else "–"
        clutter = (f"{one.clutter.clutter_per_frame:.2f}", one.clutter.samples, len(one.clutter.density))
        rows.append((name, *clutter, followed, *births, *hand, *gains))
    header = (
        "scene", "r̄", "boxes marked", "places", "followed", "s̄", "tracks", "places", "s̄ by hand", "marks", "places",
        "gain of false alarms", "of births", "by hand",
    )  # fmt: skip
    return table(header, rows)


if __name__ == "__main__":
    main()
