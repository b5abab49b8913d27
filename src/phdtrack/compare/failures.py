"""The frames of each sequence in which the methods differ most in their mistakes, and those with most mistakes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from phdtrack.compare.plans import Case, Run
from phdtrack.compare.runs import TRACKS, Comparison, Failed, RunInput, run_input
from phdtrack.errors import InputError
from phdtrack.formats import read_tracks
from phdtrack.metrics.matching import build, tracking_mapping
from phdtrack.report.drawing import Mistakes, side_by_side
from phdtrack.types import F8, I8, Image, Tracks
from phdtrack.video import open_source

MIN_SECONDS_BETWEEN = 1.0
"""Between two frames that are shown of a sequence: neighbours show the same."""


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """A case at a rate of clutter, at the first seed: what was given, and for every method the mistakes of each frame from
    number 0."""

    case: Case
    rate: float
    given: RunInput
    mistakes: Sequence[Sequence[Mistakes]]


@dataclass(frozen=True, slots=True, eq=False)
class WorstFrame:
    """A picture of a frame, what it shows in words, and a name for its file."""

    name: str
    caption: str
    image: Image


def worst_frames(comparison: Comparison, number: int) -> Iterator[WorstFrame]:
    """Of each sequence with truth ``number`` frames in which the methods differ most, and as many with most mistakes."""
    for sequence in dict.fromkeys(case.sequence for case in comparison.plan.cases) if number > 0 else ():
        found = list(conditions(comparison, sequence))
        chosen = _chosen(found, number)
        pictures = _pictures(found[0].case.source if found else "", {frame for _, frame, _ in chosen})
        for condition, frame, why in chosen:
            yield _drawn(condition, frame, why, pictures.get(frame), comparison.plan.seeds[0])


def conditions(comparison: Comparison, sequence: str) -> Iterator[Condition]:
    """Every case of a sequence with truth at every rate, as far as there are results."""
    plan, folder = comparison.plan, comparison.folder
    for case in (case for case in plan.cases if case.sequence == sequence and case.truth is not None):
        for rate in plan.rates:
            runs = [Run(case, rate, method, plan.seeds[0]) for method in plan.methods]
            if runs := [run for run in runs if not isinstance(comparison.result(run), Failed)]:
                given = run_input(runs[0], folder)
                tracks = {run.method.name: read_tracks(folder / run.place / TRACKS) for run in runs}
                mistakes = [_mistakes(name, given, rows, plan.iou) for name, rows in tracks.items()]
                yield Condition(case, rate, given, mistakes)


def _mistakes(method: str, given: RunInput, tracks: Tracks, iou: float) -> list[Mistakes]:
    """What is right and wrong in each frame, from number 0."""
    truth, nothing, no_one = given.truth, np.zeros((0, 4)), np.zeros(0, np.int64)
    assert truth is not None
    scene = build(truth, tracks, given.info.frames)
    mapping = tracking_mapping(scene, iou)
    switched, annotated = mapping.switches(), ~truth.distractor
    wanted = _boxes(truth.frame[annotated], truth.identity[annotated], truth.xyxy[annotated])
    found = _boxes(tracks.frame, tracks.identity, tracks.xyxy)
    out = [Mistakes(method, nothing, no_one, no_one.astype(np.bool_), nothing, nothing)] * (given.info.frames + 1)
    for i, pair in enumerate(scene.pairs):
        here = slice(*np.searchsorted(mapping.position, [i, i + 1]))
        right = scene.output_identity[mapping.output[here]]
        missed = scene.truth_identity[np.setdiff1d(pair.truth, mapping.truth[here])]
        false = scene.output_identity[np.setdiff1d(pair.output, mapping.output[here])]
        parts = ((found, right), (wanted, missed), (found, false))
        boxes = [np.array([box[pair.number, who] for who in names.tolist()]).reshape(-1, 4) for box, names in parts]
        out[pair.number] = Mistakes(method, boxes[0], right, switched[here], boxes[1], boxes[2])
    return out


def _boxes(frame: I8, identity: I8, xyxy: F8) -> dict[tuple[int, int], F8]:
    """The box (4,) of an identity in a frame."""
    return dict(zip(zip(frame.tolist(), identity.tolist(), strict=True), xyxy, strict=True))


def _chosen(found: Sequence[Condition], number: int) -> list[tuple[Condition, int, str]]:
    """Frames with the greatest difference, then those with most mistakes, none within a second of another, with the reasons.

    Of frames with as many mistakes one that is shown already comes first.
    """
    reasons: dict[tuple[int, int], list[str]] = {}
    counts = [np.array([[frame.count for frame in frames] for frames in one.mistakes]) for one in found]
    for why, values in (
        ("differ most", [np.ptp(count, axis=0) for count in counts]),
        ("most mistakes", [count.sum(axis=0) for count in counts]),
    ):
        places = [(i, frame) for i, value in enumerate(values) for frame in np.flatnonzero(value > 0).tolist()]
        places.sort(key=lambda place: (-values[place[0]][place[1]], place not in reasons, place))
        taken: list[tuple[int, int]] = []
        for i, frame in places:
            apart = MIN_SECONDS_BETWEEN * found[i].given.info.fps
            if len(taken) < number and all(abs(frame - other) >= apart for _, other in taken):
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


def _drawn(condition: Condition, frame: int, why: str, image: Image | None, seed: int) -> WorstFrame:
    given, case = condition.given, condition.case
    clutter = f", clutter {condition.rate:g}, seed {seed}" if condition.rate else ""
    heading = f"{case.name}{clutter}, frame {frame}"
    mistakes = [frames[frame] for frames in condition.mistakes]
    size = (given.info.width, given.info.height)
    picture = side_by_side(image, size, f"{heading}: {why}", given.table.at(frame).xyxy, mistakes)
    titles = "; ".join(one.title for one in mistakes)
    name = f"{'-'.join(case.place.parts)}-clutter-{condition.rate:g}-frame-{frame}.png"
    return WorstFrame(name, f"{heading} ({why}). {titles}.", picture)


def write_frames(folder: Path, frames: Sequence[WorstFrame]) -> list[Path]:
    """Write the pictures as PNG; where they lie."""
    for frame in frames:
        folder.mkdir(parents=True, exist_ok=True)
        _, data = cv2.imencode(".png", frame.image)
        (folder / frame.name).write_bytes(data.tobytes())
    return [folder / frame.name for frame in frames]
