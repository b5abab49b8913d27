"""The frames of each sequence in which the methods differ most in their mistakes, and those with most mistakes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from phdtrack.compare.plans import Case, Cell, Run, SequenceFiles
from phdtrack.compare.runs import Comparison, Failed, RunInput, run_input
from phdtrack.compare.store import TRACKS
from phdtrack.errors import InputError
from phdtrack.formats import read_tracks
from phdtrack.metrics.matching import Matches, Scene, build, tracking_mapping
from phdtrack.report.drawing import Mistakes, side_by_side
from phdtrack.types import F8, I8, Image, Tracks, Truth
from phdtrack.video import open_source

MIN_SECONDS_BETWEEN = 1.0
"""Between two frames that are shown of a sequence: neighbours show the same."""


@dataclass(frozen=True, slots=True, eq=False)
class _Scored:
    """A method's tracks under a condition, matched with the truth. ``errors`` (F + 1,) are mistakes by number of frame."""

    method: str
    tracks: Tracks
    scene: Scene
    mapping: Matches
    errors: I8


@dataclass(frozen=True, slots=True, eq=False)
class _Condition:
    """A case at a rate of clutter, at the first seed, with every method's tracks."""

    case: Case
    rate: float
    given: RunInput
    truth: Truth
    scored: Sequence[_Scored]

    @property
    def errors(self) -> I8:
        """(methods, F + 1)."""
        return np.vstack([one.errors for one in self.scored])


@dataclass(frozen=True, slots=True, eq=False)
class WorstFrame:
    """A picture of a frame, what it shows in words, and a name for its file."""

    name: str
    caption: str
    image: Image


def worst_frames(comparison: Comparison, number: int) -> Iterator[WorstFrame]:
    """Of each sequence with truth ``number`` frames in which the methods differ most, and as many with most mistakes."""
    if number < 1:
        return
    sequences = {case.sequence.name: case.sequence for case in comparison.plan.cases}
    for sequence in sequences.values():
        conditions = list(_conditions(comparison, sequence))
        chosen = _chosen(conditions, number)
        pictures = _pictures(sequence, {frame for _, frame, _ in chosen})
        for condition, frame, why in chosen:
            yield _drawn(condition, frame, why, pictures.get(frame), comparison.plan.seeds[0])


def _conditions(comparison: Comparison, sequence: SequenceFiles) -> Iterator[_Condition]:
    plan, seed = comparison.plan, comparison.plan.seeds[0]
    for case in plan.cases:
        detected = comparison.detected.get(case.place)
        if case.sequence.name != sequence.name or sequence.truth is None or isinstance(detected, Failed):
            continue
        for rate in plan.rates:
            cells = [Cell(case, rate, method) for method in plan.methods]
            runs = [Run(cell, seed) for cell in cells if not isinstance(comparison.result(cell, seed), Failed)]
            if not runs:
                continue
            given = run_input(runs[0], detected)
            if given.truth is not None:
                scored = [_scored(comparison, run, given, given.truth) for run in runs]
                yield _Condition(case, rate, given, given.truth, scored)


def _scored(comparison: Comparison, run: Run, given: RunInput, truth: Truth) -> _Scored:
    tracks = read_tracks(comparison.folder / run.place / TRACKS)
    scene = build(truth, tracks, given.info.frames)
    mapping = tracking_mapping(scene, comparison.plan.iou)
    matched = mapping.per_frame(scene)
    switched = np.bincount(mapping.position[mapping.switches()], minlength=len(scene.pairs))
    errors = np.zeros(given.info.frames + 1, np.int64)
    for pair, count in zip(scene.pairs, scene.truth_boxes + scene.output_boxes - 2 * matched + switched, strict=True):
        errors[pair.number] = count
    return _Scored(run.cell.method.name, tracks, scene, mapping, errors)


