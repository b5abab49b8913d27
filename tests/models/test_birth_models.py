"""Newborn particles stand for the mass of γ where they are drawn; κ and the volumes it is spread
over.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import kstest

from phdtrack.errors import InputError
from phdtrack.models import BoxClutter, BoxSensor, FixedBirth, MeasurementBirth, UniformClutter
from phdtrack.models.volumes import image_volume, local_volume
from phdtrack.types import GaussianMixture
from reference import birth_twin as twin
from reference.birth_twin import in_neighbourhood

FRAME = (640.0, 480.0)
ALONE = [[300.0, 200, 40, 90]]
APART = [*ALONE, [100.0, 300, 20, 60], [500.0, 100, 70, 80]]
OVERLAPPING = [*ALONE, [306.0, 205, 44, 80], [300.0, 200, 40, 90]]
TINY = [[300.0, 200, 2, 3]]


def columns(rows) -> np.ndarray:
    return np.array(rows, dtype=float).T.copy()


@pytest.mark.parametrize("rate", ["births_per_second", "births_per_detection"])
@pytest.mark.parametrize("covered", [0.0, 0.6])
@pytest.mark.parametrize(
    ("boxes", "few"),
    [(ALONE, 0.03), (APART, 0.03), (OVERLAPPING, 0.05), (TINY, 0.2)],
    ids=["alone", "apart", "near", "tiny"],
)
def test_weights_integrate_gamma_over_the_regions(
    boxes, few: float, covered: float, rate: str, rng
):
    """A thousand particles a detection give the mass within a few per cent, and on average without
    bias.

    Of a box of two by three pixels a good part of the region has sizes at which nothing is born.
    """
    z = columns(boxes)
    sensor = BoxSensor(box_noise=0.15)
    birth = MeasurementBirth(**{rate: 0.02}, particles=1000, frame_size=FRAME)
    masses = [
        birth.sample(z, np.full(z.shape[1], covered), sensor, 2.0, rng).mass for _ in range(80)
    ]
    sigma = sensor.noise(sensor.states(z)[0])[[0, 1, 4, 5]]

    def density(points, own):
        around = rate == "births_per_detection"
        return 2.0 * (
            twin.local_density(points, own, 0.02)
            if around
            else twin.image_density(points, 0.02, FRAME)
        )

    want = twin.mass(z, sigma, density, 200_000, rng)
    deviation = np.std(masses) / want
    # Half of the particles at M = 0.6, and so more deviation.
    assert deviation <= few * (1 + covered)
    assert np.mean(masses) == pytest.approx(want, rel=4 * deviation / math.sqrt(80) + 0.006)


def test_the_number_of_newborn_follows_what_is_predicted(rng):
    z = columns(APART)
    sensor = BoxSensor()
    birth = MeasurementBirth(0.01, particles=1000, frame_size=FRAME)
    born = birth.sample(z, np.array([0.0, 0.7494, 1.2]), sensor, 1.0, rng)
    nearest = np.argmin(np.abs(born.state[0][:, None] - z[0]), axis=1)
    np.testing.assert_array_equal(np.bincount(nearest, minlength=3), [1000, 251, 0])
    assert (
        len(
            MeasurementBirth(births_per_detection=0.0, frame_size=FRAME).sample(
                z, np.zeros(3), sensor, 1.0, rng
            )
        )
        == 0
    )


def test_newborn_lie_in_the_region_with_positive_sizes(rng):
    z = columns(ALONE)
    sensor = BoxSensor()
    born = MeasurementBirth(0.01, particles=4000, frame_size=FRAME).sample(
        z, np.zeros(1), sensor, 1.0, rng
    )
    x, cov = sensor.states(z)
    distance2 = (((born.state - x) ** 2).T / np.diag(cov[0]))[:, [0, 1, 4, 5]].sum(1)
    assert distance2.max() <= twin.REGION * (1 + 1e-9)
    assert (
        kstest(np.arctan2(born.state[3], born.state[2]), "uniform", (-math.pi, 2 * math.pi)).pvalue
        > 1e-3
    )
    # A Gaussian amplitude of variance a² in a uniform direction: a²/2 on each axis, and no
    # correlation.
    np.testing.assert_allclose(np.cov(born.state[2:4]), cov[0][2:4, 2:4], atol=0.1 * cov[0][2, 2])


@pytest.mark.parametrize(
    "sensor",
    [BoxSensor(min_noise=1.0), BoxSensor(box_noise=0.4, min_noise=0.0), BoxSensor(scaling="fixed")],
)
def test_nothing_is_born_without_extent(sensor: BoxSensor, rng):
    for rates in ((0.01, 0.0), (0.0, 0.01)):
        for _ in range(5):
            birth = MeasurementBirth(*rates, particles=1000, frame_size=FRAME)
            born = birth.sample(columns(TINY), np.zeros(1), sensor, 1.0, rng)
            assert len(born) > 0
            assert born.state[4:6].min() > 0
            assert np.all(born.weight > 0)
            assert np.isfinite(born.weight).all()


def test_births_over_the_image_need_the_frame_size(rng):
    with pytest.raises(InputError, match="frame-size"):
        MeasurementBirth(0.25).sample(columns(ALONE), np.zeros(1), BoxSensor(), 1.0, rng)
    # They replace those around detections.
    assert MeasurementBirth(0.25, 0.25).births_per_detection == 0


def test_fixed_births(rng):
    mean = np.array([[100.0, 50, 1, 0, 20, 40], [300, 60, 0, 1, 30, 50]]).T
    cov = np.stack([np.diag([9.0, 4, 1, 1, 2, 3]), np.eye(6) + 0.5])
    mixture = GaussianMixture(np.array([0.01, 0.04]), mean, cov)
    born = FixedBirth(mixture, 20_000).sample(np.zeros((4, 0)), np.zeros(0), BoxSensor(), 3.0, rng)
    assert born.mass == pytest.approx(0.15)
    first = born.state[0] < 200
    assert born.weight[first].sum() == pytest.approx(0.03)
    for part, want_mean, want_cov in zip((first, ~first), mean.T, cov, strict=True):
        np.testing.assert_allclose(
            born.state[:, part].mean(1), want_mean, atol=4 * 3 / math.sqrt(20_000)
        )
        np.testing.assert_allclose(np.cov(born.state[:, part]), want_cov, atol=0.4)


Z = np.array([[300.0, 200, 40, 90], [10, 20, 8, 6]]).T


def test_uniform_clutter_integrates_to_its_rate():
    volume = image_volume((640, 480))
    assert volume == 640**2 * 480**2
    np.testing.assert_allclose(UniformClutter(2.5, volume).intensity(Z) * volume, 2.5)
    assert UniformClutter(2.5, volume).intensity(np.zeros((4, 0))).shape == (0,)


def test_local_clutter_integrates_to_its_rate(rng):
    """±1 box in position, half to one and a half in size: the volume, by counting hits in a larger
    box.
    """
    for j in range(2):
        z = Z[:, [j]]
        low = z[:, 0] - 2 * z[[2, 3, 2, 3], 0]
        high = z[:, 0] + 2 * z[[2, 3, 2, 3], 0]
        points = rng.uniform(low[:, None], high[:, None], (4, 400_000))
        volume = in_neighbourhood(points, z).mean() * np.prod(high - low)
        assert local_volume(z)[0] == pytest.approx(volume, rel=0.04)
        assert BoxClutter(0.3).intensity(z)[0] * volume == pytest.approx(0.3, rel=0.04)


def test_what_a_box_may_be_does_not_depend_on_the_others(rng):
    """κ and γ are densities: of a box and nothing else, and the same at every scale."""
    z = np.stack(
        [
            rng.uniform(0, 150, 40),
            rng.uniform(0, 150, 40),
            rng.uniform(15, 40, 40),
            rng.uniform(30, 90, 40),
        ]
    )
    for density in (BoxClutter(0.7).intensity, MeasurementBirth(births_per_detection=0.7).density):
        np.testing.assert_array_equal(
            density(z), np.concatenate([density(z[:, [k]]) for k in range(40)])
        )
        # In units of twice the length each of four dimensions has half the value.
        np.testing.assert_allclose(density(2 * z) * 2**4, density(z), rtol=1e-12)


def test_the_volume_of_an_image_needs_its_size():
    with pytest.raises(InputError, match="frame"):
        image_volume((0, 480))
