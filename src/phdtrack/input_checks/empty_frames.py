"""Detections in every second, third, … frame only, and none in those between: a sign that the
detector did not run there, and that the frames should say so.
"""

from __future__ import annotations

from typing import NamedTuple

# Equal distances in a row, in frames, from which they are no chance; and as many neighbours that
# both have detections from which all is well.
_EQUAL = 12
_WELL = 6


class EmptyFrames(NamedTuple):
    """Distances between observed frames with detections.

    Attributes
    ----------
    since : observed frames since the last with a detection; 0 before the first.
    distance, times : the last distance, and how many times in a row it came.
    neighbours : how many times two frames in a row had detections.
    """

    since: int = 0
    distance: int = 0
    times: int = 0
    neighbours: int = 0

    @property
    def regular(self) -> bool:
        """True if detections come in every so many frames."""
        return self.distance > 1 and self.times >= _EQUAL

    @property
    def well(self) -> bool:
        """True if detections come in neighbouring frames, too."""
        return self.neighbours >= _WELL


def with_frame(seen: EmptyFrames, detections: int) -> EmptyFrames:
    """The same after an observed frame with so many detections."""
    since, distance, times, neighbours = seen
    if not detections:
        return seen._replace(since=since + 1) if since else seen
    if not since:
        return seen._replace(since=1)
    same = since == distance
    return EmptyFrames(1, since, times + 1 if same else 1, neighbours + (since == 1))


def empty_frames_warning(seen: EmptyFrames) -> str:
    """A sentence on frames without detections that come regularly."""
    return (
        f"only one in {seen.distance} frames has detections, {seen.times + 1} times in a row. If"
        " the detector did not run on the others, pass Detections.empty(observed=False) for them:"
        " an empty frame says that nothing was there"
    )
