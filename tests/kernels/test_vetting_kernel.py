"""Who is believed of the rows of a frame, and who is remembered, against a dictionary."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.kernels.vetting import remembered, unbelieved
from reference import vetting_twin as twin


def frame(rng: np.random.Generator, rows: int, known: int):
    """Who is known, with his odds; and rows of identities known and new, seen and not."""
    names = np.sort(rng.choice(np.arange(1, 200), known, replace=False))
    odds = rng.choice([np.inf, 3.0, 0.0, -1.0, -20.0], (2, known))
    identity = rng.choice(np.arange(1, 220), rows, replace=False)
    corner = rng.uniform(0, 400, (rows, 2))
    xyxy = np.hstack([corner, corner + rng.uniform(10, 90, (rows, 2))])
    return names, odds, identity, rng.integers(-1, 3, rows), rng.random(rows) < 0.5, xyxy


@pytest.mark.parametrize("sure", [-np.inf, -5.0])
@pytest.mark.parametrize(("rows", "known"), [(0, 0), (0, 9), (5, 0), (12, 60), (60, 150)])
def test_whom_nobody_believes_yet_and_who_is_remembered(rows: int, known: int, sure: float, rng):
    for _ in range(20):
        given = frame(rng, rows, known)
        found, wanted = unbelieved(*given, sure), twin.unbelieved(*given, sure)
        for one, other in zip(found, wanted, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)
        names, odds, identity, _, confirmed, _ = given
        believed, which, least, _ = found
        asked = names, odds, identity, confirmed, believed, which, least, rng.normal(-2, 3, least.shape), sure
        for most in (1, known, known + 3, 10_000):
            new = remembered(*asked, most)
            for one, other in zip(new, twin.remembered(*asked, most), strict=True):
                np.testing.assert_array_equal(one, other)
            assert (np.diff(new[0]) > 0).all()
