"""Pictures of a report that lie over the scene: trajectories, the intensity, what was learned. Each is a `Picture` (JPEG).

The photograph is turned grey and darkened, so that colour belongs to the data. Without video the same pictures are drawn on
a dark ground. Axes are pixels of the original video.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from phdtrack.report.charts import INK, Picture, chart_axes, new_figure, to_jpeg
from phdtrack.report.drawing import identity_colour
from phdtrack.report.record import HeatMap, RunRecord
from phdtrack.scene import LearnedDensity, Scene
from phdtrack.scene.mixture import place_map
from phdtrack.types import F8, Image, SequenceInfo

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABELS = 80
_WIDTH, _HALF_WIDTH = 8.2, 5.4
_MOST_STRETCHED = 6.0
_CELLS = 160
# Gaussians lighter than this are drawn without an arrow.
_LIGHTEST = 0.02


def trajectory_picture(record: RunRecord) -> Picture:
    """The way of every identity's foot point over the scene: full where seen, thin where predicted, broken where rows are
    missing; a ring where it appeared, its number where it was last seen."""
    from matplotlib.collections import LineCollection

    info = record.info
    if not (info.width > 0 and info.height > 0):
        # A frame that holds all tracks, where its size is not known.
        reach = np.maximum(np.ceil(record.tracks.xyxy.max(axis=0, initial=1.0)), 1).astype(int)
        info = SequenceInfo(int(reach[2]), int(reach[3]), info.fps)
    figure, axes = _over_scene(info, record.background, _WIDTH, darkness=0.4)
    tracks = record.by_identity()
    colours = ["#{:02x}{:02x}{:02x}".format(*identity_colour(int(rows.identity[0]))) for rows in tracks]
    feet = [np.stack([(rows.xyxy[:, 0] + rows.xyxy[:, 2]) / 2, rows.xyxy[:, 3]], axis=1) for rows in tracks]
    seen = [np.where(rows.predicted[:, None], np.nan, way) for rows, way in zip(tracks, feet, strict=True)]
    for ways, width, alpha in ((feet, 0.8, 0.8), (seen, 1.8, 1.0)):
        cuts = [np.flatnonzero(np.diff(rows.frame) > 1) + 1 for rows in tracks]
        broken = [np.insert(way, cut, np.nan, axis=0) for way, cut in zip(ways, cuts, strict=True)]
        axes.add_collection(LineCollection(broken, colors=colours, linewidths=width, alpha=alpha))
    for way, colour in zip(feet, colours, strict=True):
        axes.scatter(way[0, 0], way[0, 1], s=24, facecolors="none", edgecolors=colour, linewidths=1.0)
    for rows, way, colour in zip(tracks, feet, colours, strict=True) if len(tracks) <= _LABELS else ():
        plate = {"boxstyle": "round,pad=0.2", "facecolor": colour, "linewidth": 0}
        x, y, name = way[-1, 0], way[-1, 1], str(rows.identity[0])
        axes.text(x, y, name, color="black", fontsize=7.5, ha="center", va="center", bbox=plate, clip_on=True)
    return to_jpeg(figure)


def heat_picture(heat: HeatMap, info: SequenceInfo) -> Picture:
    """The intensity over one frame [M07 Fig. 1]: colour where objects are expected, a cross for every detection, a ring for
    every state extracted."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure, axes = _over_scene(info, heat.image, _HALF_WIDTH, darkness=0.5)
    high, wide = heat.density.shape
    top = max(float(heat.density.max(initial=0.0)), 1e-9)
    extent = (0, wide * heat.cell, high * heat.cell, 0)
    _shade(axes, heat.density, top, extent, "nearest")
    for boxes, marker, size, colour in ((heat.detections, "+", 6.0, "#ffffff"), (heat.estimates, "o", 12.0, "#4cc9f0")):
        x, y = (boxes[:, 0] + boxes[:, 2]) / 2, (boxes[:, 1] + boxes[:, 3]) / 2
        axes.plot(x, y, marker, color=colour, markersize=size, markerfacecolor="none", linestyle="")
    axes.set_xlim(0, info.width)
    axes.set_ylim(info.height, 0)
    bar = figure.colorbar(ScalarMappable(Normalize(0, top), "inferno"), ax=axes, shrink=0.75, aspect=30, pad=0.015)
    bar.set_label(f"objects in {heat.cell:g} × {heat.cell:g} pixels", fontsize=10, color=INK)
    bar.ax.tick_params(labelsize=9, colors=INK)
    return to_jpeg(figure)


