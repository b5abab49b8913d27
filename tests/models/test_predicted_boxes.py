"""How probably the box of a target that was not detected lies on the target."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.arrays import iou
from phdtrack.kernels.coasting import overlap_probability
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.models.point import PointSensor
from phdtrack.models.predicted_boxes import on_target
from phdtrack.protocols import Model

SIZE = (640.0, 480.0)
MODEL = Model(
    BoxMotion(frame_size=SIZE),
    BoxSensor(),
    MeasurementBirth(0.25, frame_size=SIZE),
    UniformClutter(1.0, 1e10),
)


@given(st.floats(0.0, 3.0), st.floats(0.0, 3.0))
def test_the_kernel_is_the_integral_over_all_places(across: float, along: float):
    """Of both deviations on a fine grid, by the condition alone."""
    z = np.linspace(-6, 6, 1201)
    mass = np.exp(-z * z / 2)
    mass /= mass.sum()
    u = np.abs(z * across)[:, None]
    v = np.abs(z * along)
    half = np.clip(1 - u, 0, 1) * np.clip(1 - v, 0, 1) >= 2 / 3 - 1e-12
    expected = float((half * mass[:, None] * mass).sum())
    found = overlap_probability(np.array([across]), np.array([along]))
    assert found == pytest.approx([expected], abs=0.01)


def test_boxes_drawn_from_the_covariance_overlap_as_often(rng):
    n = 20_000
    for deviation in ((2.0, 30.0), (8.0, 8.0), (20.0, 20.0)):
        state = np.array([[300.0], [200.0], [0.0], [0.0], [60.0], [120.0]])
        covariance = np.diag([*np.square(deviation), 1.0, 1.0, 0.0, 0.0])[None]
        claimed = float(on_target(MODEL, state, covariance)[0])
        box = MODEL.sensor.boxes(state)
        drawn = np.repeat(state, n, axis=1)
        drawn[:2] += rng.normal(size=(2, n)) * np.array(deviation)[:, None]
        share = float((iou(box, MODEL.sensor.boxes(drawn))[0] >= 0.5).mean())
        assert claimed == pytest.approx(share, abs=0.01 + 4 * 0.5 / np.sqrt(n))


def test_positions_without_a_size_are_always_on_target():
    points = Model(MODEL.motion, PointSensor(), MODEL.birth, MODEL.clutter)
    lost = np.tile(1e4 * np.eye(4), (3, 1, 1))
    assert on_target(points, np.zeros((4, 3)), lost).tolist() == [1.0] * 3
