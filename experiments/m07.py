"""M07 Table 1, word by word and as one must; then the default settings: PHD against no filter and
against multiple hypotheses, on the same detections.

The paper's preset runs on change detection at QCIF (`m07_qcif`) and on detections of other
detectors (`m07_printed`). Default settings run on real detections, detections simulated from real
truth, and simulated scenes, as detected and with Poisson clutter added. All methods get the same
detections at the same seed. `none` is M07's MT and M09's DA.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments import m07_printed, m07_qcif
from experiments.cases import (
    CASES,
    HELD_OUT,
    MADE,
    PLACES,
    RENDERED,
    SCENES,
    Named,
    cluttered,
    drawn,
    short,
)
from experiments.claims import Claim
from experiments.common import (
    Options,
    ScoredCase,
    filled,
    in_parallel,
    measure,
    table,
    with_interval,
    write_parts,
)
from phdtrack.compare.statistics import Interval, interval
from phdtrack.metrics import Scores, pool

RATES = (0, 5, 20)
SEEDS = 3
FEW = 1
PHD = "particle-phd"
RIVALS = ("none", "mht", "mht, M09")
# Name, filter and preset.
METHODS = {
    "none": ("none", ""),
    "mht": ("mht", ""),
    "mht, M09": ("mht", "m09-mht"),
    PHD: (PHD, ""),
    "gm-phd": ("gm-phd", ""),
}
PHDS = (PHD, "gm-phd")
RANDOM = (PHD,)
GROUPS: dict[str, tuple[Named, ...]] = {
    "real detections": CASES,
    "held out": HELD_OUT,
    "made of real truth": MADE,
    "simulated scenes": SCENES,
}
# False alarms that are not Poisson clutter: separate tables, without added clutter.
FIRING: dict[str, tuple[Named, ...]] = {"places that fire": PLACES}
# The rendered scenes, too: their detector has its own false alarms.
VIDEOS: dict[str, tuple[Named, ...]] = {"rendered scenes": RENDERED}
ERRORS = {"misses": "misses", "false boxes": "false_positives", "switches": "id_switches"}
FOUR = ("MODA", "MODP", "MOTA", "MOTP")


@dataclass(frozen=True, slots=True)
class MethodRun:
    """One run; ``seed`` draws detections, clutter and particles."""

    case: Named
    rate: int
    method: str
    seed: int


def work(job: MethodRun) -> ScoredCase:
    """One run, scored."""
    kind, preset = METHODS[job.method]
    return measure(
        cluttered(drawn(job.case, job.seed), job.rate, job.seed), kind, job.seed, preset=preset
    )


@dataclass(frozen=True, slots=True, eq=False)
class MethodScores:
    """All runs; ``groups`` of cases, ``rates`` of clutter and number of ``seeds``."""

    results: dict[MethodRun, ScoredCase]
    groups: dict[str, tuple[Named, ...]]
    rates: tuple[int, ...]
    seeds: int

    @property
    def cases(self) -> tuple[Named, ...]:
        """The cases of all groups."""
        return tuple(case for cases in self.groups.values() for case in cases)

    def runs(self, case: Named, rate: int, method: str) -> list[ScoredCase]:
        """One result for each seed; the same one if nothing is random."""
        return [
            self.results[MethodRun(case, rate, method, seed_of(case, rate, method, k))]
            for k in range(1, self.seeds + 1)
        ]

    def mean(self, case: Named, rate: int, method: str, score: str) -> float:
        """A score's mean over the seeds."""
        return float(np.mean([getattr(run.scores, score) for run in self.runs(case, rate, method)]))

    def pooled(self, cases: Sequence[Named], rate: int, method: str) -> list[Scores]:
        """The scores over all ``cases``, for each seed."""
        runs = [self.runs(case, rate, method) for case in cases]
        return [pool([each[k].scores for each in runs]) for k in range(self.seeds)]


def seed_of(case: Named, rate: int, method: str, seed: int) -> int:
    """The seed whose run stands for ``seed``: the first one if neither detections, clutter nor the
    method are random.
    """
    random = method in RANDOM or rate > 0 or case in MADE + SCENES + PLACES + RENDERED
    return seed if random else 1


def jobs_of(
    groups: dict[str, tuple[Named, ...]], rates: Sequence[int], seeds: int
) -> list[MethodRun]:
    """All runs, each once."""
    runs = (
        MethodRun(case, rate, method, seed_of(case, rate, method, seed))
        for cases in groups.values()
        for case in cases
        for rate in rates
        for method in METHODS
        for seed in range(1, seeds + 1)
    )
    return list(dict.fromkeys(runs))


# In the order of the page. The last one takes hours, and is made only if it is asked for.
PARTS = ("qcif", "others", "defaults")


