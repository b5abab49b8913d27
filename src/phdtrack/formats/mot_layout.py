"""Columns 7 to 10 of files without a header, which benchmarks use in different ways.

| layout | columns from 7 |
| --- | --- |
| MOT15 | score or flag, world coordinates |
| MOT17 | flag, class of the benchmark, visibility |
| own classes | score or flag, class of the user, anything |
| UAVDT | out of view 1–3, occlusion 1–4, category 1–3 |
| VisDrone | score or flag, category 0–11, truncation, occlusion |

In MOT16 and later only pedestrians (class 1) have flag 1, and other classes flag 0. A file in which
other classes have it has class numbers of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from pathlib import Path

import numpy as np

from phdtrack.conventions import Conventions
from phdtrack.errors import InputError
from phdtrack.files import load
from phdtrack.formats.text import Text, is_number
from phdtrack.types import F8, Bool

PEDESTRIAN = 1
LAST_CLASS = 13
_BOX_COLUMNS = 6
_BENCHMARKS = ("MOT16", "MOT17", "MOT20")
# VisDrone's categories of regions that are ignored, and of objects that are.
REGION_CATEGORY = 0
OTHERS_CATEGORY = 11


class MotLayout(Enum):
    """The meaning of the columns from 7 on."""

    MOT15 = "MOT15"
    MOT17 = "MOT17"
    OWN_CLASSES = "class numbers of your own in column 8"
    UAVDT = "UAVDT"
    VISDRONE = "VisDrone"

    @property
    def columns(self) -> dict[int, str]:
        """The names of columns by 0-based position that differ from MOT15's."""
        return {
            MotLayout.MOT15: {},
            MotLayout.MOT17: {7: "MOT class"},
            MotLayout.OWN_CLASSES: {7: "class"},
            MotLayout.UAVDT: {6: "", 8: "class"},
            MotLayout.VISDRONE: {7: "class"},
        }[self]


_NAMED = {
    "mot15": MotLayout.MOT15,
    "mot17": MotLayout.MOT17,
    "uavdt": MotLayout.UAVDT,
    "visdrone": MotLayout.VISDRONE,
}


def _without_values(text: Text, conventions: Conventions) -> MotLayout | None:
    """The layout that is stated, or follows from the number of columns; None if values decide."""
    if named := _NAMED.get(conventions.format):
        return _fitting(named, text)
    if text.width not in (8, 9, 10) or not len(text):
        return MotLayout.MOT15
    return None


def layout_of_truth(path: Path, text: Text, conventions: Conventions) -> MotLayout:
    """The layout of a file of annotated objects without a header.

    Raises `InputError` if the user names a layout that needs more columns.

    Parameters
    ----------
    path : the file, whose name is evidence, too.
    text : its rows.
    conventions : what the user states.
    """
    if (known := _without_values(text, conventions)) is not None:
        return known
    if text.width < 10 and not is_number([*text.cells(0), "", ""][7]):
        return MotLayout.OWN_CLASSES
    rest = _columns_from_7(text)
    if text.width == 10:
        return MotLayout.VISDRONE if _is_visdrone(rest) else MotLayout.MOT15
    if benchmark(path):
        return MotLayout.MOT17
    if text.width == 9 and _is_uavdt(path, rest):
        return MotLayout.UAVDT
    label = rest[:, 1]
    if (label == -1).all():
        return MotLayout.MOT15
    flagged = rest[:, 0] != 0
    if _whole(label, 0, math.inf).all() and (flagged & (label != PEDESTRIAN)).any():
        return MotLayout.OWN_CLASSES
    return MotLayout.MOT17


def layout_of_tracks(path: Path, text: Text, conventions: Conventions) -> MotLayout:
    """The layout of a file of tracks without a header, which may be annotated objects.

    Raises `InputError` if the user names a layout that needs more columns.

    Parameters
    ----------
    path : the file, whose name is evidence, too.
    text : its rows.
    conventions : what the user states.
    """
    if (known := _without_values(text, conventions)) is not None:
        return known
    if text.width == 10:
        return _layout_of_ten(text)
    if not is_number([*text.cells(0), "", ""][7]):
        return MotLayout.OWN_CLASSES
    rest = _columns_from_7(text)
    if text.width == 9 and _is_benchmark(path, rest):
        return MotLayout.MOT17
    if _whole(rest[:, 1], 0, math.inf).all():
        return MotLayout.OWN_CLASSES
    return MotLayout.MOT15


def layout_of_detections(text: Text, conventions: Conventions) -> MotLayout:
    """The layout of a file of detections without a header: VisDrone has a category in column 8, and
    −1 in columns 9 and 10.
    """
    if conventions.format == "visdrone":
        return _fitting(MotLayout.VISDRONE, text)
    if text.width == 10 and len(text):
        return _layout_of_ten(text)
    return MotLayout.MOT15


