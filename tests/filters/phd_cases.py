"""Intensities, models and detections for the tests of the filter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.kernels.gaussian import Births
from phdtrack.models import BoxClutter, BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.models.births import births_around
from phdtrack.models.volumes import image_volume
from phdtrack.protocols import Model
from phdtrack.types import Particles

FRAME = (640.0, 480.0)


@dataclass(frozen=True)
class NoBirth:
    """γ = 0."""

    def sample(self, z, covered, sensor, seconds, rng) -> Particles:
        x, _ = sensor.states(z[:, :0])
        return Particles(x, np.zeros(0))

    def gaussians(self, z, sensor, seconds) -> Births:
        return births_around(sensor.states(z), np.zeros(z.shape[1]))

    def expected_count(self, z, seconds) -> float:
        return 0.0


def world(birth=None, clutter=None, **sensor) -> Model:
    """Boxes with the default noises; no births, a clutter of one a frame over the image."""
    seen = BoxSensor(**sensor)
    return Model(
        BoxMotion(0.03, 0.1, 0.99**25, frame_size=FRAME, roughening=0.0),
        seen,
        birth or NoBirth(),
        clutter or UniformClutter(1.0, image_volume(FRAME)),
    )


def with_births(model: Model, rate: float = 0.05, most: int = 300) -> Model:
    return replace(
        model,
        birth=MeasurementBirth(births_per_detection=25 * rate, particles=most, frame_size=FRAME),
        clutter=BoxClutter(0.5),
    )


def crowd(
    rng, targets: int, each: int, mass: float = 1.0, spread: float = 0.15, width: float = 640.0
) -> Particles:
    """Particles around random targets, spread about as the sensor's noise."""
    centre = rng.uniform([0, 0, -2, -2, 15, 30], [width, 480, 2, 2, 60, 150], (targets, 6)).T
    x = np.repeat(centre, each, axis=1)
    scale = np.stack(
        [
            spread / 2 * x[4],
            spread / 2 * x[5],
            0.05 * x[4],
            0.05 * x[4],
            spread * x[4],
            spread * x[5],
        ]
    )
    x = x + scale * rng.standard_normal(x.shape)
    x[4:6] = np.maximum(np.abs(x[4:6]), 2.0)
    weight = rng.uniform(0.5, 1.5, x.shape[1])
    return Particles(x, weight * mass * targets / weight.sum())


def seen_by(rng, particles: Particles, count: int) -> np.ndarray:
    """(4, count) detections of randomly chosen particles."""
    x = particles.state[:, rng.integers(len(particles), size=count)]
    z = x[[0, 1, 4, 5]] + 0.1 * rng.standard_normal((4, count)) * np.vstack([x[4:6], x[4:6]])
    z[2:] = np.maximum(z[2:], 2.0)
    return z
