"""Files of a live camera: rows by the hour and videos, each with a quota, and a log of events.

Each camera has a folder:

* ``tracks/2026-11-24T05.csv``: the online rows of an hour (UTC), or ``.parquet``;
* ``video/2026-11-24T05-10-00.mp4``: annotated pictures, ten minutes each;
* ``snapshots/2026-11-24T05-10-00.250Z-321.jpg``: the annotated picture of events at a place, with
  its frame number; the last ones;
* ``events.sqlite``: a table of events, and the last event that each receiver has;
* ``events.jsonl``: the events as JSON lines.

An incomplete file ends in ``.part``. An event is on disk before it is sent.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np

from phdtrack.errors import InputError, needed
from phdtrack.files import PART, whole
from phdtrack.types import Image, Tracks
from phdtrack.video import VideoWriter

_LINES = "events.jsonl"
# Milliseconds to wait for another process that writes into the table, while a camera waits.
_IMPATIENT = "PRAGMA busy_timeout=200"
_TABLES = (
    "PRAGMA journal_mode=WAL",
    "PRAGMA synchronous=FULL",
    (
        "CREATE TABLE IF NOT EXISTS events (id TEXT PRIMARY KEY, time TEXT, kind TEXT, place TEXT,"
        " identity INTEGER, event TEXT NOT NULL)"
    ),
    "CREATE TABLE IF NOT EXISTS receivers (name TEXT PRIMARY KEY, has INTEGER NOT NULL)",
    (
        "CREATE TABLE IF NOT EXISTS watched (one INTEGER PRIMARY KEY, number INTEGER NOT NULL,"
        " state BLOB NOT NULL)"
    ),
)
# The number of the next row; no event has had it, even if somebody has deleted rows.
_NEXT = (
    "(SELECT 1 + MAX(COALESCE(MAX(rowid), 0), (SELECT COALESCE(MAX(has), 0) FROM receivers)) FROM"
    " events)"
)
_ADD = (
    f"INSERT OR IGNORE INTO events (rowid, id, time, kind, place, identity, event) VALUES ({_NEXT},"
    " ?, ?, ?, ?, ?, ?)"
)
_WAITING = (
    "SELECT rowid, id, event FROM events WHERE rowid > (SELECT has FROM receivers WHERE name = ?)"
    " ORDER BY rowid LIMIT ?"
)
HEAD = "time,frame,identity,class,left,top,width,height,confidence,detection,confirmed\n"
Notice = dict[str, object]
"""An event for JSON."""
HOUR = 3600.0
SEGMENT = 600.0
_ROW = "%s,%d,%d,%d,%.7g,%.7g,%.7g,%.7g,%.4g,%d,%d\n"


def stamp(wall: float) -> str:
    """ISO time in UTC of seconds since 1970, as 2026-11-24T05:10:00.250Z."""
    return (
        datetime.fromtimestamp(wall, UTC).isoformat(timespec="milliseconds").removesuffix("+00:00")
        + "Z"
    )


class Segments:
    """The files of a folder, one per period; beyond the quota the oldest are removed.

    Parameters
    ----------
    folder : is made if it is missing.
    suffix : of the files.
    seconds : length of a period; periods begin at multiples of it since 1970.
    quota : bytes of all complete files together; 0: no limit.
    """

    def __init__(self, folder: Path, suffix: str, seconds: float, quota: int = 0) -> None:
        self.folder = folder
        self._suffix = suffix
        self._seconds = seconds
        self._quota = quota
        self._period = -1
        self.open: Path | None = None
        folder.mkdir(parents=True, exist_ok=True)

    def over(self, wall: float) -> bool:
        """True if the time lies in another period than the open file, or no file is open."""
        return self.open is None or int(wall // self._seconds) != self._period

    def begin(self, wall: float) -> Path:
        """The incomplete file of the period that this time lies in."""
        self._period = int(wall // self._seconds)
        start = datetime.fromtimestamp(self._period * self._seconds, UTC)
        name = start.strftime("%Y-%m-%dT%H" if self._seconds >= HOUR else "%Y-%m-%dT%H-%M-%S")
        count = 1
        while any(
            self._path(name, count).with_suffix(suffix).exists()
            for suffix in (self._suffix, ".parquet")
        ):
            count += 1
        self.open = self._path(name, count).with_name(self._path(name, count).name + PART)
        return self.open

    def finish(self) -> Path | None:
        """Give the open file its name; remove the oldest files beyond the quota."""
        done = None
        if self.open is not None and self.open.exists():
            done = self.open.with_name(self.open.name.removesuffix(PART))
            self.open.replace(done)
        self.open = None
        self.prune()
        return done

    def left(self) -> list[Path]:
        """The incomplete files of an earlier run, oldest first."""
        return sorted(self.folder.glob(f"*{self._suffix}{PART}"), key=_age)

    def complete(self) -> list[Path]:
        """The complete files, oldest first."""
        return sorted((file for file in self.folder.iterdir() if file.suffix != PART), key=_age)

    def prune(self) -> None:
        """Remove the oldest complete files until all are within the quota."""
        files = self.complete()
        sizes = [file.stat().st_size for file in files]
        while self._quota and files and sum(sizes) > self._quota:
            files.pop(0).unlink()
            sizes.pop(0)

    def _path(self, name: str, count: int) -> Path:
        return self.folder / f"{name}{f'.{count}' if count > 1 else ''}{self._suffix}"


def _age(file: Path) -> tuple[str, int]:
    """Sort key by age: the period in the file's name, and the number within it."""
    period, _, rest = file.name.partition(".")
    count = rest.partition(".")[0]
    return period, int(count) if count.isdecimal() else 1


