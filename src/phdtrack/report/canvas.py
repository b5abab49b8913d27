"""Figures without matplotlib's global state, and their way into bytes.

`Figure` objects are made directly, so that neither pyplot nor a display is needed and no rcParams change. Charts become
SVG, pictures with a photograph inside become JPEG; both stand in the report as data addresses. matplotlib takes half a
second to import: it is imported where a figure is made.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from phdtrack.types import F8

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK = "#3a4250"
GRID = "#dfe3ea"
_SMALL = 9.0


@dataclass(frozen=True, slots=True)
class Picture:
    """An encoded figure: ``data`` of type ``mime``, ``width`` × ``height`` in CSS pixels."""

    mime: str
    data: bytes
    width: int
    height: int

    @property
    def address(self) -> str:
        """The picture as a ``data:`` address."""
        return f"data:{self.mime};base64,{base64.b64encode(self.data).decode('ascii')}"


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of ``width`` × ``height`` inches that lays itself out."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def chart_axes(figure: Figure, x_label: str, y_label: str, *, position: int = 111) -> Axes:
    """Axes in the style of all charts: a light grid behind, no frame at the top and right."""
    axes = figure.add_subplot(position)
    axes.set_xlabel(x_label, fontsize=_SMALL + 1, color=INK)
    axes.set_ylabel(y_label, fontsize=_SMALL + 1, color=INK)
    axes.tick_params(labelsize=_SMALL, colors=INK)
    axes.grid(True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(INK)
    return axes


def legend(axes: Axes) -> None:
    """A legend in one line above the axes, where it covers nothing."""
    handles, _ = axes.get_legend_handles_labels()
    if handles:
        axes.legend(
            loc="lower left", bbox_to_anchor=(0, 1), ncols=len(handles), frameon=False, fontsize=_SMALL, labelcolor=INK
        )


def to_svg(figure: Figure) -> Picture:
    """The figure as SVG on a transparent ground: text as outlines, no date, no address of anything."""
    buffer = io.BytesIO()
    nothing = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure.savefig(buffer, format="svg", transparent=True, metadata=nothing)
    text = buffer.getvalue()
    return _picture("image/svg+xml", text[text.index(b"<svg") :], figure)


def to_jpeg(figure: Figure, *, dpi: int = 144) -> Picture:
    """The figure as JPEG on white, for photographs."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="jpg", dpi=dpi, facecolor="white", pil_kwargs={"quality": 87})
    return _picture("image/jpeg", buffer.getvalue(), figure)


def _picture(mime: str, data: bytes, figure: Figure) -> Picture:
    wide, high = figure.get_size_inches()
    return Picture(mime, data, round(96 * float(wide)), round(96 * float(high)))


def thinned(values: F8, limit: int) -> F8:
    """(n, …) means over consecutive blocks of ``values`` (N, …), so that n ≤ ``limit``; unchanged where N ≤ ``limit``."""
    block = block_size(len(values), limit)
    if block == 1:
        return values
    starts = np.arange(0, len(values), block)
    counts = np.diff([*starts, len(values)]).reshape(-1, *[1] * (values.ndim - 1))
    means: F8 = np.add.reduceat(values, starts, axis=0) / counts
    return means


def block_size(length: int, limit: int) -> int:
    """Frames that `thinned` puts into one point."""
    return max(1, -(-length // limit))
