"""The change detector where people stand, where they stand again and again, and where the light of
the scene changes.
"""

import numpy as np
import pytest

from phdtrack.detect import make_detector
from phdtrack.detect.scene_knowledge import study
from phdtrack.detect.scene_light import response
from phdtrack.types import Detections, Frame, Image

HEIGHT = 120
WIDTH = 160
FLOOR = (120, 150, 160)
# Left, top, right and bottom of a person.
PERSON = (64, 30, 92, 100)


def room() -> Image:
    """A textured room."""
    rng = np.random.default_rng(4)
    blocks = rng.integers(-30, 30, (HEIGHT // 8, WIDTH // 8, 1))
    texture = np.kron(blocks, np.ones((8, 8, 1), int))
    return np.clip(np.array(FLOOR) + texture, 0, 255).astype(np.uint8)


def with_person(image: Image, clothes: tuple[int, ...], shift: int = 0) -> Image:
    """A person, with a wide belt that looks like the room behind."""
    left, top, right, bottom = PERSON
    out = image.copy()
    out[top:bottom, left + shift : right + shift] = clothes
    out[58:66, left : right + shift] = image[58:66, left : right + shift]
    return out


def noisy(image: Image, number: int, fps: float) -> Frame:
    rng = np.random.default_rng(number)
    picture = np.clip(image + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)
    return Frame(number, (number - 1) / fps, picture)


def people(found: Detections) -> list[tuple[int, ...]]:
    return [tuple(round(x) for x in box) for box in found.xyxy]


def test_person_who_stands_long_keeps_one_box() -> None:
    """For five minutes: somebody who sways is not absorbed, however long he stays."""
    fps = 2.0
    detector = make_detector("change")
    empty = room()
    for k in range(1, 41):
        detector(noisy(empty, k, fps))
    shifts = np.random.default_rng(1).integers(-2, 3, 600)
    for k in range(41, 41 + 600):
        found = detector(noisy(with_person(empty, (60, 70, 80), int(shifts[k - 41])), k, fps))
        assert len(found) == 1, k
        np.testing.assert_allclose(found.xyxy[0], PERSON, atol=6)
    for k in range(641, 660):
        found = detector(noisy(empty, k, fps))
    assert people(found) == []


def visits() -> list[Frame]:
    """Three minutes of a room in which six people, most of them in dark clothes, stand at one place
    in turn, more than half of the time; a picture a second.
    """
    frames = list[Frame]()
    clothes = [(20, 20, 24), (24, 22, 20), (22, 20, 20), (30, 30, 160), (18, 22, 24), (22, 24, 22)]
    for k in range(180):
        there = k % 30 >= 14
        sway = (k * 7) % 3 - 1
        picture = with_person(room(), clothes[k // 30], sway) if there else room()
        frames.append(noisy(picture, k + 1, 1.0))
    return frames


def test_people_who_stand_at_one_place_are_not_the_scene() -> None:
    """Neither the median, as they are there most of the time, nor what samples often showed, as
    their clothes are alike.
    """
    frames = visits()
    detector = make_detector("change")
    study(detector, frames)
    for k, frame in enumerate(frames):
        found = people(detector(frame))
        if k == 0:
            continue
        if k % 30 >= 14:
            assert len(found) == 1, k
            np.testing.assert_allclose(found[0], PERSON, atol=6)
        else:
            assert found == [], k


def cloudy(gain: float) -> Image:
    """The room with a window, whose sky is as bright when the sun is gone."""
    image = np.clip(room() * gain, 0, 255).astype(np.uint8)
    image[:40, 100:] = (230, 220, 210)
    return image


@pytest.mark.parametrize("dim", [0.45, 0.6])
def test_a_sky_that_stays_bright_is_not_an_object(dim: float) -> None:
    rng = np.random.default_rng(8)
    gains = np.where(rng.random(60) < 0.5, 1.0, dim) * rng.uniform(0.9, 1.0, 60)
    frames = [noisy(cloudy(gain), k + 1, 2.0) for k, gain in enumerate(gains)]
    detector = make_detector("change")
    study(detector, frames)
    for frame in frames:
        assert people(detector(frame)) == []
    picture = cloudy(dim)
    left, top, right, bottom = PERSON
    picture[top:bottom, left:right] = (10, 10, 120)
    found = detector(noisy(picture, 61, 2.0))
    assert len(found) == 1
    np.testing.assert_allclose(found.xyxy[0], PERSON, atol=4)


def test_response_is_what_does_not_follow_the_light() -> None:
    """In a light of half the strength, one half of the picture keeps its brightness."""
    shape = (8, 8)
    n = 64 + 2 * 16
    scene = np.full(n, 128, np.uint8)
    scene[:64] = 116
    samples = list[Image]()
    lights = list[np.ndarray]()
    for gain in [0.5] * 5 + [1.0] * 10:
        picture = scene.copy()
        picture[:32] = 16 + round(gain * 100)
        samples.append(picture)
        light = np.eye(3, 4, dtype=np.float32)
        light[:, :3] *= gain
        lights.append(light)
    found = response(samples, lights, shape)
    assert found is not None
    np.testing.assert_allclose(found[:32], 0, atol=1)
    np.testing.assert_allclose(found[32:64], -100, atol=2)
    np.testing.assert_allclose(found[64:], 0, atol=1)
    assert response(samples[5:], lights[5:], shape) is None
