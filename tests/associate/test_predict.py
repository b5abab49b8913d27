"""The window's states are those of the motion model, step by step: for any model, and for more than fit in one block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from association_cases import matching_of, model_of, states

from phdtrack.associate.predict import BLOCK, predicted
from phdtrack.associate.triangle import block, lower, whole
from phdtrack.associate.window import Columns, Edges, Rows, Window
from phdtrack.errors import InputError
from phdtrack.protocols import Motion
from phdtrack.types import Estimates

BOXES = model_of().motion
SHOWN = list(model_of().sensor.observed)


@dataclass(frozen=True, slots=True)
class Turning:
    """Each target turns as fast as it is large, so that no two have one Jacobian."""

    def transition(self, x, dt):
        angle, n = 0.01 * dt * x[4], x.shape[1]
        f = np.zeros((n, 6, 6))
        f[:, range(6), range(6)] = 1.0
        f[:, 0, 2] = f[:, 1, 3] = dt
        f[:, 2, 2] = f[:, 3, 3] = np.cos(angle)
        f[:, 3, 2] = np.sin(angle)
        f[:, 2, 3] = -f[:, 3, 2]
        noise = np.einsum("n,rs->nrs", 0.1 * x[5], np.eye(6) + 0.1)
        return np.einsum("nrs,sn->rn", f, x), f, noise


@dataclass(frozen=True, slots=True)
class Shared:
    """One Jacobian for all states, dense."""

    def transition(self, x, dt):
        f = np.eye(6) + 0.1 * dt * np.arange(36).reshape(6, 6) / 36
        return f @ x, np.broadcast_to(f, (x.shape[1], 6, 6)), np.tile(np.eye(6), (x.shape[1], 1, 1))


def window_of(mean, cov, count: int) -> Window:
    """A window of ``count`` open vertices, whose states are the last."""
    none, zero = np.full(count, -1), np.zeros(count)
    edges = Edges(np.zeros(count + 1, np.int64), np.zeros(0, np.int64), np.zeros(0))
    rows = Rows(0, zero, none, zero, zero, edges, edges)
    row, column = np.tril_indices(6)
    return Window(Columns(0, none, zero), rows, mean, np.ascontiguousarray(cov[:, row, column].T))


@pytest.mark.parametrize("motion", [BOXES, Turning(), Shared()], ids=lambda m: type(m).__name__)
@pytest.mark.parametrize(("count", "n"), [(0, 3), (5, 0), (7, 4), (BLOCK, 2), (2 * BLOCK + 3, 5)])
def test_every_state_is_moved_and_the_new_ones_are_behind(motion: Motion, count: int, n: int):
    rng, gone = np.random.default_rng(count), 2
    mean = rng.uniform(5, 60, (6, gone + count))
    root = rng.normal(size=(gone + count, 6, 6))
    cov = root @ root.transpose(0, 2, 1)
    new = states(rng.uniform(0, 400, (n, 2)))
    before = mean.copy()
    result = predicted(window_of(mean, cov, count), new, 1.5, motion)
    moved, planes = result.mean, result.cov
    np.testing.assert_array_equal(mean, before)
    expected, jacobian, q = motion.transition(mean[:, gone:], 1.5)
    np.testing.assert_allclose(moved[:, :count], expected, rtol=1e-12)
    np.testing.assert_array_equal(moved[:, count:], new.state)
    spread = jacobian @ cov[gone:] @ jacobian.transpose(0, 2, 1) + q
    np.testing.assert_allclose(whole(planes.T, 6), np.concatenate((spread, new.covariance)), rtol=1e-10, atol=1e-10)
    shown = np.ix_(range(n), SHOWN, SHOWN)
    np.testing.assert_allclose(whole(result.noise.T, 6)[shown], motion.transition(new.state, 1.5)[2][shown])


def test_triangles():
    full = np.arange(9.0).reshape(3, 3)
    full = full + full.T
    triangle = lower(3)
    packed = full[triangle.row, triangle.column]
    np.testing.assert_array_equal(packed[triangle.place], full)
    np.testing.assert_array_equal(whole(packed[None], 3), full[None])
    part = block(3, (2, 0))
    np.testing.assert_array_equal(part.rows, [2, 0])
    np.testing.assert_array_equal(packed[part.triangle], full[np.ix_([2, 0], [2, 0])])
    np.testing.assert_array_equal(full.ravel()[part.square], full[np.ix_([2, 0], [2, 0])])


def test_positions_that_are_none_are_refused():
    """They would be looked for in cells that there are not."""
    matching, model = matching_of(), model_of()
    good = states([(100, 100), (200, 100)])
    state, _ = matching.extend(matching.start(), good, good.state[[0, 1, 4, 5]], 1, 1.0, model)
    for worth in (np.nan, np.inf):
        x = good.state.copy()
        x[1, 1] = worth
        bad = Estimates(x, good.covariance, good.weight, good.xyxy, good.detection)
        with pytest.raises(InputError, match="finite"):
            matching.extend(state, bad, x[[0, 1, 4, 5]], 2, 1.0, model)
