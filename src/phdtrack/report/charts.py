"""The charts and pictures of reports. Each function returns a `Picture`: SVG for charts, JPEG for
drawings over a photograph.

Text and axes of a chart have the colour of the text around it, so that a page is light or dark as a
whole. Photographs are turned grey and darkened; axes are pixels of the original video.

`Figure` objects are made directly: neither pyplot nor a display is needed, and no rcParams change.
matplotlib is imported when the first figure is made, because that takes half a second.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from markupsafe import Markup

from phdtrack.errors import needed
from phdtrack.opencv_package import cv2
from phdtrack.report.appearance_worth import AppearanceWorth
from phdtrack.report.drawing import feet, identity_colour
from phdtrack.report.object_list import DAY, HOUR, MAP_CELLS, MINUTE, Minute, visited
from phdtrack.report.record import RunRecord, shrunk
from phdtrack.scene import LearnedDensity, Scene
from phdtrack.scene.mixture import place_map
from phdtrack.types import F8, Image, SequenceInfo

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from phdtrack.groups.group_stages import GroupFrame

# `_INK` becomes ``currentColor`` in an SVG; `_PALE` is for text on `_DARK`.
_INK = "#3a4250"
_PALE = "#c9d1de"
_DARK = "#1b1f27"
_CYAN = "#4cc9f0"
_BLUE = "#3b6fd4"
_ORANGE = "#e08a1e"
_GREEN = "#2a9d74"
_GREY = "#9aa5b8"
# Width of figures in inches, and of charts on a phone, with room for entries of a legend in a row.
_WIDTH = 8.2
_NARROW_WIDTH = 3.4
_NARROW_ENTRIES = 2
# Height of a row of the legend in inches.
_LEGEND_ROW = 0.2
_DOTS_PER_INCH = 144
# Most identities that get a label each, in the map and in the chart of lifetimes.
_MAX_LABELS = 80
_MAX_LABELLED_ROWS = 60
# Lines with more points are drawn as pixels, because their outlines would inflate the file.
_MAX_VECTOR_POINTS = 3000
# Frames with a more extreme aspect are stretched.
_MAX_ASPECT = 6.0
# Cells of a map along the longer side; density below which a cell is transparent.
_CELLS = 160
_MIN_DENSITY = 0.004
_JPEG_WIDTH = 1400
_JPEG_QUALITY = 87
_DOTS: Any = {"marker": ".", "linestyle": "", "color": _GREY, "markersize": 3, "alpha": 0.7}
_STEPS: Any = {"drawstyle": "steps-mid"}
_BAND: Any = {"color": _BLUE, "alpha": 0.18, "linewidth": 0}
# Gaussians with less weight are drawn without an arrow.
_MIN_WEIGHT = 0.02


class Picture(NamedTuple):
    """An encoded figure: ``data`` of type ``mime``, ``width`` × ``height`` in CSS pixels; of a
    chart also the one for phones, with text of the same size.
    """

    mime: str
    data: bytes
    width: int
    height: int
    narrow: bytes = b""

    @property
    def address(self) -> str:
        """The picture as a ``data:`` address."""
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}"

    @property
    def svg(self) -> Markup:
        """A chart as markup for a page; empty for other pictures."""
        if self.mime != "image/svg+xml":
            return Markup("")
        return _markup(self.data)

    @property
    def narrow_svg(self) -> Markup:
        """The chart for a phone as markup."""
        return _markup(self.narrow)


def _markup(data: bytes) -> Markup:
    """A chart in the colour of the text around it."""
    return Markup(data.decode().replace(_INK, "currentColor"))


def count_chart(record: RunRecord) -> Picture:
    """Objects over time: annotated (if there is truth), detected, expected by the filter, tracked.

    If the filter has a distribution of their number, a band shows its 90 % interval.
    """
    axes = _time_axes(record.times, "objects in the frame", 3.1)
    if len(record.count_range):
        # Half an object to either side, so that a certain number has a band too.
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
    axes.plot(record.times, record.mass, color=_BLUE, label="expected count")
    return _chart(axes, len(record), bottom=0)


def evidence_chart(record: RunRecord) -> Picture:
    """The log evidence of each frame: how well the filter predicted the detections."""
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
        times,
        np.maximum(people - deviation, 0),
        people + deviation,
        label="one standard deviation",
        **_BAND,
    )
    axes.plot(times, people, color=_BLUE, label="people estimated")
    axes.plot(times, named, color=_ORANGE, label="groups", **_STEPS)
    return _chart(axes, len(times), bottom=0)


def lifetime_chart(record: RunRecord) -> Picture:
    """One bar per identity from its first to its last frame; lighter while predicted, interrupted
    while missing.
    """
    names, row = np.unique(record.tracks.identity, return_inverse=True)
    height = float(np.clip(0.8 + 0.17 * len(names), 1.6, 9.0))
    axes = _time_axes(record.times, "identity", height)
    axes.grid(False, axis="y")
    # A bar covers consecutive frames that are all detected or all predicted.
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
    start = np.interp(frame[first], record.numbers, record.times)
    end = np.interp(frame[last], record.numbers, record.times)
    end += 1 / record.info.fps if record.info.fps > 1e-3 else 1.0
    colours = [(_colour(int(names[row[k]])), 0.35 if predicted[k] else 1.0) for k in first]
    thickness = 0.8 * 72 * (height - 0.6) / max(len(names), 1)
    axes.hlines(row[first], start, end, colors=colours, linewidth=thickness).set(capstyle="butt")
    if len(names) <= _MAX_LABELLED_ROWS:
        axes.set_yticks(range(len(names)), names.astype(str))
    else:
        axes.set_yticks([])
        axes.set_ylabel(f"{len(names)} identities, lowest on top", fontsize=10, color=_INK)
    axes.set_ylim(max(len(names), 1) - 0.4, -0.6)
    return _chart(axes, len(first))


def trajectory_picture(record: RunRecord) -> Picture:
    """The path of every identity's foot point over the scene.

    It is thick while detected, thin while predicted, and interrupted while rows are missing. A ring
    marks its start, and its number its end.
    """
    from matplotlib.collections import LineCollection

    axes = _frame_axes(record.info)
    tracks = record.tracks
    rows = [np.flatnonzero(tracks.identity == identity) for identity in np.unique(tracks.identity)]
    paths = [tracks.select(own[np.argsort(tracks.frame[own])]) for own in rows]
    colours = [_colour(int(path.identity[0])) for path in paths]
    for width, alpha, thin in ((0.8, 0.8, True), (1.8, 1.0, False)):
        lines = []
        for path in paths:
            points = np.where(path.predicted[:, None] & (not thin), np.nan, feet(path.xyxy))
            gaps = np.flatnonzero(np.diff(path.frame) > 1) + 1
            lines.append(np.insert(points, gaps, np.nan, axis=0))
        axes.add_collection(LineCollection(lines, colors=colours, linewidths=width, alpha=alpha))
    for path, colour in zip(paths, colours, strict=True):
        (x, y), (x_end, y_end) = feet(path.xyxy)[[0, -1]].tolist()
        axes.scatter(x, y, s=24, facecolors="none", edgecolors=[colour], linewidths=1.0)
        if len(paths) <= _MAX_LABELS:
            axes.text(
                x_end,
                y_end,
                str(path.identity[0]),
                bbox={"boxstyle": "round,pad=0.2", "facecolor": colour, "linewidth": 0},
                color="black",
                fontsize=7.5,
                ha="center",
                va="center",
                clip_on=True,
            )
    return _over_scene(axes, record.background, darkness=0.4)


def arrivals_chart(rows: Sequence[Minute], width: float) -> Picture:
    """Objects that were there, and those that came, in each stretch of ``width`` seconds."""
    unit, seconds = _unit(width)
    axes = _axes(2.4, f"time in {unit}", "objects")
    start = np.array([row.start for row in rows]) / seconds
    size = width / seconds
    style: dict[str, Any] = {"align": "edge"}
    axes.bar(start, [row.objects for row in rows], 0.9 * size, color=_BLUE, alpha=0.35, **style)
    axes.bar(start, [row.arrived for row in rows], 0.9 * size, color=_ORANGE, **style)
    for bars, label in zip(axes.containers, ("there", "arrived"), strict=True):
        bars.set_label(label)
    axes.locator_params(axis="y", integer=True)
    return _chart(axes, bottom=0)


def passages_chart(
    starts: Sequence[float], entered: Sequence[int], left: Sequence[int], width: float
) -> Picture:
    """Passages in, upwards, and out, downwards, in each stretch of ``width`` seconds.

    Parameters
    ----------
    starts : seconds at which each stretch begins.
    entered, left : passages in it.
    """
    unit, seconds = _unit(width)
    axes = _axes(2.0, f"time in {unit}", "out | in")
    start = np.array(starts) / seconds
    size = 0.9 * width / seconds
    axes.bar(start, entered, size, color=_BLUE, alpha=0.7, align="edge", label="in")
    axes.bar(start, [-count for count in left], size, color=_ORANGE, align="edge", label="out")
    axes.axhline(0.0, color=_INK, linewidth=0.6)
    axes.locator_params(axis="y", integer=True)
    axes.yaxis.set_major_formatter(lambda value, _: f"{abs(value):g}")
    return _chart(axes)


def _unit(width: float) -> tuple[str, float]:
    """The unit of a time axis with bars of so many seconds, and its seconds."""
    if width < 60:
        return "seconds", 1.0
    if width < HOUR:
        return "minutes", MINUTE
    return ("hours", HOUR) if width < DAY else ("days", DAY)


def histogram_chart(values: Sequence[float], label: str) -> Picture:
    """How many objects have a value, in at most 24 bars of equal width from 0 on.

    Parameters
    ----------
    values : of the objects; those that are not known are left out.
    label : what the values are, with their unit.
    """
    axes = _axes(2.2, label, "objects")
    known = np.array([value for value in values if math.isfinite(value)])
    most = float(known.max()) if len(known) else 1.0
    bars = min(24, max(6, len(known)))
    axes.hist(known, bars, range=(0.0, most or 1.0), color=_BLUE, alpha=0.7, rwidth=0.92)
    axes.locator_params(axis="y", integer=True)
    return _chart(axes, bottom=0)


def visited_picture(record: RunRecord) -> Picture:
    """A map of where the foot points of the tracks were, over the scene."""
    info = record.info
    axes = _frame_axes(info)
    boxes = visited(record.tracks, info)
    level = np.sqrt(boxes / max(int(boxes.max()), 1))
    step = max(info.width, info.height) / MAP_CELLS
    axes.imshow(
        level,
        cmap="inferno",
        extent=(0, boxes.shape[1] * step, boxes.shape[0] * step, 0),
        alpha=np.where(level > 0, 0.25 + 0.7 * level, 0.0),
        vmin=0,
        vmax=1,
        interpolation="bilinear",
    )
    axes.set(xlim=(0, info.width), ylim=(info.height, 0))
    return _over_scene(axes, record.background, darkness=0.5)


def map_picture(learned: LearnedDensity, scene: Scene, image: Image, *, births: bool) -> Picture:
    """A map of expected births or false alarms over the frame [M09 Figs. 7, 8].

    Parameters
    ----------
    learned : density over pixels.
    scene : the scene to which it belongs.
    image : (H, W, 3) BGR frame, or (0, 0, 3).
    births : True: draw the mean path of the next second as arrows.
    """
    p = learned.density
    width = scene.width
    height = scene.height
    axes = _frame_axes(SequenceInfo(width, height, 25.0))
    step = max(width, height) / _CELLS
    shape = (math.ceil(height / step), math.ceil(width / step))
    density = place_map(p, shape, step)
    # Opacity rises steeply from 0, because weak densities matter.
    alpha = np.where(density > _MIN_DENSITY, 0.25 + 0.7 * np.clip(density, 0, 1) ** 0.5, 0.0)
    axes.imshow(
        density,
        cmap="inferno",
        extent=(0, shape[1] * step, shape[0] * step, 0),
        alpha=alpha,
        vmin=0,
        vmax=1,
        interpolation="bilinear",
    )
    for m in np.flatnonzero(p.weight >= _MIN_WEIGHT) if births else ():
        start = p.mean[:2, m]
        path = p.mean[2:4, m] * scene.rate
        style = {"arrowstyle": "-|>", "color": _CYAN, "linewidth": 1 + 4 * float(p.weight[m])}
        axes.annotate("", xy=tuple(start + path), xytext=tuple(start), arrowprops=style)
    axes.set(xlim=(0, width), ylim=(height, 0))
    return _over_scene(axes, image, darkness=0.5)


def similarity_chart(worth: AppearanceWorth) -> Picture:
    """How similar objects look to themselves and to each other: pairs counted, and the densities
    that were learned.
    """
    axes = _axes(2.8, "similarity", "share of pairs")
    edges = worth.edges
    x = np.linspace(-1, 1, 401)
    width = float(edges[1] - edges[0])
    seen = np.flatnonzero(worth.same + worth.other)
    sides = (
        (worth.same, _BLUE, "the same object"),
        (worth.other, _ORANGE, "two objects"),
    )
    for (pairs, colour, label), curve in zip(sides, worth.curves(x), strict=True):
        share = pairs / max(int(pairs.sum()), 1)
        axes.stairs(share, edges, fill=True, color=colour, alpha=0.35, label=label)
        axes.plot(x, width * curve, color=colour, linewidth=1.5)
    if len(seen):
        axes.set_xlim(float(edges[seen[0]]) - 0.1, min(float(edges[seen[-1] + 1]) + 0.1, 1.0))
    return _chart(axes, bottom=0)


def share_picture(shares: F8, size: tuple[int, int], image: Image) -> Picture:
    """A map of shares (rows, columns) over the frame, brighter for larger ones.

    Parameters
    ----------
    shares : from 0 to 1, for each place.
    size : width and height of the frame.
    image : (H, W, 3) BGR frame, or (0, 0, 3).
    """
    axes = _frame_axes(SequenceInfo(*size, 25.0))
    # Weak places matter, and are not to look darker than the picture.
    bright = (shares / max(float(shares.max(initial=0.0)), 1e-9)) ** 0.5
    axes.imshow(
        0.3 + 0.7 * bright,
        cmap="inferno",
        extent=(0, size[0], size[1], 0),
        alpha=np.where(bright > 0, 0.3 + 0.6 * bright, 0.0),
        vmin=0,
        vmax=1,
        interpolation="nearest",
    )
    axes.set(xlim=(0, size[0]), ylim=(size[1], 0))
    return _over_scene(axes, image, darkness=0.5)


def jpeg(image: Image) -> Picture:
    """A picture (H, W, 3) BGR as JPEG, shrunk to at most 1400 pixels in width."""
    image = shrunk(image, _JPEG_WIDTH)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return Picture("image/jpeg", data.tobytes(), image.shape[1], image.shape[0])


def _colour(identity: int) -> str:
    """The colour of an identity as matplotlib takes it."""
    return f"#{bytes(identity_colour(identity)).hex()}"


def _axes(height: float, x_label: str, y_label: str, ink: str = _INK) -> Axes:
    """Axes with a height in inches, in the style of all charts: a light grid, no frame at the top
    and right.
    """
    figure = needed("matplotlib.figure").Figure(figsize=(_WIDTH, height), layout="constrained")
    axes: Axes = figure.add_subplot()
    axes.set_xlabel(x_label, fontsize=10, color=ink)
    axes.set_ylabel(y_label, fontsize=10, color=ink)
    axes.tick_params(labelsize=9, colors=ink)
    axes.grid(True, color=ink, alpha=0.15, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(ink)
    return axes


def _time_axes(times: F8, y_label: str, height: float) -> Axes:
    """Axes over the time of all frames, at ``times`` (F,)."""
    axes = _axes(height, "time in seconds", y_label)
    if len(times) and times[-1] > times[0]:
        axes.set_xlim(float(times[0]), float(times[-1]))
    return axes


def _frame_axes(info: SequenceInfo) -> Axes:
    """Axes in pixels of the frame, without background."""
    height = float(np.clip((_WIDTH - 1.2) * info.height / info.width + 0.7, 1.8, 9.0))
    axes = _axes(height, "x in pixels", "y in pixels", _PALE)
    axes.grid(False)
    axes.spines[:].set(visible=True, color=_PALE)
    axes.set_facecolor("none")
    stretched = not 1 / _MAX_ASPECT < info.width / info.height < _MAX_ASPECT
    axes.set(xlim=(0, info.width), ylim=(info.height, 0), aspect="auto" if stretched else "equal")
    return axes


def _over_scene(axes: Axes, image: Image, *, darkness: float) -> Picture:
    """The drawing in the axes of a frame as JPEG, over the darkened grey photograph, or a dark
    background if it is empty.

    matplotlib would take some 20 MB more to draw the photograph itself.
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
        shrinks = right - left < image.shape[1]
        method = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
        grey = cv2.resize(grey, (right - left, high - low), interpolation=method)
        dark = cv2.convertScaleAbs(grey, alpha=1 - darkness)
        ground[len(ground) - high : len(ground) - low, left:right] = dark[..., None]
    alpha = drawn[..., 3]
    for k in range(3):
        above = cv2.multiply(drawn[..., 2 - k], alpha, scale=1 / 255)
        below = cv2.multiply(ground[..., k], 255 - alpha, scale=1 / 255)
        ground[..., k] = cv2.add(above, below)
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    return jpeg(ground)._replace(width=width, height=height)