class RowsLog:
    """Online rows by the hour, as text. With ``parquet`` each complete hour is converted to a
    Parquet file.
    """

    def __init__(self, folder: Path, quota: int = 0, *, parquet: bool = False) -> None:
        self._segments = Segments(folder, ".csv", HOUR, quota)
        self._parquet = parquet
        self._file: TextIO | None = None
        for left in self._segments.left():
            _whole_lines(left)
            left.replace(left.with_name(left.name.removesuffix(PART)))
        # A run that was killed during the conversion leaves a part of a file, or an hour twice.
        for file in folder.glob("*.parquet*"):
            (file if file.suffix == PART else file.with_suffix(".csv")).unlink(missing_ok=True)

    def write(self, rows: Tracks, wall: float) -> None:
        """Append the rows of a frame, perhaps none, and flush them; ``wall``: its seconds since
        1970.
        """
        if self._file is not None and self._segments.over(wall):
            self.finish()
        if not len(rows):
            return
        # No file is open at the beginning, and after one could not be opened.
        if self._file is None:
            self._file = self._segments.begin(wall).open("w", encoding="ascii", newline="\n")
            self._file.write(HEAD)
        boxes = np.hstack([rows.xyxy[:, :2], rows.xyxy[:, 2:] - rows.xyxy[:, :2]])
        columns = (
            rows.frame,
            rows.identity,
            rows.class_id,
            *boxes.T,
            rows.confidence,
            rows.detection,
            rows.confirmed,
        )
        values = zip(*(column.tolist() for column in columns), strict=True)
        self._file.write("".join(_ROW % (stamp(wall), *row) for row in values))
        self._file.flush()

    def last_frame(self) -> int:
        """Frame number of the newest row on disk; 0 if there is none, or it cannot be read."""
        for file in reversed(self._segments.complete()):
            # Files that somebody has changed or cut are skipped.
            with suppress(OSError, ValueError, IndexError):
                if file.suffix == ".parquet":
                    with file.open("rb") as content:
                        table = needed("pyarrow.parquet").read_table(content, columns=["frame"])
                    return int(table["frame"][-1].as_py())
                return int(_last_line(file).split(",")[1])
        return 0

    def close(self) -> None:
        """Close the open file and leave it incomplete, as a killed run does; another `RowsLog`
        completes it.
        """
        if self._file is not None:
            self._file.close()
            self._file = None

    def finish(self) -> None:
        """Complete the open file, as Parquet if that was asked for. Raises `InputError` without
        pyarrow.
        """
        if self._file is None:
            return
        self._file.flush()
        os.fsync(self._file.fileno())
        self.close()
        done = self._segments.finish()
        if done is not None and self._parquet:
            csv, parquet = (needed(f"pyarrow.{name}") for name in ("csv", "parquet"))
            file = done.with_suffix(".parquet")
            # Arrow opens files of names in UTF-8 only.
            with done.open("rb") as rows, whole(file) as part, part.open("wb") as content:
                parquet.write_table(csv.read_csv(rows), content, compression="zstd")
            done.unlink()


