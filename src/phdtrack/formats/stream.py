"""Detections that come line by line and have no end, as from a pipe."""

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
from phdtrack.types import DetectionTable

_AT_ONCE = 1 << 16
# Lines that one frame may have.
_MOST = 100_000


def stream_detections(file: BinaryIO, name: str) -> Iterator[DetectionTable]:
    """Detections as they come, of one or more whole frames: a frame is whole when a row of a later
    one has come.

    Raises `InputError` where a line cannot be understood, or is of a frame that was before; the
    message names the line.

    Parameters
    ----------
    file : MOTChallenge or CSV rows in the order of their frames, which count from 1.
    name : of it, in messages.
    """
    path = Path(name)
    cut = b""
    read = 0
    header = list[bytes]()
    # The lines that are not given yet, and their numbers; the frame that was given last.
    lines = list[bytes]()
    numbers = list[int]()
    last = 0
    going = True
    while going:
        new = os.read(file.fileno(), _AT_ONCE)
        going = bool(new)
        *whole, cut = (cut + new).split(b"\n")
        for line in whole if going else [*whole, cut]:
            read += 1
            if line.strip() and not line.lstrip().startswith(b"#"):
                lines.append(line)
                numbers.append(read)
        text = scan(path, b"\n".join([*header, *lines]))
        if text.header and not header:
            header = [lines.pop(0)]
            del numbers[0]
        if not lines:
            continue
        text = replace(text, origin=Origin(path, "line", np.array(numbers)))
        table = table_of_text(Source(path, b"", Kind.DETECTIONS, 1), text)
        # Also the rows that may have to wait are looked at when they come.
        detections_of(table)
        frame = frames_of(table)
        before = np.concatenate([[last + 1], frame[:-1]])
        problem = (
            "expected the rows of a stream in the order of their frames, came frame {:.0f} after"
            " frame {:.0f}"
        )
        enforce(
            text.origin,
            Rule(
                frame < before,
                problem,
                np.stack([frame, np.concatenate([[last], frame[:-1]])], axis=1),
            ),
        )
        if going:
            kept = int(np.searchsorted(frame, frame[-1]))
        else:
            kept = len(frame)
        if len(frame) - kept > _MOST:
            raise InputError(
                f"expected at most {_MOST} rows of a frame, came more", where=text.origin.at(kept)
            )
        if kept:
            last = int(frame[kept - 1])
            yield detections_of(table.select(np.arange(kept)))
            del lines[:kept], numbers[:kept]
