"""`Tracks` as a sequence, as a DataFrame and as another library's record; what the front door
refuses and says.
"""

from __future__ import annotations

import logging
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import phdtrack
from phdtrack import InputError, Tracker, Tracks, evaluate


def rows() -> Tracks:
    box = np.arange(16.0).reshape(4, 4)
    return Tracks.of(
        np.array([1, 1, 2, 3]), np.array([1, 2, 1, 1]), box, 0.5, np.array([0, 1, -1, 0])
    )


def test_rows_are_counted_indexed_and_gone_through() -> None:
    tracks = rows()
    assert len(tracks) == 4
    assert [(identity, box[0]) for identity, box in tracks[1:3]] == [(2, 4), (1, 8)]
    for index, frames in [
        (0, [1]),
        (-1, [3]),
        (slice(2), [1, 1]),
        ([3, 0], [3, 1]),
        (tracks.identity == 1, [1, 2, 3]),
    ]:
        assert tracks[index].frame.tolist() == frames
    assert len(tracks[[]]) == 0
    with pytest.raises(IndexError):
        tracks[4]


def test_a_line_describes_the_rows() -> None:
    assert repr(rows()) == "<Tracks: 4 rows, 2 identities, frames 1 to 3>"
    assert repr(Tracks.empty()) == "<Tracks: 0 rows>"


def test_a_data_frame_and_detections_of_supervision(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of stand-ins: these libraries are the user's own."""
    made: dict[str, Any] = {}
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    frame = rows().to_dataframe()
    assert {len(column) for column in frame.values()} == {4}
    assert (frame["right"].tolist(), frame["identity"].tolist()) == ([2, 6, 10, 14], [1, 2, 1, 1])
    assert set(frame) >= {
        "frame",
        "identity",
        "left",
        "top",
        "right",
        "bottom",
        "confidence",
        "class_id",
    }
    stand_in = SimpleNamespace(Detections=lambda xyxy, **more: made.update(more, xyxy=xyxy))
    monkeypatch.setitem(sys.modules, "supervision", stand_in)
    rows().to_supervision()
    assert made["xyxy"].shape == (4, 4)
    assert made["tracker_id"].tolist() == [1, 2, 1, 1]
    assert made["data"]["detection"].tolist() == [0, 1, -1, 0]


@pytest.mark.parametrize(
    ("name", "package"), [("to_dataframe", "pandas"), ("to_supervision", "supervision")]
)
def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, name: str, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=rf"needs the package {package}. pip install '{package}'"):
        getattr(rows(), name)()


def test_boxes_that_look_wrong_are_said_once(caplog: pytest.LogCaptureFixture) -> None:
    tracker = Tracker((640, 480), filter="none")
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            tracker.update([[0.1, 0.1, 0.5, 0.9]])
        assert [
            record.message for record in caplog.records if record.name == "phdtrack.tracker"
        ] == [
            "frame 1: no coordinate exceeds 0.9: boxes must be in pixels of the image, not in"
            " shares of its size"
        ]
        caplog.clear()
        tracker.reset()
        tracker.update([[10, 10, 50, 90]])
        tracker.update([[700, 10, 750, 90]])
        assert "frame 2: 1 of 1 boxes lie outside the frame of 640x480 pixels" in caplog.text


def test_package_lists_its_names_and_evaluate_checks_arguments() -> None:
    assert set(phdtrack.__all__) <= set(dir(phdtrack))
    with pytest.raises(InputError, match="expected annotated objects as Truth, got int"):
        evaluate(1, 2)  # type: ignore[arg-type]
