"""A camera whose pictures are mostly dropped: when that is a problem, and that it is not healthy
while nothing is tracked.
"""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
from camera_server import Clock, Scripted, until
from starlette.testclient import TestClient

from phdtrack.config import build_classes, load
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.live.live_page import live_app
from phdtrack.live.overload import Load, Overload
from phdtrack.types import Detections, Frame, SequenceInfo


class Held:
    """Finds a square; hangs while it is not ``free``."""

    def __init__(self) -> None:
        self.free = threading.Event()
        self.free.set()

    def __call__(self, frame: Frame) -> Detections:
        self.free.wait()
        return Detections.of(np.array([[40.0, 30, 64, 54]]))

    def reset(self) -> None: ...


def watched(folder: Path, source: Scripted, clock: Clock, detector: Held | None = None) -> Camera:
    def make(info: SequenceInfo) -> CameraParts:
        return CameraParts(detector or Held(), build_classes(load(preset="mot15"), info), info)

    return Camera("gate", source, make, CameraSettings(folder, video=0), clock=clock)


def second(one: Camera, source: Scripted, clock: Clock, dropped: int) -> None:
    """A second of 25 pictures, of which so many are dropped, and one is tracked."""
    source.number += 24
    source.dropped += dropped
    frame = source.next(0.0)
    assert frame is not None
    one.process(frame)
    clock.advance(1.0)


def test_most_pictures_dropped_is_a_problem(tmp_path: Path) -> None:
    clock = Clock()
    source = Scripted(rate=25.0)
    source.number = 10
    one = watched(tmp_path, source, clock)
    for _ in range(29):
        second(one, source, clock, 24)
        assert one.problems == []
    second(one, source, clock, 24)
    sentence = (
        "96 % of the pictures are dropped: the machine is too slow (1.0 of 24 pictures a second"
        " are tracked)"
    )
    assert one.problems == [sentence]
    # It is the same sentence while it lasts: a change would be another line of the log.
    for _ in range(3):
        second(one, source, clock, 20)
        assert one.problems == [sentence]
    for _ in range(30):
        second(one, source, clock, 0)
    assert one.problems == []
    assert one.stop(60.0)


def test_half_of_the_pictures_may_be_dropped() -> None:
    load = Overload(0.0)
    assert {load.update(Load(k, 50 * k, 25 * k, 25 * k)) for k in range(100)} == {""}


def test_an_overload_ends_below_its_beginning() -> None:
    load = Overload(0.0)
    dropped = arrived = 0
    said = list[bool]()
    for k, share in enumerate([30] * 40 + [22] * 40 + [15] * 40):
        said.append(bool(load.update(Load(k, arrived, dropped, 0))))
        arrived += 50
        dropped += share
    assert said[:30] == [False] * 30
    assert said[30:80] == [True] * 50
    assert not said[-1]


def test_a_silent_camera_is_no_overload() -> None:
    load = Overload(0.0)
    assert {load.update(Load(k, k // 5, k // 5, 0)) for k in range(100)} == {""}


def test_a_camera_that_tracks_nothing_is_not_healthy(tmp_path: Path) -> None:
    clock = Clock()
    detector = Held()
    one = watched(tmp_path, Scripted(), clock, detector)
    page = TestClient(live_app([one], 30.0))
    one.start()
    until(lambda: one.frames)
    assert page.get("/healthz").text == "ok\n"
    detector.free.clear()
    before = -1
    while before != one.frames:
        before = one.frames
        until(lambda: detector.free.wait(0.3) is False)
    clock.advance(31.0)
    answer = page.get("/healthz")
    expected = "gate without a tracked picture for 31 s, more than 30 s\n"
    assert (answer.status_code, answer.text) == (503, expected)
    detector.free.set()
    until(lambda: page.get("/healthz").status_code == 200)
    assert one.stop(60.0)
