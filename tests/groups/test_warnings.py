"""Closest approach of groups that go on as they go."""

from dataclasses import replace

import numpy as np
import pytest
from group_cases import people

from phdtrack.groups.encounters import EncounterWarning


def test_approaching_people_raise_a_warning_in_time():
    (warned,) = EncounterWarning(horizon=6).expected(
        np.array([4, 2]), people([(0, 0, 1, 0), (10, 1, -1, 0)], sd=0)
    )
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
def test_groups_that_do_not_meet_raise_no_warning(first, second, group):
    assert EncounterWarning().expected(np.array([1, group]), people([first, second], sd=0)) == ()


def test_warning_probability_agrees_with_sampled_paths():
    cov = np.diag([0.04, 0.04, 0.01, 0.01])
    members = replace(people([(0, 0, 1, 0), (6, 1.8, -1, 0)]), covariance=np.stack([cov, cov]))
    (warned,) = EncounterWarning().expected(np.array([1, 2]), members)
    rng = np.random.default_rng(1)
    a, b = (rng.multivariate_normal(m, cov, 100_000).T for m in members.mean.T)
    apart = (a - b)[:2] + (a - b)[2:] * warned.seconds
    # Along the line of closest approach, which is what the deviation is of.
    assert warned.deviation == pytest.approx(apart[1].std(), rel=0.02)
    assert warned.probability == pytest.approx((np.abs(apart[1]) < 2).mean(), abs=0.02)


def test_most_probable_pair_of_members_is_reported():
    members = people([(0, 0, 1, 0), (0, 6, 1, 0), (6, 6.5, -1, 0)], sd=0)
    (warned,) = EncounterWarning().expected(np.array([1, 1, 2]), members)
    assert warned.distance == pytest.approx(0.5)
