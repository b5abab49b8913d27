"""Labels of detections in one SQLite file: each mark is saved at once, from several people at a
time.

A file is a list of actions. An action is one or more marks, or a frame that is done, and the name
of its labeller; nothing is ever overwritten. The last mark on a box or frame whose action is not
undone counts, whoever made it. Undoing sets a flag, on own actions only. If two people mark the
same box, both marks are kept, and `LabelStore.disputes` lists where they differ. A page that does
not know if its request arrived repeats it: a ``key`` that the file has seen changes nothing.
"""

from __future__ import annotations

import secrets
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from phdtrack.arrays import iou
from phdtrack.errors import InputError
from phdtrack.files import readable_name
from phdtrack.types import DetectionTable, Truth

Mark = Literal["false", "birth", "true", "none"]
"""``false``: a false alarm. ``birth``: a target enters there. ``true``: an object is where the box
was drawn or moved to. ``none``: none of these any more; a drawn box is deleted.
"""
MARKS: tuple[str, ...] = get_args(Mark)
DRAWN = 1_000_000_000
"""The number of the first box that is no detection: drawn around an object that the detector
missed.
"""
FORMAT = "2"
NO_OBJECT = 0.3
"""Overlap (IoU) with every object below which a box is on no object."""
# Largest coordinate of a place in pixels.
_FAR = 1e6
# Seconds to wait while another action is written.
_TIMEOUT = 30.0

_TABLES = """
PRAGMA journal_mode = WAL;
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE IF NOT EXISTS frame (
    number INTEGER PRIMARY KEY, place INTEGER NOT NULL
) STRICT;
CREATE TABLE IF NOT EXISTS action (
    id INTEGER PRIMARY KEY AUTOINCREMENT, frame INTEGER NOT NULL, who TEXT NOT NULL,
    undone INTEGER NOT NULL DEFAULT 0,
    made TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
) STRICT;
CREATE TABLE IF NOT EXISTS mark (
    action INTEGER NOT NULL REFERENCES action (id), frame INTEGER NOT NULL, box INTEGER NOT NULL,
    mark TEXT NOT NULL, PRIMARY KEY (action, frame, box)
) STRICT;
CREATE TABLE IF NOT EXISTS place (
    action INTEGER NOT NULL REFERENCES action (id), frame INTEGER NOT NULL, box INTEGER NOT NULL,
    x1 REAL NOT NULL, y1 REAL NOT NULL, x2 REAL NOT NULL, y2 REAL NOT NULL,
    PRIMARY KEY (action, frame, box)
) STRICT;
CREATE TABLE IF NOT EXISTS request (key TEXT PRIMARY KEY) STRICT;
CREATE INDEX IF NOT EXISTS mark_by_box ON mark (frame, box, action);
"""
# The box number of a mark that says if its frame is done.
_FRAME = -1
_FRAMES = f"""
SELECT number, coalesce((
    SELECT m.mark = 'done' FROM mark m JOIN action a ON a.id = m.action
    WHERE a.undone = 0 AND m.frame = number AND m.box = {_FRAME} ORDER BY a.id DESC LIMIT 1
), 0) FROM frame ORDER BY place
"""
# The actions on a frame by one person, and those without a name.
_OWN = "frame = ? AND who IN (?, '')"
_LAST = "SELECT who FROM action WHERE who != '' ORDER BY id DESC LIMIT 1"
# SQLite takes the other columns from the row that has the maximum.
_CURRENT = """
SELECT m.frame, m.box, m.mark, a.who, x1, y1, x2, y2, max(m.action)
FROM mark m JOIN action a ON a.id = m.action
LEFT JOIN place p ON p.action = m.action AND p.frame = m.frame AND p.box = m.box
WHERE a.undone = 0 AND m.box >= 0 AND m.frame = coalesce(?, m.frame)
GROUP BY m.frame, m.box ORDER BY m.frame, m.box
"""
# The last mark of each person, for boxes that several have marked.
_BY_PERSON = """
SELECT frame, box, who, mark FROM (
    SELECT m.frame, m.box, a.who, m.mark, max(m.action),
        count(*) OVER (PARTITION BY m.frame, m.box) people
    FROM mark m JOIN action a ON a.id = m.action
    WHERE a.undone = 0 AND m.box >= 0 GROUP BY m.frame, m.box, a.who
) WHERE people > 1 ORDER BY frame, box, who
"""


