"""The empty scene from samples of a whole file, and what does not differ from all of them."""

from __future__ import annotations

from copy import deepcopy

import cv2
import numpy as np
import pytest

from phdtrack.detect.base import pose_of
from phdtrack.detect.change import ChangeDetector
from phdtrack.detect.reference import Anchor, background, median, of_objects, stabilised
from phdtrack.detect.scene_knowledge import knowledge, restore, scene_warnings, study
from phdtrack.detect.scene_light import SceneLight
from phdtrack.detect.scene_samples import sample_history
from phdtrack.detect.wrappers import Rescaled
from phdtrack.devices import Planar, planes_of
from phdtrack.kernels.planes import luma, smooth
from phdtrack.types import STILL, Frame, Image
from reference import change_twin as twin


def scene(seed: int = 0) -> Image:
    """A grey ramp with noise that stays."""
    rng = np.random.default_rng(seed)
    ramp = np.linspace(90, 170, 160)[None, :, None] + rng.normal(0, 2, (120, 160, 1))
    return np.repeat(ramp, 3, axis=2).clip(0, 255).astype(np.uint8)


def crowd(count: int = 51) -> list[Image]:
    """Samples in which dark people stand around one place, one in each, which is hidden in most of
    them.
    """
    rng = np.random.default_rng(1)
    out = list[Image]()
    for _ in range(count):
        image = scene().astype(np.int16) + rng.integers(-2, 3, (120, 160, 1))
        left = 60 + rng.integers(-14, 15)
        top = 40 + rng.integers(-14, 15)
        image[top : top + 40, left : left + 24] = rng.integers(0, 50, 3)
        out.append(image.clip(0, 255).astype(np.uint8))
    return out


def seen(planes: Image) -> Image:
    """(H, W, 3) BGR of a scene's planes."""
    return Planar((160, 120), planes).bgr()


def test_median_equals_numpy() -> None:
    images = list(np.random.default_rng(2).integers(0, 256, (7, 297), dtype=np.uint8))
    np.testing.assert_array_equal(
        median(images), np.median(np.stack(images), axis=0).astype(np.uint8)
    )


def test_mostly_hidden_background_is_recovered() -> None:
    samples = [planes_of(image) for image in crowd()]
    shape = (120, 160)
    hidden = slice(56, 64), slice(70, 75)
    assert seen(median(samples))[hidden].mean() < 40
    reference, where = background(samples, shape)
    found = seen(reference).astype(float) - scene()
    assert np.abs(found[hidden]).mean() < 15
    assert np.abs(found).mean() < 2
    assert where[hidden].mean() > 0.9
    assert where.mean() < 0.1
    assert not background([planes_of(scene())] * 7, shape)[1].any()


def test_hidden_regions_are_as_large_as_objects() -> None:
    hidden = np.zeros((60, 80), np.bool_)
    hidden[10:15, 10:15] = hidden[40:50, 30:40] = hidden[50:60, 70:80] = True
    hidden[30:34, 5:60] = True  # long, but not wide
    least = np.linspace(3.0, 9.0, 60)
    large = np.zeros_like(hidden)
    large[9:16, 9:16] = large[39:51, 29:41] = large[49:60, 69:80] = True
    np.testing.assert_array_equal(of_objects(hidden, least, 3), large)
    assert not of_objects(hidden, np.full(60, 20.0), 3).any()


def test_object_hiding_a_place_most_of_the_time_is_detected() -> None:
    samples = crowd()
    detector = ChangeDetector()
    study(detector, [Frame(k + 1, k / 2, image) for k, image in enumerate(samples)])
    detector(Frame(1, 0.0, samples[0]))
    for k, image in enumerate(samples[1:], start=1):
        dark = np.argwhere(image.max(axis=2) < 60)
        top, left = dark.min(axis=0)
        bottom, right = dark.max(axis=0) + 1
        np.testing.assert_allclose(
            detector(Frame(k + 1, k / 2, image)).xyxy, [[left, top, right, bottom]], atol=6
        )


@pytest.mark.parametrize(("width", "jumps"), [(0, False), (100, False), (0, True), (100, True)])
def test_object_in_the_first_frame_is_detected(width: int, jumps: bool) -> None:
    frames = []
    for k in range(100):
        image = scene()
        if k < 30:
            image[30:90, 60:84] = 20
        frames.append(Frame(k + 1, k / 10, image))
    detector = ChangeDetector()
    asked = list[int]()

    def sample(count: int) -> list[Frame]:
        asked.append(count)
        return [frames[k] for k in np.linspace(0, 99, count).round().astype(int)]

    looked = Rescaled(detector, width) if width else detector
    # A file that can be jumped in is not decoded once more.
    study(looked, iter(()), sample) if jumps else study(looked, frames)
    assert detector.studied
    assert asked == ([51] if jumps else [])
    found = (Rescaled(detector, width) if width else detector)(frames[0])
    np.testing.assert_allclose(found.xyxy, [[60, 30, 84, 90]], atol=4)


