"""Worlds, runs and an exact twin for the tests of the Poisson multi-Bernoulli filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mht_cases import FRAME

from phdtrack.arrays import GATE
from phdtrack.filters import PMB
from phdtrack.filters.pmb import Bernoullis
from phdtrack.kernels.pmb import STATIC_SHARE
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import F8
from reference.gm_twin import corrected

# What a detection shows of a state, and its noise in `world`.
H = np.eye(6)[[0, 1, 4, 5]]
NOISE = 9 * np.eye(4)
# One noise and one agility for all targets, no lasting clutter; clutter and p_D as the model says,
# and velocities that change little by little.
SIMPLE = PMB(
    noise_freedom=0.0,
    acceleration_factors=(1.0,),
    clutter_decay=0.0,
    lasting_clutter_prior=0.0,
    gate_probability=GATE,
    mean_visible_time=2.0,
    mean_occluded_time=0.4,
    static_clutter_prior=0.05,
    static_clutter_detection_probability=0.5,
    detection_memory=0.0,
    turns_per_second=0.0,
)
# Neither hidden states nor static clutter; and nothing is dropped.
PLAIN = replace(SIMPLE, mean_visible_time=0.0, static_clutter_prior=0.0)
EVERYTHING = replace(
    SIMPLE,
    existence_threshold=1e-200,
    hypothesis_threshold=1e-200,
    max_hypotheses=10**6,
    merge_distance=0.0,
    gate_probability=1.0,
)


def world(
    *,
    detection: float = 0.9,
    clutter: float = 1e-9,
    birth: float = 1e-9,
    survival: float = 0.99,
    rate: float = 25.0,
) -> Model:
    """Boxes with constant noises in an image without borders; births and clutter by their densities
    at a detection.
    """
    volume = (FRAME[0] * FRAME[1]) ** 2
    sensor = BoxSensor(
        detection_probability=detection,
        scaling="fixed",
        fixed_noise=(3.0, 3.0),
        birth_speed_pixels=6.0,
    )
    motion = BoxMotion(
        acceleration=0.5, size_noise=0.5, survival_probability=survival**rate, scaled_noise=False
    )
    births = MeasurementBirth(births_per_second=rate * birth * volume, frame_size=FRAME)
    return Model(motion, sensor, births, UniformClutter(clutter * volume, volume), rate=rate)


def without_births(model: Model) -> Model:
    return replace(model, birth=MeasurementBirth(births_per_detection=0.0, frame_size=FRAME))


def kalman(model: Model, mean: F8, cov: F8, z: F8 | None, dt: float) -> tuple[F8, F8]:
    """Predict, and update with one measurement (4,) where there is one."""
    moved, f, q = model.motion.transition(mean[:, None], dt)
    mean = moved[:, 0]
    cov = f[0] @ cov @ f[0].T + q[0]
    return (mean, cov) if z is None else corrected(mean, cov, z, H, NOISE)[:2]


@dataclass(frozen=True)
class One:
    """A way in which the only target may be: the measurements it took by frame, whether it stands
    still, as a target or as static clutter, and whether it is hidden.
    """

    weight: float
    taken: tuple[int, ...]
    static: bool
    genuine: bool
    hidden: bool
    mean: F8
    cov: F8


def moved_on(ways: list[One], model: Model, dt: float, turns: F8) -> list[One]:
    """Every way a frame later; ``turns`` (2, 2) are the chain's probabilities from in view and
    hidden to the same.
    """
    out = []
    for way in ways:
        weight = way.weight * float(model.motion.p_survive(way.mean[:, None], dt / model.rate)[0])
        mean, cov = kalman(model, way.mean, way.cov, None, dt)
        if way.static:
            # The place of what stands still is never known better than by a share of the variances
            # by which the sensor resolves it.
            noise = model.sensor.noise(way.mean[:, None])[:, 0]
            mean = way.mean
            cov = way.cov.copy()
            cov[range(6), range(6)] = np.maximum(np.diag(cov), STATIC_SHARE * noise**2)
        if not way.genuine:
            out.append(replace(way, weight=weight, cov=cov))
            continue
        out += [
            replace(
                way, weight=weight * turns[int(way.hidden), k], hidden=bool(k), mean=mean, cov=cov
            )
            for k in (0, 1)
        ]
    return out


def bernoulli(
    nobody: float, ways: list[One], z: F8, model: Model, firing: float
) -> tuple[float, list[One]]:
    """Bayes' rule for one target or none: probability that there is none, and every way in which
    there is one.
    """
    kappa = model.clutter.intensity(z)
    out = []
    for way in ways:
        p = 0.0 if way.hidden else model.sensor.detection_probability
        if not way.genuine:
            p = firing
        out.append(replace(way, weight=way.weight * (1 - p), taken=(*way.taken, -1)))
        for j in range(z.shape[1]):
            mean, cov, density = corrected(way.mean, way.cov, z[:, j], H, NOISE)
            out.append(
                replace(
                    way,
                    weight=way.weight * p * density / kappa[j],
                    taken=(*way.taken, j),
                    mean=mean,
                    cov=cov,
                    hidden=False,
                )
            )
    out = [way for way in out if way.weight > 0]
    total = nobody + sum(way.weight for way in out)
    return nobody / total, [replace(way, weight=way.weight / total) for way in out]


def pasts(state: Bernoullis) -> list[tuple[int, ...]]:
    """Of each hypothesis the measurements it took, frame by frame from its target's first."""
    out = []
    for place in range(len(state)):
        at = place
        taken = []
        for layer in state.layers[:0:-1]:
            taken.insert(0, int(layer.hypotheses["detection"][at]))
            at = int(layer.hypotheses["parent"][at])
            if at < 0:
                break
        out.append(tuple(taken))
    return out
