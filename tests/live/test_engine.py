"""A camera at work: events and files of what is seen, restarts, reloading, and that it ends
whatever hangs.
"""

from __future__ import annotations

import csv
import json
import sqlite3
import threading
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from camera_server import SIDE, WALL, Scripted, until

from phdtrack.config import build_classes, build_groups, load
from phdtrack.groups.group_stages import OnlineGroups
from phdtrack.live import checkpoint
from phdtrack.live.engine import Camera, CameraParts, CameraSettings
from phdtrack.live.events import Event, Maps, Watch
from phdtrack.live.outputs import SnapshotLog, VideoLog, stamp
from phdtrack.live.zones import Place, write_places
from phdtrack.tracker import Tracker
from phdtrack.types import Detections, Frame, SequenceInfo
from phdtrack.video import open_source

DOOR = Place("door", ((80.0, 119.0), (80.0, 0.0)), closed=False)


class Bright:
    """Finds what is white; hangs while `hold` is set, and raises while `fails` is."""

    def __init__(self) -> None:
        self.hold = threading.Event()
        self.hangs = threading.Event()
        self.fails = False

    def __call__(self, frame: Frame) -> Detections:
        if self.fails:
            raise ZeroDivisionError
        while self.hold.is_set():
            self.hangs.set()
            time.sleep(0.02)
        x, y, width, height = cv2.boundingRect((frame.image[..., 0] > 128).astype(np.uint8))
        return Detections.of(
            np.array([[x, y, x + width, y + height]][: int(width > 0)], float).reshape(-1, 4)
        )

    def reset(self) -> None: ...


def camera(
    source: Scripted,
    settings: CameraSettings,
    detector: Bright | None = None,
    config: Path | None = None,
    delay: int = 0,
    made: list[CameraParts] | None = None,
) -> Camera:
    """A started camera; it remembers ten seconds. Its parts are added to ``made``."""

    def make(info: SequenceInfo) -> CameraParts:
        found = load(config, ["associate.history=10", f"associate.output_delay={delay}"])
        parts = CameraParts(
            detector or Bright(),
            build_classes(found, info),
            info,
            delay,
            {"filter.kind": found.kind("filter")},
        )
        if made is not None:
            made.append(parts)
        return parts

    one = Camera("gate", source, make, settings)
    one.start()
    return one


def replaced(path: Path, text: str) -> None:
    """A file with another text, at once: whoever reads it meanwhile has the old or the new one."""
    path.with_suffix(".new").write_text(text)
    path.with_suffix(".new").replace(path)


def events(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def unfinished(folder: Path) -> list[Path]:
    return list(folder.rglob("*.part"))


def test_who_walks_to_and_fro_is_counted_and_kept(tmp_path: Path) -> None:
    source = Scripted(last=100)
    begun = time.time()
    one = camera(source, CameraSettings(tmp_path, watch=Watch((DOOR,)), video=5.0))
    number, picture = one.picture(patience=600.0)
    assert picture is not None
    until(lambda: source.through == 100)
    number, _ = one.picture()
    source.last = 200
    later, _ = one.picture(after=number, patience=600.0)
    assert later > number
    until(lambda: source.through == 200)
    assert one.stop(600.0)
    known = events(tmp_path)
    crossed = [event["direction"] for event in known if event["kind"] == "cross"]
    # 9.5 s, from the right; the first turn may come before anybody is confirmed.
    assert len(crossed) in (4, 5)
    assert all(a != b for a, b in pairwise(crossed))
    assert [event["kind"] for event in known].count("appear") == 1
    assert known[0]["kind"] == "appear"
    assert one.watched[1].counts[0].entered == crossed.count("in")
    with next((tmp_path / "tracks").glob("*.csv")).open() as file:
        rows = list(csv.DictReader(file))
    assert {row["identity"] for row in rows if row["confirmed"] == "1"} == {
        str(known[0]["identity"])
    }
    (video,) = (tmp_path / "video").glob("*.mp4")
    assert len(list(open_source(video))) == pytest.approx(5 * one.frames / source.rate, abs=2)
    assert unfinished(tmp_path) == []
    assert one.minutes[-1].most == 1
    median, most = one.latency()
    assert begun - (WALL + 200 / source.rate) <= median <= most <= time.time() - WALL
    assert one.running is not None
    maps = one.running.maps
    row = int((50 + SIDE) / maps.cell)
    assert maps.people[row - 1 : row + 2].sum() > 0.95 * maps.people.sum() > 10


def test_events_at_a_place_have_pictures_of_which_the_last_stay(tmp_path: Path) -> None:
    source = Scripted(last=200)
    one = camera(source, CameraSettings(tmp_path, watch=Watch((DOOR,)), video=0, snapshots=2))
    until(lambda: source.through == 200)
    assert one.stop(600.0)
    known = events(tmp_path)
    assert {"snapshot" in event for event in known if event["kind"] != "cross"} == {False}
    named = [str(event["snapshot"]) for event in known if event["kind"] == "cross"]
    assert len(named) == len(set(named)) >= 4
    files = sorted((tmp_path / "snapshots").iterdir())
    assert [file.relative_to(tmp_path).as_posix() for file in files] == named[-2:]
    assert one.snapshots.newest == files[-1]
    picture = cv2.imread(str(files[-1]))
    # The box is drawn in the colour of its identity; the scene itself is grey.
    coloured = np.ptp(picture.astype(int), axis=2) > 60
    last = [event for event in known if event["kind"] == "cross"][-1]
    y, x = np.nonzero(coloured)
    assert abs(x.mean() - float(str(last["x"]))) < 40
    assert abs(y.max() - float(str(last["y"]))) < 40


def test_a_picture_that_cannot_be_written_stops_no_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: SnapshotLog, *given: object) -> Path:
        raise OSError("no space left on device")

    monkeypatch.setattr(SnapshotLog, "write", full)
    one = camera(Scripted(), CameraSettings(tmp_path, watch=Watch((DOOR,)), video=0, snapshots=2))
    until(lambda: one.counted["cross"] > 1)
    assert "a picture of an event cannot be written: no space left" in "\n".join(one.problems)
    assert one.stop(600.0)


