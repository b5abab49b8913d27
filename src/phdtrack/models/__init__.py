"""The shipped models of the world: motions, sensors, births and clutters."""

from __future__ import annotations

from typing import TYPE_CHECKING

from phdtrack.files import lazy

if TYPE_CHECKING:
    from phdtrack.models.births import (
        FixedBirth,
        MeasurementBirth,
        PlaneBirth,
        PointBirth,
        UniformBirth,
    )
    from phdtrack.models.box import BoxMotion, BoxSensor
    from phdtrack.models.clutter import BoxClutter, PlaneClutter, UniformClutter
    from phdtrack.models.plane import PlaneMotion, PlaneSensor
    from phdtrack.models.point import PointMotion, PointSensor

__all__ = [
    "BoxClutter",
    "BoxMotion",
    "BoxSensor",
    "FixedBirth",
    "MeasurementBirth",
    "PlaneBirth",
    "PlaneClutter",
    "PlaneMotion",
    "PlaneSensor",
    "PointBirth",
    "PointMotion",
    "PointSensor",
    "UniformBirth",
    "UniformClutter",
]

_MODULES = {
    "Birth": "phdtrack.models.births",
    "Clutter": "phdtrack.models.clutter",
    "Box": "phdtrack.models.box",
    "Plane": "phdtrack.models.plane",
    "Point": "phdtrack.models.point",
}
# Type checkers know the names by their imports, and find one that does not exist.
if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy(
        __name__, {name: next(_MODULES[key] for key in _MODULES if key in name) for name in __all__}
    )
