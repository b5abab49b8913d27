"""Memory of runs without end, in a few thousand frames: the blocks that Python's allocator has
given.

That does not depend on the machine. An array that is kept is one block or more. To trace bytes
would take ten times as long.
"""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from experiments.soak import HEIGHT, WIDTH, Replayed, boxes
from phdtrack.config import build_classes, load
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.report import About
from phdtrack.run.directory import claim
from phdtrack.run.inputs import Inputs
from phdtrack.run.loop import NO_PICTURE
from phdtrack.run.running import RunOptions
from phdtrack.run.video import run
from phdtrack.types import Detections, Frame, SequenceInfo
from phdtrack.video import VideoSource

# The same frames come again after so many. All memories are full at `BEGUN`; from `LEAKING` on
# something leaks.
ROUND = 300
BEGUN = 2700
LEAKING = 3900
ENDED = 5100
# Blocks a frame: `track` keeps a tuple of numbers for its report of the last 100 000 frames
# (measured: 8.9, with the leak 12), `live` nothing (0.4, and 2.7). What is learned settles for some
# thousand frames, which is worth up to 1.
REPORTED = 9.5
NOTHING = 0.0
SLACK = 1.0


class Given:
    """A detector that has the boxes; from `LEAKING` on it keeps three small arrays of each
    frame.
    """

    def __init__(self) -> None:
        given = boxes()
        self._round = [next(given) for _ in range(ROUND)]
        self._kept = list[np.ndarray]()

    def __call__(self, frame: Frame) -> Detections:
        found = self._round[frame.number % ROUND]
        if frame.number >= LEAKING:
            self._kept += [np.zeros(10) for _ in range(3)]
        return Detections.of(found[:, :4], found[:, 4])

    def reset(self) -> None: ...


class Traced:
    """Notes the blocks that are held after certain frames."""

    def __init__(self) -> None:
        self.held = dict[int, int]()

    def frame(self, number: int) -> None:
        if number in (BEGUN, LEAKING, ENDED):
            gc.collect()
            self.held[number] = sys.getallocatedblocks()

    def growth(self, begin: int, end: int) -> float:
        """Blocks a frame."""
        return (self.held[end] - self.held[begin]) / (end - begin)


def tracked(folder: Path, given: Given, traced: Callable[[int], None]) -> None:
    """`phdtrack track` on rows without an end, two frames a second, of which it remembers 120
    seconds.
    """
    info = SequenceInfo(WIDTH, HEIGHT, 2.0, 0, "soak")

    def read(source: VideoSource) -> Iterator[tuple[int, float, np.ndarray, str]]:
        for number in range(1, ENDED + 5):
            traced(number)
            yield number, (number - 1) / info.fps, NO_PICTURE, ""

    inputs = Inputs(
        info, VideoSource(info, read), given, "soak", "soak", pictures=False, again=False
    )
    kinds = build_classes(load(None, ["associate.history=120"]), info)
    directory = claim(folder / "run", overwrite=False, name="soak")
    options = RunOptions(About("soak"), read={"source": "soak"})
    assert run(inputs, kinds, directory, options=options).stop is None


def watched(folder: Path, given: Given, traced: Callable[[int], None]) -> None:
    """A camera."""
    done = threading.Event()

    def through(number: int) -> None:
        traced(number)
        if number == ENDED:
            done.set()

    def make(info: SequenceInfo) -> CameraParts:
        return CameraParts(given, build_classes(load(None, ["associate.history=10"]), info), info)

    camera = Camera(
        "soak", Replayed(ENDED, through), make, CameraSettings(folder / "camera", video=0.0)
    )  # type: ignore[arg-type]
    camera.start()
    assert done.wait(300.0)
    assert camera.stop(60.0)
    assert not camera.problems


@pytest.mark.slow
@pytest.mark.parametrize(("part", "usual"), [(tracked, REPORTED), (watched, NOTHING)])
def test_memory_of_a_frame_is_given_back(
    part: Callable[[Path, Given, Callable[[int], None]], None],
    usual: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    # What is kept of some thousand frames at most is full sooner.
    monkeypatch.setattr("phdtrack.run.video.SAMPLE", 100)
    for name in ("MAX_LATENCIES", "MAX_RECENT"):
        monkeypatch.setattr(f"phdtrack.live.engine.{name}", 20)
    traced = Traced()
    part(tmp_path, Given(), traced.frame)
    assert traced.growth(BEGUN, LEAKING) < usual + SLACK
    # Three small arrays a frame would be noticed.
    assert traced.growth(LEAKING, ENDED) > usual + SLACK