def main(options: Options) -> Path:
    """Make the parts that were asked for and write m07.md."""
    path = options.folder / "m07.md"
    for part in options.parts(PARTS, () if options.quick else ("defaults",)):
        text, claims = MAKERS[part](options)
        path = write_parts("m07", options, PARTS, {part: text}, claims)
    return path


def qcif(options: Options) -> tuple[str, list[Claim]]:
    """Table 1 on change detection at QCIF."""
    small = m07_qcif.run_all(options)
    claims = m07_qcif.claims(small)
    return m07_qcif.section(small, claims, options), claims


def others(options: Options) -> tuple[str, list[Claim]]:
    """Table 1 on the boxes of other detectors."""
    found = m07_printed.run_all(options)
    claims = m07_printed.claims(found)
    return m07_printed.section(found, claims, options), claims


def defaults(options: Options) -> tuple[str, list[Claim]]:
    """The comparison of filters with default settings."""
    seeds = options.number(SEEDS, FEW)
    rates = RATES[::2] if options.quick else RATES
    groups = {"real detections": short(CASES)[:1]} if options.quick else GROUPS
    firing = {"places that fire": PLACES[1:2]} if options.quick else FIRING
    videos = {"rendered scenes": RENDERED[:1]} if options.quick else VIDEOS
    once = jobs_of(firing, rates[:1], seeds) + jobs_of(videos, rates[::2], seeds)
    jobs = jobs_of(groups, rates, seeds) + once
    results = dict(zip(jobs, in_parallel(work, jobs, "m07, defaults", options), strict=True))
    found = MethodScores(results, groups, rates, seeds)
    places = MethodScores(results, firing, rates[:1], seeds)
    of_videos = MethodScores(results, videos, rates[::2], seeds)
    return filled("m07_defaults", **figures(found, places, of_videos)), []


MAKERS: dict[str, Callable[[Options], tuple[str, list[Claim]]]] = {
    "qcif": qcif,
    "others": others,
    "defaults": defaults,
}


def figures(found: MethodScores, places: MethodScores, videos: MethodScores) -> dict[str, object]:
    """The values of the page's placeholders; ``places``: the scenes with persistent clutter;
    ``videos``: the rendered ones.
    """
    heavy = found.rates[-1]
    first = found.groups["real detections"]
    none, phd = (_spread(found.pooled(first, heavy, method), "MOTA") for method in ("none", PHD))
    pooled = (
        "cases",
        "clutter added",
        "method",
        *FOUR,
        "IDF1",
        "HOTA",
        "misses",
        "false boxes",
        "switches",
        "false tracks",
    )
    each = ("case", "method", *FOUR, "IDF1", "HOTA", "switches", "delay", "false tracks", "ms")
    return {
        "seeds": found.seeds,
        "heavy": heavy,
        "none": none,
        "phd": phd,
        "ahead": _ahead_table(found),
        "pooled": table(pooled, _pooled(found)),
        "places": table(pooled, _pooled(places)),
        "videos_ahead": _ahead_table(videos),
        "videos": table(pooled, _pooled(videos)),
        "videos_gaps": _gaps_table(videos),
        "gaps": _gaps_table(found),
        "natural": table(each, _natural(found)),
        "cluttered": "\n".join(_with_clutter(found, rate) for rate in found.rates[1:]),
        "behind": _behind_table(found),
    }


def leads(
    found: MethodScores,
    case: Named,
    rate: int,
    rival: str,
    phd: str = PHD,
    scores: Sequence[str] = ("MODA", "MOTA"),
) -> bool:
    """True if a PHD filter is ahead of a rival in all of the ``scores``, by their means over the
    seeds.
    """
    return all(
        found.mean(case, rate, phd, score) > found.mean(case, rate, rival, score)
        for score in scores
    )


def gap(
    found: MethodScores, cases: Sequence[Named], rate: int, phd: str, rival: str, score: str
) -> Interval:
    """A pooled score of a PHD filter minus that of a rival, seed by seed."""
    ours = found.pooled(cases, rate, phd)
    theirs = found.pooled(cases, rate, rival)
    return interval(
        [getattr(a, score) - getattr(b, score) for a, b in zip(ours, theirs, strict=True)]
    )


def _groups(found: MethodScores) -> dict[str, tuple[Named, ...]]:
    return found.groups if len(found.groups) == 1 else {**found.groups, "all": found.cases}


def _ahead_table(found: MethodScores) -> str:
    over = (f"ahead of {rival}" for rival in (*RIVALS, "all", "none in all four"))
    return table(
        ("filter", "cases", "clutter added", "of", *over),
        [row for phd in PHDS for row in _ahead(found, phd)],
    )


