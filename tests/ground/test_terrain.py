"""Elevation maps: flat ones are flat ground, slopes are planes, hills hide what lies behind
them.
"""

from pathlib import Path

import numpy as np
import pytest

from camera_cases import ROTATION, TRANSLATION, hills, pixels, posed, tsai
from phdtrack.errors import InputError
from phdtrack.ground import Flat, PosedCamera, Terrain, read_terrain

STEP = np.array([2.0, 2])
GRID = "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n"


def terrain(height: np.ndarray) -> Terrain:
    return Terrain(np.array([-100.0, -100]), STEP, height)


def test_flat_terrain_equals_flat_ground(rng: np.random.Generator) -> None:
    pixel = pixels(rng, 1000)
    flat = posed(tsai(5e-3), Flat(2.5))
    map_ = posed(tsai(5e-3), terrain(np.full((101, 101), 2.5)))
    expected = flat.ground(pixel)
    found = map_.ground(pixel)
    on_map = (np.abs(expected) <= 100).all(axis=0)
    assert on_map.sum() > 400
    np.testing.assert_allclose(found[:, on_map], expected[:, on_map], rtol=1e-12)
    assert np.isnan(found[:, ~on_map]).all(), "beyond the map nothing is known"
    np.testing.assert_allclose(
        map_.jacobian(pixel)[on_map], flat.jacobian(pixel)[on_map], rtol=1e-9
    )
    np.testing.assert_allclose(map_.pixels(expected[:, on_map]), flat.pixels(expected[:, on_map]))


def test_slope_equals_a_plane(rng: np.random.Generator) -> None:
    """The intersection of a ray with z = 0.1 x − 0.05 y + 1 has a closed form, and bilinear
    interpolation is exact on planes.
    """
    y, x = np.mgrid[-100:101:2.0, -100:101:2.0]
    camera = posed(tsai(5e-3), terrain(0.1 * x - 0.05 * y + 1))
    pixel = rng.uniform([[0], [330]], [[768], [576]], (2, 300))
    ray = np.vstack([camera.lens.rays(pixel), np.ones(300)])
    direction = ROTATION.T @ ray
    origin = -ROTATION.T @ TRANSLATION
    normal = np.array([-0.1, 0.05, 1])
    s = (1 - normal @ origin) / (normal @ direction)
    np.testing.assert_allclose(
        camera.ground(pixel), (origin[:, None] + s * direction)[:2], atol=1e-9
    )


def test_ground_point_is_the_first_on_the_line_of_sight(rng: np.random.Generator) -> None:
    """Steep hills: no point of the ray before it is below the ground, and it lies on the ground."""
    ground = hills(4.0)
    camera = posed(tsai(5e-3), ground)
    pixel = pixels(rng, 600)
    place = camera.ground(pixel)
    seen = np.isfinite(place).all(axis=0)
    assert seen.sum() > 200
    world = np.vstack([place, ground.height(place)])[:, seen]
    np.testing.assert_allclose(camera.pixels(world), pixel[:, seen], atol=1e-7)
    for share in np.linspace(0.0, 0.995, 200):
        way = camera.position[:, None] + share * (world - camera.position[:, None])
        height = ground.height(way[:2])
        assert not (way[2] < height - 0.02).any()


def test_ray_entering_below_the_terrain_is_unknown() -> None:
    """A plateau at the map's edge, higher than the camera: it bars the view of the valley behind
    it, from outside.
    """
    y, x = np.mgrid[-10:191:2.0, -10:191:2.0]
    plateau = np.where(x + y < 10, 9.0, 0.0)
    camera = posed(tsai(5e-3), Terrain(np.array([-10.0, -10]), STEP, plateau))
    assert camera.position[2] < 9
    pixel = posed(tsai(5e-3)).pixels(np.array([[20.0, 30], [25, 25]]))
    assert np.isfinite(pixel).all()
    assert np.isnan(camera.ground(pixel)).all()


def test_points_beside_unknown_heights_are_unknown() -> None:
    heights = np.zeros((101, 101))
    heights[50, 50] = np.nan  # at (0, 0)
    camera = posed(tsai(5e-3), terrain(heights))
    world = np.array([[0.5, 5.0], [0.5, 5.0]])
    assert np.isnan(camera.surface.height(world)[0])
    assert np.isnan(camera.pixels(world)[:, 0]).all()
    place = camera.ground(posed(tsai(5e-3)).pixels(world))
    assert np.isnan(place[:, 0]).all()
    np.testing.assert_allclose(place[:, 1], world[:, 1], atol=1e-9)


def test_world_with_downward_axis_gives_the_same(rng: np.random.Generator) -> None:
    """z downwards, y mirrored: hills become negative heights."""
    mirror = np.diag([1.0, -1, -1])
    up = hills(1.5)
    down = terrain(-up.heights[::-1])
    one = PosedCamera(tsai(5e-3), ROTATION, TRANSLATION, up)
    other = PosedCamera(tsai(5e-3), ROTATION @ mirror, TRANSLATION, down)
    pixel = pixels(rng, 300)
    np.testing.assert_allclose(
        other.ground(pixel) * np.array([[1], [-1]]), one.ground(pixel), atol=1e-8
    )


def test_terrain_files_are_read(tmp_path: Path) -> None:
    heights = np.arange(12.0).reshape(3, 4)
    text = (
        "ncols 4\nnrows 3\nxllcorner -2\nYLLCENTER 5\ncellsize 2\nNODATA_value -9999\n8 9 10 11\n4"
        " -9999 6 7\n0 1 2 3\n"
    )
    (tmp_path / "a.asc").write_text(text)
    grid = read_terrain(tmp_path / "a.asc")
    assert (grid.origin.tolist(), grid.step.tolist()) == ([-1, 5], [2, 2])
    assert np.isnan(grid.heights[1, 1])
    np.testing.assert_array_equal(np.nan_to_num(grid.heights, nan=5), heights)


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        ("hello world\n", "", "ASCII grid that states ncols"),
        (GRID + "1 2\n", "", "2 rows of heights, got 1"),
        (GRID + "1 2\n1 x\n", ", line 7", "2 numbers, got '1 x'"),
        (GRID + "1 2 3\n1 2\n", ", line 6", "2 numbers, got 3"),
        (GRID.replace("size 1", "size 0") + "1 2\n3 4\n", "", "steps"),
        (GRID.replace("ncols 2", "ncols 1") + "1\n3\n", "", "2 x 2 heights or more"),
        (GRID + "1 2\n3 1e308\n", "", "within 1e.07 m"),
        (GRID.replace("ncols 2", "ncols inf"), "", "whole number for ncols, got inf"),
        ("ncols two\n", ", line 1", "1 numbers, got 'two'"),
    ],
)
def test_bad_terrain_grids_are_refused(tmp_path: Path, text: str, where: str, words: str) -> None:
    path = tmp_path / "bad.asc"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_terrain(path)
    assert caught.value.where == f"{path}{where}"
