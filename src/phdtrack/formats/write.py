"""Writers of tracks, detections, states and truth as text.

A writer stays open while a sequence runs and passes every frame to the operating system at once:
if the program is killed, the results so far remain. The functions `write_tracks`,
`write_detections` and `write_truth` write a whole sequence. All files except the states are
MOTChallenge files without a header, which every tool of the field reads:

* tracks: ``frame,id,left,top,width,height,confidence,x,y,z,detection,confirmed``; x and y are
  metres on the ground and z is 0, or all three are −1 if the position is unknown; a 13th column has
  the class if there are classes;
* detections: ``frame,-1,left,top,width,height,confidence,-1,-1,-1,class``, followed by the 10
  values of the covariance if there is one (see `phdtrack.formats.table`);
* truth: ``frame,id,left,top,width,height,flag,class,visibility``, distractors with flag 0 and class
  8, as in MOT16.

States have a header: ``frame,time,weight,detection,left,top,width,height,s0,s1,…``. Frames count
from 1, times are seconds, boxes are pixels of the video, state components are those of the model.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, cannot_write, part_of, publish, readable_name
from phdtrack.types import (
    F8,
    I8,
    Bool,
    Detections,
    DetectionTable,
    Step,
    Tracks,
    Truth,
)

# Seven significant digits: a thousandth of a pixel in the largest images, without rounding small
# boxes in other units to nothing.
_BOX = "%.7g,%.7g,%.7g,%.7g"
_TRACK = f"%d,%d,{_BOX},%.7g,%.7g,%.7g,%d,%d,%d"
# Ten significant digits: the 32-bit floats of a detector are read back exactly, for another run.
_DETECTION = "%d,-1,%.10g,%.10g,%.10g,%.10g,%.10g,-1,-1,-1,%s"
_TRUTH = f"%d,%d,{_BOX},%d,%d,1"
_STATE_COLUMNS = ("frame", "time", "weight", "detection", "left", "top", "width", "height")
_PEDESTRIAN = 1
_DISTRACTOR = 8


class Lines:
    """A text file that is written line by line. Its name ends in ``.part`` until it is closed.

    ``close`` may be called twice. After a failed write the file is cut after the last complete
    block and keeps the name with ``.part``; it also keeps it if an error leaves the ``with`` block.
    Raises `InputError` if the file cannot be written.
    """

    def __init__(self, path: AnyPath) -> None:
        self.path = Path(path)
        self._whole = True
        self._end = 0
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = part_of(self.path).open("wb", buffering=0)
        except OSError as error:
            raise cannot_write(self.path, error) from None

    def write(self, pattern: str, *columns: F8 | I8 | Bool | NDArray[np.str_]) -> None:
        """Write one line for each row of the columns (M,) or (M, k), and pass all of them to the
        operating system.
        """
        width = pattern.count("%")
        values = [
            column.tolist()
            for block in columns
            for column in (block.T if block.ndim == 2 else block[None])
        ]
        if width:
            text = "".join([pattern % row + "\n" for row in zip(*values, strict=True)])
        else:
            text = f"{pattern}\n"
        if not text or not self._whole:
            return
        data = memoryview(readable_name(text).encode("utf-8"))
        try:
            written = 0
            while written < len(data):
                written += self._file.write(data[written:])
            self._end += written
        except OSError as error:
            self._whole = False
            with suppress(OSError):
                self._file.truncate(self._end)
            raise cannot_write(self.path, error) from None

    def close(self) -> None:
        """Close the file and give it its final name."""
        if self._file.closed:
            return
        self._file.close()
        if self._whole:
            try:
                publish(self.path)
            except OSError as error:
                raise cannot_write(self.path, error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._whole = self._whole and kind is None
        self.close()


class _ClassWriter(Lines):
    """A text file with classes by name, or by number if a class has no name."""

    def __init__(self, path: AnyPath, names: Mapping[int, str] | None = None) -> None:
        super().__init__(path)
        self._names = names

    def labels(self, class_id: I8) -> NDArray[np.str_]:
        """(N,) the classes as text, without characters that would break a line of CSV."""
        names = self._names or {}
        words = {
            number: re.sub(r'[^\S ]|[,;"]', "_", names.get(number, str(number)))
            for number in np.unique(class_id).tolist()
        }
        return np.array([words[number] for number in class_id.tolist()], np.str_)


class TracksWriter(_ClassWriter):
    """Writes ``tracks.csv`` frame by frame; with classes if ``names`` is given, which may be
    empty.
    """

    def append(self, tracks: Tracks, place: F8 | None = None) -> None:
        """Write the rows of one or more frames in the given order; ``place`` (2, M) is their
        position on the ground in metres, NaN if unknown.

        Parameters
        ----------
        tracks : boxes in pixels, frames from 1.
        place : (2, M) metres; None: not known.
        """
        if place is None:
            place = np.full((2, len(tracks)), np.nan)
        known = np.isfinite(place).all(axis=0)
        classes = [] if self._names is None else [self.labels(tracks.class_id)]
        self.write(
            _TRACK + ",%s" * len(classes),
            tracks.frame,
            tracks.identity,
            ltwh(tracks.xyxy),
            tracks.confidence,
            np.where(known, place, -1.0).T,
            np.where(known, 0, -1),
            tracks.detection,
            tracks.confirmed,
            *classes,
        )


class DetectionsWriter(_ClassWriter):
    """Writes ``detections.csv`` frame by frame. A frame without detections has no line, whether it
    was observed or not.
    """

    def append(self, frame: int | I8, detections: Detections) -> None:
        """Write the detections of frame ``frame``, from 1, or of many frames (N,). Either all calls
        have covariances, or none has.

        Parameters
        ----------
        frame : number of the frame from 1, or (N,) of each detection.
        detections : boxes in pixels.
        """
        columns: list[F8 | I8 | NDArray[np.str_]] = [
            np.broadcast_to(frame, len(detections)),
            ltwh(detections.xyxy),
            detections.confidence,
            self.labels(detections.class_id),
        ]
        if detections.covariance is None:
            self.write(_DETECTION, *columns)
        else:
            i, j = np.triu_indices(4)
            self.write(_DETECTION + ",%.10g" * 10, *columns, detections.covariance[:, i, j])


class StatesWriter(Lines):
    """Writes ``states.csv`` frame by frame: the extracted states, before association. The header is
    written with the first frame.
    """

    _header = ""

    def append(self, step: Step) -> None:
        """Write the states of a frame.

        Parameters
        ----------
        step : everything that the frame brought.
        """
        dim, n = step.estimates.state.shape
        estimates = step.estimates
        if not self._header:
            columns = [*_STATE_COLUMNS, *(f"s{i}" for i in range(dim))]
            self._header = ",".join(columns)
            self.write(self._header)
        self.write(
            f"%d,%.6f,%.7g,%d,{_BOX}" + ",%.9g" * dim,
            np.full(n, step.number),
            np.full(n, step.time),
            estimates.weight,
            estimates.detection,
            ltwh(estimates.xyxy),
            estimates.state.T,
        )


def write_tracks(path: AnyPath, tracks: Tracks, names: Mapping[int, str] | None = None) -> None:
    """Write the tracks of a sequence; replaces an existing file. Classes are written if there are
    names or any class is not 0.

    Raises `InputError` if the file cannot be written.

    Parameters
    ----------
    path : the file.
    tracks : the rows to write.
    names : the names of the classes by number.
    """
    with TracksWriter(path, names or ({} if tracks.class_id.any() else None)) as writer:
        writer.append(tracks)


def write_detections(path: AnyPath, table: DetectionTable) -> None:
    """Write the detections of a sequence; replaces an existing file. Raises `InputError` if it
    cannot be written.

    Parameters
    ----------
    path : the file.
    table : boxes in pixels, frames from 1.
    """
    with DetectionsWriter(path, table.names) as writer:
        writer.append(table.frame, table.detections)


def write_truth(path: AnyPath, truth: Truth) -> None:
    """Write truth in the form of MOT16: scored rows as pedestrians with flag 1, distractors with
    flag 0.

    Raises `InputError` if there are regions to ignore or a least height, which the format cannot
    express.

    Parameters
    ----------
    path : the file.
    truth : boxes in pixels, frames from 1.
    """
    if len(truth.regions) or truth.least_height:
        raise InputError(
            "MOTChallenge truth has no regions to ignore and no least height", where=Path(path)
        )
    label = np.where(truth.distractor, _DISTRACTOR, _PEDESTRIAN)
    with Lines(path) as file:
        file.write(_TRUTH, truth.frame, truth.identity, ltwh(truth.xyxy), ~truth.distractor, label)


def ltwh(xyxy: F8) -> F8:
    """(M, 4) left, top, width, height of the boxes."""
    return np.hstack([xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2]])
