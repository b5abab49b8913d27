"""``phdtrack evaluate``: scores of a file of tracks against annotated objects, and how commands
show scores.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from phdtrack.cli import options as given
from phdtrack.cli.options import option
from phdtrack.cli.output import Output, number
from phdtrack.errors import InputError
from phdtrack.formats import (
    find_seqinfo,
    ignoring,
    read_detections,
    read_tracks,
    read_tracks_named,
    read_truth,
    read_truth_by_class,
)
from phdtrack.metrics import Errors, Scores, explain, rmse_per_target, tgospa_boxes
from phdtrack.metrics import evaluate as score
from phdtrack.metrics.causes import FALSE, PLACES
from phdtrack.report.pages import score_meanings
from phdtrack.run import directory as rundir
from phdtrack.run.inputs import refuse
from phdtrack.types import I8, Tracks, Truth

# The scores that a table shows, in its order: keys of `Scores.as_dict`.
SHOWN = """
MODA N_MODA MODP MOTA MOTA_log MOTP IDF1 HOTA OSPA GOSPA OSPA2 SFDA ATA id_switches misses false_positives fragments
false_tracks delay_mean frames
"""
WORST = 5
NO_TRUTH = Truth(*(np.zeros(0, np.int64),) * 2, np.zeros((0, 4)), np.zeros(0, np.bool_))
BY_TRAJECTORY = (
    "TGOSPA",
    "TGOSPA_localisation",
    "TGOSPA_missed",
    "TGOSPA_false",
    "TGOSPA_switching",
)


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """What does not count, and what is told of errors."""

    ignore: Annotated[
        Path | None, option("FILE", "Regions that do not count: CSV frame,x,y,w,h; no frame: all.")
    ] = None
    kitti: Annotated[str, option("TYPE", "Type that is scored of KITTI label files, as Car.")] = ""
    per_class: Annotated[
        bool, typer.Option("--per-class", help="Scores of each class; no pair is of two classes.")
    ] = False
    errors: Annotated[
        bool,
        typer.Option("--errors", help="Misses and false boxes by cause, and the worst tracks."),
    ] = False
    detections: Annotated[
        Path | None, option("FILE", "For --errors: what the tracker was given.")
    ] = None
    worst: Annotated[
        int, option("N", "For --errors: how many objects and tracks are named.", min=0)
    ] = WORST
    max_file_size: given.MaxFileSize = ""


def evaluate(
    truth: Annotated[Path, option("FILE", "Annotated objects: MOTChallenge gt.txt, CSV, XML.")],
    tracks: Annotated[Path, option("FILE", "Tracks to score: MOTChallenge or CSV.")],
    output: Output,
    asked: EvaluateOptions,
    iou: given.Iou = 0.5,
    frames: Annotated[
        int, option("N", "Number of frames; 0: as seqinfo.ini or the last box says.", min=0)
    ] = 0,
    t_gospa: Annotated[
        bool, typer.Option("--t-gospa", help="T-GOSPA too: seconds to minutes on long sequences.")
    ] = False,
    rmse: Annotated[
        float, option("PX", "RMSE of each object's box centres too, pairs nearer than PX.", min=0.0)
    ] = 0.0,
) -> None:
    """Score tracks against annotated objects.

    A row of the truth that the benchmark ignores is ignored here; every row of the tracks counts.
    --errors says why boxes are missed or false. With --json a score whose denominator is empty is
    null.
    """
    if not asked.errors:
        useless = {"--detections": asked.detections, "--worst": asked.worst != WORST}
        refuse(useless, "it goes with --errors only", "say --errors")
    if (part := rundir.part_of_run(tracks)) and part != "1-":
        said = f"the run tracked the frames {part} alone, and objects of all others are missed"
        output.warn([f"{said}: phdtrack track --truth scores those frames"])
    if asked.per_class:
        output.document(per_class(output, truth, tracks, asked, iou=iou, frames=frames))
        return
    annotated = read_truth(truth, kitti=asked.kitti)
    found = read_tracks(tracks, kitti=asked.kitti)
    if asked.ignore is None:
        annotated = annotated
    else:
        annotated = ignoring(annotated, asked.ignore)
    if frames:
        known = None
    else:
        known = find_seqinfo(truth)
    if known is not None:
        frames = max(known.frames, int(max([*annotated.frame, *found.frame], default=0)))
    if not len(annotated):
        output.warn([f"{truth}: the truth holds no object"])
    scores = score(annotated, found, frames=frames, iou=iou)
    output.say(
        f"{tracks} against {truth}: {scores.frames} frames, {scores.truth_objects} objects, match"
        f" from IoU {iou:g}"
    )
    output.say()
    score_table(output, {"": scores})
    document: dict[str, object] = {**scores.as_dict()}
    if t_gospa:
        parts = tgospa_boxes(annotated, found, frames=scores.frames)
        values = (parts.distance, parts.localisation, parts.missed, parts.false, parts.switching)
        whole = {
            key: value / max(scores.frames, 1)
            for key, value in zip(BY_TRAJECTORY, values, strict=True)
        }
        _table(output, {"": whole}, BY_TRAJECTORY)
        document |= whole
    if rmse:
        document["RMSE"] = located_errors(output, annotated, found, rmse)
    if asked.errors:
        if asked.detections is None:
            detections = None
        else:
            detections = read_detections(asked.detections)
        errors = explain(annotated, found, detections, frames=scores.frames, iou=iou)
        error_tables(output, errors, asked.worst)
        document["errors"] = errors.as_dict(asked.worst)
    output.document(document)


def per_class(
    output: Output, truth: Path, tracks: Path, asked: EvaluateOptions, *, iou: float, frames: int
) -> dict[str, object]:
    """Scores of each class of the truth and of the tracks, in a table and for JSON."""
    if asked.kitti or asked.errors:
        raise InputError(
            "it does not go with --kitti or --errors", where="--per-class", cure="Leave one out."
        )
    annotated = read_truth_by_class(truth)
    found, names = read_tracks_named(tracks)
    if frames:
        known = None
    else:
        known = find_seqinfo(truth)
    last = max(
        [found.frame.max(initial=0), *(one.frame.max(initial=0) for one in annotated.values())]
    )
    frames = frames or max(int(last), 0 if known is None else known.frames)
    label = np.array([names.get(one, str(one)).lower() for one in found.class_id.tolist()], np.str_)
    words = {one: one for one in label.tolist()} | {
        name.lower(): name for name in (*names.values(), *annotated)
    }
    scores = {}
    for word, name in words.items():
        given = next((one for key, one in annotated.items() if key.lower() == word), NO_TRUTH)
        if asked.ignore is None:
            given = given
        else:
            given = ignoring(given, asked.ignore)
        mine = found.select(label == word)
        if len(mine) or len(given):
            scores[name] = score(given, mine, frames=frames, iou=iou)
    output.say(
        f"{tracks} against {truth}: {frames} frames, each class on its own, match from IoU {iou:g}",
        "",
    )
    score_table(output, scores)
    return {"classes": {name: one.as_dict() for name, one in scores.items()}}


def score_table(out: Output, runs: Mapping[str, Scores]) -> None:
    """The scores of each run, by its title, in a column of its own, and what each of them says."""
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
    """Misses by cause and place, false boxes by cause, and the ``worst`` objects and tracks."""
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


def _table_of(
    out: Output, title: str, head: Sequence[str], columns: Sequence[I8], chosen: I8
) -> None:
    """The rows ``chosen`` of the columns, where there are any."""
    if len(chosen):
        out.say("", title)
        out.table(head, [[str(column[i]) for column in columns] for i in chosen.tolist()])


def located_errors(out: Output, truth: Truth, tracks: Tracks, gate: float) -> object:
    """A table of the errors of the boxes' centres in pixels, object by object without distractors;
    the same for JSON.
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
