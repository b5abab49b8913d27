"""Labels of detections in one SQLite file: every mark is kept the moment it is made, by however many people at once.

A file is a list of actions, each of one or more marks, or that a frame is done; nothing is ever overwritten. The last mark
on a box, or on a frame, whose action is not undone counts. So undoing is a flag, and of two people who mark the same box
both keep their click. A page that does not know whether its click arrived sends it again: what carries a ``key`` that the
file has seen changes nothing.
"""

from __future__ import annotations

import secrets
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from phdtrack.arrays import iou
from phdtrack.errors import InputError
from phdtrack.types import DetectionTable, Truth

Mark = Literal["false", "birth", "none"]
"""``false``: the detector is wrong there. ``birth``: a target enters there. ``none``: neither, after all."""
MARKS: tuple[str, ...] = get_args(Mark)
FORMAT = "1"
NO_OBJECT = 0.3
"""A box whose overlap (IoU) with every object is below this is on none."""
# Seconds to wait while another person's click is written.
_TIMEOUT = 30.0

_TABLES = """
PRAGMA journal_mode = WAL;
CREATE TABLE IF NOT EXISTS about (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE IF NOT EXISTS frame (
    number INTEGER PRIMARY KEY, place INTEGER NOT NULL, done INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE TABLE IF NOT EXISTS action (
    id INTEGER PRIMARY KEY AUTOINCREMENT, frame INTEGER NOT NULL, who TEXT NOT NULL, undone INTEGER NOT NULL DEFAULT 0,
    made TEXT NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
) STRICT;
CREATE TABLE IF NOT EXISTS mark (
    action INTEGER NOT NULL REFERENCES action (id), frame INTEGER NOT NULL, box INTEGER NOT NULL, mark TEXT NOT NULL,
    PRIMARY KEY (action, frame, box)
) STRICT;
CREATE TABLE IF NOT EXISTS request (key TEXT PRIMARY KEY) STRICT;
CREATE INDEX IF NOT EXISTS mark_by_box ON mark (frame, box, action);
"""
# What says of a frame, not of a box, whether it is done; files of before may have it beside the frame's number only.
_FRAME = -1
_FRAMES = f"""
SELECT number, coalesce((
    SELECT m.mark = 'done' FROM mark m JOIN action a ON a.id = m.action
    WHERE a.undone = 0 AND m.frame = number AND m.box = {_FRAME} ORDER BY a.id DESC LIMIT 1
), done) FROM frame ORDER BY place
"""
# SQLite takes the columns beside max(…) from the row that has the maximum.
_CURRENT = """
SELECT m.frame, m.box, m.mark, max(m.action) FROM mark m JOIN action a ON a.id = m.action
WHERE a.undone = 0 AND m.box >= 0 AND m.frame = coalesce(?, m.frame) GROUP BY m.frame, m.box ORDER BY m.frame, m.box
"""


@dataclass(frozen=True, slots=True)
class Label:
    """What a box is: ``box`` counts from 0 among the detections of ``frame``."""

    frame: int
    box: int
    mark: Mark


@dataclass(frozen=True, slots=True)
class Progress:
    """Frames looked at, of how many, and boxes marked as false and as births on all of them."""

    done: int
    frames: int
    false: int
    births: int


