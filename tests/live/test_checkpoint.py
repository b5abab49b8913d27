"""Restarts of a live camera: tracks, counts and identities go on, and what cannot be used is
said.
"""

from __future__ import annotations

import csv
import json
import sqlite3
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from camera_server import Clock

from appearance_cases import FPS, SIZE, frame_of, prototypes
from phdtrack.config import build_classes, load
from phdtrack.live.checkpoint import LOST, NAME, Checkpoints
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.live.events import Watch
from phdtrack.live.zones import Place
from phdtrack.types import Detections, SequenceInfo
from phdtrack.video.live_sources import LiveFrame, SourceStatus

DOOR = Place("door", ((80.0, 119.0), (80.0, 0.0)), closed=False)
START = 1_790_000_000.0


def run(
    folder: Path,
    *,
    sets: tuple[str, ...] = (),
    delay: int = 0,
    every: float = 1e9,
    clock: Clock | None = None,
) -> Camera:
    """A camera whose detector finds what the pictures say, and whose source is this test."""

    def make(info: SequenceInfo) -> CameraParts:
        found = load(None, ["associate.history=10", f"associate.output_delay={delay}", *sets])
        fixed = {"filter.kind": found.kind("filter")}
        return CameraParts(detect, build_classes(found, info), info, delay=delay, fixed=fixed)  # type: ignore[arg-type]

    def detect(frame: Any) -> Detections:
        left = int(frame.image[0, 0, 0])
        return Detections.of([[left, 50, left + 24, 90]] if left else np.zeros((0, 4)))

    source: Any = SimpleNamespace(
        status=lambda: SourceStatus(frames=100, fps=10.0), stop=lambda: None
    )
    settings = CameraSettings(folder, watch=Watch((DOOR,)), video=0, checkpoint=every)
    return Camera("gate", source, make, settings, clock=clock or Clock())


def show(one: Camera, lefts: list[int], wall: float, first: int = 0) -> None:
    """Pictures in which somebody is so far on the left, ten a second; 0: nobody. Numbers and times
    begin anew.
    """
    for k, left in enumerate(lefts, start=first):
        image = np.full((120, 160, 3), left, np.uint8)
        one.process(LiveFrame(k + 1, k / 10, wall + k / 10, image))


def stopped(folder: Path, steps: int, wall: float) -> Camera:
    """A camera that somebody walked past for so many steps, and that ended in order."""
    one = run(folder)
    show(one, [20 + 3 * k for k in range(steps)], wall)
    assert one.stop(10.0)
    return one


def crashed(one: Camera, *, saved: bool = True) -> None:
    """A process that was killed, after a checkpoint where that is to be saved now."""
    one.checkpoints.wait()
    if saved:
        one.save()
    one.log.close()
    one.rows.close()


