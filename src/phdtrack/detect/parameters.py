"""A detector's own settings from files and options: their types, which the detector itself takes for granted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phdtrack.detect.registry import detector_parameters
from phdtrack.errors import InputError

_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}


def typed(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """``parameters`` of detector ``name`` in the types of its defaults; unknown ones are left for `make_detector` to refuse.

    Raises
    ------
    InputError : a value of another type.
    """
    defaults = {field.name: field.default for field in detector_parameters(name)}
    return {key: _as(type(defaults[key]), key, value) if key in defaults else value for key, value in parameters.items()}


def _as(kind: type, key: str, value: Any) -> Any:
    if kind is float and type(value) is int:
        return float(value)
    if kind in _WORDS and type(value) is not kind:
        raise InputError(f"expected {_WORDS[kind]}, got {value!r}", where=f"detector.{key}")
    return value
