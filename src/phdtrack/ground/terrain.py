"""The ground: flat, or an elevation map z(x, y) on a regular grid, bilinear between its points [E13
§3.3].

A ray p + s d meets terrain at the least root s of h(s) = p_z + s d_z − z(x(s), y(s)). The
Gauss–Newton steps of E13 from the flat solution may end behind a hill that is in the way. So the
line of sight is sampled in half steps of the grid, and the first interval in which it goes below
the ground is bisected.

Elevation maps are read from ASCII grids of geographic programs: lines of a name and a number
(ncols, nrows, xllcorner or xllcenter, yllcorner or yllcenter, cellsize, and optionally
NODATA_value), followed by the heights, the northernmost row first. All lengths are in metres, in
the camera's world.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.types import F8

_HALVINGS = 60
# No height on the Earth is larger, metres.
_MAX_HEIGHT = 1e7
# Samples of lines of sight that are evaluated at once: 8 MiB per array.
_BLOCK = 1 << 20
# A ray this flat, relative to its length, is the horizon within the precision of float64.
_LEVEL = 1e-12
_HEAD = (
    "ncols",
    "nrows",
    "xllcorner",
    "xllcenter",
    "yllcorner",
    "yllcenter",
    "cellsize",
    "nodata_value",
)


@dataclass(frozen=True, slots=True)
class Flat:
    """Level ground; ``level`` is its height, metres."""

    level: float = 0.0

    def height(self, xy: F8) -> F8:
        """(N,) the level.

        Parameters
        ----------
        xy : (2, N) points of the plane, metres.
        """
        return np.full(np.shape(xy)[1], self.level)

    def normal(self, xy: F8) -> F8:
        """(3, N) straight up.

        Parameters
        ----------
        xy : (2, N) points of the plane, metres.
        """
        return np.repeat([[0.0], [0.0], [1.0]], np.shape(xy)[1], axis=1)

    def meet(self, origin: F8, direction: F8) -> F8:
        """(N,) the s > 0 at which the ray reaches the level; NaN on and above the horizon [E13
        (7)].

        Parameters
        ----------
        origin : (3,) where all rays begin, metres.
        direction : (3, N) along each ray, of any length.
        """
        fall = self.level - origin[2]
        length = np.linalg.norm(direction, axis=0)
        meets = (direction[2] * fall > 0) & (np.abs(direction[2]) > _LEVEL * length)
        return np.asarray(fall / np.where(meets, direction[2], np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """An elevation map; outside of it and beside unknown heights the ground is unknown, and no
    pixel shows it.

    Attributes
    ----------
    origin : (2,) x and y of the first grid point, metres.
    step : (2,) spacing of the grid along x and y, metres, above 0.
    heights : (ny, nx) elevation in metres, row by row in increasing y, at least 2 x 2; NaN for
        unknown.
    """

    origin: F8
    step: F8
    heights: F8
    _levels: tuple[float, float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        origin = np.asarray(self.origin)
        step = np.asarray(self.step)
        heights = np.asarray(self.heights)
        is_grid = heights.ndim == 2 and min(heights.shape) >= 2
        if not is_grid or (np.abs(heights) > _MAX_HEIGHT).any() or np.isnan(heights).all():
            raise InputError(
                f"expected 2 x 2 heights or more, within {_MAX_HEIGHT:g} m or NaN, not all NaN, got"
                f" shape {heights.shape}",
                where="terrain",
            )
        shapes_fit = origin.shape == step.shape == (2,)
        if not (shapes_fit and np.isfinite([origin, step]).all() and (step > 0).all()):
            raise InputError(
                "expected a finite origin (x, y) and finite steps (along x, along y) above 0, in"
                " metres",
                where="terrain",
            )
        levels = float(np.nanmin(heights)), float(np.nanmean(heights)), float(np.nanmax(heights))
        object.__setattr__(self, "_levels", levels)

    @property
    def end(self) -> F8:
        """(2,) x and y of the last grid point, metres."""
        return np.asarray(self.origin + self.step * (np.array(self.heights.shape[::-1]) - 1))

    def height(self, xy: F8) -> F8:
        """(N,) elevation at the points (2, N), metres; NaN outside of the map and beside unknown
        heights.

        Parameters
        ----------
        xy : (2, N) points of the plane, metres.
        """
        x, y = np.asarray(xy, dtype=np.float64)
        inside = (
            (x >= self.origin[0]) & (x <= self.end[0]) & (y >= self.origin[1]) & (y <= self.end[1])
        )
        return np.where(inside, self._patch(x, y)[0], np.nan)

    def normal(self, xy: F8) -> F8:
        """(3, N) normals (−∂z/∂x, −∂z/∂y, 1) at the points (2, N).

        Parameters
        ----------
        xy : (2, N) points of the plane, metres.
        """
        _, slope_x, slope_y = self._patch(*np.asarray(xy, dtype=np.float64))
        return np.stack([-slope_x, -slope_y, np.ones_like(slope_x)])

    def meet(self, origin: F8, direction: F8) -> F8:
        """(N,) the least s > 0 at which the ray goes below the ground [E13 §3.3].

        Parameters
        ----------
        origin : (3,) where all rays begin, metres.
        direction : (3, N) along each ray, of any length.
        """
        low, high = self._first_crossing(origin, direction)
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            above = self._above(origin, direction, middle) > 0
            low = np.where(above, middle, low)
            high = np.where(above, high, middle)
        s = (low + high) / 2
        # Beside unknown heights the bisection may end at their edge.
        on_ground = np.abs(self._above(origin, direction, s)) <= 1e-9 * (
            1 + np.abs(origin[2] + s * direction[2])
        )
        return np.where(on_ground, s, np.nan)

    def _patch(self, x: F8, y: F8) -> tuple[F8, F8, F8]:
        """Elevation and slopes along x and y at the points; outside of the map, those of the
        nearest edge.
        """
        ny, nx = self.heights.shape
        column = np.clip(np.nan_to_num((x - self.origin[0]) / self.step[0]), 0, nx - 1)
        row = np.clip(np.nan_to_num((y - self.origin[1]) / self.step[1]), 0, ny - 1)
        i = np.minimum(row.astype(np.int64), ny - 2)
        j = np.minimum(column.astype(np.int64), nx - 2)
        a = column - j
        b = row - i
        h = self.heights
        rise = h[i, j + 1] - h[i, j]
        rise_next = h[i + 1, j + 1] - h[i + 1, j]
        near = h[i, j] + a * rise
        far = h[i + 1, j] + a * rise_next
        return (
            near + b * (far - near),
            ((1 - b) * rise + b * rise_next) / self.step[0],
            (far - near) / self.step[1],
        )

    def _above(self, origin: F8, direction: F8, s: F8) -> F8:
        """Height of the points origin + s·direction over the ground, positive on the camera's side
        of it.
        """
        x, y, z = (origin[k] + s * direction[k] for k in range(3))
        side = 1.0 if origin[2] >= self._levels[1] else -1.0
        return np.asarray(side * (z - self._patch(x, y)[0]))

    def _first_crossing(self, origin: F8, direction: F8) -> tuple[F8, F8]:
        """Intervals of s, from (N,) to (N,), in which rays first go below the ground.

        NaN for rays that never do, and for those that enter the map below its ground.
        """
        # Rays are sampled between their ends in the box around the map. The box has a margin, or
        # the box of flat terrain would have no height.
        lowest, _, highest = self._levels
        margin = 1e-3 * (1 + highest - lowest)
        corners = np.array([[*self.origin, lowest - margin], [*self.end, highest + margin]])
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (corners - origin)[:, :, None] / direction
        enter = np.maximum(np.fmin(a, b).max(axis=0), 0)
        leave = np.fmax(a, b).min(axis=0)
        crosses = enter < leave
        enter = np.where(crosses, enter, np.nan)
        leave = np.where(crosses, leave, np.nan)
        across = np.hypot(direction[0], direction[1]) * (leave - enter)
        count = int(np.ceil(2 * np.max(np.nan_to_num(across), initial=0.0) / self.step.min())) + 2
        low = np.full(len(enter), np.nan)
        high = np.full(len(enter), np.nan)
        share = np.linspace(0, 1, count)
        block = max(1, _BLOCK // count)
        for first in range(0, len(enter), block):
            rows = slice(first, first + block)
            s = enter[rows, None] + share * (leave - enter)[rows, None]
            above = self._above(origin, direction[:, rows, None], s)
            falls = (above[:, :-1] > 0) & (above[:, 1:] <= 0)
            ray = np.arange(len(falls))
            interval = np.argmax(falls, axis=1)
            meets = falls[ray, interval] & ~(above[:, 0] < 0)
            low[rows] = np.where(meets, s[ray, interval], np.nan)
            high[rows] = np.where(meets, s[ray, interval + 1], np.nan)
        return low, high


Surface = Flat | Terrain


class Line(NamedTuple):
    """The words of a line of text, and its place in the file."""

    where: str
    words: list[str]

    def numbers(self, count: int) -> list[float]:
        """The ``count`` numbers of the line. Raises `InputError` if it has others."""
        if len(self.words) != count:
            raise InputError(f"expected {count} numbers, got {len(self.words)}", where=self.where)
        try:
            return [float(word) for word in self.words]
        except ValueError:
            got = " ".join(self.words)[:60]
            raise InputError(f"expected {count} numbers, got '{got}'", where=self.where) from None


def read_terrain(path: AnyPath) -> Terrain:
    """Read the elevation map in an ASCII grid. Raises `InputError` if missing or malformed.

    Parameters
    ----------
    path : the grid: its header, then heights in metres.

    Returns
    -------
    The surface of the ground.
    """
    path = Path(path)
    origin, step, heights = _grid(path, load(path))
    try:
        return Terrain(origin, step, heights)
    except InputError as error:
        raise InputError(error.problem, where=path) from None


def _grid(path: Path, content: bytes) -> tuple[F8, F8, F8]:
    """Origin, step and heights of an ASCII grid."""
    text = content.decode(errors="replace").splitlines()
    lines = [
        Line(f"{path}, line {i}", line.split()) for i, line in enumerate(text, 1) if line.strip()
    ]
    head: dict[str, float] = {}
    while lines and (name := lines[0].words[0].lower()) in _HEAD:
        line = lines.pop(0)
        head[name] = Line(line.where, line.words[1:]).numbers(1)[0]
    for names in (
        ("ncols",),
        ("nrows",),
        ("cellsize",),
        ("xllcorner", "xllcenter"),
        ("yllcorner", "yllcenter"),
    ):
        if not any(name in head for name in names):
            raise InputError(
                f"expected an ASCII grid that states {' or '.join(names)}, got none", where=path
            )
    for name in ("ncols", "nrows"):
        if not (head[name] >= 0 and head[name].is_integer()):
            raise InputError(f"expected a whole number for {name}, got {head[name]:g}", where=path)
    columns = int(head["ncols"])
    rows = int(head["nrows"])
    cell = head["cellsize"]
    table = [line.numbers(columns) for line in lines]
    if len(table) != rows:
        raise InputError(
            f"expected {rows} rows of heights, got {len(table)}",
            where=path,
            cure="Is the file complete?",
        )
    heights = np.array(table).reshape(rows, columns)[::-1]
    heights = np.where(heights == head.get("nodata_value", np.nan), np.nan, heights)
    origin = [head.get(f"{a}llcenter", head.get(f"{a}llcorner", 0.0) + cell / 2) for a in "xy"]
    return np.array(origin), np.array([cell, cell]), heights
