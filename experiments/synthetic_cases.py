"""Synthetic cameras as cases for the trackers, and the peers' scores on them.

The scores of SORT, ByteTrack and OC-SORT are kept in `experiments/synthetic_peers.csv`, with the
number of detections of the camera that they are for. For cameras that are missing there the peers
run in their environment (`make peers`), and their scores are added.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from experiments.common import Case, Options, in_parallel, run_peers
from experiments.regimes_scenes import PEERS
from experiments.synthetic_cameras import SyntheticCamera, camera, name_of, seed_of
from phdtrack.errors import InputError
from phdtrack.formats import read_tracks
from phdtrack.metrics import evaluate
from phdtrack.types import Detections, DetectionTable, SequenceInfo, Tracks, Truth

# The name of the detections of every synthetic camera.
DETECTOR = "synthetic"
SCORES = ("HOTA", "MOTA", "IDF1")
CSV = Path(__file__).with_name("synthetic_peers.csv")
Row = Mapping[str, str]


# All cameras of a run, which every variant is tried on.
@lru_cache(maxsize=32)
def camera_case(name: str) -> Case:
    """A synthetic camera by its name. Detections of one without scores have none (1 for all)."""
    return case_of(camera(seed_of(name)))


def case_of(one: SyntheticCamera) -> Case:
    """A camera as a case."""
    world, found = one.world, one.detections
    info = SequenceInfo(world.width, world.height, world.fps, world.frames, one.name)
    frame, identity, xyxy = one.truth()
    truth = Truth(frame, identity, xyxy, np.zeros(len(frame), bool))
    return Case(
        one.name,
        info,
        truth,
        DetectionTable(found.frame, Detections.of(found.xyxy, found.score)),
    )


def points(case: Case, tracks: Tracks) -> list[str]:
    """HOTA, MOTA and IDF1 of tracks, in points."""
    scores = evaluate(case.truth, tracks, frames=case.info.frames)
    return [f"{100 * getattr(scores, name):.3f}" for name in SCORES]


def peers_of_cameras(seeds: Iterable[int], options: Options) -> list[Row]:
    """The peers' scores on the cameras of these seeds; those that are not kept are measured now.

    Raises `InputError` if kept scores are for another camera of the same seed, or if scores are
    missing and the peers' environment is, too.
    """
    names = [name_of(seed) for seed in seeds]
    kept = kept_peers()
    known = {row["sequence"] for row in kept}
    missing = [name for name in names if name not in known]
    if missing:
        kept = [*kept, *measured_peers(missing, options)]
        keep_peers(kept)
    rows = [row for row in kept if row["sequence"] in names]
    for row in rows:
        number = len(camera_case(row["sequence"]).table.frame)
        if int(row["detections"]) != number:
            raise InputError(
                f"expected scores of peers on the {number} detections of {row['sequence']}, got"
                f" those on {row['detections']}",
                where=CSV,
                cure="Delete the file and say make peers: the next run measures them anew",
            )
    return rows


def kept_peers() -> list[Row]:
    """All rows of the file; none if it is missing."""
    if not CSV.is_file():
        return []
    with CSV.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def keep_peers(rows: Sequence[Row]) -> None:
    """Write the file, by camera and peer."""
    order = sorted(rows, key=lambda row: (seed_of(row["sequence"]), PEERS.index(row["name"])))
    with CSV.open("w", newline="", encoding="utf-8") as file:
        names = ("sequence", "detections", "name", *SCORES)
        writer = csv.DictWriter(file, names, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(order)


def measured_peers(names: Sequence[str], options: Options) -> list[Row]:
    """Run the peers on cameras in their environment, and score their tracks."""
    with tempfile.TemporaryDirectory() as folder:
        seeds = [seed_of(name) for name in names]
        run_peers("synthetic", [folder, *seeds], options.jobs)
        jobs = [(name, folder) for name in names]
        return [row for rows in in_parallel(_scored, jobs, "peers", options) for row in rows]


def _scored(job: tuple[str, str]) -> list[Row]:
    """The scores of all peers on one camera."""
    name, folder = job
    case = camera_case(name)
    rows = []
    for peer in PEERS:
        path = Path(folder) / peer / f"{name}.txt"
        tracks = read_tracks(path) if path.stat().st_size else Tracks.empty()
        values = dict(zip(SCORES, points(case, tracks), strict=True))
        number = str(len(case.table.frame))
        rows.append({"sequence": name, "detections": number, "name": peer, **values})
    return rows
