"""What the options of a command say about its input. Nothing heavy is imported here, for a quick start (see `inputs`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

DEFAULT_DETECTOR = "change"


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the options say, before anything is opened. Empty text and 0 stand for an option that was not given.

    ``last`` is the last annotated frame: a sequence without a video is at least that long.
    """

    source: str = ""
    detections: Path | None = None
    detector: str = ""
    frame_size: str = ""
    fps: float = 0.0
    max_width: int = 0
    mask: Path | None = None
    last: int = 0
