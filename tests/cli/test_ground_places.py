"""Where boxes stand and where particles on the ground are seen."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from phdtrack.cli.group_observer import nearest
from phdtrack.cli.job import places, shown_particles
from phdtrack.models import BoxSensor, PlaneSensor
from phdtrack.types import Particles
from plane_cases import LevelCamera, people

CAMERA = LevelCamera()


def shown(particles: Particles, sensor: object) -> Particles | None:
    stages = SimpleNamespace(filter=None, model=SimpleNamespace(sensor=sensor))
    return shown_particles(stages, particles)  # type: ignore[arg-type]


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


def test_particles_are_shown_in_the_middle_of_their_boxes_and_those_behind_the_camera_far_outside() -> None:
    state = np.array([[0.0, 1, 0], [10, 20, -5], [0, 0, 0], [0, 0, 0]])
    particles = Particles(state, np.array([0.2, 0.3, 0.4]))
    sensor = PlaneSensor(camera=CAMERA, size=(0.6, 1.8))
    seen = shown(particles, sensor)
    assert seen is not None
    assert seen.state[0, :2] == pytest.approx(CAMERA.pixels(state[:2, :2])[0])
    middle = CAMERA.pixels(np.vstack([state[:2, :2], [0.9, 0.9]]))
    assert seen.state[1, :2] == pytest.approx(middle[1])
    assert (seen.state[:2, 2] < -1000).all()
    assert seen.weight is particles.weight
    assert shown(particles, PlaneSensor()) is None
    assert shown(particles, BoxSensor()) is particles


def test_people_take_the_identity_of_the_nearest_corrected_row() -> None:
    people = np.array([[0.0, 3, 9, np.nan], [0, 0, 0, 0]])
    place = np.array([[3.1, 0.4, np.nan], [0.1, 0, 0]])
    assert nearest(people, place, np.array([7, 8, 9])).tolist() == [8, 7, 0, 0]
    assert nearest(people, np.zeros((2, 0)), np.zeros(0, np.int64)).tolist() == [0] * 4
    assert nearest(np.zeros((2, 0)), place, np.array([7, 8, 9])).tolist() == []
