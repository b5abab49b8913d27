"""Embeddings and images that `Tracker.update` takes: all forms are the same, and what cannot be
right is refused before anything changes.
"""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phdtrack import Tracker
from phdtrack.detect.colours import Colours
from phdtrack.errors import InputError
from phdtrack.types import F4, Detections, Image
from tracker_cases import SIZE, boxes, equal, tracker_of

D = 6


def looks(k: int) -> F4:
    """(2, D) noisy embeddings of the two people of `boxes`, at frame k from 0."""
    return np.asarray(np.eye(2, D) + np.random.default_rng(k).normal(0, 0.1, (2, D)), np.float32)


def picture(k: int) -> Image:
    """A picture of the two people of `boxes`, at frame k from 0: one in red, the other in blue."""
    rng = np.random.default_rng(k)
    image = rng.integers(100, 120, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
    for (left, top, right, bottom), colour in zip(
        boxes(k).astype(int), [(30, 30, 200), (200, 60, 30)], strict=True
    ):
        image[top:bottom, left:right] = colour
    return image


def seen(tracker: Tracker) -> F4:
    """The embeddings that the tracker used in the last frame."""
    assert tracker.step is not None
    found = tracker.step.detections.embeddings
    assert found is not None
    return found


class Tensor:
    """Like torch's with gradients on a GPU."""

    def __init__(self, values: F4) -> None:
        self.values = values

    def detach(self) -> Tensor:
        return self

    def cpu(self) -> Tensor:
        return self

    def double(self) -> F4:
        return self.values


def objects(k: int) -> dict[str, Any]:
    """Detectors' output that holds embeddings."""
    found = boxes(k)
    data = {"embeddings": looks(k), "other": np.zeros(2)}
    inner = SimpleNamespace(xyxy=found, conf=np.ones(2), cls=np.zeros(2), data=np.zeros((2, 6)))
    return {
        "supervision": SimpleNamespace(xyxy=found, confidence=None, class_id=None, data=data),
        "supervision, listed": SimpleNamespace(
            xyxy=found, confidence=None, class_id=None, data={"embeddings": list(looks(k))}
        ),
        "ultralytics": SimpleNamespace(boxes=inner, embeddings=Tensor(looks(k))),
        "a list": [SimpleNamespace(boxes=inner, embeddings=looks(k).tolist())],
        "an object": SimpleNamespace(xyxy=found, embeddings=looks(k).astype(np.float64)),
        "Detections": Detections.of(found, embeddings=looks(k)),
    }


@pytest.mark.parametrize("form", objects(0))
def test_embeddings_come_in_all_forms(form: str) -> None:
    plain = tracker_of()
    other = tracker_of()
    for k in range(8):
        rows = plain.update(boxes(k), embeddings=looks(k))
        assert equal(rows, other.update(objects(k)[form]))
        np.testing.assert_array_equal(seen(other), looks(k))
    assert equal(plain.tracks(), other.tracks())


NO_BOX = np.zeros((0, 4), np.float32)
NO_BOXES = SimpleNamespace(xyxy=NO_BOX, conf=np.zeros(0), cls=np.zeros(0), data=np.zeros((0, 6)))
EMPTY = {
    # As `Detections.empty()` of supervision, and what is left of others by a mask.
    "supervision": SimpleNamespace(
        xyxy=NO_BOX, confidence=np.zeros(0, np.float32), class_id=np.zeros(0, int), data={}
    ),
    "supervision, none left": SimpleNamespace(
        xyxy=NO_BOX, confidence=None, class_id=None, data={"embeddings": np.zeros((0, D))}
    ),
    "supervision, listed": SimpleNamespace(
        xyxy=NO_BOX, confidence=None, class_id=None, data={"embeddings": []}
    ),
    "ultralytics": SimpleNamespace(boxes=NO_BOXES, embeddings=None),
    "ultralytics, none left": SimpleNamespace(
        boxes=NO_BOXES, embeddings=Tensor(np.zeros((0, D), np.float32))
    ),
}


@pytest.mark.parametrize("form", EMPTY)
def test_empty_frames_come_in_all_forms(form: str) -> None:
    """Among others with embeddings, also as the first one."""
    plain = tracker_of()
    other = tracker_of()
    for k in range(12):
        if k in (0, 6, 7):
            rows = plain.update(NO_BOX)
            assert equal(rows, other.update(EMPTY[form]))
        else:
            rows = plain.update(boxes(k), embeddings=looks(k))
            assert equal(rows, other.update(objects(k)[form.partition(",")[0]]))
    assert equal(plain.tracks(), other.tracks())


def test_argument_replaces_embeddings_of_the_object() -> None:
    tracker = tracker_of()
    tracker.update(objects(0)["supervision"], embeddings=2 * looks(0))
    np.testing.assert_array_equal(seen(tracker), 2 * looks(0))
    tracker = tracker_of()
    tracker.update(objects(0)["supervision"], image=picture(0))
    assert seen(tracker).shape == (2, Colours().length)


def test_colours_of_an_image_are_embeddings() -> None:
    plain = tracker_of()
    other = tracker_of()
    for k in range(8):
        embeddings = Colours().describe(picture(k), boxes(k))
        rows = plain.update(boxes(k), embeddings=embeddings)
        assert equal(rows, other.update(boxes(k), image=picture(k)))
        np.testing.assert_array_equal(seen(other), embeddings)
    assert equal(plain.tracks(), other.tracks())


def test_boxes_left_out_take_their_embeddings_along() -> None:
    tracker = tracker_of()
    table = np.vstack([boxes(0)[:1], [[5, 5, 5, 9]], boxes(0)[1:]])
    tracker.update(table, embeddings=np.arange(3 * D).reshape(3, D))
    np.testing.assert_array_equal(seen(tracker)[:, 0], [0, 2 * D])
    tracker = tracker_of()
    tracker.update(table, image=picture(0))
    np.testing.assert_array_equal(seen(tracker), Colours().describe(picture(0), boxes(0)))


def test_grey_images_have_one_channel_or_three() -> None:
    grey = picture(0)[..., 1]
    one = tracker_of()
    one.update(boxes(0), image=grey)
    three = tracker_of()
    three.update(boxes(0), image=np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_array_equal(seen(one), seen(three))


def test_frames_without_embeddings_are_allowed() -> None:
    tracker = tracker_of()
    tracker.update(boxes(0), embeddings=looks(0))
    tracker.update(boxes(1))
    tracker.update(np.zeros((0, 4)), embeddings=[])
    tracker.update(np.zeros((0, 4)), embeddings=np.zeros((0, 99)))
    tracker.update(Detections.empty(observed=False))
    unknown = looks(5)
    unknown[0] = np.nan
    unknown[1] = 0
    tracker.update(boxes(5), embeddings=unknown)
    for k in range(6, 12):
        tracker.update(boxes(k), embeddings=looks(k))
    assert len(tracker.tracks())


@pytest.mark.parametrize(
    ("embeddings", "message"),
    [
        (np.ones((3, D)), "a row for each box, for 2 boxes; got an array of shape (3, 6)"),
        (np.ones(2), "for 2 boxes; got an array of shape (2,)"),
        (np.ones((2, 0)), "for 2 boxes; got an array of shape (2, 0)"),
        ([["a", "b"], ["c", "d"]], "got list that does not convert to numbers"),
        ([[1.0, 2.0], [3.0]], "got list that does not convert to numbers"),
        ([[1, 2], [np.inf, 4]], "row 1 (from 0) of the embeddings is not finite: inf"),
        ([[1, np.nan], [3, 4]], "row 0 (from 0) of the embeddings is not finite: nan"),
        ([[1, 2], [1e300, 4]], "row 1 (from 0) of the embeddings is not finite: 1e+300"),
    ],
)
def test_embeddings_that_cannot_be_right(embeddings: Any, message: str) -> None:
    tracker = tracker_of()
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        tracker.update(boxes(0), embeddings=embeddings)
    assert "frame 1, update(embeddings=…)" in str(caught.value)
    assert tracker.step is None


def test_an_embedding_of_a_single_box_is_a_row() -> None:
    with pytest.raises(InputError, match=re.escape("an array of one row: [[…]]")):
        tracker_of().update(boxes(0)[:1], embeddings=looks(0)[0])


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((480, 640, 3)), "got an array (480, 640, 3) of float64"),
        (np.zeros((480, 640, 4), np.uint8), "got an array (480, 640, 4) of uint8"),
        (np.zeros((240, 320, 3), np.uint8), "expected an image of 640x480 pixels, got one of 320x"),
        ("frame.png", "expected an image (H, W, 3) or (H, W) of uint8"),
    ],
)
def test_images_that_cannot_be_right(image: Any, message: str) -> None:
    tracker = tracker_of()
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        tracker.update(boxes(0), image=image)
    assert "frame 1, update(image=…)" in str(caught.value)
    assert tracker.step is None


def test_embeddings_and_image_are_too_much() -> None:
    with pytest.raises(InputError, match="Give one of them"):
        tracker_of().update(boxes(0), embeddings=looks(0), image=picture(0))


def test_another_length_is_an_error_until_reset() -> None:
    tracker = tracker_of()
    tracker.update(boxes(0), embeddings=looks(0))
    restored = tracker_of()
    restored.load_state_dict(tracker.state_dict())
    for one in (tracker, restored):
        with pytest.raises(InputError, match="expected embeddings of 6 numbers as before, got 3"):
            one.update(boxes(1), embeddings=np.ones((2, 3)))
        with pytest.raises(InputError, match="as before, got 192"):
            one.update(boxes(1), image=picture(1))
        one.update(boxes(1), embeddings=looks(1))
    tracker.reset()
    tracker.update(boxes(0), embeddings=np.ones((2, 3)))