class VideoLog:
    """Annotated pictures in videos of ten minutes, in real time: each picture stays until the next.

    After a gap of more than ``longest`` seconds a new file begins.
    """

    def __init__(self, folder: Path, fps: float, quota: int = 0, *, longest: float = 5.0) -> None:
        self._segments = Segments(folder, ".mp4", SEGMENT, quota)
        self._fps = fps
        self._longest = longest
        self._video: VideoWriter | None = None
        self._start = self._last = 0.0
        for left in self._segments.left():
            if _whole_fragments(left):
                left.replace(left.with_name(left.name.removesuffix(PART)))
            else:
                left.unlink()

    def due(self, wall: float) -> bool:
        """True if a picture of this time would be shown, False if it follows the last too soon."""
        return (
            self._video is None
            or wall < self._last
            or round((wall - self._start) * self._fps) >= self._video.frames
        )

    def write(self, image: Image, wall: float) -> None:
        """Show a picture, (H, W, 3) BGR, from this time on."""
        ended = self._segments.over(wall) or wall - self._last > self._longest or wall < self._last
        if self._video is None or ended:
            self.finish()
            height, width = image.shape[:2]
            self._video = VideoWriter(
                self._segments.begin(wall), width, height, self._fps, fragmented=True
            )
            self._start = wall
        due = round((wall - self._start) * self._fps) + 1 - self._video.frames
        for _ in range(due):
            self._video.write(image)
        self._last = wall

    def finish(self) -> None:
        """Complete the open file."""
        if self._video is not None:
            self._video.close()
            self._video = None
            self._segments.finish()


class SnapshotLog:
    """Pictures of events as JPEG files; beyond the ``most`` the oldest are removed."""

    def __init__(self, folder: Path, most: int) -> None:
        self._folder = folder
        self._most = most
        self.newest: Path | None = None
        """The last one that was written."""
        if most:
            folder.mkdir(parents=True, exist_ok=True)

    def write(self, picture: bytes, number: int, wall: float) -> Path:
        """Write a picture, and return its file. Raises `OSError` if it cannot be written.

        Parameters
        ----------
        picture : JPEG.
        number, wall : of the frame, and its seconds since 1970.
        """
        file = self._folder / f"{stamp(wall).replace(':', '-')}-{number}.jpg"
        with whole(file) as part:
            part.write_bytes(picture)
        # The names begin with the time.
        for old in sorted(self._folder.glob("*.jpg"))[: -self._most]:
            old.unlink(missing_ok=True)
        self.newest = file
        return file


