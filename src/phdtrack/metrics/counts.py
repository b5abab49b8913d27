"""The sums behind all scores of a sequence. Sequences are pooled by adding their sums; `scores.py`
forms quotients last.

VACE and CLEAR [M07 Table 1; M09 (22)–(25)], with m_k misses, f_k false positives, s_k identity
switches and N_k annotated boxes of frame k, and costs of 1:

    MODP(k) = Σ IoU of the mapped pairs / N_mapped              averaged over the frames that have a
    mapped pair MODA(k) = 1 − (m_k + f_k) / N_k                             averaged over the frames
    that have truth N_MODA  = 1 − Σ_k (m_k + f_k) / Σ_k N_k                     pooled; false
    positives of frames without truth count MOTP    = Σ IoU over all mapped pairs / their number
    MOTA    = 1 − Σ_k (m_k + f_k + s_k) / Σ_k N_k               MOTA_log: ln(1 + s_k) in place of
    s_k

MODA(k) and MODP(k) use the detection mapping, the largest total overlap of each frame for itself;
everything else uses the tracking mapping (`matching.py`). N_MODA, MOTA, MOTP, switches and
fragments are TrackEval's MODA, MOTA, MOTP, IDSW and Frag. A switch: an object is mapped to another
output than when it was last mapped, however long ago. A fragment: the mapping of an object begins
again after a break. The delay of an object: frames from its first in the truth to its first mapped
one. A false track: an output identity that is never mapped. Mostly tracked: mapped in more than 80
% of its frames; mostly lost: in less than 20 % (as in TrackEval).

VACE without a threshold (Kasturi et al. 2009): FDA maps boxes of one frame, STDA tracks of the
whole sequence, one to one, each for the largest sum.

    FDA(k) = Σ_mapped IoU / ((N_G(k) + N_D(k)) / 2)         SFDA = mean of FDA(k) over the frames
    with a box on either side STDA   = Σ_mapped [ Σ_k IoU_k(G_i, D_i) / N_(G_i ∪ D_i) ]     ATA =
    STDA / ((N_G + N_D) / 2)

N_(G ∪ D) is the number of frames in which the object, its track, or both are present. ATA_matched
has TrackEval's relaxed STDA, which counts frames at IoU ≥ threshold as 1 and others as 0. OSPA(2)
of whole tracks, c = p = q = 1, is 1 − STDA / max(N_G, N_D).

IDF1 (Ristani et al. 2016; TrackEval's Identity): one mapping of identities for the whole sequence,

    IDTP = max over one-to-one mappings of identities of Σ (frames in which the two overlap at IoU ≥
    threshold) IDF1 = 2 IDTP / (annotated boxes + output boxes)

HOTA (Luiten et al. 2021; TrackEval's HOTA): for each threshold α in 0.05, 0.10, …, 0.95, then
averaged over them,

    DetA_α = TP / (TP + FN + FP)        AssA_α = 1/TP Σ_{c ∈ TP} A(c)        HOTA_α = √(DetA_α
    AssA_α)

where for a mapped pair c of identities (i, j) A(c) = TPA / (TPA + FNA + FPA): TPA counts the frames
in which i is mapped to j, FNA and FPA the other boxes of i and of j. The mapping in a frame has the
largest Σ J(i, j)·IoU, where the alignment J rewards identities that agree over the whole sequence;
it is one mapping for all α:

    J(i, j) = Σ_k a / (|i| + |j| − Σ_k a)        a = IoU / (Σ_row IoU + Σ_column IoU − IoU)

OSPA (Schuhmacher, Vo, Vo 2008) and GOSPA (Rahmathullah et al. 2017: not divided by the larger
number of boxes, with c^p/α for a box too many) have the base distance 1 − IoU, c = 1, p = 1, α = 2.
They are averaged over all frames of the sequence, in which a frame that is empty on both sides
counts 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.metrics.matching import (
    ROUNDING,
    Matches,
    Scene,
    above,
    assign,
    match,
    tracking_mapping,
)
from phdtrack.types import F8, I8

ALPHA: F8 = np.arange(0.05, 0.99, 0.05)


@dataclass(frozen=True, slots=True, eq=False)
class Counts:
    """Sums of one sequence or of several.

    Attributes
    ----------
    frames, occupied, truth_frames : all frames, those with a box on either side, those with an
        annotated box.
    truth_boxes, output_boxes, truth_objects, output_identities : boxes and identities on either
        side.
    detected, detected_frames : mapped pairs of the detection mapping, and the frames that have one.
    miss_ratio, false_ratio : Σ m_k/N_k and Σ f_k/N_k of that mapping over the frames with truth.
    precision : Σ MODP(k) over the frames with a mapped pair.
    matches, overlap : mapped pairs of the tracking mapping and the sum of their IoU.
    id_switches, log_switches, fragments : of that mapping; Σ_k ln(1 + s_k).
    objects_found, delay, mostly_tracked, mostly_lost, false_tracks : objects ever mapped, Σ of
    their delays, numbers.
    identity_matches : IDTP.
    stda, stda_matched : STDA and its relaxed form.
    hota_matches, hota_association : (19,) mapped pairs at each α, and Σ A(c) over them.
    ospa, gospa, fda, count_error, count_error_squared : sums over frames; the error of the count is
        output − truth.
    """

    frames: int
    occupied: int
    truth_frames: int
    truth_boxes: int
    output_boxes: int
    truth_objects: int
    output_identities: int
    detected: int
    detected_frames: int
    miss_ratio: float
    false_ratio: float
    precision: float
    matches: int
    overlap: float
    id_switches: int
    log_switches: float
    fragments: int
    objects_found: int
    delay: int
    mostly_tracked: int
    mostly_lost: int
    false_tracks: int
    identity_matches: int
    stda: float
    stda_matched: float
    hota_matches: F8
    hota_association: F8
    ospa: float
    gospa: float
    fda: float
    count_error: int
    count_error_squared: int


class _Pairs(NamedTuple):
    """Sums for each pair of identities (G, O): of IoU, of frames at IoU ≥ threshold, of frames with
    both, of the a of J.

    ``truth_boxes`` (G,), ``output_boxes`` (O,) are the boxes of each identity, ``appeared`` (G,)
    the first frame.
    """

    overlap: F8
    matched: F8
    both: F8
    shared: F8
    truth_boxes: I8
    output_boxes: I8
    appeared: I8


def count(scene: Scene, threshold: float) -> Counts:
    """The sums of one sequence; pairs of boxes match at IoU ≥ ``threshold``."""
    detection = match(scene, lambda pair, _: above(pair.iou, threshold))
    tracking = tracking_mapping(scene, threshold)
    pairs = _pairs(scene, threshold)
    truth, output = scene.boxes
    detected = np.bincount(detection.position, minlength=len(truth))
    annotated = truth > 0
    mapped = detected > 0
    iou = np.bincount(detection.position, detection.iou, minlength=len(truth))
    switched = np.bincount(tracking.position[tracking.switches()], minlength=1)
    first = tracking.first_frames(scene)
    share = np.bincount(tracking.truth, minlength=len(first)) / pairs.truth_boxes
    union = pairs.truth_boxes[:, None] + pairs.output_boxes - pairs.both
    hota_matches, hota_association = _hota(scene, pairs)
    ospa, gospa, fda = _sets(scene)
    return Counts(
        frames=scene.frames,
        occupied=len(scene.pairs),
        truth_frames=int(annotated.sum()),
        truth_boxes=int(truth.sum()),
        output_boxes=int(output.sum()),
        truth_objects=len(first),
        output_identities=len(scene.output_identity),
        detected=len(detection.iou),
        detected_frames=int(mapped.sum()),
        miss_ratio=float(((truth - detected)[annotated] / truth[annotated]).sum()),
        false_ratio=float(((output - detected)[annotated] / truth[annotated]).sum()),
        precision=float((iou[mapped] / detected[mapped]).sum()),
        matches=len(tracking.iou),
        overlap=float(tracking.iou.sum()),
        id_switches=int(switched.sum()),
        log_switches=float(np.log1p(switched).sum()),
        fragments=_fragments(scene, tracking),
        objects_found=int((first > 0).sum()),
        delay=int((first - pairs.appeared)[first > 0].sum()),
        mostly_tracked=int((share > 0.8).sum()),
        mostly_lost=int((share < 0.2).sum()),
        false_tracks=len(scene.output_identity) - len(np.unique(tracking.output)),
        identity_matches=int(_largest(pairs.matched)),
        stda=_largest(pairs.overlap / union),
        stda_matched=_largest(pairs.matched / union),
        hota_matches=hota_matches,
        hota_association=hota_association,
        ospa=ospa,
        gospa=gospa,
        fda=fda,
        count_error=int((output - truth).sum()),
        count_error_squared=int(np.square(output - truth).sum()),
    )


def _pairs(scene: Scene, threshold: float) -> _Pairs:
    """The sums for pairs of identities."""
    shape = len(scene.truth_identity), len(scene.output_identity)
    overlap, matched, both, shared = (np.zeros(shape) for _ in range(4))
    truth_boxes, output_boxes, appeared = (np.zeros(shape[side], np.int64) for side in (0, 1, 0))
    for pair in reversed(scene.pairs):
        where = np.ix_(pair.truth, pair.output)
        rivals = pair.iou.sum(axis=0) + pair.iou.sum(axis=1)[:, None] - pair.iou
        overlap[where] += pair.iou
        # Without the rounding that the other scores allow: TrackEval has none here.
        matched[where] += pair.iou >= threshold
        both[where] += 1
        shared[where] += np.divide(
            pair.iou, rivals, out=np.zeros_like(rivals), where=rivals > ROUNDING
        )
        truth_boxes[pair.truth] += 1
        output_boxes[pair.output] += 1
        appeared[pair.truth] = pair.number
    return _Pairs(overlap, matched, both, shared, truth_boxes, output_boxes, appeared)


def _largest(score: F8) -> float:
    """The largest total of a one-to-one mapping."""
    return float(score[assign(score)].sum())


def _fragments(scene: Scene, mapping: Matches) -> int:
    """How often the mapping of an object begins again."""
    # As in TrackEval, a frame with an empty side does not break a mapping: time is counted without
    # such frames.
    turn = np.cumsum(scene.boxes.all(axis=0))
    order, again = mapping.histories()
    return int((again & (np.diff(turn[mapping.position[order]]) > 1)).sum())


def _hota(scene: Scene, pairs: _Pairs) -> tuple[F8, F8]:
    """(19,) number of mapped pairs at each α, and Σ A(c) over them."""
    aligned = pairs.shared / (pairs.truth_boxes[:, None] + pairs.output_boxes - pairs.shared)
    mapping = match(scene, lambda pair, _: aligned[np.ix_(pair.truth, pair.output)] * pair.iou)
    # Only pairs of identities that are mapped are kept: a dense table would hold G·O·19 numbers.
    code = mapping.truth * max(len(pairs.output_boxes), 1) + mapping.output
    _, first, which = np.unique(code, return_index=True, return_inverse=True)
    boxes = pairs.truth_boxes[mapping.truth[first]] + pairs.output_boxes[mapping.output[first]]
    found = np.zeros(len(ALPHA))
    association = np.zeros(len(ALPHA))
    for a, alpha in enumerate(ALPHA):
        together = np.bincount(which[mapping.iou >= alpha - ROUNDING], minlength=len(first))
        found[a] = together.sum()
        association[a] = (together * together / np.maximum(1, boxes - together)).sum()
    return found, association


def _sets(scene: Scene) -> tuple[float, float, float]:
    """Σ over frames of OSPA, of GOSPA and of FDA."""
    ospa = gospa = fda = 0.0
    for pair in scene.pairs:
        n, m = pair.iou.shape
        # With distance 1 − IoU the cheapest mapping is the one with most overlap, and serves all
        # three.
        overlap = _largest(pair.iou)
        least = min(n, m) - overlap
        ospa += (least + abs(n - m)) / max(n, m)
        gospa += least + abs(n - m) / 2
        fda += 2 * overlap / (n + m)
    return ospa, gospa, fda
