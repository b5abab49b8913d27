"""``--set NAME=VALUE`` for the settings of a scene and ``--look`` for its picture: numbers, by the type of the setting."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.simulate import Look


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
    return dict(_assigned(text, numeric, "--set") for text in assignments)


def look_settings(name: str, assignments: Sequence[str]) -> Look:
    """The look of scene ``name`` with what ``assignments`` ("wave=0.2") change.

    Raises
    ------
    InputError : not of the form NAME=VALUE, there is no such setting, or the value is no number of its type, or impossible.
    """
    from phdtrack.simulate import default_look

    look = default_look(name)
    numeric: dict[str, type[int] | type[float]] = {f.name: type(getattr(look, f.name)) for f in fields(look)}
    # Each is a number of its own field's type, which a dictionary of all of them cannot say.
    changed: dict[str, Any] = dict(_assigned(text, numeric, "--look") for text in assignments)
    return replace(look, **changed)


def _assigned(text: str, numeric: dict[str, type[int] | type[float]], option: str) -> tuple[str, int | float]:
    key, equals, value = (part.strip() for part in text.partition("="))
    where = f"{option} {text}"
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
