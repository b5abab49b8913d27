"""Settings of parts that are built only once the sequence, a camera or a learned scene is known.

The other sections are the dataclasses of the parts themselves: ``[filter]`` of kind ``pmb`` has the
fields of `filters.pmb.PMB`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phdtrack.errors import Checked, InputError, NonNegative, Positive, check
from phdtrack.models.volumes import EVERYWHERE, Region, check_region
from phdtrack.types import GaussianMixture

Places = tuple[tuple[float, float, float, float, float], ...]
"""Gaussians on the ground: x, y in metres, weight, deviations of position (m), speed (m/s)."""
Label = int | str
"""A class, by its number or its name."""


@dataclass(frozen=True, slots=True)
class TimeSettings(Checked):
    """Settings of the time.

    Parameters
    ----------
    units_per_second : time units per second in which noises are stated; the papers' are per frame
        at 25 Hz.
    longest_interval : seconds between pictures up to which targets move as in videos. With longer
        ones the filter's time runs slower, so that they are as long as this. 0: never.
    births_before : seconds before the first frame whose births are expected in it, as far as they
        survive: objects were there before it. 0: those of one interval.
    """

    units_per_second: Positive = 25.0
    longest_interval: NonNegative = 0.2
    births_before: NonNegative = 60.0


@dataclass(frozen=True, slots=True)
class Nothing:
    """A part that is left out, or that checks its settings itself."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Between pixels and ground, for ``motion.kind=plane``.

    Parameters
    ----------
    file : camera, see `ground.read_camera`; empty if the detections are in metres already.
    region : the ground that counts, left, low, right, high in metres; all 0: what the image shows
        up to ``max_distance``, no border without a camera.
    max_distance : metres from the camera up to which the ground counts.
    first_pixel : number of the first pixel in the detections; 1 in MOTChallenge's files.
    """

    file: str = ""
    region: Region = EVERYWHERE
    max_distance: Positive = 60.0
    first_pixel: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)
        check_region(self.region, "camera.region")


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """A scene that `phdtrack learn` has learned: births and false alarms in addition to those
    around each detection.

    Parameters
    ----------
    file : the learned scene; empty for none.
    use : parts of it that are used, of those that were learned.
    """

    file: str = ""
    use: tuple[Literal["births", "clutter"], ...] = ("births", "clutter")


@dataclass(frozen=True, slots=True)
class ClassOptions:
    """Settings of a detector's classes, each called by its name or its number.

    A class may have settings of its own: ``min_score``, ``min_size`` (longer side, pixels) and
    those of `class_settings.SECTIONS`. In a file they are the tables [classes.car] and
    [classes.car.sensor], on the command line ``classes.car.min_score=0.3``.

    Parameters
    ----------
    only : classes that are tracked; none: all.
    together : classes that the detector confuses, as [["car", "truck"]]; a track may change between
        them.
    names : names of the classes 0, 1, 2, …, if the detections have numbers only; or a table of
        number and name, such as the ``names`` of a model of Ultralytics.
    """

    only: tuple[Label, ...] = ()
    together: tuple[tuple[Label, ...], ...] = ()
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = [str(one).lower() for group in self.together for one in group]
        if len(known) > len(set(known)):
            raise InputError("expected each class in one group", where="classes.together")


def gaussians_at(places: Places) -> GaussianMixture:
    """Gaussians at rest at places of the ground. Raises `InputError` for a negative weight or a
    deviation that is not above 0.
    """
    x, y, weight, position, velocity = np.array(places, dtype=np.float64).reshape(-1, 5).T
    finite = np.isfinite(x + y + weight + position + velocity)
    if not (finite & (weight >= 0) & (position > 0) & (velocity > 0)).all():
        problem = (
            "expected places as x, y, a weight from 0, deviations of position and of velocity"
            " above 0"
        )
        raise InputError(problem, where="places")
    at_rest = np.zeros(len(x))
    variances = np.square(np.stack([position, position, velocity, velocity], axis=1))
    covariance = variances[:, :, None] * np.eye(4)
    return GaussianMixture(weight.copy(), np.stack([x, y, at_rest, at_rest]), covariance)
