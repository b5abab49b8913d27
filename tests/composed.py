"""One frame of a filter as predict, update and reduce in turn: what `Filter.step` means."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, UpdateInfo

S = TypeVar("S")


def composed_step(
    recursion: Filter[S], state: S, z: F8, model: Model, dt: float, rng: np.random.Generator
) -> tuple[S, UpdateInfo]:
    """The intensity after a frame, ``dt`` after the one before, in which ``z`` (m, N) was measured."""
    predicted = recursion.predict(state, model, dt, rng)
    updated, info = recursion.update(predicted, z, model, dt, rng)
    return recursion.reduce(updated, rng), info
