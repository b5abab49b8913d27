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


def trajectory_picture(record: RunRecord) -> Picture:
    """The way of every identity's foot point over the scene; a ring where it was first seen, its number where it ended."""
    info = _extent_of(record)
    figure, axes = _scene(info, record.background, _WIDTH, darkness=0.4)
    identities = np.unique(record.tracks.identity)
    for identity in identities:
        rows = record.tracks.take(record.tracks.identity == identity)
        _trajectory(axes, rows, int(identity), labelled=len(identities) <= _LABELS)
    return to_jpeg(figure)


def heat_picture(heat: HeatMap, info: SequenceInfo) -> Picture:
    """The intensity over one frame in the manner of M07's Fig. 1: colour where objects are expected, a cross for every
    detection, a ring for every state extracted."""
    figure, axes = _scene(info, heat.image, _WIDTH, darkness=0.55)
    high, wide = heat.density.shape
    edges = (0, wide * heat.cell, high * heat.cell, 0)
    top = max(float(heat.density.max(initial=0.0)), 1e-9)
    share = np.clip(heat.density / top, 0, 1)
    axes.imshow(heat.density, cmap="inferno", extent=edges, alpha=_opacity(share), vmin=0, vmax=top, interpolation="nearest")
    for boxes, marker, size, colour, label in (
        (heat.detections, "+", 7.0, "#ffffff", "detection"),
        (heat.estimates, "o", 13.0, "#4cc9f0", "extracted state"),
    ):
        x, y = (boxes[:, 0] + boxes[:, 2]) / 2, (boxes[:, 1] + boxes[:, 3]) / 2
        axes.plot(x, y, marker, color=colour, markersize=size, markerfacecolor="none", linestyle="", label=label)
    axes.set_xlim(0, info.width)
    axes.set_ylim(info.height, 0)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False, fontsize=9, labelcolor=INK)
    _colour_bar(figure, axes, top, heat.cell)
    return to_jpeg(figure)


def _opacity(share: F8) -> F8:
    """Nothing where nothing is expected, quickly opaque above it: a weak mass is what one looks for."""
    opacity: F8 = np.where(share > 0.004, 0.25 + 0.7 * share**0.5, 0.0)
    return opacity


def _colour_bar(figure: Figure, axes: Axes, top: float, cell: float) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = figure.colorbar(ScalarMappable(Normalize(0, top), "inferno"), ax=axes, fraction=0.03, pad=0.015)
    bar.set_label(f"expected objects in {cell:g} × {cell:g} pixels", fontsize=10, color=INK)
    bar.ax.tick_params(labelsize=9, colors=INK)


def _extent_of(record: RunRecord) -> SequenceInfo:
    """The frame size, or where nobody stated one, a frame that holds all tracks."""
    info = record.info
    if info.width > 0 and info.height > 0:
        return info
    reach = np.ceil(record.tracks.xyxy.max(axis=0, initial=1.0))
    return SequenceInfo(int(max(reach[2], 1)), int(max(reach[3], 1)), info.fps, info.frames, info.name)


def _scene(info: SequenceInfo, image: Image, width: float, *, darkness: float) -> tuple[Figure, Axes]:
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
    axes.set_aspect("equal")
    axes.set_xlabel("x in pixels", fontsize=10, color=INK)
    axes.set_ylabel("y in pixels", fontsize=10, color=INK)
    axes.tick_params(labelsize=9, colors=INK)
    return figure, axes


def _trajectory(axes: Axes, rows: Tracks, identity: int, *, labelled: bool) -> None:
    """One way: full where seen, thin where predicted, broken where frames are missing."""
    colour = hexadecimal(identity_colour(identity))
    x, y = (rows.xyxy[:, 0] + rows.xyxy[:, 2]) / 2, rows.xyxy[:, 3]
    missing = np.flatnonzero(np.diff(rows.frame) > 1) + 1
    seen = np.where(rows.predicted, np.nan, y)
    axes.plot(np.insert(x, missing, np.nan), np.insert(y, missing, np.nan), color=colour, linewidth=0.8, alpha=0.8)
    axes.plot(np.insert(x, missing, np.nan), np.insert(seen, missing, np.nan), color=colour, linewidth=1.8)
    axes.plot(x[0], y[0], "o", color=colour, markersize=5, markerfacecolor="none")
    if labelled:
        axes.annotate(
            str(identity),
            (x[-1], y[-1]),
            color="black",
            fontsize=7.5,
            ha="center",
            va="center",
            annotation_clip=True,
            bbox={"boxstyle": "round,pad=0.2", "facecolor": colour, "linewidth": 0},
        )
