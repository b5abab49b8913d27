"""All scores of a sequence, or of several pooled. The modules beside this one say what each means and on which mapping.

`evaluate` scores one sequence; `pool` adds the sums behind several such results and forms the scores again, which is not
the mean of the scores: MODA is the mean over the frames of all sequences, N_MODA, MOTA, IDF1 and HOTA are pooled as in
TrackEval's combined row, OSPA and GOSPA are means over all frames, SFDA over those that hold a box; ATA and OSPA2 are those
of the sequences one after the other, with new identities in each.

A score whose denominator is empty is NaN, never 0 or 1 by convention: MOTA without truth, MOTP without a mapped pair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

from phdtrack.errors import InputError
from phdtrack.metrics.clear import (
    DetectionCounts,
    TrackCounts,
    TrackingCounts,
    count_detections,
    count_tracking,
    count_whole_tracks,
)
from phdtrack.metrics.identity import HotaCounts, IdentityCounts, count_hota, count_identities
from phdtrack.metrics.lifetimes import LifetimeCounts, check_threshold, count_lifetimes
from phdtrack.metrics.matching import Scene, build, detection_mapping, ratio, total, tracking_mapping
from phdtrack.metrics.sets import SetCounts, count_sets
from phdtrack.types import Tracks, Truth


@dataclass(frozen=True, slots=True)
class Settings:
    """``iou``: the overlap that makes a match (HOTA has its own); c_m and c_f, the costs in MODA, N_MODA and MOTA."""

    iou: float = 0.5
    miss_cost: float = 1.0
    false_positive_cost: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Counts:
    """The sums behind all scores, each with its meaning in its own module. `total` adds them."""

    detections: DetectionCounts
    tracking: TrackingCounts
    identities: IdentityCounts
    hota: HotaCounts
    sets: SetCounts
    lifetimes: LifetimeCounts
    tracks: TrackCounts


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Scores of a sequence or of several; NaN where undefined. Shares are at most 1, not per cent; delays are in frames.

    ``counts`` and ``settings`` are what they were made of; `as_dict` leaves them out.
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
    settings: Settings = field(repr=False)

    def as_dict(self) -> dict[str, float | int | None]:
        """The scores by name, for JSON: None in place of NaN."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("counts", "settings")}
        return {name: None if math.isnan(value) else value for name, value in values.items()}


def evaluate(
    truth: Truth,
    tracks: Tracks,
    *,
    frames: int = 0,
    iou: float = 0.5,
    miss_cost: float = 1.0,
    false_positive_cost: float = 1.0,
) -> Scores:
    """Score ``tracks`` against ``truth``.

    Parameters
    ----------
    truth : annotated boxes; output matched to its distractors counts neither for nor against, as in MOT16 and later.
    tracks : every row counts, confirmed or not, predicted or not. `Tracks.take` chooses among them.
    frames : number of frames of the sequence, rows after it are left out; 0: up to the last frame of either side.
    iou : the overlap from which a pair of boxes may match, in (0, 1]; pixels do not matter.
    miss_cost, false_positive_cost : c_m and c_f ≥ 0 in MODA, N_MODA, MOTA and MOTA_log.

    Raises
    ------
    InputError : for settings out of range, wrong shapes, frame numbers below 1, boxes without finite extent, or an
        identity twice in a frame of either side.
    """
    check_threshold(iou)
    for name, cost in (("miss_cost", miss_cost), ("false_positive_cost", false_positive_cost)):
        if not 0 <= cost < math.inf:
            raise InputError(f"expected a finite cost ≥ 0, got {cost}", where=name)
    settings = Settings(iou, miss_cost, false_positive_cost)
    return scores_of(count(build(truth, tracks, frames), iou), settings)


def count(scene: Scene, iou: float) -> Counts:
    """The sums of one sequence."""
    tracking = tracking_mapping(scene, iou)
    return Counts(
        detections=count_detections(scene, detection_mapping(scene, iou)),
        tracking=count_tracking(scene, tracking),
        identities=count_identities(scene, iou),
        hota=count_hota(scene),
        sets=count_sets(scene),
        lifetimes=count_lifetimes(scene, tracking),
        tracks=count_whole_tracks(scene, iou),
    )


def pool(parts: Sequence[Scores]) -> Scores:
    """The scores over several sequences, each one's result of `evaluate` (or of `pool`) with the same settings.

    Raises
    ------
    InputError : for no results, or results with different settings.
    """
    if not parts:
        raise InputError("expected the scores of at least one sequence, got none")
    different = [part.settings for part in parts if part.settings != parts[0].settings]
    if different:
        raise InputError(
            f"expected results with the same settings, got {parts[0].settings} and {different[0]}",
            cure="Evaluate all sequences with the same threshold and costs.",
        )
    return scores_of(total([part.counts for part in parts]), parts[0].settings)


def scores_of(counts: Counts, settings: Settings) -> Scores:
    """The scores that follow from ``counts`` [M09 (22)–(25)]."""
    boxes, tracking, names, sets = counts.detections, counts.tracking, counts.identities, counts.sets
    tracks, lives = counts.tracks, counts.lifetimes
    miss, false = settings.miss_cost, settings.false_positive_cost
    n_moda = 1 - ratio(miss * tracking.misses + false * tracking.false_positives, tracking.truth_boxes)
    hota, det_a, ass_a = (float(part.mean()) for part in counts.hota.per_alpha())
    return Scores(
        MODA=1 - ratio(miss * boxes.miss_ratio + false * boxes.false_ratio, boxes.truth_frames),
        N_MODA=n_moda,
        MODP=ratio(boxes.precision, boxes.mapped_frames),
        MOTA=n_moda - ratio(tracking.switches, tracking.truth_boxes),
        MOTA_log=n_moda - ratio(tracking.log_switches, tracking.truth_boxes),
        MOTP=ratio(tracking.overlap, tracking.matches),
        IDF1=ratio(2 * names.true_positives, names.truth_boxes + names.output_boxes),
        HOTA=hota,
        OSPA=ratio(sets.ospa_sum, sets.frames),
        GOSPA=ratio(sets.gospa_sum, sets.frames),
        OSPA2=1 - ratio(tracks.stda, max(tracks.objects, tracks.identities)),
        SFDA=ratio(sets.fda_sum, sets.occupied),
        ATA=ratio(2 * tracks.stda, tracks.objects + tracks.identities),
        id_switches=tracking.switches,
        misses=tracking.misses,
        false_positives=tracking.false_positives,
        fragments=tracking.fragments,
        frames=sets.frames,
        DetA=det_a,
        AssA=ass_a,
        IDP=ratio(names.true_positives, names.output_boxes),
        IDR=ratio(names.true_positives, names.truth_boxes),
        N_MODA_detection=1 - ratio(miss * boxes.misses + false * boxes.false_positives, boxes.truth_boxes),
        ATA_matched=ratio(2 * tracks.matched, tracks.objects + tracks.identities),
        truth_boxes=tracking.truth_boxes,
        output_boxes=names.output_boxes,
        matches=tracking.matches,
        truth_objects=lives.objects,
        output_identities=lives.identities,
        false_tracks=lives.false_tracks,
        mostly_tracked=lives.mostly_tracked,
        mostly_lost=lives.mostly_lost,
        objects_found=lives.found,
        delay_mean=ratio(lives.delay, lives.found),
        count_error_mean=ratio(sets.count_error, sets.frames),
        count_error_rms=math.sqrt(ratio(sets.count_error_squared, sets.frames)),
        counts=counts,
        settings=settings,
    )
