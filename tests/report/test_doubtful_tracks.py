"""Doubtful tracks of moving regions, judged without truth."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from report_runs import run_record

from phdtrack.report import sentences
from phdtrack.report.doubtful_tracks import DoubtfulTracks, TrackSigns
from phdtrack.report.pages import doubts, report_html, run_document
from phdtrack.run.running import FrameSummary, used_boxes
from phdtrack.types import Detections, SequenceInfo, Tracks

INFO = SequenceInfo(400, 200, 10.0)
FRAMES = 60


def track(
    identity: int, x: np.ndarray, y: float = 80.0, first: int = 1, height: float = 40.0
) -> Tracks:
    """A track of boxes 20 pixels wide, with their left sides at ``x`` (n,)."""
    n = len(x)
    boxes = np.column_stack([x, np.full(n, y), x + 20.0, np.full(n, y + height)])
    return Tracks.of(np.arange(first, first + n), identity, boxes, 1.0, np.zeros(n, np.int64))


def judged(
    *tracks: Tracks, used: np.ndarray | None = None, region=None, frames: int = FRAMES
) -> DoubtfulTracks:
    """The doubt about tracks whose detections are their boxes, in a file of so many frames."""
    rows = Tracks.concatenate(tracks)
    signs = TrackSigns(INFO, region)
    for number in range(1, frames + 1):
        signs.see(number)
    signs.add(rows, rows.xyxy if used is None else used)
    return signs.result()


CROSSING = track(1, np.linspace(0, 380, FRAMES))


def test_track_across_the_picture_is_not_doubtful() -> None:
    found = judged(CROSSING)
    assert asdict(found) == asdict(DoubtfulTracks(FRAMES, 1))
    assert not found.warn
    assert found.signs == ()
    assert judged().boxes == 0
    # Someone who comes towards the camera keeps the centre of the box in place.
    size = np.linspace(10, 95, FRAMES)[:, None]
    near = np.hstack([200 - size / 2, 100 - size, 200 + size / 2, 100 + size])
    assert judged(replace(CROSSING, xyxy=near)).no_motion == 0


@pytest.mark.parametrize(
    ("name", "doubtful"),
    [
        ("leaves sway in one place", track(2, 200 + 8 * np.sin(np.arange(30.0)), first=15)),
        ("a ghost stays from the first frame", track(2, np.full(30, 100.0))),
        ("a lamp stays at the border", track(2, np.full(30, 1.0))),
    ],
)
def test_track_that_stays_in_place_is_doubtful(name: str, doubtful: Tracks) -> None:
    found = judged(CROSSING, doubtful)
    assert found.no_motion == pytest.approx(30 / 90), name
    assert found.size_jumps == 0


SHORT = 20
NOISE = np.random.default_rng(3).normal(0, 0.5, (SHORT, 4))


def noisy(rows: Tracks) -> Tracks:
    """The same track with boxes that tremble by half a pixel."""
    return replace(rows, xyxy=rows.xyxy + NOISE[: len(rows)])


def approaching(n: int) -> Tracks:
    """Somebody far away who comes towards the camera: the lower side moves by half a height."""
    size = np.linspace(40, 56, n)[:, None]
    boxes = np.hstack([200 - size / 4, np.full((n, 1), 50.0), 200 + size / 4, 50 + size])
    return replace(track(1, np.full(n, 190.0)), xyxy=boxes)


@pytest.mark.parametrize(
    ("name", "moving"),
    [
        ("walks, and is seen in all of two seconds", track(1, np.linspace(100, 118, SHORT))),
        ("comes towards the camera", approaching(SHORT)),
        ("leaves after a second", track(1, np.linspace(366, 380, 10))),
        ("enters a second before the end", track(1, np.linspace(0, 14, 10), first=SHORT - 9)),
    ],
)
def test_track_that_a_short_file_cuts_may_move(name: str, moving: Tracks) -> None:
    """It has not moved by its own size yet, but it is on its way."""
    found = judged(noisy(moving), frames=SHORT)
    assert found.boxes == len(moving), name
    assert found.no_motion == 0, name


@pytest.mark.parametrize(
    ("name", "still"),
    [
        ("stands", track(1, np.full(SHORT, 100.0))),
        ("sways", track(1, 100 + 8 * np.sin(np.arange(float(SHORT))))),
        ("jumps to and fro", track(1, 100 + 12.0 * (np.arange(SHORT) // 3 % 2))),
        ("shrinks over a minute", track(1, np.linspace(100, 100.6, SHORT))),
    ],
)
def test_track_in_place_is_doubtful_in_a_short_file(name: str, still: Tracks) -> None:
    assert judged(noisy(still), frames=SHORT).no_motion == 1, name


def test_track_that_ends_by_itself_had_its_time() -> None:
    """Nothing cut it short: it went a part of its size and was gone."""
    brief = noisy(track(1, np.linspace(100, 112, 10), first=25))
    assert judged(brief).no_motion == 1
    assert judged(replace(brief, frame=brief.frame - 24)).no_motion == 0


@pytest.mark.parametrize(
    ("first", "x", "inside"),
    [
        (15, np.linspace(100, 300, 30), True),
        # It was there before the first frame, it goes on after the last one, it leaves, it enters.
        (1, np.linspace(100, 300, 30), False),
        (31, np.linspace(100, 300, 30), False),
        (15, np.linspace(100, 380, 30), False),
        (15, np.linspace(0, 300, 30), False),
    ],
)
def test_track_that_begins_and_ends_inside_is_doubtful(
    first: int, x: np.ndarray, inside: bool
) -> None:
    found = judged(CROSSING, track(2, x, first=first))
    assert found.inside_ends == pytest.approx(inside * 30 / 90)
    assert found.share == found.inside_ends


def test_border_of_a_mask_is_a_border() -> None:
    region = np.zeros((200, 400), np.bool_)
    region[:, 95:325] = True
    doubtful = track(2, np.linspace(100, 300, 30), first=15)
    assert judged(doubtful).inside_ends == 1
    assert judged(doubtful, region=region).inside_ends == 0


def test_heights_that_jump_are_doubtful_and_gait_is_not() -> None:
    """A body falls into parts; a shadow comes and goes; someone only swings arms and legs."""
    for times, heights, jumps in (
        ("parts", np.where(np.arange(FRAMES) % 10 < 2, 15.0, 40.0), True),
        ("shadow", np.where(np.arange(FRAMES) // 9 % 2, 40.0, 70.0), True),
        ("gait", 40 + 5 * np.sin(np.arange(FRAMES)), False),
        ("once", np.where(np.arange(FRAMES) < 30, 40.0, 70.0), False),
        ("comes near", 10 * 1.04 ** np.arange(FRAMES), False),
    ):
        used = CROSSING.xyxy.copy()
        used[:, 3] = used[:, 1] + heights
        # Steps of a walker's width are as large as they like.
        used[::2, 2] += 30
        assert judged(CROSSING, used=used).size_jumps == jumps, times


def test_predicted_rows_are_no_jumps() -> None:
    used = CROSSING.xyxy.copy()
    used[::3] = np.nan
    assert judged(CROSSING, used=used).size_jumps == 0


def test_rows_in_parts_give_the_same_as_all_at_once() -> None:
    rng = np.random.default_rng(1)
    tracks = [CROSSING]
    for identity in range(2, 9):
        first = int(rng.integers(1, 40))
        n = int(rng.integers(3, 20))
        x = np.linspace(rng.uniform(0, 200), rng.uniform(0, 380), n)
        tracks.append(track(identity, x, first=first, height=float(rng.uniform(20, 60))))
    rows = Tracks.concatenate(tracks)
    rows = rows.select(np.lexsort((rows.identity, rows.frame)))
    used = rows.xyxy + rng.uniform(-6, 6, rows.xyxy.shape)
    whole = judged(rows, used=used)
    signs = TrackSigns(INFO)
    for begin in range(1, FRAMES + 1, 7):
        for number in range(begin, min(begin + 7, FRAMES + 1)):
            signs.see(number)
        part = (rows.frame >= begin) & (rows.frame < begin + 7)
        signs.add(rows.select(part), used[part])
    assert asdict(signs.result()) == pytest.approx(asdict(whole))
    assert whole.tracks == 8
    assert 0 < whole.share < 1
    # Tracks that have ended are forgotten, except for their counts.
    assert signs.active < 8


def test_used_boxes_are_those_of_the_detections() -> None:
    boxes = np.arange(12.0).reshape(3, 4)
    kept = Detections.of(boxes).select(np.array([0, 2]))
    summaries = [
        FrameSummary(3, 0.3, kept, 0.0, np.zeros(2)),
        FrameSummary(5, 0.5, Detections.of(boxes[:1]), 0.0, np.zeros(1)),
    ]
    rows = Tracks.of(
        np.array([3, 3, 3, 4, 5]), 1, np.zeros((5, 4)), 1.0, np.array([2, 1, -1, 0, 0])
    )
    nothing = np.full(4, np.nan)
    np.testing.assert_array_equal(
        used_boxes(rows, summaries), [boxes[2], nothing, nothing, nothing, boxes[0]]
    )
    assert np.isnan(used_boxes(rows, [])).all()


def test_pooled_shares_are_weighted_by_boxes() -> None:
    pooled = DoubtfulTracks.pooled(
        [DoubtfulTracks(30, 2, 1.0, 0.5, 0.0, 0.5), DoubtfulTracks(10, 1), DoubtfulTracks()]
    )
    assert asdict(pooled) == asdict(DoubtfulTracks(40, 3, 0.75, 0.375, 0.0, 0.375))
    assert DoubtfulTracks.pooled([]).boxes == 0


def test_warning_names_the_strongest_sign_and_its_cure() -> None:
    record = run_record(12, 3)
    for doubtful, cause in (
        (DoubtfulTracks(36, 3, 0.6, 0.5, 0.2, 0.1), "parts"),
        (DoubtfulTracks(36, 3, 0.6, 0.1, 0.5, 0.2), "left"),
        (DoubtfulTracks(36, 3, 0.6, 0.1, 0.2, 0.5), "stand still"),
    ):
        (said,) = doubts(replace(record, doubtful=doubtful))
        assert said.startswith("the tracks may be wrong: about 60")
        assert cause in said.split("typical of")[1]
        assert "--detector onnx:FILE" in said
    few = DoubtfulTracks(36, 3, 0.2, 0.2)
    assert doubts(replace(record, doubtful=few)) == ()
    assert doubts(replace(record, doubtful=DoubtfulTracks(4, 1, 1.0, 1.0))) == ()


def test_report_says_what_moving_regions_are() -> None:
    record = run_record(12, 3)
    objects = " ".join(sentences(record))
    assert "regions" not in objects
    assert "Doubtful" not in report_html(record, {})
    assert run_document(record, {})["doubtful_boxes"] is None
    doubtful = DoubtfulTracks(36, 3, 0.25, 0.0, 0.25, 0.0)
    regions = replace(record, doubtful=doubtful)
    said = " ".join(sentences(regions))
    assert said.count("Moving regions, not recognised objects: counts are approximate") == 1
    assert "about 25\u00a0% of the boxes are in doubtful tracks" in said
    assert "Doubtful tracks" in report_html(regions, {})
    assert run_document(regions, {})["doubtful_boxes"] == asdict(doubtful)
    sure = replace(record, doubtful=DoubtfulTracks(36, 0, 0.0, 0.0, 0.0, 0.0))
    assert "counts are approximate." in " ".join(sentences(sure))
    empty = replace(regions, tracks=Tracks.empty(), doubtful=DoubtfulTracks())
    assert "Doubtful tracks" not in report_html(empty, {})