def _layout_of_ten(text: Text) -> MotLayout:
    """The layout of ten columns: VisDrone's results or annotations, or MOT15."""
    first = [*text.cells(0), "", "", ""][7:10]
    if not all(map(is_number, first)) or float(first[0]) < 0:
        return MotLayout.MOT15
    rest = _columns_from_7(text)
    result = _whole(rest[:, 1], 0, OTHERS_CATEGORY).all() and (rest[:, 2:] == -1).all()
    if result or _is_visdrone(rest):
        return MotLayout.VISDRONE
    return MotLayout.MOT15


def benchmark(path: Path) -> bool:
    """True if a folder of the path is called after MOT16, MOT17 or MOT20."""
    return any(part.upper().startswith(_BENCHMARKS) for part in path.absolute().parts)


def own_class_names(path: Path, labels: Sequence[float]) -> dict[int, str]:
    """The names of class numbers from 1 in a ``labels.txt`` beside the file, as CVAT writes it;
    empty if there is none for these ``labels``.
    """
    file = path.parent / "labels.txt"
    if not file.is_file() or file.samefile(path):
        return {}
    try:
        words = load(file).decode("utf-8-sig").split("\n")
    except (UnicodeDecodeError, InputError):
        return {}
    names = {number: word.strip() for number, word in enumerate(words, start=1) if word.strip()}
    return names if set(labels) <= set(names) else {}


def _fitting(layout: MotLayout, text: Text) -> MotLayout:
    """The layout, which the user named. Raises `InputError` if the file has too few columns."""
    needed = max(layout.columns, default=_BOX_COLUMNS - 1) + 1
    if len(text) and text.width < needed:
        raise InputError(
            f"expected at least {needed} columns of {layout.value}, got {text.width}",
            where=text.origin.at(0),
            cure="Leave out --format, or in Python format.",
        )
    return layout


def _columns_from_7(text: Text) -> F8:
    """(M, width − 6) the values of the columns; NaN for what is not a number."""
    try:
        table = np.loadtxt(text.lines, delimiter=text.delimiter, comments=None, ndmin=2)
        if table.shape == (len(text), text.width):
            return table[:, _BOX_COLUMNS:]
    except ValueError:
        pass
    rows = np.full((len(text), text.width - _BOX_COLUMNS), np.nan)
    for row in range(len(text)):
        cells = text.cells(row)[_BOX_COLUMNS : text.width]
        for column, cell in enumerate(cells):
            if is_number(cell):
                rows[row, column] = float(cell)
    return rows


def _whole(values: F8, low: float, high: float) -> Bool:
    """Which values are whole numbers from ``low`` to ``high``."""
    with np.errstate(invalid="ignore"):
        fits: Bool = (np.floor(values) == values) & (values >= low) & (values <= high)
    return fits


def _is_visdrone(rest: F8) -> bool:
    """True for columns of VisDrone's annotations: ignored regions and others have flag 0."""
    flag, category, truncation, occlusion = rest.T
    fits = _whole(flag, 0, 1) & _whole(category, 0, OTHERS_CATEGORY)
    fits &= _whole(truncation, 0, 1) & _whole(occlusion, 0, 2)
    ignored = (category == REGION_CATEGORY) | (category == OTHERS_CATEGORY)
    return bool(fits.all() and (flag[ignored] == 0).all() and (flag[~ignored] == 1).any())


def _is_uavdt(path: Path, rest: F8) -> bool:
    """True for columns of UAVDT's annotations: a MOT flag and a visibility do not exceed 1."""
    fits = _whole(rest[:, 0], 1, 3) & _whole(rest[:, 1], 1, 4) & _whole(rest[:, 2], 1, 3)
    named = any("UAVDT" in part.upper() for part in path.absolute().parts)
    named |= path.stem.endswith("gt_whole")
    return bool(fits.all() and (named or (rest[:, [0, 2]] > 1).any()))


def _is_benchmark(path: Path, rest: F8) -> bool:
    """True for columns of MOT17's annotations: flag 1 means that it is a pedestrian."""
    flag, label, visibility = rest.T
    with np.errstate(invalid="ignore"):
        shares = (visibility >= 0) & (visibility <= 1)
    if not (_whole(flag, 0, 1) & _whole(label, PEDESTRIAN, LAST_CLASS) & shares).all():
        return False
    agree = ((flag == 1) == (label == PEDESTRIAN)).all() and 0 < flag.mean() < 1
    return bool(agree or path.name == "gt.txt")
