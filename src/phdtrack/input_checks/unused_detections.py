"""Detections that come again and again, nearly all of which are used by no track.

A detection continues one of the frame before if each of the two is the one that overlaps the other
most. From the sixth in a row on it is no chance, also in dense clutter.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.protocols import AnyStages
from phdtrack.types import I8, Step

# The how manieth detection in a row comes again and again.
RECURRING = 6
# What a judgement needs: seconds since the first such detection, frames with any, their number,
# their share of all detections, and how many times the frames by which rows lag.
_SECONDS = 5.0
_FRAMES = 30
_COUNT = 30
_SHARE = 0.05
_DELAYS = 4
# If at most the first share of them is used something is wrong, from the second on all is well.
_UNUSED = 0.1
_USED = 0.5
# Best scores below are low for a probability.
_LOW_SCORE = 0.5
# Settings that decide whether a detection becomes an object: one to estimate, and some to lower.
_PROBABILITY = "sensor.detection_probability"
_DECIDING = (
    _PROBABILITY,
    "clutter.clutter_per_frame",
    "clutter.clutter_per_detection",
    "filter.static_clutter_prior",
    "filter.lasting_clutter_prior",
    "extract.min_weight",
)


class UseCounts(NamedTuple):
    """Counts since the first frame with recurring detections.

    Attributes
    ----------
    begun : its time.
    frames : frames with recurring detections.
    detections, recurring, used : all detections, recurring ones, and rows that rest on any.
    unusable : detections that tell nothing of any state.
    false_alarms : sum of the probabilities that recurring ones are false alarms.
    """

    begun: float = 0.0
    frames: int = 0
    detections: int = 0
    recurring: int = 0
    used: int = 0
    unusable: int = 0
    false_alarms: float = 0.0

    @property
    def well(self) -> bool:
        """True if enough recurring detections are used."""
        return self.recurring >= _COUNT and self.used >= _USED * self.recurring

    def unused(self, time: float, delay: int) -> bool:
        """True if nearly all recurring detections are used by no track.

        ``time`` is that of the last frame, ``delay`` the frames by which rows lag.
        """
        return (
            self.recurring >= _COUNT
            and self.used <= _UNUSED * self.recurring
            and self.recurring >= _SHARE * self.detections
            and self.frames >= max(_FRAMES, _DELAYS * delay)
            and time - self.begun >= _SECONDS
        )


def chain_lengths(length: I8, link: I8) -> I8:
    """(m + 1,) how many frames in a row each detection has come by now, and a 0.

    ``length`` (n + 1,) is the same of the frame before, ``link`` (m,) the detection there that each
    continues, −1 for none.
    """
    longer = np.zeros(len(link) + 1, np.int64)
    longer[:-1] = length[link] + 1
    return longer


def with_use(counts: UseCounts, step: Step, length: I8) -> UseCounts:
    """The counts after a frame.

    Parameters
    ----------
    counts : before it.
    step : what the frame brought.
    length : (N + 1,) see `chain_lengths`.
    """
    recurring = length >= RECURRING
    count = int(np.count_nonzero(recurring))
    if not count and not counts.frames:
        return counts
    begun, frames, detections, before, used, unusable, false_alarms = counts
    probability = step.info.clutter_probability
    n = len(step.detections)
    if count and len(probability) == n:
        false_alarms += float(probability @ recurring[:-1])
    return UseCounts(
        begun if frames else step.time,
        frames + (count > 0),
        detections + n,
        before + count,
        used + int(np.count_nonzero(step.tracks.detection >= 0)),
        unusable + step.unusable,
        false_alarms,
    )


def use_warning(counts: UseCounts, best_score: float, fps: float, settings: tuple[str, ...]) -> str:
    """A sentence on recurring detections, nearly all of which are used by no track.

    Parameters
    ----------
    counts, best_score : of the stream; the highest score.
    fps : frames per second that the tracker was told.
    settings : see `deciding_settings`.
    """
    if 2 * counts.unusable > counts.detections:
        meaning = "they show no possible place on the ground"
        cures = ["check the camera"]
    else:
        meaning = "the filter finds no object that is certain enough"
        if 2 * counts.false_alarms > counts.recurring:
            meaning = "the filter takes them for false alarms"
        cures = [*_to_check(best_score, fps), *_to_change(settings)]
    return (
        f"{_at_most(counts.used)} of {counts.recurring} detections that recur in {RECURRING} or"
        f" more frames in a row are used by a track: {meaning}. If they show objects,"
        f" {_listed(cures)}"
    )


def _at_most(count: int) -> str:
    """The number as an upper bound."""
    return f"at most {count}" if count else "none"


def _listed(words: list[str]) -> str:
    """The words as "a", "a or b", "a, b or c"."""
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _to_check(best_score: float, fps: float) -> list[str]:
    """The inputs to check."""
    checks = f"check fps={fps:g}"
    if best_score < _LOW_SCORE:
        checks += f" and the scores, of which the highest is {best_score:.2g}"
    return [checks]


def _to_change(settings: tuple[str, ...]) -> list[str]:
    """The settings to change."""
    changes = list[str]()
    if _PROBABILITY in settings:
        changes.append(f"set {_PROBABILITY} to the share of frames in which an object is detected")
    lower = [name for name in settings if name != _PROBABILITY]
    if lower:
        changes.append(f"lower {_listed(lower)}")
    return changes


def deciding_settings(stages: AnyStages) -> tuple[str, ...]:
    """The settings, by section and name, that decide whether these stages take a detection for an
    object.
    """
    parts = {
        "sensor": stages.model.sensor,
        "clutter": stages.model.clutter,
        "filter": stages.filter,
        "extract": stages.extractor,
    }
    known = {
        f"{section}.{setting.name}"
        for section, part in parts.items()
        if is_dataclass(part)
        for setting in fields(part)
        # A rate of 0 is not in use.
        if getattr(part, setting.name)
    }
    return tuple(name for name in _DECIDING if name in known)
