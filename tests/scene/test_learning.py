import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.scene.training import FALSE_BOXES, OBJECT_BOXES, learn_births, learn_boxes

SIZE = (640.0, 480.0)
MEAN = np.array([100.0, 300, 2, 0.5, 40, 90])
DEVIATION = np.array([10.0, 15, 0.5, 0.5, 4, 8])


def door(rng, n):
    """First states at one door, walking out of it."""
    return MEAN[:, None] + DEVIATION[:, None] * rng.standard_normal((6, n))


def test_births_at_a_door_are_learned():
    """Some velocities are unknown."""
    mean = MEAN
    deviation = DEVIATION
    states = door(np.random.default_rng(4), 200)
    lesson = learn_births(states, 5000, SIZE)
    density = lesson.learned.density
    learned = lesson.learned
    assert (learned.rate, learned.samples) == (200 / 5000, 200)
    assert (np.abs(density.mean[:, np.argmax(density.weight)] - mean) < 0.4 * deviation).all()
    # The entropy of the uniform density less that of the door's Gaussian, less what 160 samples
    # leave uncertain.
    entropy = 0.5 * len(mean) * np.log(2 * np.pi * np.e) + np.log(deviation).sum()
    assert lesson.gain == pytest.approx(np.log(density.volume) - entropy, abs=0.5)
    states[2:4, ::3] = np.nan
    fewer = learn_births(states, 5000, SIZE)
    assert (fewer.learned.rate, fewer.learned.samples) == (200 / 5000, 200)
    known = learn_births(states[:, np.isfinite(states[2])], 5000, SIZE)
    assert fewer.gain == pytest.approx(known.gain, abs=1)
    states[2:4] = np.nan
    with pytest.raises(InputError, match="no birth has a known velocity"):
        learn_births(states, 5000, SIZE)


def test_too_few_samples_are_reported():
    """A component needs as many births as half the number of its parameters, 27."""
    born = door(np.random.default_rng(3), 14)
    assert learn_births(born, 100, SIZE).learned.samples == 14
    for learn, arguments, words in (
        (learn_births, (born[:, 1:], 100, SIZE), "at least 14 births"),
        (learn_births, (born, 0, SIZE), "expected a duration above 0"),
        (
            learn_boxes,
            (np.ones((4, 9)), 40, SIZE, OBJECT_BOXES),
            "at least 10 objects .*, got 9.* Check",
        ),
        (
            learn_boxes,
            (np.ones((4, 9)), 40, SIZE, FALSE_BOXES),
            "at least 10 detections marked as false, got 9",
        ),
        (
            learn_boxes,
            (np.ones((4, 20)), 0, SIZE, FALSE_BOXES),
            "expected frames on which detections were checked, got 0",
        ),
    ):
        with pytest.raises(InputError, match=words):
            learn(*arguments)


def test_object_density_and_rate_are_learned():
    rng = np.random.default_rng(8)
    boxes = door(rng, 300)[[0, 1, 4, 5]]
    lesson = learn_boxes(boxes, 40, SIZE, OBJECT_BOXES)
    assert (lesson.learned.rate, lesson.learned.samples) == (7.5, 300)
    density = lesson.learned.density
    assert density.mean[:, np.argmax(density.weight)] == pytest.approx([100, 300, 40, 90], abs=3)
    # As what is learned of the same boxes as false alarms: the places of both can be compared.
    false = learn_boxes(boxes, 40, SIZE, FALSE_BOXES).learned.density
    np.testing.assert_array_equal(density.covariance, false.covariance)
    np.testing.assert_array_equal((density.low, density.high), (false.low, false.high))


def test_few_uniform_samples_do_not_harm():
    """Gaussians explain every sample that they were fitted to; what is kept must not deny the next
    one its place.
    """
    rng = np.random.default_rng(6)
    low = np.array([0.0, 0, -4, -4, 30, 60])
    high = np.array([640.0, 480, 4, 4, 60, 120])
    lesson = learn_births(rng.uniform(low[:, None], high[:, None], (6, 15)), 1000, SIZE)
    assert lesson.gain > -0.01
    fresh = rng.uniform(low[:, None], high[:, None], (6, 1000))
    density = lesson.learned.density
    inside = density.contains(fresh)
    assert density.log(fresh[:, inside]).mean() + np.log(density.volume) > -1
    # Fifteen at one door do say where the next one comes.
    at_door = learn_births(door(rng, 15), 1000, SIZE)
    assert at_door.gain > 5
    assert at_door.learned.density.uniform < 0.3


def test_uniform_share_is_learned_from_held_out_samples():
    rng = np.random.default_rng(7)
    anywhere = rng.uniform(0, 1, (4, 300)) * np.array([640.0, 480, 640, 480])[:, None]
    flag = np.array([500.0, 100, 30, 30])[:, None] + 3 * rng.standard_normal((4, 700))
    boxes = np.hstack([anywhere, flag])[:, rng.permutation(1000)]
    density = learn_boxes(boxes, 40, SIZE, FALSE_BOXES).learned.density
    assert density.uniform == pytest.approx(0.3, abs=0.06)
