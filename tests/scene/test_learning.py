import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.scene.training import learn_births, learn_clutter, learn_objects

SIZE = (640.0, 480.0)


def door(rng, n):
    """First states at one door, walking out of it."""
    mean, deviation = np.array([100.0, 300, 2, 0.5, 40, 90]), np.array([10.0, 15, 0.5, 0.5, 4, 8])
    return mean[:, None] + deviation[:, None] * rng.standard_normal((6, n))


def test_births_at_a_door():
    rng = np.random.default_rng(0)
    lesson = learn_births(door(rng, 200), time_units=5000, frame_size=SIZE)
    learned = lesson.learned
    assert learned.rate == pytest.approx(200 / 5000)
    assert learned.samples == 200
    heaviest = np.argmax(learned.density.weight)
    assert learned.density.mean[:, heaviest] == pytest.approx([100, 300, 2, 0.5, 40, 90], abs=4)
    # The entropy of the uniform density less that of the door's Gaussian, less what 160 samples leave uncertain.
    density = learned.density
    entropy = 0.5 * 6 * np.log(2 * np.pi * np.e) + np.log([10, 15, 0.5, 0.5, 4, 8]).sum()
    assert lesson.gain == pytest.approx(np.log(density.volume) - entropy, abs=0.5)


def test_samples_spread_evenly_teach_nothing():
    rng = np.random.default_rng(2)
    boxes = rng.uniform(0, 1, (4, 400)) * np.array([640.0, 480, 640, 480])[:, None]
    lesson = learn_clutter(boxes, frames=40, frame_size=SIZE)
    assert -0.5 < lesson.gain < 0.2


@pytest.mark.parametrize(("n", "time", "words"), [(13, 100, "at least 14 births"), (50, 0, "some length")])
def test_too_little_is_told(n, time, words):
    with pytest.raises(InputError, match=words):
        learn_births(door(np.random.default_rng(3), n), time, SIZE)


def test_fourteen_births_are_enough_and_ten_without_a_size():
    """As many as a component needs to exist: half the numbers that it is told by, 27 with a size and 14 without."""
    rng = np.random.default_rng(3)
    assert learn_births(door(rng, 14), 100, SIZE).learned.samples == 14
    on_ground = door(rng, 10)[:4] * 0.01
    assert learn_births(on_ground, 100, (30.0, 40.0), (-15.0, -20.0)).learned.rate == 0.1
    with pytest.raises(InputError, match="at least 10 births while the scene was watched, got 9"):
        learn_births(on_ground[:, 1:], 100, (30.0, 40.0), (-15.0, -20.0))


def test_objects_are_where_they_were_detected_so_many_a_frame():
    rng = np.random.default_rng(8)
    boxes = door(rng, 300)[[0, 1, 4, 5]]
    lesson = learn_objects(boxes, 40, SIZE)
    assert (lesson.learned.rate, lesson.learned.samples) == (7.5, 300)
    density = lesson.learned.density
    assert density.mean[:, np.argmax(density.weight)] == pytest.approx([100, 300, 40, 90], abs=3)
    # As what is learned of the same boxes as false alarms: the places of both can be compared.
    false = learn_clutter(boxes, 40, SIZE).learned.density
    np.testing.assert_array_equal(density.covariance, false.covariance)
    np.testing.assert_array_equal((density.low, density.high), (false.low, false.high))


def test_births_of_unknown_velocity_count_and_move_what_they_show():
    rng = np.random.default_rng(4)
    states = door(rng, 120)
    states[2:4, ::3] = np.nan
    lesson = learn_births(states, time_units=1000, frame_size=SIZE)
    assert lesson.learned.rate == pytest.approx(0.12)
    assert lesson.learned.samples == 120
    heaviest = np.argmax(lesson.learned.density.weight)
    assert lesson.learned.density.mean[:, heaviest] == pytest.approx([100, 300, 2, 0.5, 40, 90], abs=5)
    known = learn_births(states[:, np.isfinite(states[2])], 1000, SIZE)
    assert lesson.gain == pytest.approx(known.gain, abs=1)
    states[2:4] = np.nan
    with pytest.raises(InputError, match="no birth's velocity is known"):
        learn_births(states, 1000, SIZE)


def test_births_on_the_ground_have_no_size():
    """A region that does not begin at 0; the gain is that of the Gaussian over the region."""
    rng = np.random.default_rng(4)
    mean, deviation = np.array([-8.0, 6, 1, 0]), np.array([1.0, 0.7, 0.4, 0.4])
    states = mean[:, None] + deviation[:, None] * rng.standard_normal((4, 200))
    lesson = learn_births(states, 400.0, (30.0, 40.0), (-15.0, -20.0))
    density = lesson.learned.density
    np.testing.assert_array_equal(density.low[:2], [-15, -20])
    np.testing.assert_array_equal(density.high[:2], [15, 20])
    assert density.mean[:, np.argmax(density.weight)] == pytest.approx(mean, abs=0.3)
    entropy = 0.5 * 4 * np.log(2 * np.pi * np.e) + np.log(deviation).sum()
    assert lesson.gain == pytest.approx(np.log(density.volume) - entropy, abs=0.4)


def test_a_dozen_samples_from_anywhere_are_not_worth_less_than_nothing():
    """Gaussians explain every sample that they were fitted to; what is kept must not deny the next one its place."""
    rng = np.random.default_rng(6)
    low, high = np.array([0.0, 0, -4, -4, 30, 60]), np.array([640.0, 480, 4, 4, 60, 120])
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


def test_the_share_of_what_may_be_anywhere_is_learned_from_unseen_samples():
    rng = np.random.default_rng(7)
    anywhere = rng.uniform(0, 1, (4, 300)) * np.array([640.0, 480, 640, 480])[:, None]
    flag = np.array([500.0, 100, 30, 30])[:, None] + 3 * rng.standard_normal((4, 700))
    boxes = np.hstack([anywhere, flag])[:, rng.permutation(1000)]
    density = learn_clutter(boxes, 40, SIZE).learned.density
    assert density.uniform == pytest.approx(0.3, abs=0.06)


@pytest.mark.parametrize(
    ("learn", "words"),
    [(learn_objects, "of objects on the frames .*, got 9.* Look at"), (learn_clutter, "marked as false, got 9")],
)
def test_too_few_boxes_or_frames_are_told(learn, words):
    with pytest.raises(InputError, match=f"at least 10 detections {words}"):
        learn(np.ones((4, 9)), 40, SIZE)
    with pytest.raises(InputError, match="expected frames on which detections were looked at, got 0"):
        learn(np.ones((4, 20)), 0, SIZE)
