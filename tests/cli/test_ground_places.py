"""Where boxes stand and where particles on the ground are seen."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.commands.ground import places, shown
from phdtrack.models import BoxSensor, PlaneSensor
from phdtrack.types import Particles
from plane_cases import LevelCamera, people

CAMERA = LevelCamera()


def test_boxes_of_states_stand_where_the_states_are() -> None:
    sensor, x = PlaneSensor(camera=CAMERA), people(np.random.default_rng(0), 20)
    assert places(sensor, sensor.boxes(x)) == pytest.approx(x[:2], abs=1e-9)
    plan = PlaneSensor(scaling="fixed")
    assert places(plan, plan.boxes(x)) == pytest.approx(x[:2], abs=1e-9)


def test_boxes_in_the_sky_and_in_an_image_without_a_ground_stand_nowhere() -> None:
    sky = np.array([[10.0, 5, 20, 30]])
    assert np.isnan(places(PlaneSensor(camera=CAMERA), sky)).all()
    assert np.isnan(places(BoxSensor(), sky)).all()
    assert places(PlaneSensor(camera=CAMERA), np.zeros((0, 4))).shape == (2, 0)


def test_particles_are_shown_at_their_pixels_and_those_behind_the_camera_nowhere() -> None:
    state = np.array([[0.0, 1, 0], [10, 20, -5], [0, 0, 0], [0, 0, 0]])
    particles = Particles(state, np.array([0.2, 0.3, 0.4]))
    seen = shown(particles, PlaneSensor(camera=CAMERA))
    assert seen is not None
    assert seen.state[:2] == pytest.approx(CAMERA.pixels(state[:2, :2]))
    assert seen.weight.tolist() == [0.2, 0.3]
    assert shown(particles, PlaneSensor()) is None
    assert shown(particles, BoxSensor()) is particles
