"""Clouds of particles for the tests of extraction."""

from __future__ import annotations

from functools import reduce

import numpy as np

from phdtrack.filters.extract import KMeans, Mixture
from phdtrack.models import BoxClutter, BoxMotion, BoxSensor, MeasurementBirth
from phdtrack.protocols import Model
from phdtrack.types import Particles

ROWS = [0, 1, 4, 5]
FRAME = (4000.0, 4000.0)
EXTRACTORS = [KMeans(min_weight=0.6, merge_iou=1.0), Mixture(min_weight=0.5, merge_iou=1.0)]
NAMES = ["kmeans", "mixture"]
HERE = np.array([300.0, 200, 1, 0, 40, 100])
THERE = np.array([1300.0, 900, -1, 0, 50, 90])


def world(p_detect: float = 0.9, clutter: float = 1e-4) -> Model:
    return Model(
        BoxMotion(0.03, 0.07, frame_size=FRAME),
        BoxSensor(detection_probability=p_detect),
        MeasurementBirth(births_per_detection=25 * 0.05, particles=300, frame_size=FRAME),
        BoxClutter(clutter),
    )


MODEL = world()


def cloud(rng, at, mass: float, count: int = 400, spread: float = 0.5) -> Particles:
    """Particles about a state, as wide as ``spread`` of the measurement's noise: half of it is a
    typical posterior.
    """
    x = np.asarray(at, dtype=float)[:, None]
    state = x + spread * MODEL.sensor.noise(x) * rng.standard_normal((len(x), count))
    return Particles(state, np.full(count, mass / count))


def moved(*by: float) -> np.ndarray:
    """The state HERE, its first components changed by the given amounts."""
    return HERE + np.pad(np.array(by, dtype=float), (0, 6 - len(by)))


def together(*parts: Particles) -> Particles:
    return reduce(join, parts, Particles(np.zeros((6, 0)), np.zeros(0)))


def seen(*states) -> np.ndarray:
    """(4, n) exact detections of states."""
    return np.array(states, dtype=float).reshape(-1, 6).T[ROWS].copy()


def nearest_state(estimates, at) -> int:
    return int(np.argmin(np.abs(estimates.state[:2] - np.asarray(at)[:2, None]).sum(0)))


def join(a: Particles, b: Particles) -> Particles:
    """The sum of two intensities."""
    return Particles(np.hstack([a.state, b.state]), np.concatenate([a.weight, b.weight]))
