"""IDF1: how many boxes carry the right name, when each annotated identity may claim one output identity.

    IDTP = max over one-to-one mappings of identities of Σ (frames in which the two overlap at IoU ≥ threshold)
    IDF1 = 2 IDTP / (annotated boxes + output boxes)

One mapping for the whole sequence, unlike the frame-wise mappings of `matching.py` (Ristani et al. 2016). Minimising the
false boxes of both sides, as it is usually put, is the same: a pair of g and o boxes with t in common costs g + o − 2t, and
g + o when left apart. TrackEval's Identity gives the same figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.assignment import assign
from phdtrack.metrics.scene import Scene
from phdtrack.metrics.sums import ratio


@dataclass(frozen=True, slots=True)
class IdentityCounts:
    """IDTP, and the boxes on either side."""

    true_positives: int
    truth_boxes: int
    output_boxes: int

    def idf1(self) -> float:
        """IDF1; 0 where one side is empty, NaN where both are."""
        return ratio(2 * self.true_positives, self.truth_boxes + self.output_boxes)

    def recall(self) -> float:
        """IDR: share of the annotated boxes that are named right; NaN without truth."""
        return ratio(self.true_positives, self.truth_boxes)

    def precision(self) -> float:
        """IDP: share of the output boxes that are named right; NaN without output."""
        return ratio(self.true_positives, self.output_boxes)


def count_identities(scene: Scene, threshold: float) -> IdentityCounts:
    """The sums of ``scene`` for pairs of boxes at IoU ≥ ``threshold``."""
    common = np.zeros((len(scene.truth_identity), len(scene.output_identity)))
    for pair in scene.pairs:
        # Without the rounding that the other scores allow: TrackEval has none here.
        rows, columns = np.nonzero(pair.iou >= threshold)
        common[pair.truth[rows], pair.output[columns]] += 1
    found = int(common[assign(common)].sum())
    return IdentityCounts(found, int(scene.truth_boxes.sum()), int(scene.output_boxes.sum()))