@dataclass(frozen=True, slots=True)
class LabelStore:
    """The labels in one file. Every method opens it, does one thing wholly or not at all, and closes it."""

    path: Path

    @classmethod
    def open(cls, path: Path, source: str, digest: str, frames: Sequence[int]) -> LabelStore:
        """The labels of some detections; the file is made where there is none, gone on with where there is.

        Parameters
        ----------
        path : of the file.
        source, digest : name of the video or file, and a digest of its detections.
        frames : numbers to label, in the order to show them; those that a file holds already stay, in front.

        Raises
        ------
        InputError : the file is that of other detections, or no file of labels.
        """
        store, about = cls(path), {"format": FORMAT, "source": source, "detections": digest, "name": secrets.token_hex(8)}
        try:
            with store._connection() as db, db:
                db.executescript(_TABLES)
                known = about | dict(db.execute("SELECT name, value FROM about"))
                if known["format"] != FORMAT:
                    raise InputError(f"expected labels of format {FORMAT}, got {known['format']!r}", where=path)
                if known["detections"] != digest:
                    problem = f"the labels are those of other detections (of {known['source']}), not of these of {source}"
                    raise InputError(problem, where=path, cure="Give another --labels file, or the detections of then")
                db.executemany("INSERT OR IGNORE INTO about VALUES (?, ?)", about.items())
                place = "(SELECT coalesce(max(place) + 1, 0) FROM frame)"
                rows = [(int(number),) for number in frames]
                db.executemany(f"INSERT OR IGNORE INTO frame (number, place) VALUES (?, {place})", rows)
        except sqlite3.DatabaseError as error:
            raise InputError(f"cannot be used as a file of labels ({error})", where=path) from None
        return store

    @property
    def name(self) -> str:
        """A random name that the file keeps for good, wherever it is moved."""
        return str(self._rows("SELECT value FROM about WHERE name = 'name'")[0][0])

    @property
    def ports(self) -> range:
        """Ports for the page of this file, the same each time: what a browser keeps for one port is not seen on others."""
        first = 20_000 + int(self.name, 16) % 12_000
        return range(first, first + 8)

    def mark(self, frame: int, marks: Iterable[Label], who: str = "", key: str = "") -> None:
        """Keep marks as one action; of two on one box the last counts.

        Parameters
        ----------
        frame : that was looked at meanwhile; the marks may be on others.
        marks : one or more.
        who, key : a name, and what tells that the same is sent again.

        Raises
        ------
        InputError : no mark, or an unknown one.
        """
        rows = [(label.frame, label.box, label.mark) for label in marks]
        if not rows:
            raise InputError("expected a mark or more", where=f"frame {frame}")
        for _, box, mark in rows:
            if mark not in MARKS or box < 0:
                raise InputError(f"expected one of {', '.join(MARKS)} on a box from 0, got {mark!r} on {box}")
        self._act(frame, rows, who, key)

    def mark_false(self, table: DetectionTable, truth: Truth) -> None:
        """Mark the detections that are on no annotated object, `NO_OBJECT`, on all frames, which are done then.

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

    def undo(self, frame: int, key: str = "") -> None:
        """Take back the last action made on ``frame``, if there is one."""
        last = "SELECT max(id) FROM action WHERE frame = ? AND undone = 0"
        self._change(key, (f"UPDATE action SET undone = 1 WHERE id = ({last})", [(frame,)]))

    def redo(self, frame: int, key: str = "") -> None:
        """Make the action on ``frame`` that was undone last count again, if there is one."""
        first = "SELECT min(id) FROM action WHERE frame = ? AND undone = 1"
        self._change(key, (f"UPDATE action SET undone = 0 WHERE id = ({first})", [(frame,)]))

    def finish(self, frame: int, done: bool = True, key: str = "") -> None:
        """Say that a frame has been looked at, which `undo` takes back. One without false boxes is looked at too.

        Parameters
        ----------
        frame : its number.
        done : False where it has not been looked at after all.
        key : as in `mark`.
        """
        self._act(frame, [(frame, _FRAME, "done" if done else "none")], "", key)

    def steps(self, frame: int) -> tuple[int, int]:
        """How many actions on ``frame`` can be undone and redone."""
        known = [undone for (undone,) in self._rows("SELECT undone FROM action WHERE frame = ?", frame)]
        return known.count(0), known.count(1)

    def labels(self, frame: int | None = None) -> list[Label]:
        """What every marked box is, or those of one ``frame``; boxes marked as ``none`` again are not listed."""
        return [Label(number, box, mark) for number, box, mark, _ in self._rows(_CURRENT, frame) if mark != "none"]

    def frames(self) -> list[tuple[int, bool]]:
        """The frames to label in the order to show them, and which of them have been looked at."""
        return [(number, bool(done)) for number, done in self._rows(_FRAMES)]

    def progress(self) -> Progress:
        """How far the work is."""
        done, marks = [done for _, done in self.frames()], [label.mark for label in self.labels()]
        return Progress(sum(done), len(done), marks.count("false"), marks.count("birth"))

    def csv(self) -> str:
        """The labels as CSV: frame, box, mark."""
        return "frame,box,mark\n" + "".join(f"{label.frame},{label.box},{label.mark}\n" for label in self.labels())

    def _rows(self, question: str, *values: int | None) -> list[tuple[Any, ...]]:
        """The answer to a question."""
        with self._connection() as db:
            return db.execute(question, values).fetchall()

    def _act(self, frame: int, rows: Sequence[tuple[int, int, str]], who: str, key: str) -> None:
        """Keep rows (frame, box, mark) as one action made on ``frame``."""
        self._change(
            key,
            # What was undone before is gone for good once something new was done: redoing would mix the two.
            ("UPDATE action SET undone = 2 WHERE frame = ? AND undone = 1", [(frame,)]),
            ("INSERT INTO action (frame, who) VALUES (?, ?)", [(frame, who)]),
            ("INSERT OR REPLACE INTO mark SELECT max(id), ?, ?, ? FROM action", rows),
        )

    def _change(self, key: str, *steps: tuple[str, Sequence[tuple[object, ...]]]) -> None:
        """Take all steps, a statement and its rows each, or none of them where ``key`` has been seen before."""
        with self._connection() as db, db:
            # From the start no other connection writes: what is read first must still hold when it is written.
            db.execute("BEGIN IMMEDIATE")
            if key and not db.execute("INSERT OR IGNORE INTO request VALUES (?)", (key,)).rowcount:
                return
            for statement, rows in steps:
                db.executemany(statement, rows)

    def _connection(self) -> closing[sqlite3.Connection]:
        """An open connection; a click is on the disk when the page learns that it was kept."""
        db = sqlite3.connect(self.path, timeout=_TIMEOUT)
        db.execute("PRAGMA synchronous = FULL")
        return closing(db)
