"""Costs of a video in `phdtrack batch`: CPU per video, per frame and per finished video, memory,
and bytes on disk.

    python -m experiments.batch_costs

A rendered street of 640x360 is tracked with the change detector, and again from its detections,
without annotated videos. CPU seconds count all threads and processes; other programs disturb them
less than the elapsed time.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import pyarrow.parquet

from phdtrack.run import RunRequest
from phdtrack.run.video_batch import DOCUMENT, BatchPlan

SHORT = 50
MIDDLE = 200
MANY = 9
DONE = 1000


class Used(NamedTuple):
    """Resources of a command: CPU seconds of all its processes, memory of the largest one in MiB,
    and elapsed seconds.
    """

    cpu: float
    memory: float
    wall: float


def run(*words: object) -> Used:
    """Run ``phdtrack`` and wait for it."""
    command = [sys.executable, "-m", "phdtrack", *map(str, words)]
    began = time.monotonic()
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert child.stderr is not None
    errors = child.stderr.read().decode()
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{' '.join(command)}: {errors}")
    return Used(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, time.monotonic() - began)


def sources(folder: Path, frames: int) -> tuple[Path, Path]:
    """A street's video, and its detections with a seqinfo.ini beside them."""
    run("simulate", "street", "--out", folder / "made", "--seed", 1, "--frames", frames)
    return folder / "made" / "scene.mp4", folder / "made" / "det" / "det.txt"


def copies(source: Path, folder: Path, count: int) -> list[Path]:
    """Copies of the video under different names."""
    folder.mkdir()
    if (info := source.parents[1] / "seqinfo.ini").exists():
        shutil.copy(info, folder)
    return [Path(shutil.copy(source, folder / f"s{k}{source.suffix}")) for k in range(count)]


def costs(source: Path, long: Path, frames: int, folder: Path) -> list[tuple[str, str]]:
    """Names and values of the measured costs."""
    folder.mkdir()
    many = copies(source, folder / "in", MANY)
    batch = ["batch", "--jobs", 1, "--out"]
    run(*batch, folder / "warm", many[0], "--", "--no-video")
    one = run(*batch, folder / "one", many[0], "--", "--no-video")
    all_of_them = run(*batch, folder / "many", *many, "--", "--no-video")
    longer = run(*batch, folder / "long", long, "--", "--no-video")
    each = (all_of_them.cpu - one.cpu) / (MANY - 1)
    frame = (longer.cpu - one.cpu) / (frames - SHORT)
    rows = next((folder / "long" / "tracks").iterdir())
    count = pyarrow.parquet.read_metadata(rows).num_rows
    size = sum(file.stat().st_size for file in (folder / "long" / "runs" / rows.stem).iterdir())
    return [
        ("a frame, CPU ms", f"{1000 * frame:.1f}"),
        ("a video beside its frames, CPU s", f"{each - SHORT * frame:.2f}"),
        ("the command and its process, CPU s", f"{one.cpu - each:.1f}"),
        ("memory of the process, MiB", f"{longer.memory:.0f}"),
        ("rows a frame", f"{count / frames:.2f}"),
        ("a row of the data set, bytes", f"{rows.stat().st_size / count:.1f}"),
        ("the run's folder, bytes a frame", f"{size / frames:.0f}"),
    ]


def per_core(source: Path, folder: Path) -> str:
    """Throughput per core of two processes on two cores relative to one process, by CPU time and by
    the clock, starts included.
    """
    many = copies(source, folder, 6)
    one, two = (
        run("batch", "--jobs", n, "--out", folder / f"by{n}", *many, "--", "--no-video")
        for n in (1, 2)
    )
    return f"{one.cpu / two.cpu:.2f}, {one.wall / two.wall / 2:.2f}"


def done(source: Path, out: Path, folder: Path) -> float:
    """CPU milliseconds for a video whose results are all complete already."""
    many = copies(source, folder, DONE)
    place = folder / "out"
    mark = json.loads(next(out.glob(f"runs/*/{DOCUMENT}")).read_bytes())
    for video in BatchPlan(RunRequest(), (), place).videos([str(one) for one in many]):
        video.folder.mkdir(parents=True)
        (video.folder / DOCUMENT).write_text(json.dumps(mark | {"digest": video.digest}))
        video.rows.parent.mkdir(exist_ok=True)
        video.rows.touch()
    return (
        1000
        * (run("batch", "--out", place, *many).cpu - run("batch", "--out", place, many[0]).cpu)
        / (DONE - 1)
    )


def main() -> None:
    """Measure and print the costs."""
    options = argparse.ArgumentParser(prog="python -m experiments.batch_costs", description=__doc__)
    options.add_argument("--frames", type=int, default=1050, help="of the long video")
    frames = options.parse_args().frames
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("short", "long"):
            (folder / part).mkdir()
        short = sources(folder / "short", SHORT)
        long = sources(folder / "long", frames)
        for kind, one, other in zip(("video", "detections"), short, long, strict=True):
            for quantity, value in costs(one, other, frames, folder / kind):
                print(f"{kind:12} {quantity:52} {value:>8}", flush=True)
        (folder / "middle").mkdir()
        for kind, one in zip(
            ("video", "detections"), sources(folder / "middle", MIDDLE), strict=True
        ):
            print(
                f"{kind:12} {'work per core of two processes: CPU, clock':52}"
                f" {per_core(one, folder / ('two' + kind)):>8}"
            )
        again = done(short[1], folder / "video" / "one", folder / "done")
        print(f"{'':12} {'a video that is done, CPU ms':52} {again:8.2f}")


if __name__ == "__main__":
    main()
