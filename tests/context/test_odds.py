"""Whether what is followed somewhere is a false alarm: how often a person saw either there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.context import ContextDensity, Followed, Learned, uniform_density
from phdtrack.context.odds import Odds

LOW, HIGH = np.zeros(4), np.array([640.0, 480, 640, 480])
VOLUME = (640.0 * 480) ** 2
FLAG, DOOR, STREET = (np.array([p], np.float64).T for p in ([500, 100, 40, 60], [60, 300, 40, 90], [300, 300, 40, 90]))
ANYWHERE = np.array([[400.0], [50], [20], [20]])
BEYOND = np.array([[-30.0], [500], [40], [90]])
NOT, YES = np.zeros(1, np.bool_), np.ones(1, np.bool_)


def at(place: np.ndarray, deviation: float, uniform: float) -> ContextDensity:
    """One place where boxes are detected, seldom anywhere else."""
    return ContextDensity(LOW, HIGH, uniform, np.ones(1), place, deviation**2 * np.eye(4)[None])


def peak(deviation: float) -> float:
    return (2 * np.pi * deviation**2) ** -2


FLAGS = Learned(3.0, at(FLAG, 4.0, 0.1))
PEOPLE = Learned(5.0, at(STREET, 20.0, 0.3))
# With the velocities, of which the odds know nothing.
ENTRY = ContextDensity(
    np.array([0.0, 0, -9, -9, 0, 0]), np.array([640.0, 480, 9, 9, 640, 480]), 0.2, np.ones(1),
    np.vstack([DOOR[:2], [[3], [0]], DOOR[2:]]), np.diag([25.0, 25, 1, 1, 25, 25])[None],
)  # fmt: skip
ODDS = Odds(FLAGS, Followed(0.4, PEOPLE))
WITH_BIRTHS = Odds(FLAGS, Followed(0.4, PEOPLE), Learned(0.02, ENTRY))


def test_the_odds_of_one_place_by_hand():
    """λ r̄ α_g N over the density of objects a frame; every Gaussian lies in the volume but for a millionth."""
    false, flat = 0.4 * 3.0 * 0.9 * peak(4.0), 5.0 * 0.3 / VOLUME
    assert ODDS.log(FLAG, NOT)[0] == pytest.approx(np.log(false / flat), rel=1e-6)
    two_off = FLAG + np.array([[8.0], [0], [0], [4]])
    assert ODDS.log(two_off, NOT)[0] == pytest.approx(np.log(false * np.exp(-0.5 * 5) / flat), rel=1e-6)
    both = FLAG + np.array([[0.0], [12], [0], [0]])
    people = flat + 5.0 * 0.7 * peak(20.0) * np.exp(-0.5 * ((both - STREET) ** 2).sum() / 400)
    assert ODDS.log(both, NOT)[0] == pytest.approx(np.log(false * np.exp(-4.5) / people), rel=1e-6)


def test_false_alarms_are_where_they_were_marked_and_nowhere_else():
    """Their uniform part tells of no place, so that an object may be anywhere else, beyond the volume too."""
    z = np.hstack([FLAG, STREET, ANYWHERE, BEYOND, DOOR])
    assert (ODDS.log(z, np.zeros(5, np.bool_)) < 0).tolist() == [False, True, True, True, True]
    assert np.isfinite(ODDS.log(z, np.zeros(5, np.bool_))).all()


def test_what_the_tracker_never_takes_for_somebody_is_never_false():
    odds = Odds(FLAGS, Followed(0.0, PEOPLE))
    assert (odds.log(np.hstack([FLAG, STREET, ANYWHERE, BEYOND]), np.zeros(4, np.bool_)) < 0).all()


def test_people_come_in_where_they_come_in():
    """Beside a flag at the door: who begins there is an object sooner than who is seen there later."""
    flag = Learned(3.0, at(DOOR, 4.0, 0.1))
    odds = Odds(flag, Followed(1e-3, PEOPLE), Learned(0.02, ENTRY))
    first, later = odds.log(DOOR, YES)[0], odds.log(DOOR, NOT)[0]
    assert first < 0 < later
    flat = 5.0 * 0.3 / VOLUME
    people = flat + 5.0 * 0.7 * peak(20.0) * np.exp(-0.5 * ((DOOR - STREET) ** 2).sum() / 400)
    born = 5.0 * (0.2 / VOLUME + 0.8 * peak(5.0))
    assert later == pytest.approx(np.log(1e-3 * 3.0 * 0.9 * peak(4.0) / people), rel=1e-6)
    assert first == pytest.approx(np.log(1e-3 * 3.0 * 0.9 * peak(4.0) / (people + born)), rel=1e-6)
    # Without births to know of, the first row is as any other.
    assert Odds(flag, Followed(1e-3, PEOPLE)).log(DOOR, YES)[0] == pytest.approx(later)


@given(
    x=st.floats(-100, 740), y=st.floats(-100, 580), w=st.floats(1, 700), h=st.floats(1, 700),
    share=st.floats(0, 1), rate=st.floats(0, 50), seen=st.floats(0, 50),
)  # fmt: skip
def test_the_odds_are_numbers_anywhere_and_births_only_lower_them(x, y, w, h, share, rate, seen):
    z = np.array([[x], [y], [w], [h]])
    followed = Followed(share, Learned(seen, PEOPLE.density))
    plain = Odds(Learned(rate, FLAGS.density), followed)
    births = Odds(Learned(rate, FLAGS.density), followed, Learned(0.02, ENTRY))
    assert np.isfinite(plain.log(z, NOT)).all()
    assert births.log(z, NOT) == plain.log(z, NOT)
    assert births.log(z, YES) <= plain.log(z, YES) + 1e-12
    half = Odds(Learned(rate, FLAGS.density), Followed(share / 2, followed.objects))
    assert half.log(z, NOT) <= plain.log(z, NOT) + 1e-12


def test_each_box_is_judged_by_itself(rng):
    z = np.hstack([FLAG, DOOR, STREET, ANYWHERE, BEYOND])
    z = z[:, rng.integers(0, 5, 40)] + rng.normal(0, 3, (4, 40))
    first = rng.random(40) < 0.5
    together = WITH_BIRTHS.log(z, first)
    alone = np.concatenate([WITH_BIRTHS.log(z[:, [k]], first[[k]]) for k in range(40)])
    np.testing.assert_array_equal(together, alone)
    none = np.zeros(0, np.bool_)
    assert WITH_BIRTHS.log(np.zeros((4, 0)), none).shape == ODDS.log(np.zeros((4, 0)), none).shape == (0,)


def test_a_scene_of_which_only_uniform_parts_are_known_holds_nobody_back():
    odds = Odds(Learned(3.0, uniform_density(LOW, HIGH)), Followed(1.0, Learned(1e-3, uniform_density(LOW, HIGH))))
    assert (odds.log(np.hstack([FLAG, STREET, BEYOND]), np.zeros(3, np.bool_)) < 0).all()


@given(odds=st.floats(1e-6, 10), share=st.floats(0.01, 1))
def test_odds_of_all_false_alarms_are_those_of_all_that_are_followed(odds, share):
    """Below it are the same places as if every false alarm were followed."""
    z = np.hstack([FLAG + 0.5 * k for k in range(20)])
    some, every = (Odds(FLAGS, Followed(part, PEOPLE)) for part in (share, 1.0))
    no = np.zeros(20, np.bool_)
    below = every.log(z, no) - np.log(odds)
    clear = np.abs(below) > 1e-9
    assert ((some.log(z, no) < some.of_all(odds)) == (below < 0))[clear].all()


def test_no_odds_are_low_enough_to_be_sure_where_none_are_asked_for():
    assert ODDS.of_all(0.0) == -np.inf
