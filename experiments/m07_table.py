"""M07 Table 1: its methods, their runs on some cases with and without added clutter, and the claim
that the filter is ahead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.cases import cluttered
from experiments.claims import MENDED, OURS, WORDS, Claim, decided
from experiments.common import Case, ScoredCase, measure
from experiments.verdicts import all_hold, with_seeds

RATES = (0, 5, 20)
SEEDS = 3
FEW = 1
FOUR = ("MODP", "MODA", "MOTP", "MOTA")
MT = "MT"


@dataclass(frozen=True, slots=True)
class Method:
    """A filter, its preset and the changes to it; ``random`` if it draws numbers."""

    filter: str
    preset: str
    sets: tuple[str, ...] = ()
    random: bool = True


# The one change: what is not printed word by word but needed for a target to be a state.
EXTRACTION = ("extract.kind=kmeans", "extract.split_weight=1.5", "extract.merge_iou=1.0")
METHODS = {
    MT: Method("none", "m07", random=False),
    WORDS: Method("particle-phd", "m07"),
    MENDED: Method("particle-phd", "m07", EXTRACTION),
    OURS: Method("pmb", "background", random=False),
}
FORMS = (WORDS, MENDED, OURS)


@dataclass(frozen=True, slots=True)
class TableRun:
    """One run; ``rate`` false alarms a frame are added, ``seed`` is that of these and of the
    particles.
    """

    case: str
    rate: int
    method: str
    seed: int


def jobs_of(rates: Mapping[str, Sequence[int]], seeds: int) -> list[TableRun]:
    """All runs of the cases, each with its rates of added clutter; one seed if nothing is
    random.
    """
    return [
        TableRun(case, rate, method, seed)
        for case, some in rates.items()
        for rate in some
        for method, how in METHODS.items()
        for seed in range(1, (seeds if how.random or rate else 1) + 1)
    ]


def scored(run: TableRun, case: Case, how: Method) -> ScoredCase:
    """One run of a method on a case, scored."""
    with_clutter = cluttered(case, run.rate, run.seed)
    return measure(with_clutter, how.filter, run.seed, how.sets, how.preset)


@dataclass(frozen=True, slots=True, eq=False)
class TableResults:
    """All runs of the ``cases`` with these ``rates`` of added clutter."""

    scored: Mapping[TableRun, ScoredCase]
    cases: tuple[str, ...]
    rates: tuple[int, ...]

    def each(self, case: str, rate: int, method: str, score: str) -> list[float]:
        """A score of each seed; of one if nothing is random."""
        return [
            getattr(found.scores, score)
            for run, found in self.scored.items()
            if (run.case, run.rate, run.method) == (case, rate, method)
        ]

    def mean(self, case: str, rate: int, method: str, score: str) -> float:
        """A score's mean over the seeds."""
        return float(np.mean(self.each(case, rate, method, score)))

    def gaps(self, case: str, rate: int, method: str, score: str) -> list[float]:
        """A score of a method minus that of MT, seed by seed."""
        ours = self.each(case, rate, method, score)
        theirs = self.each(case, rate, MT, score)
        # MT has one run if nothing is random, and a method may have more.
        return (np.array(ours) - np.array(theirs)).tolist()

    def seeds(self, rate: int, method: str) -> int:
        """The number of seeds of a method at a rate of added clutter; 0 if nothing is random."""
        if not METHODS[method].random and rate == 0:
            return 0
        return len({run.seed for run in self.scored if (run.rate, run.method) == (rate, method)})

    def gap(self, case: str, rate: int, method: str, score: str) -> float:
        """A score of a method minus that of MT."""
        return float(np.mean(self.gaps(case, rate, method, score)))

    def cells(self, case: str, rate: int, digits: int) -> list[str]:
        """A cell for each of the `FOUR` scores, with those of all methods."""
        return [
            " / ".join(f"{self.mean(case, rate, method, score):.{digits}f}" for method in METHODS)
            for score in FOUR
        ]


def ahead(
    found: TableResults, form: str, rate: int, about: str, scores: Sequence[str] = FOUR
) -> Claim:
    """The claim of Table 1 that PHD-MT is above MT in the ``scores``.

    Parameters
    ----------
    found, form, rate : the runs, in which form, with how many false alarms a frame added.
    about : the detections, in words.
    """
    gaps = {name: [found.gaps(name, rate, form, score) for score in scores] for name in found.cases}
    means = [float(np.mean(each)) for of_case in gaps.values() for each in of_case]
    won = sum(mean > 0 for mean in means)
    middle = np.median(means[len(scores) - 1 :: len(scores)])
    figures = f"{won} of {len(means)} pairs, MOTA {middle:+.2f} in the median"
    # Without any box MODP and MOTP are not numbers, and not above MT's.
    return Claim(
        f"PHD-MT above MT in {', '.join(scores)} ({about})",
        "16 of 16" if len(scores) > 1 else "+.05, +.73, +.01, +.08",
        form,
        with_seeds(figures, found.seeds(rate, form)),
        {name: all_hold(map(decided, of_case)) for name, of_case in gaps.items()},
    )
