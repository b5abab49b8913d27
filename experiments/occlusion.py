"""What occlusion costs a detector: recall by the covered part of a box, and what a filter makes of it in the image.

The annotated boxes of the seven cases of `cases`, by the largest part that one nearer box of the frame covers (nearer
is the box whose lower edge is lower). A box is detected where a detection is mapped to it at IoU ≥ 0.5, one to one. Then the
GM-PHD filter on the same cases, with `sensor.occlusion` and without.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from experiments.cases import CASES, short
from experiments.common import Case, Options, ScoredCase, in_parallel, measure, mot15, table, write
from experiments.e13 import covered
from phdtrack.arrays import iou
from phdtrack.metrics.matching import above, assign
from phdtrack.models.occlusion import SHAPE
from phdtrack.types import F8

# Borders of the covered parts; the first class is of boxes that nothing covers.
PARTS = (0.0, 0.01, 0.1, 0.35, 0.55, 0.75, 1.0)
OcclusionRun = tuple[str, str, str]


def found(case: Case) -> tuple[F8, F8]:
    """Of every annotated box the covered part, and 1 where it is detected, 0 where not."""
    parts, hits = [np.zeros(0)], [np.zeros(0)]
    for number in np.unique(case.truth.frame).tolist():
        boxes = case.truth.xyxy[case.truth.frame == number]
        rows, _ = assign(above(iou(boxes, case.table.at(number).xyxy), 0.5))
        hit = np.zeros(len(boxes))
        hit[rows] = 1.0
        parts.append(covered(boxes))
        hits.append(hit)
    return np.concatenate(parts), np.concatenate(hits)


def recalls(case: Case) -> list[float]:
    """Share of the boxes detected by class of their covered part, over that of the free ones; NaN without any."""
    part, hit = found(case)
    kind = np.searchsorted(PARTS[1:-1], part, side="right")
    shares = [float(hit[kind == k].mean()) if (kind == k).any() else float("nan") for k in range(len(PARTS) - 1)]
    return [share / shares[0] for share in shares]


def work(job: OcclusionRun) -> ScoredCase:
    """The filter on a case, with occlusion known or not."""
    sequence, kind, occlusion = job
    return measure(mot15(sequence, kind), "gm-phd", 1, (f"sensor.occlusion={occlusion}",))


def main(options: Options) -> Path:
    """Run everything and write occlusion.md."""
    chosen = short(CASES) if options.quick else CASES
    cases = [mot15(*case) for case in chosen]
    seen = np.array([recalls(case) for case in cases])
    middle = [(low + high) / 2 for low, high in pairwise(PARTS[1:])]
    header = ("case", *(f"{low:g} to {high:g}" for low, high in pairwise(PARTS[1:])))
    rows: list[tuple[object, ...]] = [
        (case.name, *(float(r) for r in row[1:])) for case, row in zip(cases, seen, strict=True)
    ]
    rows.append(("mean", *(float(r) for r in np.nanmean(seen[:, 1:], axis=0))))
    rows.append(("1 − c^1.5 in the middle", *(1 - c**SHAPE for c in middle)))
    jobs = [(*case, occlusion) for case in chosen for occlusion in ("false", "true")]
    results = dict(zip(jobs, in_parallel(work, jobs, "occlusion", options), strict=True))
    scores = ("MOTA", "IDF1", "id_switches")
    filtered: list[tuple[object, ...]] = []
    for case in chosen:
        off, on = (results[(*case, occlusion)].scores for occlusion in ("false", "true"))
        filtered.append((" ".join(case), *(getattr(which, score) for score in scores for which in (off, on))))
    means = np.array([row[1:] for row in filtered], dtype=np.float64).mean(axis=0)
    filtered.append(("mean", *means.tolist()))
    columns = ("case", "MOTA off", "on", "IDF1 off", "on", "switches off", "on")
    return write("occlusion", options, cases=len(chosen), recall=table(header, rows), filtered=table(columns, filtered))
