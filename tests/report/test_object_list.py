"""The list of objects, the minutes, and the thumbnails of a report."""

from __future__ import annotations

import base64
import csv
import io

import cv2
import numpy as np
import pytest

from phdtrack.report.object_list import (
    BAR_UNITS,
    bar_seconds,
    heatmap_csv,
    minutes,
    minutes_csv,
    objects,
    objects_csv,
    visited,
)
from phdtrack.report.pages import clock
from phdtrack.report.thumbnails import Thumbnails
from phdtrack.types import Frame, SequenceInfo, Tracks

FPS = 10.0
NUMBERS = np.arange(1, 1201)
TIMES = (NUMBERS - 1) / FPS


def walk(
    identity: int, first: int, last: int, speed: float, height: float = 40.0, **more: object
) -> Tracks:
    """Rows of one object that walks to the right, ``speed`` pixels a second."""
    frame = np.arange(first, last + 1)
    x = 20 + speed * (frame - first) / FPS
    boxes = np.stack([x, 0 * x + 60, x + 20, 0 * x + 60 + height], axis=1)
    count = len(frame)
    return Tracks(
        **{
            "frame": frame,
            "identity": np.full(count, identity),
            "xyxy": boxes,
            "confidence": np.ones(count),
            "class_id": np.zeros(count, np.int64),
            "detection": np.zeros(count, np.int64),
            "confirmed": np.ones(count, np.bool_),
        }
        | more
    )


def test_objects_have_times_path_and_speed() -> None:
    tracks = Tracks.concatenate([walk(7, 101, 200, 25.0), walk(3, 1, 51, 0.0, height=80.0)])
    standing, walking = objects(tracks, NUMBERS, TIMES, {0: "person"})
    assert (standing.identity, walking.identity) == (3, 7)
    assert (walking.first, walking.last, walking.boxes) == (10.0, 19.9, 100)
    assert walking.seconds == pytest.approx(9.9)
    assert walking.name == "person"
    assert walking.speed == pytest.approx(25.0, rel=1e-6)
    assert walking.speed_in_heights == pytest.approx(25.0 / 40, rel=1e-6)
    # Half a second at both ends goes into the means.
    assert walking.distance == pytest.approx(25.0 * 9.5, rel=1e-6)
    assert standing.speed == standing.distance == 0.0


def test_trembling_boxes_go_nowhere(rng: np.random.Generator) -> None:
    still = walk(1, 1, 600, 0.0)
    shaken = still.xyxy + rng.normal(0, 2.0, (600, 1))
    (one,) = objects(walk(1, 1, 600, 0.0, xyxy=shaken), NUMBERS, TIMES)
    raw = np.abs(np.diff(shaken[:, 0])).sum()
    assert one.distance < raw / 5


def test_an_object_seen_once_has_no_speed() -> None:
    (one,) = objects(walk(1, 5, 5, 0.0), NUMBERS, TIMES)
    assert np.isnan(one.speed)
    (row,) = csv.DictReader(io.StringIO(objects_csv([one])))
    assert row["speed"] == row["speed_in_heights"] == ""
    assert float(row["first"]) == 0.4


def test_minutes_count_who_was_there_and_who_came() -> None:
    tracks = Tracks.concatenate([walk(1, 1, 700, 1.0), walk(2, 650, 1200, 1.0)])
    found = objects(tracks, NUMBERS, TIMES)
    count = np.array([(tracks.frame == number).sum() for number in NUMBERS])
    rows = minutes(found, TIMES, count, 60.0)
    assert [row.start for row in rows] == [0.0, 60.0]
    assert [row.objects for row in rows] == [1, 2]
    assert [row.arrived for row in rows] == [1, 1]
    assert rows[0].mean == 1.0
    assert rows[1].mean == pytest.approx((100 + 551) / 600)
    assert sum(row.arrived for row in rows) == len(found)
    head, *lines = minutes_csv(rows).splitlines()
    assert head == "start,objects,arrived,mean"
    assert lines[0] == "0.000,1,1,1.00"
    assert minutes([], np.zeros(0), np.zeros(0, np.int64), 60.0) == []


@pytest.mark.parametrize("away", [1e3, 1e9, 1e12])
def test_minutes_without_a_frame_are_left_out(away: float) -> None:
    """And each frame is in one minute, wherever rounding puts its edge."""
    rng = np.random.default_rng(1)
    times = np.sort(np.concatenate([np.arange(0, 120, 0.1), away + rng.uniform(0, 200, 900)]))
    count = rng.integers(0, 4, len(times))
    rows = minutes([], times, count, 60.0)
    assert 5 <= len(rows) <= 7
    assert [row.start for row in rows[:2]] == [0.0, 60.0]
    seen = [np.count_nonzero((times >= row.start) & (times < row.start + 60)) for row in rows]
    assert min(seen) > 0
    assert sum(seen) == len(times)
    total = sum(row.mean * frames for row, frames in zip(rows, seen, strict=True))
    assert total == pytest.approx(count.sum())


