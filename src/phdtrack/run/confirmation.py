"""After how many detections in a row an object is reported."""

from __future__ import annotations

import numpy as np

from phdtrack import pipeline
from phdtrack.filters import NoFilter
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import lines
from phdtrack.types import F8, Detections, SequenceInfo

# An object that is detected this often in a row must have been reported; after more than _SLOW
# detections the user is warned.
_TRIED = 25
_SLOW = 5


def confirmation(stages: AnyStages, info: SequenceInfo, boxes: F8) -> tuple[str, ...]:
    """A note after how many detections an object is reported, and a warning if these are many;
    nothing without boxes or a filter.

    Parameters
    ----------
    stages, info : the tracker's parts, and the sequence.
    boxes : (n, 4) detections, whose usual size the object has.
    """
    if isinstance(stages.filter, NoFilter) or not len(boxes):
        return ()
    width, height = np.median(boxes[:, 2:] - boxes[:, :2], axis=0)
    needed = detections_needed(stages, info, (float(width), float(height)))
    return lines("confirmation.txt", needed=needed, tried=_TRIED, slow=_SLOW)


def detections_needed(stages: AnyStages, info: SequenceInfo, size: tuple[float, float]) -> int:
    """Detections in a row of an object up to its first state; 0 for more than 25.

    The ratio of the densities of births and of clutter decides it, which settings do not show. So
    it is tried: an object moves through the middle of the frame by a tenth of its width a frame and
    is detected in every frame. An object at rest from its first frame on may be a persistent false
    alarm.

    Parameters
    ----------
    stages, info : the tracker's parts, and the sequence.
    size : width and height of the object in pixels.
    """
    centre = np.array([info.width, info.height]) / 2
    half = np.array(size) / 2
    box = np.concatenate([centre - half, centre + half])
    step = np.array([0.1 * size[0], 0, 0.1 * size[0], 0])
    frames = (
        (k, k / info.fps, Detections.of(box + (k - _TRIED / 2) * step))
        for k in range(1, _TRIED + 1)
    )
    steps = pipeline.run(stages, frames, np.random.default_rng(0))
    return next((step.number for _, step in steps if len(step.estimates)), 0)
