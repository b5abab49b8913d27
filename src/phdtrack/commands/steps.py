"""The tracker as the run loop drives it: a frame's detections in, its step out."""

from __future__ import annotations

from typing import Protocol

from phdtrack.types import Detections, Particles, Step, Tracks


class Steps(Protocol):
    """Detections in, steps out, corrected tracks at the end."""

    def advance(self, number: int, time: float, detections: Detections) -> Step:
        """Take in the detections of frame ``number`` at ``time`` seconds."""

    @property
    def particles(self) -> Particles | None:
        """The filter's particles after the last frame; None for a filter without."""

    def flush(self) -> Tracks:
        """The online rows that the output delay held back."""

    def finish(self) -> Tracks:
        """The corrected tracks of everything taken in so far."""
