"""HOTA (Luiten et al. 2021; TrackEval's HOTA): for each threshold α in 0.05, 0.10, …, 0.95, then
averaged over them,

    DetA_α = TP / (TP + FN + FP)        AssA_α = 1/TP Σ_{c ∈ TP} A(c)
    HOTA_α = √(DetA_α AssA_α)

where for a mapped pair c of identities (i, j) A(c) = TPA / (TPA + FNA + FPA): TPA counts the frames
in which i is mapped to j, FNA and FPA the other boxes of i and of j. The mapping in a frame has the
largest Σ J(i, j)·IoU, where the alignment J rewards identities that agree over the whole sequence;
all α share one mapping:

    J(i, j) = Σ_k a / (|i| + |j| − Σ_k a)        a = IoU / (Σ_row IoU + Σ_column IoU − IoU)
"""

from __future__ import annotations

import numpy as np

from phdtrack.metrics.identity import IdentityPairs
from phdtrack.metrics.matching import ROUNDING, SequencePair, match
from phdtrack.types import F8

ALPHA: F8 = np.arange(0.05, 0.99, 0.05)


def hota_sums(sequence: SequencePair, pairs: IdentityPairs) -> tuple[F8, F8]:
    """(19,) number of mapped pairs at each α, and (19,) Σ A(c) over them."""
    aligned = pairs.shared / (pairs.truth_boxes[:, None] + pairs.output_boxes - pairs.shared)
    mapping = match(sequence, lambda pair, _: aligned[np.ix_(pair.truth, pair.output)] * pair.iou)
    # Only pairs of identities that are mapped are kept: a dense table would hold G·O·19 numbers.
    code = mapping.truth * max(len(pairs.output_boxes), 1) + mapping.output
    _, first, which = np.unique(code, return_index=True, return_inverse=True)
    boxes = pairs.truth_boxes[mapping.truth[first]] + pairs.output_boxes[mapping.output[first]]
    matches = np.zeros(len(ALPHA))
    association = np.zeros(len(ALPHA))
    for a, alpha in enumerate(ALPHA):
        together = np.bincount(which[mapping.iou >= alpha - ROUNDING], minlength=len(first))
        matches[a] = together.sum()
        association[a] = (together * together / np.maximum(1, boxes - together)).sum()
    return matches, association
