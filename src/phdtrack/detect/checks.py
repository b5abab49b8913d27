"""Checks that several detectors make beside the bounds of their settings."""

from __future__ import annotations

from phdtrack.errors import InputError
from phdtrack.types import Frame


def check_odd(settings: object, *names: str) -> None:
    """Raise InputError unless each of the named settings is an odd whole number."""
    for name in names:
        value = getattr(settings, name)
        if value % 2 != 1:
            raise InputError(f"expected an odd whole number, got {value!r}", where=f"{type(settings).__name__}.{name}")


def check_same_size(frame: Frame, shape: tuple[int, ...]) -> None:
    """Raise InputError where ``frame`` is not of the (H, W) ``shape`` that the detector has learned."""
    if frame.image.shape[:2] != shape[:2]:
        got, learned = (f"{size[1]}x{size[0]}" for size in (frame.image.shape, shape))
        raise InputError(
            f"this frame is {got} pixels, the background was learned at {learned}",
            where=f"frame {frame.number}",
            cure="Call reset() before another video.",
        )
