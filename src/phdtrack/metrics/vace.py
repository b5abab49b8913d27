"""The comprehensive scores of the VACE protocol, without a threshold (Kasturi et al. 2009).

    FDA(k) = Σ_mapped IoU / ((N_G(k) + N_D(k)) / 2)         SFDA = mean of FDA(k) over the frames with a box on either side
    STDA   = Σ_mapped [ Σ_k IoU_k(G_i, D_i) / N_(G_i ∪ D_i) ]     ATA = STDA / ((N_G + N_D) / 2)

N_(G ∪ D) is the number of frames in which the object, its track, or both are present. FDA maps boxes of one frame and STDA
tracks of the whole sequence, one to one, each for the largest sum. SFDA says how well objects are found and framed, ATA how
well they are followed under one name. TrackEval's VACE has a relaxed STDA, which counts frames at IoU ≥ threshold as 1 and
others as 0: `ata_matched`.

OSPA(2) of whole tracks is made of the same sum: 1 − STDA / max(N_G, N_D); see `ospa2`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.assignment import assign
from phdtrack.metrics.scene import Scene
from phdtrack.metrics.sums import ratio
from phdtrack.types import F8


@dataclass(frozen=True, slots=True)
class TrackCounts:
    """STDA of the sequence, its relaxed form, and the numbers of objects and of output identities [K09 §3]."""

    stda: float
    matched: float
    objects: int
    identities: int

    def ata(self) -> float:
        """ATA; 0 where one side is empty, NaN where both are."""
        return ratio(2 * self.stda, self.objects + self.identities)

    def ata_matched(self) -> float:
        """ATA of the relaxed form."""
        return ratio(2 * self.matched, self.objects + self.identities)

    def ospa2(self) -> float:
        """OSPA(2) over the whole sequence, c = p = q = 1; NaN where both sides are empty."""
        return 1 - ratio(self.stda, max(self.objects, self.identities))


def fda_from(overlap: float, n: int, m: int) -> float:
    """FDA of a frame of ``n`` and ``m`` boxes, not both 0, when the best mapping has the total ``overlap`` [K09 §3]."""
    return 2 * overlap / (n + m)


def count_whole_tracks(scene: Scene, threshold: float) -> TrackCounts:
    """The sums of ``scene``; ``threshold`` is that of the relaxed form."""
    shape = len(scene.truth_identity), len(scene.output_identity)
    overlap, matched, both = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    boxes = np.zeros(shape[0]), np.zeros(shape[1])
    for pair in scene.pairs:
        where = np.ix_(pair.truth, pair.output)
        overlap[where] += pair.iou
        # Without the rounding that the other scores allow: TrackEval has none here.
        matched[where] += pair.iou >= threshold
        both[where] += 1
        boxes[0][pair.truth] += 1
        boxes[1][pair.output] += 1
    either = boxes[0][:, None] + boxes[1] - both
    return TrackCounts(_best(overlap / either), _best(matched / either), *shape)


def _best(share: F8) -> float:
    return float(share[assign(share)].sum())
