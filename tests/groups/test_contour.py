"""Level curves of the position intensity: circles of known radius, the area against counting
points, what has none.
"""

import numpy as np
import pytest
from group_cases import people

from phdtrack.groups.contours import Contours, polygon_area


def test_contour_of_one_person_is_a_circle():
    sd = 0.5
    (circle,) = Contours(grid_density=8, tolerance=0).of(
        people([(3, -2, 1, 0)], sd=sd), np.ones(1, np.bool_)
    )
    radius = sd * np.sqrt(2 * np.log(1 / (2 * np.pi * sd**2 * 0.1)))
    assert np.hypot(circle[0] - 3, circle[1] + 2) == pytest.approx(
        np.full(circle.shape[1], radius), rel=0.01
    )
    assert (circle[:, 0] == circle[:, -1]).all()
    assert polygon_area(circle) == pytest.approx(np.pi * radius**2, rel=0.02)


def test_uncertain_person_has_no_contour():
    # The peak is below the level where 2π sd² > 10.
    sd = np.sqrt(10 / (2 * np.pi))
    assert Contours().of(people([(0, 0, 0, 0)], sd=1.01 * sd), np.ones(1, np.bool_)) == ()
    assert len(Contours().of(people([(0, 0, 0, 0)], sd=0.97 * sd), np.ones(1, np.bool_))) == 1


def test_hole_of_a_ring_has_opposite_orientation():
    angle = np.arange(12) * np.pi / 6
    mixture = people([(3 * np.cos(a), 3 * np.sin(a), 0, 0) for a in angle], sd=0.45)
    areas = sorted(polygon_area(p) for p in Contours().of(mixture, np.ones(12, np.bool_)))
    assert len(areas) == 2
    assert areas[0] < 0 < areas[1]
    # Of a group of one nobody else counts.
    (one,) = Contours().of(mixture, np.arange(12) == 3)
    (wanted,) = Contours().of(people([(0, 3, 0, 0)], sd=0.45), np.ones(1, np.bool_))
    assert one == pytest.approx(wanted)


def test_area_is_that_of_points_above_the_level():
    rng = np.random.default_rng(3)
    mixture = people([(0, 0, 0, 0), (1, 0.5, 0, 0), (0.3, 1.4, 0, 0)], [1.0, 0.6, 1.4], sd=0.5)
    area = sum(polygon_area(p) for p in Contours(grid_density=8).of(mixture, np.ones(3, np.bool_)))
    points = rng.uniform(-3, 5, (2, 400_000))
    density = sum(
        w * np.exp(-((points - m[:2, None]) ** 2).sum(0) / 0.5) / (np.pi * 0.5)
        for w, m in zip(mixture.weight, mixture.mean.T, strict=True)
    )
    inside = (density > 0.1).mean()
    error = 64 * np.sqrt(inside * (1 - inside) / points.shape[1])
    assert area == pytest.approx(64 * inside, abs=5 * error + 0.01 * area)


def test_simplified_polygon_stays_within_tolerance():
    mixture = people([(0, 0, 0, 0), (1, 0.5, 0, 0)], sd=0.5)
    (exact,), (simple,) = (
        Contours(tolerance=t).of(mixture, np.ones(2, np.bool_)) for t in (0.0, 0.05)
    )
    assert simple.shape[1] < exact.shape[1] / 3
    a = simple[:, :-1, None]
    b = simple[:, 1:, None]
    along = np.clip(((exact[:, None] - a) * (b - a)).sum(0) / ((b - a) ** 2).sum(0), 0, 1)
    assert np.hypot(*(exact[:, None] - a - along * (b - a))).min(0).max() < 0.05 + 1e-6


@pytest.mark.parametrize("fineness", [2.0, 6.0])
def test_every_contour_is_closed(fineness):
    rng = np.random.default_rng(8)
    for _ in range(20):
        n = int(rng.integers(1, 8))
        states = [tuple(s) for s in rng.normal(0, 2, (n, 4))]
        mixture = people(states, rng.uniform(0.3, 2, n).tolist(), sd=float(rng.uniform(0.1, 1.2)))
        for curve in Contours(grid_density=fineness).of(mixture, np.ones(n, np.bool_)):
            assert (curve[:, 0] == curve[:, -1]).all()
