"""κ and the volumes it is spread over."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.models import BoxClutter, UniformClutter
from phdtrack.models.volumes import image_volume, local_volume
from reference.birth_twin import in_neighbourhood

Z = np.array([[300.0, 200, 40, 90], [10, 20, 8, 6]]).T


def test_uniform_clutter_integrates_to_its_rate():
    volume = image_volume((640, 480))
    assert volume == 640**2 * 480**2
    np.testing.assert_allclose(UniformClutter(2.5, volume).intensity(Z) * volume, 2.5)
    assert UniformClutter(2.5, volume).intensity(np.zeros((4, 0))).shape == (0,)


def test_local_clutter_integrates_to_its_rate_over_each_neighbourhood(rng):
    """±1 box in position, half to one and a half in size: the volume, by counting hits in a larger box."""
    for j in range(2):
        z = Z[:, [j]]
        low, high = z[:, 0] - 2 * z[[2, 3, 2, 3], 0], z[:, 0] + 2 * z[[2, 3, 2, 3], 0]
        points = rng.uniform(low[:, None], high[:, None], (4, 400_000))
        volume = in_neighbourhood(points, z).mean() * np.prod(high - low)
        assert local_volume(z)[0] == pytest.approx(volume, rel=0.04)
        assert BoxClutter(0.3).intensity(z)[0] * volume == pytest.approx(0.3, rel=0.04)


def test_where_neighbourhoods_overlap_densities_add_up(rng):
    z = np.stack([rng.uniform(0, 150, 40), rng.uniform(0, 150, 40), rng.uniform(15, 40, 40), rng.uniform(30, 90, 40)])
    kappa = BoxClutter(0.7).intensity(z)
    for i in range(40):
        near = [j for j in range(40) if in_neighbourhood(z[:, [i]], z[:, [j]])[0]]
        assert kappa[i] == pytest.approx(sum(0.7 / local_volume(z[:, [j]])[0] for j in near))
    assert (kappa > 1.5 * 0.7 / local_volume(z)).any()


def test_the_volume_of_an_image_needs_its_size():
    with pytest.raises(InputError, match="frame"):
        image_volume((0, 480))
