"""Corrected rows of a loop without end, each given once, when it is final."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from phdtrack.tracker import Tracker
from phdtrack.types import Tracks


class FinalTracks:
    """The corrected rows of a loop without end, each given once, when it is final.

    A row is final ``lag`` seconds after its frame. A track that lasts longer than the tracker
    remembers keeps its identity (``associate={"history": S}``: the lag, ``every``, and what comes
    before the rows, 30 s or more). Take `rest` before the tracker is reset. What was given is no
    part of a tracker's state: after `Tracker.load_state_dict` rows come again.

    Parameters
    ----------
    tracker : whose `Tracker.update` is called in between.
    lag, every : seconds after which rows are final, and between two times that they are given.
    """

    def __init__(self, tracker: Tracker, lag: float = 30.0, every: float = 30.0) -> None:
        self._tracker = tracker
        self._lag = lag
        self._every = every
        self._sequence = 0
        self._follow()

    def _follow(self) -> None:
        """Begin anew if the tracker was reset or has loaded a state."""
        if self._sequence == self._tracker.sequences:
            return
        self._sequence = self._tracker.sequences
        self._last = 0
        self._used = 0
        self._next = math.nan
        # When each frame was, of those that are not final; identities of rows that were given, by
        # frame and detection.
        self._times = dict[int, float]()
        self._identities = dict[tuple[int, int], int]()

    def due(self) -> Tracks:
        """The rows that are final now; none except every so many seconds. Call it after each
        update.
        """
        self._follow()
        step = self._tracker.step
        if step is None:
            return Tracks.empty()
        self._times[step.number] = step.time
        if math.isnan(self._next):
            self._next = step.time + self._lag + self._every
        if step.time < self._next:
            return Tracks.empty()
        self._next = step.time + self._every
        past = [number for number, time in self._times.items() if time <= step.time - self._lag]
        return self._up_to(max(past, default=0))

    def rest(self) -> Tracks:
        """All other rows, at the end."""
        self._follow()
        return self._up_to(self._tracker.state.number)

    def _up_to(self, frame: int) -> Tracks:
        """The rows after those that were given, up to a frame, with lasting identities."""
        rows = self._tracker.tracks()
        fresh = rows.select((rows.frame > self._last) & (rows.frame <= frame))
        votes: dict[int, Counter[int]] = {
            identity: Counter() for identity in np.unique(fresh.identity).tolist()
        }
        for number, identity, detection in _detected(rows):
            if identity in votes and (number, detection) in self._identities:
                votes[identity][self._identities[number, detection]] += 1
        names = dict[int, int]()
        for identity in sorted(votes, key=lambda one: -max(votes[one].values(), default=0)):
            free = [name for name, _ in votes[identity].most_common() if name not in names.values()]
            self._used += not free
            names[identity] = free[0] if free else self._used
        first = int(rows.frame.min(initial=frame))
        self._identities = {at: name for at, name in self._identities.items() if at[0] >= first}
        for number, identity, detection in _detected(fresh):
            self._identities[number, detection] = names[identity]
        self._times = {number: time for number, time in self._times.items() if number > frame}
        self._last = max(self._last, frame)
        lasting = [names[identity] for identity in fresh.identity.tolist()]
        return replace(fresh, identity=np.array(lasting, np.int64))


def _detected(rows: Tracks) -> Iterator[tuple[int, int, int]]:
    """Frame, identity and detection of each row that rests on one."""
    seen = rows.select(rows.detection >= 0)
    return zip(seen.frame.tolist(), seen.identity.tolist(), seen.detection.tolist(), strict=True)
