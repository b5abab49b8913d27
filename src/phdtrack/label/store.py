"""Labels of detections in one SQLite file: every mark is kept the moment it is made, by however many people at once.

A file is a list of actions, each of one or more marks; nothing is ever overwritten. The last mark on a box whose action is
not undone counts. So undoing is a flag, and of two people who mark the same box both keep their click. A page that does not
know whether its click arrived sends it again: what carries a ``key`` that the file has seen changes nothing.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from phdtrack.errors import InputError

Mark = Literal["false", "birth", "none"]
"""``false``: the detector is wrong there. ``birth``: a target enters there. ``none``: neither, after all."""
MARKS: tuple[str, ...] = get_args(Mark)
FORMAT = "1"
_PATIENCE = 30.0

_TABLES = """
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
CREATE TABLE IF NOT EXISTS told (key TEXT PRIMARY KEY) STRICT;
CREATE INDEX IF NOT EXISTS mark_by_box ON mark (frame, box, action);
"""
# SQLite takes the columns beside max(…) from the row that has the maximum.
_CURRENT = """
SELECT m.frame, m.box, m.mark, max(m.action) FROM mark m JOIN action a ON a.id = m.action
WHERE a.undone = 0 {where} GROUP BY m.frame, m.box ORDER BY m.frame, m.box
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


class LabelStore:
    """The labels in one file. Every method opens it, does one thing wholly or not at all, and closes it."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def open(cls, path: Path, source: str, digest: str, frames: Sequence[int]) -> LabelStore:
        """The labels of some detections; the file is made where there is none, gone on with where there is.

        Parameters
        ----------
        path : of the file.
        source, digest : name of the video or file, and a digest of its detections.
        frames : numbers to label, in the order to show them; those that a file holds already stay, in front.

        Returns
        -------
        The labels.

        Raises
        ------
        InputError : the file is that of other detections, or no file of labels.
        """
        store = cls(path)
        try:
            with store._connection() as db:
                db.executescript("PRAGMA journal_mode = WAL;" + _TABLES)
                with db:
                    known = dict(db.execute("SELECT name, value FROM about"))
                    if known.get("format", FORMAT) != FORMAT:
                        raise InputError(f"expected labels of format {FORMAT}, got {known['format']!r}", where=path)
                    if known.get("detections", digest) != digest:
                        problem = (
                            f"the labels are those of other detections (of {known.get('source')}), not of these of {source}"
                        )
                        raise InputError(problem, where=path, cure="Give another --labels file, or the detections of then")
                    about = {"format": FORMAT, "source": source, "detections": digest}
                    db.executemany("INSERT OR IGNORE INTO about VALUES (?, ?)", about.items())
                    (after,) = db.execute("SELECT coalesce(max(place) + 1, 0) FROM frame").fetchone()
                    rows = [(int(number), after + k) for k, number in enumerate(frames)]
                    db.executemany("INSERT OR IGNORE INTO frame (number, place) VALUES (?, ?)", rows)
        except sqlite3.DatabaseError as error:
            raise InputError(f"cannot be used as a file of labels ({error})", where=path) from None
        return store

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
        rows = list(marks)
        if not rows:
            raise InputError("expected a mark or more", where=f"frame {frame}")
        for row in rows:
            if row.mark not in MARKS or row.box < 0:
                raise InputError(f"expected one of {', '.join(MARKS)} on a box from 0, got {row.mark!r} on {row.box}")
        with self._change(key) as db:
            number = db.execute("INSERT INTO action (frame, who) VALUES (?, ?)", (frame, who)).lastrowid
            # What was undone before is gone for good once something new was done: redoing would mix the two.
            db.execute("UPDATE action SET undone = 2 WHERE frame = ? AND undone = 1", (frame,))
            db.executemany(
                "INSERT OR REPLACE INTO mark VALUES (?, ?, ?, ?)", [(number, m.frame, m.box, m.mark) for m in rows]
            )

    def undo(self, frame: int, key: str = "") -> None:
        """Take back the last action made on ``frame``, if there is one."""
        self._turn("SELECT max(id) FROM action WHERE frame = ? AND undone = 0", frame, 1, key)

    def redo(self, frame: int, key: str = "") -> None:
        """Make the action on ``frame`` that was undone last count again, if there is one."""
        self._turn("SELECT min(id) FROM action WHERE frame = ? AND undone = 1", frame, 0, key)

    def finish(self, frame: int, done: bool = True, key: str = "") -> None:
        """Say that a frame has been looked at. One without false boxes is looked at too.

        Parameters
        ----------
        frame : its number.
        done : False where it has not been looked at after all.
        key : as in `mark`.
        """
        with self._change(key) as db:
            db.execute("UPDATE frame SET done = ? WHERE number = ?", (int(done), frame))

    def steps(self, frame: int) -> tuple[int, int]:
        """How many actions on ``frame`` can be undone and redone."""
        question = "SELECT coalesce(sum(undone = 0), 0), coalesce(sum(undone = 1), 0) FROM action WHERE frame = ?"
        with self._connection() as db:
            undo, redo = db.execute(question, (frame,)).fetchone()
        return int(undo), int(redo)

    def labels(self, frame: int | None = None) -> list[Label]:
        """What every marked box is, or those of one ``frame``; boxes marked as ``none`` again are not listed."""
        where, values = ("", ()) if frame is None else ("AND m.frame = ?", (frame,))
        with self._connection() as db:
            rows = db.execute(_CURRENT.format(where=where), values).fetchall()
        return [Label(number, box, mark) for number, box, mark, _ in rows if mark != "none"]

    def frames(self) -> list[tuple[int, bool]]:
        """The frames to label in the order to show them, and which of them have been looked at."""
        with self._connection() as db:
            rows = db.execute("SELECT number, done FROM frame ORDER BY place").fetchall()
        return [(number, bool(done)) for number, done in rows]

    def progress(self) -> Progress:
        """How far the work is."""
        listed, labels = self.frames(), self.labels()
        births = sum(label.mark == "birth" for label in labels)
        return Progress(sum(done for _, done in listed), len(listed), len(labels) - births, births)

    def csv(self) -> str:
        """The labels as CSV: frame, box, mark."""
        lines = ["frame,box,mark", *(f"{label.frame},{label.box},{label.mark}" for label in self.labels())]
        return "\n".join(lines) + "\n"

    def _turn(self, which: str, frame: int, undone: int, key: str) -> None:
        with self._change(key) as db:
            (number,) = db.execute(which, (frame,)).fetchone()
            db.execute("UPDATE action SET undone = ? WHERE id = ?", (undone, number))

    @contextmanager
    def _change(self, key: str) -> Iterator[sqlite3.Connection]:
        """A connection for one change, kept when the block ends; undone where ``key`` has been seen before."""
        with self._connection() as db:
            # From the start alone with the file: what is read first must still hold when it is written.
            db.execute("BEGIN IMMEDIATE")
            seen = key and db.execute("SELECT 1 FROM told WHERE key = ?", (key,)).fetchone()
            try:
                if key and not seen:
                    db.execute("INSERT INTO told VALUES (?)", (key,))
                yield db
            except BaseException:
                db.rollback()
                raise
            if seen:
                db.rollback()
            else:
                db.commit()

    @contextmanager
    def _connection(self) -> Iterator[sqlite3.Connection]:
        db = sqlite3.connect(self.path, timeout=_PATIENCE)
        try:
            # A click is on the disk when the page is told that it was kept.
            db.execute("PRAGMA synchronous = FULL")
            yield db
        finally:
            db.close()
