"""Tracks of five peers on worse detections of the real sequences, for `experiments.degraded`.

Runs in the environment of the peers (`make peers`), which has the package `trackers`:

    .venv-peers/bin/python -m experiments.degraded_peers DATA GROUPS OUT

writes OUT/CHANGE/PEER/DETECTOR/SEQUENCE.txt. The trackers have their defaults and the sequence's
frame rate, and get no pictures.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from experiments.degraded_inputs import CHANGES, PEERS, CameraCase, Input, cases, changed

Job = tuple[CameraCase, str, Path]


def track(job: Job) -> None:
    """Track one case after one change with every peer."""
    import trackers

    case, change, out = job
    given = changed(case, change)
    kinds = {
        "sort": trackers.SORTTracker,
        "bytetrack": trackers.ByteTrackTracker,
        "ocsort": trackers.OCSORTTracker,
        "botsort": trackers.BoTSORTTracker,
        "cbiou": trackers.CBIoUTracker,
    }
    for name in PEERS:
        path = out / change / name / case.detector / f"{case.sequence}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        rows = followed(kinds[name](frame_rate=given.fps), given)
        np.savetxt(path, rows, delimiter=",", fmt="%g")


def followed(tracker: object, given: Input) -> np.ndarray:
    """(N, 10) rows of a MOT file."""
    import supervision as sv

    order = np.argsort(given.frame, kind="stable")
    ends = np.searchsorted(given.frame[order], np.arange(1, given.frames + 2))
    rows = []
    for k in range(given.frames):
        part = order[ends[k] : ends[k + 1]]
        boxes = sv.Detections(
            given.xyxy[part].astype(np.float32).reshape(-1, 4),
            confidence=given.score[part].astype(np.float32),
            class_id=np.zeros(len(part), int),
        )
        out = tracker.update(boxes if len(part) else sv.Detections.empty())
        if out.tracker_id is None:
            continue
        for identity, box in zip(out.tracker_id, out.xyxy, strict=True):
            if identity >= 0:
                x, y, x2, y2 = (float(value) for value in box)
                rows.append((k + 1, int(identity), x, y, x2 - x, y2 - y, 1, -1, -1, -1))
    return np.array(rows, dtype=float).reshape(-1, 10)


def main(arguments: Sequence[str] | None = None) -> None:
    """Track every case after every change."""
    parser = argparse.ArgumentParser(prog="experiments.degraded_peers", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the real sequences")
    parser.add_argument("groups", type=Path, help="table of the groups of the new cameras")
    parser.add_argument("out", type=Path, help="folder of the tracks")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N")
    options = parser.parse_args(arguments)
    jobs = [
        (case, change, options.out)
        for case in cases(options.data, options.groups)
        for change in CHANGES
    ]
    with ProcessPoolExecutor(max_workers=options.jobs) as pool:
        for _ in pool.map(track, jobs):
            pass


if __name__ == "__main__":
    main()
