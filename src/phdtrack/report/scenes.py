"""Pictures of a report that lie over the scene: trajectories and heat maps of the intensity. Each gives a `Picture` (JPEG).

The photograph is turned grey and darkened, so that colour belongs to the data alone. Axes are pixels of the original video.
Without video the same pictures are drawn on a dark ground.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from phdtrack.report.canvas import INK, Picture, new_figure, to_jpeg
from phdtrack.report.palette import hexadecimal, identity_colour
from phdtrack.report.record import HeatMap, RunRecord
from phdtrack.types import F8, Image, SequenceInfo, Tracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABELS = 80
_WIDTH = 8.2
_MOST_STRETCHED = 6.0
_HALF_WIDTH = 5.4


def trajectory_picture(record: RunRecord) -> Picture:
    """The way of every identity's foot point over the scene: full where seen, thin where predicted, broken where rows are
    missing; a ring where it appeared, its number where it was last seen."""
    from matplotlib.collections import LineCollection

    figure, axes = over_scene(_extent_of(record), record.background, _WIDTH, darkness=0.4)
    tracks = record.by_identity()
    colours = [hexadecimal(identity_colour(int(rows.identity[0]))) for rows in tracks]
    ways = [_broken(rows, _feet(rows)) for rows in tracks]
    seen = [_broken(rows, np.where(rows.predicted[:, None], np.nan, _feet(rows))) for rows in tracks]
    axes.add_collection(LineCollection(ways, colors=colours, linewidths=0.8, alpha=0.8))
    axes.add_collection(LineCollection(seen, colors=colours, linewidths=1.8))
    if tracks:
        x, y = np.array([_feet(rows)[0] for rows in tracks]).T
        axes.scatter(x, y, s=24, facecolors="none", edgecolors=colours, linewidths=1.0)
    for rows, colour in zip(tracks, colours, strict=True) if len(tracks) <= _LABELS else ():
        _label(axes, rows, colour)
    return to_jpeg(figure)


def heat_picture(heat: HeatMap, info: SequenceInfo) -> Picture:
    """The intensity over one frame in the manner of M07's Fig. 1: colour where objects are expected, a cross for every
    detection, a ring for every state extracted."""
    figure, axes = over_scene(info, heat.image, _HALF_WIDTH, darkness=0.5)
    high, wide = heat.density.shape
    edges = (0, wide * heat.cell, high * heat.cell, 0)
    top = max(float(heat.density.max(initial=0.0)), 1e-9)
    share = np.clip(heat.density / top, 0, 1)
    axes.imshow(heat.density, cmap="inferno", extent=edges, alpha=opacity(share), vmin=0, vmax=top, interpolation="nearest")
    for boxes, marker, size, colour in ((heat.detections, "+", 6.0, "#ffffff"), (heat.estimates, "o", 12.0, "#4cc9f0")):
        x, y = (boxes[:, 0] + boxes[:, 2]) / 2, (boxes[:, 1] + boxes[:, 3]) / 2
        axes.plot(x, y, marker, color=colour, markersize=size, markerfacecolor="none", linestyle="")
    axes.set_xlim(0, info.width)
    axes.set_ylim(info.height, 0)
    _colour_bar(figure, axes, top, heat.cell)
    return to_jpeg(figure)


def opacity(share: F8) -> F8:
    """Nothing where nothing is expected, quickly opaque above it: a weak mass is what one looks for."""
    shown: F8 = np.where(share > 0.004, 0.25 + 0.7 * share**0.5, 0.0)
    return shown


def _colour_bar(figure: Figure, axes: Axes, top: float, cell: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = figure.colorbar(ScalarMappable(Normalize(0, top), "inferno"), ax=axes, shrink=0.75, aspect=30, pad=0.015)
    bar.set_label(f"objects in {cell:g} × {cell:g} pixels", fontsize=10, color=INK)
    bar.ax.tick_params(labelsize=9, colors=INK)


def _extent_of(record: RunRecord) -> SequenceInfo:
    """The frame size, or where nobody stated one, a frame that holds all tracks."""
    info = record.info
    if info.width > 0 and info.height > 0:
        return info
    reach = np.ceil(record.tracks.xyxy.max(axis=0, initial=1.0))
    return SequenceInfo(int(max(reach[2], 1)), int(max(reach[3], 1)), info.fps, info.frames, info.name)


def over_scene(info: SequenceInfo, image: Image, width: float, *, darkness: float) -> tuple[Figure, Axes]:
    """A figure whose axes are the frame in pixels, with the darkened grey photograph or a dark ground."""
    height = float(np.clip((width - 1.2) * info.height / info.width + 0.7, 1.8, 9.0))
    figure = new_figure(width, height)
    axes = figure.add_subplot(111)
    axes.set_facecolor("#1b1f27")
    if image.size:
        grey = image @ np.array([0.114, 0.587, 0.299]) * (1 - darkness)
        axes.imshow(grey, cmap="gray", vmin=0, vmax=255, extent=(0, info.width, info.height, 0))
    axes.set_xlim(0, info.width)
    axes.set_ylim(info.height, 0)
    axes.set_aspect("equal" if _MOST_STRETCHED > info.width / info.height > 1 / _MOST_STRETCHED else "auto")
    axes.set_xlabel("x in pixels", fontsize=10, color=INK)
    axes.set_ylabel("y in pixels", fontsize=10, color=INK)
    axes.tick_params(labelsize=9, colors=INK)
    return figure, axes


def _feet(rows: Tracks) -> F8:
    """(M, 2) middle of the lower edge of each box."""
    return np.stack([(rows.xyxy[:, 0] + rows.xyxy[:, 2]) / 2, rows.xyxy[:, 3]], axis=1)


def _broken(rows: Tracks, points: F8) -> F8:
    """``points`` (M, 2) of the rows of one identity with a break (NaN) wherever frames are missing."""
    missing = np.flatnonzero(np.diff(rows.frame) > 1) + 1
    broken: F8 = np.insert(points, missing, np.nan, axis=0)
    return broken


def _label(axes: Axes, rows: Tracks, colour: str) -> None:
    x, y = _feet(rows)[-1]
    plate = {"boxstyle": "round,pad=0.2", "facecolor": colour, "linewidth": 0}
    name = str(rows.identity[0])
    axes.text(float(x), float(y), name, color="black", fontsize=7.5, ha="center", va="center", bbox=plate, clip_on=True)
