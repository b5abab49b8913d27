"""One object of a JSON file, with errors that name its place."""

from __future__ import annotations

import reprlib
from typing import Any, NamedTuple

from phdtrack.errors import InputError


class Entry(NamedTuple):
    """A JSON object: its values, including those under ``attributes``, and its place in the
    file.
    """

    values: dict[str, Any]
    where: str

    def number(self, *names: str, default: float | None = None) -> float:
        """The value of the first of the names that the object has, as a number."""
        for name in names:
            if name in self.values:
                return _number(self.values[name], name, self.where)
        if default is not None:
            return default
        got = ", ".join(self.values) or "none"
        raise InputError(
            f"expected a value for {' or '.join(names)}, got keys {got}", where=self.where
        )

    def box(self) -> list[float]:
        """Left, top, width, height."""
        box = self.values.get("bbox")
        if not isinstance(box, list) or len(box) != 4:
            raise InputError(
                f"expected four numbers for bbox (left, top, width, height), got {brief(box)}",
                where=self.where,
            )
        return [_number(value, "bbox", self.where) for value in box]


def entry_of(value: Any, where: str, keys: str) -> Entry:
    """The JSON object ``value``. Raises `InputError` if it is not an object; the message names the
    ``keys`` that it should have.

    Parameters
    ----------
    value : a parsed JSON value.
    where : its place in the file.
    keys : the keys that messages name.
    """
    if not isinstance(value, dict):
        raise InputError(f"expected an object with {keys}, got {brief(value)}", where=where)
    attributes = value.get("attributes")
    if isinstance(attributes, dict):
        return Entry({**attributes, **value}, where)
    return Entry(value, where)


def brief(value: object) -> str:
    """The value in at most 40 characters, for messages."""
    text = reprlib.repr(value)
    if len(text) <= 40:
        return text
    return f"{text[:37]}..."


def _number(value: object, name: str, where: str) -> float:
    """A number, or digits in quotes, as some programs write image ids."""
    if isinstance(value, str) and value.isdecimal():
        return float(value)
    if isinstance(value, int | float):
        try:
            return float(value)
        except OverflowError:
            pass
    raise InputError(f"expected a number for {name}, got {brief(value)}", where=where)
