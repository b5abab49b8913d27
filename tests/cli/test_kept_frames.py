"""Frames that are kept for a second pass come back as they were, without their pictures."""

import numpy as np

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


def test_kept_frames_come_back_as_they_were(rng: np.random.Generator) -> None:
    frames = [a_frame(rng, number) for number in range(3, 63)]
    kept = KeptFrames()
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
        np.testing.assert_array_equal(one.warp, other.warp)
        np.testing.assert_array_equal(one.pose, other.pose)
    number, time, count = kept.columns
    assert number.tolist() == [each.frame.number for each in frames]
    assert time.tolist() == [each.frame.time for each in frames]
    assert count.tolist() == [len(each.detections) for each in frames]
    every = np.concatenate([each.detections.xyxy for each in frames])
    np.testing.assert_array_equal(kept.boxes, every)
