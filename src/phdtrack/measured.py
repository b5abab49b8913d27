"""What is remembered of a sequence's measurements when it has ended: what finished tracks are refined by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phdtrack.types import F4, F8, I8


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The measurements of a sequence, frame by frame: what is remembered of them when it has ended.

    Attributes
    ----------
    number, time : (F,) the frames' numbers, ascending, and their times in the model's time units.
    start : (F + 1,) frame f has the columns start[f] … start[f + 1] − 1 of ``z`` (m, Z), in the order of its detections.
    warp : (F, 3, 3) how the camera moved since the frame before; (0, 3, 3) where it stood.
    look : (Z, B) what each detection looks like, as `Refiner.look` has it, NaN where that is not known; (Z, 0) where nobody
        looked.
    """

    number: I8
    time: F8
    start: I8
    z: F8
    warp: F8
    look: F4

    def looked(self, looks: Mapping[int, F4]) -> Measured:
        """With what the detections of frames (by their number) look like, (N, B) each."""
        kept = [(place, looks[number]) for place, number in enumerate(self.number.tolist()) if number in looks]
        if not kept:
            return self
        look = np.full((self.z.shape[1], kept[0][1].shape[1]), np.nan, np.float32)
        for place, those in kept:
            look[self.start[place] : self.start[place + 1]] = those
        return Measured(self.number, self.time, self.start, self.z, self.warp, look)