def map_picture(learned: LearnedDensity, scene: Scene, image: Image, *, births: bool) -> Picture:
    """Where births or false alarms are expected, over the frame [M09 Figs. 7, 8].

    Parameters
    ----------
    learned : over pixels or, for births on the ground, over metres: then it is drawn on a plan of their region.
    scene : whose they are.
    image : (H, W, 3) BGR frame, or (0, 0, 3).
    births : whether to draw the mean way of the next second as arrows.

    Returns
    -------
    The picture.
    """
    p = learned.density
    (left, top), (wide, high) = p.low[:2], (p.high - p.low)[:2]
    ground = (left, top, wide, high) != (0, 0, scene.width, scene.height)
    if ground:
        drawn = new_figure(_WIDTH, _WIDTH * min(max(high / wide, 0.3), 1.5))
        axes = chart_axes(drawn, "x in metres", "y in metres")
    else:
        drawn, axes = _over_scene(SequenceInfo(scene.width, scene.height, 25.0), image, _WIDTH, darkness=0.5)
    step = max(wide, high) / _CELLS
    shape = (math.ceil(high / step), math.ceil(wide / step))
    extent = (left, left + shape[1] * step, top + shape[0] * step, top)
    _shade(axes, place_map(p, shape, step, sized=p.dim == 6 or not births), 1.0, extent, "bilinear")
    for m in np.flatnonzero(p.weight >= _LIGHTEST) if births else ():
        start, way = p.mean[:2, m], p.mean[2:4, m] * scene.rate
        style = {"arrowstyle": "-|>", "color": "#4cc9f0", "linewidth": 1 + 4 * float(p.weight[m])}
        axes.annotate("", xy=tuple(start + way), xytext=tuple(start), arrowprops=style)
    axes.set_xlim(left, left + wide)
    # Of a plan the far end is above, of a picture row 0.
    axes.set_ylim(*((top, top + high) if ground else (top + high, top)))
    return to_jpeg(drawn)


def _shade(axes: Axes, density: F8, top: float, extent: tuple[float, float, float, float], interpolation: str) -> None:
    """Colour by the density: clear where nothing is expected, quickly opaque above it, because a weak mass matters."""
    share = np.clip(density / top, 0, 1)
    alpha = np.where(share > 0.004, 0.25 + 0.7 * share**0.5, 0.0)
    axes.imshow(density, cmap="inferno", extent=extent, alpha=alpha, vmin=0, vmax=top, interpolation=interpolation)


def _over_scene(info: SequenceInfo, image: Image, width: float, *, darkness: float) -> tuple[Figure, Axes]:
    """A figure whose axes are the frame in pixels, with the darkened grey photograph or a dark ground."""
    figure = new_figure(width, float(np.clip((width - 1.2) * info.height / info.width + 0.7, 1.8, 9.0)))
    axes = chart_axes(figure, "x in pixels", "y in pixels")
    axes.grid(False)
    axes.spines[:].set(visible=True, color="black")
    axes.set_facecolor("#1b1f27")
    if image.size:
        grey = image @ np.array([0.114, 0.587, 0.299]) * (1 - darkness)
        axes.imshow(grey, cmap="gray", vmin=0, vmax=255, extent=(0, info.width, info.height, 0))
    axes.set_xlim(0, info.width)
    axes.set_ylim(info.height, 0)
    axes.set_aspect("equal" if _MOST_STRETCHED > info.width / info.height > 1 / _MOST_STRETCHED else "auto")
    return figure, axes
