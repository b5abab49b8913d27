"""The shipped box model as numbers, and a whole frame of the GM-PHD filter as one call for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from phdtrack.kernels import gm_model
from phdtrack.kernels.gm_model import BoxNumbers
from phdtrack.kernels.gm_reduce import triangles
from phdtrack.kernels.gm_step import Limits, box_step
from phdtrack.kernels.laid_over import scene_about
from phdtrack.models import (
    BoxMotion,
    BoxSensor,
    FixedBirth,
    LocalClutter,
    MeasurementBirth,
    NoSpawn,
    ScoredClutter,
    UniformClutter,
)
from phdtrack.models.births import newborn_shape, region
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.models.volume import REACH, SIZES, image_volume
from phdtrack.protocols import Birth, Clutter, Model
from phdtrack.types import F8, GaussianMixture, UpdateInfo

_SCALINGS = {
    "particle": gm_model.PARTICLE,
    "detection": gm_model.DETECTION,
    "fixed": gm_model.FIXED,
    "given": gm_model.GIVEN,
}
_NOBODY = np.zeros((0, 1 + gm_model.D + gm_model.ENTRIES))
_UNASKED, _NOWHERE = np.zeros(0), np.zeros((0, gm_model.ABOUT))
_NO_BIRTHS, _NO_CLUTTER = (np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))), (np.zeros(0), np.zeros((0, 0)))
# The smallest number above 0: at least this is positive.
_POSITIVE = math.ulp(0.0)


@dataclass(frozen=True, slots=True, eq=False)
class BoxModel:
    """The model over one interval: ``numbers`` (35,), see `gm_model.BoxNumbers`, and what they do not say.

    ``births`` (B, 1 + d + 21) are those that are given: weight, mean and triangle of the covariance of each; ``clutter``
    says κ where it is of one frame's values; ``scene`` is what a scene has taught of births that are spread around the
    detections by place, and of false alarms, as `kernels.laid_over.scene_about` takes it, None for neither.
    """

    numbers: F8
    births: F8
    clutter: ScoredClutter | None = None
    scene: tuple[F8, F8, F8, F8, F8] | None = None


def box_model(model: Model, dt: float) -> BoxModel | None:
    """The model in numbers, where its parts are shipped ones that the kernel knows; None where any is another's.

    Its own, not one derived from it: who overrides a method wants it called. The scaling ``previous`` has a longer state.
    """
    motion, sensor = model.motion, model.sensor
    # The kinds themselves and nothing derived from them.
    if type(motion) is not BoxMotion or type(sensor) is not BoxSensor or type(motion.births) is not NoSpawn:
        return None
    # The kernel knows one detection probability for all.
    if len(sensor.hiders):
        return None
    birth, clutter = model.birth, model.clutter
    if type(birth) is not MeasurementBirth and type(birth) is not FixedBirth and type(birth) is not SceneBirth:
        return None
    if type(clutter) is ScoredClutter:
        # What it is of matters only to itself: the kernel is given its values, which are those of one frame.
        box = _in_numbers(motion, sensor, birth, None, dt, dt / model.rate)
        return box and replace(box, clutter=clutter)
    if type(clutter) is not UniformClutter and type(clutter) is not LocalClutter and type(clutter) is not SceneClutter:
        return None
    return _in_numbers(motion, sensor, birth, clutter, dt, dt / model.rate)


# The parts are values, so the same ones give the same numbers.
@lru_cache(maxsize=64)
def _in_numbers(
    motion: BoxMotion,
    sensor: BoxSensor,
    births: MeasurementBirth | FixedBirth | SceneBirth,
    false: UniformClutter | LocalClutter | SceneClutter | None,
    dt: float,
    seconds: float,
) -> BoxModel | None:
    birth, clutter = _birth(births, seconds), _clutter(false)
    if motion.remember_size or sensor.scaling not in _SCALINGS or birth is None or clutter is None:
        return None
    volume, stretch = newborn_shape(gm_model.M)
    low, high = _bounds(births)
    numbers = BoxNumbers(
        dt=float(dt),
        acceleration=float(motion.acceleration),
        resize=float(motion.size_noise),
        scaled=float(motion.scaled_noise),
        smallest=float(motion.min_size),
        survival=float(motion.survival_probability**seconds),
        frame_width=float(motion.frame_size[0]),
        frame_height=float(motion.frame_size[1]),
        scaling=_SCALINGS[sensor.scaling],
        spread=float(sensor.box_noise),
        floor=float(sensor.min_noise),
        fixed_position=float(sensor.fixed_noise[0]) ** 2,
        fixed_size=float(sensor.fixed_noise[1]) ** 2,
        deviation_scaled=sensor.birth_speed / math.sqrt(2),
        deviation_fixed=sensor.birth_speed_pixels / math.sqrt(2),
        p_detect=float(sensor.detection_probability),
        birth=birth[0],
        born=birth[1],
        newborn_volume=volume,
        newborn_stretch=stretch,
        newborn_limit=region()[0],
        clutter=clutter[0],
        false=clutter[1],
        local_volume=(2 * REACH) ** 2 * (SIZES[1] - SIZES[0]) ** 2,
        reach=REACH,
        size_low=SIZES[0],
        size_high=SIZES[1],
        low=low,
        high=high,
    )
    return BoxModel(np.hstack(numbers), birth[2], scene=_scene(births, false))


def _birth(birth: Birth, seconds: float) -> tuple[float, float, F8] | None:
    """What γ is spread over, its density or rate, and its Gaussians where it is a mixture."""
    if type(birth) is FixedBirth and len(birth.mixture.mean) == gm_model.D:
        return gm_model.NOWHERE, 0.0, _table(birth.mixture, seconds)
    if type(birth) is SceneBirth and birth.density.dim == gm_model.D and birth.observed == gm_model.ROWS:
        if birth.around_detections > 0:
            return gm_model.PLACES, float(birth.around_detections * seconds), _NOBODY
        return gm_model.IMAGE, float(birth.flat * seconds), _table(birth.given, seconds)
    if type(birth) is not MeasurementBirth:
        return None
    if birth.volume == "local":
        return gm_model.LOCAL, float(birth.births_per_second * seconds), _NOBODY
    return gm_model.IMAGE, float(birth.births_per_second / image_volume(birth.frame_size) * seconds), _NOBODY


def _table(given: GaussianMixture, seconds: float) -> F8:
    """(B, 1 + d + 21) births as `kernels.gm_step` takes them."""
    return np.hstack([given.weight[:, None] * seconds, given.mean.T, triangles(np.ascontiguousarray(given.covariance))])


def _scene(birth: Birth, clutter: Clutter | None) -> tuple[F8, F8, F8, F8, F8] | None:
    """`BoxModel.scene`."""
    births = birth.rows if isinstance(birth, SceneBirth) and birth.around_detections > 0 else None
    alarms = clutter.rows if isinstance(clutter, SceneClutter) else None
    return None if births is None and alarms is None else (*(births or _NO_BIRTHS), *(alarms or _NO_CLUTTER))


def _bounds(birth: Birth) -> tuple[gm_model.Box, gm_model.Box]:
    """Where a detection must lie for a birth about it: in the volume that was learned, or any of positive size."""
    if isinstance(birth, SceneBirth):
        low, high = birth.shown.low, birth.shown.high
        return (low[0], low[1], low[2], low[3]), (high[0], high[1], high[2], high[3])
    return (-math.inf, -math.inf, _POSITIVE, _POSITIVE), (math.inf, math.inf, math.inf, math.inf)


def _clutter(clutter: Clutter | None) -> tuple[float, float] | None:
    """What κ is spread over, and its density or rate, by place that of what is beside. None: κ is given."""
    if clutter is None:
        return gm_model.PLACES, 0.0
    if type(clutter) is SceneClutter:
        return (gm_model.PLACES, float(clutter.around_detections)) if clutter.density.dim == gm_model.M else None
    if type(clutter) is LocalClutter:
        return gm_model.LOCAL, float(clutter.clutter_per_frame)
    if type(clutter) is UniformClutter:
        return gm_model.IMAGE, float(clutter.clutter_per_frame / clutter.volume)
    return None


@lru_cache(maxsize=64)
def limits(*settings: float) -> F8:
    """The settings of the filter as the kernel reads them, in the order of `Limits`."""
    return np.array(Limits(*settings), dtype=np.float64)


def fused_step(state: GaussianMixture, z: F8, box: BoxModel, settings: F8) -> tuple[GaussianMixture, UpdateInfo]:
    """A frame of the box model [V06 (24)–(38), Table II]; ``settings`` as `limits` gives them."""
    z, about, kappa = np.ascontiguousarray(z), _NOWHERE, _UNASKED
    if box.scene is not None:
        about, kappa = scene_about(z, box.numbers, *box.scene)
    if box.clutter is not None:
        kappa = box.clutter.intensity(z)
    weight, mean, cov, tag, table, predicted, newborn, mass, vanished, fresh = box_step(
        state.weight, state.mean, state.covariance, state.tag, z, box.births, about, kappa, box.numbers, settings,
        state.fresh,
    )  # fmt: skip
    evidence, kappa = table
    return GaussianMixture(weight, mean, cov, tag, fresh), UpdateInfo(predicted, newborn, mass, evidence, kappa, vanished)
