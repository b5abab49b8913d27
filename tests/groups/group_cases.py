"""People on the ground as a mixture, for the tests of groups."""

import numpy as np

from phdtrack.types import F8, GaussianMixture


def people(
    states: list[tuple[float, float, float, float]],
    weight: list[float] | None = None,
    sd: float = 0.3,
) -> GaussianMixture:
    """A component for each (px, py, vx, vy), of weight 1 where none is given, as certain in every
    direction.
    """
    mean: F8 = np.array(states, dtype=np.float64).reshape(-1, 4).T
    n = mean.shape[1]
    return GaussianMixture(
        np.ones(n) if weight is None else np.array(weight),
        mean,
        np.tile(np.eye(4) * sd**2, (n, 1, 1)),
    )
