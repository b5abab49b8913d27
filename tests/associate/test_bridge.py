"""Bridged gaps against the textbook's Kalman filter and smoother."""

import numpy as np
from association_cases import model_of
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.models import warp as warp_of
from phdtrack.models.rts import bridge
from reference import graph_twin as twin


def spread(rng: np.random.Generator, d: int, scale: float) -> np.ndarray:
    root = rng.normal(size=(d, d))
    return scale * (root @ root.T / d + 0.2 * np.eye(d))


@given(
    st.integers(0, 2**32 - 1), st.lists(st.floats(0.1, 4.0), min_size=1, max_size=30), st.booleans()
)
@settings(max_examples=40, deadline=None)
def test_bridge_is_the_smoother(seed: int, steps: list[float], scaled: bool):
    rng = np.random.default_rng(seed)
    motion = model_of(
        scaled_noise=scaled,
        acceleration=0.05 if scaled else 1.0,
        size_noise=0.05 if scaled else 1.0,
    ).motion
    before = np.array([100.0, 200.0, *rng.normal(0, 3, 2), 40.0, 80.0])
    after = before + rng.normal(0, 20, 6)
    args = (before, spread(rng, 6, 4.0), after, spread(rng, 6, 4.0), np.array(steps))
    other = (before + 5.0, args[1], after - 3.0, args[3], args[4])
    ours = bridge(
        motion, tuple(np.stack(pair) for pair in zip(args[:4], other[:4], strict=True)), args[4]
    )
    assert ours.shape == (6, 2, len(steps) - 1)
    for n, one in enumerate((args, other)):
        np.testing.assert_allclose(ours[:, n], twin.smoothed(motion, *one), rtol=1e-9, atol=1e-9)


def zooming(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Pans and zooms, which scale what the noises are multiples of."""
    out = []
    for scale, x, y in zip(
        rng.uniform(0.9, 1.1, count), *rng.normal(0, 20, (2, count)), strict=True
    ):
        out.append(np.array([[scale, 0, x], [0, scale, y], [0, 0, 1.0]]))
    return out


def test_bridge_under_moving_camera_is_the_warped_still_one(rng):
    motion = model_of(scaled_noise=True).motion
    warps = zooming(rng, 5)
    before = np.array([300.0, 200.0, 2.0, -1.0, 40.0, 80.0])
    after = before + rng.normal(0, 9, 6)
    cov_before = spread(rng, 6, 3.0)
    cov_after = spread(rng, 6, 3.0)
    still = bridge(
        motion, (before[None], cov_before[None], after[None], cov_after[None]), np.ones(5)
    )[:, 0]
    whole = warp_of.after(warps)
    slope = warp_of.warp_jacobian(after[:, None], whole)[0]
    seen = warp_of.warp_states(after[:, None], whole)[:, 0]
    ends = before[None], cov_before[None], seen[None], (slope @ cov_after @ slope.T)[None]
    moving = bridge(motion, ends, np.ones(5), warps)[:, 0]
    for k in range(4):
        wanted = warp_of.warp_states(still[:, k : k + 1], warp_of.after(warps[: k + 1]))[:, 0]
        np.testing.assert_allclose(moving[:, k], wanted, rtol=1e-8, atol=1e-8)
