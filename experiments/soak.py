"""A day of video time, as fast as possible: memory and speed of ``phdtrack track`` on a pipe and of
a live camera.

    python -m experiments.soak track --hours 24
    python -m experiments.soak live --hours 24
    python -m experiments.soak pause

Ten targets that return again and again, one detection in ten missing, and a false-alarm rate that
varies between none and six a frame within five minutes, at 25 frames a second. After each hour of
video time the resident memory and the processor time are recorded. Processor time on a shared
machine is hard to interpret, so it is compared with that of a fresh tracker on the same frames in
the same minutes: the ratio must not grow.

`pause` measures for how long a checkpoint interrupts `phdtrack track` and a camera, and its size,
after 1 000 and after 20 000 frames with ten targets: milliseconds, the median and the longest of
the last hundred, and MB.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from phdtrack.config import build_classes, load
from phdtrack.detect import make_detector
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.live.events import Watch
from phdtrack.live.zones import Place
from phdtrack.run.detection_log import DetectionLog
from phdtrack.run.directory import KNOWN, LOG, claim
from phdtrack.run.inputs import Inputs
from phdtrack.state import to_bytes
from phdtrack.tracker import Tracker
from phdtrack.types import Detections, Frame, SequenceInfo
from phdtrack.video import VideoSource
from phdtrack.video.live_sources import LiveFrame, SourceStatus

FPS = 25
WIDTH = 640
HEIGHT = 360
TARGETS = 10
SIZE = np.array([16.0, 36.0])
# Frames between measurements of a fresh tracker, and frames of each.
_EVERY = 7500
_FRESH = 250
ROW = "{},-1,{:.2f},{:.2f},{:.2f},{:.2f},{:.2f}\n"
_WALL = 1_700_000_000.0


def boxes(seed: int = 0) -> Iterator[np.ndarray]:
    """(N, 5) boxes with scores of each frame, without end."""
    rng = np.random.default_rng(seed)
    room = np.array([WIDTH, HEIGHT]) - SIZE
    at = rng.uniform(0, room, (TARGETS, 2))
    speed = rng.uniform(-2, 2, (TARGETS, 2))
    number = 0
    while True:
        number += 1
        at += speed
        speed[(at < 0) | (at > room)] *= -1
        np.clip(at, 0, room, out=at)
        seen = at[rng.random(TARGETS) < 0.9]
        seen = seen + rng.normal(0, 0.5, seen.shape)
        false = rng.uniform(0, room, (rng.poisson(3 + 3 * np.sin(number / 1200)), 2))
        corner = np.vstack([seen, false])
        score = np.where(np.arange(len(corner)) < len(seen), 0.9, 0.5)
        yield np.column_stack([corner, corner + SIZE, score])


@dataclass(slots=True)
class Hour:
    """State after a number of hours of video time: elapsed and processor seconds of the last one;
    those of a fresh tracker in the same minutes; and resident memory in MB.
    """

    hour: float
    wall: float
    cpu: float
    fresh: float
    memory: float


@dataclass(slots=True)
class Watching:
    """Records each completed hour of a process, by its number; 0: this process."""

    process: int
    per_hour: int
    hours: list[Hour] = field(default_factory=list)
    _fresh: list[float] = field(default_factory=list)
    _before: tuple[float, float] = (0.0, 0.0)
    _own: float = 0.0

    def frame(self, number: int) -> None:
        """Count a processed frame."""
        if number == 1:
            self._before = time.monotonic(), self._cpu()
        if number % min(_EVERY, self.per_hour) == 0:
            began = time.thread_time()
            self._fresh.append(fresh_tracker() / _FRESH)
            self._own += 0.0 if self.process else time.thread_time() - began
        if number % self.per_hour == 0:
            now = time.monotonic(), self._cpu()
            wall = now[0] - self._before[0]
            cpu = now[1] - self._before[1] - self._own
            fresh = float(np.median(self._fresh)) * self.per_hour
            self.hours.append(
                Hour(number / self.per_hour, wall, cpu, fresh, resident(self.process))
            )
            self._before = now
            self._own = 0.0
            self._fresh.clear()
            last = self.hours[-1]
            print(
                f"hour {last.hour:g}: {last.memory:.1f} MB, {cpu / fresh:.2f} of a fresh tracker,"
                f" {wall:.0f} s",
                flush=True,
            )

    def _cpu(self) -> float:
        if not self.process:
            return time.process_time()
        words = Path(f"/proc/{self.process}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def resident(process: int = 0) -> float:
    """Resident memory in MB."""
    pages = int(Path(f"/proc/{process or 'self'}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def fresh_tracker() -> float:
    """Processor seconds of this thread for the frames 51 … 50 + `_FRESH` of a new tracker."""
    tracker = Tracker((WIDTH, HEIGHT), fps=FPS)
    stream = boxes(1)
    for _ in range(50):
        tracker.update(next(stream))
    frames = [next(stream) for _ in range(_FRESH)]
    began = time.thread_time()
    for one in frames:
        tracker.update(one)
    return time.thread_time() - began


def track(hours: float, per_hour: int, folder: Path) -> list[Hour]:
    """Run the command line with rows on its standard input."""
    size = f"{WIDTH}x{HEIGHT}"
    command = [
        sys.executable,
        "-m",
        "phdtrack",
        "track",
        "--detections",
        "-",
        "--fps",
        str(FPS),
        "--frame-size",
        size,
    ]
    with subprocess.Popen(
        [*command, "--out", str(folder / "run"), "--overwrite"], stdin=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        watching = Watching(process.pid, per_hour)
        stream = boxes()
        for number in range(1, round(hours * per_hour) + 1):
            rows = [
                (number, x, y, r - x, b - y, score) for x, y, r, b, score in next(stream).tolist()
            ]
            process.stdin.write("".join(ROW.format(*row) for row in rows).encode())
            watching.frame(number)
        process.stdin.close()
        if process.wait() != 0:
            raise SystemExit(f"phdtrack track ended with status {process.returncode}")
    return watching.hours


class Replayed:
    """A source that gives a frame when the previous one is done, with times of 25 a second."""

    def __init__(self, last: int, through: Callable[[int], None]) -> None:
        self.last = last
        self.number = 0
        self._through = through
        self._image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def next(self, timeout: float) -> LiveFrame | None:
        """The next frame."""
        if self.number:
            self._through(self.number)
        if self.number >= self.last:
            self._through = lambda number: None
            time.sleep(timeout)
            return None
        self.number += 1
        return LiveFrame(self.number, self.number / FPS, _WALL + self.number / FPS, self._image)

    def status(self) -> SourceStatus:
        """A status that is always working."""
        return SourceStatus(
            "live", frames=max(100, self.number), fps=FPS, width=WIDTH, height=HEIGHT
        )


class _Given:
    """A detector that returns prepared boxes."""

    def __init__(self) -> None:
        self._boxes = boxes()

    def __call__(self, frame: Frame) -> Detections:
        found = next(self._boxes)
        return Detections.of(found[:, :4], found[:, 4])

    def reset(self) -> None: ...


def live(hours: float, per_hour: int, folder: Path) -> list[Hour]:
    """Run a camera with a line and a zone, video, hourly files and a quota, in this process."""
    middle = Place("middle", ((WIDTH / 2, HEIGHT), (WIDTH / 2, 0.0)), closed=False)
    corner = Place(
        "corner",
        ((0.0, 0.0), (WIDTH / 2, 0.0), (WIDTH / 2, HEIGHT / 2), (0.0, HEIGHT / 2)),
        closed=True,
    )

    def make(info: SequenceInfo) -> CameraParts:
        return CameraParts(
            _Given(), build_classes(load(None, ["associate.history=60"]), info), info
        )

    watching = Watching(0, per_hour)
    source = Replayed(round(hours * per_hour), watching.frame)
    settings = CameraSettings(folder / "camera", watch=Watch((middle, corner)), quota=50_000_000)
    camera = Camera("soak", source, make, settings)  # type: ignore[arg-type]
    camera.start()
    while len(watching.hours) < int(hours):
        time.sleep(0.2)
        if camera.problems or not camera.alive:
            raise SystemExit(f"the camera: {camera.problems}")
    if not camera.stop(60.0):
        raise SystemExit(f"not all files are complete: {camera.problems}")
    return watching.hours


def _pictures(last: int) -> VideoSource:
    """Ten boxes on noise."""
    ground = np.random.default_rng(5).integers(120, 136, (HEIGHT, WIDTH, 3)).astype(np.uint8)

    def read(source: VideoSource) -> Iterator[tuple[int, float, np.ndarray, str]]:
        for number, found in zip(range(1, last + 1), boxes(), strict=False):
            image = ground.copy()
            for left, top, right, bottom in found[found[:, 4] > 0.8, :4].astype(int).tolist():
                image[max(top, 0) : bottom, max(left, 0) : right] = 30
            yield number, (number - 1) / FPS, image, ""

    return VideoSource(SequenceInfo(WIDTH, HEIGHT, FPS, last, "soak"), read)


class _Timed(DetectionLog):
    """A log that records for how many seconds each checkpoint interrupts the run."""

    waits: tuple[float, ...] = ()

    def _save(self, inputs: Inputs, number: int, log: BinaryIO) -> None:
        due = self._due
        began = time.perf_counter()
        super()._save(inputs, number, log)
        if self._due != due:
            self.waits = (*self.waits[-99:], time.perf_counter() - began)


def pause(frames: int, folder: Path) -> dict[str, float]:
    """Pauses and sizes for a video's detector and for a camera's tracker with a history of 60 s,
    after ``frames`` frames.
    """
    source = _pictures(frames)
    directory = claim(folder / f"run{frames}", overwrite=False, name="soak")
    inputs = Inputs(
        source.info, source, make_detector("change"), "soak", "change", pictures=True, again=True
    )
    checkpoint = _Timed(directory, {"frames": frames}, {}, 0.05, resume=False)
    for _ in checkpoint.detect(inputs, iter(source)):
        pass
    track = {
        "ms": 1000 * float(np.median(checkpoint.waits)),
        "longest": 1000 * max(checkpoint.waits),
    }
    size = {
        "MB": directory.file(KNOWN).stat().st_size / 1e6,
        "log, bytes a frame": directory.file(LOG).stat().st_size / frames,
    }
    tracker = Tracker((WIDTH, HEIGHT), fps=FPS, associate={"history": 60})
    stream = boxes()
    began = list[float]()
    for number in range(1, frames + 1):
        tracker.update(next(stream))
        if number > frames - 100:
            clock = time.perf_counter()
            later = tracker.snapshot()
            began.append(time.perf_counter() - clock)
    live = {"live ms": 1000 * float(np.median(began)), "live longest": 1000 * max(began)}
    return track | size | live | {"live MB": len(zlib.compress(to_bytes(later()), 1)) / 1e6}


def main() -> None:
    """Run one part; write the result into a file."""
    out = argparse.ArgumentParser(prog="python -m experiments.soak", description=__doc__)
    out.add_argument("part", choices=("track", "live", "pause"))
    out.add_argument("--hours", type=int, default=24)
    out.add_argument(
        "--minutes", type=float, default=60.0, help="of video time in what counts as an hour"
    )
    out.add_argument("--out", type=Path, default=Path("runs/reliability"))
    parsed = out.parse_args()
    parsed.out.mkdir(parents=True, exist_ok=True)
    if parsed.part == "pause":
        with tempfile.TemporaryDirectory() as folder:
            pauses = {frames: pause(frames, Path(folder)) for frames in (1000, 20_000)}
        (parsed.out / "soak-pause.json").write_text(json.dumps(pauses, indent=1) + "\n")
        print(json.dumps(pauses, indent=1))
        return
    with tempfile.TemporaryDirectory(
        dir=parsed.out.parent if parsed.out.parent.is_dir() else None
    ) as folder:
        hours = {"track": track, "live": live}[parsed.part](
            parsed.hours, round(parsed.minutes * 60 * FPS), Path(folder)
        )
    result = {"minutes": parsed.minutes, "hours": [asdict(one) for one in hours]}
    (parsed.out / f"soak-{parsed.part}.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
