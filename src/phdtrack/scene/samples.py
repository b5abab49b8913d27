"""What densities are learned from: first states of tracks, and detections that somebody marked as false [M09 §IV]."""

from __future__ import annotations

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.types import F8, Tracks

# Seconds of a track from which its first velocity is taken.
LEAD = 0.4
# Who enters is there for so many seconds, and goes as far as he is large: light that trembles does not.
LASTING, FAR = 1.0, 1.0


def births_in(tracks: Tracks, fps: float, rate: float, shown: F8 | None = None) -> F8:
    """The first states of the tracks that teach where people enter: those that last, and go somewhere."""
    return first_states(tracks, fps, rate, max(5, round(LASTING * fps)), shown, FAR)


def first_states(
    tracks: Tracks, fps: float, rate: float, shortest: int = 5, shown: F8 | None = None, far: float = 0.0
) -> F8:
    """(6, n) states (px, py, vx, vy, w, h) in which the tracks of at least ``shortest`` rows began [M09 §IV].

    Velocities are pixels per time unit, of which ``rate`` make a second: slopes of straight lines through the centres of
    the first ``LEAD`` seconds, at least three rows. Tracks that are there in the first frame began before it: left out, as
    are those that have not `gone` as ``far``.

    ``shown`` (r, M) is what the rows show, the position first, where it is not centre and size of their boxes: points, or
    places on the ground, whose states are (px, py, vx, vy).
    """
    boxes = to_cxcywh(tracks.xyxy)
    box = boxes if shown is None else shown
    order = np.lexsort((tracks.frame, tracks.identity))
    start = np.flatnonzero(np.diff(tracks.identity[order], prepend=-1))
    opening = int(tracks.frame.min(initial=np.iinfo(np.int64).max))
    states = []
    for rows in np.split(order, start[1:]) if len(order) else []:
        known = len(rows) >= shortest and tracks.frame[rows[0]] > opening
        if known and (far == 0 or gone(boxes[:, rows]) >= far):
            states.append(first_state(box[:, rows], (tracks.frame[rows] - tracks.frame[rows[0]]) / fps, rate))
    return np.array(states).reshape(-1, len(box) + 2).T.copy()


def gone(box: F8) -> float:
    """How far a track has gone from where it began, in its sizes √(wh): boxes (4, n) as centre and size.

    Told by the medians of the first and of the last fifth of its centres.
    """
    fifth = max(1, box.shape[1] // 5)
    step = np.median(box[:2, -fifth:], axis=1) - np.median(box[:2, :fifth], axis=1)
    return float(np.linalg.norm(step) / np.sqrt(np.median(box[2] * box[3])))


def first_state(box: F8, seconds: F8, rate: float) -> F8:
    """(r + 2,) the first state of one track: boxes (r, n) as centre and size, at ``seconds`` (n,) after the first."""
    lead = max(3, int((seconds <= LEAD).sum()))
    time = seconds[:lead] * rate
    centred = time - time.mean()
    velocity = (box[:2, :lead] * centred).sum(axis=1) / (centred**2).sum()
    return np.concatenate([box[:2, 0], velocity, box[2:, 0]])


def state_volume(
    width: float, height: float, fastest: float, corner: tuple[float, float] = (0.0, 0.0), *, sized: bool = True
) -> tuple[F8, F8]:
    """Bounds (6,) of the states that births may have: centre in the frame, any size in it, |v| up to ``fastest`` an axis.

    Those of states without a size are (4,); a region of the ground does not begin at 0 but at its ``corner``.
    """
    left, top = corner
    low, high = [left, top, -fastest, -fastest], [left + width, top + height, fastest, fastest]
    return np.array([*low, *([0.0, 0.0] if sized else [])]), np.array([*high, *([width, height] if sized else [])])


def measurement_volume(width: float, height: float) -> tuple[F8, F8]:
    """Bounds (4,) of the boxes that false alarms may be: centre in the frame, any size in it."""
    return np.zeros(4), np.array([width, height, width, height], np.float64)
