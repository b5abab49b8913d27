"""The pasts that hypotheses carry from frame to frame: what each has seen of its target."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.kernels.appearance import NO_LOOKS, NO_PASTS, Looks, Pasts
from phdtrack.types import I8, Estimates


def carried(past: I8, pasts: Pasts, looks: Looks | None) -> tuple[I8, Pasts, Looks]:
    """The pasts of hypotheses, and what a frame looks like: nothing where that is not known.

    Where descriptors have another length than before, the pasts begin anew.

    Parameters
    ----------
    past : (C,) which of the ``pasts`` each hypothesis has, −1 for none.
    """
    if looks is None:
        return past, pasts, NO_LOOKS
    size = looks.raw.shape[1]
    if pasts.looks.shape[2] == size:
        return past, pasts, looks
    none = np.zeros((0, 2, size), np.float32)
    return np.full(len(past), -1), NO_PASTS._replace(looks=none), looks


def with_looks(estimates: Estimates, past: I8, pasts: Pasts, followed: I8) -> Estimates:
    """The estimates with what their pasts look like.

    Parameters
    ----------
    past : (n,) which of the ``pasts`` each estimate has, −1 for none.
    followed : see `Estimates.followed`.
    """
    known = past >= 0
    mean = np.zeros((len(past), pasts.looks.shape[2]), np.float32)
    number = np.zeros(len(past))
    mean[known] = pasts.looks[past[known], 0]
    number[known] = pasts.rows["number"][past[known]]
    return replace(estimates, appearance=mean, appearance_count=number, followed=followed)
