"""What a filter carries, in the pixels of the present frame, where the camera has moved (`Model.warp`)."""

from __future__ import annotations

import numpy as np

from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture, ParticleBlocks, Particles


def carried_particles(state: Particles | ParticleBlocks, model: Model) -> Particles | ParticleBlocks:
    """The same weights at the carried states; neighbours stay neighbours, and so blocks stay blocks."""
    if len(model.warp) == 0 or len(state) == 0:
        return state
    if isinstance(state, Particles):
        return Particles(model.warp_states(state.state), state.weight)
    moved = model.warp_states(state.state.astype(np.float64))
    return ParticleBlocks(np.ascontiguousarray(moved, np.float32), state.start, state.unit)


def carried_mixture(state: GaussianMixture, model: Model) -> GaussianMixture:
    """The same weights and tags, means and covariances carried."""
    if len(model.warp) == 0 or len(state) == 0:
        return state
    mean, cov = model.warp_gaussians(state.mean, state.covariance)
    return GaussianMixture(state.weight, mean, cov, state.tag, state.fresh)
