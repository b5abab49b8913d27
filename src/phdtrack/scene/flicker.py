"""Flicker of a scene: places in which things come again and again and never go anywhere.

A crown of a tree, a screen or water is detected in bursts as long as the stay of a person, so a
rate of false alarms per frame does not tell the two apart. What does is what they do: objects come
from somewhere or leave for somewhere, and flicker never does. So not detections are counted but
arrivals. In the neighbourhood of a box (as `models.volumes`: as far as its size, of half to twice
its size) there were

    n  arrivals of something that never went anywhere: runs of detections, without a gap of `GAP`
       seconds, that belong to no object that travelled
    m  visits of objects that travelled

Arrivals of flicker and visits of objects are Poisson processes with unknown rates over the same
exposure, which therefore cancels. With a prior of `PRIOR` visits the odds that the next arrival is
an object, and not flicker, are

    o = (m + PRIOR)/n, at least `LEAST_ODDS`, at most 1

At most 1, because the model of the filter already expects false alarms everywhere. Objects that
stay have one arrival however long they stay, those of a queue have visits, and so has a parked car
that leaves. A short file has too few arrivals to teach anything. What touches the border of the
picture, where objects enter, is only partly visible, so its travel cannot be seen: it counts for
nothing.

**Whole tracks.** A track that never went anywhere is flicker if o < 1 at most of its detections. n
are here the arrivals before and after it alone. If it was there for d seconds without a gap, and
they for μ on average, and objects that stay do so for `STAY` on average, both exponential, o is
multiplied by

    exp(−d/STAY)/STAY : exp(−d/μ)/μ, at least 1

so that a person who stands for long where leaves move for a moment is an object.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.types import F8, I8, Bool

# Visits that the prior is worth.
PRIOR = 3.0
# Nothing is learned that makes objects rarer than this.
LEAST_ODDS = 0.05
# Sizes that an object travels at least, and the share of its way that leads forward.
TRAVEL = 1.0
STRAIGHT = 0.6
# Seconds over which positions are averaged for this, at least so many of them, and at most.
_WINDOW = 0.2
_MIN_WINDOWS = 3
_MAX_WINDOWS = 500
# Seconds without a detection after which the next one is a new arrival.
GAP = 0.5
# Seconds for which a track may be missing and still be there.
MISSING = 2.0
# Seconds before and after a track in which what arrives may be part of it.
ASIDE = 1.0
# Seconds for which an object that stays does so on average.
STAY = 10.0
_CERTAIN = 50.0
# The share of a detection inside the box of an object that travels from which it is part of it.
PART = 0.3
# Pixels from the border of the picture within which a box touches it.
BORDER = 2.0
_NEAR = (-1, 0, 1)
_BITS = 20


@dataclass(frozen=True, slots=True)
class FlickerMap:
    """Arrivals and visits by place.

    Attributes
    ----------
    cell : (k,) the places, ascending: cells of position and size.
    arrivals, visits : (k,) n, of what never went anywhere, and m, of objects that travelled.
    """

    cell: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    arrivals: F8 = field(default_factory=lambda: np.zeros(0))
    visits: F8 = field(default_factory=lambda: np.zeros(0))

    def odds(self, z: F8) -> F8:
        """(N,) the odds that a new arrival at boxes ``z`` (4, N), centre and size, is an object, at
        most 1.
        """
        return _odds(*self._at(z))

    def odds_among(self, z: F8, others: F8) -> F8:
        """(N,) the same for what has been there, if there were ``others`` (N,) besides."""
        return _odds(others, self._at(z)[1])

    def others(self, z: F8) -> F8:
        """(N,) the number of arrivals at boxes besides one's own."""
        arrivals: F8 = np.maximum(self._at(z)[0] - 1, 0.0)
        return arrivals

    @property
    def flickers(self) -> Bool:
        """(k,) the places where flicker is likelier than objects."""
        return self.arrivals > self.visits + PRIOR

    def joined(self, other: FlickerMap, kept: float = 1.0) -> FlickerMap:
        """The map with the counts of another one; ``kept`` of its own are remembered."""
        cell = np.union1d(self.cell, other.cell)
        counts = np.zeros((2, len(cell)))
        for each, share in ((self, kept), (other, 1.0)):
            at = np.searchsorted(cell, each.cell)
            counts[:, at] += share * np.stack([each.arrivals, each.visits])
        lasting = counts.max(axis=0, initial=0.0) >= _FORGOTTEN
        return FlickerMap(cell[lasting], *counts[:, lasting])

    def _at(self, z: F8) -> F8:
        """(2, N) arrivals and visits at boxes."""
        if not len(self.cell):
            return np.zeros((2, z.shape[1]))
        cell = _cells(z)
        at = np.minimum(np.searchsorted(self.cell, cell), len(self.cell) - 1)
        known = self.cell[at] == cell
        counts: F8 = np.stack([self.arrivals[at], self.visits[at]]) * known
        return counts


