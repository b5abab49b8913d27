"""Learning while tracking: the places where a camera's scene flickers.

The detections since the last lesson wait with the online tracks they belong to. Every `LESSON`
seconds they are counted as in `scene.flicker`, and what was counted before fades with the time
constant `MEMORY`: light and weather change. A track that is still there and has gone nowhere so far
waits for the next lesson, up to `PATIENCE` seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.models.flicker_odds import with_odds
from phdtrack.protocols import Learning, Model
from phdtrack.scene.flicker import (
    NOWHERE,
    FlickerMap,
    counted_places,
    sightings,
    travellers,
)
from phdtrack.types import F8, I8, Bool, Detections, Step

# Seconds between two lessons; after which what was learned counts for 37 %; for which a track may
# wait for its lesson; and without a detection after which a track has ended.
LESSON = 30.0
MEMORY = 1800.0
PATIENCE = 60.0
ENDED = 2.0


@dataclass(frozen=True, slots=True)
class FlickerSeen:
    """The state.

    Attributes
    ----------
    learned : where the scene flickers.
    xyxy, time : (M, 4) and (M,) detections that wait for their lesson, and their seconds.
    frame, row : (M,) frame and number in it of each.
    identity : (M,) the online track that each belongs to; −1 for none.
    went, stayed : identities in view that were counted as objects that travelled, and as others.
    begun : seconds at the last lesson; NaN before the first frame.
    scores : the state of what scores say.
    """

    learned: FlickerMap = NOWHERE
    xyxy: F8 = field(default_factory=lambda: np.zeros((0, 4)))
    time: F8 = field(default_factory=lambda: np.zeros(0))
    frame: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    row: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    identity: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    went: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    stayed: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    begun: float = math.nan
    scores: Any = None


@dataclass(frozen=True, slots=True)
class LiveFlicker(Learning[FlickerSeen]):
    """Learning where a scene flickers while it is tracked.

    Parameters
    ----------
    size : width and height of the picture, pixels.
    scores : what scores say besides; None if they are not learned.
    """

    size: tuple[float, float]
    scores: Learning[Any] | None = None

    def start(self) -> FlickerSeen:
        """Nothing learned."""
        return FlickerSeen(scores=None if self.scores is None else self.scores.start())

    def model(self, state: FlickerSeen, model: Model) -> Model:
        """The model with what scores have taught."""
        return model if self.scores is None else self.scores.model(state.scores, model)

    def with_scores(self, state: FlickerSeen, model: Model, detections: Detections) -> Model:
        """The model whose false alarms are weighed by the places of the detections."""
        if self.scores is not None:
            model = self.scores.with_scores(state.scores, model, detections)
        return with_odds(model, state.learned.odds(to_cxcywh(detections.xyxy)))

    def advance(self, state: FlickerSeen, step: Step) -> FlickerSeen:
        """Keep the detections of a frame; if a lesson is due, learn."""
        if self.scores is not None:
            state = replace(state, scores=self.scores.advance(state.scores, step))
        if not step.detections.observed:
            return state
        state = _with_frame(state, step)
        if not state.begun <= step.time:
            # The first frame, or a clock that was set back.
            return replace(state, begun=step.time)
        if step.time - state.begun < LESSON:
            return state
        return self._taught(state, step.time)

    def _taught(self, state: FlickerSeen, now: float) -> FlickerSeen:
        """The state after a lesson."""
        seen = sightings(state.xyxy, state.time, state.identity)
        went = np.union1d(state.went, travellers(seen))
        waiting = _waiting(state, went, now)
        done = sightings(state.xyxy[~waiting], state.time[~waiting], state.identity[~waiting])
        counts = counted_places(done, self.size, went, state.stayed)
        kept = math.exp(-(now - state.begun) / MEMORY)
        present = np.unique(state.identity[state.time > now - LESSON])
        stayed = np.union1d(state.stayed, np.setdiff1d(done.identity, went))
        return FlickerSeen(
            state.learned.joined(counts, kept),
            state.xyxy[waiting],
            state.time[waiting],
            state.frame[waiting],
            state.row[waiting],
            state.identity[waiting],
            np.intersect1d(went, present),
            np.intersect1d(stayed[stayed >= 0], present),
            now,
            state.scores,
        )


def _waiting(state: FlickerSeen, went: I8, now: float) -> Bool:
    """(M,) True for detections of tracks that are still there and may yet go somewhere."""
    identity, first, which = np.unique(state.identity, return_index=True, return_inverse=True)
    last = np.full(len(identity), -np.inf)
    np.maximum.at(last, which, state.time)
    undecided = (identity >= 0) & ~np.isin(identity, np.concatenate([went, state.stayed]))
    young = state.time[first] > now - PATIENCE
    waiting: Bool = (undecided & young & (last > now - ENDED))[which]
    return waiting


def _with_frame(state: FlickerSeen, step: Step) -> FlickerSeen:
    """The state with the detections of a frame, and with the identities of its online rows, which
    may be of earlier frames.
    """
    found = step.detections
    count = len(found)
    frame = np.concatenate([state.frame, np.full(count, step.number)])
    row = np.concatenate([state.row, found.row])
    identity = np.concatenate([state.identity, np.full(count, -1)])
    used = np.flatnonzero(step.tracks.detection >= 0)
    for k in used.tolist():
        begin, end = np.searchsorted(frame, [step.tracks.frame[k], step.tracks.frame[k] + 1])
        at = begin + np.flatnonzero(row[begin:end] == step.tracks.detection[k])
        identity[at] = step.tracks.identity[k]
    return replace(
        state,
        xyxy=np.concatenate([state.xyxy, found.xyxy]),
        time=np.concatenate([state.time, np.full(count, step.time)]),
        frame=frame,
        row=row,
        identity=identity,
    )
