"""The shipped box model as the numbers and tables that the fused kernels read."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.kernels import box_blocks, newborn
from phdtrack.kernels.overlaps import rectangle_grid
from phdtrack.models.births import KEPT, MeasurementBirth
from phdtrack.models.box_motion import BoxMotion
from phdtrack.models.box_sensor import BoxSensor
from phdtrack.models.spawning import NoSpawn
from phdtrack.models.volume import image_volume, local_volume
from phdtrack.protocols import Model
from phdtrack.types import F4, F8, I8


@dataclass(frozen=True, slots=True)
class BoxModel:
    """The parts of a model of boxes, by their own types."""

    motion: BoxMotion
    sensor: BoxSensor
    birth: MeasurementBirth

    @property
    def own(self) -> bool:
        """Whether the likelihood's deviations follow the particle's size."""
        return self.sensor.scaling == "particle"

    @property
    def local(self) -> bool:
        """Whether births are spread around the detections."""
        return self.birth.volume == "local"


def box_model(model: Model) -> BoxModel | None:
    """The model's parts where the fused path knows all of them; None where it does not."""
    motion, sensor, birth = model.motion, model.sensor, model.birth
    if type(motion) is not BoxMotion or type(sensor) is not BoxSensor or type(birth) is not MeasurementBirth:
        return None
    if motion.remember_size or type(motion.births) is not NoSpawn or sensor.scaling in ("previous", "given"):
        return None
    return BoxModel(motion, sensor, birth)


def motion_numbers(motion: BoxMotion, dt: float) -> F4:
    """What `box_blocks.move` reads, and the rest of the position's noise for dt > 1 [M09 (11)]."""
    root, (width, height) = math.sqrt(dt), motion.frame_size
    rest = motion.acceleration * math.sqrt((dt**3 - dt) / 12) if dt > 1 else 0.0
    if not (width > 0 and height > 0):
        width = height = 0.0
    scaled = float(motion.scaled)
    numbers = (dt, motion.acceleration * root, motion.resize * root, motion.smallest, scaled, width, height, rest)
    return np.array(numbers, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The detections of a frame as the kernels read them.

    Attributes
    ----------
    z : (4, N).  reach : (2, N) half the extent of the region in which each one's newborn are drawn.
    table : (rows, N) float32, see `kernels.box_blocks` and `kernels.newborn`.
    speed : (N,) float32 deviation of a newborn velocity's amplitude.
    lower, upper : (2, N) gates.  grid : their grid, see `kernels.overlaps`.
    """

    z: F8
    reach: F8
    table: F4
    speed: F4
    lower: F8
    upper: F8
    grid: tuple[F8, I8, I8, I8]


def seen(model: BoxModel, z: F8, dt: float, limit: float) -> Seen:
    """The tables for detections z (4, N); ``limit`` is the squared radius of the region of births."""
    n = z.shape[1]
    at_rest = np.zeros((6, n))
    at_rest[0:2], at_rest[4:6] = z[0:2], z[2:4]
    noise = model.sensor.noise(at_rest)
    sigma = np.concatenate([noise[0:2], noise[4:6]])
    table = np.zeros((newborn.COLUMNS, n), np.float32)
    table[box_blocks.ZX : box_blocks.ZH + 1] = z
    inverse = 1.0 / sigma
    table[box_blocks.IX : box_blocks.IZH + 1] = inverse
    table[newborn.BX : newborn.BH + 1] = inverse
    table[box_blocks.GSCALE] = inverse.prod(0) / (2 * math.pi) ** 2
    table[newborn.SX : newborn.SH + 1] = sigma
    if model.local:
        table[newborn.DENSITY] = model.birth.rate * dt / local_volume(z)
    lower, upper = model.sensor.gate(z)
    speed = (math.sqrt(2) * noise[2]).astype(np.float32)
    return Seen(z, math.sqrt(limit) * sigma[:2], table, speed, lower, upper, rectangle_grid(lower, upper))


def proposal_peaks(seen: Seen, many: I8) -> F4:
    """The table with J_i times the density of each detection's proposal at its centre, a Gaussian cut to its kept part."""
    table = seen.table.copy()
    table[newborn.PEAK] = many * (table[box_blocks.GSCALE] / np.float32(KEPT))
    return table


def flat_density(birth: MeasurementBirth, dt: float) -> float:
    """γ during ``dt`` where it is the same all over the image; 0 where births lie around the detections."""
    return birth.rate * dt / image_volume(birth.frame_size) if birth.volume == "image" else 0.0
