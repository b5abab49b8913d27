"""A comparison in rows: every cell, and every method pooled over the sequences, with Student's t intervals over the
seeds."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from scipy.special import stdtrit

from phdtrack.compare.plans import Case, Cell, Method
from phdtrack.compare.runs import Comparison, Failed
from phdtrack.compare.store import RunResult
from phdtrack.errors import InputError
from phdtrack.metrics import Scores, pool

LEVEL = 0.95
SCORES = tuple(entry.name for entry in fields(Scores) if entry.name not in ("counts", "settings"))
# What there is without truth too.
OTHERS = ("tracks", "boxes_per_frame", "ms")
SHOWN = ("MODA", "MOTA", "IDF1", "HOTA", "id_switches")
POOLED = "all"


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean over ``count`` values, and half the width of its 95 % confidence interval; NaN where there is none."""

    mean: float
    half: float
    count: int

    @property
    def clear(self) -> bool:
        """Whether 0 lies outside."""
        return math.isfinite(self.half) and abs(self.mean) > self.half

    @property
    def low(self) -> float:
        """The lower end; the mean itself where there is no interval."""
        return self.mean - self.half if math.isfinite(self.half) else self.mean

    @property
    def high(self) -> float:
        """The upper end; the mean itself where there is no interval."""
        return self.mean + self.half if math.isfinite(self.half) else self.mean


def interval(values: Sequence[float]) -> Interval:
    """Mean and interval of independent values, t with n − 1 degrees of freedom; undefined (NaN) values make it undefined."""
    each = np.array(values, np.float64)
    count = len(each)
    if count < 2:
        return Interval(float(each.mean()) if count else math.nan, math.nan, count)
    error = float(each.std(ddof=1)) / math.sqrt(count)
    return Interval(float(each.mean()), float(stdtrit(count - 1, (1 + LEVEL) / 2)) * error, count)


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One method at one rate of clutter, on one case or pooled over several.

    Attributes
    ----------
    sequence, detections : of the case; `POOLED` where pooled over more than one.
    cases : over how many.
    rate, method : see `Cell`.
    random : whether the seeds matter. Where not, one run was enough and there is no interval.
    values : means over the seeds with their intervals, by the names of scores; ``ms`` is milliseconds per frame.
    ahead : the same for the differences to the first method, seed by seed; empty for that method itself.
    each : the scores at every seed, in the order of the seeds.
    failed : why there are no values; empty where there are.
    """

    sequence: str
    detections: str
    cases: int
    rate: float
    method: str
    random: bool = False
    values: Mapping[str, Interval] = field(default_factory=dict)
    ahead: Mapping[str, Interval] = field(default_factory=dict)
    each: Sequence[Mapping[str, float]] = ()
    failed: str = ""

    @property
    def pooled(self) -> bool:
        """Over more than one sequence."""
        return self.cases > 1

    def differs(self, other: Row, name: str) -> bool:
        """Whether the two differ in a score by more than chance between seeds, at 95 %; where nothing is random, at all."""
        found = interval([mine[name] - theirs[name] for mine, theirs in zip(self.each, other.each, strict=True)])
        return found.clear if self.random or other.random else found.mean != 0


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """``rows`` of the cells, then those pooled over the sequences of each set of detections, then over everything."""

    rows: tuple[Row, ...]

    @property
    def widest(self) -> tuple[Row, ...]:
        """The rows that pool the most."""
        most = max(row.cases for row in self.rows)
        return tuple(row for row in self.rows if row.cases == most)


def summary(comparison: Comparison) -> Summary:
    """The rows of a comparison."""
    plan = comparison.plan
    groups: list[tuple[str, str, tuple[Case, ...]]] = [
        (case.sequence.name, case.detections.name, (case,)) for case in plan.cases
    ]
    names = list(dict.fromkeys(case.detections.name for case in plan.cases))
    for name in names:
        cases = tuple(case for case in plan.cases if case.detections.name == name)
        if 1 < len(cases) < len(plan.cases):
            groups.append((POOLED, name, cases))
    if len(plan.cases) > 1:
        groups.append((POOLED, names[0] if len(names) == 1 else POOLED, plan.cases))
    rows = []
    for sequence, detections, cases in groups:
        for rate in plan.rates:
            seeds = [_scores_by_seed(comparison, cases, rate, method) for method in plan.methods]
            for method, own in zip(plan.methods, seeds, strict=True):
                first = seeds[0] if method is not plan.methods[0] and own.scores and seeds[0].scores else None
                ahead = {} if first is None else own.intervals(first)
                where = (sequence, detections, len(cases), rate, method.name)
                rows.append(Row(*where, own.random, own.intervals(), ahead, own.scores, own.failed))
    return Summary(tuple(rows))


def check_scores(names: Sequence[str]) -> tuple[str, ...]:
    """``names`` of scores as they are written; `InputError` for an unknown one."""
    known = {name.lower(): name for name in (*SCORES, *OTHERS)}
    for name in names:
        if name.lower() not in known:
            close = difflib.get_close_matches(name.lower(), known, 1)
            cure = f"Did you mean {known[close[0]]}?" if close else f"There are {', '.join(known.values())}."
            raise InputError(f"there is no score {name}", where="--scores", cure=cure)
    return tuple(known[name.lower()] for name in names)


def values_of(parts: Sequence[RunResult]) -> dict[str, float]:
    """The scores of one run, or of several pooled; those that are undefined are left out."""
    frames = sum(part.frames for part in parts)
    out: dict[str, float] = {}
    scores = [part.scores for part in parts if part.scores is not None]
    if scores:
        pooled = scores[0] if len(scores) == 1 else pool(scores)
        out = {name: float(value) for name, value in pooled.as_dict().items() if value is not None}
    out["tracks"] = sum(part.tracks for part in parts)
    if frames:
        out["boxes_per_frame"] = sum(part.rows for part in parts) / frames
        out["ms"] = 1000 * sum(part.seconds * part.frames for part in parts) / frames
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Seeds:
    """The scores of a method at every seed, pooled over cases, and whether the seeds matter; without scores: why."""

    scores: list[dict[str, float]]
    random: bool
    failed: str = ""

    def intervals(self, minus: _Seeds | None = None) -> dict[str, Interval]:
        """By name, over the seeds, of the scores or of their differences; a score undefined at one of them is left out."""
        each = self.scores
        if minus is not None:
            pairs = zip(each, minus.scores, strict=True)
            each = [{name: mine[name] - theirs[name] for name in mine if name in theirs} for mine, theirs in pairs]
        if not (self.random or (minus is not None and minus.random)):
            each = each[:1]
        names = [name for name in (each[0] if each else {}) if all(name in values for values in each)]
        return {name: interval([values[name] for values in each]) for name in names}


def _scores_by_seed(comparison: Comparison, cases: Sequence[Case], rate: float, method: Method) -> _Seeds:
    cells, seeds = [Cell(case, rate, method) for case in cases], comparison.plan.seeds
    firsts = [comparison.result(cell, seeds[0]) for cell in cells]
    random = rate > 0 or any(isinstance(first, RunResult) and first.drawn for first in firsts)
    scores = []
    for seed in seeds:
        results = [comparison.result(cell, seed) for cell in cells]
        for result in results:
            if isinstance(result, Failed):
                return _Seeds([], random, result.reason)
        scores.append(values_of([result for result in results if isinstance(result, RunResult)]))
    return _Seeds(scores, random)
