"""Local clutter: each detection's neighbourhood carries the rate, and where neighbourhoods overlap the densities add up."""

import numpy as np
import pytest

from phdtrack.models import LocalClutter
from phdtrack.models.volumes import local_volume
from reference.birth_twin import in_neighbourhood


def test_a_lone_detection_has_the_rate_over_its_own_volume():
    z = np.array([[100.0], [80.0], [20.0], [50.0]])
    assert LocalClutter(0.3).intensity(z) == pytest.approx(0.3 / local_volume(z))


def test_crowded_detections_add_up(rng):
    z = np.stack([rng.uniform(0, 150, 40), rng.uniform(0, 150, 40), rng.uniform(15, 40, 40), rng.uniform(30, 90, 40)])
    kappa = LocalClutter(0.7).intensity(z)
    for i in range(40):
        near = [j for j in range(40) if in_neighbourhood(z[:, [i]], z[:, [j]])[0]]
        assert kappa[i] == pytest.approx(sum(0.7 / local_volume(z[:, [j]])[0] for j in near))
    assert (kappa > 1.5 * 0.7 / local_volume(z)).any()


def test_no_detections():
    assert LocalClutter(0.3).intensity(np.zeros((4, 0))).shape == (0,)
