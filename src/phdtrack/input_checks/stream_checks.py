"""The checks of a stream, frame by frame: each warns once.

A check that has warned, or has found that all is well, is settled and takes no more time. Memory is
bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from phdtrack.input_checks.class_changes import ClassLinks, class_warning, with_links
from phdtrack.input_checks.empty_frames import EmptyFrames, empty_frames_warning, with_frame
from phdtrack.input_checks.equal_scores import FirstScores, score_warning, with_scores
from phdtrack.input_checks.time_units import FrameTimes, with_time
from phdtrack.input_checks.unused_detections import (
    UseCounts,
    chain_lengths,
    deciding_settings,
    use_warning,
    with_use,
)
from phdtrack.kernels.box import following
from phdtrack.multiclass import ClassSettings
from phdtrack.types import F8, I8, Step

# Overlap (IoU) of a detection with the one of the frame before that it continues.
_LINKED = 0.3
_NO_BOXES: F8 = np.zeros((0, 4))
_NO_LABELS: I8 = np.zeros(0, np.int64)
_NO_CHAINS: I8 = np.zeros(1, np.int64)


class Settled(NamedTuple):
    """The checks that are over: they have warned, or found that all is well."""

    times: bool = False
    use: bool = False
    classes: bool = False
    scores: bool = False
    empty: bool = False


class StreamSeen(NamedTuple):
    """The memory of the checks of a stream.

    Attributes
    ----------
    settled : the checks that are over.
    times, counts, links, first, empty : what each of them remembers.
    boxes, labels, length : (m, 4) boxes of the last observed frame, (m,) their classes, and
        (m + 1,) how many frames in a row each has come, and a 0; empty while nothing needs them.
    """

    settled: Settled = Settled()
    times: FrameTimes = FrameTimes()
    counts: UseCounts = UseCounts()
    links: ClassLinks = ClassLinks()
    first: FirstScores = FirstScores()
    empty: EmptyFrames = EmptyFrames()
    boxes: F8 = _NO_BOXES
    labels: I8 = _NO_LABELS
    length: I8 = _NO_CHAINS

    def resumed(self) -> StreamSeen:
        """The same for a stream that goes on after a pause."""
        return self._replace(times=self.times.resumed())


@dataclass(frozen=True, slots=True)
class StreamChecks:
    """The checks of a tracker.

    Attributes
    ----------
    fps : frames per second that it was told.
    delay : frames by which its online rows lag.
    settings : see `unused_detections.deciding_settings`.
    groups : classes that it tracks together.
    trusts_times : whether times are not checked.
    """

    fps: float
    delay: int = 0
    settings: tuple[str, ...] = ()
    groups: tuple[tuple[int, ...], ...] = ()
    trusts_times: bool = False

    def advance(
        self, seen: StreamSeen, step: Step, labels: I8
    ) -> tuple[StreamSeen, tuple[str, ...]]:
        """Take in a frame: the memory after it, and warnings.

        Parameters
        ----------
        seen : the memory before it.
        step : what the frame brought.
        labels : (N,) the class that each of its detections is tracked as; (0,) as long as all have
            been of one class.
        """
        warnings = list[str]()
        if not (seen.settled.times or self.trusts_times):
            times, warning = with_time(seen.times, step.number, step.time, self.fps)
            settled = seen.settled
            if warning:
                warnings.append(warning)
                settled = settled._replace(times=True)
            seen = StreamSeen(settled, times, *seen[2:])
        if step.detections.observed:
            seen = self._observed(seen, step, labels, warnings)
        return seen, tuple(warnings)

    def _observed(
        self, seen: StreamSeen, step: Step, labels: I8, warnings: list[str]
    ) -> StreamSeen:
        """Take in an observed frame; add its warnings."""
        if not seen.settled.scores:
            seen = _with_scores(seen, step.detections.confidence, warnings)
        if not seen.settled.empty:
            seen = _with_frame(seen, len(step.detections), warnings)
        use = not seen.settled.use
        classes = len(labels) > 0 and not seen.settled.classes
        if not (use or classes):
            if not (len(seen.boxes) or len(seen.labels)):
                return seen
            # An empty frame lies between two others.
            return seen._replace(boxes=_NO_BOXES, labels=_NO_LABELS)
        boxes = np.ascontiguousarray(step.detections.xyxy)
        link = following(seen.boxes, boxes, _LINKED)
        if classes and len(seen.labels):
            seen = self._with_classes(seen, (boxes, labels), link, warnings)
        if use:
            seen = self._with_use(seen, step, link, warnings)
        return seen._replace(boxes=boxes, labels=labels)

    def _with_classes(
        self, seen: StreamSeen, now: tuple[F8, I8], link: I8, warnings: list[str]
    ) -> StreamSeen:
        """Take in the classes of a frame; add a warning of them."""
        links, pairs = with_links(seen.links, (seen.boxes, seen.labels), now, link)
        for pair in pairs:
            if links.often(pair):
                warnings.append(class_warning(links, pair, self.groups))
                settled = seen.settled._replace(classes=True)
                return seen._replace(settled=settled, links=ClassLinks())
        return seen._replace(links=links)

    def _with_use(self, seen: StreamSeen, step: Step, link: I8, warnings: list[str]) -> StreamSeen:
        """Take in which detections are used; add a warning of them."""
        length = chain_lengths(seen.length, link)
        counts = with_use(seen.counts, step, length)
        unused = counts.unused(step.time, self.delay)
        if not (unused or counts.well):
            return seen._replace(counts=counts, length=length)
        if unused:
            warnings.append(use_warning(counts, seen.first.best, self.fps, self.settings))
        settled = seen.settled._replace(use=True)
        return seen._replace(settled=settled, counts=UseCounts(), length=_NO_CHAINS)


def _with_scores(seen: StreamSeen, score: F8, warnings: list[str]) -> StreamSeen:
    """Remember scores (N,) of a frame; add a warning of them."""
    first = with_scores(seen.first, score)
    if not first.enough:
        return seen._replace(first=first)
    warning = score_warning(first.scores)
    if warning:
        warnings.append(warning)
    settled = seen.settled._replace(scores=True)
    return seen._replace(settled=settled, first=first.judged())


def _with_frame(seen: StreamSeen, detections: int, warnings: list[str]) -> StreamSeen:
    """Count the detections of a frame; add a warning of those without any."""
    empty = with_frame(seen.empty, detections)
    if not (empty.regular or empty.well):
        return seen._replace(empty=empty)
    if empty.regular:
        warnings.append(empty_frames_warning(empty))
    return seen._replace(settled=seen.settled._replace(empty=True), empty=EmptyFrames())


@runtime_checkable
class Delays(Protocol):
    """An associator whose online rows lag by some frames."""

    output_delay: int


def longest_delay(classes: ClassSettings) -> int:
    """The frames by which online rows lag, of the class whose rows lag most."""
    associators = [stages.associator for stages in (classes.usual, *classes.own.values())]
    delays = [each.output_delay for each in associators if isinstance(each, Delays)]
    return max(delays, default=0)


def checks_of(classes: ClassSettings, fps: float) -> StreamChecks:
    """The checks of a tracker with these settings and this number of frames per second."""
    stages = classes.usual
    delay = 0
    if isinstance(stages.associator, Delays):
        delay = stages.associator.output_delay
    groups = dict[int, tuple[int, ...]]()
    for label, first in classes.first.items():
        groups[first] = (*groups.get(first, ()), label)
    return StreamChecks(fps, delay, deciding_settings(stages), tuple(groups.values()))
