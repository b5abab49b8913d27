"""``phdtrack export``: the tracks of a run, or of a file, in the format of another tool."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from phdtrack.cli import options as given
from phdtrack.cli.options import listed, one_of, option
from phdtrack.cli.output import Output, counted
from phdtrack.detect.convert import check_units
from phdtrack.errors import InputError
from phdtrack.formats import EXPORTS, export_tracks
from phdtrack.run import directory as rundir
from phdtrack.run.requests import ReadingRequest, frame_size

_BY_EVIDENCE = ReadingRequest()
_TO = f"Format: {', '.join(EXPORTS)}."


def export(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="The directory of a run, or a file of tracks.")
    ],
    output: Output,
    to: Annotated[
        str,
        option(
            "FORMAT",
            _TO,
            callback=lambda value: one_of(value, *EXPORTS),
            autocompletion=listed(_TO),
        ),
    ],
    out: Annotated[
        Path | None, option("FILE", "File to write. Default: beside the tracks.")
    ] = None,
    overwrite: given.Overwrite = False,
    size: given.FrameSize = "",
    reading: ReadingRequest = _BY_EVIDENCE,
) -> None:
    """Write the tracks of a run, or of a file, in the format of another tool: MOTChallenge, CSV,
    COCO, CVAT, and others.

    phdtrack reads all of these as a file of tracks, of detections or of truth.
    """
    stated = frame_size(size) if size else (0, 0)
    notices = list[str]()
    found = rundir.read_run_tracks(run, reading.conventions(stated), notices)
    output.warn(notices)
    width, height = stated if size else (found.info.width, found.info.height)
    if not rundir.is_run(run) and min(width, height) > 0:
        tracks = found.tracks
        words = {"units": reading.units, "box": reading.box}
        check_units(tracks.xyxy, tracks.confidence, (width, height), run, **words)
    folder, stem = (run, "tracks") if run.is_dir() else (run.parent, run.stem)
    path = out or folder / f"{stem}_{to}{EXPORTS[to]}"
    if path.name == "-":
        raise InputError("expected the name of a file, got -", where="--out", cure="Name one.")
    if path.exists() and not overwrite:
        raise InputError(
            "the file exists already",
            where=path,
            cure="Say --overwrite, or choose another --out.",
        )
    export_tracks(
        path, found.tracks, to, found.names, replace(found.info, width=width, height=height)
    )
    rows = len(found.tracks)
    identities = len(np.unique(found.tracks.identity))
    output.say(f"{counted(rows, 'row')} of {counted(identities, 'track')}: {path}")
    output.document(
        {
            "tracks": str(run),
            "format": to,
            "rows": rows,
            "identities": identities,
            "file": str(path),
        }
    )
