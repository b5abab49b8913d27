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

from dataclasses import dataclass, field

import numpy as np

from phdtrack.kernels.box import share_of, shown_between
from phdtrack.types import F8, I8, Detections, Tracks, state_record

# The share before anything is seen, as if from so many sides of boxes; the most that it may be:
# beyond 1 is the prediction.
PRIOR = 0.5
PRIOR_WEIGHT = 50.0
MOST = 1.5
# Sides of boxes that are remembered.
KEPT = 3000.0
_PRIOR = (PRIOR, PRIOR_WEIGHT, MOST)


@state_record
class ShownFrame:
    """The rows of a frame that rest on detections: ``identity`` (n,), boxes ``seen`` and
    ``filtered`` (n, 4); seconds.
    """

    time: float = 0.0
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    seen: F8 = field(default_factory=lambda: np.zeros((0, 4)))
    filtered: F8 = field(default_factory=lambda: np.zeros((0, 4)))


@state_record
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
    last: tuple[ShownFrame, ShownFrame] = (ShownFrame(), ShownFrame())
    sums: F8 = field(default_factory=lambda: np.zeros((2, 4)))

    @property
    def share(self) -> tuple[float, float]:
        """a of centres and of sizes."""
        return share_of(self.sums, 0, _PRIOR), share_of(self.sums, 1, _PRIOR)


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
        waiting = state.waiting
        if waiting and waiting[0][0] < oldest:
            waiting = tuple(frame for frame in waiting if frame[0] >= oldest)
        if len(detections):
            waiting = (*waiting, (number, time, detections.row, detections.xyxy))
        return self.shown(ShareState(waiting, state.last, state.sums), tracks)

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
        rows = (tracks.frame, tracks.identity, tracks.detection, xyxy)
        done = 0
        for number, time, row, boxes in state.waiting:
            if number > until:
                break
            done += 1
            first, second = last
            ratio = 0.0
            if len(first.identity):
                ratio = (second.time - first.time) / (time - second.time)
            sums, *shown = shown_between(
                rows,
                (number, row, boxes),
                (first.identity, first.seen, first.filtered),
                (second.identity, second.seen),
                ratio,
                KEPT,
                sums,
                _PRIOR,
            )
            if len(shown[0]):
                last = (second, ShownFrame(time, *shown))
        return ShareState(state.waiting[done:], last, sums), tracks.with_boxes(xyxy)
