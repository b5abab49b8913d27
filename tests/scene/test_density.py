import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.scene import SceneDensity
from phdtrack.scene.mixture import mass_inside
from views import drawn_of

LOW = np.array([0.0, 0.0, -2.0])
HIGH = np.array([10.0, 6.0, 2.0])


def leaking():
    """Two Gaussians with correlated components, of which a good part lies outside."""
    cov = np.array(
        [
            [[4.0, 1.5, 0.3], [1.5, 2.0, -0.4], [0.3, -0.4, 0.5]],
            [[1.0, 0, 0], [0, 1, 0], [0, 0, 4.0]],
        ]
    )
    mean = np.array([[0.5, 9.5], [3.0, 1.0], [1.5, 0.0]])
    return SceneDensity(LOW, HIGH, 0.2, np.array([0.7, 0.3]), mean, cov)


def cells(count):
    """Midpoints of count³ equal cells of the volume, and the volume of one."""
    axes = [
        lo + (hi - lo) * (np.arange(count) + 0.5) / count for lo, hi in zip(LOW, HIGH, strict=True)
    ]
    points = np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")])
    return points, np.prod(HIGH - LOW) / count**3


def test_density_integrates_to_one_inside_the_volume():
    points, cell = cells(80)
    assert leaking()(points).sum() * cell == pytest.approx(1, abs=2e-3)
    assert leaking()(np.array([[-0.1, 5.0], [3.0, 6.1], [0.0, 0.0]])).tolist() == [0, 0]


@pytest.mark.parametrize("count", [0, 1, 7, 40])
def test_every_gaussian_counts_that_the_last_digit_shows(count, rng):
    """The density against a plain sum, also where most Gaussians are far away, and without the
    uniform part 30 deviations away.
    """
    root = rng.normal(0, 1, (count, 3, 3))
    covariance = root @ root.transpose(0, 2, 1) / 40 + 0.004 * np.eye(3)
    mean = rng.uniform(LOW, HIGH, (count, 3)).T
    weight = np.full(count, 1 / max(count, 1))
    p = SceneDensity(LOW, HIGH, 0.3 if count else 1.0, weight, mean, covariance)
    points = rng.uniform(LOW - 0.5, HIGH + 0.5, (300, 3)).T
    step = points[:, None] - mean[:, :, None]
    distance2 = np.einsum("akn,kab,bkn->kn", step, np.linalg.inv(covariance), step)
    peak = p.gaussians.weight / np.sqrt(np.linalg.det(2 * np.pi * covariance))
    inside = ((points >= LOW[:, None]) & (points <= HIGH[:, None])).all(axis=0)
    plain = (peak[:, None] * np.exp(-distance2 / 2)).sum(axis=0)
    assert 100 < inside.sum() < 300
    wanted = np.where(inside, p.flat + plain, 5.0)
    np.testing.assert_allclose(p(points, outside=5.0), wanted, 1e-12)
    found = p.gaussian_part(points)
    np.testing.assert_allclose(found, np.where(inside, plain, 0.0), rtol=1e-9, atol=1e-300)
    if count == 1:
        assert found[found > 0].min() < 1e-60 * p.flat


def test_mass_inside_agrees_with_sampling():
    p = leaking()
    rng = np.random.default_rng(0)
    for m in range(2):
        drawn = rng.multivariate_normal(p.mean[:, m], p.covariance[m], 400_000).T
        part = ((drawn >= LOW[:, None]) & (drawn <= HIGH[:, None])).all(axis=0).mean()
        # Four standard errors of the drawing, and what the lattice may be off.
        assert p.truncated_mass[m] == pytest.approx(
            part, abs=4 * np.sqrt(part * (1 - part) / 400_000) + 1e-3
        )


def test_mass_inside_is_exact_for_independent_components():
    from scipy.stats import norm

    mean = np.array([[1.0], [2.0], [0.5]])
    deviation = np.array([3.0, 1.0, 2.0])
    expected = np.prod(norm.cdf(HIGH, mean[:, 0], deviation) - norm.cdf(LOW, mean[:, 0], deviation))
    assert mass_inside(mean, np.diag(deviation**2)[None], LOW, HIGH)[0] == pytest.approx(
        expected, rel=1e-12
    )


def test_draws_follow_the_density():
    p = leaking()
    rng = np.random.default_rng(1)
    drawn = drawn_of(p, 200_000, rng)
    assert ((drawn >= LOW[:, None]) & (drawn <= HIGH[:, None])).all()
    points, cell = cells(80)
    density = p(points) * cell
    for r in range(3):
        mean = (density * points[r]).sum()
        deviation = np.sqrt((density * points[r] ** 2).sum() - mean**2)
        assert drawn[r].mean() == pytest.approx(
            mean, abs=5 * deviation / np.sqrt(200_000) + 2e-3 * (HIGH - LOW)[r]
        )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"high": np.array([0.0, 6, 2])}, "exceed"),
        ({"uniform": 0.0}, "share of the uniform part"),
        ({"weight": np.array([0.7, 0.7])}, "with sum 1"),
        ({"weight": np.array([1.0])}, "do not fit"),
        ({"mean": np.full((3, 2), np.nan)}, "finite"),
        ({"covariance": np.zeros((2, 3, 3))}, "positive definite"),
    ],
)
def test_bad_arguments_are_refused(change, words):
    p = leaking()
    parts = {
        name: getattr(p, name)
        for name in ("low", "high", "uniform", "weight", "mean", "covariance")
    }
    with pytest.raises(InputError, match=words):
        SceneDensity(**(parts | change))
