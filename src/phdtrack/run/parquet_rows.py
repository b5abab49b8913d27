"""The tracks of a run as one Parquet file of a data set."""

from __future__ import annotations

from pathlib import Path

from phdtrack.clock import Clock
from phdtrack.errors import needed
from phdtrack.files import readable_name, whole
from phdtrack.run import directory as rundir

# The columns of tracks.csv; x and y are null if the place is unknown, `class` without classes.
_BOX = ("left", "top", "width", "height", "confidence", "x", "y")
_COLUMNS = ("frame", "identity", *_BOX, "z", "detection", "confirmed", "class")


def write_rows(name: str, folder: Path, file: Path, fps: float, video: Clock | None = None) -> None:
    """Write the tracks of a run with the video's name: ``video``, ``frame`` from 1, ``time`` in
    seconds since the first frame, and what tracks.csv has. The time is that of the frame's states;
    for a frame without any it is that of the video, or interpolated.

    Parameters
    ----------
    name : of the video.
    folder, file : of the run, and the Parquet file to write.
    fps : frames per second where the states say nothing.
    video : the times of the video, if they are known.
    """
    arrow, csv, parquet = (needed(f"pyarrow{part}") for part in ("", ".csv", ".parquet"))
    special = {
        **{column: arrow.float64() for column in _BOX},
        "class": arrow.string(),
        "confirmed": arrow.int8(),
    }
    types = {column: special.get(column, arrow.int64()) for column in _COLUMNS}
    table = arrow.table({column: arrow.array([], kind) for column, kind in types.items()})
    tracks = folder / rundir.TRACKS
    if tracks.stat().st_size:
        # Arrow opens files of names in UTF-8 only.
        with tracks.open("rb") as lines:
            width = lines.readline().count(b",") + 1
            lines.seek(0)
            reading = csv.ReadOptions(column_names=list(_COLUMNS[:width]))
            converting = csv.ConvertOptions(column_types=types)
            table = csv.read_csv(lines, read_options=reading, convert_options=converting)
    number = table["frame"].to_numpy()
    nowhere = table["z"].to_numpy() != 0
    columns = {
        "video": arrow.array([readable_name(name)] * len(number), arrow.string()),
        "frame": table["frame"],
        "time": rundir.run_clock(folder, fps, video).times(number),
    }
    columns |= {column: table[column] for column in table.column_names}
    columns |= {
        column: arrow.array(table[column].to_numpy(), mask=nowhere) for column in ("x", "y")
    }
    columns.setdefault("class", arrow.nulls(len(number), arrow.string()))
    del columns["z"]
    with whole(file) as part, part.open("wb") as content:
        parquet.write_table(arrow.table(columns), content, compression="zstd")