@dataclass(frozen=True, slots=True)
class Label:
    """The mark on a box. ``box`` counts from 0 among the detections of ``frame``, or from `DRAWN`
    for a drawn box.

    ``place`` (left, top, right, bottom; pixels) is where a person drew the box or moved it to, None
    for the detection's own. ``who`` is the labeller; comparisons ignore it.

    Attributes
    ----------
    frame : number of the frame, from 1.
    mark : what the box is.
    """

    frame: int
    box: int
    mark: Mark
    place: tuple[float, float, float, float] | None = None
    who: str = field(default="", compare=False)


@dataclass(frozen=True, slots=True)
class Progress:
    """Number of frames that are done, and of all; of boxes marked as false, as births, and drawn;
    and of disputed boxes.

    Attributes
    ----------
    done, frames : frames that are done, and all.
    false, births, drawn : boxes marked as false alarms, as births, and drawn by hand.
    disputed : boxes that labellers mark differently.
    """

    done: int
    frames: int
    false: int
    births: int
    drawn: int = 0
    disputed: int = 0


def last_labeller(path: Path) -> str:
    """The name under which the last marks were made in a file of labels, or else in the newest of
    those beside it; empty if there is none.
    """
    others = sorted(
        (other for other in path.parent.glob("*.labels.sqlite") if other != path),
        key=lambda other: other.stat().st_mtime,
        reverse=True,
    )
    for file in filter(Path.is_file, (path, *others)):
        try:
            with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as db:
                found = db.execute(_LAST).fetchone()
        except sqlite3.DatabaseError:
            # Another program's file, which cannot tell.
            continue
        if found:
            return str(found[0])
    return ""


