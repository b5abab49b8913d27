"""The few pieces of HTML that a report is made of. Whatever comes from outside is escaped here and nowhere else.

``Html`` marks text that is already markup; functions take plain text as ``str`` and markup as ``Html``, and the type checker
keeps them apart.
"""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import NewType

from phdtrack.report.canvas import Picture

Html = NewType("Html", str)
NOTHING = Html("")


def text(value: str) -> Html:
    """Plain text, escaped. Characters that no browser shows (control characters, lone surrogates) become �."""
    shown = "".join(
        c if c in "\n\t" or (c >= " " and not "\ud800" <= c <= "\udfff" and c != "\x7f") else "\ufffd" for c in value
    )
    return Html(html.escape(shown, quote=True))


def join(parts: Iterable[Html]) -> Html:
    """Markup one after the other."""
    return Html("\n".join(parts))


def element(tag: str, content: Html, css: str = "") -> Html:
    """``<tag class="css">content</tag>``."""
    attribute = f' class="{css}"' if css else ""
    return Html(f"<{tag}{attribute}>{content}</{tag}>")


def section(title: str, *content: Html) -> Html:
    """A headed section; nothing where it would have no content."""
    body = join(part for part in content if part)
    return element("section", join([element("h2", text(title)), body])) if body else NOTHING


def paragraph(value: str, css: str = "") -> Html:
    """A paragraph of plain text."""
    return element("p", text(value), css)


def figure(picture: Picture, alt: str, caption: str, css: str) -> Html:
    """A picture with its alternative text and caption, scaled to the page."""
    image = Html(
        f'<img src="{picture.address}" alt="{text(alt)}" width="{picture.width}" height="{picture.height}" class="{css}">'
    )
    scroller = element("div", image, "scroll")
    return element("figure", join([scroller, element("figcaption", text(caption))]))


def table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]], css: str = "") -> Html:
    """A table; nothing where there are no rows. The first column heads its row."""
    body = [
        element("tr", join([Html(f'<th scope="row">{text(row[0])}</th>'), *(element("td", text(cell)) for cell in row[1:])]))
        for row in rows
    ]
    if not body:
        return NOTHING
    top = join(Html(f'<th scope="col">{text(cell)}</th>') for cell in head)
    parts = [element("thead", element("tr", top)), element("tbody", join(body))]
    return element("div", element("table", join(parts), css), "scroll")


def bullets(items: Iterable[str]) -> Html:
    """A list of plain sentences; nothing where there are none."""
    entries = [element("li", text(item)) for item in items]
    return element("ul", join(entries)) if entries else NOTHING


def details(summary: str, content: Html) -> Html:
    """Content that unfolds on request; nothing where there is none."""
    return element("details", join([element("summary", text(summary)), content])) if content else NOTHING
