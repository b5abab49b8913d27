"""What every background detector must do, and what `change` must do better."""

from __future__ import annotations

from copy import deepcopy

import cv2
import numpy as np
import pytest
from detect_scenes import Scene

from phdtrack.arrays import iou
from phdtrack.detect import make_detector
from phdtrack.detect.base import Detector
from phdtrack.detect.change import ChangeDetector
from phdtrack.detect.mean_background import MeanBackgroundDetector
from phdtrack.detect.scene_knowledge import knowledge, restore
from phdtrack.errors import InputError
from phdtrack.types import Detections, Frame, Image

BACKGROUND = ["change", "mean-background", "mog2"]


def build(name: str, **parameters: object) -> Detector:
    few = {"frames": 10} if name == "mean-background" else {}
    return make_detector(name, **(few | parameters))


@pytest.mark.parametrize("name", BACKGROUND)
def test_moving_square_is_detected(name: str) -> None:
    scene = Scene(frames=130, speed=2.0, enter=30)
    detector = build(name)
    hits = seen = extra = 0
    for frame in scene:
        found = detector(frame)
        truth = scene.truth[frame.number]
        whole = truth[(truth[:, 2] - truth[:, 0]) == 24]
        if frame.number <= 30 or not len(whole):
            continue
        seen += 1
        overlap = iou(whole, found.xyxy)
        hits += overlap.size > 0 and overlap.max() > 0.6
        extra += max(0, len(found) - 1)
    assert seen > 40
    assert hits >= 0.97 * seen
    assert extra <= 0.1 * seen


@pytest.mark.parametrize("name", BACKGROUND)
def test_empty_scene_has_no_detections(name: str) -> None:
    detector = build(name)
    assert not any(len(detector(frame)) for frame in Scene(frames=40, squares=0))


@pytest.mark.parametrize("name", BACKGROUND)
def test_other_frame_size_needs_a_reset(name: str) -> None:
    detector = build(name)
    for frame in Scene(frames=3):
        detector(frame)
    other = Frame(4, 0.2, np.zeros((50, 60, 3), np.uint8))
    with pytest.raises(InputError, match=r"frame 4: .*60x50 .*160x120"):
        detector(other)
    detector.reset()
    assert len(detector(other)) == 0


def test_flicker_causes_no_detections() -> None:
    detector = ChangeDetector()
    counts = [len(detector(frame)) for frame in Scene(frames=120, squares=0, flicker=0.1)]
    assert sum(counts[5:]) == 0


def test_shadow_is_ignored_but_object_is_detected() -> None:
    scene = Scene(frames=40, squares=0)
    *learned, last = scene
    for factor, expected in ((0.85, 0), (0.3, 1)):
        detector = ChangeDetector()
        for frame in learned:
            detector(frame)
        image = last.image.copy()
        image[40:80, 60:90] = (image[40:80, 60:90] * factor).astype(np.uint8)
        assert len(detector(Frame(last.number, last.time, image))) == expected


def still(image: Image, count: int, start: int = 0, fps: float = 25.0) -> list[Frame]:
    rng = np.random.default_rng(9)
    noisy = [
        np.clip(image + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8)
        for _ in range(count)
    ]
    return [Frame(start + i + 1, (start + i) / fps, picture) for i, picture in enumerate(noisy)]


def with_object(image: Image, left: int) -> Image:
    out = image.copy()
    out[40:80, left : left + 24] = (20, 30, 230)
    return out


def test_stopped_object_is_absorbed_after_a_while() -> None:
    background = Scene().background()
    detector = make_detector("change", learn=1.0, adapt_objects=20.0)
    for frame in still(background, 10, fps=5):
        detector(frame)
    counts = [len(detector(frame)) for frame in still(with_object(background, 70), 300, 10, fps=5)]
    assert all(counts[:30])
    assert not any(counts[-20:])


