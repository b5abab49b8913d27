"""Statistics of a comparison: every method on each case and pooled over the sequences, with
Student's t intervals over the seeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from scipy.special import stdtrit

from phdtrack.compare.plans import Case, Run
from phdtrack.compare.runs import ComparedRun, Comparison
from phdtrack.errors import InputError, did_you_mean
from phdtrack.metrics import Scores, pool
from phdtrack.metrics.causes import SUMS
from phdtrack.parallel import Failed

LEVEL = 0.95
SCORES = (*(entry.name for entry in fields(Scores) if entry.repr), *SUMS)
# Available without truth.
OTHERS = ("tracks", "boxes_per_frame", "log_evidence", "ms")
POOLED = "all"
MEAN = "mean"


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean over ``seeds``, or as many sequences, and half the width of its 95 % confidence
    interval; NaN if undefined.
    """

    mean: float
    half: float
    seeds: int

    @property
    def clear(self) -> bool:
        """True if 0 lies outside the interval."""
        return abs(self.mean) > self.half

    def __format__(self, spec: str) -> str:
        """Mean and interval with the digits of ``spec``, such as ``0.553 ± 0.018``; a dash without
        a mean.
        """
        if not math.isfinite(self.mean):
            return "–"
        if not math.isfinite(self.half):
            return f"{self.mean:{spec}}"
        return f"{self.mean:{spec}} ± {self.half:{spec.lstrip('+')}}"


UNKNOWN = Interval(math.nan, math.nan, 0)