NOWHERE = FlickerMap()
"""A scene in which nothing flickers."""
# A count below which a place is forgotten.
_FORGOTTEN = 0.1


@dataclass(frozen=True, slots=True)
class Sightings:
    """Detections, and the tracks they belong to.

    Attributes
    ----------
    box : (4, M) centre and size of each.
    time : (M,) seconds, ascending.
    identity : (M,) its track; −1 for none.
    """

    box: F8
    time: F8
    identity: I8


def distance_travelled(box: F8, time: F8) -> float:
    """How far an object went steadily, in its own sizes √(wh).

    This is the longest distance between two averaged positions, without the longest step between,
    of which a way leads that is at most 1/`STRAIGHT` times as long. What flickers jumps to and fro.

    Parameters
    ----------
    box : (4, n) centre and size of its detections.
    time : (n,) their seconds, ascending.
    """
    window = max(_WINDOW, float(time[-1] - time[0]) / _MAX_WINDOWS)
    first = np.unique(((time - time[0]) / window + 1e-6).astype(np.int64), return_index=True)[1]
    if len(first) < _MIN_WINDOWS:
        return 0.0
    parts = np.split(box[:2], first[1:], axis=1)
    place = np.array([np.median(part, axis=1) for part in parts])
    step = np.linalg.norm(np.diff(place, axis=0), axis=1)
    farthest = 0.0
    for start in range(0, len(place) - 2, 2):
        way = np.cumsum(step[start:])
        longest = np.maximum.accumulate(step[start:])
        distance = np.linalg.norm(place[start + 1 :] - place[start], axis=1)
        steady = (distance - longest)[distance >= STRAIGHT * way]
        farthest = max(farthest, float(steady.max(initial=0.0)))
    return farthest / float(np.sqrt(np.median(box[2] * box[3])))


def travellers(seen: Sightings) -> I8:
    """The identities of the tracks that went somewhere, ascending."""
    went = [
        int(seen.identity[rows[0]])
        for rows in _tracks(seen, seen.identity >= 0)
        if distance_travelled(seen.box[:, rows], seen.time[rows]) >= TRAVEL
    ]
    return np.array(went, np.int64)


def of_objects(seen: Sightings, went: I8) -> Bool:
    """(M,) True for detections of objects that travelled, and of parts of them.

    Parameters
    ----------
    seen : the detections.
    went : identities of the objects, ascending.
    """
    theirs = np.isin(seen.identity, went)
    whole = np.flatnonzero(theirs)
    others = np.flatnonzero(~theirs & np.isin(seen.time, seen.time[whole]))
    begin = np.searchsorted(seen.time[whole], seen.time[others], "left")
    end = np.searchsorted(seen.time[whole], seen.time[others], "right")
    out = theirs.copy()
    for k, first, last in zip(others.tolist(), begin.tolist(), end.tolist(), strict=True):
        inside = _shared(seen.box[:, k], seen.box[:, whole[first:last]])
        out[k] = inside.max(initial=0.0) >= PART
    return out