def test_sample_extremes_equal_a_plain_sort() -> None:
    past = sample_history([planes_of(image) for image in crowd()], (120, 160))
    for found, expected in zip(
        (past.extremes, past.near), twin.extremes(past.samples, 120, 160), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("height", "width"), [(120, 160), (131, 77)])
def test_scene_noise_is_the_median_energy(height: int, width: int) -> None:
    """Learned in bands of rows, of which the last one may be lower and odd."""
    rng = np.random.default_rng(3)
    detector = ChangeDetector()
    ramp = np.linspace(60, 180, width)[None, :, None] + np.zeros((height, 1, 3))
    samples = [
        np.clip(ramp + rng.normal(0, 6, ramp.shape), 0, 255).astype(np.uint8) for _ in range(9)
    ]
    study(detector, [Frame(k + 1, k / 2, image) for k, image in enumerate(samples)])
    pictures = [planes_of(image) for image in samples]
    for one in pictures:
        smooth(one, (height, width))
    light = SceneLight((height, width), round((height * width / 2000) ** 0.5))
    energies = np.stack([detector.compared(one)[1] for one in light.levelled(pictures)])
    typical = (np.median(energies, axis=0) / np.float32(0.789)).astype(np.float32)
    usual = np.minimum(cv2.dilate(cv2.blur(typical, (5, 5)), np.ones((3, 3), np.uint8)), 60)
    np.testing.assert_allclose(detector.knowledge()["scene"], usual, rtol=1e-5)
    assert usual.std() > 0.1


def test_blinking_lamp_is_not_detected() -> None:
    frames = []
    for k in range(200):
        image = scene()
        if k // 5 % 2:
            image[20:50, 30:60] = 230
        frames.append(Frame(k + 1, k / 10, image))
    plain = ChangeDetector()
    learned = ChangeDetector()
    study(learned, frames)
    counts = [sum(len(detector(frame)) for frame in frames) for detector in (plain, learned)]
    assert counts[0] > 10
    assert counts[1] == 0


