"""The shipped models of the world: motions, sensors, births, clutters, and the papers' presets made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.models.bearing import BearingSensor, TurningMotion
    from phdtrack.models.births import (
        FixedBirth,
        MeasurementBirth,
        NoSpawn,
        PlaneBirth,
        PointBirth,
        SplitSpawn,
        UniformBirth,
    )
    from phdtrack.models.box import BoxMotion, BoxSensor
    from phdtrack.models.clutter import LocalClutter, LocalPlaneClutter, ScoredClutter, UniformClutter
    from phdtrack.models.plane import PlaneMotion, PlaneSensor
    from phdtrack.models.point import PointMotion, PointSensor

__getattr__, __dir__ = lazy(
    __name__,
    {
        "BearingSensor": "phdtrack.models.bearing",
        "BoxMotion": "phdtrack.models.box",
        "BoxSensor": "phdtrack.models.box",
        "FixedBirth": "phdtrack.models.births",
        "LocalClutter": "phdtrack.models.clutter",
        "LocalPlaneClutter": "phdtrack.models.clutter",
        "MeasurementBirth": "phdtrack.models.births",
        "NoSpawn": "phdtrack.models.births",
        "PlaneBirth": "phdtrack.models.births",
        "PlaneMotion": "phdtrack.models.plane",
        "PlaneSensor": "phdtrack.models.plane",
        "PointBirth": "phdtrack.models.births",
        "PointMotion": "phdtrack.models.point",
        "PointSensor": "phdtrack.models.point",
        "ScoredClutter": "phdtrack.models.clutter",
        "SplitSpawn": "phdtrack.models.births",
        "TurningMotion": "phdtrack.models.bearing",
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
