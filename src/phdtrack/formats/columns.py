"""Which column means what: by position in MOTChallenge files, by name where there is a header.

By position (1-based), the same for all: 1 frame, 2 identity, 3–6 left, top, width, height, 7 confidence (optional). Then

* detections: 11 class, 12–21 the upper triangle, by rows, of the covariance of (centre x, centre y, width, height);
* truth of 8 or 9 columns (MOT16 and later): 8 class; in 10 columns (MOT15) 8–10 are places in the world, not used;
* tracks: 11 detection, 12 confirmed.

By name, a box may be given by left, top, width, height, by left, top, right, bottom, or by its centre and size. Plain
``x, y`` with a size means left and top, as in COCO, unless the header names left or centre otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

from phdtrack.errors import InputError

Aliases = tuple[str, ...]

LEFT: Aliases = ("left", "bb_left", "bbox_left", "xmin", "x_min", "x1")
TOP: Aliases = ("top", "bb_top", "bbox_top", "ymin", "y_min", "y1")
RIGHT: Aliases = ("right", "bb_right", "bbox_right", "xmax", "x_max", "x2")
BOTTOM: Aliases = ("bottom", "bb_bottom", "bbox_bottom", "ymax", "y_max", "y2")
WIDTH: Aliases = ("width", "bb_width", "bbox_width", "w")
HEIGHT: Aliases = ("height", "bb_height", "bbox_height", "h")
CENTRE_X: Aliases = ("cx", "xc", "center_x", "centre_x", "x_center", "x_centre")
CENTRE_Y: Aliases = ("cy", "yc", "center_y", "centre_y", "y_center", "y_centre")


class Kind(Enum):
    """What a file is read as."""

    DETECTIONS = auto()
    TRUTH = auto()
    TRACKS = auto()


class Role(Enum):
    """What a column is used for: the names by which a header may call it, the usual one first (boxes: see `Form`)."""

    FRAME = ("frame", "frame_id", "frame_number", "frame_no", "frame_num", "frame_idx", "frame_index", "frameid")
    IDENTITY = ("identity", "id", "track_id", "trackid", "tracker_id", "target_id", "object_id", "track", "label")
    BOX = ("box",)
    CONFIDENCE = ("confidence", "conf", "score", "probability", "prob")
    CLASS = ("class", "class_id", "category_id", "category", "cls")
    COVARIANCE = ("covariance",)
    DISTRACTOR = ("distractor", "ignore", "ignored")
    DETECTION = ("detection", "detection_index")
    CONFIRMED = ("confirmed", "is_confirmed")


class Form(Enum):
    """How four columns give a box."""

    CORNER_SIZE = (LEFT, TOP, WIDTH, HEIGHT)
    CORNERS = (LEFT, TOP, RIGHT, BOTTOM)
    CENTRE_SIZE = (CENTRE_X, CENTRE_Y, WIDTH, HEIGHT)
    PLAIN = (("x",), ("y",), WIDTH, HEIGHT)


COVARIANCE: tuple[Aliases, ...] = tuple((f"cov_{a}_{b}",) for i, a in enumerate("xywh") for b in "xywh"[i:])

_OPTIONAL = {
    Kind.DETECTIONS: (Role.CONFIDENCE, Role.CLASS),
    Kind.TRUTH: (Role.CONFIDENCE, Role.DISTRACTOR),
    Kind.TRACKS: (Role.CONFIDENCE, Role.DETECTION, Role.CONFIRMED),
}


@dataclass(frozen=True, slots=True)
class Layout:
    """The columns in use: ``columns`` 0-based in the file, the role of each, its label in messages, and the box's form."""

    roles: tuple[Role, ...]
    columns: tuple[int, ...]
    labels: tuple[str, ...]
    form: Form = Form.CORNER_SIZE

    def place(self, role: Role) -> list[int]:
        """Which of ``columns`` have this role."""
        return [i for i, r in enumerate(self.roles) if r is role]

    def without(self, absent: Sequence[int]) -> Layout:
        """The same layout less the file's columns ``absent``."""
        keep = [i for i, column in enumerate(self.columns) if column not in absent]
        return Layout(
            tuple(self.roles[i] for i in keep),
            tuple(self.columns[i] for i in keep),
            tuple(self.labels[i] for i in keep),
            self.form,
        )

    @property
    def optional(self) -> list[int]:
        """The file's columns that may be empty from top to bottom."""
        needed = (Role.FRAME, Role.IDENTITY, Role.BOX, Role.COVARIANCE)
        return [column for role, column in zip(self.roles, self.columns, strict=True) if role not in needed]


