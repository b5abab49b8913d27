"""Frames that are kept for a second pass come back as they were, without their pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phdtrack.run import scene_pass
from phdtrack.run.loop import DetectedFrame
from phdtrack.run.scene_pass import KeptFrames
from phdtrack.types import Detections, Frame, Image


def a_frame(rng: np.random.Generator, number: int) -> DetectedFrame:
    """A frame of one of several kinds."""
    picture: Image = np.zeros((4, 6, 3), np.uint8)
    frame = Frame(number, number / 30, picture)
    count = int(rng.integers(0, 4))
    boxes = rng.uniform(0, 90, (count, 4))
    kind = number % 5
    if kind == 1:
        return DetectedFrame(frame, Detections.of(boxes, rng.random(count)), seconds=0.25)
    if kind == 2:
        return DetectedFrame(frame, Detections.empty(observed=False))
    if kind == 3:
        moved = np.array([[1.0, 0, 2], [0, 1, -1], [0, 0, 1]])
        return DetectedFrame(frame, Detections.of(boxes), moved, pose=moved)
    if kind == 4:
        return DetectedFrame(frame, Detections.of(boxes).select(np.arange(count) % 2 == 1))
    return DetectedFrame(frame, Detections.of(boxes), seconds=0.5)


def with_embeddings(rng: np.random.Generator, number: int) -> DetectedFrame:
    """A frame whose detections have embeddings in two of three."""
    detected = a_frame(rng, number)
    found = detected.detections
    looks = rng.normal(size=(len(found), 700)).astype(np.float32)
    if number % 3 == 1:
        looks = looks.astype(np.float16).astype(np.float32)
    if number % 3:
        return detected._replace(detections=replace(found, embeddings=looks))
    return detected


@pytest.mark.parametrize("described", [False, True])
def test_kept_frames_come_back_as_they_were(
    rng: np.random.Generator, tmp_path: Path, described: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_pass, "IN_MEMORY", 1000)
    make = with_embeddings if described else a_frame
    frames = [make(rng, number) for number in range(3, 63)]
    kept = KeptFrames(tmp_path)
    for frame in frames:
        kept.append(frame)
    assert len(kept) == len(frames)
    for one, other in zip(kept, frames, strict=True):
        assert one.frame.number == other.frame.number
        assert one.frame.time == other.frame.time
        assert not np.asarray(one.frame.picture).size
        assert one.seconds == other.seconds
        assert one.detections.observed == other.detections.observed
        for name in ("xyxy", "confidence", "class_id", "row"):
            found = getattr(one.detections, name)
            np.testing.assert_array_equal(found, getattr(other.detections, name))
        looks = one.detections.embeddings
        expected = other.detections.embeddings
        assert (looks is None) == (expected is None)
        if looks is not None and expected is not None:
            assert looks.dtype == np.float32
            np.testing.assert_array_equal(looks, expected)
        np.testing.assert_array_equal(one.warp, other.warp)
        np.testing.assert_array_equal(one.pose, other.pose)
    number, time, count = kept.columns
    assert number.tolist() == [each.frame.number for each in frames]
    assert time.tolist() == [each.frame.time for each in frames]
    assert count.tolist() == [len(each.detections) for each in frames]
    every = np.concatenate([each.detections.xyxy for each in frames])
    np.testing.assert_array_equal(kept.boxes, every)