def _chart(axes: Axes, points: int = 0, bottom: float | None = None) -> Picture:
    """The figure as transparent SVG with a legend above its axes, text as outlines, and no date;
    and the same in the width of a phone.
    """
    axes.set_ylim(bottom=bottom)
    for artist in (*axes.lines, *axes.collections):
        artist.set_rasterized(points > _MAX_VECTOR_POINTS)
    entries = len(axes.get_legend_handles_labels()[0])
    figure: Any = axes.get_figure(root=True)
    _legend(axes, entries)
    wide = _as_svg(figure)
    width, height = (round(96 * float(inches)) for inches in figure.get_size_inches())
    rows = 1
    if entries > _NARROW_ENTRIES:
        rows = math.ceil(entries / _NARROW_ENTRIES)
        _legend(axes, _NARROW_ENTRIES)
    inches = float(figure.get_size_inches()[1]) + _LEGEND_ROW * (rows - 1)
    figure.set_size_inches(_NARROW_WIDTH, inches)
    return Picture("image/svg+xml", wide, width, height, _as_svg(figure))


def _legend(axes: Axes, columns: int) -> None:
    """Draw the legend above the axes, if anything has a label."""
    if columns:
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0, 1),
            ncols=columns,
            frameon=False,
            fontsize=9.0,
            labelcolor=_INK,
        )


def _as_svg(figure: Any) -> bytes:
    """The figure as SVG for a page, which needs no XML declaration."""
    buffer = io.BytesIO()
    figure.savefig(
        buffer,
        dpi=_DOTS_PER_INCH,
        format="svg",
        transparent=True,
        metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")),
    )
    data = buffer.getvalue()
    return data[data.find(b"<svg") :]
