"""κ(z): false alarms, uniform over a volume [M07 §2], and what scores make of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.errors import Checked, InputError, NonNegative, Positive, check
from phdtrack.models.volumes import (
    EVERYWHERE,
    Region,
    area,
    image_volume,
    local_area,
    local_density,
)
from phdtrack.protocols import Clutter
from phdtrack.types import F8, state_record


@dataclass(frozen=True, slots=True)
class UniformClutter(Checked):
    """κ the same everywhere.

    Parameters
    ----------
    clutter_per_frame : expected false alarms per frame.
    volume : of measurement space, pixel² for points, pixel⁴ for boxes.
    """

    clutter_per_frame: NonNegative = 1.0
    volume: Positive = 1.0

    def intensity(self, z: F8) -> F8:
        """κ = rate / volume, the same everywhere."""
        return np.full(z.shape[1], self.clutter_per_frame / self.volume)


@dataclass(frozen=True, slots=True)
class BoxClutter:
    """False alarms of boxes, uniform over the image or the same at every scale [M07 §2].

    The latter is a density κ(z) = rate/(4w²h²) that no other detection changes (see
    `models.volumes`).

    Parameters
    ----------
    clutter_per_detection : expected false alarms in the neighbourhood of a box: ±1 box in position,
        0.5 to 1.5 in size.
    clutter_per_frame : expected false alarms per frame, anywhere in the image, which replace those
        around each detection if it is not 0.
    frame_size : the image's width and height in pixels, needed for false alarms anywhere.
    volume : of positions and sizes over which false alarms anywhere are uniform, pixel⁴; 0: all of
        the frame's.
    """

    clutter_per_detection: NonNegative = 0.6
    clutter_per_frame: NonNegative = 0.0
    frame_size: tuple[float, float] = (0.0, 0.0)
    volume: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)
        if self.clutter_per_frame and self.clutter_per_detection:
            # Uniform false alarms replace those around each detection.
            object.__setattr__(self, "clutter_per_detection", 0.0)

    def intensity(self, z: F8) -> F8:
        """κ(z), per frame and pixel⁴."""
        if self.clutter_per_frame:
            return np.full(
                z.shape[1], self.clutter_per_frame / (self.volume or image_volume(self.frame_size))
            )
        return local_density(z, self.clutter_per_detection)


@dataclass(frozen=True, slots=True)
class PlaneClutter:
    """False alarms on the ground, uniform over a region or the same at every scale (see
    `models.volumes`).

    Parameters
    ----------
    clutter_per_detection : expected false alarms in the ellipse of a detection's noise.
    clutter_per_frame : expected false alarms per frame, anywhere in the region, which replace those
        around each detection if it is not 0.
    density : false alarms per frame and m², which replaces the other two where it is not 0.
    borders : left, low, right and high border of the region in metres, needed for false alarms
        anywhere in it.
    """

    clutter_per_detection: NonNegative = 0.6
    clutter_per_frame: NonNegative = 0.0
    density: NonNegative = 0.0
    borders: Region = EVERYWHERE

    def __post_init__(self) -> None:
        check(self)
        if self.clutter_per_frame and self.clutter_per_detection:
            # Uniform false alarms replace those around each detection.
            object.__setattr__(self, "clutter_per_detection", 0.0)

    def intensity(self, z: F8) -> F8:
        """κ(z), per frame and m²."""
        if self.density:
            return np.full(z.shape[1], self.density)
        if self.clutter_per_frame:
            return np.full(
                z.shape[1], self.clutter_per_frame / area(self.borders, "PlaneClutter.borders")
            )
        return self.clutter_per_detection / local_area(z)


@state_record
class ScoredClutter:
    """κ(z) of the detections of one frame, and what the score s of each says.

    Filters whose g(z|x) leaves scores out take `intensity`. Those that weigh every explanation of a
    detection by its score take `without_scores` and the odds.

    Parameters
    ----------
    base : κ(z), without scores.
    odds : (N,) p(s|target)/p(s|false alarm) of the detections, in the order of the measurements.
    log_odds : (N,) log p(s|target)/p(s|lasting false alarm), for filters that know of false alarms
        that last.
    more : how many times as many false alarms there are as κ says.
    anew : the share of these that are new in each frame; the others are false alarms that come
        again.
    missing : the probabilities that a visible target, and a false alarm that lasts, are not
        detected in a frame; 0 and 0 where this is not known.
    """

    base: Clutter
    odds: F8
    log_odds: F8
    more: float = 1.0
    anew: float = 1.0
    missing: tuple[float, float] = (0.0, 0.0)

    def without_scores(self, z: F8) -> F8:
        """(N,) more·κ(z), whatever the scores."""
        return self.base.intensity(z) * self.more

    def intensity(self, z: F8) -> F8:
        """(N,) more·κ(z)/odds: with p(s|target) taken out of every ratio of the update, what scores
        leave. A detection of low odds can only be explained by a target that exists already, and
        starts none.

        Raises `InputError` for other detections than those with the odds.
        """
        if z.shape[1] != len(self.odds):
            raise InputError(
                f"expected the {len(self.odds)} detections that the odds are of, got {z.shape[1]}"
            )
        return self.base.intensity(z) * (self.more / self.odds)