@dataclass(frozen=True, slots=True)
class LabelStore:
    """The labels in one file. Each method opens it, does one thing completely or not at all, and
    closes it.

    Parameters
    ----------
    path : the SQLite file.
    """

    path: Path

    @classmethod
    def open(cls, path: Path, source: str, digest: str, frames: Sequence[int]) -> LabelStore:
        """The labels of some detections; a missing file is made, an existing one continued. Raises
        `InputError` if it is of other detections, or no file of labels.

        Parameters
        ----------
        path : of the file.
        source, digest : name of the video or file, and a digest of its detections.
        frames : numbers to label, in the order to show them; those in the file stay in front.
        """
        store = cls(path)
        about = {
            "format": FORMAT,
            "source": readable_name(source),
            "detections": digest,
            "name": secrets.token_hex(8),
        }
        try:
            with store._connection() as db, db:
                db.executescript(_TABLES)
                known = about | dict(db.execute("SELECT name, value FROM about"))
                if known["format"] != FORMAT:
                    raise InputError(
                        f"expected labels of format {FORMAT}, got {known['format']!r}", where=path
                    )
                if known["detections"] != digest:
                    problem = (
                        f"these marks were made on other detections (of {known['source']}) than"
                        f" those to be used now (of {source})"
                    )
                    raise InputError(
                        problem,
                        where=path,
                        cure="Say the same --detections or --detector as when they were made, or"
                        " another --labels file.",
                    )
                db.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", known.items())
                place = "(SELECT coalesce(max(place) + 1, 0) FROM frame)"
                rows = [(int(number),) for number in frames]
                db.executemany(
                    f"INSERT OR IGNORE INTO frame (number, place) VALUES (?, {place})", rows
                )
        except sqlite3.DatabaseError as error:
            raise InputError(f"cannot be used as a file of labels ({error})", where=path) from None
        return store

    @property
    def name(self) -> str:
        """A random name that the file keeps when it is moved."""
        return str(self._rows("SELECT value FROM about WHERE name = 'name'")[0][0])

    @property
    def digest(self) -> str:
        """The digest of the detections that are labelled."""
        return str(self._rows("SELECT value FROM about WHERE name = 'detections'")[0][0])

    @property
    def ports(self) -> range:
        """Ports for the page of this file, always the same: a browser stores data by port."""
        first = 20_000 + int(self.name, 16) % 12_000
        return range(first, first + 8)

    def mark(self, frame: int, marks: Iterable[Label], who: str = "", key: str = "") -> None:
        """Save marks as one action; of two on one box the last counts. Raises `InputError` for no
        mark, an unknown one, and a place that is invalid or that the mark cannot have.

        Parameters
        ----------
        frame : the frame on the page; the marks may be on others.
        marks : one or more.
        who, key : the labeller, and a text by which a repeated request is recognised.
        """
        labels = list(marks)
        if not labels:
            raise InputError("expected a mark or more", where=f"frame {frame}")
        for label in labels:
            _check(label)
        self._act(frame, labels, who, key)

    def mark_false(self, table: DetectionTable, truth: Truth) -> None:
        """Mark the detections that are on no annotated object (`NO_OBJECT`) as false, on all
        frames, and set these done.

        Parameters
        ----------
        table : the detections that are labelled.
        truth : the annotated objects of the same frames.
        """
        for number, _ in self.frames():
            overlap = iou(table.at(number).xyxy, truth.xyxy[truth.frame == number])
            false = np.flatnonzero(overlap.max(axis=1, initial=0) < NO_OBJECT)
            if len(false):
                self.mark(number, [Label(number, box, "false") for box in false.tolist()])
            self.finish(number)

    def undo(self, frame: int, key: str = "", who: str = "", *, again: bool = False) -> None:
        """Undo the last action on a frame, if there is one.

        Parameters
        ----------
        frame : its number.
        who, key : as in `mark`; actions without a name are everybody's.
        again : redo the action that was undone last instead.
        """
        chosen = (
            f"SELECT {'min' if again else 'max'}(id) FROM action WHERE {_OWN} AND undone ="
            f" {int(again)}"
        )
        self._change(
            key,
            (f"UPDATE action SET undone = {int(not again)} WHERE id = ({chosen})", [(frame, who)]),
        )

    def finish(self, frame: int, done: bool = True, key: str = "", who: str = "") -> None:
        """Set a frame done: a person has looked at it. `undo` takes that back. Frames without false
        boxes are set done too.

        Parameters
        ----------
        frame : its number.
        done : False for a frame that is not done after all.
        who, key : as in `mark`.
        """
        self._act(frame, [Label(frame, _FRAME, cast(Mark, "done" if done else "none"))], who, key)

    def steps(self, frame: int, who: str = "") -> tuple[int, int]:
        """Number of actions on ``frame`` that ``who`` can undo, and redo."""
        known = [
            undone
            for (undone,) in self._rows(f"SELECT undone FROM action WHERE {_OWN}", frame, who)
        ]
        return known.count(0), known.count(1)

    def labels(self, frame: int | None = None) -> list[Label]:
        """The labels of all boxes, or of one ``frame``; boxes that are marked ``none`` are left
        out.
        """
        return [
            Label(number, box, mark, None if place[0] is None else tuple(place), who)
            for number, box, mark, who, *place, _ in self._rows(_CURRENT, frame)
            if mark != "none"
        ]

    def disputes(self) -> dict[tuple[int, int], dict[str, str]]:
        """The boxes that labellers mark differently: by frame and box, each labeller's last mark.

        A detection whose mark a labeller removed, or that he moved, counts as true.
        """
        marks_of = dict[tuple[int, int], dict[str, str]]()
        for frame, box, who, mark in self._rows(_BY_PERSON):
            marks_of.setdefault((frame, box), {})[who] = (
                "true" if mark == "none" and box < DRAWN else mark
            )
        return {box: marks for box, marks in marks_of.items() if len(set(marks.values())) > 1}

    def frames(self) -> list[tuple[int, bool]]:
        """The frames to label in the order to show them, with True for those that are done."""
        return [(number, bool(done)) for number, done in self._rows(_FRAMES)]

    def progress(self) -> Progress:
        """The progress of the work."""
        done = [done for _, done in self.frames()]
        labels = self.labels()
        marks = [label.mark for label in labels]
        drawn = sum(label.box >= DRAWN for label in labels)
        return Progress(
            sum(done),
            len(done),
            marks.count("false"),
            marks.count("birth"),
            drawn,
            len(self.disputes()),
        )

    def _rows(self, query: str, *values: int | str | None) -> list[tuple[Any, ...]]:
        """The rows that a query returns."""
        with self._connection() as db:
            return db.execute(query, values).fetchall()

    def _act(self, frame: int, labels: Sequence[Label], who: str, key: str) -> None:
        """Save labels as one action on ``frame``; of two on one box the last."""
        last = {(label.frame, label.box): label for label in labels}.values()
        self._change(
            key,
            # A new action makes undone ones final: redoing them would mix the two.
            (f"UPDATE action SET undone = 2 WHERE {_OWN} AND undone = 1", [(frame, who)]),
            ("INSERT INTO action (frame, who) VALUES (?, ?)", [(frame, who)]),
            (
                "INSERT INTO mark SELECT max(id), ?, ?, ? FROM action",
                [(one.frame, one.box, one.mark) for one in last],
            ),
            (
                "INSERT INTO place SELECT max(id), ?, ?, ?, ?, ?, ? FROM action",
                [(one.frame, one.box, *one.place) for one in last if one.place is not None],
            ),
        )

    def _change(self, key: str, *steps: tuple[str, Sequence[tuple[object, ...]]]) -> None:
        """Execute all steps, each a statement and its rows, or none if ``key`` has been seen."""
        with self._connection() as db, db:
            # No other connection writes from here on: what is read must still hold when it is
            # written.
            db.execute("BEGIN IMMEDIATE")
            if key and not db.execute("INSERT OR IGNORE INTO request VALUES (?)", (key,)).rowcount:
                return
            for statement, rows in steps:
                db.executemany(statement, rows)

    def _connection(self) -> closing[sqlite3.Connection]:
        """An open connection; an action is on disk before the page is told that it is saved."""
        db = sqlite3.connect(self.path, timeout=_TIMEOUT)
        db.execute("PRAGMA synchronous = FULL")
        return closing(db)


def _check(label: Label) -> None:
    """Raise `InputError` if a box cannot have this mark or place."""
    box = label.box
    mark = label.mark
    place = label.place
    if mark not in MARKS or not 0 <= box < 2 * DRAWN:
        raise InputError(
            f"expected one of {', '.join(MARKS)} on a box from 0, got {mark!r} on {box}"
        )
    problem = ""
    if place is None and (mark == "true" or (mark == "birth" and box >= DRAWN)):
        problem = f"expected the place of box {box}, got none"
    elif place is not None and mark in ("false", "none"):
        problem = f"expected no place of a box that is marked {mark}, got {place}"
    elif mark == "false" and box >= DRAWN:
        problem = "expected a detection to be marked as false, got a box that was drawn"
    elif place and not (
        max(map(abs, place)) < _FAR and place[2] > place[0] and place[3] > place[1]
    ):
        problem = f"expected left < right and top < bottom in pixels, got {place}"
    if problem:
        raise InputError(problem, where=f"frame {label.frame}")
