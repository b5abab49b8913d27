"""The charts and pictures of reports. Each function gives a `Picture`: charts are SVG, what lies
over a photograph JPEG.

Text and axes of a chart have the colour of the text around it, so that a page is light or dark as a
whole.

`Figure` objects are made directly: neither pyplot nor a display is needed and no rcParams change.
matplotlib takes half a second to import: it is imported where a figure is made. Photographs are
turned grey and darkened; axes are pixels of the original video.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from markupsafe import Markup

from phdtrack.errors import needed
from phdtrack.report.drawing import feet, identity_colour
from phdtrack.report.record import RunRecord, shrunk
from phdtrack.scene import LearnedDensity, Scene
from phdtrack.scene.mixture import place_map
from phdtrack.types import F8, Image, SequenceInfo

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from phdtrack.groups.group_stages import GroupFrame

# `_INK` stands in an SVG as ``currentColor``; `_PALE` is for what is written on `_DARK`.
_INK = "#3a4250"
_PALE = "#c9d1de"
_DARK = "#1b1f27"
_CYAN = "#4cc9f0"
_BLUE = "#3b6fd4"
_ORANGE = "#e08a1e"
_GREEN = "#2a9d74"
_GREY = "#9aa5b8"
# Inches, and dots in each.
_WIDE = 8.2
_DOTS_PER_INCH = 144
# Identities with a label each; points of a line, or bars, up to which they are outlines: more would
# swell the file.
_LABELS = 80
_LABELLED_ROWS = 60
_OUTLINES = 3000
_MAX_STRETCH = 6.0
_CELLS = 160
_DOTS: Any = {"marker": ".", "linestyle": "", "color": _GREY, "markersize": 3, "alpha": 0.7}
_STEPS: Any = {"drawstyle": "steps-mid"}
_BAND: Any = {"color": _BLUE, "alpha": 0.18, "linewidth": 0}
# Gaussians lighter than this are drawn without an arrow.
_MIN_WEIGHT = 0.02


class Picture(NamedTuple):
    """An encoded figure: ``data`` of type ``mime``, ``width`` × ``height`` in CSS pixels."""

    mime: str
    data: bytes
    width: int
    height: int

    @property
    def address(self) -> str:
        """The picture as a ``data:`` address."""
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}"

    @property
    def svg(self) -> Markup:
        """A chart as markup to stand in a page, empty for other pictures."""
        return Markup(
            self.data.decode().replace(_INK, "currentColor") if self.mime == "image/svg+xml" else ""
        )


def count_chart(record: RunRecord) -> Picture:
    """Objects over time: annotated (where there is truth), detected, expected by the filter,
    tracked.

    Where the filter carries the distribution of the number, a band shows between which numbers it
    lies with 90 %.
    """
    axes = _time_axes(record.times, "objects in the frame", 3.1)
    if len(record.count_range):
        # Half an object to either side: a number that is certain has a band too.
        low, high = record.count_range.T
        axes.fill_between(
            record.times,
            np.maximum(low - 0.5, 0),
            high + 0.5,
            label="number, 90 %",
            step="mid",
            **_BAND,
        )
    axes.plot(record.times, record.n_detections, label="detections", **_DOTS)
    if len(record.truth_count):
        axes.plot(
            record.times,
            record.truth_count,
            color=_GREEN,
            linewidth=5,
            alpha=0.4,
            label="truth",
            **_STEPS,
        )
    axes.plot(record.times, record.track_count, color=_ORANGE, label="tracks", **_STEPS)
    axes.plot(record.times, record.mass, color=_BLUE, label="expected count (mass of the filter)")
    return _chart(axes, len(record), bottom=0)


def evidence_chart(record: RunRecord) -> Picture:
    """How well the filter foretold the detections, frame by frame."""
    axes = _time_axes(record.times, "log evidence", 1.8)
    axes.plot(record.times, record.log_evidence, color=_BLUE)
    return _chart(axes, len(record))


def group_chart(frames: Sequence[GroupFrame], detections: Sequence[int]) -> Picture:
    """People, groups and raw detections over time [E13 Fig. 2]."""
    numbers = [(frame.time, frame.people, frame.deviation, frame.named) for frame in frames]
    times, people, deviation, named = np.array(numbers).T
    axes = _time_axes(times, "number", 3.1)
    axes.plot(times, detections, label="detections", **_DOTS)
    axes.fill_between(
        times, np.maximum(people - deviation, 0), people + deviation, label="one deviation", **_BAND
    )
    axes.plot(times, people, color=_BLUE, label="people estimated")
    axes.plot(times, named, color=_ORANGE, label="groups", **_STEPS)
    return _chart(axes, len(times), bottom=0)


def lifetime_chart(record: RunRecord) -> Picture:
    """One bar for each identity from its first to its last frame; lighter where predicted, white
    where missing.
    """
    names, row = np.unique(record.tracks.identity, return_inverse=True)
    height = float(np.clip(0.8 + 0.17 * len(names), 1.6, 9.0))
    axes = _time_axes(record.times, "identity", height)
    axes.grid(False, axis="y")
    # A bar is a stretch of consecutive frames, all seen or all predicted.
    order = np.lexsort((record.tracks.frame, record.tracks.predicted, row))
    row = row[order]
    frame = record.tracks.frame[order]
    predicted = record.tracks.predicted[order]
    first = np.flatnonzero(
        (np.diff(row, prepend=-1) != 0)
        | np.diff(predicted, prepend=False)
        | (np.diff(frame, prepend=0) > 1)
    )
    last = np.append(first[1:], len(row))[: len(first)] - 1
    start, end = (np.interp(frame[k], record.numbers, record.times) for k in (first, last))
    colours = [(_colour(int(names[row[k]])), 0.35 if predicted[k] else 1.0) for k in first]
    thick = 0.8 * 72 * (height - 0.6) / max(len(names), 1)
    end += 1 / record.info.fps if record.info.fps > 1e-3 else 1.0
    axes.hlines(row[first], start, end, colors=colours, linewidth=thick).set(capstyle="butt")
    if len(names) <= _LABELLED_ROWS:
        axes.set_yticks(range(len(names)), names.astype(str))
    else:
        axes.set_yticks([])
        axes.set_ylabel(
            f"{len(names)} identities, the lowest number on top", fontsize=10, color=_INK
        )
    axes.set_ylim(max(len(names), 1) - 0.4, -0.6)
    return _chart(axes, len(first))


def trajectory_picture(record: RunRecord) -> Picture:
    """The way of every identity's foot point over the scene: full where seen, thin where predicted,
    broken where rows are missing; a ring where it appeared, its number where it was last seen."""
    from matplotlib.collections import LineCollection

    axes = _frame_axes(record.info)
    tracks = record.tracks
    rows = [np.flatnonzero(tracks.identity == identity) for identity in np.unique(tracks.identity)]
    paths = [tracks.select(own[np.argsort(tracks.frame[own])]) for own in rows]
    colours = [_colour(int(path.identity[0])) for path in paths]
    for width, alpha, thin in ((0.8, 0.8, True), (1.8, 1.0, False)):
        ways = []
        for path in paths:
            way = np.where(path.predicted[:, None] & (not thin), np.nan, feet(path.xyxy))
            ways.append(np.insert(way, np.flatnonzero(np.diff(path.frame) > 1) + 1, np.nan, axis=0))
        axes.add_collection(LineCollection(ways, colors=colours, linewidths=width, alpha=alpha))
    for path, colour in zip(paths, colours, strict=True):
        (x, y), (x_end, y_end) = feet(path.xyxy)[[0, -1]].tolist()
        axes.scatter(x, y, s=24, facecolors="none", edgecolors=[colour], linewidths=1.0)
        if len(paths) <= _LABELS:
            look: Any = {
                "color": "black",
                "fontsize": 7.5,
                "ha": "center",
                "va": "center",
                "clip_on": True,
            }
            plate = {"boxstyle": "round,pad=0.2", "facecolor": colour, "linewidth": 0}
            axes.text(x_end, y_end, str(path.identity[0]), bbox=plate, **look)
    return _over_scene(axes, record.background, darkness=0.4)


def map_picture(learned: LearnedDensity, scene: Scene, image: Image, *, births: bool) -> Picture:
    """Where births or false alarms are expected, over the frame [M09 Figs. 7, 8].

    Parameters
    ----------
    learned : over pixels.
    scene : whose they are.
    image : (H, W, 3) BGR frame, or (0, 0, 3).
    births : whether to draw the mean way of the next second as arrows.
    """
    p = learned.density
    wide = scene.width
    high = scene.height
    axes = _frame_axes(SequenceInfo(wide, high, 25.0))
    step = max(wide, high) / _CELLS
    shape = (math.ceil(high / step), math.ceil(wide / step))
    # Clear where nothing is expected, quickly opaque above it, because a weak mass matters.
    density = place_map(p, shape, step)
    extent = (0, shape[1] * step, shape[0] * step, 0)
    alpha = np.where(density > 0.004, 0.25 + 0.7 * np.clip(density, 0, 1) ** 0.5, 0.0)
    axes.imshow(
        density,
        cmap="inferno",
        extent=extent,
        alpha=alpha,
        vmin=0,
        vmax=1,
        interpolation="bilinear",
    )
    for m in np.flatnonzero(p.weight >= _MIN_WEIGHT) if births else ():
        start = p.mean[:2, m]
        way = p.mean[2:4, m] * scene.rate
        style = {"arrowstyle": "-|>", "color": _CYAN, "linewidth": 1 + 4 * float(p.weight[m])}
        axes.annotate("", xy=tuple(start + way), xytext=tuple(start), arrowprops=style)
    axes.set(xlim=(0, wide), ylim=(high, 0))
    return _over_scene(axes, image, darkness=0.5)


def jpeg(image: Image) -> Picture:
    """A picture (H, W, 3) BGR as JPEG, shrunk to 1400 pixels where it is wider."""
    image = shrunk(image, 1400)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 87])
    return Picture("image/jpeg", data.tobytes(), image.shape[1], image.shape[0])


def _colour(identity: int) -> str:
    """The colour of an identity as matplotlib takes it."""
    return f"#{bytes(identity_colour(identity)).hex()}"


def _axes(height: float, x_label: str, y_label: str, ink: str = _INK) -> Axes:
    """Axes of so many inches in the style of all charts: a light grid behind, no frame above and
    right.
    """
    axes: Axes = (
        needed("matplotlib.figure")
        .Figure(figsize=(_WIDE, height), layout="constrained")
        .add_subplot()
    )
    axes.set_xlabel(x_label, fontsize=10, color=ink)
    axes.set_ylabel(y_label, fontsize=10, color=ink)
    axes.tick_params(labelsize=9, colors=ink)
    axes.grid(True, color=ink, alpha=0.15, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(ink)
    return axes


def _time_axes(times: F8, y_label: str, height: float) -> Axes:
    """Axes over the whole run of frames at ``times`` (F,)."""
    axes = _axes(height, "time in seconds", y_label)
    if len(times) and times[-1] > times[0]:
        axes.set_xlim(float(times[0]), float(times[-1]))
    return axes


def _frame_axes(info: SequenceInfo) -> Axes:
    """Axes that are the frame in pixels, on no ground."""
    height = float(np.clip((_WIDE - 1.2) * info.height / info.width + 0.7, 1.8, 9.0))
    axes = _axes(height, "x in pixels", "y in pixels", _PALE)
    axes.grid(False)
    axes.spines[:].set(visible=True, color=_PALE)
    axes.set_facecolor("none")
    stretched = not 1 / _MAX_STRETCH < info.width / info.height < _MAX_STRETCH
    axes.set(xlim=(0, info.width), ylim=(info.height, 0), aspect="auto" if stretched else "equal")
    return axes


def _over_scene(axes: Axes, image: Image, *, darkness: float) -> Picture:
    """What was drawn in the axes of a frame as JPEG, over the darkened grey photograph, or a dark
    ground where it is empty.

    To put a photograph under its axes itself matplotlib takes some 20 MB more.
    """
    figure: Any = axes.get_figure(root=True)
    canvas = needed("matplotlib.backends.backend_agg").FigureCanvasAgg(figure)
    figure.set(dpi=_DOTS_PER_INCH, facecolor="none")
    canvas.draw()
    drawn = np.asarray(canvas.buffer_rgba())
    ground = np.full(
        (*drawn.shape[:2], 3), [int(_DARK[k : k + 2], 16) for k in (5, 3, 1)], np.uint8
    )
    if image.size:
        left, low, right, high = np.rint(axes.get_window_extent().extents).astype(int).tolist()
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if right - left < image.shape[1]:
            way = cv2.INTER_AREA
        else:
            way = cv2.INTER_CUBIC
        grey = cv2.resize(grey, (right - left, high - low), interpolation=way)
        ground[len(ground) - high : len(ground) - low, left:right] = cv2.convertScaleAbs(
            grey, alpha=1 - darkness
        )[..., None]
    for k in range(3):
        above = cv2.multiply(drawn[..., 2 - k], drawn[..., 3], scale=1 / 255)
        ground[..., k] = cv2.add(
            above, cv2.multiply(ground[..., k], 255 - drawn[..., 3], scale=1 / 255)
        )
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    return jpeg(ground)._replace(width=width, height=height)


def _chart(axes: Axes, points: int = 0, bottom: float | None = None) -> Picture:
    """The figure with a legend above its axes, as SVG on a transparent ground: text as outlines, no
    date.
    """
    axes.set_ylim(bottom=bottom)
    for artist in (*axes.lines, *axes.collections):
        artist.set_rasterized(points > _OUTLINES)
    if handles := axes.get_legend_handles_labels()[0]:
        look = {"ncols": len(handles), "frameon": False, "fontsize": 9.0, "labelcolor": _INK}
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), **look)
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure: Any = axes.get_figure(root=True)
    figure.savefig(
        buffer := io.BytesIO(), dpi=_DOTS_PER_INCH, format="svg", transparent=True, metadata=nothing
    )
    data = buffer.getvalue()
    wide, high = (round(96 * float(inches)) for inches in figure.get_size_inches())
    return Picture(
        "image/svg+xml", data[data.find(b"<svg") :], wide, high
    )  # without its XML declaration
