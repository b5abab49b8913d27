"""Detections from a stream without an end, such as a pipe."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from phdtrack.errors import InputError
from phdtrack.formats.checks import Origin, Rule, enforce
from phdtrack.formats.read import detections_of, frames_of
from phdtrack.formats.table import Kind, Source, table_of_text
from phdtrack.formats.text import scan
from phdtrack.types import I8, DetectionTable

_BYTES_PER_READ = 1 << 16
_MAX_ROWS_PER_FRAME = 100_000


def stream_detections(file: BinaryIO, name: str) -> Iterator[DetectionTable]:
    """Yield the detections of one or more complete frames as they arrive. A frame is complete when
    a row of a later one arrives.

    Raises `InputError` if a line is malformed or belongs to an earlier frame; the message names the
    line.

    Parameters
    ----------
    file : MOTChallenge or CSV rows in the order of their frames, which count from 1.
    name : what messages call the stream.
    """
    path = Path(name)
    incomplete_line = b""
    lines_read = 0
    header = list[bytes]()
    # The lines that were not yielded yet, and their numbers; the frame that was yielded last.
    lines = list[bytes]()
    numbers = list[int]()
    last = 0
    open_ = True
    while open_:
        data = os.read(file.fileno(), _BYTES_PER_READ)
        open_ = bool(data)
        *whole, incomplete_line = (incomplete_line + data).split(b"\n")
        for line in whole if open_ else [*whole, incomplete_line]:
            lines_read += 1
            if line.strip() and not line.lstrip().startswith(b"#"):
                lines.append(line)
                numbers.append(lines_read)
        text = scan(path, b"\n".join([*header, *lines]))
        if text.header and not header:
            header = [lines.pop(0)]
            del numbers[0]
        if not lines:
            continue
        text = replace(text, origin=Origin(path, "line", np.array(numbers)))
        table = table_of_text(Source(path, b"", Kind.DETECTIONS, 1), text)
        # Rows of an incomplete frame are checked as they arrive, too.
        detections_of(table)
        frame = frames_of(table)
        _check_order(text.origin, frame, last)
        if open_:
            complete = int(np.searchsorted(frame, frame[-1]))
        else:
            complete = len(frame)
        if len(frame) - complete > _MAX_ROWS_PER_FRAME:
            raise InputError(
                f"expected at most {_MAX_ROWS_PER_FRAME} rows of a frame, got more",
                where=text.origin.at(complete),
            )
        if complete:
            last = int(frame[complete - 1])
            yield detections_of(table.select(np.arange(complete)))
            del lines[:complete], numbers[:complete]


def _check_order(origin: Origin, frame: I8, last: int) -> None:
    """Raise `InputError` if a row comes after one of a later frame, or at frame ``last``, which is
    complete.
    """
    earliest = np.concatenate([[last + 1], frame[:-1]])
    previous = np.concatenate([[last], frame[:-1]])
    problem = (
        "expected the rows of a stream in the order of their frames, got frame {:.0f} after"
        " frame {:.0f}"
    )
    enforce(origin, Rule(frame < earliest, problem, np.stack([frame, previous], axis=1)))
