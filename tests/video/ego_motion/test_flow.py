"""Sparse flow: a known path of the camera is found, in a rendered clip and in noise; where it
cannot be, that is told.
"""

import cv2
import numpy as np
import pytest

from moving_cases import filmed, handheld, moving, points, step
from phdtrack.models import warp as warp_of
from phdtrack.simulate import DetectorModel, Rendered, make_scene
from phdtrack.video.ego_motion import CameraMotion, SparseFlow

WINDOW = (440, 260)
CORNERS = np.array([[0.0, 440, 440, 0], [0, 0, 260, 260]])
NOBODY = np.zeros((0, 4))


@pytest.fixture(scope="module")
def clip():
    """Pictures of a street by a camera in a hand, the boxes in them, and the true maps between
    them.
    """
    scene = make_scene(
        "street", 1, DetectorModel(p_detect=0.9, clutter_rate=1.0), frames=40, lead_in=-6.0
    )
    path = np.array([[1.0, 0, -100], [0, 1.0, -50], [0, 0, 1.0]]) @ handheld(
        40, np.random.default_rng(3)
    )
    frames = [filmed(frame, path, WINDOW) for frame in Rendered(scene, np.random.default_rng(1))]
    return frames, moving(scene, path).detections, [step(path, frame.number) for frame in frames]


@pytest.mark.parametrize(
    ("form", "worst", "typical"), [("similarity", 0.8, 0.2), ("homography", 4.0, 1.0)]
)
@pytest.mark.parametrize("told", [True, False], ids=["boxes left out", "boxes not known"])
def test_motion_over_a_filmed_street_is_measured(
    clip, form: str, worst: float, typical: float, told: bool
):
    """In pixels, at the corners of the picture, where errors are largest."""
    frames, table, true = clip
    motion = CameraMotion(SparseFlow(form=form))
    errors = []
    for frame, wanted in zip(frames, true, strict=True):
        warp = motion(frame.image, table.at(frame.number).xyxy if told else NOBODY)
        assert motion.measured
        errors.append(np.abs(points(warp, CORNERS) - points(wanted, CORNERS)).max())
    assert max(errors[1:]) < worst
    assert np.median(errors[1:]) < typical


def texture(rng: np.random.Generator, high: int, wide: int) -> np.ndarray:
    blurred = cv2.GaussianBlur(rng.integers(0, 255, (high, wide), np.uint8), (0, 0), 2.5)
    return cv2.normalize(blurred, None, 0, 255, cv2.NORM_MINMAX)


def test_motion_of_a_large_picture_is_in_its_own_pixels(rng):
    """The middle of a zoom and a turn is where it is, to a tenth of a pixel of 1280 x 720."""
    wide = texture(rng, 900, 1500)
    c = 1.03 * np.cos(0.02)
    s = 1.03 * np.sin(0.02)
    there = np.array([[1.0, 0, 640], [0, 1.0, 360], [0, 0, 1.0]])
    turn = there @ np.array([[c, -s, 12.0], [s, c, -7.0], [0, 0, 1.0]]) @ warp_of.back(there)
    middle = np.array([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1.0]])
    shift = np.array([[1.0, 0, -110], [0, 1.0, -90], [0, 0, 1.0]])
    before, after = (
        cv2.warpPerspective(wide, warp_of.back(middle) @ warp @ middle, (1280, 720))
        for warp in (shift, turn @ shift)
    )
    motion = CameraMotion()
    motion(before, NOBODY)
    warp = motion(after, NOBODY)
    corners = np.array([[0.0, 1280, 1280, 0, 640], [0, 0, 720, 720, 360]])
    np.testing.assert_allclose(points(warp, corners), points(turn, corners), atol=0.25)
    np.testing.assert_allclose(points(warp, corners[:, 4:]), points(turn, corners[:, 4:]), atol=0.1)
    again = CameraMotion()
    again(before, NOBODY)
    np.testing.assert_array_equal(again(after, NOBODY), warp)


def test_detected_objects_do_not_affect_the_motion(rng):
    """A bus before a wall: most of the picture, and it drives one way while the camera turns the
    other.
    """
    wall = texture(rng, 240, 400)
    bus = texture(rng, 150, 230)
    pictures = []
    for k in range(2):
        picture = wall[20:220, 40 - 6 * k : 340 - 6 * k].copy()
        picture[25:175, 30 - 9 * k : 260 - 9 * k] = bus
        pictures.append(picture)
    box = np.array([[30.0, 25.0, 260.0, 175.0]])
    told = CameraMotion()
    untold = CameraMotion()
    told(pictures[0], box)
    untold(pictures[0], NOBODY)
    np.testing.assert_allclose(told(pictures[1], box)[:2, 2], [6.0, 0.0], atol=0.1)
    assert told.measured
    assert untold(pictures[1], NOBODY)[0, 2] < 0


@pytest.mark.parametrize("pair", ["blank", "cut", "size"])
def test_unmeasurable_motion_is_reported(pair: str, rng):
    one = np.zeros((200, 300), np.uint8) if pair == "blank" else texture(rng, 200, 300)
    two = {"blank": one, "cut": texture(rng, 200, 300), "size": texture(rng, 200, 200)}[pair]
    motion = CameraMotion()
    motion(one, NOBODY)
    np.testing.assert_array_equal(motion(two, NOBODY), np.eye(3))
    assert not motion.measured
    # The next pair is measured again.
    np.testing.assert_allclose(motion(two, NOBODY), np.eye(3), atol=1e-6)
    assert motion.measured == (pair != "blank")
