"""The shipped box model as the numbers and tables that the fused kernels read."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.kernels.birth_table import detection_table, neighbours
from phdtrack.kernels.overlaps import rectangle_grid
from phdtrack.models.births import MeasurementBirth, region
from phdtrack.models.box_motion import BoxMotion
from phdtrack.models.box_sensor import BoxSensor
from phdtrack.models.scene import SceneBirth
from phdtrack.models.spawning import NoSpawn
from phdtrack.models.volume import image_volume, local_volume
from phdtrack.protocols import Model
from phdtrack.types import F4, F8, I8


@dataclass(frozen=True, slots=True)
class BoxModel:
    """The parts of a model of boxes, by their own types."""

    motion: BoxMotion
    sensor: BoxSensor
    birth: MeasurementBirth | SceneBirth

    @property
    def own(self) -> bool:
        """Whether the likelihood's deviations follow the particle's size."""
        return self.sensor.scaling == "particle"

    @property
    def local(self) -> bool:
        """Whether births are spread around the detections."""
        return isinstance(self.birth, MeasurementBirth) and self.birth.volume == "local"


def box_model(model: Model) -> BoxModel | None:
    """The model's parts where the fused path knows all of them; None where it does not."""
    motion, sensor, birth = model.motion, model.sensor, model.birth
    if type(motion) is not BoxMotion or type(sensor) is not BoxSensor:
        return None
    if type(birth) is not MeasurementBirth and type(birth) is not SceneBirth:
        return None
    if motion.remember_size or type(motion.births) is not NoSpawn or sensor.scaling in ("previous", "given"):
        return None
    # The kernels know one detection probability for all.
    if len(sensor.hiders):
        return None
    return BoxModel(motion, sensor, birth)


def motion_numbers(motion: BoxMotion, dt: float) -> F4:
    """What `box_blocks.move` reads, and the rest of the position's noise for dt > 1 [M09 (11)]."""
    root, (width, height) = math.sqrt(dt), motion.frame_size
    rest = motion.drawn * math.sqrt((dt**3 - dt) / 12) if dt > 1 else 0.0
    if not (width > 0 and height > 0):
        width = height = 0.0
    scaled = float(motion.scaled_noise)
    numbers = (dt, motion.drawn * root, motion.size_noise * root, motion.min_size, scaled, width, height, rest)
    return np.array(numbers, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The detections of a frame as the kernels read them.

    Attributes
    ----------
    table : (rows, N) float32, see `kernels.box_blocks` and `kernels.newborn`; the proposals' peaks are still missing.
    numbers : (4,) float32 of the sensor: spread, floor, squared radii of the regions that count as explained and in which
        births are drawn.
    flat : (N,) float32 density of births around each detection where it is flat there; 0 where births are local.
    velocity : (5, N) float32 of each detection's newborn the mean, and the lower triangle that a velocity of uniform
        direction and standard Gaussian amplitude is turned with.
    extents : (N, 6) of the regions in which each one's newborn are drawn, see `kernels.birth_table`.
    lower, upper : (2, N) gates.  grid : their grid, see `kernels.overlaps`.
    near_start, near, touching : the neighbours of each one's newborn, see `kernels.birth_table`.
    """

    table: F4
    numbers: F4
    flat: F4
    velocity: F4
    extents: F4
    lower: F8
    upper: F8
    grid: tuple[F8, I8, I8, I8]
    near_start: I8
    near: I8
    touching: I8


def seen(model: BoxModel, z: F8, explained: float, seconds: float) -> Seen:
    """The tables for detections z (4, N); ``explained`` is the squared radius of the region that counts as explained."""
    at_rest = np.zeros((6, z.shape[1]))
    at_rest[0:2], at_rest[4:6] = z[0:2], z[2:4]
    noise = model.sensor.noise(at_rest)
    lower, upper = model.sensor.gate(z)
    limit, _ = region()
    rate = model.birth.births_per_second * seconds if model.local else 0.0
    table, speed, reach, extents, low, high = detection_table(
        z, noise, rate, local_volume(z), limit, lower, upper, model.local
    )
    # A floor of zero would let the deviation of a vanishing box vanish.
    numbers = np.array([model.sensor.box_noise, max(model.sensor.min_noise, 1e-3), explained, limit], np.float32)
    near = neighbours(z, reach, lower, upper, low, high, *rectangle_grid(low, high))
    flat, velocity = _births(model.birth, at_rest, noise, z, speed, seconds)
    return Seen(table, numbers, flat, velocity, extents, lower, upper, rectangle_grid(lower, upper), *near)


def _births(birth: MeasurementBirth | SceneBirth, at_rest: F8, noise: F8, z: F8, speed: F4, seconds: float) -> tuple[F4, F4]:
    """`Seen.flat` and `Seen.velocity`; ``at_rest``, ``noise`` (6, N) states of the detections, and their deviations.

    ``speed`` (N,) is the deviation of the velocity's amplitude at rest.
    """
    if isinstance(birth, SceneBirth):
        return birth.about(at_rest, noise, seconds)
    flat, velocity = np.zeros(z.shape[1], np.float32), np.zeros((5, z.shape[1]), np.float32)
    if birth.volume == "image":
        flat[:] = birth.births_per_second * seconds / image_volume(birth.frame_size)
    velocity[2], velocity[4] = speed, speed
    return flat, velocity
