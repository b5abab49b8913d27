from __future__ import annotations

import numpy as np
import pytest

from phdtrack.simulate.paint import PHASES, Placed, put, put_scaled, pyramid, walking


def half_red() -> np.ndarray:
    """A 40 × 20 sprite, left half red, right half blue, opaque."""
    sprite = np.full((40, 20, 4), 255, np.uint8)
    sprite[:, :10, :3], sprite[:, 10:, :3] = (0, 0, 200), (200, 0, 0)
    return sprite


def grey() -> np.ndarray:
    return np.full((60, 60, 3), 100, np.uint8)


def test_put_replaces_what_is_opaque_and_mixes_where_it_is_half_transparent() -> None:
    canvas, expected = grey(), grey()
    put(canvas, Placed(half_red(), 5, 7))
    expected[7:47, 5:15], expected[7:47, 15:25] = (0, 0, 200), (200, 0, 0)
    assert (canvas == expected).all()
    canvas = grey()
    put(canvas, Placed(np.full((10, 10, 4), (100, 100, 100, 128), np.uint8), 0, 0))
    assert np.abs(canvas[:10, :10].astype(int) - 150).max() <= 1


@pytest.mark.parametrize(("left", "top"), [(-10, -10), (50, 50), (-30, 0), (0, 70), (45, -39)])
def test_put_cuts_at_the_borders(left: int, top: int) -> None:
    canvas, wide = grey(), np.full((200, 200, 3), 100, np.uint8)
    put(canvas, Placed(half_red(), left, top))
    put(wide, Placed(half_red(), left + 70, top + 70))
    assert (canvas == wide[70:130, 70:130]).all()


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("scale", [0.4, 1.0, 1.3])
def test_put_scaled_fills_its_box_and_mirrors(mirrored: bool, scale: float) -> None:
    canvas = grey()
    box = np.array([10.0, 5.0, 10.0 + 20 * scale, 5.0 + 40 * scale])
    put_scaled(canvas, pyramid(half_red()), box, mirrored=mirrored)
    y, x = np.nonzero((canvas != 100).any(axis=2))
    assert np.abs(np.array([x.min(), y.min(), x.max() + 1, y.max() + 1]) - box).max() <= 1
    row = int(5 + 20 * scale)
    left, right = canvas[row, int(10 + 4 * scale)], canvas[row, int(10 + 16 * scale)]
    assert (left[2] > left[0]) == (right[0] > right[2]) == (not mirrored)


def test_figures_differ_between_people_and_phases() -> None:
    a, b = (walking(np.random.default_rng(seed), 0.38) for seed in (1, 2))
    assert len(a) == PHASES
    assert (a[0][0] != b[0][0]).any()
    assert (a[0][0] != a[PHASES // 4][0]).any()
    for phase in a:
        opaque = phase[0][:, :, 3] > 128
        assert 0.2 < opaque.mean() < 0.6
        assert opaque[:6].any()
        assert opaque[-5:].any()
