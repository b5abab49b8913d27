"""Runs that are killed at any moment and resumed: are their files those of an uninterrupted run?

    python -m experiments.kills --kills 160 --stops 40 --seed 1

Half of the runs read a video (change detector, camera motion, annotated video), half a file of
detections. Each is started, ended by SIGKILL or SIGTERM at a time drawn uniformly from the duration
of a whole run, resumed, now and then ended again, and resumed until it is complete. Then every file
is compared with that of the uninterrupted run, byte by byte.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from phdtrack.video import VideoWriter

SAME = ("tracks.csv", "tracks_online.csv", "states.csv", "detections.csv", "annotated.mp4")
_FRAMES = 250
_PATIENCE = 600.0
_AGAIN = 0.3


def clip(path: Path) -> None:
    """A noisy grey video in which two dark boxes cross."""
    rng = np.random.default_rng(5)
    ground = rng.integers(120, 136, (120, 200, 3))
    with VideoWriter(path, 200, 120, 25.0) as writer:
        for k in range(_FRAMES):
            image = (ground + rng.integers(-2, 3, ground.shape)).astype(np.uint8)
            for place, top in ((2 * k % 180, 20), (180 - 3 * k % 180, 70)):
                image[top : top + 40, place : place + 16] = 30
            writer.write(image)


def detections(path: Path) -> None:
    """Write detections like those of the clip, with false alarms."""
    rng = np.random.default_rng(6)
    rows = list[str]()
    for k in range(1, 8 * _FRAMES):
        found = [
            (2 * k % 180, 20),
            (180 - 3 * k % 180, 70),
            *rng.uniform(0, 100, (rng.poisson(1.0), 2)).tolist(),
        ]
        rows += [f"{k},-1,{x:.2f},{y:.2f},16,40,0.9" for x, y in found]
    path.write_text("\n".join(rows) + "\n")


def started(words: list[str], out: Path, *more: str) -> subprocess.Popen[bytes]:
    """Start a run in a separate process."""
    command = [
        sys.executable,
        "-m",
        "phdtrack",
        "track",
        *words,
        "--out",
        str(out),
        "--checkpoint-every",
        "0.05",
        *more,
    ]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def whole(words: list[str], out: Path) -> float:
    """Run to the end, twice, so that kernels are compiled; return the seconds of the second run."""
    for _ in range(2):
        began = time.monotonic()
        run = started(words, out, "--overwrite")
        if run.wait(_PATIENCE) != 0:
            raise SystemExit(f"{' '.join(words)}: {run.communicate()[1].decode()}")
    return time.monotonic() - began


def ended(
    words: list[str],
    folder: Path,
    usual: Path,
    number: int,
    seconds: float,
    rng: np.random.Generator,
) -> Counter[str]:
    """End a run by a signal, resume it, and count the outcomes."""
    out = folder / "run"
    came = Counter[str]()
    more = ()
    while True:
        run = started(words, out, *more)
        strike = not more or rng.random() < _AGAIN
        if strike:
            try:
                run.wait(rng.uniform(0, seconds))
            except subprocess.TimeoutExpired:
                run.send_signal(number)
                came[signal.Signals(number).name] += 1
        _, errors = run.communicate(timeout=_PATIENCE)
        if run.returncode == 0:
            break
        if not strike or run.returncode not in (-number, 128 + number):
            came["failed"] += 1
            print(
                f"status {run.returncode} after {signal.Signals(number).name}:"
                f" {errors.decode()[-2000:]}",
                flush=True,
            )
            break
        more = ("--resume",) if out.exists() else ()
    names = {path.name for path in out.iterdir()} if out.exists() else set()
    if names != {path.name for path in usual.iterdir()}:
        came["other files"] += 1
    for name in SAME:
        if (usual / name).exists() and (
            name not in names or (out / name).read_bytes() != (usual / name).read_bytes()
        ):
            came[f"another {name}"] += 1
    shutil.rmtree(out, ignore_errors=True)
    return came


def main() -> None:
    """Run everything, and write the counts into a file."""
    out = argparse.ArgumentParser(prog="python -m experiments.kills", description=__doc__)
    out.add_argument("--kills", type=int, default=160)
    out.add_argument("--stops", type=int, default=40)
    out.add_argument("--seed", type=int, default=1)
    out.add_argument("--out", type=Path, default=Path("runs/reliability"))
    parsed = out.parse_args()
    parsed.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(parsed.seed)
    result = dict[str, object]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clip(folder / "clip.mp4")
        detections(folder / "det.txt")
        size = ["--frame-size", "200x120", "--fps", "25"]
        jobs = {"video": [str(folder / "clip.mp4"), "--camera-motion", "flow"]}
        jobs["detections"] = ["--detections", str(folder / "det.txt"), *size]
        for kind, words in jobs.items():
            usual = folder / kind
            total = Counter[str]()
            began = time.monotonic()
            seconds = whole(words, usual)
            for number, count in (
                (signal.SIGKILL, parsed.kills // 2),
                (signal.SIGTERM, parsed.stops // 2),
            ):
                for _ in range(count):
                    total += ended(words, folder, usual, int(number), seconds, rng)
            result[kind] = {
                "seconds of a run": seconds,
                "seconds": time.monotonic() - began,
                **total,
            }
            print(kind, result[kind], flush=True)
    (parsed.out / "kills.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