def test_moving_camera_and_dark_pictures_cause_warnings() -> None:
    wide = (
        np.random.default_rng(4)
        .integers(0, 256, (24, 60, 3), dtype=np.uint8)
        .repeat(5, axis=0)
        .repeat(5, axis=1)
    )
    still = [scene() for _ in range(51)]
    moving = [wide[:, 3 * k : 3 * k + 140].copy() for k in range(51)]
    dark = [image // 6 for image in still]
    for images, words in (
        (still, []),
        (moving, ["camera moves"]),
        (dark, ["dark"]),
        # Darker ones are black.
        ([m // 6 for m in moving], ["camera moves", "dark"]),
    ):
        detector = Rescaled(ChangeDetector(), 100)
        assert scene_warnings(detector) == ()
        frames = [Frame(k + 1, k / 2, image) for k, image in enumerate(images)]
        study(detector, frames)
        said = scene_warnings(detector)
        assert [
            word for word in ("camera moves", "dark") if any(word in sentence for sentence in said)
        ] == words
        assert all("--detector onnx:FILE" in sentence for sentence in said)


def test_scene_in_motion_is_not_blamed_on_the_camera() -> None:
    """Clouds, leaves and water change most of the picture; some corners stay where they are."""
    rng = np.random.default_rng(5)
    ground = rng.integers(0, 256, (10, 32, 3), np.uint8).repeat(5, axis=0).repeat(5, axis=1)

    def clouds(image: Image, k: int) -> None:
        light = rng.uniform(0.3, 1.7, (7, 16)).repeat(10, axis=0).repeat(10, axis=1)
        image[:70] = np.clip(image[:70] * light[..., None], 0, 255).astype(np.uint8)

    def leaves(image: Image, k: int) -> None:
        image[:70] = rng.integers(0, 256, (14, 32, 3)).repeat(5, axis=0).repeat(5, axis=1)

    def water(image: Image, k: int) -> None:
        waves = np.sin(np.arange(70)[:, None] / 3 + rng.uniform(0, 6, 32).repeat(5))
        image[:70] = (128 + 100 * waves[..., None]).astype(np.uint8)

    for move in (clouds, leaves, water):
        images = [np.concatenate([scene()[:70], ground]) for _ in range(51)]
        for k, image in enumerate(images):
            move(image, k)
        detector = ChangeDetector()
        study(detector, [Frame(k + 1, k / 2, image) for k, image in enumerate(images)])
        (said,) = scene_warnings(detector)
        assert "although the camera stands still" in said, move
        assert "--camera-motion" not in said


WALL = cv2.resize(
    np.random.default_rng(3).integers(60, 200, (30, 40, 3), np.uint8),
    (320, 240),
    interpolation=cv2.INTER_CUBIC,
)


def shaken(x: float, y: float, turn: float = 0.0, left: int = -1) -> tuple[Image, np.ndarray]:
    """A wall as a camera sees it that is moved by some pixels and turned, and (2, 3) where it moved
    to.

    Before it stands something dark, 30 pixels wide and 60 high, from column ``left`` on.
    """
    image = WALL.copy()
    if left >= 0:
        image[100:160, left : left + 30] = 20
    pose = cv2.getRotationMatrix2D((160, 120), turn, 1.0) + np.array([[0, 0, x], [0, 0, y]])
    return cv2.warpAffine(
        image, pose, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    ), pose


def test_pose_is_found_with_partial_occlusion() -> None:
    anchor = Anchor(luma(planes_of(WALL), (240, 320)))
    grey = {}
    for x, y, turn in ((0, 0, 0), (3.3, -5.6, 0), (-9, 12, 0.4)):
        image, pose = shaken(x, y, turn, left=100)
        grey[x] = planes_of(image)
        found = anchor.pose(luma(grey[x], (240, 320)))
        corners = np.array([[30, 290, 160], [30, 210, 120], [1, 1, 1]])
        np.testing.assert_allclose(found[:2] @ corners, pose @ corners, atol=0.25)
    back = stabilised(grey[3.3], (240, 320), anchor.pose(luma(grey[3.3], (240, 320))))
    was, before, after = (
        luma(each, (240, 320))[20:220, 140:300].astype(float)
        for each in (planes_of(WALL), grey[3.3], back)
    )
    assert np.abs(after - was).mean() < 3 < np.abs(before - was).mean() / 3


def test_without_corners_the_camera_is_assumed_still() -> None:
    plain = np.full((240, 320), 100, np.uint8)
    wall = luma(planes_of(WALL), (240, 320))
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), np.uint8)
    for one, other in ((plain, plain), (plain, wall), (wall, plain), (wall, noise)):
        assert Anchor(one).pose(other) is STILL


def passing(amount: float, hidden: tuple[int, ...] = ()) -> tuple[list[Frame], list[np.ndarray]]:
    """Frames of a camera that shakes, with something dark that passes, and its boxes; the
    ``hidden`` frames are white.
    """
    rng = np.random.default_rng(5)
    frames = list[Frame]()
    truth = []
    for k in range(80):
        left = 20 + 3 * k
        x, y = amount * rng.standard_normal(2)
        image, pose = shaken(x, y, left=left)
        truth.append(np.array([left, 100, left + 30, 160]) + np.tile(pose[:, 2], 2))
        image = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
        image[:] = 255 if k in hidden else image
        frames.append(Frame(k + 1, k / 10, Planar((320, 240), planes_of(image))))
    return frames, truth


@pytest.mark.parametrize("amount", [0.0, 4.0])
@pytest.mark.parametrize("width", [0, 200])
def test_objects_are_detected_with_a_shaking_camera(amount: float, width: int) -> None:
    frames, truth = passing(amount)
    inner = ChangeDetector()
    detector = Rescaled(inner, width) if width else inner
    study(detector, frames)
    counts = []
    misses = []
    moved = []
    for frame, true in zip(frames, truth, strict=True):
        found = detector(frame).xyxy
        pose = pose_of(detector, frame)
        assert (len(pose) > 0) == (amount > 0)
        if amount:
            # The wall lies where it lies in the last frame, but for what the camera moved.
            moved.append(pose[:2, 2] - true[:2] + [3 * frame.number, 0])
        counts.append(len(found))
        misses.append(np.abs(found - true).max(axis=1).min() if len(found) else np.inf)
    assert np.mean(np.array(counts) == 1) > 0.9
    assert np.median(misses) < (6 if width else 4)
    assert not amount or np.ptp(moved, axis=0).max() < 1.5


def test_lost_pose_suspends_detection_for_a_while() -> None:
    # Among them the one in the middle, which would otherwise be what the others are laid onto.
    frames, _ = passing(4.0, hidden=(39, 40, 41, *range(60, 80)))
    detector = ChangeDetector()
    study(detector, frames)
    seen = [detector(frame).observed for frame in frames]
    assert not any(seen[39:42])
    assert all(seen[:39])
    assert all(seen[42:60])
    # The camera may stand elsewhere for good.
    assert not any(seen[60:79])
    assert detector(Frame(81, 8.5, frames[-1].picture)).observed


def test_restored_detector_continues_with_a_shaking_camera() -> None:
    frames, _ = passing(4.0)
    first = ChangeDetector()
    second = ChangeDetector()
    for detector in (first, second):
        study(detector, frames)
    for frame in frames[:30]:
        first(frame)
    restore(second, deepcopy(knowledge(first)), frames[30])
    for frame in frames[30:]:
        np.testing.assert_array_equal(second(frame).xyxy, first(frame).xyxy)
        np.testing.assert_array_equal(second.pose, first.pose)


def test_one_textured_patch_is_not_a_shaking_camera() -> None:
    rng = np.random.default_rng(8)
    frames = list[Frame]()
    for k in range(60):
        image = np.full((240, 320, 3), 120.0)
        image[30:90, 40:100] = WALL[30:90, 40:100]
        image = np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
        frames.append(Frame(k + 1, k / 10, Planar((320, 240), planes_of(image))))
    detector = ChangeDetector()
    study(detector, frames)
    detector(frames[0])
    assert len(detector.pose) == 0
