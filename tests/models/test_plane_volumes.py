"""Births and clutter around the detections on the ground: as dense as their rates say, and as
quickly believed anywhere.
"""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack import pipeline
from phdtrack.associate.graph import GraphMatching
from phdtrack.filters import GMPHD
from phdtrack.filters.extract import Components
from phdtrack.models import PlaneBirth, PlaneClutter, PlaneMotion, PlaneSensor
from phdtrack.models.volumes import local_area
from phdtrack.protocols import Model, Stages
from phdtrack.types import Detections
from plane_cases import FRAME, LevelCamera


def test_the_area_is_that_of_the_ellipse_of_six_deviations():
    """By counting, on a lattice around one detection whose covariance is slanted."""
    z = np.array([[3.0], [20.0], [0.4], [-0.15], [0.9]])
    step = 0.05
    lattice = (
        np.stack(np.meshgrid(np.arange(-10, 16, step), np.arange(7, 33, step))).reshape(2, -1)
        - z[:2]
    )
    inverse = np.linalg.inv([[0.4, -0.15], [-0.15, 0.9]])
    inside = np.einsum("il,ij,jl->l", lattice, inverse, lattice) <= 36
    assert local_area(z)[0] == pytest.approx(inside.sum() * step**2, rel=0.01)


def test_a_detection_gives_itself_the_clutter_of_its_own_ellipse():
    z = np.array([[0.0, 50], [0, 0], [0.25, 4], [0, 1], [1, 4]])
    want = 0.3 / (np.pi * 36 * np.sqrt([0.25, 15]))
    np.testing.assert_allclose(PlaneClutter(0.3).intensity(z), want)


def believed_after(depth: float) -> int:
    """Coherent detections of somebody standing there up to his first state."""
    sensor = PlaneSensor(camera=LevelCamera(), frame_size=FRAME)
    world = Stages(
        Model(PlaneMotion(), sensor, PlaneBirth(), PlaneClutter(0.3), rate=1.0, first=0.1),
        GMPHD(),
        Components(),
        GraphMatching(gap_cost=1.609),
    )
    box = Detections.of(sensor.boxes(np.array([[0.0], [depth], [0], [0]])))
    rng = np.random.default_rng(0)
    state = pipeline.start(world, rng)
    for number in range(1, 12):
        state, step = pipeline.advance(world, state, box, number, number / 10, rng)
        if len(step.estimates):
            return number
    return 99


def test_confirmation_does_not_depend_on_distance():
    assert {believed_after(depth) for depth in (9.0, 20.0, 40.0)} <= {2, 3}