def touches_border(box: F8, size: tuple[float, float]) -> Bool:
    """(M,) True for boxes (4, M) that touch the border of a picture of this width and height; for
    none if they are (0, 0), unknown.
    """
    if not min(size) > 0:
        return np.zeros(box.shape[1], np.bool_)
    low = box[:2] - box[2:] / 2
    high = box[:2] + box[2:] / 2
    limit = np.array(size)[:, None] - BORDER
    return np.asarray(((low <= BORDER) | (high >= limit)).any(axis=0))


def counted_places(
    seen: Sightings, size: tuple[float, float], went: I8, known: I8 | None = None
) -> FlickerMap:
    """The arrivals and visits of a sequence, or of a part of it.

    Parameters
    ----------
    seen : its detections.
    size : width and height of the picture, pixels.
    went : identities of objects that travelled, ascending.
    known : identities whose arrival was counted before.
    """
    arrived = arrivals(seen, size, went, known).cell
    objects = of_objects(seen, went) & (seen.identity >= 0)
    visited = _distinct(seen.box[:, objects], seen.identity[objects])[0]
    cell = np.unique(np.concatenate([arrived, visited]))
    counts = [
        np.bincount(np.searchsorted(cell, each), minlength=len(cell)).astype(np.float64)
        for each in (arrived, visited)
    ]
    return FlickerMap(cell, *counts)


class Arrivals(NamedTuple):
    """Arrivals of what never went anywhere: their places (a,), ascending, seconds (a,), which
    ascend in each place, and for how many seconds (a,) they were there.
    """

    cell: I8
    time: F8
    duration: F8

    def others(self, box: F8, begin: float, end: float) -> tuple[F8, F8]:
        """(n,) the number of other arrivals at boxes, and (n,) the seconds for which they were
        there together.

        Parameters
        ----------
        box : (4, n) centre and size.
        begin, end : seconds; those between are not others.
        """
        place, which = np.unique(_cells(box), return_inverse=True)
        first = np.searchsorted(self.cell, place, "left")
        last = np.searchsorted(self.cell, place, "right")
        out = np.zeros((2, len(place)))
        for k, (a, b) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
            other = (self.time[a:b] + self.duration[a:b] < begin) | (self.time[a:b] > end)
            out[:, k] = other.sum(), self.duration[a:b][other].sum()
        return out[0, which], out[1, which]


def _present(seen: Sightings, chosen: Bool) -> tuple[F8, I8]:
    """(4, K) boxes and (K,) blocks of time in which each of the chosen detections was there; a
    track that is missing for up to `MISSING` seconds is there, too.
    """
    rows = np.flatnonzero(chosen)
    block = (seen.time[rows] / GAP + 1e-6).astype(np.int64)
    order = np.lexsort((block, seen.identity[rows]))
    rows = rows[order]
    block = block[order]
    ahead = np.diff(block, append=block[-1:])
    same = (seen.identity[rows] >= 0) & (np.diff(seen.identity[rows], append=-1) == 0)
    gap = np.where(same & (ahead <= MISSING / GAP), np.maximum(ahead, 1), 1)
    which = np.repeat(np.arange(len(rows)), gap)
    later = np.arange(len(which)) - np.repeat(np.cumsum(gap) - gap, gap)
    return seen.box[:, rows[which]], block[which] + later


