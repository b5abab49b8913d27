"""All scores of a sequence, or of several pooled; `counts.py` defines them.

`evaluate` scores one sequence; `pool` adds the sums behind several results and forms the scores
again, which is not the mean of the scores: MODA is the mean over the frames of all sequences,
N_MODA, MOTA, IDF1 and HOTA are pooled as in TrackEval's combined row, OSPA and GOSPA are means over
all frames, SFDA over those with a box; ATA and OSPA2 are those of the concatenated sequences, with
new identities in each.

A score whose denominator is 0 is NaN, never 0 or 1 by convention: MOTA without truth, MOTP without
a mapped pair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import json_value
from phdtrack.metrics.counts import Counts, count
from phdtrack.metrics.matching import check_threshold, pair_frames, ratio
from phdtrack.types import F8, Tracks, Truth


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Scores of a sequence or of several; NaN if undefined. Shares are at most 1, not per cent;
    delays are in frames.

    ``counts`` are the sums and ``iou`` is the threshold of a match; `as_dict` omits both.

    Attributes
    ----------
    MODA, N_MODA : detection accuracy, 1 − (misses + false positives) / truth: mean over the frames
        with truth, and of the sums.
    MODP : mean overlap (IoU) of the pairs of a frame, over the frames that have one.
    MOTA, MOTA_log : tracking accuracy: N_MODA less the identity switches s of each frame per
        annotated box; less ln(1 + s).
    MOTP : mean overlap (IoU) of all pairs.
    IDF1, IDP, IDR : F1, precision and recall of the best mapping of identities for the whole
        sequence.
    HOTA, DetA, AssA : mean over 19 thresholds of overlap, and its parts for detection and
        association.
    OSPA, GOSPA : distances between the sets of boxes, means over the frames.
    OSPA2 : distance between the sets of whole tracks.
    SFDA, ATA : VACE's accuracies of frames and of tracks, without a threshold.
    N_MODA_detection, ATA_matched : N_MODA with the mapping of the largest overlap in each frame;
        ATA with overlaps counted as 1 from the threshold on.
    id_switches, fragments : changes of an object's output identity; interruptions of its mapping.
    misses, false_positives, matches : boxes of the truth without a pair, of the output without one,
        and pairs.
    frames, truth_boxes, output_boxes, truth_objects, output_identities : numbers of them.
    objects_found, mostly_tracked, mostly_lost : objects that are ever mapped, in more than 80 % of
        their frames, in less than 20 %.
    false_tracks : output identities that are never mapped.
    delay_mean : frames from an object's first one to its first pair, mean over those found.
    count_error_mean, count_error_rms : output boxes less annotated ones in a frame: mean, and root
        mean square.
    """

    MODA: float
    N_MODA: float
    MODP: float
    MOTA: float
    MOTA_log: float
    MOTP: float
    IDF1: float
    HOTA: float
    OSPA: float
    GOSPA: float
    OSPA2: float
    SFDA: float
    ATA: float
    id_switches: int
    misses: int
    false_positives: int
    fragments: int
    frames: int
    DetA: float
    AssA: float
    IDP: float
    IDR: float
    N_MODA_detection: float
    ATA_matched: float
    truth_boxes: int
    output_boxes: int
    matches: int
    truth_objects: int
    output_identities: int
    false_tracks: int
    mostly_tracked: int
    mostly_lost: int
    objects_found: int
    delay_mean: float
    count_error_mean: float
    count_error_rms: float
    counts: Counts = field(repr=False)
    iou: float = field(repr=False)

    def as_dict(self) -> dict[str, float | int | None]:
        """The scores by name, for JSON: None in place of NaN."""
        return dict(json_value(self))


