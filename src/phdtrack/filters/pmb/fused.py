"""A whole frame of the Poisson multi-Bernoulli filter as one call, for the shipped box model."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from phdtrack.bernoullis import Layer
from phdtrack.filters.gm_box import BoxModel
from phdtrack.kernels.pmb_step import Settings, pmb_box_step
from phdtrack.kernels.pmb_update import foremost
from phdtrack.types import F8, UpdateInfo

_UNASKED = np.zeros(0)


@lru_cache(maxsize=64)
def settings_of(*settings: float) -> F8:
    """The settings as the kernel reads them, in the order of `Settings`."""
    return np.array(Settings(*settings), dtype=np.float64)


def fused_step(before: Layer, z: F8, box: BoxModel, settings: F8, fresh: int) -> tuple[Layer, UpdateInfo, int]:
    """The targets after a frame of the box model, and the label that is free next."""
    kappa = _UNASKED if box.clutter is None else box.clutter.intensity(z)
    target, exist, first, weight, mean, cov, static, hidden, taken, parent, table, predicted, born = pmb_box_step(
        before.exist, before.first, before.weight, before.mean, before.covariance, before.static, before.hidden,
        np.ascontiguousarray(z), kappa, box.numbers, settings,
    )  # fmt: skip
    old = int(np.count_nonzero(target >= 0))
    new = len(target) - old
    label = np.concatenate([before.label[target[:old]], fresh + np.arange(new)])
    best, presence = foremost(exist, first, weight, static)
    believed = np.concatenate([before.believed[target[:old]], np.zeros(new)])
    layer = Layer(
        exist, label, first, weight, mean, cov, static, hidden, taken, parent, best, presence, np.maximum(believed, presence)
    )
    evidence, clutter = table
    vanished = int(np.count_nonzero(evidence + clutter == 0))
    info = UpdateInfo(predicted + born, born, float(presence.sum()), evidence, clutter, vanished)
    return layer, info, fresh + new
