from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.errors import InputError
from phdtrack.report import Annotator
from phdtrack.report.drawing import COLOURS, cached_plate, identity_colour
from phdtrack.types import Detections, SequenceInfo, Tracks

BOX = (100.0, 80.0, 140.0, 200.0)
GREY = np.full((240, 320, 3), 90, np.uint8)


def rows(
    *boxes: tuple[float, ...],
    frame: int = 1,
    identity: int = 1,
    seen: bool = True,
    confirmed: bool = True,
) -> Tracks:
    n = len(boxes)
    return Tracks(
        np.full(n, frame),
        np.arange(identity, identity + n),
        np.array(boxes, dtype=np.float64).reshape(n, 4),
        np.ones(n),
        np.full(n, 0 if seen else -1),
        np.full(n, confirmed),
    )


def annotate(image: np.ndarray, *given: object, **more: object) -> np.ndarray:
    """One frame without trails."""
    return Annotator(SequenceInfo(320, 240, 25.0))(image, *given, **more)  # type: ignore[arg-type]


def coloured(image: np.ndarray, identity: int = 1) -> np.ndarray:
    """(H, W) where the picture has exactly the identity's colour."""
    return (image == np.array(identity_colour(identity)[::-1])).all(axis=2)


def left_edge(image: np.ndarray) -> np.ndarray:
    """(rows,) whether the left edge of BOX is drawn in identity 1's colour, between its corners."""
    return coloured(image)[82:199, 100]


def test_detected_box_is_solid_and_predicted_box_dashed() -> None:
    seen = left_edge(annotate(GREY, 1, rows(BOX), Detections.empty()))
    predicted = left_edge(annotate(GREY, 1, rows(BOX, seen=False), Detections.empty()))
    assert seen.all()
    assert 0.35 < predicted.mean() < 0.8
    assert (np.diff(predicted.astype(int)) == 1).sum() >= 3


def test_unconfirmed_box_is_faint_and_unlabelled() -> None:
    faint = annotate(GREY, 1, rows(BOX, confirmed=False), Detections.empty())
    assert not coloured(faint).any()
    assert (faint[82:199, 100] != 90).any(axis=1).all()
    assert (faint[60:78, 100:130] == 90).all()


def test_false_alarm_is_crossed_out() -> None:
    found = Detections.of([BOX])
    believed = annotate(GREY, 1, Tracks.empty(), found, clutter_probability=np.array([0.2]))
    doubted = annotate(GREY, 1, Tracks.empty(), found, clutter_probability=np.array([0.9]))
    assert (believed[130:150, 110:130] == 90).all()
    assert (doubted[130:150, 110:130] != 90).any()
    # A corrected track knows more than the filter knew then.
    tracked = annotate(GREY, 1, rows(BOX), found, clutter_probability=np.array([0.9]))
    assert (tracked[130:150, 110:130] == 90).all()


def test_trails_follow_the_feet_and_fade() -> None:
    annotator = Annotator(SequenceInfo(320, 240, 10.0), trail_seconds=1.0)
    for number in range(1, 21):
        box = (10.0 * number, 80.0, 10.0 * number + 20, 150.0)
        out = annotator(GREY, number, rows(box, frame=number), Detections.empty())
    strength = np.abs(out[150].astype(int) - 90).sum(axis=1)
    assert strength[185] > strength[130] > 0  # recent stronger than old
    assert (strength[:105] == 0).all()  # beyond one second: forgotten


wild = st.floats(allow_nan=True, allow_infinity=True, width=32) | st.floats(-20, 90)


@settings(max_examples=150, deadline=None)
@given(
    st.integers(1, 70),
    st.integers(1, 70),
    st.lists(st.tuples(wild, wild, wild, wild), max_size=5),
    st.booleans(),
)
def test_any_box_on_any_frame_draws_without_error(
    high: int, wide: int, boxes: list[tuple[float, ...]], flag: bool
) -> None:
    image = np.zeros((high, wide, 3), np.uint8)
    annotator = Annotator(SequenceInfo(wide, high, 0.0))
    for number in (1, 2):
        found = Detections.of(np.array(boxes, dtype=np.float64).reshape(-1, 4))
        tracks = rows(
            *boxes, frame=number, identity=10**12, seen=flag, confirmed=not flag or number == 2
        )
        out = annotator(
            image, number, tracks, found, mass=np.inf, clutter_probability=np.ones(len(boxes))
        )
        assert out.shape == image.shape
        assert out.dtype == np.uint8
    assert not image.any()


def test_only_recurring_labels_are_cached() -> None:
    """A header is of one frame: kept, those of a long video took tens of MB."""
    annotator = Annotator(SequenceInfo(320, 240, 25.0))
    before = cached_plate.cache_info().currsize
    for number in range(1, 21):
        annotator(GREY, number, rows(BOX, frame=number), Detections.empty())
    assert cached_plate.cache_info().currsize <= before + 1


def test_mismatching_pictures_are_rejected() -> None:
    with pytest.raises(InputError, match=r"frame 7.*BGR"):
        annotate(np.zeros((4, 4), np.uint8), 7, Tracks.empty(), Detections.empty())
    with pytest.raises(InputError, match="uint8"):
        annotate(np.zeros((4, 4, 3)), 7, Tracks.empty(), Detections.empty())
    with pytest.raises(InputError, match="clutter probability"):
        annotate(GREY, 7, Tracks.empty(), Detections.of([BOX]), clutter_probability=np.ones(2))


MACHADO = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.01182, 0.04294, 0.968881],
    ],
}


@pytest.mark.parametrize("sight", sorted(MACHADO))
def test_consecutive_colours_differ_for_the_colour_blind(sight: str) -> None:
    share = np.array(COLOURS) / 255
    linear = (
        np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
        @ np.array(MACHADO[sight]).T
    )
    linear = np.clip(linear, 0, 1)
    seen = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    lab = cv2.cvtColor(seen[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    assert np.linalg.norm(lab - np.roll(lab, 1, axis=0), axis=1).min() > 40


@pytest.mark.parametrize("size", [(240, 320), (42, 66)])
def test_drawing_on_planes_equals_drawing_on_bgr(size: tuple[int, int]) -> None:
    """Brightness and colours of the result differ by rounding, and by four pixels sharing their
    colours.
    """
    high, wide = size
    image = cv2.resize(np.random.default_rng(3).integers(0, 255, (4, 5, 3), np.uint8), (wide, high))
    planes = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), np.uint8)
    boxes = np.array([[10.0, 12, 40, 38], [30, 8, 60, 30]])
    rows = Tracks.of(1, np.array([1, 2]), boxes, 1.0, np.array([0, -1]))
    given = (1, rows, Detections.of(boxes + 1))
    info = SequenceInfo(wide, high, 25.0)
    bgr = Annotator(info)(image, *given)
    before = planes.copy()
    drawn = Annotator(info)(planes, *given)
    expected = cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420)
    light, wanted = (each[:high].astype(int) for each in (drawn, expected))
    assert np.abs(light - wanted).max() <= 3
    untouched = (bgr == image).all(axis=2)
    assert np.array_equal(drawn[:high][untouched], before[:high][untouched])
    assert (drawn != before).any()
    again = Annotator(info)
    again(before.copy(), *given)
    assert np.array_equal(
        again(before.copy(), 2, Tracks.empty(), Detections.empty())[high // 2 : high],
        before[high // 2 : high],
    )