def test_a_restart_gives_events_names_of_their_own(tmp_path: Path) -> None:
    names = list[object]()
    for k in range(2):
        one = camera(Scripted(wall=WALL + 400 * k), CameraSettings(tmp_path, video=0))
        until(lambda one=one: one.counted["appear"])
        assert one.stop(600.0)
        names = [event["id"] for event in events(tmp_path) if event["kind"] == "appear"]
    assert len(names) == len(set(names)) == 2


def test_places_and_settings_change_while_it_runs(tmp_path: Path) -> None:
    places = tmp_path / "places.toml"
    config = tmp_path / "mine.toml"
    config.write_text("[sensor]\ndetection_probability = 0.95\n")
    made = list[CameraParts]()
    settings = CameraSettings(tmp_path / "out", places, config, video=0)
    one = camera(Scripted(), settings, config=config, made=made)
    until(lambda: one.counted["appear"])
    write_places(places, (DOOR,))
    until(lambda: one.counted["cross"])
    assert one.problems == []
    replaced(places, "[[line]]\npoints = 3\n")
    until(lambda: one.problems)
    assert "the places stay as they were" in one.problems[0]
    assert one.watched[0].places == (DOOR,)
    write_places(places, (DOOR,))
    until(lambda: not one.problems)
    replaced(config, "[sensor]\ndetection_probability = 0.9\n")
    until(lambda: made[-1].classes.usual.model.sensor.detection_probability == 0.9)
    replaced(config, '[filter]\nkind = "gm-phd"\n')
    until(lambda: one.problems)
    assert "filter.kind cannot change while it runs" in one.problems[0]
    seen = one.frames
    until(lambda: one.frames > seen + 20)
    assert one.stop(600.0)
    # Nobody appeared anew when the settings changed.
    assert [event["kind"] for event in events(tmp_path / "out")].count("appear") == 1


def test_settings_that_cannot_be_worked_with_stop_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "mine.toml"
    config.write_text("")
    one = camera(Scripted(), CameraSettings(tmp_path / "out", None, config, video=0), config=config)
    until(lambda: one.frames > 5)
    monkeypatch.setattr(Tracker, "warm_up", lambda self: [][1])
    replaced(config, "[sensor]\ndetection_probability = 0.9\n")
    until(lambda: one.problems)
    assert one.problems == ["the settings stay as they were: list index out of range"]
    seen = one.frames
    until(lambda: one.frames > seen + 5)
    assert one.stop(600.0)


