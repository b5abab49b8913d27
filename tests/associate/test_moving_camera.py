"""Association under a camera that moves: in the pixels of each frame it does what it does where the camera stands."""

from dataclasses import replace

import numpy as np
import pytest
from association_cases import matching_of, model_of, states

from phdtrack.associate import Labelled
from phdtrack.models import warp as warp_of
from phdtrack.models.rts import bridge
from phdtrack.types import STILL, Estimates, Tracks

SIZES = (4, 5)


def zooming(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Pans and zooms, which scale what the noises are multiples of."""
    out = []
    for scale, x, y in zip(rng.uniform(0.9, 1.1, count), *rng.normal(0, 20, (2, count)), strict=True):
        out.append(np.array([[scale, 0, x], [0, scale, y], [0, 0, 1.0]]))
    return out


def spread(rng: np.random.Generator) -> np.ndarray:
    root = rng.normal(size=(6, 6))
    return root @ root.T / 2 + np.eye(6)


def test_a_bridge_under_a_moving_camera_is_the_still_one_carried_along(rng):
    motion, warps = model_of(scaled_noise=True).motion, zooming(rng, 5)
    before = np.array([300.0, 200.0, 2.0, -1.0, 40.0, 80.0])
    after, cov_before, cov_after = before + rng.normal(0, 9, 6), spread(rng), spread(rng)
    still = bridge(motion, (before, cov_before, after, cov_after), np.ones(5))
    whole = warp_of.after(warps)
    slope = warp_of.warp_jacobian(after[:, None], whole, SIZES)[0]
    seen = warp_of.warp_states(after[:, None], whole, SIZES)[:, 0]
    moving = bridge(motion, (before, cov_before, seen, slope @ cov_after @ slope.T), np.ones(5), warps)
    for k in range(4):
        wanted = warp_of.warp_states(still[:, k : k + 1], warp_of.after(warps[: k + 1]), SIZES)[:, 0]
        np.testing.assert_allclose(moving[:, k], wanted, rtol=1e-8, atol=1e-8)


def walkers(labelled: bool) -> list[Estimates]:
    """Two people who cross, one missing for four frames, one seen twice before it is believed."""
    out = []
    for k in range(40):
        at = np.array([[100.0 + 6 * k, 200.0], [400.0 - 6 * k, 220.0]])
        shown = np.array([not 12 <= k < 16, k > 2])
        found = states(at[shown], velocity=np.array([[6.0, 0.0], [-6.0, 0.0]])[shown])
        out.append(replace(found, tag=np.flatnonzero(shown)) if labelled else found)
    return out


def shifted(found: Estimates, by: np.ndarray) -> Estimates:
    state = found.state.copy()
    state[:2] += by[:, None]
    return replace(found, state=state, xyxy=found.xyxy + np.tile(by, 2))


def tracked(associator, frames: list[Estimates], path: np.ndarray, told: bool) -> tuple[Tracks, Tracks]:
    """Online and corrected rows, brought home into the pixels of the first frame, of a camera shifted along ``path``."""
    model, state, rows = model_of(), associator.start(), []
    for k, found in enumerate(frames):
        warp = np.eye(3)
        warp[:2, 2] = path[k] - path[max(0, k - 1)]
        seen = shifted(found, path[k])
        every = states(np.array([[100.0 + 6 * k, 200.0], [400.0 - 6 * k, 220.0]]) + path[k]).state[[0, 1, 4, 5]]
        here = replace(model, warp=warp if told and k else STILL)
        state, given = associator.extend(state, seen, every, k + 1, 1.0, here)
        rows.append(given)
    online = Tracks.concatenate([*rows, associator.flush(state, model)])
    return tuple(replace(t, xyxy=t.xyxy - np.tile(path[t.frame - 1], 2)) for t in (online, associator.finish(state, model)))


@pytest.mark.parametrize("associator", [
    matching_of(back_dating=5, max_coast=0.4), matching_of(output_delay=6), matching_of(output_delay=2, history=0.2),
    Labelled(max_coast=0.4), Labelled(output_delay=3),
], ids=["graph", "delayed", "forgetting", "labelled", "labelled, delayed"])  # fmt: skip
def test_rows_are_those_of_a_camera_that_stands(associator, rng):
    frames, path = walkers(isinstance(associator, Labelled)), np.cumsum(rng.normal(0, 25, (40, 2)), axis=0)
    still = tracked(associator, frames, np.zeros((40, 2)), told=False)
    moving = tracked(associator, frames, path, told=True)
    for ours, wanted in zip(moving, still, strict=True):
        assert len(wanted) > 40
        for name in ("frame", "identity", "detection", "confirmed"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(wanted, name))
        np.testing.assert_allclose(ours.xyxy, wanted.xyxy, atol=1e-6)
