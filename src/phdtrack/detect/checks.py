"""Checks that several detectors make: values of their settings, the size of the frames."""

from __future__ import annotations

import math

from phdtrack.errors import InputError
from phdtrack.types import Frame


def positive(settings: object, *names: str, below: float = math.inf, odd: bool = False, zero: bool = False) -> None:
    """Raise InputError unless each named setting is a number above 0 (or 0 with ``zero``) and ``below`` the limit.

    ``odd`` asks for odd whole numbers.
    """
    for name in names:
        value = getattr(settings, name)
        fine = (
            isinstance(value, int | float)
            and math.isfinite(value)
            and (value > 0 or (zero and value == 0))
            and value < below
        )
        if odd:
            fine = fine and value == int(value) and value % 2 == 1
        if not fine:
            least = "not below 0" if zero else "above 0"
            limit = f" and below {below:g}" if below < math.inf else ""
            kind = "an odd whole number" if odd else "a number"
            raise InputError(f"{name} must be {kind} {least}{limit}, not {value!r}", where=type(settings).__name__)


def check_same_size(frame: Frame, shape: tuple[int, ...]) -> None:
    """Raise InputError where ``frame`` is not of the (H, W) ``shape`` that the detector has learned."""
    if frame.image.shape[:2] != shape[:2]:
        got, learned = (f"{size[1]}x{size[0]}" for size in (frame.image.shape, shape))
        raise InputError(
            f"this frame is {got} pixels, the background was learned at {learned}",
            where=f"frame {frame.number}",
            cure="Call reset() before another video.",
        )