def test_a_first_picture_that_fails_leaves_what_was_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next one takes it up: half of it would be saved as all that there is."""
    settings = CameraSettings(tmp_path, watch=Watch((DOOR,)), video=0, checkpoint=0.2)
    one = camera(Scripted(last=100), settings)
    until(lambda: one.counted["cross"] > 1)
    assert one.stop(600.0)
    before = one.watched[1].counts[0]
    failed = list[Path]()
    real = checkpoint.load

    def failing(folder: Path, key: str) -> object:
        failed.append(folder)
        if len(failed) < 3:
            raise MemoryError
        return real(folder, key)

    monkeypatch.setattr("phdtrack.live.engine.load", failing)
    one = camera(Scripted(wall=WALL + 400), settings)
    until(lambda: len(failed) == 3 and one.frames)
    after = one.watched[1].counts[0]
    assert after.entered + after.left >= before.entered + before.left > 0
    assert one.stop(600.0)


def test_a_failure_at_the_end_is_reported(
    tmp_path: Path,
) -> None:
    one = camera(Scripted(), CameraSettings(tmp_path, video=0))
    until(lambda: one.frames > 5)

    def full() -> None:
        raise sqlite3.OperationalError("database or disk is full")

    one.log.close, close = full, one.log.close  # type: ignore[method-assign]
    assert not one.stop(600.0)
    assert one.problems == ["database or disk is full"]
    close()


@pytest.mark.parametrize("what", ["camera", "detector"])
def test_it_ends_in_time_with_whole_files_whatever_hangs(tmp_path: Path, what: str) -> None:
    source = Scripted()
    detector = Bright()
    one = camera(source, CameraSettings(tmp_path), detector)
    until(lambda: one.counted["appear"])
    if what == "camera":
        source.frozen = True
        until(lambda: source.through == source.number)
    else:
        detector.hold.set()
        until(detector.hangs.is_set)
    begun = time.monotonic()
    assert one.stop()
    # What hangs would do so for ever; half the bound is the machine's.
    assert time.monotonic() - begun < 20
    assert unfinished(tmp_path) == []
    assert events(tmp_path)
    detector.hold.clear()


def test_it_ends_in_time_if_an_encoder_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoder = Bright()
    monkeypatch.setattr(VideoLog, "write", lambda self, image, wall: encoder(Frame(1, 0.0, image)))
    one = camera(Scripted(), CameraSettings(tmp_path))
    until(lambda: one.counted["appear"])
    encoder.hold.set()
    until(encoder.hangs.is_set)
    begun = time.monotonic()
    assert not one.stop()
    assert time.monotonic() - begun < 20
    assert events(tmp_path)
    encoder.hold.clear()
    # Once it moves again, all can be completed.
    assert one.stop(600.0)
    assert unfinished(tmp_path) == []


def test_events_that_a_full_disk_refused_are_written_later(tmp_path: Path) -> None:
    one = camera(Scripted(), CameraSettings(tmp_path, video=0))
    write = one.log.write
    refused = list[object]()

    def full(*given):
        refused.append(given)
        if len(refused) < 4:
            raise OSError(28, "No space left on device")
        return write(*given)

    one.log.write = full
    until(lambda: one.counted["appear"])
    until(lambda: not one.problems)
    assert len(refused) >= 4
    assert one.stop(600.0)
    assert events(tmp_path)[0]["kind"] == "appear"


def test_a_locked_table_keeps_no_picture_waiting(tmp_path: Path) -> None:
    one = camera(Scripted(), CameraSettings(tmp_path, video=0))
    other = sqlite3.connect(tmp_path / "events.sqlite", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    until(lambda: one.problems)
    assert one.problems == [
        "events are still to be written, the last 1000 are kept: database is locked"
    ]
    seen = one.frames
    until(lambda: one.frames > seen + 20)
    assert not one.counted
    assert one.tracks == 1
    other.execute("ROLLBACK")
    until(lambda: one.counted["appear"])
    assert one.problems == []
    assert one.stop(600.0)
    other.close()
    assert [event["kind"] for event in events(tmp_path)] == ["appear"]
    with next((tmp_path / "tracks").glob("*.csv")).open() as file:
        numbers = [int(row["frame"]) for row in csv.DictReader(file)]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))


def test_a_camera_whose_pictures_all_fail_is_not_at_work(tmp_path: Path) -> None:
    detector = Bright()
    one = camera(Scripted(), CameraSettings(tmp_path, video=0), detector)
    until(lambda: one.frames > 5)
    assert one.working
    detector.fails = True
    until(lambda: not one.working)
    assert one.alive
    detector.fails = False
    until(lambda: one.working)
    assert one.stop(600.0)


def test_a_rewritten_file_of_places_is_read_when_complete(
    tmp_path: Path,
) -> None:
    places = tmp_path / "places.toml"
    write_places(places, (DOOR,))
    text = places.read_text()
    one = camera(Scripted(), CameraSettings(tmp_path / "out", places, video=0))
    until(lambda: one.counted["cross"])
    counts = one.watched[1].counts[0]
    with places.open("w") as file:
        file.flush()
        seen = one.frames
        until(lambda: one.frames > seen + 5)
        watch = one.watched[0]
        file.write(text + "# the same\n")
    until(lambda: one.watched[0] is not watch)
    assert one.watched[0].places == (DOOR,)
    assert one.watched[1].counts[0].entered >= counts.entered
    assert one.watched[1].counts[0].left >= counts.left
    assert one.stop(600.0)


def test_rows_that_come_late_go_with_their_frames(tmp_path: Path) -> None:
    source = Scripted(last=60)
    one = camera(source, CameraSettings(tmp_path, video=0), delay=3)
    until(lambda: source.through == 60)
    assert one.stop(600.0)
    with next((tmp_path / "tracks").glob("*.csv")).open() as file:
        rows = [row for row in csv.DictReader(file) if row["confirmed"] == "1"]
    assert rows[-1]["frame"] == "60"
    for row in rows:
        assert row["time"] == stamp(WALL + int(row["frame"]) / source.rate)
    times = [row["time"] for row in rows]
    assert times == sorted(times)
    assert len(set(times)) == len(times)


def test_groups_on_the_ground_are_events(tmp_path: Path) -> None:
    info = SequenceInfo(60, 60, 5.0)
    found = load(
        sets=[
            "motion.kind=plane",
            "sensor.scaling=fixed",
            "sensor.fixed_noise=0.1",
            "camera.region=[-30,-30,30,30]",
        ]
    )
    classes = build_classes(found, info)
    groups = OnlineGroups(build_groups(found, classes.usual), classes.usual, first=8)
    tracker = Tracker(stages=classes, fps=5.0)
    told = []
    for k in range(1, 41):
        # Two walk together, a third far from them.
        centre = np.array([[0.2 * k - 4, 0.0], [0.2 * k - 4, 0.8], [4 - 0.2 * k, 15.0]])
        rows = tracker.update(Detections.of(np.hstack([centre - 0.3, centre + 0.3])), k, k / 5)
        mixture = groups.mixture(tracker.state.intensity, tracker.step)
        told += [
            Event.of_group(one)
            for one in groups.events(mixture, rows.select(rows.confirmed), k, k / 5)
        ]
    assert [(event.kind, event.place) for event in told] == [("group", "appear")] * 2
    # Numbers of an earlier run are not given again.
    assert min(event.identity for event in told) >= 8
    assert all(0 < event.time < 8 for event in told)


def test_maps_fade_and_leave_out_what_is_outside() -> None:
    maps = Maps.of(640, 480)
    maps.add(0.0, np.array([[5.0, 5.0], [-1.0, 5.0], [700.0, 5.0]]), np.zeros((0, 4)), np.zeros(0))
    maps.add(3600.0, np.zeros((0, 2)), np.array([[100.0, 100.0, 110.0, 110.0]]), np.array([0.75]))
    assert maps.people.sum() == maps.people[0, 0] == pytest.approx(0.5)
    assert maps.clutter[10, 10] == maps.clutter.sum() == 0.75


def test_warnings_of_its_tracker_are_kept(tmp_path: Path) -> None:
    """Each once, also when its settings are read again; pauses of a camera are no jumps."""
    config = tmp_path / "mine.toml"
    config.write_text("[extract]\nmin_weight = 0.999999999\n")
    source = Scripted(last=200)
    made = list[CameraParts]()
    one = camera(source, CameraSettings(tmp_path, config=config), config=config, made=made)
    until(lambda: source.through == 200)
    assert len(one.warnings) == 1
    assert "detections that recur in 6 or more frames in a row" in one.warnings[0]
    replaced(config, "[extract]\nmin_weight = 0.9999999999\n")
    until(lambda: len(made) == 2)
    source.last = 400
    until(lambda: source.through == 400)
    assert one.stop(600.0)
    assert len(one.warnings) == 1
