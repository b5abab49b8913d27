"""The page of a learned scene: where births and false alarms are expected, over a frame, and what the learning is worth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.report.canvas import Picture, chart_axes, new_figure, to_jpeg
from phdtrack.report.html import bare_header, page
from phdtrack.report.markup import NOTHING, Html, figure, join, paragraph, section, table, text
from phdtrack.report.scenes import opacity, over_scene
from phdtrack.scene import Learned, Scene
from phdtrack.scene.maps import place_map
from phdtrack.types import Image, SequenceInfo

_WIDTH = 8.2
_CELLS = 160
# Gaussians lighter than this are not drawn with an arrow.
_LIGHTEST = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Lessons:
    """A scene with what is told of it: a frame (H, W, 3), or (0, 0, 3), the gains in nats per unseen sample, and from what
    it was learned, in words."""

    scene: Scene
    image: Image
    births_gain: float = math.nan
    clutter_gain: float = math.nan
    births_from: str = ""
    clutter_from: str = ""


def scene_page(lessons: Lessons, lead: str, command: str) -> str:
    """The whole page as text."""
    scene = lessons.scene
    body = [
        bare_header(text("What was learned of the scene"), scene.source, lead),
        _part("Births", "expected births per second", scene.births, lessons, scene.rate),
        _part("False alarms", "expected false alarms per frame", scene.clutter, lessons, 1.0),
        _followed(scene),
        section("How to use it", paragraph(command)),
    ]
    return page(text("Learned scene"), join(body))


def map_picture(learned: Learned, scene: Scene, image: Image, *, births: bool) -> Picture:
    """Where it is expected, over the frame; for births the mean way of the next second as an arrow [M09 Figs. 7, 8].

    Births on the ground are drawn on a plan of their region, in metres.
    """
    p = learned.density
    (left, top), (wide, high) = p.low[:2], (p.high - p.low)[:2]
    ground = (left, top, wide, high) != (0, 0, scene.width, scene.height)
    if ground:
        drawn = new_figure(_WIDTH, _WIDTH * min(max(high / wide, 0.3), 1.5))
        axes = chart_axes(drawn, "x in metres", "y in metres")
    else:
        drawn, axes = over_scene(SequenceInfo(scene.width, scene.height, 25.0), image, _WIDTH, darkness=0.5)
    step = max(wide, high) / _CELLS
    shape = (math.ceil(high / step), math.ceil(wide / step))
    share = place_map(p, shape, step, sized=p.dim == 6 or not births)
    edges = (left, left + shape[1] * step, top + shape[0] * step, top)
    axes.imshow(share, cmap="inferno", extent=edges, alpha=opacity(share), vmin=0, vmax=1, interpolation="bilinear")
    if births:
        for m in np.flatnonzero(p.weight >= _LIGHTEST):
            x, y = p.mean[:2, m]
            way = p.mean[2:4, m] * scene.rate
            style = {"arrowstyle": "-|>", "color": "#4cc9f0", "linewidth": 1 + 4 * float(p.weight[m])}
            axes.annotate("", xy=(x + way[0], y + way[1]), xytext=(x, y), arrowprops=style)
    axes.set_xlim(left, left + wide)
    # Of a plan the far end is above, of a picture row 0.
    axes.set_ylim(*((top, top + high) if ground else (top + high, top)))
    return to_jpeg(drawn)


def _part(title: str, rate: str, learned: Learned | None, lessons: Lessons, per: float) -> Html:
    if learned is None:
        return section(title, paragraph("Not learned: as without a scene."))
    p, births = learned.density, learned is lessons.scene.births
    gain = lessons.births_gain if births else lessons.clutter_gain
    origin = lessons.births_from if births else lessons.clutter_from
    rows = [
        ("samples", str(learned.samples)),
        (rate, f"{learned.rate * per:.3g}"),
        ("Gaussians that were left", str(len(p))),
        ("share that may be anywhere", f"{100 * p.uniform:.1f} %"),
        ("log-likelihood of samples not learned from, above uniform", _nats(gain)),
    ]
    caption = "Bright: expected here most. " + ("Arrows: the way of the first second." if births else "")
    picture = map_picture(learned, lessons.scene, lessons.image, births=births)
    told = paragraph(origin[:1].upper() + origin[1:]) if origin else NOTHING
    return section(
        title, told, table(("", ""), rows), figure(picture, f"Map of {title.lower()}", caption, "wide") or NOTHING
    )


def _followed(scene: Scene) -> Html:
    """What is known of the false alarms that the tracker follows."""
    if scene.clutter is None:
        return NOTHING
    title = "Who is held back"
    if scene.followed is None or not scene.followed.share:
        return section(title, paragraph("Nobody: nobody has looked at what of the false alarms the tracker follows."))
    rows = [
        ("false alarms that the tracker follows although it knows them", f"{100 * scene.followed.share:.2g} %"),
        ("detections of objects a frame", f"{scene.followed.objects.rate:.3g}"),
    ]
    told = paragraph(
        "Tracks that stay where false alarms are followed, until they have been where an object is the likelier. "
        "Who enters there is therefore reported later. Where false alarms are rare among objects, live tracks are confirmed "
        "with their first state."
    )
    return section(title, told, table(("", ""), rows))


def _nats(gain: float) -> str:
    return f"{gain:+.2f} nats each" if math.isfinite(gain) else "too few samples to leave any out"
