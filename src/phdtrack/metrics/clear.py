"""The sums behind the scores of VACE and CLEAR, from the mappings of `matching.py` [M07 Table 1; M09 (22)–(25)].

    MODP(k) = Σ IoU of the mapped pairs / N_mapped              averaged over the frames that have a mapped pair
    MODA(k) = 1 − (c_m m_k + c_f f_k) / N_k                     averaged over the frames that have truth
    N_MODA  = 1 − Σ_k (c_m m_k + c_f f_k) / Σ_k N_k             pooled; false positives of frames without truth count
    MOTP    = Σ IoU over all mapped pairs / their number
    MOTA    = 1 − Σ_k (c_m m_k + c_f f_k + s_k) / Σ_k N_k
    MOTA_log: ln(1 + s_k) in place of s_k

with m_k misses, f_k false positives, s_k identity switches and N_k annotated boxes of frame k. MODA(k) and MODP(k) use the
detection mapping, everything else the tracking mapping. N_MODA, MOTA, MOTP, switches and fragments are TrackEval's MODA,
MOTA, MOTP, IDSW and Frag.

A switch: an object is mapped to another output than when it was last mapped, however long ago. A fragment: the mapping of an
object begins again after a break.

The comprehensive scores of the VACE protocol, without a threshold (Kasturi et al. 2009).

    FDA(k) = Σ_mapped IoU / ((N_G(k) + N_D(k)) / 2)         SFDA = mean of FDA(k) over the frames with a box on either side
    STDA   = Σ_mapped [ Σ_k IoU_k(G_i, D_i) / N_(G_i ∪ D_i) ]     ATA = STDA / ((N_G + N_D) / 2)

N_(G ∪ D) is the number of frames in which the object, its track, or both are present. FDA maps boxes of one frame and STDA
tracks of the whole sequence, one to one, each for the largest sum. ATA_matched has TrackEval's relaxed STDA, which counts
frames at IoU ≥ threshold as 1 and others as 0. OSPA(2) of whole tracks, c = p = q = 1, is 1 − STDA / max(N_G, N_D).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.matching import Matches, Scene, assign
from phdtrack.types import I8, Bool


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
    # As in TrackEval, a frame with an empty side does not break a mapping: time is counted without such frames.
    turn = np.cumsum((scene.truth_boxes > 0) & (scene.output_boxes > 0))
    order, again = _histories(mapping)
    return TrackingCounts(
        truth_boxes=annotated,
        matches=matched,
        misses=annotated - matched,
        false_positives=output - matched,
        switches=int(switched.sum()),
        log_switches=float(np.log1p(switched).sum()),
        fragments=int((again & (np.diff(turn[mapping.position[order]]) > 1)).sum()),
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


@dataclass(frozen=True, slots=True)
class TrackCounts:
    """STDA of the sequence, its relaxed form, and the numbers of objects and of output identities [K09 §3]."""

    stda: float
    matched: float
    objects: int
    identities: int


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
    shares = [total / (boxes[0][:, None] + boxes[1] - both) for total in (overlap, matched)]
    stda, relaxed = (float(share[assign(share)].sum()) for share in shares)
    return TrackCounts(stda, relaxed, *shape)