NO_ARRIVALS = Arrivals(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


def arrivals(
    seen: Sightings, size: tuple[float, float], went: I8, known: I8 | None = None
) -> Arrivals:
    """The arrivals of what never went anywhere.

    Parameters
    ----------
    seen, size : detections, and width and height of the picture, pixels.
    went, known : identities as of `counted_places`.
    """
    still = ~of_objects(seen, went) & ~touches_border(seen.box, size)
    if known is not None:
        still &= ~np.isin(seen.identity, known)
    box, block = _present(seen, still)
    cell, when = _distinct(box, block)
    # Blocks of time without a gap are one arrival.
    begins = (np.diff(cell, prepend=-1) != 0) | (np.diff(when, prepend=-2) > 1)
    begin = np.flatnonzero(begins)
    last = when[np.append(begin[1:], len(when)) - 1] if len(begin) else when
    return Arrivals(cell[begins], when[begins] * GAP, (last - when[begins] + 1) * GAP)


def learn_flicker(seen: Sightings, size: tuple[float, float]) -> FlickerMap:
    """The places where a whole sequence flickers; `NOWHERE` if none does.

    Parameters
    ----------
    seen : its detections, with corrected tracks.
    size : width and height of the picture, pixels.
    """
    learned = counted_places(seen, size, travellers(seen))
    if learned.flickers.any():
        return learned
    return NOWHERE


def without_flicker(
    seen: Sightings, learned: FlickerMap, came: Arrivals, size: tuple[float, float]
) -> I8:
    """The identities of the tracks that are flicker, ascending: they went nowhere, and at most of
    their detections flicker is likelier than an object that stops.

    Only arrivals before or after a track count against it, because an object that stays may itself
    be detected in parts. What is there for much longer than they is an object, too.

    Parameters
    ----------
    seen : detections with corrected tracks.
    learned, came : where the scene flickers, and all arrivals.
    size : width and height of the picture, pixels.
    """
    still = (seen.identity >= 0) & ~np.isin(seen.identity, travellers(seen))
    flicker = list[int]()
    for rows in _tracks(seen, still):
        box = seen.box[:, rows]
        begin, end = seen.time[rows[[0, -1]]].tolist()
        others, together = came.others(box, begin - ASIDE, end + ASIDE)
        odds = learned.odds_among(box, others)
        odds = odds * _stays(_longest_run(seen.time[rows]), (together + GAP) / (others + 1))
        if ((odds < 1) & ~touches_border(box, size)).mean() > 0.5:
            flicker.append(int(seen.identity[rows[0]]))
    return np.array(flicker, np.int64)


def _longest_run(time: F8) -> float:
    """The longest time, in seconds, without a gap between detections at these seconds."""
    begin = np.flatnonzero(np.diff(time, prepend=-np.inf) > GAP)
    end = np.append(begin[1:], len(time)) - 1
    return float((time[end] - time[begin]).max()) + GAP


def _stays(seconds: float, mean: F8) -> F8:
    """(n,) how many times as likely an object stays for so long as flicker does whose mean is
    ``mean`` (n,) seconds; at least 1.
    """
    log = seconds / mean - seconds / STAY + np.log(mean / STAY)
    return np.exp(np.clip(log, 0.0, _CERTAIN))


def _tracks(seen: Sightings, chosen: Bool) -> list[I8]:
    """The rows of each track among those chosen, by identity."""
    rows = np.flatnonzero(chosen)
    rows = rows[np.argsort(seen.identity[rows], kind="stable")]
    bounds = np.flatnonzero(np.diff(seen.identity[rows])) + 1
    return [part for part in np.split(rows, bounds) if len(part)]


def _odds(arrivals: F8, visits: F8) -> F8:
    """The odds of an object, between `LEAST_ODDS` and 1."""
    return np.clip((visits + PRIOR) / np.maximum(arrivals, 1.0), LEAST_ODDS, 1.0)


def _cells(box: F8) -> I8:
    """(M,) the cell of each box: the power of two below its size, and the position in units of
    that.
    """
    level = np.floor(np.log2(np.maximum(np.sqrt(box[2] * box[3]), 1.0))).astype(np.int64)
    place = np.floor(box[:2] / 2.0**level).astype(np.int64)
    return _packed(level, place[0], place[1])


def _packed(level: I8, column: I8, row: I8) -> I8:
    """One number for each cell; positions outside of the picture are negative."""
    half = 1 << (_BITS - 1)
    cell: I8 = ((level + 1) << (2 * _BITS)) + ((column + half) << _BITS) + row + half
    return cell


def _apart(cell: I8) -> tuple[I8, I8, I8]:
    """Level, column and row of cells."""
    half = 1 << (_BITS - 1)
    mask = (1 << _BITS) - 1
    return (cell >> (2 * _BITS)) - 1, ((cell >> _BITS) & mask) - half, (cell & mask) - half


def _distinct(box: F8, event: I8) -> tuple[I8, I8]:
    """The distinct pairs of a place in the neighbourhood of a box (4, M) and its event (M,): their
    cells and their events, ordered.
    """
    if not len(event):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    pairs = np.unique(np.stack([_cells(box), event]), axis=1)
    level, column, row = _apart(pairs[0])
    around = list[I8]()
    for step in _NEAR:
        # The cell of another level that holds the middle of this one.
        scale = 2.0**-step
        x = np.floor((column + 0.5) * scale).astype(np.int64)
        y = np.floor((row + 0.5) * scale).astype(np.int64)
        around += [_packed(level + step, x + i, y + j) for i in _NEAR for j in _NEAR]
    both = np.stack([np.concatenate(around), np.tile(pairs[1], len(around))])
    both = both[:, np.lexsort(both[::-1])]
    new = np.any(np.diff(both, axis=1, prepend=-1) != 0, axis=0)
    return both[0, new], both[1, new]


def _shared(box: F8, others: F8) -> F8:
    """(n,) the share of a box (4,) that lies in each of the others (4, n)."""
    low = np.maximum((box[:2] - box[2:] / 2)[:, None], others[:2] - others[2:] / 2)
    high = np.minimum((box[:2] + box[2:] / 2)[:, None], others[:2] + others[2:] / 2)
    return np.asarray(np.maximum(high - low, 0.0).prod(axis=0) / (box[2] * box[3]))


def flicker_share(
    seen: Sightings, learned: FlickerMap, size: tuple[float, float], frames: int, rows: int
) -> F8:
    """(rows, columns) the share of the frames in which a detection of flicker covers each place of
    the picture.

    Parameters
    ----------
    seen, learned : the detections, with corrected tracks, and where the scene flickers.
    size, frames : width and height of the picture, pixels, and the number of frames.
    rows : of the map.
    """
    columns = max(1, round(rows * size[0] / size[1]))
    still = ~of_objects(seen, travellers(seen)) & ~touches_border(seen.box, size)
    box = seen.box[:, still & (learned.odds(seen.box) < 1)]
    scale = np.array([columns / size[0], rows / size[1]])[:, None]
    low = np.floor((box[:2] - box[2:] / 2) * scale).astype(np.int64)
    high = np.ceil((box[:2] + box[2:] / 2) * scale).astype(np.int64)
    limit = np.array([[columns], [rows]])
    low = np.clip(low, 0, limit)
    high = np.clip(high, 0, limit)
    # Corners of the boxes; their double sum fills them.
    corners = np.zeros((rows + 1, columns + 1))
    for x, y, sign in ((low, low, 1), (high, high, 1), (low, high, -1), (high, low, -1)):
        np.add.at(corners, (y[1], x[0]), sign)
    filled: F8 = corners.cumsum(axis=0).cumsum(axis=1)[:rows, :columns]
    return np.minimum(filled / max(frames, 1), 1.0)


def sightings(xyxy: F8, time: F8, identity: I8) -> Sightings:
    """Sightings of boxes; those without extent are left out.

    Parameters
    ----------
    xyxy, time : (M, 4) boxes and (M,) their seconds, ascending.
    identity : (M,) the track of each; −1 for none.
    """
    box = to_cxcywh(xyxy)
    good = (box[2:] > 0).all(axis=0)
    return Sightings(box[:, good], time[good], identity[good])
