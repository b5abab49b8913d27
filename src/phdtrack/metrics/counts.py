"""The sums behind all scores of a sequence. Sequences are pooled by adding their sums; `scores.py`
forms the quotients.

VACE and CLEAR [M07 Table 1; M09 (22)–(25)], with m_k misses, f_k false positives, s_k identity
switches and N_k annotated boxes of frame k, and costs of 1:

    MODP(k)  = Σ IoU of the mapped pairs / N_mapped     averaged over frames that have a mapped pair
    MODA(k)  = 1 − (m_k + f_k) / N_k                    averaged over frames that have truth
    N_MODA   = 1 − Σ_k (m_k + f_k) / Σ_k N_k            pooled, with false positives of all frames
    MOTP     = Σ IoU over all mapped pairs / their number
    MOTA     = 1 − Σ_k (m_k + f_k + s_k) / Σ_k N_k
    MOTA_log = the same with ln(1 + s_k) in place of s_k

MODA(k) and MODP(k) use the detection mapping, the one with the largest total overlap in each frame;
everything else uses the tracking mapping (`matching.py`). N_MODA, MOTA, MOTP, switches and
fragments are TrackEval's MODA, MOTA, MOTP, IDSW and Frag. A switch: an object is mapped to another
output than when it was last mapped, however long ago. A fragment: the mapping of an object resumes
after a break. The delay of an object: frames from its first in the truth to its first mapped one. A
false track: an output identity that is never mapped. Mostly tracked: mapped in more than 80 % of
its frames; mostly lost: in less than 20 % (as in TrackEval).

The other sums are defined in `identity.py`, `hota.py` and `sets.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.metrics.hota import hota_sums
from phdtrack.metrics.identity import identity_pairs, largest_total
from phdtrack.metrics.matching import Matches, SequencePair, above, match, tracking_mapping
from phdtrack.metrics.sets import set_distances
from phdtrack.types import F8


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
    id_switches, log_switches, fragments : of that mapping; log_switches is Σ_k ln(1 + s_k).
    objects_found, delay : objects that are ever mapped, and the sum of their delays.
    mostly_tracked, mostly_lost, false_tracks : numbers of objects and of output identities.
    identity_matches : IDTP.
    stda, stda_matched : STDA and its relaxed form.
    hota_matches, hota_association : (19,) mapped pairs at each α, and Σ A(c) over them.
    ospa, gospa, fda, count_error, count_error_squared : sums over frames; the count error is
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


def count(sequence: SequencePair, threshold: float) -> Counts:
    """The sums of one sequence; pairs of boxes match at IoU ≥ ``threshold``."""
    detection = match(sequence, lambda pair, _: above(pair.iou, threshold))
    tracking = tracking_mapping(sequence, threshold)
    pairs = identity_pairs(sequence, threshold)
    truth, output = sequence.boxes
    detected = np.bincount(detection.position, minlength=len(truth))
    annotated = truth > 0
    mapped = detected > 0
    iou = np.bincount(detection.position, detection.iou, minlength=len(truth))
    switched = np.bincount(tracking.position[tracking.switches()], minlength=1)
    first = tracking.first_frames(sequence)
    share = np.bincount(tracking.truth, minlength=len(first)) / pairs.truth_boxes
    union = pairs.truth_boxes[:, None] + pairs.output_boxes - pairs.both
    hota_matches, hota_association = hota_sums(sequence, pairs)
    ospa, gospa, fda = set_distances(sequence)
    return Counts(
        frames=sequence.frames,
        occupied=len(sequence.pairs),
        truth_frames=int(annotated.sum()),
        truth_boxes=int(truth.sum()),
        output_boxes=int(output.sum()),
        truth_objects=len(first),
        output_identities=len(sequence.output_identity),
        detected=len(detection.iou),
        detected_frames=int(mapped.sum()),
        miss_ratio=float(((truth - detected)[annotated] / truth[annotated]).sum()),
        false_ratio=float(((output - detected)[annotated] / truth[annotated]).sum()),
        precision=float((iou[mapped] / detected[mapped]).sum()),
        matches=len(tracking.iou),
        overlap=float(tracking.iou.sum()),
        id_switches=int(switched.sum()),
        log_switches=float(np.log1p(switched).sum()),
        fragments=_fragments(sequence, tracking),
        objects_found=int((first > 0).sum()),
        delay=int((first - pairs.first_frame)[first > 0].sum()),
        mostly_tracked=int((share > 0.8).sum()),
        mostly_lost=int((share < 0.2).sum()),
        false_tracks=len(sequence.output_identity) - len(np.unique(tracking.output)),
        identity_matches=int(largest_total(pairs.matched)),
        stda=largest_total(pairs.overlap / union),
        stda_matched=largest_total(pairs.matched / union),
        hota_matches=hota_matches,
        hota_association=hota_association,
        ospa=ospa,
        gospa=gospa,
        fda=fda,
        count_error=int((output - truth).sum()),
        count_error_squared=int(np.square(output - truth).sum()),
    )


def _fragments(sequence: SequencePair, mapping: Matches) -> int:
    """The number of times that the mapping of an object resumes after a break."""
    # As in TrackEval, a frame with an empty side does not break a mapping: such frames are not
    # counted in `turn`.
    turn = np.cumsum(sequence.boxes.all(axis=0))
    order, again = mapping.histories()
    return int((again & (np.diff(turn[mapping.position[order]]) > 1)).sum())
