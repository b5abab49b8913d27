"""What every detector and every source of frames must do."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from shipped import keeps

from phdtrack.detect import DETECTORS, TableDetector, make_detector
from phdtrack.detect.base import Detector
from phdtrack.types import Detections, DetectionTable, Frame
from phdtrack.video import VideoWriter, open_source

WIDTH = 160
HEIGHT = 128


def pictures(count: int = 12) -> list[Frame]:
    """Texture over which a square moves."""
    ground = np.random.default_rng(3).integers(90, 110, (HEIGHT, WIDTH, 3), np.uint8)
    out = []
    for k in range(count):
        image = ground.copy()
        image[40:80, 10 + 8 * k : 40 + 8 * k] = (20, 30, 220)
        image.flags.writeable = False
        out.append(Frame(k + 1, k / 25, image))
    return out


TABLE = DetectionTable(
    np.array([1, 3, 3]), Detections.of([[1, 2, 30, 40], [5, 6, 70, 80], [9, 9, 20, 20]])
)


@pytest.mark.parametrize("name", [*DETECTORS, "table"])
def test_detectors_give_boxes_in_frame_and_reset(name: str):
    """Frames are read-only: nobody writes into a picture that he received."""
    detector = TableDetector(TABLE) if name == "table" else make_detector(name)
    keeps(Detector, detector)
    runs = []
    for _ in range(2):
        detector.reset()
        found = [detector(frame) for frame in pictures()]
        for here in found:
            n = len(here)
            assert isinstance(here, Detections)
            assert here.xyxy.shape == (n, 4)
            assert here.confidence.shape == here.class_id.shape == (n,)
            assert np.isfinite(here.xyxy).all()
            assert (here.xyxy[:, 2:] > here.xyxy[:, :2]).all()
            assert (here.xyxy[:, :2] < (WIDTH, HEIGHT)).all()
            assert (here.xyxy[:, 2:] > 0).all()
        runs.append(found)
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a.xyxy, b.xyxy)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    video = folder / "clip.mp4"
    with VideoWriter(video, WIDTH, HEIGHT, 25.0) as writer:
        for frame in pictures():
            writer.write(frame.image)
    images = folder / "images"
    images.mkdir()
    for frame in pictures():
        cv2.imwrite(str(images / f"{frame.number:06d}.png"), frame.image)
    return {"video": video, "images": images}


@pytest.mark.parametrize("kind", ["video", "images"])
def test_sources_give_frames_in_order_and_again(kind: str, files):
    source = open_source(files[kind])
    assert (source.info.width, source.info.height) == (WIDTH, HEIGHT)
    assert source.info.fps == pytest.approx(25)
    for _ in range(2):
        frames = list(source)
        assert [frame.number for frame in frames] == list(range(1, 13))
        assert [frame.time for frame in frames] == pytest.approx(
            [k / 25 for k in range(12)], abs=1e-3
        )
        for frame in frames:
            assert frame.image.shape == (HEIGHT, WIDTH, 3)
            assert frame.image.dtype == np.uint8
    assert source.info.frames == (12 if kind == "images" else 0)
