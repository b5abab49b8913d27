"""The sums behind IDF1: how many boxes carry the right name, when each annotated identity may claim one output identity.

    IDTP = max over one-to-one mappings of identities of Σ (frames in which the two overlap at IoU ≥ threshold)
    IDF1 = 2 IDTP / (annotated boxes + output boxes)

One mapping for the whole sequence, unlike the frame-wise mappings of `matching.py` (Ristani et al. 2016). Minimising the
false boxes of both sides, as it is usually put, is the same: a pair of g and o boxes with t in common costs g + o − 2t, and
g + o when left apart. TrackEval's Identity gives the same figures.

HOTA: detection and association in one figure (Luiten et al., IJCV 2021; TrackEval's HOTA gives the same).

For each threshold α in 0.05, 0.10, …, 0.95

    DetA_α = TP / (TP + FN + FP)
    AssA_α = 1/TP Σ_{c ∈ TP} A(c)      A(c) = TPA / (TPA + FNA + FPA)
    HOTA_α = √(DetA_α AssA_α)

where for a mapped pair c of identities (i, j) TPA counts the frames in which i is mapped to j, and FNA, FPA the other boxes
of i and of j. The three scores are means over α. The mapping in a frame has the largest Σ J(i, j)·IoU, where the alignment J
rewards identities that agree over the whole sequence:

    J(i, j) = Σ_k a / (|i| + |j| − Σ_k a)        a = IoU / (Σ_row IoU + Σ_column IoU − IoU)

It is one mapping for all α; a pair counts at those α that its IoU reaches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.matching import ROUNDING, Matches, Scene, assign, match
from phdtrack.types import F8, I8


@dataclass(frozen=True, slots=True)
class IdentityCounts:
    """IDTP, and the boxes on either side."""

    true_positives: int
    truth_boxes: int
    output_boxes: int


def count_identities(scene: Scene, threshold: float) -> IdentityCounts:
    """The sums of ``scene`` for pairs of boxes at IoU ≥ ``threshold``."""
    common = np.zeros((len(scene.truth_identity), len(scene.output_identity)))
    for pair in scene.pairs:
        # Without the rounding that the other scores allow: TrackEval has none here.
        rows, columns = np.nonzero(pair.iou >= threshold)
        common[pair.truth[rows], pair.output[columns]] += 1
    found = int(common[assign(common)].sum())
    return IdentityCounts(found, int(scene.truth_boxes.sum()), int(scene.output_boxes.sum()))


ALPHA: F8 = np.arange(0.05, 0.99, 0.05)


@dataclass(frozen=True, slots=True, eq=False)
class HotaCounts:
    """Mapped pairs at each α (19,), Σ A(c) over them (19,), and the number of boxes on each side."""

    true_positives: F8
    association: F8
    truth_boxes: int
    output_boxes: int

    def per_alpha(self) -> tuple[F8, F8, F8]:
        """(19,) each: HOTA_α, DetA_α and AssA_α; NaN where both sides are empty, AssA 0 where no pair is mapped."""
        either = self.truth_boxes + self.output_boxes - self.true_positives
        det_a = np.divide(self.true_positives, either, out=np.full_like(either, np.nan), where=either > 0)
        ass_a = np.where(either > 0, self.association / np.maximum(1, self.true_positives), np.nan)
        return np.sqrt(det_a * ass_a), det_a, ass_a


def count_hota(scene: Scene) -> HotaCounts:
    """The sums of ``scene`` for all thresholds."""
    of_truth, of_output = (np.zeros(len(names), np.int64) for names in (scene.truth_identity, scene.output_identity))
    for pair in scene.pairs:
        of_truth[pair.truth] += 1
        of_output[pair.output] += 1
    aligned = _alignment(scene, of_truth, of_output)
    mapping = match(scene, lambda pair: aligned[np.ix_(pair.truth, pair.output)] * pair.iou)
    found, association = _associations(mapping, of_truth, of_output)
    return HotaCounts(found, association, int(of_truth.sum()), int(of_output.sum()))


def _alignment(scene: Scene, of_truth: I8, of_output: I8) -> F8:
    """(G, O) J(i, j)."""
    common = np.zeros((len(of_truth), len(of_output)))
    for pair in scene.pairs:
        rivals = pair.iou.sum(axis=0)[None, :] + pair.iou.sum(axis=1)[:, None] - pair.iou
        share = np.divide(pair.iou, rivals, out=np.zeros_like(rivals), where=rivals > ROUNDING)
        common[np.ix_(pair.truth, pair.output)] += share
    aligned: F8 = common / (of_truth[:, None] + of_output[None, :] - common)
    return aligned


def _associations(mapping: Matches, of_truth: I8, of_output: I8) -> tuple[F8, F8]:
    """(19,) number of mapped pairs at each α, and Σ A(c) over them."""
    # Only pairs of identities that meet are kept: a dense table would hold G·O·19 numbers.
    code = mapping.truth * max(len(of_output), 1) + mapping.output
    _, first, which = np.unique(code, return_index=True, return_inverse=True)
    boxes = of_truth[mapping.truth[first]] + of_output[mapping.output[first]]
    found, association = np.zeros(len(ALPHA)), np.zeros(len(ALPHA))
    for a, alpha in enumerate(ALPHA):
        together = np.bincount(which[mapping.iou >= alpha - ROUNDING], minlength=len(first))
        found[a] = together.sum()
        association[a] = (together * together / np.maximum(1, boxes - together)).sum()
    return found, association
