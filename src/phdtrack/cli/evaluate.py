"""``phdtrack evaluate``: scores of a file of tracks against annotated objects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from phdtrack.cli.options import Iou, Json
from phdtrack.cli.output import Output
from phdtrack.cli.scoring import check_iou, error_table, located, score_table, trajectory_scores, trajectory_table


def evaluate(
    truth: Annotated[
        Path, typer.Option("--truth", metavar="FILE", help="Annotated objects: MOTChallenge gt.txt, CSV, XML.")
    ],
    tracks: Annotated[Path, typer.Option("--tracks", metavar="FILE", help="Tracks to score: MOTChallenge or CSV.")],
    iou: Iou = 0.5,
    frames: Annotated[
        int,
        typer.Option(
            "--frames",
            metavar="N",
            min=0,
            help="Number of frames; 0: as seqinfo.ini by the truth says, or up to the last box.",
        ),
    ] = 0,
    t_gospa: Annotated[
        bool,
        typer.Option(
            "--t-gospa", help="T-GOSPA too: switches and breaks in one distance; takes seconds to minutes on long sequences."
        ),
    ] = False,
    rmse: Annotated[
        float,
        typer.Option(
            "--rmse",
            metavar="PX",
            min=0.0,
            help="RMSE of box centres per object, too; pairs from PX pixels on are misses and false ones. 0: without.",
        ),
    ] = 0.0,
    json: Json = False,
) -> None:
    """Score tracks against annotated objects.

    A row of the truth that the benchmark ignores is ignored here; every row of the tracks counts. With --json a score
    whose denominator is empty is null.
    """
    from phdtrack.formats import find_seqinfo, read_tracks, read_truth
    from phdtrack.metrics import evaluate as score

    check_iou(iou)
    annotated, given = read_truth(truth), read_tracks(tracks)
    if not frames:
        found = find_seqinfo(truth)
        last = max([*annotated.frame, *given.frame], default=0)
        frames = max(found.frames, int(last)) if found else 0
    scores, out = score(annotated, given, frames=frames, iou=iou), Output(json)
    out.say(f"{tracks} against {truth}: {scores.frames} frames, {scores.truth_objects} objects, match from IoU {iou:g}")
    out.say()
    score_table(out, [("", scores)])
    whole = trajectory_scores(annotated, given, scores.frames) if t_gospa else {}
    if whole:
        trajectory_table(out, whole)
    errors = located(annotated, given, rmse) if rmse else None
    if errors is not None:
        error_table(out, errors, rmse)
    out.document({**scores.as_dict(), **whole, **({"RMSE": errors.as_dict()} if errors is not None else {})})
