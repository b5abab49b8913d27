"""Scores of one mapping of identities for the whole sequence: IDF1, ATA and OSPA(2).

IDF1 (Ristani et al. 2016; TrackEval's Identity):

    IDTP = max over one-to-one mappings of identities of
           Σ (frames in which the two overlap at IoU ≥ threshold)
    IDF1 = 2 IDTP / (annotated boxes + output boxes)

STDA and ATA (Kasturi et al. 2009), without a threshold:

    STDA = max over mappings of Σ_mapped [ Σ_k IoU_k(G_i, D_i) / N_(G_i ∪ D_i) ]
    ATA  = STDA / ((N_G + N_D) / 2)

N_(G ∪ D) is the number of frames in which the object, its track, or both are present. ATA_matched
has TrackEval's relaxed STDA, which counts frames at IoU ≥ threshold as 1 and others as 0. OSPA(2)
of whole tracks, c = p = q = 1, is 1 − STDA / max(N_G, N_D).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.metrics.matching import ROUNDING, SequencePair, assign
from phdtrack.types import F8, I8


class IdentityPairs(NamedTuple):
    """Sums over the frames for each pair of identities (G, O): IoU (``overlap``), frames at
    IoU ≥ threshold (``matched``), frames in which both are present (``both``), and the a of
    HOTA's alignment (``shared``).

    ``truth_boxes`` (G,) and ``output_boxes`` (O,) are the numbers of boxes of each identity,
    ``first_frame`` (G,) the first frame of each object.
    """

    overlap: F8
    matched: F8
    both: F8
    shared: F8
    truth_boxes: I8
    output_boxes: I8
    first_frame: I8


def identity_pairs(sequence: SequencePair, threshold: float) -> IdentityPairs:
    """The sums for pairs of identities."""
    objects = len(sequence.truth_identity)
    outputs = len(sequence.output_identity)
    overlap, matched, both, shared = np.zeros((4, objects, outputs))
    truth_boxes = np.zeros(objects, np.int64)
    output_boxes = np.zeros(outputs, np.int64)
    first_frame = np.zeros(objects, np.int64)
    # Backwards, so that the first frame of an object is written last.
    for pair in reversed(sequence.pairs):
        where = np.ix_(pair.truth, pair.output)
        total = pair.iou.sum(axis=0) + pair.iou.sum(axis=1)[:, None] - pair.iou
        overlap[where] += pair.iou
        # TrackEval allows no rounding here, unlike in its other scores.
        matched[where] += pair.iou >= threshold
        both[where] += 1
        shared[where] += np.divide(
            pair.iou, total, out=np.zeros_like(total), where=total > ROUNDING
        )
        truth_boxes[pair.truth] += 1
        output_boxes[pair.output] += 1
        first_frame[pair.truth] = pair.number
    return IdentityPairs(overlap, matched, both, shared, truth_boxes, output_boxes, first_frame)


def largest_total(score: F8) -> float:
    """The largest total ``score`` (n, m) of a one-to-one mapping."""
    return float(score[assign(score)].sum())