@pytest.mark.parametrize(
    ("total", "unit"),
    [
        (0.0, "second"),
        (20.0, "second"),
        (60.0, "10 seconds"),
        (1200.0, "minute"),
        (7200.0, "minute"),
        (86400.0, "hour"),
        (864000.0, "day"),
        (4e7, "30 days"),
    ],
)
def test_a_chart_has_few_bars_however_long_the_run_is(total: float, unit: str) -> None:
    """A row a billion frames away made eleven thousand bars, which took minutes to draw."""
    width = bar_seconds(total)
    assert BAR_UNITS[width] == unit
    assert total / width <= 180


def test_visited_cells_are_under_the_feet() -> None:
    info = SequenceInfo(width=200, height=100, fps=FPS)
    inside = visited(walk(1, 1, 10, 0.0, height=38.0), info, 20)
    assert inside.shape == (10, 20)
    assert inside.sum() == 10
    assert inside[9, 3] == 10


def test_heatmap_is_a_row_for_each_visited_cell() -> None:
    info = SequenceInfo(width=160, height=100, fps=FPS)
    tracks = Tracks.concatenate([walk(1, 1, 30, 0.0, height=33.0), walk(2, 1, 10, 0.0, 13.0)])
    rows = list(csv.DictReader(io.StringIO(heatmap_csv(tracks, info))))
    # Cells of 2 pixels; feet at (30, 73) and (30, 93).
    assert [(row["left"], row["top"], row["right"], row["bottom"]) for row in rows] == [
        ("30.00", "72.00", "32.00", "74.00"),
        ("30.00", "92.00", "32.00", "94.00"),
    ]
    assert [(row["boxes"], row["share"]) for row in rows] == [
        ("10", "0.250000"),
        ("30", "0.750000"),
    ]
    head = "left,top,right,bottom,boxes,share"
    assert heatmap_csv(Tracks.empty(), info).split() == [head]


@pytest.mark.parametrize(
    ("time", "text"),
    [(0, "0:00.0"), (65.23, "1:05.2"), (59.96, "1:00.0"), (3725.0, "1:02:05.0")],
)
def test_times_of_a_video_are_minutes_and_seconds(time: float, text: str) -> None:
    assert clock(time) == text


def picture(number: int, colour: tuple[int, int, int]) -> Frame:
    image = np.full((120, 200, 3), 90, np.uint8)
    image[55:105, 15:45] = colour
    return Frame(number, (number - 1) / FPS, image)


def shown(address: str) -> np.ndarray:
    kind, _, data = address.partition(",")
    assert kind == "data:image/jpeg;base64"
    return cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)


def test_a_thumbnail_is_given_to_the_corrected_track_below_it() -> None:
    thumbnails = Thumbnails()
    online = walk(4, 1, 1, 0.0)
    thumbnails.see(picture(1, (0, 0, 250)), online, online.xyxy)
    corrected = Tracks.concatenate([walk(9, 1, 30, 0.0), walk(2, 2, 30, 0.0)])
    found = thumbnails.of(corrected)
    assert [*found] == [9]
    image = shown(found[9])
    assert max(image.shape[:2]) <= 72
    middle = image[image.shape[0] // 2, image.shape[1] // 2].astype(int)
    assert middle[2] > 200
    assert middle[0] < 80
    assert thumbnails.of(walk(1, 1, 1, 0.0, xyxy=np.array([[150.0, 60, 170, 100]]))) == {}


def test_a_thumbnail_of_a_hidden_box_is_hidden() -> None:
    stripes = np.zeros((120, 200, 3), np.uint8)
    stripes[:, ::2] = 255
    online = walk(4, 1, 1, 0.0)
    spread = {}
    for blur in ("", "boxes"):
        thumbnails = Thumbnails(blur)
        thumbnails.see(Frame(1, 0.0, stripes), online, online.xyxy)
        image = shown(thumbnails.of(online)[4])
        spread[blur] = float(image[10:-10, 6:-6].astype(float).std())
    assert spread["boxes"] < 0.2 * spread[""]


def test_few_frames_are_converted_for_thumbnails() -> None:
    class Counted:
        asked = 0
        size = (200, 120)

        def bgr(self, size: object = None) -> np.ndarray:
            self.asked += 1
            return np.full((120, 200, 3), 90, np.uint8)

    seen = Counted()
    thumbnails = Thumbnails()
    for number in range(1, 101):
        online = walk(number, number, number, 0.0)
        thumbnails.see(Frame(number, (number - 1) / FPS, seen), online, online.xyxy)
    assert seen.asked == 10
