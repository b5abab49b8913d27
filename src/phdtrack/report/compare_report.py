"""The report of a comparison: tables with intervals, charts, the frames in which methods differ most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from phdtrack.report.canvas import Picture
from phdtrack.report.html import again, bare_header, page
from phdtrack.report.markup import NOTHING, Html, bullets, element, figure, join, paragraph, section, table, text
from phdtrack.report.record import About
from phdtrack.report.run_json import write_text
from phdtrack.types import Image

_WIDEST = 1400


@dataclass(frozen=True, slots=True)
class Table:
    """A table under a title, with a sentence before it."""

    title: str
    intro: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Shown:
    """A picture with its caption, which is its alternative text too."""

    picture: Picture
    caption: str


@dataclass(frozen=True, slots=True)
class ComparePage:
    """What the report of a comparison shows, in the order of the page."""

    about: About
    source: str
    lead: str
    pooled: Sequence[Table]
    charts: Sequence[tuple[str, Sequence[Shown]]]
    single: Sequence[Table]
    frames: Sequence[Shown]
    legend: str
    config: Mapping[str, object]
    seeds: int = 1


def write_comparison(path: Path, content: ComparePage) -> None:
    """Write the report. Raises `InputError` where the file cannot be written."""
    about = content.about
    warnings = bullets(about.warnings)
    body = [
        bare_header(text(about.title), content.source, content.lead),
        element("section", join([element("h2", text("Warnings")), warnings]), "warnings") if warnings else NOTHING,
        *(_table(one) for one in content.pooled),
        *(section(title, element("div", join(map(_figure, shown)), "grid")) for title, shown in content.charts),
        *(_table(one) for one in content.single),
        _frames(content),
        section("Good to know", bullets(about.notes)),
        again(about, content.config, content.seeds),
    ]
    write_text(path, page(text(about.title), join(part for part in body if part)))


def encoded(image: Image) -> Picture:
    """A picture (H, W, 3) BGR as JPEG, no wider than a page can show."""
    high, wide = image.shape[:2]
    if wide > _WIDEST:
        size = (_WIDEST, round(high * _WIDEST / wide))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(image.dtype)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return Picture("image/jpeg", data.tobytes(), image.shape[1], image.shape[0])


def _table(one: Table) -> Html:
    intro = paragraph(one.intro) if one.intro else NOTHING
    return section(one.title, intro, table(one.head, one.rows, "cells")) if one.rows else NOTHING


def _figure(one: Shown) -> Html:
    return figure(one.picture, one.caption, one.caption, "photo")


def _frames(content: ComparePage) -> Html:
    if not content.frames:
        return NOTHING
    return section("The worst frames", paragraph(content.legend), *map(_figure, content.frames))
