"""Words, numbers and JSON that pages, terminal and files share.

``run.json`` and its like are plain JSON: values that are not numbers (NaN, infinity) become null, arrays lists, paths
strings. Keys keep their names and order; new ones are added at the end.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import json_value

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


def score_direction(name: str) -> str:
    """The words to add to a sentence about a score of which less is better; nothing for the others."""
    return "; lower is better" if name in LOWER_IS_BETTER else ""


def grouped(number: float) -> str:
    """A whole number with spaces between groups of three digits."""
    return f"{round(number):,}".replace(",", NBSP)


def counted(number: int, *noun: str) -> str:
    """A number with its noun, as "1 frame" and "2 frames"; its plural is the second where that has more than an s."""
    return f"{grouped(number)} {noun[0] if number == 1 else (*noun, f'{noun[0]}s')[1]}"


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


def flattened(config: Mapping[str, object], prefix: str = "") -> tuple[tuple[str, str], ...]:
    """Pairs (dotted name, text) of a nested configuration, in its order: the form that ``--set`` takes."""
    pairs: list[tuple[str, str]] = []
    for key, value in config.items():
        if isinstance(value, Mapping):
            pairs += flattened(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", json.dumps(json_value(value), ensure_ascii=False)))
    return tuple(pairs)


def write_run(path: Path, document: Mapping[str, object]) -> None:
    """Write the document as indented UTF-8. Raises `InputError` where the file cannot be written."""
    write_text(path, json.dumps(json_value(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 and make the folder. Raises `InputError` where that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # File names may hold bytes that are no text; their escape is also how JSON spells them.
        path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
    except OSError as error:
        raise InputError(
            f"could not be written: {error.strerror or error}", where=path, cure="Choose another output folder."
        ) from error