def _ahead(found: MethodScores, phd: str) -> list[tuple[object, ...]]:
    """The number of cases in which a PHD filter leads."""
    rows: list[tuple[object, ...]] = []
    for name, cases in _groups(found).items():
        for rate in found.rates:
            over = {
                rival: [leads(found, case, rate, rival, phd) for case in cases] for rival in RIVALS
            }
            four = sum(leads(found, case, rate, "none", phd, FOUR) for case in cases)
            every = sum(all(each) for each in zip(*over.values(), strict=True))
            rows.append(
                (phd, name, rate, len(cases), *(sum(each) for each in over.values()), every, four)
            )
    return rows


def _pooled(found: MethodScores) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for name, cases in _groups(found).items():
        for rate in found.rates:
            for method in METHODS:
                scores = found.pooled(cases, rate, method)
                boxes = np.mean([one.truth_boxes for one in scores])
                per_box = (
                    f"{np.mean([getattr(one, key) for one in scores]) / boxes:.3f}"
                    for key in ERRORS.values()
                )
                false = f"{np.mean([one.false_tracks for one in scores]):.0f}"
                rows.append(
                    (
                        name,
                        rate,
                        method,
                        *(_spread(scores, key) for key in (*FOUR, "IDF1", "HOTA")),
                        *per_box,
                        false,
                    )
                )
    return rows


def _spread(scores: Sequence[Scores], key: str) -> str:
    return with_interval(interval([getattr(one, key) for one in scores]))


def _gaps_table(found: MethodScores) -> str:
    scores = (f"{score}, less {rival}" for rival in RIVALS for score in ("MODA", "MOTA"))
    return table(
        ("filter", "cases", "clutter added", *scores),
        [row for phd in PHDS for row in _gaps(found, phd)],
    )


def _gaps(found: MethodScores, phd: str) -> list[tuple[object, ...]]:
    """Pooled scores of a PHD filter minus those of its rivals."""
    rows: list[tuple[object, ...]] = []
    for name, cases in _groups(found).items():
        for rate in found.rates:
            gaps = (
                gap(found, cases, rate, phd, rival, score)
                for rival in RIVALS
                for score in ("MODA", "MOTA")
            )
            rows.append((phd, name, rate, *(with_interval(one, sign="+") for one in gaps)))
    return rows


def _natural(found: MethodScores) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for case in found.cases:
        for method in METHODS:
            runs = found.runs(case, 0, method)
            scores = [_spread([run.scores for run in runs], key) for key in (*FOUR, "IDF1", "HOTA")]
            switches = round(found.mean(case, 0, method, "id_switches"))
            late = [run.delay for run in runs if np.isfinite(run.delay)]
            false = f"{found.mean(case, 0, method, 'false_tracks'):.1f}"
            ms = f"{1e3 * np.median([run.seconds_per_frame for run in runs]):.1f}"
            rows.append(
                (
                    " ".join(case),
                    method,
                    *scores,
                    switches,
                    f"{np.mean(late):.1f}" if late else "–",
                    false,
                    ms,
                )
            )
    return rows


def _with_clutter(found: MethodScores, rate: int) -> str:
    """MODA and MOTA of all cases at a rate of added clutter."""
    header = ("case", *(f"{score} {method}" for score in ("MODA", "MOTA") for method in METHODS))
    rows = [
        (
            " ".join(case),
            *(
                _spread([run.scores for run in found.runs(case, rate, method)], score)
                for score in ("MODA", "MOTA")
                for method in METHODS
            ),
        )
        for case in found.cases
    ]
    return f"### {rate} false alarms per frame added\n\n{table(header, rows)}"


def _behind_table(found: MethodScores) -> str:
    """The cases in which a rival is ahead in MODA or MOTA, and the kind of error."""
    rows = [
        (phd, " ".join(case), rate, rival, *_errors(found, case, rate, rival, phd))
        for phd in PHDS
        for case in found.cases
        for rate in found.rates
        for rival in RIVALS
        if not leads(found, case, rate, rival, phd)
    ]
    header = (
        "filter",
        "case",
        "clutter added",
        "behind",
        "MODA",
        "MOTA",
        "misses",
        "false boxes",
        "switches",
        "most by",
    )
    return table(header, rows)


def _errors(
    found: MethodScores, case: Named, rate: int, rival: str, phd: str = PHD
) -> tuple[object, ...]:
    """Differences in MODA and MOTA, and in errors per annotated box, whose sum is the negative
    difference in MOTA.
    """
    gap = [
        found.mean(case, rate, phd, score) - found.mean(case, rate, rival, score)
        for score in ("MODA", "MOTA")
    ]
    boxes = found.mean(case, rate, phd, "truth_boxes")
    more = {
        name: (found.mean(case, rate, phd, key) - found.mean(case, rate, rival, key)) / boxes
        for name, key in ERRORS.items()
    }
    worst = max(more, key=lambda name: more[name])
    return (
        *(f"{value:+.3f}" for value in (*gap, *more.values())),
        worst if more[worst] > 0 else "–",
    )
