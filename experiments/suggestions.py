"""Suggestions for labelling: how many of the boxes that the page suggests, and ticks, are false.

Real videos of several kinds with the change detector, as `phdtrack label` reads them. A box is
false if it overlaps by less than 0.3 (IoU) each annotated object, and the box around all those that
lie in it. Where the truth is masks, a box is false if less than a tenth of it moves. Boxes of
frames without truth, or in regions that do not count, are left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.common import ROOT, Options, in_parallel, need_data, table, write
from experiments.video_kinds import SHORT, UNBOXED, KindVideo
from experiments.video_kinds import VIDEOS as VIDEOS_WITH_BOXES
from phdtrack.arrays import intersection, iou
from phdtrack.formats import read_detections, read_truth
from phdtrack.formats.truth import ignoring
from phdtrack.label.samples import shuffled
from phdtrack.label.sequences import open_sequence, suggestions
from phdtrack.label.suggestions import REASONS, TICKED, Suggestion
from phdtrack.run import SourceRequest, TrackingRequest
from phdtrack.run.choices import chosen_settings
from phdtrack.types import F8, I8, DetectionTable, Truth

# Frames drawn at random, as for a person who labels.
DRAWN = 200
# Least overlap with an object, and least share that moves, of a box that is true.
TRUE_OVERLAP = 0.3
TRUE_SHARE = 0.1
# Least share of an object inside a box around several.
INSIDE = 0.5
VIDEOS = tuple(video for video in (*VIDEOS_WITH_BOXES, *UNBOXED) if not video.rendered)


@dataclass(frozen=True, slots=True)
class Precision:
    """Of suggestions on frames with truth, by reason and altogether (``all``): how many were ticked
    or shown, and how many of them are false.
    """

    ticked: Counter[str]
    ticked_false: Counter[str]
    shown: Counter[str]
    shown_false: Counter[str]


def wrong(detections: DetectionTable, video: KindVideo) -> F8:
    """(M,) 1 for a detection that is false, 0 for a true one, and NaN where that is unknown."""
    frames = detections.frame
    if not video.truth:
        return np.where(frames <= video.empty, 1.0, np.nan)
    path = need_data() / video.truth
    if video.masks:
        moving = read_detections(path)
        nobody = np.zeros(len(moving), np.int64)
        truth = Truth(moving.frame, nobody, moving.detections.xyxy, nobody > 0)
    else:
        truth = read_truth(path)
    if video.ignored:
        truth = ignoring(truth, need_data() / video.ignored)
    return wrong_boxes(detections, truth, masks=video.masks)


def wrong_boxes(detections: DetectionTable, truth: Truth, *, masks: bool) -> F8:
    """`wrong` for this truth, of which only frames with objects are annotated."""
    out = np.full(len(detections), np.nan)
    ignored = np.vstack(
        [np.column_stack([truth.frame, truth.xyxy])[truth.distractor], truth.regions]
    )
    for number in np.unique(truth.frame).tolist():
        begin, end = np.searchsorted(detections.frame, [number, number + 1])
        boxes = detections.detections.xyxy[begin:end]
        objects = truth.xyxy[(truth.frame == number) & ~truth.distractor]
        if masks:
            false = _share(boxes, objects) < TRUE_SHARE
        else:
            false = ~_overlaps(boxes, objects)
        region = ignored[(ignored[:, 0] == number) | (ignored[:, 0] == 0), 1:]
        unknown = _share(boxes, region) >= INSIDE
        out[begin:end] = np.where(unknown & false, np.nan, false)
    return out


def _share(boxes: F8, others: F8) -> F8:
    """(n,) the share of each box that others cover, at most 1."""
    area = np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(axis=1), 1e-9)
    covered: F8 = np.minimum(intersection(boxes, others).sum(axis=1) / area, 1.0)
    return covered


def _overlaps(boxes: F8, objects: F8) -> F8:
    """(n,) True for boxes around an object, or around several."""
    good = iou(boxes, objects).max(axis=1, initial=0.0) >= TRUE_OVERLAP
    area = np.maximum((objects[:, 2:] - objects[:, :2]).prod(axis=1), 1e-9)
    inside = intersection(boxes, objects) / area >= INSIDE
    for k in np.flatnonzero(~good & (inside.sum(axis=1) > 1)).tolist():
        group = objects[inside[k]]
        around = np.concatenate([group[:, :2].min(axis=0), group[:, 2:].max(axis=0)])
        good[k] = iou(boxes[k : k + 1], around[None])[0, 0] >= TRUE_OVERLAP
    return good


def precision(found: Sequence[Suggestion], detections: DetectionTable, false: F8) -> Precision:
    """The precision of suggestions.

    Parameters
    ----------
    found, detections : the suggestions, and all detections.
    false : (M,) as of `wrong`.
    """
    counts = Precision(Counter(), Counter(), Counter(), Counter())
    for one in found:
        value = false[np.searchsorted(detections.frame, one.frame) + one.box]
        if np.isnan(value):
            continue
        for name in (one.reason, "all"):
            counts.shown[name] += 1
            counts.shown_false[name] += int(value)
            if one.score >= TICKED:
                counts.ticked[name] += 1
                counts.ticked_false[name] += int(value)
    return counts


def work(job: tuple[KindVideo, Path]) -> Precision:
    """The precision of what `phdtrack label` suggests on a video, in as many frames with truth as a
    person would be shown, at most.
    """
    video, runs = job
    source = SourceRequest(str(need_data() / video.source))
    settings = chosen_settings(TrackingRequest(), (), detector=source.detector_name)
    labels = runs / f"{video.name}.labels.sqlite"
    sequence = open_sequence(source, settings.values("detector"), labels)
    false = wrong(sequence.table, video)
    known = np.unique(sequence.table.frame[~np.isnan(false)])
    drawn: I8 = known[np.array(shuffled(len(known), 0)[:DRAWN], np.int64) - 1]
    kept = labels.with_suffix(".json")
    kept.unlink(missing_ok=True)
    found = suggestions(sequence, settings, drawn.tolist(), kept, lambda share: None)
    return precision(found, sequence.table, false)


def main(options: Options) -> Path:
    """Run everything and write suggestions.md."""
    runs = ROOT / "runs" / ("suggestions-quick" if options.quick else "suggestions")
    runs.mkdir(parents=True, exist_ok=True)
    videos = [video for video in VIDEOS if video.name == SHORT] if options.quick else VIDEOS
    done = in_parallel(work, [(video, runs) for video in videos], "suggestions", options)
    measured = dict(zip(videos, done, strict=True))
    header = ("kind", "video", "ticked", "of them false", *REASONS, "shown", "of them false")
    rows = [[video.kind, video.name, *_cells((one,))] for video, one in measured.items()]
    rows += [["all", "", *_cells(done)]]
    return write(
        "suggestions",
        options,
        kinds=table(("kind", *header[2:]), _by_kind(measured)),
        videos=table(header, rows),
    )


def _by_kind(measured: Mapping[KindVideo, Precision]) -> list[list[object]]:
    """The rows of the kinds of scene."""
    kinds = dict.fromkeys(video.kind for video in measured)
    return [
        [kind, *_cells([one for video, one in measured.items() if video.kind == kind])]
        for kind in kinds
    ]


def _cells(parts: Sequence[Precision]) -> list[object]:
    """Ticked, share of them that is false, ticked by reason, shown, share of them that is false."""
    ticked = sum((one.ticked for one in parts), Counter[str]())
    false = sum((one.ticked_false for one in parts), Counter[str]())
    shown = sum((one.shown for one in parts), Counter[str]())
    shown_false = sum((one.shown_false for one in parts), Counter[str]())
    return [
        ticked["all"],
        _percent(false["all"], ticked["all"]),
        *(f"{false[name]} of {ticked[name]}" for name in REASONS),
        shown["all"],
        _percent(shown_false["all"], shown["all"]),
    ]


def _percent(part: int, whole: int) -> str:
    """A share in percent."""
    return f"{100 * part / whole:.0f} %" if whole else "–"