def by_position(kind: Kind, width: int, where: str | Path) -> Layout:
    """The layout of a file of ``width`` columns without a header.

    Raises
    ------
    InputError : there are fewer than six columns.
    """
    if width < 6:
        raise InputError(
            f"expected at least 6 columns (frame, id, left, top, width, height), came {width}",
            where=where,
            cure="Give the columns in this order, or name them in a header line.",
        )
    names = [aliases[0] for aliases in Form.CORNER_SIZE.value]
    spec = [
        (Role.FRAME, "frame"),
        (Role.IDENTITY, "id"),
        *((Role.BOX, name) for name in names),
        (Role.CONFIDENCE, "confidence"),
    ]
    columns = list(range(min(width, 7)))
    if kind is Kind.DETECTIONS:
        spec += [(Role.CLASS, "class")] + [(Role.COVARIANCE, aliases[0]) for aliases in COVARIANCE]
        columns += range(10, 21) if width >= 21 else [10] if width > 10 else []
    elif kind is Kind.TRUTH:
        spec += [(Role.CLASS, "class")]
        columns += [7] if width in (8, 9) else []
    else:
        spec += [(Role.DETECTION, "detection"), (Role.CONFIRMED, "confirmed")]
        columns += [10, 11] if width >= 12 else []
    used = list(zip(spec, columns, strict=False))
    if kind is Kind.DETECTIONS:  # the identity is −1 there by convention; whatever it is, it is not used
        used = [entry for entry in used if entry[0][0] is not Role.IDENTITY]
    return Layout(tuple(r for (r, _), _ in used), tuple(c for _, c in used), tuple(name for (_, name), _ in used))


def by_name(kind: Kind, header: Sequence[str], where: str | Path) -> Layout:
    """The layout that a ``header`` of lower-case names tells; unknown names are passed over.

    Raises
    ------
    InputError : there is no column for the frame, for the box, or (truth and tracks) for the identity.
    """
    form = next((form for form in Form if all(_find(header, aliases) >= 0 for aliases in form.value)), None)
    wanted = [Role.FRAME] if kind is Kind.DETECTIONS else [Role.FRAME, Role.IDENTITY]
    missing = next((role.value for role in wanted if _find(header, role.value) < 0), None)
    if form is None or missing is not None:
        what, cure = _missing(missing)
        came = ", ".join(header)
        raise InputError(f"no column for the {what}; the columns are {came[:200]}", where=where, cure=cure)
    found = [(role, _find(header, role.value)) for role in wanted]
    found += [(Role.BOX, _find(header, aliases)) for aliases in form.value]
    found += [(role, i) for role in _OPTIONAL[kind] if (i := _find(header, role.value)) >= 0]
    covariance = [_find(header, aliases) for aliases in COVARIANCE]
    if kind is Kind.DETECTIONS and min(covariance) >= 0:
        found += [(Role.COVARIANCE, i) for i in covariance]
    return Layout(tuple(r for r, _ in found), tuple(c for _, c in found), tuple(header[c] for _, c in found), form)


def _find(header: Sequence[str], aliases: Aliases) -> int:
    """The column with the first of the ``aliases`` that the header has; −1 for none."""
    return next((header.index(name) for name in aliases if name in header), -1)


def _missing(aliases: Aliases | None) -> tuple[str, str]:
    if aliases is not None:
        return aliases[0], f"Name it one of {', '.join(aliases)}."
    return "box", "Name left, top, width, height, or left, top, right, bottom, or cx, cy, width, height."
