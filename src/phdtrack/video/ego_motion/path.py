"""How far a camera went: what is told of its motion at the end of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.ground import warp as warp_of
from phdtrack.types import F8


@dataclass(slots=True)
class CameraPath:
    """Sums over the frames so far, for pictures of ``width`` and ``height`` pixels.

    Attributes
    ----------
    frames : motions added; ``unmeasured`` of them are not known and count as none.
    pixels : way of what is in the middle of the picture, frame by frame.      largest : the longest such step.
    turned : degrees turned about the line of sight, either way.    zoomed : factor by which sizes have changed in all.
    """

    width: float
    height: float
    frames: int = 0
    unmeasured: int = 0
    pixels: float = 0.0
    largest: float = 0.0
    turned: float = 0.0
    zoomed: float = 1.0

    def add(self, warp: F8) -> None:
        """One more frame, whose pixels ``warp`` (3, 3) leads to; `types.STILL` where it is not known."""
        self.frames += 1
        if len(warp) == 0:
            self.unmeasured += 1
            return
        middle = np.array([[self.width / 2], [self.height / 2]])
        # A unit step to the right, as a state's velocity.
        moved = warp_of.carried(np.vstack([middle, [[1.0], [0.0], [1.0]]]), warp, (4,))[:, 0]
        step = float(np.hypot(*(moved[:2] - middle[:, 0])))
        self.pixels += step
        self.largest = max(self.largest, step)
        self.turned += abs(math.degrees(math.atan2(moved[3], moved[2])))
        self.zoomed *= float(moved[4])

    def sentence(self) -> str:
        """In plain words."""
        if not self.frames:
            return "the camera's motion: there is only one frame"
        lost = f"; in {self.unmeasured} of {self.frames} frames it could not be measured and was taken for none"
        return (
            f"the camera moved by {self.pixels:.0f} pixels in all in the middle of the picture, at most "
            f"{self.largest:.1f} from one frame to the next{lost if self.unmeasured else ''}"
        )

    def document(self) -> dict[str, object]:
        """The same for programs."""
        return {
            "frames": self.frames,
            "frames_unmeasured": self.unmeasured,
            "pixels": self.pixels,
            "largest_step_pixels": self.largest,
            "degrees_turned": self.turned,
            "zoomed": self.zoomed,
        }
