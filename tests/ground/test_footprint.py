"""The field of view on the ground."""

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from camera_cases import CAMERAS, MATRIX, PLANE, SIZE, looking
from phdtrack.errors import InputError
from phdtrack.ground import HomographyCamera, OpenCVLens, PosedCamera, Terrain, footprint


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_point_is_inside_when_the_frame_shows_it(camera: PosedCamera, rng: np.random.Generator) -> None:
    """But for points within 0.3 m of the outline, which is a polygon and no curve."""
    polygon = footprint(camera, SIZE, 50.0)
    assert np.isfinite(polygon).all()
    assert camera.depth(polygon).max() == pytest.approx(50)
    low, high = polygon.min(axis=1, keepdims=True) - 10, polygon.max(axis=1, keepdims=True) + 10
    world = rng.uniform(low, high, (2, 1500))
    pixel = camera.pixels(world)
    size = np.array(SIZE)[:, None]
    shown = ((pixel >= 0) & (pixel <= size)).all(axis=0) & (camera.depth(world) <= 50)
    outline = Outline(polygon.T)
    inside = outline.contains_points(world.T)
    closed = np.hstack([polygon, polygon[:, :1]])
    dense = np.concatenate([np.linspace(a, b, 20) for a, b in zip(closed.T[:-1], closed.T[1:], strict=True)])
    clear = np.array([np.hypot(*(dense - point).T).min() > 0.3 for point in world.T])
    assert 80 < shown.sum() < 1400
    # Terrain may hide ground within the outline; what is shown lies inside of it all the same.
    terrain = isinstance(camera, PosedCamera) and isinstance(camera.surface, Terrain)
    wrong = (shown & ~inside if terrain else shown != inside) & clear
    assert wrong.sum() <= (15 if terrain else 0)


def test_without_a_horizon_it_is_the_image_of_the_frame() -> None:
    rotation, translation = looking((0.0, -6.0, 8.0), (0.0, 0.0))
    camera = PosedCamera(OpenCVLens(MATRIX), rotation, translation)
    polygon = footprint(camera, SIZE)
    corners = camera.ground(np.array([[0, SIZE[0], SIZE[0], 0], [0, 0, SIZE[1], SIZE[1]]]))
    np.testing.assert_allclose(polygon[:, ::64], corners, atol=1e-9)


def test_a_frame_of_sky_shows_nothing() -> None:
    sky = HomographyCamera(PLANE @ np.array([[1.0, 0, 0], [0, 1, -3000], [0, 0, 1]]))
    assert footprint(sky, SIZE).shape == (2, 0)
    with pytest.raises(InputError, match="above 0"):
        footprint(sky, SIZE, 0.0)
