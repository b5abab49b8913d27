"""The foot of a box on the ground: its place, its covariance, what it looks like from a state, and
where it cannot be.
"""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.models import PlaneSensor
from phdtrack.types import Detections
from plane_cases import FRAME, LevelCamera, MapCamera, people, with_covariance

CAMERA = LevelCamera()
HORIZON = np.array([[100.0, 10, 140, 39], [100, 200, 140, 300]])


def measured(rng, n: int, **settings):
    sensor = PlaneSensor(camera=CAMERA, frame_size=FRAME, **settings)
    x = people(rng, n)
    return sensor, x, sensor.measure(Detections.of(sensor.boxes(x)))


def test_the_covariance_is_that_of_jittered_boxes(rng):
    """Deviations are fractions of the box's size: 40 000 draws of the foot point, through the
    camera.
    """
    sensor, _, z = measured(rng, 4, box_noise=(0.06, 0.01), min_noise=0.5)
    for i, box in enumerate(sensor.boxes(people(np.random.default_rng(20090706), 4))):
        size = box[2:] - box[:2]
        sigma = np.maximum([0.06, 0.01] * size, 0.5)
        foot = np.array([[box[0] + size[0] / 2], [box[3]]]) + sigma[:, None] * rng.standard_normal(
            (2, 40_000)
        )
        want = np.cov(CAMERA.ground(foot))
        np.testing.assert_allclose(
            z[[2, 3, 3, 4], i].reshape(2, 2), want, rtol=0.06, atol=0.03 * np.trace(want)
        )


def test_covariances_that_detections_bring_are_led_to_the_ground(rng):
    """The lower edge is centre plus half of the height, so its variance is σ_cy² + σ_h²/4."""
    sensor, x, _ = measured(rng, 5)
    xyxy = sensor.boxes(x)
    variance = rng.uniform(1, 9, (5, 4))
    z = sensor.measure(with_covariance(xyxy, variance))
    foot = np.stack([(xyxy[:, 0] + xyxy[:, 2]) / 2, xyxy[:, 3]])
    for i, j in enumerate(CAMERA.jacobian(foot)):
        pixel = np.diag([variance[i, 0], variance[i, 1] + variance[i, 3] / 4])
        np.testing.assert_allclose(z[[2, 3, 3, 4], i].reshape(2, 2), j @ pixel @ j.T)


def test_the_fixed_noise_is_the_same_everywhere(rng):
    _, x, z = measured(rng, 6, scaling="fixed")
    np.testing.assert_allclose(z[2:], np.repeat([[0.5], [0], [0.5]], 6, axis=1))
    noise = PlaneSensor(camera=CAMERA, scaling="fixed").noise(x)
    np.testing.assert_allclose(noise, np.repeat([[0.5**0.5], [0.5**0.5], [1], [1]], 6, axis=1))
    given, x, z = measured(rng, 6)
    np.testing.assert_allclose(given.noise(x)[:2] ** 2, z[[2, 4]])


def test_feet_above_the_horizon_are_columns_of_nan(rng):
    for scaling in ("given", "fixed"):
        z = PlaneSensor(camera=CAMERA, scaling=scaling).measure(Detections.of(HORIZON))
        assert np.isnan(z[:, 0]).all()
        assert np.isfinite(z[:, 1]).all()


def test_a_camera_without_heights_gives_boxes_by_its_scale(rng):
    x = people(rng, 9)
    with_heights, without = (
        PlaneSensor(camera=camera).boxes(x) for camera in (CAMERA, MapCamera())
    )
    np.testing.assert_allclose(without, with_heights, rtol=1e-9)


def test_person_behind_the_camera_is_not_detected():
    sensor = PlaneSensor(camera=CAMERA, frame_size=FRAME)
    x = np.array([[0.0, 0], [-3, 20], [0, 0], [0, 0]])
    assert np.isfinite(sensor.boxes(x)).all()
    assert (sensor.boxes(x)[0, 2:] < 0).all()
    np.testing.assert_allclose(sensor.p_detect(x), [0, 0.9])
    assert np.isfinite(sensor.noise(x)).all()


def test_the_field_of_view_falls_with_the_visible_part():
    """A person walks out at the side of the image."""
    sensor = PlaneSensor(camera=CAMERA, frame_size=FRAME)
    x = np.zeros((4, 200))
    x[0] = np.linspace(0, 15, 200)
    x[1] = 20.0
    p = sensor.p_detect(x)
    boxes = sensor.boxes(x)
    inside = np.clip((640 - boxes[:, 0]) / (boxes[:, 2] - boxes[:, 0]), 0, 1)
    np.testing.assert_allclose(p, 0.9 * inside, atol=1e-12)
    np.testing.assert_array_equal(
        PlaneSensor(camera=CAMERA, frame_size=FRAME, view=False).p_detect(x), 0.9
    )
    np.testing.assert_array_equal(PlaneSensor(camera=CAMERA).p_detect(x), 0.9)


def test_a_plan_in_metres(rng):
    """Without a camera a box's middle is the position, and what is outside of the region is not
    seen.
    """
    sensor = PlaneSensor(scaling="fixed", fixed_noise=0.3, borders=(-4.0, 0.0, 4.0, 40.0))
    x = people(rng, 7)
    z = sensor.measure(Detections.of(sensor.boxes(x)))
    np.testing.assert_allclose(z[:2], x[:2])
    np.testing.assert_allclose(z[2:], np.repeat([[0.09], [0], [0.09]], 7, axis=1))
    np.testing.assert_allclose(
        sensor.p_detect(np.array([[0.0, 5], [1, 1], [0, 0], [0, 0]])), [0.9, 0]
    )
    with pytest.raises(InputError, match="fixed"):
        PlaneSensor().measure(Detections.of(sensor.boxes(x)))
