"""Masks, keypoints and whatever else belongs to boxes: `update` gives them back by row."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phdtrack import Detections, InputError, Tracker, Tracks
from tracker_cases import boxes, equal


def tracker(**sections: Any) -> Tracker:
    return Tracker((640, 480), fps=25.0, **sections)


def data_of(k: int, n: int = 2) -> dict[str, Any]:
    """Of n boxes of frame k, columns of several kinds, whose values tell frame and box."""
    return {
        "masks": np.arange(1, n + 1)[:, None, None] * np.ones((n, 3, 4), np.uint8),
        "keypoints": 1.0 + k + np.arange(n)[:, None, None] + np.zeros((n, 17, 2)),
        "names": [f"{k} {i}" for i in range(n)],
        "polygons": [np.full((3 + i, 2), i) for i in range(n)],
    }


class OneMissed:
    """Two boxes a frame, without the second one in frame 20, and what belongs to them."""

    def __init__(self, own: Tracker) -> None:
        self.own = own
        self.rows = list[Tracks]()
        for k in range(1, 31):
            n = 1 if k == 20 else 2
            self.rows.append(own.update(boxes(k)[:n], data=data_of(k, n)))


def check(rows: Tracks) -> None:
    """Each row has what came with its detection, or empty entries."""
    assert {len(column) for column in rows.data.values()} <= {len(rows)}
    for row in range(len(rows)):
        k, i = int(rows.frame[row]), int(rows.detection[row])
        if rows.predicted[row]:
            assert not rows.data["masks"][row].any()
            assert not rows.data["keypoints"][row].any()
            assert rows.data["names"][row] == ""
            assert rows.data["polygons"][row] is None
        else:
            assert (rows.data["masks"][row] == i + 1).all()
            assert (rows.data["keypoints"][row] == 1 + k + i).all()
            assert rows.data["names"][row] == f"{k} {i}"
            assert rows.data["polygons"][row].shape == (3 + i, 2)


@pytest.mark.parametrize("delay", [0, 4])
@pytest.mark.parametrize("kind", ["pmb", "gm-phd"])
def test_each_row_has_the_data_of_its_detection(kind: Any, delay: int) -> None:
    run = OneMissed(tracker(filter=kind, associate={"output_delay": delay}))
    parts = [*run.rows, run.own.flush()]
    for rows in parts:
        check(rows)
    whole = Tracks.concatenate(parts)
    check(whole)
    check(whole[whole.identity == 2])
    check(whole.with_class(np.ones(len(whole), np.int64)).with_boxes(whole.xyxy + 1))
    assert whole.frame.max() == 30
    if not delay:
        assert whole.predicted.any()
    assert whole.data["masks"].shape[1:] == (3, 4)


def test_data_changes_no_track() -> None:
    plain = tracker()
    for rows, k in zip(OneMissed(tracker()).rows, range(1, 31), strict=True):
        assert equal(plain.update(boxes(k)[: 1 if k == 20 else 2]), rows)


def test_rows_without_boxes_have_empty_entries_of_the_same_shape() -> None:
    run = OneMissed(tracker(filter="gm-phd"))
    for nothing in (None, {}, {"masks": [], "names": []}):
        rows = run.own.update(np.zeros((0, 4)), data=nothing)
        assert len(rows)
        assert rows.predicted.all()
        assert rows.data["masks"].shape == (len(rows), 3, 4)
        check(rows)


def test_boxes_left_out_shift_nothing() -> None:
    """The first box is no box, and is left out."""
    own = tracker()
    for k in range(1, 11):
        found = np.vstack([[5.0, 5.0, 5.0, 5.0], boxes(k)])
        rows = own.update(found, data={"names": ["none", "first", "second"]})
    assert rows.detection.tolist() == [1, 2]
    assert rows.data["names"].tolist() == ["first", "second"]


def test_classes_keep_their_data() -> None:
    own = tracker()
    for k in range(1, 11):
        found = Detections.of(boxes(k), class_id=[7, 3])
        rows = own.update(found, data={"names": ["seven", "three"]})
    names = {7: "seven", 3: "three"}
    assert len(rows) == 2
    assert rows.data["names"].tolist() == [names[label] for label in rows.class_id.tolist()]


def test_an_array_that_is_filled_again_is_given_back_as_it_was() -> None:
    own = tracker(associate={"output_delay": 3})
    buffer = np.zeros(2)
    parts = []
    for k in range(1, 16):
        buffer[:] = k
        parts.append(own.update(boxes(k), data={"frame": buffer}))
    rows = Tracks.concatenate(parts)
    assert len(rows)
    assert (rows.data["frame"] == rows.frame).all()


def test_a_reset_or_loaded_tracker_knows_no_data_of_before() -> None:
    run = OneMissed(tracker())
    saved = run.own.state_dict()
    run.own.reset()
    assert not run.own.update(boxes(1)).data
    run.own.load_state_dict(saved)
    rows = run.own.update(boxes(31))
    assert len(rows)
    assert not rows.data
    assert not run.own.tracks().data


class Tensor:
    """As torch has it: it does not convert to an array before it is on the CPU."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    def __array__(self) -> np.ndarray:
        raise TypeError("can't convert cuda:0 device type tensor to numpy")

    def __len__(self) -> int:
        return len(self.values)

    @property
    def data(self) -> Tensor:
        return self

    def detach(self) -> Tensor:
        return self

    def cpu(self) -> np.ndarray:
        return self.values


