"""What the associator remembers of every frame, as a record that grows without copying all of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from phdtrack.associate.triangle import lower, whole
from phdtrack.associate.window import Links
from phdtrack.types import F8, I8, STILL, Estimates, MeasurementHistory

# Twice as many moments are held as they came before the older half is joined: what was just seen is asked for most.
CHUNK = 32


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One frame: its number, its model time, its states (vertices ``first``, ``first`` + 1, …), and the links made final.

    ``final`` are the links (between global vertex numbers) that this frame made unchangeable. ``z`` (m, N) are the
    measurements. ``warp`` is how the camera moved since the frame before (`Model.warp`): everything else lies in the frame's
    own pixels.
    """

    number: int
    time: float
    first: int
    estimates: Estimates
    final: Links
    z: F8
    warp: F8 = field(default_factory=lambda: STILL)

    @property
    def spare(self) -> I8:
        """(S,) the measurements that no state rests on."""
        n = self.z.shape[1]
        # The last place stands for no detection.
        free = np.ones(n + 1, np.bool_)
        free[np.minimum(self.estimates.detection, n)] = False
        return free[:n].nonzero()[0]


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Some moments in a row, end to end in few arrays: a frame takes its numbers and no objects.

    ``number``, ``time`` (K,); ``vertex`` (K + 1,), ``link`` (K + 1,), ``other`` (K + 1,): where each moment's states (by
    vertex number), final links and measurements begin. ``estimates`` holds all states, with of each covariance
    the lower triangle (d·(d + 1)/2,). ``warp`` is (K, 3, 3), or (0, 3, 3) where the camera stood still.
    """

    number: I8
    time: F8
    vertex: I8
    link: I8
    other: I8
    estimates: Estimates
    final: Links
    z: F8
    warp: F8

    @classmethod
    def of(cls, moments: tuple[Moment, ...]) -> Chunk:
        """The same moments, joined."""
        estimates, final = [m.estimates for m in moments], [m.final for m in moments]
        # Frames without states may come in any dimension: that of a tracker that has not seen any.
        full = [e for e in estimates if len(e)] or estimates[:1]
        shown = [m.z for m in moments if m.z.shape[1]] or [moments[0].z]
        triangle, moved = lower(len(full[0].state)), any(len(m.warp) for m in moments)
        return cls(
            np.array([m.number for m in moments], np.int64),
            np.array([m.time for m in moments]),
            moments[0].first + _ends([len(e) for e in estimates]),
            _ends([len(f.later) for f in final]),
            _ends([m.z.shape[1] for m in moments]),
            Estimates(
                np.hstack([e.state for e in full]),
                np.concatenate([e.covariance for e in full])[:, triangle.row, triangle.column],
                np.concatenate([e.weight for e in full]),
                np.concatenate([e.xyxy for e in full]),
                np.concatenate([e.detection for e in full]),
                np.concatenate([e.tag for e in full]),
            ),
            Links(
                np.concatenate([f.later for f in final]),
                np.concatenate([f.earlier for f in final]),
                np.concatenate([f.gain for f in final]),
            ),
            np.hstack(shown),
            np.array([m.warp if len(m.warp) else np.eye(3) for m in moments if moved]).reshape(-1, 3, 3),
        )

    def __len__(self) -> int:
        return len(self.number)

    def __getitem__(self, place: int) -> Moment:
        states = slice(*(self.vertex[place : place + 2] - self.vertex[0]).tolist())
        links, shown = slice(*self.link[place : place + 2].tolist()), slice(*self.other[place : place + 2].tolist())
        x, f = self.estimates, self.final
        covariance = whole(x.covariance[states], len(x.state))
        return Moment(
            int(self.number[place]),
            float(self.time[place]),
            int(self.vertex[place]),
            Estimates(x.state[:, states], covariance, x.weight[states], x.xyxy[states], x.detection[states], x.tag[states]),
            Links(f.later[links], f.earlier[links], f.gain[links]),
            self.z[:, shown],
            self.warp[place] if len(self.warp) else STILL,
        )


def measurements(moments: Iterable[Moment]) -> MeasurementHistory:
    """The measurements of all moments."""
    held = list(moments)
    shown = [m.z for m in held if m.z.shape[1]] or [m.z for m in held[:1]] or [np.zeros((0, 0))]
    moved = any(len(m.warp) for m in held)
    return MeasurementHistory(
        np.array([m.number for m in held], np.int64),
        np.array([m.time for m in held]),
        _ends([m.z.shape[1] for m in held]),
        np.hstack(shown),
        np.array([m.warp if len(m.warp) else np.eye(3) for m in held if moved]).reshape(-1, 3, 3),
        np.zeros((sum(m.z.shape[1] for m in held), 0), np.float32),
    )


def _ends(counts: list[int]) -> I8:
    """(K + 1,) where each of K stretches of these lengths begins, and the last ends."""
    return np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))


@dataclass(frozen=True, slots=True)
class History:
    """All moments so far, in chunks, so that adding one copies a few dozen references at most.

    Places count from the first frame; the first ``forgotten`` of them are no longer held.
    """

    full: tuple[Chunk, ...] = ()
    recent: tuple[Moment, ...] = ()
    forgotten: int = 0

    def append(self, moment: Moment) -> History:
        """A history with one more moment."""
        recent = (*self.recent, moment)
        if len(recent) < 2 * CHUNK:
            return History(self.full, recent, self.forgotten)
        return History((*self.full, Chunk.of(recent[:CHUNK])), recent[CHUNK:], self.forgotten)

    def since(self, time: float) -> History:
        """Without the chunks that lie before ``time``."""
        gone = 0
        while gone < len(self.full) and self.full[gone].time[-1] < time:
            gone += 1
        return History(self.full[gone:], self.recent, self.forgotten + CHUNK * gone) if gone else self

    def __len__(self) -> int:
        return self.forgotten + CHUNK * len(self.full) + len(self.recent)

    def __getitem__(self, index: int) -> Moment:
        chunk, place = divmod(index - self.forgotten, CHUNK)
        if chunk < len(self.full):
            return self.full[chunk][place]
        return self.recent[index - self.forgotten - CHUNK * len(self.full)]

    def __iter__(self) -> Iterator[Moment]:
        """Those still held."""
        for index in range(self.forgotten, len(self)):
            yield self[index]
