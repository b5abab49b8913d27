"""Tracks of SORT, ByteTrack and OC-SORT in front of synthetic cameras, for `experiments.cameras`.

Runs in the environment of the peers (`make peers`), which has the package `trackers`:

    .venv-peers/bin/python -m experiments.synthetic_peers OUT SEED …

writes OUT/PEER/camera-SEED.txt. The trackers have their defaults and the camera's frame rate.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from experiments.degraded_inputs import Input
from experiments.degraded_peers import followed
from experiments.regimes_scenes import PEERS
from experiments.synthetic_cameras import camera


def track(seed: int, out: Path) -> None:
    """Track the camera of a seed with every peer."""
    import trackers

    one = camera(seed)
    world, found = one.world, one.detections
    nothing = np.zeros((0, 7))
    size = (world.width, world.height)
    given = Input(
        found.frame, found.xyxy, found.score, world.frames, size, world.fps, nothing, nothing
    )
    kinds = dict(
        zip(
            PEERS,
            (trackers.SORTTracker, trackers.ByteTrackTracker, trackers.OCSORTTracker),
            strict=True,
        )
    )
    for name, kind in kinds.items():
        path = out / name / f"{one.name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, followed(kind(frame_rate=world.fps), given), delimiter=",", fmt="%g")


def main(arguments: Sequence[str] | None = None) -> None:
    """Track every camera."""
    parser = argparse.ArgumentParser(prog="experiments.synthetic_peers", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the tracks")
    parser.add_argument("seeds", type=int, nargs="+", help="seeds of the cameras")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N")
    options = parser.parse_args(arguments)
    with ProcessPoolExecutor(max_workers=options.jobs) as pool:
        for _ in pool.map(partial(track, out=options.out), options.seeds):
            pass


if __name__ == "__main__":
    main()