class EventLog:
    """Events in an SQLite table, each once, with the last event that each receiver has; and the
    same events as JSON lines.

    The table is authoritative: one transaction saves the events and the visitors after them. The
    file of lines is a receiver like others; it may lag behind, ``problem`` gives the reason, and it
    may be moved away.

    At the start, and for a new receiver, it waits ``patience`` seconds for another process that
    writes into the table. Raises `InputError` if the files cannot be written.
    """

    def __init__(self, folder: Path, patience: float = 5.0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / _LINES
        self._patient = f"PRAGMA busy_timeout={round(1000 * patience)}"
        self._lock = threading.Lock()
        self._closed = False
        self.problem = ""
        try:
            self._base = sqlite3.connect(
                folder / "events.sqlite", check_same_thread=False, isolation_level=None
            )
            for statement in (self._patient, *_TABLES):
                self._base.execute(statement)
            self._find_last_line()
            self._base.execute(_IMPATIENT)
        except (OSError, sqlite3.Error) as error:
            cure = "Does another program hold events.sqlite? If not, choose another --out."
            raise InputError(
                f"the events cannot be written: {error}", where=folder, cure=cure
            ) from None
        self._add_lines()

    def write(
        self, events: Iterable[Notice], watched: tuple[int, bytes] | None = None
    ) -> list[Notice]:
        """Write events, and return those that are new. Raises `sqlite3.Error` if nothing was
        written.

        Parameters
        ----------
        events : each with at least ``id``, ``time`` and ``kind``.
        watched : number of the frame, and the visitors after it as bytes; None leaves the last
        ones.
        """
        fresh = []
        with self._lock:
            with self._transaction():
                for event in events:
                    values = [
                        event.get(name) for name in ("id", "time", "kind", "place", "identity")
                    ]
                    sentence = json.dumps(event, ensure_ascii=False, allow_nan=False)
                    if self._base.execute(_ADD, (*values, sentence)).rowcount:
                        fresh.append(event)
                if watched is not None:
                    self._base.execute(
                        "REPLACE INTO watched (one, number, state) VALUES (1, ?, ?)", watched
                    )
            self._add_lines()
        return fresh

    def watched(self) -> tuple[int, bytes] | None:
        """The last ``watched`` that was written; None if there is none."""
        with self._lock:
            found: tuple[int, bytes] | None = self._base.execute(
                "SELECT number, state FROM watched"
            ).fetchone()
            return found

    def forget_watched(self) -> None:
        """Forget the visitors and the frame number that were written."""
        with self._lock:
            self._base.execute("DELETE FROM watched")

    def highest(self, kind: str = "") -> int:
        """The highest identity of all events, or of those of a kind."""
        with self._lock:
            ((found,),) = self._base.execute(
                "SELECT MAX(identity) FROM events WHERE ? IN ('', kind)", (kind,)
            )
            return int(found or 0)

    def register(self, receiver: str) -> None:
        """Add a receiver of all events from now on; a known one continues after its last event.

        Raises `InputError` if that cannot be written.
        """
        try:
            with self._lock:
                self._base.execute(self._patient)
                self._base.execute(
                    f"INSERT OR IGNORE INTO receivers (name, has) VALUES (?, {_NEXT} - 1)",
                    (receiver,),
                )
                self._base.execute(_IMPATIENT)
        except sqlite3.Error as error:
            where = self._path.with_suffix(".sqlite")
            cure = "Does another program hold it?"
            raise InputError(f"cannot be written into ({error})", where=where, cure=cure) from None

    def waiting(self, receiver: str, most: int = 100) -> list[tuple[int, str, str]]:
        """Row number, identifier and JSON of the oldest events that a receiver does not have."""
        with self._lock:
            return list(self._base.execute(_WAITING, (receiver, most)))

    def delivered(self, receiver: str, row: int) -> None:
        """Record that a receiver has the event in this row and all before it."""
        with self._lock:
            self._base.execute("UPDATE receivers SET has = ? WHERE name = ?", (row, receiver))

    def close(self) -> None:
        """Close the table. Raises `InputError` if the file of lines lacks some events."""
        with self._lock:
            if not self._closed:
                self._add_lines()
            self._base.close()
            self._closed = True
        if self.problem:
            raise InputError(self.problem)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """A transaction: everything in the block is on disk when it ends, or nothing."""
        self._base.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._base.execute("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                self._base.execute("ROLLBACK")
            raise

    def _find_last_line(self) -> None:
        """Find the last event in the file of lines; a killed run may have written more than it
        recorded, or half a line.
        """
        self._base.execute("INSERT OR IGNORE INTO receivers (name, has) VALUES (?, 0)", (_LINES,))
        if not self._path.exists():
            return
        _whole_lines(self._path)
        with suppress(ValueError, TypeError, KeyError, RecursionError):
            last = str(json.loads(_last_line(self._path))["id"])
            found = self._base.execute("SELECT rowid FROM events WHERE id = ?", (last,)).fetchone()
            self._base.execute("UPDATE receivers SET has = ? WHERE name = ?", (*found, _LINES))

    def _add_lines(self) -> None:
        """Bring the file of lines up to date."""
        try:
            if self.problem:
                self._find_last_line()
            while waiting := self._base.execute(_WAITING, (_LINES, 1000)).fetchall():
                # It may have been moved away meanwhile.
                with self._path.open("a", encoding="utf-8", newline="\n") as file:
                    file.writelines(f"{event}\n" for _, _, event in waiting)
                    file.flush()
                    os.fsync(file.fileno())
                self._base.execute(
                    "UPDATE receivers SET has = ? WHERE name = ?", (waiting[-1][0], _LINES)
                )
            self.problem = ""
        except (OSError, sqlite3.Error) as error:
            self.problem = f"{_LINES} is still to be brought up to date: {error}"


def _last_line(path: Path) -> str:
    """The last complete line of a text file; empty if there is none."""
    with path.open("rb") as file:
        end = file.seek(0, os.SEEK_END)
        file.seek(max(0, end - 65536))
        return file.read().rpartition(b"\n")[0].rpartition(b"\n")[2].decode("utf-8", "replace")


def _whole_lines(path: Path) -> None:
    """Cut a text file after its last complete line; a killed run wrote a part of the next."""
    with path.open("r+b") as file:
        end = file.seek(0, os.SEEK_END)
        while end > 0:
            start = max(0, end - 65536)
            file.seek(start)
            newline = file.read(end - start).rfind(b"\n")
            if newline >= 0:
                file.truncate(start + newline + 1)
                return
            end = start
        file.truncate(0)


def _whole_fragments(path: Path) -> bool:
    """Cut a fragmented video after its last complete fragment. False if it has none."""
    with path.open("r+b") as file:
        end = file.seek(0, os.SEEK_END)
        at = 0
        whole = 0
        while at + 8 <= end:
            file.seek(at)
            size = int.from_bytes(file.read(4), "big")
            kind = file.read(4)
            if size < 8 or at + size > end:
                break
            at += size
            # The pictures of a fragment follow its description.
            whole = at if kind == b"mdat" else whole
        file.truncate(whole)
    return whole > 0
