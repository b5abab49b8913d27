"""Errors of a camera that came from a file say the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from phdtrack.errors import InputError

T = TypeVar("T")


def located(path: Path, make: Callable[[], T]) -> T:
    """What ``make`` gives; an `InputError` of it names ``path`` too."""
    try:
        return make()
    except InputError as error:
        raise InputError(error.problem, where=f"{path}, {error.where}", cure=error.cure) from None
