"""``phdtrack evaluate``: scores of a file of tracks against annotated objects; tables of scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import typer

from phdtrack.cli import options as given
from phdtrack.cli.options import option
from phdtrack.cli.output import Output, number
from phdtrack.errors import InputError
from phdtrack.formats import Conventions, read_detections
from phdtrack.metrics import (
    Errors,
    IdentityError,
    Scores,
    explain,
    rmse_per_target,
    tgospa_boxes,
)
from phdtrack.metrics import evaluate as score
from phdtrack.metrics.causes import FALSE, PLACES
from phdtrack.metrics.labelled import detections_in_frames
from phdtrack.report.pages import score_meanings
from phdtrack.run import directory as rundir
from phdtrack.run.requests import ReadingRequest, frame_size, refuse
from phdtrack.run.scored_files import (
    ScoredFiles,
    ScoringRequest,
    read_scored,
    read_scored_by_class,
)
from phdtrack.types import I8, Tracks, Truth

# The scores that a table shows, in its order: keys of `Scores.as_dict`.
SHOWN = """
MODA N_MODA MODP MOTA MOTA_log MOTP IDF1 HOTA OSPA GOSPA OSPA2 SFDA ATA id_switches misses
false_positives fragments false_tracks delay_mean frames
"""
WORST = 5
BY_TRAJECTORY = (
    "TGOSPA",
    "TGOSPA_localisation",
    "TGOSPA_missed",
    "TGOSPA_false",
    "TGOSPA_switching",
)


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """Regions and classes that count, and reports of errors."""

    ignore: Annotated[
        Path | None, option("FILE", "Regions that do not count: CSV frame,x,y,w,h. No frame: all.")
    ] = None
    kitti: Annotated[str, option("TYPE", "Type of KITTI label files to score, as Car.")] = ""
    per_class: Annotated[bool, typer.Option("--per-class", help="Score each class on its own.")] = (
        False
    )
    errors: Annotated[
        bool,
        typer.Option("--errors", help="List misses, false boxes and swaps by cause."),
    ] = False
    detections: Annotated[
        Path | None, option("FILE", "For --errors: the detections that were tracked.")
    ] = None
    worst: Annotated[
        int, option("N", "For --errors: how many objects and tracks are named.", min=0)
    ] = WORST
    reading: ReadingRequest = field(default_factory=ReadingRequest)
    frame_size: given.FrameSize = ""
    labelled: given.Labelled = ""
    max_file_size: given.MaxFileSize = ""


def evaluate(
    truth: Annotated[
        Path, option("FILE", "Annotated objects: MOTChallenge's gt.txt, CSV, XML and others.")
    ],
    tracks: Annotated[
        Path, option("FILE", "Tracks to score: MOTChallenge, CSV, others, or a run's directory.")
    ],
    output: Output,
    asked: EvaluateOptions,
    iou: given.Iou = 0.5,
    frames: Annotated[
        int,
        option(
            "N", "Number of frames. Default: that of seqinfo.ini, or up to the last box.", min=0
        ),
    ] = 0,
    t_gospa: Annotated[
        bool, typer.Option("--t-gospa", help="T-GOSPA, too: takes seconds to minutes.")
    ] = False,
    rmse: Annotated[
        float,
        option(
            "PX",
            "RMSE of box centres, too, of pairs nearer than PX. Default: not computed.",
            min=0.0,
        ),
    ] = 0.0,
) -> None:
    """Score tracks against annotated objects.

    A row of the truth that the benchmark ignores is ignored here; every row of the tracks counts.
    With --errors it reports why boxes are missed or false. With --json a score whose denominator is
    empty is null.
    """
    if not asked.errors:
        unused = {"--detections": asked.detections, "--worst": asked.worst != WORST}
        refuse(unused, "it goes with --errors only", "say --errors")
    if (tracks / rundir.TRACKS).is_file():
        tracks = tracks / rundir.TRACKS
    part = rundir.part_of_run(tracks)
    if part and part != "1-":
        missed = f"the run tracked the frames {part} alone, and objects of all others are missed"
        output.warn([f"{missed}: phdtrack track --truth scores those frames"])
    request = ScoringRequest(
        truth, tracks, _reading(asked), asked.ignore, asked.kitti, frames, asked.labelled
    )
    if asked.per_class:
        output.document(per_class(output, request, asked, iou=iou))
        return
    files = read_scored(request)
    output.warn(files.notices)
    scores = score(files.truth, files.tracks, frames=files.frames, iou=iou)
    output.say(
        f"{tracks} against {truth}: {scores.frames} frames, {scores.truth_objects} objects, match"
        f" from IoU {iou:g}"
    )
    output.say()
    score_table(output, {"": scores})
    document: dict[str, object] = {**scores.as_dict()}
    if t_gospa:
        document |= trajectory_scores(output, files.truth, files.tracks, scores.frames)
    if rmse:
        document["RMSE"] = located_errors(output, files.truth, files.tracks, rmse)
    if asked.errors:
        document["errors"] = _errors(output, files, asked, scores.frames, iou)
    output.document(document)


def _errors(
    output: Output, files: ScoredFiles, asked: EvaluateOptions, frames: int, iou: float
) -> dict[str, object]:
    """Misses and false boxes by cause, in tables and for JSON."""
    detections = None
    if asked.detections:
        notices = list[str]()
        detections = read_detections(asked.detections, notices=notices)
        output.warn(notices)
        if len(files.labelled):
            detections = detections_in_frames(detections, files.labelled)
    errors = explain(files.truth, files.tracks, detections, frames=frames, iou=iou)
    if len(files.labelled):
        errors = errors.in_frames(files.labelled)
    error_tables(output, errors, asked.worst)
    return errors.as_dict(asked.worst)


def _reading(asked: EvaluateOptions) -> tuple[Conventions, Conventions]:
    """The conventions of the truth and of the tracks. Raises `InputError` for unknown words."""
    size = frame_size(asked.frame_size) if asked.frame_size else (0, 0)
    truth, tracks = asked.reading.pair()
    if "," not in asked.reading.format:
        # Trackers write other formats than annotators.
        tracks = replace(tracks, format="")
    return truth.conventions(size), tracks.conventions(size)


def trajectory_scores(
    output: Output, truth: Truth, tracks: Tracks, frames: int
) -> dict[str, float]:
    """T-GOSPA and its parts per frame, in a table and for JSON."""
    parts = tgospa_boxes(truth, tracks, frames=frames)
    values = (parts.distance, parts.localisation, parts.missed, parts.false, parts.switching)
    scores = {
        name: value / max(frames, 1) for name, value in zip(BY_TRAJECTORY, values, strict=True)
    }
    _table(output, {"": scores}, BY_TRAJECTORY)
    return scores


def per_class(
    output: Output, request: ScoringRequest, asked: EvaluateOptions, *, iou: float
) -> dict[str, object]:
    """Scores of each class of the truth and of the tracks, in a table and for JSON."""
    if asked.kitti or asked.errors:
        problem = "it does not go with --kitti or --errors"
        raise InputError(problem, where="--per-class", cure="Leave one out.")
    files = read_scored_by_class(request)
    output.warn(files.notices)
    scores = {
        name: score(truth, tracks, frames=files.frames, iou=iou)
        for name, (truth, tracks) in files.classes.items()
    }
    output.say(
        f"{request.tracks} against {request.truth}: {files.frames} frames, each class on its own,"
        f" match from IoU {iou:g}",
        "",
    )
    score_table(output, scores)
    return {"classes": {name: one.as_dict() for name, one in scores.items()}}


def score_table(out: Output, runs: Mapping[str, Scores]) -> None:
    """Print the scores of each run in a column under its title, and the meaning of each score."""
    _table(out, {title: scores.as_dict() for title, scores in runs.items()}, SHOWN.split())


def _table(
    out: Output, columns: Mapping[str, Mapping[str, float | None]], names: Sequence[str]
) -> None:
    meanings = score_meanings()
    rows = [
        [key, *(number(column[key]) for column in columns.values()), meanings[key]] for key in names
    ]
    out.table(["", *columns, ""], rows, words=(0, len(columns) + 1))


def error_tables(out: Output, errors: Errors, worst: int) -> None:
    """Print misses and false boxes by cause, and the ``worst`` objects and tracks."""
    table = errors.misses.sum(axis=0)[: len(errors.causes)]
    rows = [
        [cause, *map(str, row), str(sum(row))]
        for cause, row in zip(errors.causes, table.tolist(), strict=True)
    ]
    out.say("", "Misses by cause, and by place in the object's life:")
    out.table(
        ["", *PLACES, "all"],
        [*rows, ["all", *map(str, table.sum(axis=0).tolist()), str(table.sum())]],
    )
    false = errors.false.sum(axis=0)
    out.say("", f"False boxes by cause (ignored, counted as nothing: {errors.ignored}):")
    out.table([*FALSE, "all"], [[*map(str, false.tolist()), str(false.sum())]], words=())
    by_cause = errors.misses.sum(axis=2)[:, : len(errors.causes)]
    places = errors.misses.sum(axis=1)
    objects = [
        errors.objects,
        errors.boxes,
        places.sum(axis=1),
        *by_cause.T,
        *places.T,
        errors.last,
    ]
    tracks = [
        errors.tracks,
        errors.track_boxes,
        errors.false.sum(axis=1),
        *errors.false.T,
        errors.track_last,
    ]
    head = ["object", "boxes", "misses", *errors.causes, *PLACES, "last"]
    title = "Objects with most misses, and the last frame in which each was followed:"
    _table_of(out, title, head, objects, errors.worst_objects(worst))
    title = "Tracks with most false boxes, and the last frame in which each followed an object:"
    _table_of(
        out, title, ["track", "boxes", "false", *FALSE, "last"], tracks, errors.worst_tracks(worst)
    )
    identity_table(out, errors, worst)


def identity_table(out: Output, errors: Errors, worst: int) -> None:
    """Print how many errors of identity there are of each kind, and the ``worst`` of them."""
    sums = errors.identity_sums()
    out.say("", "Errors of identity:")
    out.table(list(sums), [[str(count) for count in sums.values()]], words=())
    chosen = errors.worst_identity(worst)
    if chosen:
        rows = [
            [each.kind, str(each.frame), _names(each, each.objects), _names(each, each.tracks)]
            for each in chosen
        ]
        title = "The worst of them, and how many boxes each takes out of their identity:"
        out.say("", title)
        table = [[*row, str(each.boxes)] for row, each in zip(rows, chosen, strict=True)]
        out.table(["error", "frame", "object", "track", "boxes"], table, words=(0, 2, 3))


def _names(error: IdentityError, identities: Sequence[int]) -> str:
    """The identities of one side of an error, as ``3 and 4`` or ``3 to 4``."""
    word = " and " if error.kind == "swap" else " to "
    return word.join(str(each) for each in identities)


def _table_of(
    out: Output, title: str, head: Sequence[str], columns: Sequence[I8], chosen: I8
) -> None:
    """Print the rows ``chosen`` of the columns, if there are any."""
    if len(chosen):
        out.say("", title)
        out.table(head, [[str(column[i]) for column in columns] for i in chosen.tolist()])


def located_errors(out: Output, truth: Truth, tracks: Tracks, gate: float) -> object:
    """The errors of the boxes' centres in pixels, object by object without distractors, in a table
    and for JSON.
    """
    kept = ~truth.distractor
    centre, found = ((xyxy[:, :2] + xyxy[:, 2:]).T / 2 for xyxy in (truth.xyxy[kept], tracks.xyxy))
    errors = rmse_per_target(
        truth.frame[kept], truth.identity[kept], centre, tracks.frame, found, gate
    )
    columns = [
        each.tolist()
        for each in (errors.identity, errors.frames, errors.mapped, *errors.rmse_axis, errors.rmse)
    ]
    rows = [[number(value, 2) for value in row] for row in zip(*columns, strict=True)]
    total = [
        "all",
        str(errors.frames.sum()),
        str(errors.mapped.sum()),
        "",
        "",
        number(errors.overall, 2),
    ]
    out.say("", f"RMSE of box centres in pixels, pairs nearer than {gate:g}:")
    out.table(["object", "frames", "mapped", "x", "y", "RMSE"], [*rows, total])
    return errors.as_dict()
