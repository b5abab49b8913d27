"""The four scores of VACE and CLEAR, from the mappings of `matching.py` [M07 Table 1; M09 (22)–(25)].

    MODP(k) = Σ IoU of the mapped pairs / N_mapped              averaged over the frames that have a mapped pair
    MODA(k) = 1 − (c_m m_k + c_f f_k) / N_k                     averaged over the frames that have truth
    N_MODA  = 1 − Σ_k (c_m m_k + c_f f_k) / Σ_k N_k             pooled; false positives of frames without truth count
    MOTP    = Σ IoU over all mapped pairs / their number
    MOTA    = 1 − Σ_k (c_m m_k + c_f f_k + s_k) / Σ_k N_k
    MOTA_log: ln(1 + s_k) in place of s_k

with m_k misses, f_k false positives, s_k identity switches and N_k annotated boxes of frame k. MODA(k) and MODP(k) use the
detection mapping, everything else the tracking mapping; N_MODA is also there under the detection mapping.
N_MODA, MOTA, MOTP, switches and fragments are TrackEval's MODA, MOTA, MOTP, IDSW and Frag.

A switch: an object is mapped to another output than when it was last mapped, however long ago. A fragment: the mapping of an
object begins again after a break.

The comprehensive scores of the VACE protocol, without a threshold (Kasturi et al. 2009).

    FDA(k) = Σ_mapped IoU / ((N_G(k) + N_D(k)) / 2)         SFDA = mean of FDA(k) over the frames with a box on either side
    STDA   = Σ_mapped [ Σ_k IoU_k(G_i, D_i) / N_(G_i ∪ D_i) ]     ATA = STDA / ((N_G + N_D) / 2)

N_(G ∪ D) is the number of frames in which the object, its track, or both are present. FDA maps boxes of one frame and STDA
tracks of the whole sequence, one to one, each for the largest sum. SFDA says how well objects are found and framed, ATA how
well they are followed under one name. TrackEval's VACE has a relaxed STDA, which counts frames at IoU ≥ threshold as 1 and
others as 0: `ata_matched`.

OSPA(2) of whole tracks is made of the same sum: 1 − STDA / max(N_G, N_D).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.matching import Matches, Scene, assign, ratio
from phdtrack.types import F8, I8, Bool


@dataclass(frozen=True, slots=True)
class DetectionCounts:
    """Sums under the detection mapping.

    Attributes
    ----------
    truth_frames, mapped_frames : frames with an annotated box; frames with a mapped pair.
    truth_boxes, misses, false_positives : boxes in all frames.
    miss_ratio, false_ratio : Σ m_k/N_k and Σ f_k/N_k over the frames with truth.
    precision : Σ MODP(k) over the frames with a mapped pair.
    """

    truth_frames: int
    mapped_frames: int
    truth_boxes: int
    misses: int
    false_positives: int
    miss_ratio: float
    false_ratio: float
    precision: float

    def moda(self, miss_cost: float, false_positive_cost: float) -> float:
        """Mean of MODA(k) over the frames with truth [M09 (22)–(25)]; NaN without any."""
        wrong = miss_cost * self.miss_ratio + false_positive_cost * self.false_ratio
        return 1 - ratio(wrong, self.truth_frames)

    def n_moda(self, miss_cost: float, false_positive_cost: float) -> float:
        """N_MODA under the detection mapping; NaN without truth."""
        return 1 - ratio(miss_cost * self.misses + false_positive_cost * self.false_positives, self.truth_boxes)

    def modp(self) -> float:
        """Mean of MODP(k) over the frames with a mapped pair [M09 (22)–(25)]; NaN without any."""
        return ratio(self.precision, self.mapped_frames)


@dataclass(frozen=True, slots=True)
class TrackingCounts:
    """Sums under the tracking mapping; ``log_switches`` is Σ_k ln(1 + s_k), ``overlap`` the sum of mapped IoU."""

    truth_boxes: int
    matches: int
    misses: int
    false_positives: int
    switches: int
    log_switches: float
    fragments: int
    overlap: float

    def n_moda(self, miss_cost: float, false_positive_cost: float) -> float:
        """N_MODA under the tracking mapping; NaN without truth."""
        return 1 - ratio(miss_cost * self.misses + false_positive_cost * self.false_positives, self.truth_boxes)

    def mota(self, miss_cost: float, false_positive_cost: float) -> float:
        """MOTA [M09 (22)–(25)]; NaN without truth."""
        return self.n_moda(miss_cost, false_positive_cost) - ratio(self.switches, self.truth_boxes)

    def mota_log(self, miss_cost: float, false_positive_cost: float) -> float:
        """MOTA with ln(1 + switches of the frame) in place of the count [M09 (22)–(25)]; NaN without truth."""
        return self.n_moda(miss_cost, false_positive_cost) - ratio(self.log_switches, self.truth_boxes)

    def motp(self) -> float:
        """MOTP [M09 (22)–(25)]; NaN without a mapped pair."""
        return ratio(self.overlap, self.matches)


def count_detections(scene: Scene, mapping: Matches) -> DetectionCounts:
    """The sums of ``scene`` under its detection ``mapping``."""
    matched = mapping.per_frame(scene)
    misses, false = scene.truth_boxes - matched, scene.output_boxes - matched
    annotated, mapped = scene.truth_boxes > 0, matched > 0
    return DetectionCounts(
        truth_frames=int(annotated.sum()),
        mapped_frames=int(mapped.sum()),
        truth_boxes=int(scene.truth_boxes.sum()),
        misses=int(misses.sum()),
        false_positives=int(false.sum()),
        miss_ratio=float((misses[annotated] / scene.truth_boxes[annotated]).sum()),
        false_ratio=float((false[annotated] / scene.truth_boxes[annotated]).sum()),
        precision=float((mapping.iou_per_frame(scene)[mapped] / matched[mapped]).sum()),
    )


def count_tracking(scene: Scene, mapping: Matches) -> TrackingCounts:
    """The sums of ``scene`` under its tracking ``mapping``."""
    annotated, output, matched = int(scene.truth_boxes.sum()), int(scene.output_boxes.sum()), len(mapping.iou)
    switched = np.bincount(mapping.position[switches(mapping)], minlength=1)
    return TrackingCounts(
        truth_boxes=annotated,
        matches=matched,
        misses=annotated - matched,
        false_positives=output - matched,
        switches=int(switched.sum()),
        log_switches=float(np.log1p(switched).sum()),
        fragments=_fragments(scene, mapping),
        overlap=float(mapping.iou.sum()),
    )


def switches(mapping: Matches) -> Bool:
    """(K,) True where the object was mapped before, and to another output."""
    order, again = _histories(mapping)
    switched = np.zeros(len(order), np.bool_)
    switched[order[1:]] = again & (np.diff(mapping.output[order]) != 0)
    return switched


def _histories(mapping: Matches) -> tuple[I8, Bool]:
    """The order (K,) that puts the pairs of an object together, frames ascending; (K−1,) whether the next is of the same."""
    order = np.argsort(mapping.truth, kind="stable")
    return order, np.diff(mapping.truth[order]) == 0


def _fragments(scene: Scene, mapping: Matches) -> int:
    # As in TrackEval, a frame with an empty side does not break a mapping: time is counted without such frames.
    turn = np.cumsum((scene.truth_boxes > 0) & (scene.output_boxes > 0))
    order, again = _histories(mapping)
    return int((again & (np.diff(turn[mapping.position[order]]) > 1)).sum())


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
    """FDA of a frame of ``n`` and ``m`` boxes, not both 0, when the best mapping has the total ``overlap`` [K09 §3].

    Parameters
    ----------
    overlap : total IoU of the best mapping.
    n, m : numbers of annotated and of output boxes, not both 0.
    """
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
