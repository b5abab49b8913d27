"""Jinja2 templates turned into text, and the few words and numbers that templates, terminal and files share.

Whatever a template prints is escaped, unless it is `markupsafe.Markup`. Control characters and lone surrogates, which no
browser shows, become �.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jinja2 import Environment

NBSP = "\u00a0"
"""A space that does not break; unlike the narrow ones every legacy terminal encoding has it."""
_LOWER = """
OSPA GOSPA OSPA2 TGOSPA TGOSPA_localisation TGOSPA_missed TGOSPA_false TGOSPA_switching id_switches misses false_positives
fragments false_tracks mostly_lost delay_mean count_error_rms ms
"""
_HIGHER = """
MODA N_MODA MODP MOTA MOTA_log MOTP IDF1 HOTA SFDA ATA DetA AssA IDP IDR N_MODA_detection ATA_matched matches
mostly_tracked objects_found
"""
LOWER_IS_BETTER, HIGHER_IS_BETTER = frozenset(_LOWER.split()), frozenset(_HIGHER.split())
"""Scores by name. A score in neither set is a plain count, or is best at 0."""
_NOT_SHOWN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff]")


def score_direction(name: str) -> str:
    """The words to add to a sentence about a score of which less is better; nothing for the others."""
    return "; lower is better" if name in LOWER_IS_BETTER else ""


def grouped(number: float) -> str:
    """A whole number with spaces between groups of three digits."""
    return f"{round(number):,}".replace(",", NBSP)


def counted(number: int, noun: str, plural: str = "") -> str:
    """A number with its noun, as "1 frame" and "2 frames".

    Parameters
    ----------
    number : how many.
    noun : in the singular.
    plural : where it is not the noun with an s.

    Returns
    -------
    Text for people.
    """
    return f"{grouped(number)} {noun if number == 1 else plural or noun + 's'}"


def duration(seconds: float) -> str:
    """Such as "8.2 s", "1 min 54 s", "2 h 5 min"."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    if seconds < 3600:
        return f"{int(seconds // 60)} min {int(seconds % 60)} s"
    return f"{int(seconds // 3600)} h {int(seconds % 3600 // 60)} min"


def percent(part: float, whole: float = 1.0) -> str:
    """The share in per cent, with a decimal where it is small; a dash where the whole is 0."""
    if not whole > 0:
        return "–"
    share = 100 * part / whole
    return f"{share:.1f}{NBSP}%" if 0 < share < 10 else f"{share:.0f}{NBSP}%"


def score(value: float) -> str:
    """A score with three decimals, a count without any."""
    if not math.isfinite(value):
        return "undefined"
    return grouped(value) if isinstance(value, int | np.integer) else f"{value:.3f}"


def render(template: str, **context: object) -> str:
    """The text of a template in ``report/templates``; in another one it is `markupsafe.Markup`."""
    return environment().get_template(template).render(context)


def lines(template: str, **context: object) -> tuple[str, ...]:
    """The sentences of a text template, which has one on each line."""
    return tuple(line.strip() for line in render(template, **context).split("\n") if line.strip())


@cache
def environment() -> Environment:
    """Where the templates are, and the functions that they can call. Jinja2 is imported here, on first use."""
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    made = Environment(
        loader=PackageLoader("phdtrack.report"),
        autoescape=select_autoescape(("html",)),
        finalize=_showable,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    for function in (grouped, counted, duration, percent, score, score_direction):
        made.filters[function.__name__] = function
    return made


def _showable(value: object) -> object:
    return _NOT_SHOWN.sub("\ufffd", value) if type(value) is str else value
