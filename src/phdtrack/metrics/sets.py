"""OSPA, GOSPA, SFDA and the number of boxes, frame by frame: scores that know no identities and no threshold.

On boxes the base distance is 1 − IoU, with c = 1, p = 1, α = 2; OSPA and GOSPA are means over all frames of the sequence, in
which a frame that is empty on both sides counts 0, and SFDA is one over the frames that are not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.assignment import assign
from phdtrack.metrics.gospa import gospa_from
from phdtrack.metrics.ospa import ospa_from
from phdtrack.metrics.scene import Scene
from phdtrack.metrics.sums import ratio
from phdtrack.metrics.vace import fda_from

CUTOFF, ORDER, ALPHA = 1.0, 1.0, 2.0


@dataclass(frozen=True, slots=True)
class SetCounts:
    """Sums over ``frames`` frames, ``occupied`` of which hold a box on either side: OSPA, GOSPA, FDA, the error of the
    count (output − truth), and its square."""

    frames: int
    occupied: int
    ospa_sum: float
    gospa_sum: float
    fda_sum: float
    count_error: int
    count_error_squared: int

    def ospa(self) -> float:
        """Mean OSPA; NaN without frames."""
        return ratio(self.ospa_sum, self.frames)

    def gospa(self) -> float:
        """Mean GOSPA; NaN without frames."""
        return ratio(self.gospa_sum, self.frames)

    def sfda(self) -> float:
        """Mean FDA over the occupied frames; NaN without any."""
        return ratio(self.fda_sum, self.occupied)

    def count_error_mean(self) -> float:
        """Mean of (output − truth) boxes per frame: positive where too many are reported."""
        return ratio(self.count_error, self.frames)

    def count_error_rms(self) -> float:
        """Root of the mean squared error of the number of boxes."""
        return math.sqrt(ratio(self.count_error_squared, self.frames))


def count_sets(scene: Scene) -> SetCounts:
    """The sums of ``scene``."""
    ospa_sum = gospa_sum = fda_sum = 0.0
    for pair in scene.pairs:
        n, m = pair.iou.shape
        # With distance 1 − IoU the cheapest mapping is the one with most overlap, and serves all scores.
        overlap = float(pair.iou[assign(pair.iou)].sum())
        least = min(n, m) - overlap
        ospa_sum += ospa_from(least, n, m, c=CUTOFF, p=ORDER)
        gospa_sum += gospa_from(least, n, m, c=CUTOFF, p=ORDER, alpha=ALPHA)
        fda_sum += fda_from(overlap, n, m)
    error = scene.output_boxes - scene.truth_boxes
    sums = ospa_sum, gospa_sum, fda_sum
    return SetCounts(scene.frames, len(scene.pairs), *sums, int(error.sum()), int(np.square(error).sum()))
