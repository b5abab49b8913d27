"""The first command of most users, `phdtrack track VIDEO`, against a plain loop:
OpenCV's MOG2, SORT and cv2.VideoWriter.

    python -m benchmarks.command [WIDTHxHEIGHT …]
        print one line for each size, with and without annotated video
    python -m benchmarks.command --loop VIDEO OUT
        the plain loop by itself; prints frames a second (OUT "-": no video)
    python -m benchmarks.command --detect VIDEO
        milliseconds a frame of `change` as the command has it, and of MOG2

The videos are made on the spot: people-like figures cross a still scene with the noise of a camera.
Frames a second are those of run.json, from the first frame up to the report, and of the loop alone:
neither side counts its start. Annotated video of 4K has 1920 pixels a row, as the command writes
it, and in a line of its own all of them, as the loop's. The peak of memory is that of the whole
process, read by the system, so this needs Linux or macOS.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.parts import Outcome, Row, Scale, Skipped
from phdtrack.video import VideoWriter


class Size(NamedTuple):
    """Pixels, frames in the quick scale, and how many times as fast as the plain loop it should be
    with and without annotated video.
    """

    width: int
    height: int
    frames: int
    with_video: float | None = None
    without: float | None = None


SIZES = {
    "768x576": Size(768, 576, 300, 1.3, 1.6),
    "1080p": Size(1920, 1080, 150, 2.2, 4.0),
    "4K": Size(3840, 2160, 40),
}
# MiB at the peak, at 1080p.
MEMORY = 360.0
PEOPLE = 12
RATE = 25.0
NOISES = 4
# Wider pictures are shrunk for the annotated video.
SHRUNK = 1920


def make(path: Path, width: int, height: int, frames: int, seed: int = 1) -> None:
    """A video of `PEOPLE` figures that walk to and fro."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(60, 190, (height // 24, width // 24, 3), dtype=np.uint8)
    scene = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    # Noise in grains of two pixels, which a camera's own compression leaves.
    grains = [
        rng.normal(8, 3, (height // 2, width // 2)).clip(0, 16).astype(np.uint8)
        for _ in range(NOISES)
    ]
    noise = [cv2.merge([cv2.resize(each, (width, height))] * 3) for each in grains]
    high = 0.16 * height
    wide = 0.06 * height
    left = rng.uniform(0, width, PEOPLE)
    top = rng.uniform(0.1, 0.8, PEOPLE) * height
    speed = rng.uniform(0.0015, 0.004, PEOPLE) * width * rng.choice([-1, 1], PEOPLE)
    colours = rng.integers(0, 255, (PEOPLE, 2, 3)).tolist()
    with VideoWriter(path, width, height, RATE) as out:
        for number in range(frames):
            picture = scene.copy()
            for x, y, (coat, legs) in zip(
                (left + number * speed) % (width + 2 * wide) - wide, top, colours, strict=True
            ):
                for colour, above, below, inset in ((coat, 0.18, 0.6, 0.0), (legs, 0.6, 1.0, 0.1)):
                    corner = (round(x + inset * wide), round(y + above * high))
                    cv2.rectangle(
                        picture,
                        corner,
                        (round(x + (1 - inset) * wide), round(y + below * high)),
                        colour,
                        -1,
                    )
                cv2.circle(
                    picture,
                    (round(x + wide / 2), round(y + 0.09 * high)),
                    round(0.09 * high),
                    (120, 150, 200),
                    -1,
                )
            out.write(
                cv2.add(picture, np.roll(noise[number % NOISES], int(rng.integers(width)), axis=1))
            )


def ours(video: Path, folder: Path, *options: str) -> dict[str, float]:
    """Frames a second, peak in MiB, and seconds of processor and wall of the whole process."""
    # Those of the run before would be taken for nothing.
    out = folder / "run"
    again = ("--detect-again", *options)
    found = _process(
        [
            sys.executable,
            "-m",
            "phdtrack",
            "track",
            str(video),
            "--out",
            str(out),
            "--overwrite",
            *again,
        ]
    )
    run = json.loads((out / "run.json").read_text())
    return found | {"fps": run["frames_per_second"], "frames": run["frames"]}


def plain(video: Path, out: str) -> dict[str, float]:
    """The same of the plain loop, in a process of its own."""
    with tempfile.NamedTemporaryFile() as said:
        found = _process(
            [sys.executable, "-m", "benchmarks.command", "--loop", str(video), out], said.fileno()
        )
        return found | json.loads(Path(said.name).read_text())


# Runs a command and tells the processor seconds and the peak of it alone: a process begins with the
# peak of the one that started it, so that one has to be small.
_MEASURED = """import json, resource, subprocess, sys
status = subprocess.run(sys.argv[2:]).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
open(sys.argv[1], "w").write(json.dumps([status, used.ru_utime + used.ru_stime, used.ru_maxrss]))"""


def _process(command: list[str], said: int | None = None) -> dict[str, float]:
    """Run it; its wall and processor time, and its peak."""
    with tempfile.NamedTemporaryFile("r") as told:
        began = time.perf_counter()
        measured = [sys.executable, "-c", _MEASURED, told.name, *command]
        subprocess.run(measured, stdout=subprocess.DEVNULL if said is None else said, check=True)
        wall = time.perf_counter() - began
        status, cpu, peak = json.load(told)
    if status:
        raise RuntimeError(f"{' '.join(command)} ended with status {status}")
    return {"wall": wall, "cpu": cpu, "peak": peak / (2**20 if sys.platform == "darwin" else 2**10)}


class Sort:
    """SORT as published: a Kalman filter of centre, area and shape for each track, assignment by
    overlap.
    """

    def __init__(self, least: float = 0.3, patience: int = 5) -> None:
        self._least = least
        self._patience = patience
        self._next = 1
        self.tracks: list[list[Any]] = []
        self._f = np.eye(7) + np.eye(7, k=4) * (np.arange(7) < 3)[:, None]
        self._q = np.diag([1, 1, 1, 1, 0.01, 0.01, 1e-4])
        self._r = np.diag([1.0, 1, 10, 10])

    def update(self, boxes: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Identity and box of the tracks that were detected now."""
        from scipy.optimize import linear_sum_assignment

        from phdtrack.arrays import iou

        for track in self.tracks:
            track[1], track[2] = self._f @ track[1], self._f @ track[2] @ self._f.T + self._q
            track[3] += 1
        overlap = iou(np.array([_box(track[1]) for track in self.tracks]).reshape(-1, 4), boxes)
        pairs = [
            (i, j)
            for i, j in zip(*linear_sum_assignment(-overlap), strict=True)
            if overlap[i, j] >= self._least
        ]
        for i, j in pairs:
            track = self.tracks[i]
            gain = track[2][:, :4] @ np.linalg.inv(track[2][:4, :4] + self._r)
            track[1] = track[1] + gain @ (_measured(boxes[j]) - track[1][:4])
            track[2] = track[2] - gain @ track[2][:4]
            track[3] = 0
        for j in set(range(len(boxes))) - {j for _, j in pairs}:
            state = np.concatenate([_measured(boxes[j]), np.zeros(3)])
            self.tracks.append([self._next, state, np.diag([10.0, 10, 10, 10, 1e4, 1e4, 1e4]), 0])
            self._next += 1
        self.tracks = [track for track in self.tracks if track[3] <= self._patience]
        return [(track[0], _box(track[1])) for track in self.tracks if track[3] == 0]


def _measured(box: np.ndarray) -> np.ndarray:
    """Centre, area and shape of a box."""
    width = box[2] - box[0]
    height = box[3] - box[1]
    return np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2, width * height, width / height])


def _box(state: np.ndarray) -> np.ndarray:
    """The box of a state."""
    width = np.sqrt(max(state[2] * state[3], 1.0))
    height = max(state[2], 1.0) / width
    return np.array(
        [state[0] - width / 2, state[1] - height / 2, state[0] + width / 2, state[1] + height / 2]
    )


def loop(video: str, out: str) -> float:
    """Frames a second of what one would write oneself, at the video's own size."""
    capture = cv2.VideoCapture(video)
    tracker = Sort()
    subtractor = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
    window = np.ones((5, 5), np.uint8)
    size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    writer = (
        None if out == "-" else cv2.VideoWriter(out, cv2.VideoWriter.fourcc(*"mp4v"), RATE, size)
    )
    frames = 0
    began = time.perf_counter()
    while (shot := capture.read())[0]:
        mask = cv2.compare(subtractor.apply(shot[1]), 200, cv2.CMP_GT)
        mask = cv2.morphologyEx(
            cv2.morphologyEx(mask, cv2.MORPH_OPEN, window), cv2.MORPH_CLOSE, window
        )
        found = [
            cv2.boundingRect(each)
            for each in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
        ]
        boxes = np.array(
            [(x, y, x + w, y + h) for x, y, w, h in found if w * h > 5e-4 * size[0] * size[1]],
            np.float64,
        )
        for identity, box in tracker.update(boxes.reshape(-1, 4)):
            left, top, right, bottom = box.round().astype(int).tolist()
            cv2.rectangle(shot[1], (left, top), (right, bottom), (0, 255, 0), 2)
            cv2.putText(
                shot[1], str(identity), (left, top), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 255, 0), 2
            )
        if writer is not None:
            writer.write(shot[1])
        frames += 1
    if writer is not None:
        writer.release()
    return frames / (time.perf_counter() - began)


def detectors(video: Path, warm: int = 20) -> dict[str, float]:
    """Median milliseconds a frame: `change` at the command's width, shrinking included, and then
    MOG2 at the full one.

    One after the other, for each empties the other's caches.
    """
    from phdtrack.detect.detectors import make_detector, working_width
    from phdtrack.detect.scene_knowledge import study
    from phdtrack.video import open_source

    source = open_source(video)
    subtractor = cv2.createBackgroundSubtractorMOG2(detectShadows=True)
    change = make_detector("change", max_width=working_width("change", None, source.info))
    study(change, source, source.sample)
    taken: dict[str, list[float]] = {"change": [], "mog2": []}
    for name, times in taken.items():
        for frame in source:
            image = frame.image if name == "mog2" else None
            began = time.perf_counter()
            change(frame) if image is None else subtractor.apply(image)
            times.append(time.perf_counter() - began)
    return {name: 1e3 * float(np.median(times[warm:])) for name, times in taken.items()}


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Both sides in turn, with and without video, at every size."""
    if not scale.others:
        raise Skipped("not in this scale")
    if sys.platform == "win32":
        raise Skipped("this system does not tell the peak memory of a process that has ended")
    rows = list[Row]()
    entry = dict[str, Any]()
    for name, size in SIZES.items():
        # Only the sizes that have goals.
        if scale.name == "quick" and size.with_video is None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            video = Path(folder) / "video.mp4"
            out = Path(folder) / "plain.mp4"
            say(f"making {name}")
            make(video, size.width, size.height, size.frames * (3 if scale.name == "full" else 1))
            kinds = [("with video", size.with_video), ("--no-video", size.without)]
            kinds += [("--video-size 0", None)] if size.width > SHRUNK else []
            for kind, least in kinds:
                say(f"{name}, {kind}")
                options = kind.split() if kind.startswith("--") else []
                mine = ours(video, Path(folder), *options)
                other = plain(video, "-" if kind == "--no-video" else str(out))
                entry[f"{name} {kind}"] = {"phdtrack": mine, "plain loop": other}
                note = (
                    f"{mine['fps']:.0f} and {other['fps']:.0f} frames/s;"
                    f" {1e3 * mine['cpu'] / mine['frames']:.1f} ms of processor a frame,"
                    f" {mine['wall']:.1f} s in all"
                )
                rows.append(
                    Row(
                        f"phdtrack track against the plain loop, {name}, {kind}",
                        mine["fps"] / other["fps"],
                        "×",
                        least=least,
                        note=note,
                    )
                )
                most = MEMORY if name == "1080p" else None
                rows.append(
                    Row(
                        f"peak, {name}, {kind}",
                        mine["peak"],
                        "MiB",
                        most=most,
                        note=f"plain {other['peak']:.0f}",
                    )
                )
            each = detectors(video)
            entry[f"{name} detectors"] = each
            rows.append(
                Row(
                    f"change: time over MOG2's, {name}",
                    each["change"] / each["mog2"],
                    "×",
                    most=1.0,
                    note=f"{each['change']:.1f} and {each['mog2']:.1f} ms",
                )
            )
    return Outcome(tuple(rows), {"command": entry})


def main() -> None:
    """Parse the arguments."""
    if sys.argv[1:2] == ["--loop"]:
        print(json.dumps({"fps": loop(*sys.argv[2:4])}))
        return
    if sys.argv[1:2] == ["--detect"]:
        print(json.dumps(detectors(Path(sys.argv[2]))))
        return
    from dataclasses import replace

    from benchmarks.parts import QUICK

    for name in [name for name in SIZES if sys.argv[1:] and name not in sys.argv[1:]]:
        del SIZES[name]
    every = replace(QUICK, name="all")
    for row in run(every, lambda text: print(f"  … {text}", file=sys.stderr, flush=True)).rows:
        print(f"{row.what:60}{row.value:8.2f} {row.unit:10}{row.note}", flush=True)


if __name__ == "__main__":
    main()