def events(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def rows(folder: Path) -> list[dict[str, str]]:
    """All rows, by time."""
    found = list[dict[str, str]]()
    for path in (folder / "tracks").iterdir():
        with path.open() as file:
            found += csv.DictReader(file)
    return sorted(found, key=lambda row: row["time"])


def numbered(folder: Path) -> list[tuple[int, int]]:
    """Frame and identity of all rows, by time."""
    return [(int(row["frame"]), int(row["identity"])) for row in rows(folder)]


@pytest.mark.parametrize("delay", [0, 2])
def test_tracks_and_counts_continue_after_a_kill(tmp_path: Path, delay: int) -> None:
    first = run(tmp_path, delay=delay)
    show(first, [20 + 3 * k for k in range(20)], START)
    crashed(first)
    second = run(tmp_path, delay=delay)
    # Half a second was lost: five steps.
    show(second, [95 + 3 * k for k in range(12)], START + 2.4)
    assert second.problems == []
    assert second.running is not None
    assert second.running.tracker.state.time == pytest.approx(1.9 + 0.5 + 1.1)
    assert [event["kind"] for event in events(tmp_path)] == ["appear", "cross"]
    assert second.watched[1].counts[0].entered + second.watched[1].counts[0].left == 1
    assert second.running.maps.people.sum() > 20
    # 20 frames before and 12 after; somebody is confirmed in nearly all of them.
    assert sum(minute.frames for minute in second.minutes) == 32 - delay
    assert sum(minute.mean * minute.frames for minute in second.minutes) == pytest.approx(
        sum(row["confirmed"] == "1" for row in rows(tmp_path))
    )
    # Somebody else, later: identities that the killed run may have given are left out.
    show(second, [0] * 60 + [20 + 3 * k for k in range(12)], START + 2.4, 12)
    assert second.stop(10.0)
    assert [event["kind"] for event in events(tmp_path)] == ["appear", "cross", "leave", "appear"]
    found = [int(row["identity"]) for row in rows(tmp_path) if row["confirmed"] == "1"]
    assert set(found[:20]) == {1}
    assert max(found) > LOST
    assert len(set(found)) == 2
    frames = [row["frame"] for row in rows(tmp_path)]
    assert len(frames) == len(set(frames)), "no frame comes twice"


@pytest.mark.parametrize("hour", [0.0, 3600.0])
@pytest.mark.parametrize("delay", [0, 2])
def test_events_after_the_checkpoint_are_reported_once(
    tmp_path: Path, delay: int, hour: float
) -> None:
    """Somebody crosses, goes, and somebody else comes, all after the checkpoint; then it is killed,
    and starts at once, or in another hour, in whose file the rows are then."""
    first = run(tmp_path, delay=delay)
    show(first, [20 + 3 * k for k in range(15)], START)
    first.save()
    show(first, [65 + 3 * k for k in range(15)], START, 15)
    show(first, [0] * 50 + [20 + 2 * k for k in range(15)], START, 30)
    crashed(first, saved=False)
    before = events(tmp_path)
    assert [event["kind"] for event in before] == ["appear", "cross", "leave", "appear"]
    counts = first.watched[1].counts
    second = run(tmp_path, delay=delay)
    show(second, [45 + k for k in range(15)] + [0] * 50, START + 9.6 + hour)
    assert second.problems == []
    assert second.watched[1].counts == counts
    assert second.stop(10.0)
    after = events(tmp_path)
    assert after[: len(before)] == before
    # After an hour all are others. At once he is a track of another number, as the checkpoint did
    # not know him.
    assert sorted(event["kind"] for event in after[len(before) :]) == ["appear", "leave", "leave"]
    gone = [event["identity"] for event in after if event["kind"] == "leave"]
    assert sorted(gone) == sorted(event["identity"] for event in after if event["kind"] == "appear")
    numbers = numbered(tmp_path)
    assert len(numbers) == len(set(numbers))
    assert numbers == sorted(numbers)


def test_a_kill_soon_after_an_end_in_order_repeats_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checkpoint is that of the end before."""
    stopped(tmp_path, 10, START)
    second = run(tmp_path)
    with monkeypatch.context() as never:
        never.setattr(Checkpoints, "write", lambda *given, **more: None)
        show(second, [20 + 3 * k for k in range(25)], START + 100)
        crashed(second, saved=False)
    third = run(tmp_path)
    show(third, [20 + 3 * k for k in range(10)], START + 200)
    assert third.problems == []
    assert third.watched[1].counts == second.watched[1].counts
    assert third.stop(10.0)
    appeared = [event["identity"] for event in events(tmp_path) if event["kind"] == "appear"]
    assert len(appeared) == len(set(appeared)) == 3
    assert len(numbered(tmp_path)) == len(set(numbered(tmp_path)))


@pytest.mark.parametrize("end", ["killed", "stopped"])
def test_a_restart_does_not_count_unwritten_events(tmp_path: Path, end: str) -> None:
    clock = Clock()
    one = run(tmp_path, every=0.5, clock=clock)
    show(one, [20 + 3 * k for k in range(10)], START)
    one.checkpoints.wait()
    other = sqlite3.connect(tmp_path / "events.sqlite", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    for k in range(10):
        # A checkpoint is due with each picture.
        clock.advance(0.5)
        show(one, [50 + 3 * k], START, 10 + k)
        one.checkpoints.wait()
    assert "events are still to be written" in one.problems[0]
    assert not one.stop(10.0) if end == "stopped" else crashed(one, saved=False) is None
    other.close()
    second = run(tmp_path)
    show(second, [80 + 3 * k for k in range(10)], START + 2.0)
    assert second.stop(10.0)
    crossed = [event for event in events(tmp_path) if event["kind"] == "cross"]
    assert len(crossed) == second.watched[1].counts[0].entered + second.watched[1].counts[0].left


def test_lagging_event_lines_are_written_without_a_new_event(tmp_path: Path) -> None:
    clock = Clock()
    one = run(tmp_path, clock=clock)
    lines = tmp_path / "events.jsonl"
    lines.mkdir()
    show(one, [20 + 3 * k for k in range(25)], START)
    (said,) = one.problems
    assert "events.jsonl is still to be brought up to date" in said
    lines.rmdir()
    clock.advance(1.0)
    show(one, [95], START, 25)
    assert one.problems == []
    assert [event["kind"] for event in events(tmp_path)] == ["appear", "cross"]
    assert one.stop(10.0)


def test_a_checkpoint_that_cannot_be_read_now_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped(tmp_path, 25, START)
    second = run(tmp_path)
    with monkeypatch.context() as busy:

        def full(path: Path) -> bytes:
            raise OSError(24, "Too many open files")

        busy.setattr(Path, "read_bytes", full)
        with pytest.raises(OSError, match="Too many open files"):
            show(second, [20], START + 9)
    show(second, [20], START + 9)
    assert second.watched[1].counts[0].entered + second.watched[1].counts[0].left == 1
    assert second.stop(10.0)


def test_after_an_end_in_order_identities_go_on_without_a_gap(tmp_path: Path) -> None:
    for k in range(3):
        assert stopped(tmp_path, 10, START + 100 * k).problems == []
    assert [event["identity"] for event in events(tmp_path) if event["kind"] == "appear"] == [
        1,
        2,
        3,
    ]


@pytest.mark.parametrize(("what", "says"), [
    ("damaged", "cut off or changed"), ("settings", "differs in: settings"),
    ("state", "cut off or changed"), ("missing", ""),
])  # fmt: skip
def test_after_an_unusable_checkpoint_identities_are_new(
    tmp_path: Path, what: str, says: str
) -> None:
    first = run(tmp_path)
    show(first, [20 + 3 * k for k in range(10)], START)
    if what == "state":
        assert first.running is not None
        saved = first.running.tracker.state_dict()
        saved["state"] = saved["state"][:-1]
        first.running.tracker.snapshot = lambda: lambda: saved  # type: ignore[method-assign]
    crashed(first)
    file = tmp_path / NAME
    if what == "damaged":
        file.write_bytes(file.read_bytes()[:-20])
    if what == "missing":
        file.unlink()
    second = run(tmp_path, sets=("filter.kind=gm-phd",) if what == "settings" else ())
    show(second, [20 + 3 * k for k in range(10)], START + 5)
    assert ["begin anew" in problem and says in problem for problem in second.problems] == [
        True
    ] * (what != "missing")
    assert second.watched[1].counts[0].entered == 0
    appeared = [event["identity"] for event in events(tmp_path) if event["kind"] == "appear"]
    assert appeared[0] == 1
    assert appeared[1] > LOST
    assert second.stop(10.0)
    assert not second.alive


def test_without_the_option_there_is_none(tmp_path: Path) -> None:
    one = run(tmp_path, every=0.0)
    show(one, [20 + 3 * k for k in range(10)], START)
    assert one.stop(10.0)
    assert not (tmp_path / NAME).exists()


def test_it_is_written_beside_the_loop_when_it_is_due(tmp_path: Path) -> None:
    clock = Clock()
    one = run(tmp_path, every=10.0, clock=clock)
    show(one, [20, 23], START)
    # The first one at once: who is killed before it has nothing to go on with.
    one.checkpoints.wait()
    written = [(tmp_path / NAME).read_bytes()]
    for seconds in (9.9, 0.1, 9.9, 0.1):
        clock.advance(seconds)
        assert one.checkpoints.due == (seconds == 0.1)
        show(one, [26], START, 1 + len(written))
        one.checkpoints.wait()
        assert not one.checkpoints.due
        written.append((tmp_path / NAME).read_bytes())
    changed = [before != after for before, after in pairwise(written)]
    assert changed == [False, True, False, True]
    assert one.stop(10.0)


PEOPLE = (0, 1, 2, 3, 4)
LOOKS = prototypes(8)


def described(folder: Path) -> Camera:
    """A camera whose pictures name the frame of a scene, and who is in it; its detector knows what
    they look like.
    """

    def make(info: SequenceInfo) -> CameraParts:
        return CameraParts(detect, build_classes(load(None), info), info)  # type: ignore[arg-type]

    def detect(frame: Any) -> Detections:
        k = int(frame.image[0, 0, 0]) + 200 * int(frame.image[0, 0, 1])
        return frame_of(np.flatnonzero(frame.image[1, :8, 0]).tolist(), k, LOOKS)

    source: Any = SimpleNamespace(
        status=lambda: SourceStatus(frames=100, fps=FPS), stop=lambda: None
    )
    settings = CameraSettings(folder, video=0, checkpoint=1e9)
    return Camera("gate", source, make, settings, clock=Clock())


def show_people(one: Camera, frames: range, people: tuple[int, ...]) -> None:
    """Pictures of these people, ten a second, whose numbers and times begin anew with a camera."""
    for number, k in enumerate(frames, start=one.frames + 1):
        image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
        image[0, 0, :2] = k % 200, k // 200
        image[1, list(people), 0] = 1
        one.process(LiveFrame(number, number / FPS, START + k / FPS, image))


@pytest.mark.parametrize("killed", [False, True])
def test_who_left_before_a_restart_is_known_after_it(tmp_path: Path, killed: bool) -> None:
    """Somebody leaves 3 s before the program ends, and comes back 4 s after it has started again;
    another one, who was never there, is new.
    """
    first = described(tmp_path)
    show_people(first, range(150), PEOPLE)
    left = {int(row["identity"]) for row in rows(tmp_path) if row["confirmed"] == "1"}
    show_people(first, range(150, 180), PEOPLE[1:])
    assert first.returned == 0
    if killed:
        crashed(first)
    else:
        assert first.stop(10.0)
    second = described(tmp_path)
    show_people(second, range(230, 270), PEOPLE[1:])
    assert second.problems == []
    assert second.returned == 0
    show_people(second, range(270, 300), (*PEOPLE, 6))
    assert second.returned == 1
    assert second.running is not None
    (pair,) = second.running.tracker.returns
    assert pair.identity in left
    now = {int(row["identity"]) for row in rows(tmp_path)[-6:]}
    assert pair.identity in now
    assert second.stop(10.0)
    third = described(tmp_path)
    show_people(third, range(300, 303), PEOPLE)
    assert third.returned == 0
    assert third.stop(10.0)
