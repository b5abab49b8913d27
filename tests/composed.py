"""A frame as predict, update and reduce in turn: what `Filter.step` means; draws of f, and g by its
Gaussian.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from phdtrack.filters import ParticlePHD
from phdtrack.protocols import Filter, Model, Motion, Sensor
from phdtrack.types import F8, Particles, UpdateInfo

S = TypeVar("S")


def composed_step(
    recursion: Filter[S], state: S, z: F8, model: Model, dt: float, rng: np.random.Generator
) -> tuple[S, UpdateInfo]:
    """The intensity after a frame, ``dt`` after the one before, in which ``z`` (m, N) was
    measured.
    """
    predicted = recursion.predict(state, model, dt, rng)
    updated, info = recursion.update(predicted, z, model, dt, rng)
    return recursion.reduce(updated, rng), info


def drawn(motion: Motion, x: F8, dt: float, rng: np.random.Generator) -> F8:
    """(d, L) one draw of f(·|ξ) for each column ξ of ``x``, as the particle filters draw it."""
    count = x.shape[1]
    particles = Particles(x, np.ones(count), np.array([0, count]))
    return (
        ParticlePHD()
        .predict(particles, Model(motion, None, None, None), dt, rng)
        .state.astype(np.float64)
    )


def gaussian_view(sensor: Sensor, z: F8, x: F8) -> tuple[F8, F8]:
    """(P,) d² and log N(z; h(x), R) of pairs of columns."""
    step = sensor.innovation(z, sensor.predicted_measurements(x)).T
    noise = sensor.covariance(z, x)
    distance2 = (step * np.linalg.solve(noise, step[:, :, None])[:, :, 0]).sum(axis=1)
    return distance2, -0.5 * (distance2 + np.linalg.slogdet(2 * np.pi * noise)[1])
