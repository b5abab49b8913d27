"""A picture of the scene without the objects, from a few frames spread over the run.

With a fixed camera the median over the frames removes what moves. With a moving camera a median would be a ghost of several
views, so the middle frame is shown as it is. The two are told apart by how far the frames lie from their median.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from phdtrack.types import Image

_STILL = 10.0
"""Mean distance from the median, in grey levels, up to which the camera counts as fixed: crowds and noise stay below,
a turned camera lies far above."""


def still_background(images: Sequence[Image]) -> Image:
    """(H, W, 3) the scene seen in ``images`` (at least one, BGR); frames of another size than the first are left out."""
    same = [image for image in images if image.shape == images[0].shape]
    stack = np.stack(same)
    median = np.median(stack, axis=0).astype(np.uint8)
    apart = np.abs(stack.astype(np.int16) - median).mean()
    return median if apart <= _STILL else same[len(same) // 2].copy()
