"""Merged measurements: two people who meet and share a blob, and videos with background detectors.

Rendered meetings go through the change detector; the videos are those of `videos`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.common import (
    Case,
    Options,
    built,
    detections_in,
    followed,
    in_parallel,
    mot15,
    need_data,
    table,
    write,
)
from experiments.meetings import PARTINGS, Leave, filmed, leaving
from phdtrack.metrics import Scores, evaluate, pool
from phdtrack.video import open_source

FILTERS = ("pmb", "gm-phd")
Sets = tuple[str, ...]
# Settings by their name on the page.
WAYS: Mapping[str, Sets] = {"as detected": (), "merged": ("merged_measurements.kind=explained",)}
VIDEOS = (("PETS09-S2L1", "change"), ("PETS09-S2L1", "mog2"), ("TUD-Campus", "change"))
LEAVES: tuple[Leave, ...] = ("right", "swapped", "new", "lost")
SCORES = ("MOTA", "IDF1", "HOTA", "switches", "MOTA online", "IDF1 online", "HOTA online")


@dataclass(frozen=True, slots=True)
class BlobCase:
    """A case by kind (meeting or video), name and seed."""

    kind: str
    name: str
    seed: int


@dataclass(frozen=True, slots=True)
class BlobScores:
    """Scores of corrected tracks and online rows; for a meeting, also the identities with which the
    two left the blob, for either.
    """

    corrected: Scores
    online: Scores
    leave: tuple[Leave, Leave] | None


def case_of(which: BlobCase) -> Case:
    """The sequence with the detections of the background detector."""
    if which.kind == "meeting":
        return filmed((next(one for one in PARTINGS if one == which.name), which.seed))
    sequence, _, detector = which.name.partition(" ")
    case = mot15(sequence, "public")
    video = need_data() / "mot15" / sequence / f"{sequence}.mp4"
    return Case(which.name, case.info, case.truth, detections_in(open_source(video), detector))


def work(job: tuple[BlobCase, Case, str, Sets]) -> BlobScores:
    """Track a case with a filter and settings."""
    which, case, filter_name, sets = job
    run = followed(
        built(case.info, filter_name, sets, "mot15" if filter_name == "pmb" else ""), case, 1
    )
    online = run.online.select(run.online.confirmed)
    scores = [
        evaluate(case.truth, tracks, frames=case.info.frames) for tracks in (run.corrected, online)
    ]
    leave = (
        (leaving(case, run.corrected), leaving(case, online)) if which.kind == "meeting" else None
    )
    return BlobScores(scores[0], scores[1], leave)


def main(options: Options) -> Path:
    """Run everything and write blobs.md."""
    seeds = options.number(20, 2)
    filters, videos = (FILTERS[:1], VIDEOS[-1:]) if options.quick else (FILTERS, VIDEOS)
    blob_cases = [
        BlobCase("meeting", parting, seed) for parting in PARTINGS for seed in range(seeds)
    ]
    blob_cases += [BlobCase("video", " ".join(video), 0) for video in videos]
    cases = dict(
        zip(blob_cases, in_parallel(case_of, blob_cases, "blobs, detecting", options), strict=True)
    )
    runs = [(which, name, way) for which in blob_cases for name in filters for way in WAYS]
    jobs = [(which, cases[which], name, WAYS[way]) for which, name, way in runs]
    scored = dict(zip(runs, in_parallel(work, jobs, "blobs", options), strict=True))
    tables = {kind: table(*_table(kind, filters, scored)) for kind in ("meeting", "video")}
    return write("blobs", options, seeds=seeds, **tables)


Runs = Mapping[tuple[BlobCase, str, str], BlobScores]


def _table(kind: str, filters: Sets, scored: Runs) -> tuple[tuple[str, ...], list[list[object]]]:
    """Header and rows by filter, method and case; for meetings also the outcomes of the pairs."""
    names = dict.fromkeys(which.name for which, _, _ in scored if which.kind == kind)
    rows: list[list[object]] = []
    for filter_, way, name in ((f, w, n) for n in names for f in filters for w in WAYS):
        those = [
            one
            for (which, f, w), one in scored.items()
            if (which.name, f, w) == (name, filter_, way)
        ]
        corrected = pool([one.corrected for one in those])
        online = pool([one.online for one in those])
        cells: list[object] = [
            corrected.MOTA,
            corrected.IDF1,
            corrected.HOTA,
            corrected.id_switches,
        ]
        cells += [online.MOTA, online.IDF1, online.HOTA]
        rows.append([name, filter_, way, *(_left(those) if kind == "meeting" else ()), *cells])
    return (kind, "filter", "blobs", *(LEAVES if kind == "meeting" else ()), *SCORES), rows


def _left(those: list[BlobScores]) -> list[str]:
    """Shares of the pairs with each outcome, in the corrected tracks and (online)."""
    left = [one.leave for one in those if one.leave is not None]
    shares = [
        [float(np.mean([pair[k] == leave for pair in left])) for k in (0, 1)] for leave in LEAVES
    ]
    return [f"{corrected:.2f} ({online:.2f})" for corrected, online in shares]
