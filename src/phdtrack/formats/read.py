"""Reading detections, truth and tracks: one function each, for every format.

The content decides what a file is: Parquet by its first bytes, XML by ``<``, JSON by ``[`` or ``{``; anything else is a
text table, MOTChallenge or CSV. An empty file is a file without rows. Frames are numbered from 1 in what is returned.
``first_frame`` is the number that the file gives the first frame, for tools that count otherwise than their format does:
0 in CVML, 1 elsewhere.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from phdtrack.files import AnyPath, load
from phdtrack.formats import rows as records
from phdtrack.formats.columns import Kind, rows_of_text
from phdtrack.formats.rows import Rows, judge, usual_distractors
from phdtrack.formats.text import Origin
from phdtrack.types import DetectionTable, SequenceInfo, Tracks, Truth

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def read_detections(path: AnyPath, *, first_frame: int | None = None, within: SequenceInfo | None = None) -> DetectionTable:
    """The detections in a MOTChallenge ``det.txt``, CSV, Parquet, COCO JSON or CVML file, sorted by frame.

    Boxes in pixels, xyxy. Confidence is 1 and class 0 where the file has none; confidence has no bounds. Where ``within``
    tells the size of the picture, a box that lies outside of it altogether is an error.

    Parameters
    ----------
    path : the file.
    first_frame : the number that it gives the first frame; None: as usual in its format.
    within : size of the picture.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    return records.detections(_read(Path(path), Kind.DETECTIONS, first_frame), within)


def read_truth(path: AnyPath, *, first_frame: int | None = None, distractors: Collection[int] | None = None) -> Truth:
    """The annotated objects in a MOTChallenge ``gt.txt``, CSV, Parquet, COCO JSON or CVML file, sorted by frame.

    Rows of confidence 0 are left out. In truth with classes (MOT16 and later) pedestrians are scored, rows of the classes
    ``distractors`` are marked, all others left out. The default is the benchmark's choice: 2, 7, 8, 12, and 6 too where
    the path has a folder called MOT20-something.

    Parameters
    ----------
    path : the file.
    first_frame : the number that it gives the first frame; None: as usual in its format.
    distractors : classes that do not count; None: the benchmark's.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    path = Path(path)
    chosen = usual_distractors(path) if distractors is None else distractors
    return records.truth(_read(path, Kind.TRUTH, first_frame, chosen))


def read_tracks(path: AnyPath, *, first_frame: int | None = None) -> Tracks:
    """The tracks in a MOTChallenge (6 to 12 columns), CSV, Parquet, COCO JSON or CVML file, sorted by frame, then identity.

    ``detection`` is −1 (none known) and ``confirmed`` true where the file does not tell.

    Raises
    ------
    InputError : the file is missing or malformed; the message names the line.
    """
    return records.tracks(_read(Path(path), Kind.TRACKS, first_frame))


def _read(path: Path, kind: Kind, first_frame: int | None, distractors: Collection[int] = ()) -> Rows:
    content = load(path)
    start = content[:4096].removeprefix(_BYTE_ORDER_MARK).lstrip()[:4]
    first = 1 if first_frame is None else first_frame
    if not content.strip():
        return Rows(Origin(path, "line", np.zeros(0, np.int64)), np.zeros(0), np.zeros((0, 4)), first)
    if start == b"PAR1":
        from phdtrack.formats.columns import rows_of_parquet

        return rows_of_parquet(path, content, kind, first)
    if start.startswith(b"<"):
        from phdtrack.formats.cvml import rows_of_cvml

        return rows_of_cvml(path, content, 0 if first_frame is None else first_frame)
    if start.startswith((b"[", b"{")):
        from phdtrack.formats.coco import rows_of_coco

        return rows_of_coco(path, content, kind, first)
    rows = rows_of_text(path, content, kind, first)
    return judge(rows, distractors) if kind is Kind.TRUTH else rows
