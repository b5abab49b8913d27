"""Connected components in position and velocity, against brute force; head counts and their
uncertainty.
"""

import numpy as np
import pytest
from group_cases import people
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.errors import InputError
from phdtrack.groups.clusters import Grouping


def brute_force(mean, near, slow):
    """Labels by spreading the smallest index along every link until nothing changes."""
    label = np.arange(mean.shape[1])
    while True:
        before = label.copy()
        for i in range(len(label)):
            for j in range(len(label)):
                d = np.hypot(*(mean[:2, i] - mean[:2, j]))
                v = np.hypot(*(mean[2:, i] - mean[2:, j]))
                if d < near and v < slow:
                    label[i] = label[j] = min(label[i], label[j])
        if (before == label).all():
            return label


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 25))
def test_groups_are_the_connected_components(seed, n):
    rng = np.random.default_rng(seed)
    mean = np.vstack([rng.uniform(0, 12, (2, n)), rng.normal(0, 0.7, (2, n))])
    found = Grouping().groups(people(list(map(tuple, mean.T))))
    truth = brute_force(mean, 2.0, 1.0)
    assert len(found.count) == len(np.unique(truth))
    assert ((found.label[:, None] == found.label) == (truth[:, None] == truth)).all()


def test_count_is_the_weight_sum_and_mean_is_weighted():
    found = Grouping().groups(people([(0, 0, 1, 0), (1, 0, 1, 0)], [1.0, 0.5]))
    assert found.count[0] == pytest.approx(1.5)
    assert found.mean[0, 0] == pytest.approx(1 / 3)
    # About the centre: the components' own variance and that of their means, w_1 w_2 / (w_1 +
    # w_2)².
    assert found.covariance[0, 0, 0] == pytest.approx(0.09 + 0.5 / 1.5**2)


def test_light_components_are_ignored():
    found = Grouping().groups(people([(0, 0, 0, 0), (1.5, 0, 0, 0), (3, 0, 0, 0)], [1.0, 0.2, 1.0]))
    assert found.label.tolist() == [0, -1, 1]
    assert found.count.tolist() == [1.0, 1.0]


def test_count_deviation_is_that_of_bernoulli_targets():
    weight = np.array([0.9, 0.6, 1.3, 2.0])
    found = Grouping().groups(people([(k, 0, 0, 0) for k in range(4)], weight.tolist()))
    rng = np.random.default_rng(5)
    draws = (np.floor(weight) + (rng.random((200_000, 4)) < weight % 1)).sum(1)
    assert found.count[0] == pytest.approx(draws.mean(), abs=5 * draws.std() / np.sqrt(len(draws)))
    # The relative standard error of a deviation of N draws is about 1/√(2N) = 0.16 %.
    assert found.deviation[0] == pytest.approx(draws.std(), rel=0.01)


def test_zero_distance_is_refused():
    with pytest.raises(InputError, match=r"Grouping\.max_distance"):
        Grouping(max_distance=0)
