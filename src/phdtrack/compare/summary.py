"""A comparison in rows: every cell, and every method pooled over the sequences, with intervals over the seeds."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from phdtrack.compare.engine import Comparison
from phdtrack.compare.parallel import Failed
from phdtrack.compare.records import Case, Cell, Method
from phdtrack.compare.statistics import Interval, interval
from phdtrack.compare.store import Outcome
from phdtrack.errors import InputError
from phdtrack.metrics import Scores, pool

SCORES = tuple(entry.name for entry in fields(Scores) if entry.name not in ("counts", "settings"))
# What there is without truth too.
OTHERS = ("tracks", "boxes_per_frame", "ms")
SHOWN = ("MODA", "MOTA", "IDF1", "HOTA", "id_switches")
POOLED = "all"


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One method at one rate of clutter, on one case or pooled over several.

    Attributes
    ----------
    sequence, detections : of the case; `POOLED` where pooled over more than one.
    cases : over how many.
    rate, method : see `Cell`.
    values : means over the seeds with their intervals, by the names of scores; ``ms`` is milliseconds per frame.
    ahead : the same for the differences to the first method, seed by seed; empty for that method itself.
    each : the scores at every seed, in the order of the seeds.
    random : whether the seeds matter. Where not, one run was enough and there is no interval.
    failed : why there are no values; empty where there are.
    """

    sequence: str
    detections: str
    cases: int
    rate: float
    method: str
    values: Mapping[str, Interval]
    ahead: Mapping[str, Interval]
    random: bool
    failed: str = ""
    each: tuple[Mapping[str, float], ...] = ()

    @property
    def pooled(self) -> bool:
        """Over more than one sequence."""
        return self.cases > 1

    def told_apart(self, other: Row, name: str) -> bool:
        """Whether the two differ in a score by more than chance between seeds: seed by seed, 95 %; where nothing is random,
        at all."""
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
    groups: list[tuple[str, str, tuple[Case, ...]]] = [(case.footage.name, case.seen.name, (case,)) for case in plan.cases]
    names = list(dict.fromkeys(case.seen.name for case in plan.cases))
    for name in names:
        cases = tuple(case for case in plan.cases if case.seen.name == name)
        if 1 < len(cases) < len(plan.cases):
            groups.append((POOLED, name, cases))
    if len(plan.cases) > 1:
        groups.append((POOLED, names[0] if len(names) == 1 else POOLED, plan.cases))
    rows = [
        _row(comparison, sequence, detections, cases, rate, method)
        for sequence, detections, cases in groups
        for rate in plan.rates
        for method in plan.methods
    ]
    return Summary(tuple(rows))


def check_scores(names: Sequence[str]) -> tuple[str, ...]:
    """``names`` of scores as they are written; `InputError` for one that there is not."""
    known = {name.lower(): name for name in (*SCORES, *OTHERS)}
    for name in names:
        if name.lower() not in known:
            close = difflib.get_close_matches(name.lower(), known, 1)
            cure = f"Did you mean {known[close[0]]}?" if close else f"There are {', '.join(known.values())}."
            raise InputError(f"there is no score {name}", where="--scores", cure=cure)
    return tuple(known[name.lower()] for name in names)


def values_of(parts: Sequence[Outcome]) -> dict[str, float]:
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


def _row(comparison: Comparison, sequence: str, detections: str, cases: Sequence[Case], rate: float, method: Method) -> Row:
    own, reason = _by_seed(comparison, cases, rate, method)
    first, _ = _by_seed(comparison, cases, rate, comparison.plan.methods[0])
    random = rate > 0 or _drawn(comparison, cases, rate, method)
    ahead: dict[str, Interval] = {}
    if method is not comparison.plan.methods[0] and own and first:
        either = random or _drawn(comparison, cases, rate, comparison.plan.methods[0])
        apart = [
            {name: mine[name] - theirs[name] for name in mine if name in theirs}
            for mine, theirs in zip(own, first, strict=True)
        ]
        ahead = _intervals(apart if either else apart[:1])
    values = _intervals(own if random else own[:1])
    return Row(sequence, detections, len(cases), rate, method.name, values, ahead, random, reason, tuple(own))


def _by_seed(
    comparison: Comparison, cases: Sequence[Case], rate: float, method: Method
) -> tuple[list[dict[str, float]], str]:
    """The scores at every seed, pooled over ``cases``; nothing and the reason where a run failed."""
    out = []
    for seed in comparison.plan.seeds:
        results = [comparison.outcome(Cell(case, rate, method), seed) for case in cases]
        for result in results:
            if isinstance(result, Failed):
                return [], result.reason
        out.append(values_of([result for result in results if isinstance(result, Outcome)]))
    return out, ""


def _drawn(comparison: Comparison, cases: Sequence[Case], rate: float, method: Method) -> bool:
    firsts = [comparison.outcome(Cell(case, rate, method), comparison.plan.seeds[0]) for case in cases]
    return any(isinstance(first, Outcome) and first.drawn for first in firsts)


def _intervals(seeds: Sequence[Mapping[str, float]]) -> dict[str, Interval]:
    """By name, over the seeds; a score that is undefined at one of them is left out."""
    names = [name for name in (seeds[0] if seeds else {}) if all(name in values for values in seeds)]
    return {name: interval([values[name] for values in seeds]) for name in names}
