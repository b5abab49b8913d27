"""A comparison in rows: every case with every method, and every method pooled over the sequences,
with Student's t intervals over the seeds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from scipy.special import stdtrit

from phdtrack.compare.plans import Case, Run
from phdtrack.compare.runs import Comparison, RunResult
from phdtrack.errors import InputError, did_you_mean
from phdtrack.metrics import Scores, pool
from phdtrack.metrics.causes import SUMS
from phdtrack.parallel import Failed

LEVEL = 0.95
SCORES = (*(entry.name for entry in fields(Scores) if entry.repr), *SUMS)
# What there is without truth too.
OTHERS = ("tracks", "boxes_per_frame", "log_evidence", "ms")
POOLED = "all"


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean over so many ``seeds``, and half the width of its 95 % confidence interval; NaN where
    there is none.
    """

    mean: float
    half: float
    seeds: int

    @property
    def clear(self) -> bool:
        """Whether 0 lies outside."""
        return abs(self.mean) > self.half

    def __format__(self, spec: str) -> str:
        """Both with the digits of ``spec``, as ``0.553 ± 0.018``; a dash where there is no mean."""
        if math.isfinite(self.half):
            half = f" ± {self.half:{spec.lstrip('+')}}"
        else:
            half = ""
        if math.isfinite(self.mean):
            return f"{self.mean:{spec}}{half}"
        return "–"


UNKNOWN = Interval(math.nan, math.nan, 0)


def interval(values: Sequence[float]) -> Interval:
    """Mean and interval of independent values, t with n − 1 degrees of freedom; undefined (NaN)
    values make it undefined.
    """
    count = len(values)
    if count < 2:
        if count:
            return Interval(float(values[0]), math.nan, 1)
        return UNKNOWN
    error = float(np.std(values, ddof=1)) / math.sqrt(count)
    return Interval(
        float(np.mean(values)), float(stdtrit(count - 1, (1 + LEVEL) / 2)) * error, count
    )


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One method at one rate of clutter, on one case or pooled over several; in JSON by these
    names.

    Attributes
    ----------
    sequence, detections : of the case; `POOLED` where pooled over more than one.
    cases : over how many.
    clutter, filter : rate of the added clutter in boxes per frame; the method's name.
    random : whether the seeds matter. Where not, one run was enough and there is no interval.
    failed : why there are no scores; empty where there are.
    scores : means over the seeds with their intervals, by name; ``ms`` is milliseconds per frame.
    ahead : the same for the differences to the first method, seed by seed; empty for that method
        itself.
    each : the scores at every seed, in the order of the seeds.
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
        """Whether the two differ in a score by more than chance between seeds, at 95 %; where
        nothing is random, at all.

        The time ``ms`` is never the same twice: one run of each tells nothing.
        """
        found = interval(
            [mine[name] - theirs[name] for mine, theirs in zip(self.each, other.each, strict=True)]
        )
        if self.random or other.random:
            return found.clear
        return found.mean != 0 and name != "ms"


def summary(comparison: Comparison) -> tuple[Row, ...]:
    """Rows of the cases, then those pooled over the sequences of each set of detections, then over
    everything.
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


def widest(rows: Sequence[Row]) -> list[Row]:
    """The rows that pool the most."""
    most = max(row.cases for row in rows)
    return [row for row in rows if row.cases == most]


def leading(rows: Sequence[Row], name: str, *, lower: bool) -> list[Row]:
    """The row with the best mean of a score, and those that do not differ from it by more than
    chance; the best first.

    Parameters
    ----------
    rows : of one input; those without the score are left out.
    name : of the score.
    lower : whether less of it is better.
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
    """Every method at every rate on these cases."""
    plan = comparison.plan
    for rate in plan.rates:
        first: Row | None = None
        for method in plan.methods:
            found = [
                [comparison.result(Run(case, rate, method, seed)) for case in cases]
                for seed in plan.seeds
            ]
            random = rate > 0 or any(isinstance(one, RunResult) and one.drawn for one in found[0])
            failed = next(
                (one.reason for results in found for one in results if isinstance(one, Failed)), ""
            )
            if failed:
                each = []
            else:
                each = [values_of([one for one in r if isinstance(one, RunResult)]) for r in found]
            pairs = zip(each, first.each if first else (), strict=False)
            apart = [
                {name: mine[name] - theirs[name] for name in mine if name in theirs}
                for mine, theirs in pairs
            ]
            parts = (
                _intervals(each, random),
                _intervals(apart, random or (first is not None and first.random)),
                each,
            )
            row = Row(sequence, detections, len(cases), rate, method.name, random, failed, *parts)
            first = first or row
            yield row


def _intervals(each: Sequence[Mapping[str, float]], random: bool) -> dict[str, Interval]:
    """By name, over the seeds where these matter; a score undefined at one of them is left out."""
    each = each if random else each[:1]
    names = [name for name in (each[0] if each else {}) if all(name in values for values in each)]
    return {name: interval([values[name] for values in each]) for name in names}


def check_scores(names: Sequence[str]) -> tuple[str, ...]:
    """``names`` of scores as they are written; `InputError` for an unknown one."""
    known = {name.lower(): name for name in (*SCORES, *OTHERS)}
    for name in names:
        if name.lower() not in known:
            raise InputError(
                f"there is no score {name}",
                where="--scores",
                cure=did_you_mean(name, known.values()),
            )
    return tuple(known[name.lower()] for name in names)


def values_of(parts: Sequence[RunResult]) -> dict[str, float]:
    """The scores of one run, or of several pooled; those that are undefined are left out."""
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
