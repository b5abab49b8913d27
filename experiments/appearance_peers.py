"""Tracks of four peers that use appearance, for `experiments.appearance`.

Runs in an environment of its own, which has `boxmot` 25.0.0 and torch:

    python -m venv .venv-boxmot && .venv-boxmot/bin/pip install boxmot==25.0.0
    .venv-boxmot/bin/python -m experiments.appearance_peers DATA OUT

writes OUT/QUALITY-SEED/PEER/DETECTOR/SEQUENCE.txt, and leaves the files that are there. The
trackers have the settings that the package ships, the frame rate of the sequence if they take one,
and the same embeddings as the tracker that they are compared with, scaled to length one. Their
pictures are black, and their correction of the camera's motion, which needs real ones, is off.
Scores are cut to 0 to 1, because they refuse others.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from experiments.appearance_inputs import F4, PEERS, PEERS_SEEDS, QUALITIES, made
from experiments.degraded_inputs import CameraCase, Input, cases, read_case

# A case, the quality and the seed of its embeddings, the folder of the scripts, and that of tracks.
Job = tuple[CameraCase, str, int, Path, Path]


def track(job: Job) -> None:
    """Track one case with every peer."""
    case, quality, seed, bench, out = job
    places = {
        name: out / f"{quality}-{seed}" / name / case.detector / f"{case.sequence}.txt"
        for name in PEERS
    }
    if all(path.is_file() for path in places.values()):
        return
    given = read_case(case)
    looks = made(case, bench, quality, seed, given.fps)
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    for name, path in places.items():
        rows = followed(tracker_of(name, given.fps), given, looks)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, rows, delimiter=",", fmt="%g")


def tracker_of(name: str, fps: float) -> object:
    """A tracker of the package with its own settings, without correction of the camera's motion."""
    from boxmot.trackers import TrackerSpec, create_tracker

    changed: Mapping[str, Mapping[str, object]] = {
        "botsort": {"use_cmc": False, "frame_rate": round(fps)},
        "deepocsort": {"cmc_off": True},
        "boosttrack": {"use_cmc": False},
        "strongsort": {},
    }
    tracker = create_tracker(TrackerSpec(name, options=tuple(sorted(changed[name].items()))))
    # StrongSORT has no setting for it.
    tracker.cmc = None
    return tracker


def followed(tracker: object, given: Input, looks: F4) -> np.ndarray:
    """(N, 10) rows of a MOT file."""
    import torch
    from boxmot.structures import Boxes, Detections

    torch.set_num_threads(1)
    order = np.argsort(given.frame, kind="stable")
    ends = np.searchsorted(given.frame[order], np.arange(1, given.frames + 2))
    black = np.zeros((given.size[1], given.size[0], 3), np.uint8)
    rows = []
    for k in range(given.frames):
        part = order[ends[k] : ends[k + 1]]
        found = Detections(
            Boxes(torch.from_numpy(given.xyxy[part].astype(np.float32).reshape(-1, 4))),
            torch.from_numpy(np.clip(given.score[part], 0, 1).astype(np.float32)),
            torch.zeros(len(part), dtype=torch.int64),
            str(k),
            embeddings=torch.from_numpy(looks[part]),
        )
        out = tracker.update(found, black)
        boxes = out.geometry.values.numpy().reshape(-1, 4)
        for identity, box in zip(out.track_ids.tolist(), boxes.tolist(), strict=True):
            x, y, x2, y2 = box
            rows.append((k + 1, identity, x, y, x2 - x, y2 - y, 1, -1, -1, -1))
    return np.array(rows, dtype=float).reshape(-1, 10)


def main(arguments: Sequence[str] | None = None) -> None:
    """Track every case with embeddings of every quality."""
    parser = argparse.ArgumentParser(prog="experiments.appearance_peers", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the real sequences")
    parser.add_argument("out", type=Path, help="folder of the tracks")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N")
    options = parser.parse_args(arguments)
    bench = options.data.parent / "bench"
    jobs = [
        (case, quality, seed, bench, options.out)
        for quality in ("middle", *(one for one in QUALITIES if one != "middle"))
        for seed in PEERS_SEEDS
        for case in cases(options.data, bench / "groups.csv")
    ]
    with ProcessPoolExecutor(max_workers=options.jobs) as pool:
        for _ in pool.map(track, jobs):
            pass


if __name__ == "__main__":
    main()
