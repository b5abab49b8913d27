"""Closest approach of groups that go on as they go."""

import numpy as np
import pytest

from phdtrack.groups.life_cycle import EncounterWarning
from phdtrack.types import GaussianMixture


def walking(mean, cov=0.0):
    n = mean.shape[1]
    return GaussianMixture(np.ones(n), mean, np.zeros((n, 4, 4)) + cov)


def test_two_who_walk_towards_each_other_are_warned_of_in_time():
    mean = np.array([[0, 0, 1, 0], [10, 1, -1, 0]], float).T
    (warned,) = EncounterWarning(horizon=6).expected(np.array([4, 2]), walking(mean))
    assert (warned.first, warned.second) == (2, 4)
    assert warned.seconds == pytest.approx(5.0)
    assert warned.distance == pytest.approx(1.0)
    assert warned.place == pytest.approx((5.0, 0.5))
    assert warned.probability == 1.0


@pytest.mark.parametrize(
    ("first", "second", "group"),
    [
        ((0, 0, 1, 0), (10, 1, -1, 0), 0),  # one of no group
        ((0, 0, -1, 0), (10, 0, 1, 0), 2),  # away from each other
        ((0, 0, 1, 0), (10, 5, -1, 0), 2),  # past each other, five metres apart
        ((0, 0, 1, 0), (40, 0, -1, 0), 2),  # beyond the horizon
        ((0, 0, 1, 0), (1, 0, -1, 0), 2),  # near already
        ((0, 0, 1, 0), (10, 0, 1, 0), 2),  # side by side in velocity
        ((0, 0, 1, 0), (6, 0, -1, 0), 1),  # of one group
    ],
)
def test_no_warning_where_groups_do_not_meet(first, second, group):
    mean = np.array([first, second], float).T
    assert EncounterWarning().expected(np.array([1, group]), walking(mean)) == ()


def test_the_deviation_and_the_probability_are_those_of_drawn_paths():
    cov = np.diag([0.04, 0.04, 0.01, 0.01])
    mean = np.array([[0, 0, 1, 0], [6, 1.8, -1, 0]], float).T
    (warned,) = EncounterWarning().expected(np.array([1, 2]), walking(mean, cov))
    rng = np.random.default_rng(1)
    a, b = (rng.multivariate_normal(m, cov, 100_000).T for m in mean.T)
    apart = (a - b)[:2] + (a - b)[2:] * warned.seconds
    # Along the line of closest approach, which is what the deviation is of.
    assert warned.deviation == pytest.approx(apart[1].std(), rel=0.02)
    assert warned.probability == pytest.approx((np.abs(apart[1]) < 2).mean(), abs=0.02)


def test_the_likeliest_pair_of_members_speaks_for_two_groups():
    mean = np.array([[0, 0, 1, 0], [0, 6, 1, 0], [6, 6.5, -1, 0]], float).T
    (warned,) = EncounterWarning().expected(np.array([1, 1, 2]), walking(mean))
    assert warned.distance == pytest.approx(0.5)