def test_what_supervision_and_ultralytics_have_is_taken() -> None:
    mask = np.zeros((2, 6, 8), bool)
    mask[1] = True
    xy = boxes(1)
    of_supervision = SimpleNamespace(
        xyxy=xy, confidence=None, class_id=None, mask=mask, data={"class_name": ["a", "b"]}
    )
    of_ultralytics = SimpleNamespace(
        boxes=SimpleNamespace(xyxy=xy, data=np.zeros((2, 6))),
        masks=SimpleNamespace(data=Tensor(mask)),
        keypoints=SimpleNamespace(data=Tensor(np.ones((2, 17, 3)))),
        obb=None,
    )
    oriented = SimpleNamespace(xyxy=xy, xywhr=Tensor(np.ones((2, 5))))
    for holder, names in (
        (of_supervision, {"mask": (6, 8), "class_name": ()}),
        (of_ultralytics, {"masks": (6, 8), "keypoints": (17, 3)}),
        ([of_ultralytics], {"masks": (6, 8), "keypoints": (17, 3)}),
        (oriented, {"xywhr": (5,)}),
    ):
        own = tracker()
        for _ in range(5):
            rows = own.update(holder, data=holder)
        assert len(rows) == 2
        assert {name: column.shape[1:] for name, column in rows.data.items()} == names


def test_a_data_frame_and_supervision_get_them(monkeypatch: pytest.MonkeyPatch) -> None:
    made: dict[str, Any] = {}
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    stand_in = SimpleNamespace(Detections=lambda xyxy, **more: made.update(more, xyxy=xyxy))
    monkeypatch.setitem(sys.modules, "supervision", stand_in)
    own = tracker()
    for k in range(1, 6):
        mask = np.ones((2, 6, 8), np.uint8)
        rows = own.update(boxes(k), data={"mask": mask, "name": ["a", "b"], "frame": [0, 0]})
    table = rows.to_dataframe()
    assert [str(name) for name in table["name"]] == ["a", "b"]
    assert list(table["frame"]) == [5, 5]
    rows.to_supervision()
    assert made["mask"].dtype == bool
    assert made["mask"].shape == (2, 6, 8)
    assert made["data"]["name"].tolist() == ["a", "b"]
    assert made["data"]["frame"].tolist() == [5, 5]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"masks": np.zeros((3, 4))}, r"'masks'.*one entry for each of 2 boxes, got 3"),
        ({"masks": 5}, r"'masks'.*one entry for each of 2 boxes, got int"),
        ({"masks": [[1], [2, 3], [4]]}, r"'masks'.*one entry for each of 2 boxes, got 3"),
        ({3: [1, 2]}, r"names that are texts, got 3"),
        (np.zeros((2, 4)), r"a mapping from names to arrays, got ndarray"),
    ],
)
def test_data_that_does_not_fit_is_refused(data: Any, message: str) -> None:
    own = tracker()
    own.update(boxes(1))
    with pytest.raises(InputError, match=message) as caught:
        own.update(boxes(2), data=data)
    assert "frame 2, update(data=…)" in str(caught.value)
    # The tracker stays as it was.
    own.update(boxes(2))
