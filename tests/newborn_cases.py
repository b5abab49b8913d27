"""The Gaussians that the GM-PHD filter makes of births."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.filters import GMPHD
from phdtrack.models import PlaneMotion, UniformClutter
from phdtrack.protocols import Birth, Model, Sensor
from phdtrack.types import GaussianMixture


def newborn(birth: Birth, z: np.ndarray, sensor: Sensor, seconds: float) -> GaussianMixture:
    """What there is after a frame in which nothing was expected and targets are never detected."""
    model = Model(PlaneMotion(), replace(sensor, detection_probability=0.0), birth, UniformClutter(1.0, 1.0), rate=1.0)
    d = len(sensor.states(z)[0])
    nothing = GaussianMixture(np.zeros(0), np.zeros((d, 0)), np.zeros((0, d, d)))
    found, _ = GMPHD().update(nothing, z, model, seconds, np.random.default_rng(0))
    there = found.weight > 0
    return GaussianMixture(found.weight[there], found.mean[:, there], found.covariance[there])
