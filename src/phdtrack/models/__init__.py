"""The shipped models of the world: motions, sensors, births, clutters, and the papers' presets made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.models.bearing_sensor import BearingSensor
    from phdtrack.models.births import FixedBirth, MeasurementBirth, UniformBirth
    from phdtrack.models.box_motion import BoxMotion
    from phdtrack.models.box_sensor import BoxSensor
    from phdtrack.models.clutter import LocalClutter, LocalPlaneClutter, ScoredClutter, UniformClutter
    from phdtrack.models.plane_birth import PlaneBirth
    from phdtrack.models.plane_motion import PlaneMotion
    from phdtrack.models.plane_sensor import PlaneSensor
    from phdtrack.models.point_birth import PointBirth
    from phdtrack.models.point_motion import PointMotion
    from phdtrack.models.point_sensor import PointSensor
    from phdtrack.models.spawning import NoSpawn, SplitSpawn
    from phdtrack.models.turning_motion import TurningMotion

__getattr__, __dir__ = lazy(
    __name__,
    {
        "BearingSensor": "phdtrack.models.bearing_sensor",
        "BoxMotion": "phdtrack.models.box_motion",
        "BoxSensor": "phdtrack.models.box_sensor",
        "FixedBirth": "phdtrack.models.births",
        "LocalClutter": "phdtrack.models.clutter",
        "LocalPlaneClutter": "phdtrack.models.clutter",
        "MeasurementBirth": "phdtrack.models.births",
        "NoSpawn": "phdtrack.models.spawning",
        "PlaneBirth": "phdtrack.models.plane_birth",
        "PlaneMotion": "phdtrack.models.plane_motion",
        "PlaneSensor": "phdtrack.models.plane_sensor",
        "PointBirth": "phdtrack.models.point_birth",
        "PointMotion": "phdtrack.models.point_motion",
        "PointSensor": "phdtrack.models.point_sensor",
        "ScoredClutter": "phdtrack.models.clutter",
        "SplitSpawn": "phdtrack.models.spawning",
        "TurningMotion": "phdtrack.models.turning_motion",
        "UniformBirth": "phdtrack.models.births",
        "UniformClutter": "phdtrack.models.clutter",
    },
)

__all__ = [
    "BearingSensor",
    "BoxMotion",
    "BoxSensor",
    "FixedBirth",
    "LocalClutter",
    "LocalPlaneClutter",
    "MeasurementBirth",
    "NoSpawn",
    "PlaneBirth",
    "PlaneMotion",
    "PlaneSensor",
    "PointBirth",
    "PointMotion",
    "PointSensor",
    "ScoredClutter",
    "SplitSpawn",
    "TurningMotion",
    "UniformBirth",
    "UniformClutter",
]