def test_object_that_leaves_causes_no_ghost() -> None:
    background = Scene().background()
    detector = make_detector("change", learn=1.0)
    for frame in still(with_object(background, 70), 60):
        detector(frame)
    counts = [len(detector(frame)) for frame in still(background, 60, 60)]
    assert sum(counts) == 0


def test_signed_difference_detects_only_darker_objects() -> None:
    image = np.full((120, 160, 3), 128, np.uint8)
    both = image.copy()
    both[20:60, 20:50] = 20
    both[20:60, 100:130] = 240
    absolute = MeanBackgroundDetector(frames=1)
    signed = MeanBackgroundDetector(frames=1, signed=True)
    for detector in (absolute, signed):
        detector(Frame(1, 0.0, image))
    assert len(absolute(Frame(2, 0.04, both))) == 2
    dark = signed(Frame(2, 0.04, both))
    assert len(dark) == 1
    np.testing.assert_allclose(dark.xyxy, [[20, 20, 50, 60]], atol=3)


@pytest.mark.data
def test_people_in_pets_are_detected(data) -> None:  # type: ignore[no-untyped-def]
    from phdtrack.video import open_source

    folder = data / "mot15" / "PETS09-S2L1"
    rows = np.loadtxt(folder / "gt" / "gt.txt", delimiter=",")
    detector = make_detector("change")
    matched = found = there = 0
    for frame in open_source(folder / "PETS09-S2L1.mp4"):
        if frame.number > 100:
            break
        result: Detections = detector(frame)
        if frame.number <= 10:
            continue
        mine = rows[(rows[:, 0] == frame.number) & (rows[:, 6] != 0)]
        truth = np.hstack([mine[:, 2:4], mine[:, 2:4] + mine[:, 4:6]])
        overlap = iou(truth, result.xyxy)
        matched += int((overlap.max(axis=1, initial=0) >= 0.5).sum())
        found += len(result)
        there += len(truth)
    assert matched / there > 0.75
    assert matched / found > 0.75


def test_brief_object_leaves_no_ghost(rng: np.random.Generator) -> None:
    """A smooth blot hides the edges behind it, as a ghost does; learned at once it would be
    reported ever after.
    """
    detector = make_detector("change")
    wall = np.kron(rng.integers(60, 200, (30, 40)), np.ones((4, 4))).astype(np.uint8)
    wall = np.repeat(wall[:, :, None], 3, axis=2)
    found = []
    for number in range(1, 181):
        image = np.clip(wall + rng.normal(0, 1.5, wall.shape), 0, 255).astype(np.uint8)
        if number > 110 and number % 10 == 0:
            x = 10 + (number * 7) % 120
            blot = np.zeros(image.shape, np.float32)
            blot[40:64, x : x + 14] = 1
            blot = cv2.GaussianBlur(blot, (0, 0), 3)
            image = (image * (1 - blot) + 130 * blot).astype(np.uint8)
        found.append(len(detector(Frame(number, number / 25, image))))
    assert sum(found[160:169]) == 0


@pytest.mark.parametrize("name", ["change", "mean-background"])
def test_restored_detector_continues_identically(rng: np.random.Generator, name: str) -> None:
    images = rng.integers(80, 90, (80, 60, 80, 3), dtype=np.uint8)
    for k, image in enumerate(images):
        image[20:40, k % 60 : k % 60 + 12] = 200
    frames = [Frame(k + 1, k / 25, image) for k, image in enumerate(images)]
    first = build(name)
    second = build(name)
    for frame in frames[:60]:
        first(frame)
    # A copy: some arrays are changed in place.
    restore(second, deepcopy(knowledge(first)), frames[60])
    boxes = [(first(frame).xyxy, second(frame).xyxy) for frame in frames[60:]]
    assert sum(map(len, (before for before, _ in boxes))) >= 10
    for before, after in boxes:
        np.testing.assert_array_equal(after, before)
