"""Why a PHD filter is behind where it is: where its misses lie, rows without hindsight, one setting changed at a time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.cases import MADE, SCENES, Named, drawn
from experiments.common import Case, built, table
from phdtrack import pipeline
from phdtrack.arrays import iou
from phdtrack.metrics import Scores, evaluate, pool
from phdtrack.metrics.matching import above, assign
from phdtrack.types import Bool, DetectionTable, Tracks, Truth

# Which annotated boxes are missed: of an object that is never found, before its first match, between two, after its last.
PLACES = ("never found", "before", "between", "after")
SHIPPED = "as shipped"
# Rows without hindsight and with it.
KINDS = ("online", "corrected")
_JOINED, _GAPS, _POOR = ("extract.merge_iou=1.0",), ("associate.gap_cost=0.0",), ("associate.min_link_gain=0.0",)
# Filter, what is changed, and how: one setting at a time. None of these decided a default.
CHANGES: dict[str, dict[str, tuple[str, ...]]] = {
    "particle-phd": {
        SHIPPED: (),
        "gaps cost nothing": _GAPS,
        "poor links kept": _POOR,
        "nobody joined": _JOINED,
        "extraction by a mixture": ("extract.kind=mixture",),
    },
    "gm-phd": {
        SHIPPED: (),
        "gaps cost nothing": _GAPS,
        "poor links kept": _POOR,
        "nobody joined": _JOINED,
        "lighter states": ("extract.min_weight=0.3",),
        "p_D 0.7": ("sensor.detection_probability=0.7",),
        "led back 20 frames": ("associate.back_dating=20",),
    },
    "mht": {SHIPPED: (), "states linked by the graph": ("associate.kind=graph",)},
    "none": {SHIPPED: ()},
}
# Real detections take most of the time and draw nothing but particles.
SEEDS_DRAWN, SEEDS_REAL = 2, 1


@dataclass(frozen=True, slots=True)
class Trial:
    """A filter on a case as detected, with other settings than the shipped ones."""

    case: Named
    method: str
    sets: tuple[str, ...]
    seed: int


@dataclass(frozen=True, slots=True)
class Tried:
    """Scores of the corrected tracks and of the online rows; ``missed``: annotated boxes by `PLACES`, and how many of
    each were ``detected``."""

    corrected: Scores
    online: Scores
    missed: tuple[int, ...]
    detected: tuple[int, ...]


def seeds_of(case: Named) -> range:
    """The seeds that a case is tried with."""
    return range(1, 1 + (SEEDS_DRAWN if case in MADE + SCENES else SEEDS_REAL))


def trials_of(cases: Sequence[Named]) -> list[Trial]:
    """Everything that is tried."""
    return [
        Trial(case, method, sets, seed)
        for case in cases
        for method, changes in CHANGES.items()
        for sets in changes.values()
        for seed in seeds_of(case)
    ]


def tried(trial: Trial) -> Tried:
    """One run of it, scored."""
    case = drawn(trial.case, trial.seed)
    stages = built(case.info, trial.method, trial.sets)
    frames = ((number, (number - 1) / case.info.fps, case.table.at(number)) for number in range(1, case.info.frames + 1))
    run = list(pipeline.run(stages, frames, np.random.default_rng(trial.seed)))
    corrected, online = pipeline.finish(stages, run[-1][0]), Tracks.concatenate([step.tracks for _, step in run])
    count = case.info.frames
    missed, detected = places(case, corrected)
    return Tried(evaluate(case.truth, corrected, frames=count), evaluate(case.truth, online, frames=count), missed, detected)


def places(case: Case, tracks: Tracks) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """How many annotated boxes are missed in each of `PLACES`, and how many of those were detected."""
    hit, seen = matched(case.truth, tracks), matched(case.truth, case.table)
    place = np.zeros(len(case.truth), np.int64)
    for identity in np.unique(case.truth.identity[hit]):
        rows = np.flatnonzero(case.truth.identity == identity)
        frame = case.truth.frame[rows]
        first, last = (pick(frame[hit[rows]]) for pick in (np.min, np.max))
        place[rows] = np.where(frame < first, 1, np.where(frame > last, 3, 2))
    counts = (np.bincount(place[which], minlength=len(PLACES)).tolist() for which in (~hit, ~hit & seen))
    missed, detected = (tuple(int(n) for n in each) for each in counts)
    return missed, detected


def matched(truth: Truth, given: Tracks | DetectionTable) -> Bool:
    """Of every annotated box whether a given one is mapped to it at IoU ≥ 0.5, one to one in each frame."""
    boxes = given.xyxy if isinstance(given, Tracks) else given.detections.xyxy
    hit = np.zeros(len(truth), np.bool_)
    for number in np.unique(truth.frame).tolist():
        rows = np.flatnonzero(truth.frame == number)
        found, _ = assign(above(iou(truth.xyxy[rows], boxes[given.frame == number]), 0.5))
        hit[rows[found]] = True
    return hit


Groups = Mapping[str, Sequence[Named]]
Outcomes = Mapping[Trial, Tried]
# A filter and its settings.
Choice = tuple[str, tuple[str, ...]]
_MHT: Choice = ("mht", ())


def where(groups: Groups, trials: Outcomes) -> str:
    """Misses as shipped per annotated box by their place, in brackets those of detected boxes."""
    rows = []
    for name, cases in groups.items():
        for method in CHANGES:
            each = _of(trials, cases, method, ())
            boxes = sum(one.corrected.truth_boxes for one in each)
            counts = zip(*(zip(one.missed, one.detected, strict=True) for one in each), strict=True)
            cells = [(sum(m for m, _ in place) / boxes, sum(d for _, d in place) / boxes) for place in counts]
            rows.append((name, method, *(f"{missed:.3f} ({detected:.3f})" for missed, detected in cells)))
    return table(("cases", "filter", *PLACES), rows)


def hindsight(groups: Groups, trials: Outcomes) -> str:
    """Pooled scores as shipped, of the online rows and of the corrected tracks."""
    header = ("cases", "filter", *(f"{score} {rows}" for score in ("MODA", "MOTA") for rows in KINDS))
    counted = (f"ahead of mht {kind}" for kind in KINDS)
    rows: list[tuple[object, ...]] = []
    for name, cases in groups.items():
        for method in CHANGES:
            each = _of(trials, cases, method, ())
            kinds = [pool([getattr(one, kind) for one in each]) for kind in KINDS]
            ahead = [f"{_ahead(trials, cases, (method, ()), _MHT, kind)} of {len(cases)}" for kind in KINDS]
            scores = (float(getattr(x, score)) for score in ("MODA", "MOTA") for x in kinds)
            rows.append((name, method, *scores, *(ahead if method != "mht" else ("–", "–"))))
    return table((*header, *counted), rows)


def changed(groups: Groups, trials: Outcomes) -> str:
    """Pooled MODA and MOTA of the corrected tracks with one setting changed, for each group of cases."""
    rows: list[tuple[object, ...]] = []
    for method, changes in CHANGES.items():
        for name, sets in changes.items():
            scores = [pool([one.corrected for one in _of(trials, cases, method, sets)]) for cases in groups.values()]
            cells = (f"{one.MODA:.3f} / {one.MOTA:.3f}" for one in scores)
            cases = list(dict.fromkeys(case for each in groups.values() for case in each))
            ahead = f"{_ahead(trials, cases, (method, sets), _MHT)} of {len(cases)}" if (method, sets) != _MHT else "–"
            rows.append((method, name, ", ".join(f"`{each}`" for each in sets) or "–", *cells, ahead))
    return table(("filter", "change", "setting", *groups, "ahead of mht as shipped"), rows)


def _of(trials: Outcomes, cases: Iterable[Named], method: str, sets: tuple[str, ...]) -> list[Tried]:
    """The outcomes of a filter with its settings on the cases, as many of each: one seed stands for two."""
    return [
        trials[Trial(case, method, sets, seeds_of(case)[min(k, len(seeds_of(case)) - 1)])]
        for case in cases
        for k in range(SEEDS_DRAWN)
    ]


def _ahead(trials: Outcomes, cases: Iterable[Named], ours: Choice, theirs: Choice, rows: str = "corrected") -> int:
    """In how many cases one filter with its settings is ahead of another, in MODA and MOTA, with hindsight or online."""
    count = 0
    for case in cases:
        a, b = ([getattr(one, rows) for one in _of(trials, [case], *each)] for each in (ours, theirs))
        count += all(sum(getattr(x, key) for x in a) > sum(getattr(x, key) for x in b) for key in ("MODA", "MOTA"))
    return count