def evaluate(
    truth: Truth, tracks: Tracks, *, frames: int = 0, iou: float = 0.5, first: int = 1
) -> Scores:
    """Score ``tracks`` against ``truth``. Raises `InputError` for other types, settings out of
    range, wrong shapes, frame numbers below 1, boxes without finite extent, and an identity twice
    in a frame of either side.

    Parameters
    ----------
    truth : annotated boxes; output matched to distractors is ignored, as in MOT16 and later.
    tracks : output boxes; every row counts, confirmed or not, predicted or not. `Tracks.select`
        chooses among them.
    frames : number of frames of the sequence, later rows are ignored; 0: up to the last frame of
        either side.
    iou : the overlap from which a pair of boxes may match, in (0, 1]; HOTA has its own thresholds.
    first : the first frame that is scored, to score a part of a sequence.

    Returns
    -------
    The scores; shares are at most 1, those that are not defined NaN.
    """
    check_threshold(iou)
    for rows, kind, name in ((truth, Truth, "annotated objects"), (tracks, Tracks, "tracks")):
        if not isinstance(rows, kind):
            raise InputError(
                f"expected {name} as {kind.__name__}, got {type(rows).__name__}",
                where="evaluate",
                cure="Read files with phdtrack.formats.read_truth and read_tracks.",
            )
    return scores_of(count(pair_frames(truth, tracks, frames, first), iou), iou)


def pool(parts: Sequence[Scores]) -> Scores:
    """The scores over several sequences, from their results of `evaluate` or `pool` with the same
    threshold. Raises `InputError` for no results, or results with different thresholds.

    Parameters
    ----------
    parts : the scores of each sequence.

    Returns
    -------
    The pooled scores.
    """
    if not parts:
        raise InputError("expected the scores of at least one sequence, got none")
    iou = parts[0].iou
    different = [part.iou for part in parts if part.iou != iou]
    if different:
        raise InputError(
            f"expected results with the same settings, got IoU {iou} and {different[0]}",
            cure="Evaluate all sequences with the same threshold.",
        )
    sums = (sum(getattr(part.counts, f.name) for part in parts) for f in fields(Counts))
    return scores_of(Counts(*sums), iou)


def hota_per_alpha(counts: Counts) -> tuple[F8, F8, F8]:
    """(19,) each: HOTA_α, DetA_α and AssA_α; NaN if both sides are empty. AssA is 0 if no pair is
    mapped.
    """
    matches = counts.hota_matches
    either = counts.truth_boxes + counts.output_boxes - matches
    det_a = np.divide(matches, either, out=np.full_like(either, np.nan), where=either > 0)
    ass_a = np.where(either > 0, counts.hota_association / np.maximum(1, matches), np.nan)
    return np.sqrt(det_a * ass_a), det_a, ass_a


def scores_of(counts: Counts, iou: float) -> Scores:
    """The scores from the sums ``counts`` at the threshold ``iou`` [M09 (22)–(25)]."""
    c = counts
    boxes = counts.truth_boxes
    tracks = counts.truth_objects + counts.output_identities
    wrong = boxes + c.output_boxes - 2 * c.matches
    hota, det_a, ass_a = (float(part.mean()) for part in hota_per_alpha(c))
    same = {f.name for f in fields(Scores)} & {f.name for f in fields(Counts)}
    return Scores(
        MODA=1 - ratio(c.miss_ratio + c.false_ratio, c.truth_frames),
        N_MODA=1 - ratio(wrong, boxes),
        MODP=ratio(c.precision, c.detected_frames),
        MOTA=1 - ratio(wrong + c.id_switches, boxes),
        MOTA_log=1 - ratio(wrong + c.log_switches, boxes),
        MOTP=ratio(c.overlap, c.matches),
        IDF1=ratio(2 * c.identity_matches, boxes + c.output_boxes),
        HOTA=hota,
        OSPA=ratio(c.ospa, c.frames),
        GOSPA=ratio(c.gospa, c.frames),
        OSPA2=1 - ratio(c.stda, max(c.truth_objects, c.output_identities)),
        SFDA=ratio(c.fda, c.occupied),
        ATA=ratio(2 * c.stda, tracks),
        misses=boxes - c.matches,
        false_positives=c.output_boxes - c.matches,
        DetA=det_a,
        AssA=ass_a,
        IDP=ratio(c.identity_matches, c.output_boxes),
        IDR=ratio(c.identity_matches, boxes),
        N_MODA_detection=1 - ratio(boxes + c.output_boxes - 2 * c.detected, boxes),
        ATA_matched=ratio(2 * c.stda_matched, tracks),
        delay_mean=ratio(c.delay, c.objects_found),
        count_error_mean=ratio(c.count_error, c.frames),
        count_error_rms=math.sqrt(ratio(c.count_error_squared, c.frames)),
        counts=c,
        iou=iou,
        **{name: getattr(c, name) for name in same},
    )
