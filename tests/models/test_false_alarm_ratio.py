"""Whether what is followed somewhere is a false alarm: how often a person saw either there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.models.scene import FalseAlarmRatio
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects, uniform_density
from phdtrack.scene.mixture import OBSERVED, marginal

LOW, HIGH = np.zeros(4), np.array([640.0, 480, 640, 480])
VOLUME = (640.0 * 480) ** 2
FLAG, DOOR, STREET = (np.array([p], np.float64).T for p in ([500, 100, 40, 60], [60, 300, 40, 90], [300, 300, 40, 90]))
ANYWHERE = np.array([[400.0], [50], [20], [20]])
BEYOND = np.array([[-30.0], [500], [40], [90]])


def at(place: np.ndarray, deviation: float, uniform: float) -> SceneDensity:
    """One place where boxes are detected, seldom anywhere else."""
    return SceneDensity(LOW, HIGH, uniform, np.ones(1), place, deviation**2 * np.eye(4)[None])


def peak(deviation: float) -> float:
    return (2 * np.pi * deviation**2) ** -2


FLAGS = LearnedDensity(3.0, at(FLAG, 4.0, 0.1))
PEOPLE = LearnedDensity(5.0, at(STREET, 20.0, 0.3))
ODDS = FalseAlarmRatio(FLAGS, TrackedObjects(0.4, PEOPLE))


# With the velocities, of which the odds know nothing.
ENTRY = SceneDensity(
    np.array([0.0, 0, -9, -9, 0, 0]), np.array([640.0, 480, 9, 9, 640, 480]), 0.2, np.ones(1),
    np.vstack([DOOR[:2], [[3], [0]], DOOR[2:]]), np.diag([25.0, 25, 1, 1, 25, 25])[None],
)  # fmt: skip


def followed(z, odds: FalseAlarmRatio = ODDS) -> np.ndarray:
    """(N,) of those that are followed."""
    return odds.log(z)[0]


def test_the_odds_of_one_place_by_hand():
    """λ r̄ α_g N over the density of objects a frame; every Gaussian lies in the volume but for a millionth."""
    false, flat = 0.4 * 3.0 * 0.9 * peak(4.0), 5.0 * 0.3 / VOLUME
    assert followed(FLAG)[0] == pytest.approx(np.log(false / flat), rel=1e-6)
    two_off = FLAG + np.array([[8.0], [0], [0], [4]])
    assert followed(two_off)[0] == pytest.approx(np.log(false * np.exp(-0.5 * 5) / flat), rel=1e-6)
    both = FLAG + np.array([[0.0], [12], [0], [0]])
    people = flat + 5.0 * 0.7 * peak(20.0) * np.exp(-0.5 * ((both - STREET) ** 2).sum() / 400)
    assert followed(both)[0] == pytest.approx(np.log(false * np.exp(-4.5) / people), rel=1e-6)


def test_of_any_false_alarm_the_uniform_part_counts_and_not_whether_it_is_followed():
    """κ over the density of objects a frame: where nothing was ever seen it is that of the uniform parts."""
    z = np.hstack([FLAG, ANYWHERE])
    false = 3.0 * (0.1 / VOLUME + np.array([0.9 * peak(4.0), 0]))
    np.testing.assert_allclose(ODDS.log(z)[1], np.log(false / (5.0 * 0.3 / VOLUME)), rtol=1e-6)
    assert ODDS.log(BEYOND)[1] == pytest.approx(np.log(3.0 * 0.1 / (5.0 * 0.3)))
    np.testing.assert_array_equal(ODDS.log(z)[1], FalseAlarmRatio(FLAGS, TrackedObjects(0.1, PEOPLE)).log(z)[1])


def test_who_comes_in_where_others_did_is_no_false_alarm_that_is_seen_once():
    """As many detections as objects have, spread as places of births: not their uniform part, nor of who is followed."""
    odds = FalseAlarmRatio(FLAGS, TrackedObjects(0.4, PEOPLE), LearnedDensity(0.02, ENTRY))
    z, flat = np.hstack([DOOR, FLAG, ANYWHERE, BEYOND]), 5.0 * 0.3 / VOLUME
    people = flat + 5.0 * 0.7 * peak(20.0) * np.exp(-0.5 * ((DOOR - STREET) ** 2).sum() / 400)
    wanted = 3.0 * 0.1 / VOLUME / (people + 5.0 * 0.8 * peak(5.0))
    assert odds.log(z)[1, 0] == pytest.approx(np.log(wanted), rel=1e-6)
    np.testing.assert_allclose(odds.log(z)[1, 1:], ODDS.log(z)[1, 1:])
    np.testing.assert_array_equal(odds.log(z)[0], ODDS.log(z)[0])


def test_false_alarms_are_where_they_were_marked_and_nowhere_else():
    """Their uniform part tells of no place, so that an object may be anywhere else, beyond the volume too."""
    z = np.hstack([FLAG, STREET, ANYWHERE, BEYOND, DOOR])
    assert (followed(z) < 0).tolist() == [False, True, True, True, True]
    assert np.isfinite(ODDS.log(z)).all()


def test_what_the_tracker_never_takes_for_somebody_is_never_false():
    odds = FalseAlarmRatio(FLAGS, TrackedObjects(0.0, PEOPLE))
    assert (followed(np.hstack([FLAG, STREET, ANYWHERE, BEYOND]), odds) < 0).all()


@given(
    x=st.floats(-100, 740), y=st.floats(-100, 580), w=st.floats(1, 700), h=st.floats(1, 700),
    share=st.floats(0, 1), rate=st.floats(0, 50), seen=st.floats(0, 50),
)  # fmt: skip
def test_the_odds_are_numbers_anywhere_and_fewer_are_followed_than_there_are(x, y, w, h, share, rate, seen):
    z = np.array([[x], [y], [w], [h]])
    objects = LearnedDensity(seen, PEOPLE.density)
    some, any_ = FalseAlarmRatio(LearnedDensity(rate, FLAGS.density), TrackedObjects(share, objects)).log(z)[:, 0]
    assert np.isfinite([some, any_]).all()
    assert some <= any_ + 1e-12
    assert (
        followed(z, FalseAlarmRatio(LearnedDensity(rate, FLAGS.density), TrackedObjects(share / 2, objects)))[0]
        <= some + 1e-12
    )


def test_each_box_is_judged_by_itself(rng):
    z = np.hstack([FLAG, DOOR, STREET, ANYWHERE, BEYOND])
    z = z[:, rng.integers(0, 5, 40)] + rng.normal(0, 3, (4, 40))
    np.testing.assert_array_equal(ODDS.log(z), np.hstack([ODDS.log(z[:, [k]]) for k in range(40)]))
    assert ODDS.log(np.zeros((4, 0))).shape == (2, 0)


def test_a_scene_of_which_only_uniform_parts_are_known_holds_nobody_back():
    odds = FalseAlarmRatio(
        LearnedDensity(3.0, uniform_density(LOW, HIGH)),
        TrackedObjects(1.0, LearnedDensity(1e-3, uniform_density(LOW, HIGH))),
    )
    assert (followed(np.hstack([FLAG, STREET, BEYOND]), odds) < 0).all()


def test_it_is_what_the_densities_say(rng):
    """Near all places at once, against the densities one by one."""
    z = np.hstack([place + rng.normal(0, 4, (4, 30)) for place in (FLAG, DOOR, STREET)])
    births = LearnedDensity(0.02, ENTRY)
    alarms = LearnedDensity(3.0, SceneDensity(LOW, HIGH, 0.1, np.ones(1), STREET, 900 * np.eye(4)[None]))
    p = marginal(ENTRY, OBSERVED)
    places = alarms.rate * (np.exp(alarms.density.log(z)) - alarms.density.flat)
    people, enter = PEOPLE.rate * np.exp(PEOPLE.density.log(z)), PEOPLE.rate * (np.exp(p.log(z)) - p.flat)
    wanted = np.log([0.4 * places / people, (places + alarms.rate * alarms.density.flat) / (people + enter)])
    np.testing.assert_allclose(FalseAlarmRatio(alarms, TrackedObjects(0.4, PEOPLE), births).log(z)[1], wanted[1], rtol=1e-6)
    near = wanted[0] > -20
    assert near.sum() >= 25
    np.testing.assert_allclose(
        FalseAlarmRatio(alarms, TrackedObjects(0.4, PEOPLE)).log(z)[0, near], wanted[0, near], rtol=1e-4
    )
