"""Frames per second of `phdtrack track` as a user sees them: the whole process, from its start to
its end.

    python -m benchmarks.process [VIDEO]

Start, decoding, detecting, tracking, corrected tracks, annotated video and report are all in the
time. The stages overlap in threads, so ``stage_ms`` may add up to more than a frame's share.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(
    os.environ.get("PHDTRACK_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
)
PETS = DATA / "mot15" / "PETS09-S2L1" / "PETS09-S2L1.mp4"
DETECTORS = ("change", "mean-background", "mog2", "person")


def measure(
    video: Path = PETS, detector: str = "change", repeats: int = 1, options: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Run ``phdtrack track`` on ``video``; ``frames_per_second`` is the median over ``repeats``.

    ``frames_per_second`` is None, and ``reason`` says why, where the video is absent.
    """
    if not video.exists():
        return {
            "detector": detector,
            "frames_per_second": None,
            "reason": f"{video} is not there; set PHDTRACK_DATA",
        }
    runs = [_run(video, detector, options) for _ in range(repeats)]
    last = runs[-1][1]
    spent = [seconds for seconds, _ in runs]
    return {
        "detector": detector,
        "video": video.name,
        "frames": last["frames"],
        "frames_per_second": last["frames"] / float(np.median(spent)),
        "seconds": spent,
        "without_start": last["frames_per_second"],
        "stage_ms": {name: stage["median"] for name, stage in last["stages"].items()},
    }


def _run(video: Path, detector: str, options: tuple[str, ...]) -> tuple[float, dict[str, Any]]:
    """Seconds that the process took, and its run.json."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [
            sys.executable,
            "-m",
            "phdtrack",
            "track",
            str(video),
            "--detector",
            detector,
            "--out",
            str(out),
            *options,
        ]
        began = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - began, json.loads((out / "run.json").read_text())


def main() -> None:
    """Print one line for each detector."""
    video = Path(sys.argv[1]) if len(sys.argv) > 1 else PETS
    for detector in DETECTORS:
        found = measure(video, detector)
        if found["frames_per_second"] is None:
            print(found["reason"])
            return
        stages = ", ".join(f"{name} {ms:.1f}" for name, ms in found["stage_ms"].items())
        whole = found["frames_per_second"]
        without = found["without_start"]
        print(
            f"{detector:16}{whole:7.1f} fps, without start and report {without:.1f} fps"
            f" ({stages} ms)",
            flush=True,
        )


if __name__ == "__main__":
    main()
