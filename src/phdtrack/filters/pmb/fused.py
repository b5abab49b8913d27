"""A whole frame of the Poisson multi-Bernoulli filter as one call, for the shipped box model."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from phdtrack.filters.bernoullis import Bernoullis, Layer
from phdtrack.filters.gm_box import BoxModel
from phdtrack.kernels.pmb_births import birth_states, scene_states
from phdtrack.kernels.pmb_rows import ROW
from phdtrack.kernels.pmb_step import Settings, pmb_box_step
from phdtrack.types import F8, UpdateInfo

_UNASKED, _ALONE = np.zeros(0), np.zeros((0, ROW + 1))


@lru_cache(maxsize=64)
def settings_of(*settings: float) -> F8:
    """The settings as the kernel reads them, in the order of `Settings`."""
    return np.array(Settings(*settings), dtype=np.float64)


def fused_step(
    state: Bernoullis, now: Layer, z: F8, box: BoxModel, settings: F8, gate: float, depth: int
) -> tuple[Bernoullis, UpdateInfo]:
    """The targets ``now``, those of ``state`` in the frame's pixels, after a frame of the box model."""
    # The kernel is compiled for arrays row by row.
    ordered = np.ascontiguousarray
    z, births, kappa = ordered(z), _ALONE, _UNASKED
    if box.scene is not None:
        births, kappa = scene_states(z, box.numbers, *box.scene)
    if len(box.births):
        births = birth_states(z, box.births, gate, box.numbers)
    if box.clutter is not None:
        kappa = box.clutter.intensity(z)
    told, name, first, shares, mean, cov, static, origin, ended, fresh, table, total = pmb_box_step(
        now.exist, now.label, now.first, now.weight, ordered(now.mean), ordered(now.covariance), now.static, now.hidden,
        now.best, now.believed, ordered(state.ended), state.fresh, z, births, kappa, box.numbers, settings,
    )  # fmt: skip
    exist, presence, believed = told
    (label, best), (weight, hidden), (detection, parent) = name, shares, origin
    layer = Layer(
        exist, label, first, weight, mean, cov, static, hidden, detection, parent, best, presence, believed
    )  # fmt: skip
    predicted, born, mass, vanished = total.tolist()
    info = UpdateInfo(predicted + born, born, mass, table[0], table[1], int(vanished))
    return Bernoullis((*state.layers[-depth:], layer), ended, fresh), info
