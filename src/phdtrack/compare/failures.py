"""The frames of each sequence in which the methods differ most in their mistakes, and those with most mistakes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from phdtrack.arrays import pixelated
from phdtrack.compare.plans import Case, Run
from phdtrack.compare.runs import TRACKS, Comparison, RunInput, run_input
from phdtrack.errors import InputError
from phdtrack.formats import read_tracks
from phdtrack.metrics.matching import build, tracking_mapping
from phdtrack.parallel import Failed
from phdtrack.report.drawing import FALSE, MISSED, RIGHT, SWITCHED, Mistakes, side_by_side
from phdtrack.types import Image, Tracks
from phdtrack.video import open_source

# Between two frames that are shown of a sequence: neighbours show the same.
_MIN_SECONDS_BETWEEN = 1.0


Condition = tuple[Case, float, RunInput, Mapping[str, Mistakes]]
"""A case, a rate of clutter, what was given at the first seed, and every method's mistakes in all frames."""


class WorstFrame(NamedTuple):
    """A picture of a frame, what it shows in words, and a name for its file."""

    name: str
    caption: str
    image: Image


def worst_frames(comparison: Comparison, number: int, blur: str = "") -> Iterator[WorstFrame]:
    """Frames that show where methods go wrong.

    Parameters
    ----------
    comparison : with its results.
    number : of frames of each sequence with truth in which the methods differ most, and as many with most mistakes.
    blur : what is hidden of the boxes of detections, tracks and truth (`arrays.pixelated`).
    """
    for sequence in dict.fromkeys(case.sequence for case in comparison.plan.cases) if number > 0 else ():
        found = list(conditions(comparison, sequence))
        chosen = _chosen(found, number)
        pictures = _pictures(found[0][0].source if found else "", {frame for _, frame, _ in chosen})
        for (case, rate, given, mistakes), frame, why in chosen:
            clutter = f", clutter {rate:g}, seed {comparison.plan.seeds[0]}" if rate else ""
            heading = f"{case.name}{clutter}, frame {frame}"
            size, here = (given.info.width, given.info.height), {name: rows.at(frame) for name, rows in mistakes.items()}
            boxes = given.table.at(frame).xyxy
            image = pictures.get(frame)
            if image is not None:
                image = pixelated(image, np.vstack([boxes, *(rows.xyxy for rows in here.values())]), blur)
            picture = side_by_side(image, size, f"{heading}: {why}", boxes, here)
            caption = "; ".join(f"{name}: {rows}" for name, rows in here.items())
            name = f"{'-'.join(case.place.parts)}-clutter-{rate:g}-frame-{frame}.png"
            yield WorstFrame(name, f"{heading} ({why}). {caption}.", picture)


def conditions(comparison: Comparison, sequence: str) -> Iterator[Condition]:
    """Every case of a sequence with truth at every rate, as far as there are results."""
    plan, folder = comparison.plan, comparison.folder
    for case in (case for case in plan.cases if case.sequence == sequence and case.truth is not None):
        for rate in plan.rates:
            runs = [Run(case, rate, method, plan.seeds[0]) for method in plan.methods]
            if runs := [run for run in runs if not isinstance(comparison.result(run), Failed)]:
                given = run_input(runs[0], folder)
                tracks = {run.method.name: read_tracks(folder / run.place / TRACKS) for run in runs}
                mistakes = {name: _mistakes(given, rows, plan.iou) for name, rows in tracks.items()}
                yield case, rate, given, mistakes


def _mistakes(given: RunInput, tracks: Tracks, iou: float) -> Mistakes:
    """What is right and wrong in all frames."""
    truth = given.truth
    assert truth is not None
    scene = build(truth, tracks, given.info.frames)
    mapping = tracking_mapping(scene, iou)
    # By frame and identity, first as if nothing were mapped.
    of_tracks, of_truth = dict[tuple[int, int], int](), dict[tuple[int, int], int]()
    for pair in scene.pairs:
        of_tracks |= {(pair.number, who): FALSE for who in scene.output_identity[pair.output].tolist()}
        of_truth |= {(pair.number, who): MISSED for who in scene.truth_identity[pair.truth].tolist()}
    outputs, objects = scene.output_identity[mapping.output], scene.truth_identity[mapping.truth]
    pairs = zip(mapping.position.tolist(), outputs.tolist(), objects.tolist(), mapping.switches().tolist(), strict=True)
    for position, output, target, switched in pairs:
        number = scene.pairs[position].number
        of_tracks[number, output] = SWITCHED if switched else RIGHT
        del of_truth[number, target]
    parts = []
    for rows, kinds in ((tracks, of_tracks), (truth, of_truth)):
        keys = list(zip(rows.frame.tolist(), rows.identity.tolist(), strict=True))
        kept = [k for k, key in enumerate(keys) if key in kinds]
        kind = np.array([kinds[keys[k]] for k in kept], np.int64)
        parts.append(Mistakes(rows.frame[kept], rows.identity[kept], kind, rows.xyxy[kept]))
    return Mistakes(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _chosen(found: Sequence[Condition], number: int) -> list[tuple[Condition, int, str]]:
    """Frames with the greatest difference, then those with most mistakes, none within a second of another, with the reasons.

    Of frames with as many mistakes one that is shown already comes first.
    """
    reasons: dict[tuple[int, int], list[str]] = {}
    apart = [_MIN_SECONDS_BETWEEN * given.info.fps for _, _, given, _ in found]
    numbers = [np.unique(np.concatenate([rows.frame for rows in each.values()])) for *_, each in found]
    counts = [
        np.array([rows.counts(known) for rows in each.values()]) for known, (*_, each) in zip(numbers, found, strict=True)
    ]
    for why, values in (
        ("differ most", [np.ptp(count, axis=0) for count in counts]),
        ("most mistakes", [count.sum(axis=0) for count in counts]),
    ):
        worth = {(i, int(numbers[i][k])): value[k] for i, value in enumerate(values) for k in np.flatnonzero(value > 0)}
        places = sorted(worth, key=lambda place: (-worth[place], place not in reasons, place))
        taken: list[tuple[int, int]] = []
        for i, frame in places:
            if len(taken) < number and all(abs(frame - other) >= apart[i] for _, other in taken):
                taken.append((i, frame))
        for place in taken:
            reasons.setdefault(place, []).append(why)
    return [(found[i], frame, ", ".join(why)) for (i, frame), why in reasons.items()]


def _pictures(source: str, numbers: set[int]) -> dict[int, Image]:
    """The frames of these numbers, as far as the source can be read."""
    found: dict[int, Image] = {}
    # Where the source cannot be read the boxes can be seen without the picture.
    with suppress(InputError):
        for frame in open_source(source) if source and numbers else ():
            if frame.number in numbers:
                found[frame.number] = frame.image.copy()
            if frame.number >= max(numbers):
                break
    return found


def write_frames(folder: Path, frames: Sequence[WorstFrame]) -> None:
    """Write the pictures as PNG."""
    for frame in frames:
        folder.mkdir(parents=True, exist_ok=True)
        _, data = cv2.imencode(".png", frame.image)
        (folder / frame.name).write_bytes(data.tobytes())
