from __future__ import annotations

import numpy as np
import pytest

from phdtrack.simulate.paint_figures import PHASES, draw_clothes, premultiplied, put, put_scaled, pyramid, walking


def half_red() -> np.ndarray:
    """A 40 × 20 sprite, left half red, right half blue, opaque."""
    colour = np.zeros((40, 20, 3), np.uint8)
    colour[:, :10], colour[:, 10:] = (0, 0, 200), (200, 0, 0)
    return premultiplied(colour, np.full((40, 20), 255, np.uint8))


def grey() -> np.ndarray:
    return np.full((60, 60, 3), 100, np.uint8)


def test_put_replaces_what_is_opaque_and_only_that() -> None:
    canvas = grey()
    put(canvas, half_red(), 5, 7)
    assert (canvas[7:47, 5:15] == (0, 0, 200)).all()
    assert (canvas[7:47, 15:25] == (200, 0, 0)).all()
    canvas[7:47, 5:25] = 100
    assert (canvas == 100).all()


def test_put_mixes_where_the_sprite_is_half_transparent() -> None:
    canvas = grey()
    put(canvas, premultiplied(np.full((10, 10, 3), 200, np.uint8), np.full((10, 10), 128, np.uint8)), 0, 0)
    assert np.abs(canvas[:10, :10].astype(int) - 150).max() <= 1


@pytest.mark.parametrize(("left", "top"), [(-10, -10), (50, 50), (-30, 0), (0, 70), (45, -39)])
def test_put_cuts_at_the_borders(left: int, top: int) -> None:
    canvas, wide = grey(), np.full((200, 200, 3), 100, np.uint8)
    put(canvas, half_red(), left, top)
    put(wide, half_red(), left + 70, top + 70)
    assert (canvas == wide[70:130, 70:130]).all()


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("scale", [0.4, 1.0, 1.3])
def test_put_scaled_fills_its_box_and_mirrors(mirrored: bool, scale: float) -> None:
    canvas = grey()
    box = np.array([10.0, 5.0, 10.0 + 20 * scale, 5.0 + 40 * scale])
    put_scaled(canvas, pyramid(half_red()), box, mirrored=mirrored)
    changed_y, changed_x = np.nonzero((canvas != 100).any(axis=2))
    assert abs(changed_x.min() - box[0]) <= 1
    assert abs(changed_x.max() + 1 - box[2]) <= 1
    assert abs(changed_y.min() - box[1]) <= 1
    assert abs(changed_y.max() + 1 - box[3]) <= 1
    row = int(5 + 20 * scale)
    left, right = canvas[row, int(10 + 4 * scale)], canvas[row, int(10 + 16 * scale)]
    assert (left[2] > left[0]) == (not mirrored)
    assert (right[0] > right[2]) == (not mirrored)


def test_figures_differ_between_people_and_phases() -> None:
    a, b = (walking(draw_clothes(np.random.default_rng(seed)), 0.38) for seed in (1, 2))
    assert len(a) == PHASES
    assert (a[0][0] != b[0][0]).any()
    assert (a[0][0] != a[PHASES // 4][0]).any()
    opaque = [phase[0][:, :, 3] > 128 for phase in a]
    assert all(0.2 < mask.mean() < 0.6 for mask in opaque)
    assert all(mask[:6].any() for mask in opaque)
    assert all(mask[-5:].any() for mask in opaque)
