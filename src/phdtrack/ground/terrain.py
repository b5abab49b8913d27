"""The ground: flat, or an elevation map z(x, y) on a regular grid, bilinear between its points.

Where a ray p + s d meets terrain, s is a root of h(s) = p_z + s d_z − z(x(s), y(s)). A step of Gauss–Newton on the two
equations of E13 meets the ray with the tangent plane at the last point; all its points lie on the ray, so it is a step of
Newton on h.

From the flat solution a few steps find the point, mostly. Where a hill is in the way they may find what lies hidden behind
it, or run in a circle on a ridge. So the line of sight is looked along in half steps of the grid: the first place where it
goes below the ground is the one that is seen, and halving finds it where Newton's method did not.

Elevation maps in files: ``.npz`` (heights, origin, step) and the ASCII grid of geographic programs.

An ASCII grid starts with lines of a name and a number (ncols, nrows, xllcorner or xllcenter, yllcorner or yllcenter,
cellsize, and maybe NODATA_value), followed by the heights, the northernmost row first. All lengths are in metres, in the
camera's world.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.types import F8

_STEPS = 20
_HALVINGS = 60
# Values looked at in one go along lines of sight: 8 MiB a table.
_BLOCK = 1 << 20
# A ray this flat, relative to its length, is the horizon for all that float64 can say.
_LEVEL = 1e-12


Mask = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


class Surface(Protocol):
    """The ground as a height over the plane."""

    def height(self, xy: F8) -> F8:
        """(N,) elevation at the points (2, N), metres; NaN where it is not known."""

    def normal(self, xy: F8) -> F8:
        """(3, N) normals (−∂z/∂x, −∂z/∂y, 1) at the points (2, N)."""

    def meet(self, origin: F8, direction: F8) -> F8:
        """(N,) the least s > 0 at which origin (3,) + s·direction (3, N) comes to the ground; NaN where it never does."""


@dataclass(frozen=True, slots=True)
class Flat:
    """Level ground; ``level`` is its height, metres."""

    level: float = 0.0

    def height(self, xy: F8) -> F8:
        """(N,) the level."""
        return np.full(np.shape(xy)[1], self.level)

    def normal(self, xy: F8) -> F8:
        """(3, N) straight up."""
        return np.repeat([[0.0], [0.0], [1.0]], np.shape(xy)[1], axis=1)

    def meet(self, origin: F8, direction: F8) -> F8:
        """(N,) the s > 0 at which the ray comes to the level; NaN at the horizon and beyond [E13 (7)]."""
        fall = self.level - origin[2]
        length = np.linalg.norm(direction, axis=0)
        meets = (direction[2] * fall > 0) & (np.abs(direction[2]) > _LEVEL * length)
        return np.asarray(fall / np.where(meets, direction[2], np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """An elevation map; outside of it, and beside unknown heights, nothing is known and nothing is seen.

    Attributes
    ----------
    origin : (2,) x and y of the first grid point, metres.
    step : (2,) spacing of the grid along x and y, metres, above 0.
    heights : (ny, nx) elevation in metres, row by row in growing y, at least 2 x 2; NaN where unknown.

    Raises
    ------
    InputError : another shape, a step that is not above 0, or no known height at all.
    """

    origin: F8
    step: F8
    heights: F8
    _levels: tuple[float, float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        origin, step, heights = np.asarray(self.origin), np.asarray(self.step), np.asarray(self.heights)
        if heights.ndim != 2 or min(heights.shape) < 2 or np.isinf(heights).any() or np.isnan(heights).all():
            raise InputError(
                f"expected 2 x 2 heights or more, finite or NaN, not all NaN, came shape {heights.shape}",
                where="terrain",
            )
        if origin.shape != (2,) or step.shape != (2,) or not np.isfinite(origin).all() or not (step > 0).all():
            raise InputError("expected an origin (x, y) and steps (along x, along y) above 0, in metres", where="terrain")
        if not np.isfinite(step).all():
            raise InputError("expected finite steps", where="terrain")
        levels = float(np.nanmin(heights)), float(np.nanmean(heights)), float(np.nanmax(heights))
        object.__setattr__(self, "_levels", levels)

    @property
    def end(self) -> F8:
        """(2,) x and y of the last grid point, metres."""
        ny, nx = self.heights.shape
        return np.asarray(self.origin + self.step * np.array([nx - 1, ny - 1]))

    def height(self, xy: F8) -> F8:
        """(N,) elevation at the points (2, N), metres; NaN outside of the map and beside unknown heights."""
        x, y = np.asarray(xy, dtype=np.float64)
        inside = (x >= self.origin[0]) & (x <= self.end[0]) & (y >= self.origin[1]) & (y <= self.end[1])
        return np.where(inside, self._patch(x, y)[0], np.nan)

    def normal(self, xy: F8) -> F8:
        """(3, N) normals (−∂z/∂x, −∂z/∂y, 1) at the points (2, N)."""
        _, slope_x, slope_y = self._patch(*np.asarray(xy, dtype=np.float64))
        return np.stack([-slope_x, -slope_y, np.ones_like(slope_x)])

    def meet(self, origin: F8, direction: F8) -> F8:
        """(N,) the least s > 0 at which the ray goes below the ground, by Gauss–Newton from the flat solution [E13 §3.3]."""
        start = Flat(self._levels[1]).meet(origin, direction)
        found = self._newton(origin, direction, start)
        low, high, buried = self._first_crossing(origin, direction)
        found[buried] = np.nan
        hidden = np.isfinite(low) & ~((found >= low) & (found <= high))
        if hidden.any():
            found[hidden] = self._halve(origin, direction[:, hidden], low[hidden], high[hidden])
        return found

    def _patch(self, x: F8, y: F8) -> tuple[F8, F8, F8]:
        """Elevation and slopes along x and y of the patch at the points; outside, those of the nearest edge."""
        ny, nx = self.heights.shape
        column = np.clip(np.nan_to_num((x - self.origin[0]) / self.step[0]), 0, nx - 1)
        row = np.clip(np.nan_to_num((y - self.origin[1]) / self.step[1]), 0, ny - 1)
        i, j = np.minimum(row.astype(np.int64), ny - 2), np.minimum(column.astype(np.int64), nx - 2)
        a, b = column - j, row - i
        h = self.heights
        near, far = h[i, j] + a * (h[i, j + 1] - h[i, j]), h[i + 1, j] + a * (h[i + 1, j + 1] - h[i + 1, j])
        across = (1 - b) * (h[i, j + 1] - h[i, j]) + b * (h[i + 1, j + 1] - h[i + 1, j])
        return near + b * (far - near), across / self.step[0], (far - near) / self.step[1]

    def _above(self, origin: F8, direction: F8, s: F8) -> F8:
        """Height of the points origin + s·direction over the ground, counted from the camera's side of it."""
        point = [origin[k] + s * direction[k] for k in range(3)]
        side = 1.0 if origin[2] >= self._levels[1] else -1.0
        return np.asarray(side * (point[2] - self._patch(point[0], point[1])[0]))

    def _newton(self, origin: F8, direction: F8, start: F8) -> F8:
        """(N,) roots near ``start`` (N,), on the map and reached from above; NaN where none was found."""
        s = start
        for _ in range(_STEPS):
            x, y, z = origin[:, None] + s * direction
            ground, slope_x, slope_y = self._patch(x, y)
            # Each stops on its own, so that none depends on its neighbours; NaN is never far.
            far = np.abs(z - ground) > 1e-13 * (1 + np.abs(z))
            if not far.any():
                break
            fall = direction[2] - slope_x * direction[0] - slope_y * direction[1]
            s = np.where(far, s - (z - ground) / np.where(fall != 0, fall, np.nan), s)
        rising = self._above(origin, direction, s * (1 + 1e-7)) - self._above(origin, direction, s * (1 - 1e-7))
        point = origin[:, None] + s * direction
        exact = np.abs(point[2] - self.height(point[:2])) <= 1e-9 * (1 + np.abs(point[2]))
        return np.where(exact & (s > 0) & (rising < 0), s, np.nan)

    def _first_crossing(self, origin: F8, direction: F8) -> tuple[F8, F8, Mask]:
        """Intervals of s (N,), (N,) in which rays first go below the ground, NaN for those that never do.

        And which (N,) come onto the map below its ground: what they show lies outside, where nothing is known.
        """
        enter, leave = self._over_map(origin, direction)
        across = np.hypot(direction[0], direction[1]) * (leave - enter)
        most = np.max(np.nan_to_num(across), initial=0.0)
        count = int(np.ceil(2 * most / self.step.min())) + 2
        low, high, buried = np.full(len(enter), np.nan), np.full(len(enter), np.nan), np.zeros(len(enter), dtype=bool)
        share = np.linspace(0, 1, count)
        for first in range(0, len(enter), max(1, _BLOCK // count)):
            rows = slice(first, first + max(1, _BLOCK // count))
            s = enter[rows, None] + share * (leave - enter)[rows, None]
            above = self._above(origin, direction[:, rows, None], s)
            falls = (above[:, :-1] > 0) & (above[:, 1:] <= 0)
            at = np.argmax(falls, axis=1)
            each = np.arange(len(at))
            buried[rows] = above[each, 0] < 0
            seen = falls[each, at] & ~buried[rows]
            low[rows], high[rows] = np.where(seen, s[each, at], np.nan), np.where(seen, s[each, at + 1], np.nan)
        return low, high, buried

    def _over_map(self, origin: F8, direction: F8) -> tuple[F8, F8]:
        """(N,), (N,) the interval of s ≥ 0 in which a ray is over the map and not yet below its lowest point; NaN: none."""
        lowest, _, highest = self._levels
        corner = np.array([*self.origin, lowest]), np.array([*self.end, highest])
        # A margin, or flat terrain would have no room between its lowest and highest point.
        margin = np.array([0, 0, 1e-3 * (1 + highest - lowest)])
        with np.errstate(divide="ignore", invalid="ignore"):
            a = (corner[0] - margin - origin)[:, None] / direction
            b = (corner[1] + margin - origin)[:, None] / direction
        enter = np.maximum(np.fmin(a, b).max(axis=0), 0)
        leave = np.fmax(a, b).min(axis=0)
        seen = enter < leave
        return np.where(seen, enter, np.nan), np.where(seen, leave, np.nan)

    def _halve(self, origin: F8, direction: F8, low: F8, high: F8) -> F8:
        """(n,) the place between ``low`` and ``high`` at which the ray goes below the ground."""
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            above = self._above(origin, direction, middle) > 0
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        return (low + high) / 2


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
