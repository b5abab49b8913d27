"""A choice among a few settings, judged on sequences that had no part in it.

The best of several candidates looks better than it is: chance helped it to win. So each sequence is
left out in turn, the candidate that is best on the others is chosen, and scored on the one that was
left out. The mean of these scores is what the choice is worth on sequences that nobody has seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.compare.plans import Plan
from phdtrack.compare.runs import Comparison
from phdtrack.compare.statistics import Interval, interval
from phdtrack.errors import InputError
from phdtrack.parallel import Failed
from phdtrack.types import F8

TUNED_SCORES = ("HOTA", "MOTA", "IDF1")
"""The scores that can be chosen by."""
DEFAULT = "default"
_NO_TRUTH = "Every sequence needs them: gt/gt.txt in its folder, or --truth."


class Candidate(NamedTuple):
    """Settings to choose among: a name, settings as a variant of `phdtrack compare` has them, and
    the kind of sequence that they are meant for.
    """

    name: str
    sets: str
    meant_for: str


CANDIDATES = (
    Candidate("agile", "motion.acceleration=0.01", "objects that turn and brake at once"),
    Candidate("calm", "motion.acceleration=0.0025", "objects that move evenly"),
    Candidate("loose-boxes", "sensor.box_noise=0.2", "boxes that change from frame to frame"),
    Candidate("exact-boxes", "sensor.box_noise=0.1", "boxes that fit tightly"),
    Candidate("hidden-longer", "filter.mean_occluded_time=1.0", "long occlusions"),
    Candidate("never-hidden", "filter.mean_visible_time=0.0", "views without occlusion"),
    Candidate("scores-unused", "detection_scores.kind=none", "scores that tell nothing"),
    Candidate("mot15", "preset=mot15", "weak detectors of pedestrians"),
)
"""The settings that are tried besides the default: few, because each more makes the choice
riskier."""


@dataclass(frozen=True, slots=True)
class Fold:
    """A sequence that was left out.

    Attributes
    ----------
    sequence : its name.
    chosen : the best candidate on the other sequences.
    score, default : the scores of the chosen one, and of the default, on it.
    """

    sequence: str
    chosen: str
    score: float
    default: float

    @property
    def gain(self) -> float:
        """The gain of the choice against the default; negative for a loss."""
        return self.score - self.default


@dataclass(frozen=True, slots=True)
class Tuning:
    """The scores of all candidates, and what choosing among them is worth.

    Attributes
    ----------
    score : name of the score.
    sequences, names : of the sequences, and of the candidates; the default comes first.
    table : (candidates, sequences) scores.
    folds : each sequence, left out.
    """

    score: str
    sequences: tuple[str, ...]
    names: tuple[str, ...]
    table: F8
    folds: tuple[Fold, ...]

    @property
    def best(self) -> str:
        """The candidate with the highest mean over all sequences."""
        return self.names[_best(self.table)]

    @property
    def chosen(self) -> str:
        """The candidate to use: the best one if choosing gains anything on sequences that are left
        out, else the default.
        """
        return self.best if self.gain.mean > 0 else DEFAULT

    @property
    def gain(self) -> Interval:
        """The mean gain on sequences that are left out, with its interval over sequences."""
        return interval([fold.gain for fold in self.folds])

    @property
    def apparent(self) -> float:
        """The gain of the best candidate on the sequences that it was chosen on."""
        means = self.table.mean(axis=1)
        return float(means.max() - means[0])

    @property
    def worst(self) -> Fold:
        """The sequence, left out, on which the choice lost most or gained least."""
        return min(self.folds, key=lambda fold: fold.gain)

    def mean(self, name: str) -> Interval:
        """The mean of a candidate, with its interval over sequences."""
        return interval(self.table[self.names.index(name)].tolist())

    def ahead(self, name: str) -> Interval:
        """The mean difference of a candidate to the default, sequence by sequence."""
        return interval((self.table[self.names.index(name)] - self.table[0]).tolist())

    def times(self, name: str) -> int:
        """How often a candidate was chosen, with one sequence left out."""
        return sum(fold.chosen == name for fold in self.folds)


def check_sequences(sequences: Sequence[str]) -> None:
    """Raise `InputError` unless there are two sequences or more.

    Parameters
    ----------
    sequences : their names.
    """
    if len(dict.fromkeys(sequences)) < 2:
        raise InputError(
            "one sequence is not enough to choose settings: nothing would show how they do on"
            " another one",
            where="the sequences",
            cure="Name two or more; from five on the result tells something.",
        )


def check_truth(plan: Plan) -> None:
    """Raise `InputError` unless every sequence has annotated objects.

    Parameters
    ----------
    plan : the sequences.
    """
    for case in plan.cases:
        if case.truth is None:
            raise InputError("there are no annotated objects", where=case.name, cure=_NO_TRUTH)


def tuning(comparison: Comparison, score: str) -> Tuning:
    """The worth of choosing among the methods of a comparison, of which the first is the default.

    Parameters
    ----------
    comparison : of sequences with truth.
    score : one of `TUNED_SCORES`.

    Raises
    ------
    InputError : a run failed, or a sequence has no truth, or nothing in it.
    """
    values = dict[tuple[str, str], list[float]]()
    for run in comparison.plan.runs:
        result = comparison.result(run)
        if isinstance(result, Failed):
            raise InputError(f"the run failed: {result.reason}", where=str(run))
        scores = result.scores
        value = math.nan if scores is None else float(getattr(scores, score))
        if not math.isfinite(value):
            raise InputError(
                f"there is no {score}",
                where=str(run),
                cure=_NO_TRUTH,
            )
        values.setdefault((run.method.name, run.case.sequence), []).append(value)
    sequences = tuple(dict.fromkeys(case.sequence for case in comparison.plan.cases))
    check_sequences(sequences)
    names = tuple(method.name for method in comparison.plan.methods)
    means = {key: float(np.mean(each)) for key, each in values.items()}
    return of_scores(score, sequences, names, means)


def of_scores(
    score: str,
    sequences: Sequence[str],
    names: Sequence[str],
    values: Mapping[tuple[str, str], float],
) -> Tuning:
    """The worth of choosing, from scores.

    Parameters
    ----------
    score : its name.
    sequences, names : of sequences and candidates; the default comes first.
    values : the score by candidate and sequence; higher is better.
    """
    table = np.array([[values[name, sequence] for sequence in sequences] for name in names])
    folds = list[Fold]()
    for k, sequence in enumerate(sequences):
        best = _best(np.delete(table, k, axis=1))
        folds.append(Fold(sequence, names[best], float(table[best, k]), float(table[0, k])))
    return Tuning(score, tuple(sequences), tuple(names), table, tuple(folds))


def _best(table: F8) -> int:
    """The row with the highest mean; of equal ones the first, so that the default stays."""
    return int(np.argmax(table.mean(axis=1)))