def _chosen(conditions: Sequence[_Condition], number: int) -> list[tuple[_Condition, int, str]]:
    """Frames with the greatest difference, then those with most mistakes, none of either within a second of another.

    A frame that is both is there once, with both reasons; where mistakes are as many, one that is shown already.
    """
    reasons: dict[tuple[int, int], list[str]] = {}
    for why in ("differ most", "most mistakes"):
        ranked = [
            (-int(value), (i, frame) not in reasons, i, frame)
            for i, condition in enumerate(conditions)
            for frame, value in enumerate(_value(condition.errors, why))
            if value > 0
        ]
        taken: list[tuple[int, int]] = []
        for _, _, i, frame in sorted(ranked):
            if len(taken) == number:
                break
            if all(abs(frame - other) >= MIN_SECONDS_BETWEEN * conditions[i].given.info.fps for _, other in taken):
                taken.append((i, frame))
        for place in taken:
            reasons.setdefault(place, []).append(why)
    return [(conditions[i], frame, ", ".join(why)) for (i, frame), why in reasons.items()]


def _value(errors: I8, why: str) -> I8:
    value: I8 = errors.max(axis=0) - errors.min(axis=0) if why == "differ most" else errors.sum(axis=0)
    return value


def _pictures(sequence: SequenceFiles, numbers: set[int]) -> dict[int, Image]:
    """The frames of these numbers, as far as the source can be read."""
    found: dict[int, Image] = {}
    # Where the source cannot be read the boxes can be seen without the picture.
    with suppress(InputError):
        for frame in open_source(sequence.source) if sequence.source and numbers else ():
            if frame.number in numbers:
                found[frame.number] = frame.image.copy()
            if frame.number >= max(numbers):
                break
    return found


def _drawn(condition: _Condition, frame: int, why: str, image: Image | None, seed: int) -> WorstFrame:
    given, case = condition.given, condition.case
    clutter = f", clutter {condition.rate:g}, seed {seed}" if condition.rate else ""
    heading = f"{case.name}{clutter}, frame {frame}"
    mistakes = [_mistakes(condition.truth, one, frame) for one in condition.scored]
    size = (given.info.width, given.info.height)
    picture = side_by_side(image, size, f"{heading}: {why}", given.table.at(frame).xyxy, mistakes)
    titles = "; ".join(one.title for one in mistakes)
    name = f"{'-'.join(case.place.parts)}-clutter-{condition.rate:g}-frame-{frame}.png"
    return WorstFrame(name, f"{heading} ({why}). {titles}.", picture)


def _mistakes(truth: Truth, one: _Scored, frame: int) -> Mistakes:
    at = next((i for i, pair in enumerate(one.scene.pairs) if pair.number == frame), None)
    if at is None:
        none = np.zeros((0, 4))
        return Mistakes(one.method, none, np.zeros(0, np.int64), np.zeros(0, np.bool_), none, none)
    pair, here = one.scene.pairs[at], one.mapping.position == at
    found = one.scene.output_identity[one.mapping.output[here]]
    missed = one.scene.truth_identity[np.setdiff1d(pair.truth, one.mapping.truth[here])]
    false = one.scene.output_identity[np.setdiff1d(pair.output, one.mapping.output[here])]
    counted = ~truth.distractor
    return Mistakes(
        one.method,
        _boxes(one.tracks.frame, one.tracks.identity, one.tracks.xyxy, frame, found),
        found,
        one.mapping.switches()[here],
        _boxes(truth.frame[counted], truth.identity[counted], truth.xyxy[counted], frame, missed),
        _boxes(one.tracks.frame, one.tracks.identity, one.tracks.xyxy, frame, false),
    )


def _boxes(frames: I8, identities: I8, xyxy: F8, frame: int, wanted: I8) -> F8:
    """(n, 4) the boxes of these identities in a frame."""
    rows = np.flatnonzero(frames == frame)
    place = {int(identities[row]): int(row) for row in rows}
    return xyxy[[place[int(identity)] for identity in wanted]].reshape(-1, 4)


def write_frames(folder: Path, frames: Sequence[WorstFrame]) -> list[Path]:
    """Write the pictures as PNG; where they lie."""
    for frame in frames:
        folder.mkdir(parents=True, exist_ok=True)
        _, data = cv2.imencode(".png", frame.image)
        (folder / frame.name).write_bytes(data.tobytes())
    return [folder / frame.name for frame in frames]
