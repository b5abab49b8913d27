"""Extraction for ``--filter none``: every detection is a state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.protocols import Model
from phdtrack.types import F8, Estimates, Particles


@dataclass(frozen=True, slots=True)
class Raw:
    """One state per detection, with the covariance of what one detection tells."""

    def extract(self, state: Particles, z: F8, model: Model) -> Estimates:
        """The detections as states at rest."""
        x, cov = model.sensor.states(z)
        return Estimates(x, cov, np.ones(len(cov)), model.sensor.boxes(x), np.arange(len(cov)))
