"""``--set NAME=VALUE`` for the settings of a scene: numbers, by the type that the setting has."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import fields

from phdtrack.errors import InputError


def scene_settings(name: str, assignments: Sequence[str]) -> dict[str, int | float]:
    """The settings of scene ``name`` that ``assignments`` ("frames=100") give; empty for a scene that does not exist.

    Raises
    ------
    InputError : not of the form NAME=VALUE, no number setting has this name, or the value is no number of its type.
    """
    from phdtrack.simulate import NAMED

    if name not in NAMED:
        return {}
    world = NAMED[name]
    types = {f.name: type(getattr(world, f.name)) for f in fields(world)}
    numeric = {key: kind for key, kind in types.items() if kind in (int, float)}
    return dict(_assigned(text, numeric) for text in assignments)


def _assigned(text: str, numeric: dict[str, type[int] | type[float]]) -> tuple[str, int | float]:
    key, equals, value = (part.strip() for part in text.partition("="))
    where = f"--set {text}"
    if not equals or not key:
        raise InputError("expected NAME=VALUE", where=where)
    if key not in numeric:
        close = difflib.get_close_matches(key, numeric, 1)
        cure = f"Did you mean {close[0]}?" if close else f"There are {', '.join(numeric)}."
        raise InputError(f"this scene has no setting {key} that is a number", where=where, cure=cure)
    kind = numeric[key]
    try:
        return key, kind(value)
    except ValueError:
        wanted = "a whole number" if kind is int else "a number"
        raise InputError(f"expected {wanted}, got {value!r}", where=where) from None
