"""Elevation maps in files: ``.npz`` (heights, origin, step) and the ASCII grid of geographic programs.

An ASCII grid starts with lines of a name and a number (ncols, nrows, xllcorner or xllcenter, yllcorner or yllcenter,
cellsize, and maybe NODATA_value), followed by the heights, the northernmost row first. All lengths are in metres, in the
camera's world.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.ground.terrain import Terrain

_HEAD = ("ncols", "nrows", "xllcorner", "xllcenter", "yllcorner", "yllcenter", "cellsize", "nodata_value")


def read_terrain(path: AnyPath) -> Terrain:
    """The elevation map of a file; see the module for the two forms.

    Raises
    ------
    InputError : there is no such file, or it is none of the two.
    """
    path = Path(path)
    content = load(path)
    return _arrays(path, content) if content.startswith(b"PK") else _grid(path, content)


def _arrays(path: Path, content: bytes) -> Terrain:
    expected = "expected an .npz file with the arrays heights (ny, nx), origin (2,) and step (2,)"
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as held:
            missing = [name for name in ("heights", "origin", "step") if name not in held]
            if missing:
                raise InputError(f"{expected}, came one without {missing[0]}", where=path)
            heights, origin, step = (held[name].astype(np.float64) for name in ("heights", "origin", "step"))
    except InputError:
        raise
    except Exception as error:  # a broken archive makes NumPy fail in a dozen ways
        raise InputError(f"{expected}, which cannot be read: {error}", where=path) from None
    try:
        return Terrain(origin, np.broadcast_to(step, (2,)), heights)
    except ValueError as error:
        raise InputError(f"{expected}: {error}", where=path) from None


def _grid(path: Path, content: bytes) -> Terrain:
    lines = content.decode("utf-8", errors="replace").splitlines()
    head: dict[str, float] = {}
    first = 0
    for first, line in enumerate(lines):
        words = line.split()
        if words and words[0].lower() not in _HEAD:
            break
        if words:
            head[words[0].lower()] = _numbers(path, first, words[1:], 1)[0]
    for names in (("ncols",), ("nrows",), ("cellsize",), ("xllcorner", "xllcenter"), ("yllcorner", "yllcenter")):
        if not any(name in head for name in names):
            raise InputError(
                f"expected an elevation map, an .npz file or an ASCII grid that states {' or '.join(names)}, came neither",
                where=path,
            )
    for name in ("ncols", "nrows"):
        if not (head[name] >= 0 and head[name].is_integer()):
            raise InputError(f"expected a whole number for {name}, came {head[name]:g}", where=path)
    columns, rows, cell = int(head["ncols"]), int(head["nrows"]), head["cellsize"]
    table = [_numbers(path, first + i, line.split(), columns) for i, line in enumerate(lines[first:]) if line.strip()]
    if len(table) != rows:
        raise InputError(f"expected {rows} rows of heights, came {len(table)}", where=path, cure="Is the file complete?")
    heights = np.array(table).reshape(rows, columns)[::-1]
    origin = [head.get(f"{a}llcenter", head.get(f"{a}llcorner", 0.0) + cell / 2) for a in "xy"]
    known = np.where(heights == head["nodata_value"], np.nan, heights) if "nodata_value" in head else heights
    try:
        return Terrain(np.array(origin), np.array([cell, cell]), np.ascontiguousarray(known))
    except InputError as error:
        raise InputError(error.problem, where=path) from None


def _numbers(path: Path, line: int, words: list[str], count: int) -> list[float]:
    """The ``count`` numbers of a line (0-based), which the message gives its 1-based number."""
    where = f"{path}, line {line + 1}"
    if len(words) != count:
        raise InputError(f"expected {count} numbers, came {len(words)}", where=where)
    try:
        return [float(word) for word in words]
    except ValueError:
        raise InputError(f"expected {count} numbers, came '{' '.join(words)[:60]}'", where=where) from None
