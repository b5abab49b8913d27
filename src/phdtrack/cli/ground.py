"""Where boxes stand on the ground, for what is written and drawn."""

from __future__ import annotations

import numpy as np

from phdtrack.models import PlaneSensor
from phdtrack.protocols import Sensor
from phdtrack.types import F8, Particles


def places(sensor: Sensor, xyxy: F8) -> F8:
    """(2, M) metres: the ground under the middle of each box's (M, 4) lower edge; NaN where there is none, or where the
    world of the sensor is the image. Without a camera the image is a plan, and the middles of the boxes are the places."""
    if not isinstance(sensor, PlaneSensor) or len(xyxy) == 0:
        return np.full((2, len(xyxy)), np.nan)
    middle = (xyxy[:, 0] + xyxy[:, 2]) / 2
    if sensor.camera is None:
        return np.stack([middle, (xyxy[:, 1] + xyxy[:, 3]) / 2])
    return sensor.camera.ground(np.stack([middle, xyxy[:, 3]]))


def shown(particles: Particles, sensor: Sensor) -> Particles | None:
    """The particles where the image shows them: rows 0 and 1 the middle of their boxes in pixels, as detections are drawn.
    None where the world is a plan without an image."""
    if not isinstance(sensor, PlaneSensor):
        return particles
    if sensor.camera is None:
        return None
    boxes = sensor.boxes(particles.state)
    return Particles(np.vstack([(boxes[:, :2] + boxes[:, 2:]).T / 2, particles.state[2:]]), particles.weight)