def interval(values: Sequence[float]) -> Interval:
    """Mean and interval of independent values, by Student's t with n − 1 degrees of freedom; NaN if
    one of them is NaN.
    """
    count = len(values)
    if count == 0:
        return UNKNOWN
    if count == 1:
        return Interval(float(values[0]), math.nan, 1)
    error = float(np.std(values, ddof=1)) / math.sqrt(count)
    half = float(stdtrit(count - 1, (1 + LEVEL) / 2)) * error
    return Interval(float(np.mean(values)), half, count)


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One method at one rate of clutter, on one case or pooled over several; JSON uses these names.

    Attributes
    ----------
    sequence, detections : of the case; `POOLED` if pooled over several.
    cases : number of cases.
    clutter, filter : rate of the added clutter in boxes per frame; the method's name.
    random : True if the seeds matter; else one run is enough, and there is no interval.
    failed : why there are no scores; empty if there are.
    scores : means over the seeds with their intervals, by name; ``ms`` is milliseconds per frame.
    ahead : means and intervals of the differences to the first method, seed by seed; empty for the
        first method.
    each : the scores for every seed, in the order of the seeds.
    """

    sequence: str
    detections: str
    cases: int
    clutter: float
    filter: str
    random: bool = False
    failed: str = ""
    scores: Mapping[str, Interval] = field(default_factory=dict)
    ahead: Mapping[str, Interval] = field(default_factory=dict)
    each: Sequence[Mapping[str, float]] = field(default=(), repr=False)

    def differs(self, other: Row, name: str) -> bool:
        """Return True if the scores differ significantly over the seeds, at 95 %; if nothing is
        random, if they differ at all.

        The time ``ms`` varies between runs, so single runs never differ in it.

        Parameters
        ----------
        other : another method's row of the same case.
        name : of the score.
        """
        difference = interval(
            [mine[name] - theirs[name] for mine, theirs in zip(self.each, other.each, strict=True)]
        )
        if self.random or other.random:
            return difference.clear
        return difference.mean != 0 and name != "ms"


def summary(comparison: Comparison) -> tuple[Row, ...]:
    """Rows for each case, then pooled over the sequences of each set of detections, then pooled
    over all cases.

    Parameters
    ----------
    comparison : the result of `run`.

    Returns
    -------
    The rows: means over the seeds, with confidence intervals where there are several.
    """
    cases = comparison.plan.cases
    groups: list[tuple[str, str, Sequence[Case]]] = [
        (case.sequence, case.detections, [case]) for case in cases
    ]
    sets = {name: [case for case in cases if case.detections == name] for _, name, _ in groups}
    groups += [(POOLED, name, own) for name, own in sets.items() if len(own) > 1]
    if len(sets) > 1:
        groups.append((POOLED, POOLED, cases))
    return tuple(row for group in groups for row in _rows(comparison, *group))


def over_sequences(rows: Sequence[Row]) -> tuple[Row, ...]:
    """The mean over the sequences of each set of detections, each sequence with the same weight,
    with intervals over the sequences: how far the scores hold on others like them. None for a set
    with one sequence.

    Parameters
    ----------
    rows : of a `summary`.

    Returns
    -------
    Rows whose sequence is `MEAN`, and whose ``each`` has the scores of each sequence.
    """
    single = [row for row in rows if row.cases == 1]
    found = list[Row]()
    for place in dict.fromkeys((row.detections, row.clutter) for row in single):
        own = [row for row in single if (row.detections, row.clutter) == place]
        sequences = len({row.sequence for row in own})
        if sequences < 2:
            continue
        for name in dict.fromkeys(row.filter for row in own):
            mine = [row for row in own if row.filter == name]
            failed = next((row.failed for row in mine if row.failed), "")
            each = [] if failed else [_means(row.scores) for row in mine]
            differences = [] if failed else [_means(row.ahead) for row in mine]
            found.append(
                Row(
                    MEAN,
                    place[0],
                    sequences,
                    place[1],
                    name,
                    True,
                    failed,
                    _intervals(each, random=True),
                    _intervals(differences, random=True),
                    each,
                )
            )
    return tuple(found)


def _means(scores: Mapping[str, Interval]) -> dict[str, float]:
    """The means of scores that are known."""
    return {name: value.mean for name, value in scores.items() if math.isfinite(value.mean)}


def widest(rows: Sequence[Row]) -> list[Row]:
    """The rows that pool the most.

    Parameters
    ----------
    rows : of a `summary`.

    Returns
    -------
    Those of the most cases.
    """
    most = max(row.cases for row in rows)
    return [row for row in rows if row.cases == most]


def leading(rows: Sequence[Row], name: str, *, lower: bool) -> list[Row]:
    """The row with the best mean of a score, then those that do not differ from it significantly.

    Parameters
    ----------
    rows : of one input; those without the score are left out.
    name : of the score.
    lower : True if lower is better.
    """
    known = sorted(
        (row for row in rows if name in row.scores),
        key=lambda row: row.scores[name].mean,
        reverse=not lower,
    )
    return [row for row in known if row is known[0] or not row.differs(known[0], name)]


def _rows(
    comparison: Comparison, sequence: str, detections: str, cases: Sequence[Case]
) -> Iterator[Row]:
    """Yield a row for every method at every rate on these cases."""
    plan = comparison.plan
    for rate in plan.rates:
        first: Row | None = None
        for method in plan.methods:
            results = list[list[ComparedRun]]()
            failed = ""
            for seed in plan.seeds:
                results.append([])
                for case in cases:
                    result = comparison.result(Run(case, rate, method, seed))
                    if isinstance(result, Failed):
                        failed = failed or result.reason
                    else:
                        results[-1].append(result)
            random = rate > 0 or any(result.drawn for result in results[0])
            each = [] if failed else [values_of(of_seed) for of_seed in results]
            differences = list[Mapping[str, float]]()
            if first is not None:
                for mine, theirs in zip(each, first.each, strict=False):
                    common = [name for name in mine if name in theirs]
                    differences.append({name: mine[name] - theirs[name] for name in common})
            row = Row(
                sequence,
                detections,
                len(cases),
                rate,
                method.name,
                random,
                failed,
                _intervals(each, random),
                _intervals(differences, random or (first is not None and first.random)),
                each,
            )
            first = first or row
            yield row


def _intervals(each: Sequence[Mapping[str, float]], random: bool) -> dict[str, Interval]:
    """The interval of each score over the seeds, or of the first seed unless ``random``; scores
    undefined for a seed are left out.
    """
    if not each:
        return {}
    if not random:
        each = each[:1]
    names = [name for name in each[0] if all(name in values for values in each)]
    return {name: interval([values[name] for values in each]) for name in names}


def check_scores(names: Sequence[str]) -> tuple[str, ...]:
    """The ``names`` of scores in their usual case. Raises `InputError` for an unknown one.

    Parameters
    ----------
    names : of scores, in any case.

    Returns
    -------
    The names as they are written, in the same order.
    """
    known = {name.lower(): name for name in (*SCORES, *OTHERS)}
    for name in names:
        if name.lower() not in known:
            raise InputError(
                f"there is no score {name}",
                where="--scores",
                cure=did_you_mean(name, known.values()),
            )
    return tuple(known[name.lower()] for name in names)


def values_of(parts: Sequence[ComparedRun]) -> dict[str, float]:
    """The scores of one run, or pooled over several; undefined ones are left out."""
    out = dict[str, float]()
    frames = sum(part.frames for part in parts)
    scores = [part.scores for part in parts if part.scores is not None]
    if scores:
        out = {
            name: float(value)
            for name, value in pool(scores).as_dict().items()
            if value is not None
        }
        out |= {name: sum(part.errors.get(name, 0) for part in parts) for name in SUMS}
    out["tracks"] = sum(part.tracks for part in parts)
    if frames:
        out["boxes_per_frame"] = sum(part.rows for part in parts) / frames
        known = [
            (part.log_evidence * part.frames, part.frames)
            for part in parts
            if part.log_evidence is not None
        ]
        if len(known) == len(parts):
            out["log_evidence"] = sum(total for total, _ in known) / frames
        out["ms"] = 1000 * sum(part.seconds * part.frames for part in parts) / frames
    return out
