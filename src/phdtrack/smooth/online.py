"""Boxes of online rows: between the filter's and the detection's, as far as the detections that
follow teach.

A filter that keeps identities when targets jump assumes wide noises, so that its boxes follow exact
detections too slowly. Shown is, of each target that was detected,

    b = z + a (m − z)

with z the detection's box, m the filter's, and one share a for centres and one for sizes of a
stream. The two boxes that follow, z′ and z″, tell where the target was, without the errors that m
and z have: at r = z′ − (z″ − z′) T/T′, after intervals T and T′. So a is the slope of the
regression of r − z on m − z, both in widths and heights of the box, in which steps that are large
for the stream count less. It begins at `PRIOR` and forgets what is old.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.kernels.box import agreement, between
from phdtrack.types import F8, I8, Detections, Tracks

# The share before anything is seen, as if from so many sides of boxes; the most that it may be:
# beyond 1 is the prediction.
PRIOR = 0.5
PRIOR_WEIGHT = 50.0
MOST = 1.5
# Sides of boxes that are remembered.
KEPT = 3000.0


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """The rows of a frame that rest on detections: ``identity`` (n,), boxes ``seen`` and
    ``filtered`` (n, 4); seconds.
    """

    time: float = 0.0
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    seen: F8 = field(default_factory=lambda: np.zeros((0, 4)))
    filtered: F8 = field(default_factory=lambda: np.zeros((0, 4)))


@dataclass(frozen=True, slots=True, eq=False)
class ShareState:
    """The statistics of the boxes shown so far.

    Attributes
    ----------
    waiting : number, seconds, `Detections.row` (n,) and boxes (n, 4) of the frames with detections
        whose rows are still to come, the oldest first.
    last : the two frames before.
    sums : (2, 4) of centres and of sizes: of products, of squares, how many, and the mean size of m
        − z.
    """

    waiting: tuple[tuple[int, float, I8, F8], ...] = ()
    last: tuple[Shown, Shown] = (Shown(), Shown())
    sums: F8 = field(default_factory=lambda: np.zeros((2, 4)))

    @property
    def share(self) -> tuple[float, float]:
        """a of centres and of sizes."""
        return _share(self.sums)


@dataclass(frozen=True, slots=True)
class DetectionShare:
    """The rule; it has no settings."""

    def start(self) -> ShareState:
        """Before the first frame."""
        return ShareState()

    def advance(
        self,
        state: ShareState,
        tracks: Tracks,
        detections: Detections,
        number: int,
        time: float,
        oldest: int,
    ) -> tuple[ShareState, Tracks]:
        """The state and the rows with the boxes that are shown."""
        # Without tracks no row tells which frames are done; those that are forgotten are.
        waiting = tuple(frame for frame in state.waiting if frame[0] >= oldest)
        if len(detections):
            waiting = (*waiting, (number, time, detections.row, detections.xyxy))
        return self.shown(replace(state, waiting=waiting), tracks)

    def shown(self, state: ShareState, tracks: Tracks) -> tuple[ShareState, Tracks]:
        """The state after these rows, all of frames that it waits for, and the rows with the boxes
        that are shown.
        """
        if len(tracks) == 0:
            return state, tracks
        last = state.last
        sums = state.sums
        xyxy = tracks.xyxy.copy()
        until = int(tracks.frame[-1])
        detected = tracks.detection >= 0
        for number, time, row, boxes in state.waiting:
            rows = np.flatnonzero(detected & (tracks.frame == number))
            if number <= until and len(rows):
                seen = boxes[np.searchsorted(row, tracks.detection[rows])]
                now = Shown(time, tracks.identity[rows], seen, xyxy[rows])
                sums = _learned(sums, *last, now)
                last = (last[1], now)
                xyxy[rows] = between(now.seen, now.filtered, *_share(sums))
        waiting = tuple(frame for frame in state.waiting if frame[0] > until)
        return ShareState(waiting, last, sums), replace(tracks, xyxy=xyxy)


def _share(sums: F8) -> tuple[float, float]:
    """a of centres and of sizes."""
    out = []
    for product, square, count, _ in sums.tolist():
        slope = product / max(square, 1e-12)
        out.append(
            min(max((count * slope + PRIOR_WEIGHT * PRIOR) / (count + PRIOR_WEIGHT), 0.0), MOST)
        )
    return out[0], out[1]


def _learned(sums: F8, first: Shown, second: Shown, now: Shown) -> F8:
    """The sums with what a further frame says of the rows two frames ago."""
    if len(first.identity) == 0:
        return sums
    ratio = (second.time - first.time) / (now.time - second.time)
    kept = max(1 - 2 * len(now.identity) / KEPT, 0.0)
    then = (first.identity, first.seen, first.filtered)
    between = (second.identity, second.seen)
    return np.asarray(agreement(then, between, (now.identity, now.seen), ratio, kept, sums))
