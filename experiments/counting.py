"""Crossings of lines and visits of zones: `phdtrack count` compared with the same counts of the
annotated truth.

Two videos, PETS09-S2L1 and CAVIAR's shop corridor. The truth goes through the same lines and zones,
with the same hysteresis. Lines and zones were drawn before anything was counted.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.common import ROOT, Options, in_parallel, need_data, table, write
from phdtrack.formats import read_truth
from phdtrack.live.events import Event, Tally, Watch, place_events, tallies
from phdtrack.live.zones import Place
from phdtrack.run.directory import read_run_tracks
from phdtrack.types import F8, Tracks, Truth


def line(name: str, *values: float) -> Place:
    """A line through these points."""
    return Place(name, tuple(zip(values[::2], values[1::2], strict=True)), closed=False)


def box(name: str, left: float, top: float, right: float, bottom: float) -> Place:
    """A zone with sides along the frame's."""
    return Place(name, ((left, top), (right, top), (right, bottom), (left, bottom)), closed=True)


@dataclass(frozen=True, slots=True)
class Count:
    """A video with its truth, detections (empty: the default detector's), and places."""

    name: str
    video: str
    truth: str
    detections: str
    places: tuple[Place, ...]


PETS = (
    *(
        line("road", 330, 80, 420, 570),
        line("left", 200, 120, 200, 500),
        line("far", 300, 200, 768, 200),
    ),
    *(box("middle", 250, 200, 600, 450), box("right", 450, 150, 768, 400)),
)
CORRIDOR = (
    line("across", 0, 150, 384, 150),
    line("shop", 150, 60, 150, 288),
    box("near", 60, 120, 340, 288),
)
_PETS = "mot15/PETS09-S2L1"
COUNTS = (
    Count("PETS09-S2L1", f"{_PETS}/PETS09-S2L1.mp4", f"{_PETS}/gt/gt.txt", "", PETS),
    Count(
        "PETS09-S2L1",
        f"{_PETS}/PETS09-S2L1.mp4",
        f"{_PETS}/gt/gt.txt",
        f"{_PETS}/det_public/det.txt",
        PETS,
    ),
    Count("OneLeaveShop1cor", "caviar/OneLeaveShop1cor.mpg", "caviar/cols1gt.xml", "", CORRIDOR),
)
SHORT = "OneLeaveShop1cor"


def as_tracks(truth: Truth) -> Tracks:
    """The annotated objects as tracks."""
    rows = Tracks.of(truth.frame, truth.identity, truth.xyxy, 1.0, -1)
    return rows.select(np.lexsort((truth.identity, truth.frame)))


def inside(events: list[Event], place: str, last: int) -> F8:
    """(last,) number of objects in a zone in each frame."""
    change = np.zeros(last + 1)
    for event in events:
        if event.place == place:
            change[event.number - 1] += {"enter": 1, "exit": -1}.get(event.kind, 0)
    return np.cumsum(change)[:last]


def work(job: tuple[Count, Path]) -> list[list[object]]:
    """A row for each place, for the corrected tracks and for the online rows."""
    case, runs = job
    out = runs / f"{case.name}-{'given' if case.detections else 'change'}"
    detection_options = (
        ("--detections", str(need_data() / case.detections)) if case.detections else ()
    )
    command = [
        sys.executable,
        "-m",
        "phdtrack",
        "track",
        str(need_data() / case.video),
        *detection_options,
        "--no-video",
        "--overwrite",
    ]
    subprocess.run([*command, "--out", str(out)], check=True, capture_output=True)
    run = read_run_tracks(out)
    watch = Watch(case.places)
    last = run.info.frames
    fps = run.info.fps
    truth = place_events(watch, as_tracks(read_truth(need_data() / case.truth)), last, fps)
    rows = list[list[object]]()
    for output, tracks in (
        ("corrected", run.tracks),
        ("online", read_run_tracks(out / "tracks_online.csv").tracks),
    ):
        found = place_events(watch, tracks, last, fps)
        pairs = zip(
            tallies(watch, truth, 0.0, last / fps),
            tallies(watch, found, 0.0, last / fps),
            strict=True,
        )
        for place, (real, ours) in zip(case.places, pairs, strict=True):
            seen = "public" if case.detections else "change"
            rows.append(
                [
                    case.name,
                    seen,
                    output,
                    place.name,
                    *_cells(place, real, ours, truth, found, last),
                ]
            )
    return rows


def _cells(
    place: Place, real: Tally, ours: Tally, truth: list[Event], found: list[Event], last: int
) -> list[object]:
    """In and out, true and counted; for a zone the number inside and the time inside."""
    error = abs(real.entered - ours.entered) + abs(real.left - ours.left)
    cells: list[object] = [f"{real.entered} / {real.left}", f"{ours.entered} / {ours.left}", error]
    if not place.closed:
        return [*cells, "", "", ""]
    off = np.abs(inside(truth, place.name, last) - inside(found, place.name, last)).mean()
    return [
        *cells,
        f"{real.mean:.2f} / {ours.mean:.2f}",
        f"{off:.2f}",
        f"{real.stay:.1f} / {ours.stay:.1f}",
    ]


def main(options: Options) -> Path:
    """Track, count, and write counting.md."""
    runs = ROOT / "runs" / ("counting-quick" if options.quick else "counting")
    runs.mkdir(parents=True, exist_ok=True)
    cases = [case for case in COUNTS if not options.quick or case.name == SHORT]
    rows = [
        row
        for part in in_parallel(work, [(case, runs) for case in cases], "counting", options)
        for row in part
    ]
    head = ("video", "detections", "tracks", "place", "truth in / out", "counted", "error")
    head = (*head, "mean inside, truth / counted", "mean error a frame", "seconds of a visit")
    lines = [row for row in rows if row[7] == ""]
    return write(
        "counting",
        options,
        table=table(head, rows),
        crossings=sum(
            int(part) for row in lines if row[2] == "corrected" for part in str(row[4]).split(" / ")
        ),
        wrong=sum(int(str(row[6])) for row in lines if row[2] == "corrected"),
        online=sum(int(str(row[6])) for row in lines if row[2] == "online"),
    )
