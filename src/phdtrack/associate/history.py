"""The frames that associators remember, and the rows of corrected tracks that follow from them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import field, replace
from typing import Protocol

import numpy as np

from phdtrack.kernels.linking import Links, Window
from phdtrack.models import warp as warp_of
from phdtrack.models.rts import bridge
from phdtrack.protocols import Model
from phdtrack.types import (
    F4,
    F8,
    I8,
    NO_DESCRIPTORS,
    STILL,
    Detections,
    Estimates,
    MeasurementHistory,
    Tracks,
    row_of,
    state_record,
)

NO_LINKS = Links(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
# Seconds of the filter's time that are remembered by default, so that memory stays bounded: some
# 100 MB with ten targets at 25 fps.
HISTORY = 600.0
# Moments in a chunk: adding a moment copies references to less than two chunks and to the chunks
# before.
CHUNK = 32

# Seconds of the longest gap of a corrected track that has rows: a target in view is seldom missed
# for longer.
LONGEST_BRIDGE = 2.0
# A detector is overdue this many intervals of its last two frames after the last.
OVERDUE = 1.5
# Frames in a row without detection that are remembered: tracks are not continued for longer.
MOST_UNOBSERVED = 300

# A track: the places (moment, state) of its states.
Path = list[tuple[int, int]]


@state_record
class Moment:
    """One frame.

    Attributes
    ----------
    number, time : frame number and model time.
    first : number of the first vertex; the states are the vertices ``first``, ``first`` + 1, …
    estimates : the states.
    final : the links, between vertices, that can no longer change since this frame.
    z : (m, N) measurements.
    row, class_id, score : (N,) of the detections that were measured.
    warp : the camera's motion since the frame before (`Model.warp`); all else lies in the frame's
        own pixels.
    observed : whether a detector ran. If not, the states are predicted from the frame that was
        observed before, and nothing is learned of them.
    embeddings : (N, D) of the detections; (0, 0) without.
    pace : how fast the model's time has run since the last observed frame (`Model.pace`).
    """

    number: int
    time: float
    first: int
    estimates: Estimates
    final: Links
    z: F8
    row: I8
    class_id: I8
    score: F8
    warp: F8 = field(default_factory=lambda: STILL)
    observed: bool = True
    embeddings: F4 = field(default_factory=lambda: NO_DESCRIPTORS)
    pace: float = 1.0

    @property
    def rows(self) -> I8:
        """(n,) `Detections.row` of the detection that each state rests on, −1 for none."""
        return row_of(self.row, self.estimates.detection)

    def with_estimates(self, estimates: Estimates) -> Moment:
        """The same frame with other states."""
        return Moment(
            self.number,
            self.time,
            self.first,
            estimates,
            self.final,
            self.z,
            self.row,
            self.class_id,
            self.score,
            self.warp,
            self.observed,
            self.embeddings,
            self.pace,
        )

    def columns(self) -> I8:
        """One measurement for each detection, ascending by row: the last of those that share a
        merged one.
        """
        if (self.row[1:] > self.row[:-1]).all():
            return np.arange(len(self.row))
        order = np.argsort(self.row, kind="stable")
        rising = self.row[order]
        return np.asarray(order[np.append(rising[1:] > rising[:-1], True)])


@state_record
class History:
    """All moments so far. Places count from the first frame; the first ``forgotten`` of them are no
    longer held.
    """

    full: tuple[tuple[Moment, ...], ...] = ()
    recent: tuple[Moment, ...] = ()
    forgotten: int = 0

    def append(self, moment: Moment) -> History:
        """A history with one more moment."""
        recent = (*self.recent, moment)
        if len(recent) < 2 * CHUNK:
            return History(self.full, recent, self.forgotten)
        return History((*self.full, recent[:CHUNK]), recent[CHUNK:], self.forgotten)

    def followed_by(self, moment: Moment) -> History:
        """A history with one more moment, whose time and warp are as of `next_moment`.

        Of more moments in a row that were not observed than `MOST_UNOBSERVED` no more is kept.
        """
        gap = unobserved_at_end(self, self.forgotten)
        if len(gap) >= MOST_UNOBSERVED and not moment.observed:
            return self
        place = len(self) - len(gap) - 1
        before = self[place] if place >= self.forgotten else None
        timed, moment = next_moment(before, gap, moment)
        held = min(len(gap), len(self.recent))
        recent = (*self.recent[: len(self.recent) - held], *timed[len(gap) - held :])
        return History(self.full, recent, self.forgotten).append(moment)

    def since(self, time: float) -> History:
        """Without the chunks that lie before model time ``time``."""
        gone = 0
        while gone < len(self.full) and self.full[gone][-1].time < time:
            gone += 1
        if gone:
            return History(self.full[gone:], self.recent, self.forgotten + CHUNK * gone)
        return self

    def __len__(self) -> int:
        return self.forgotten + CHUNK * len(self.full) + len(self.recent)

    def __getitem__(self, index: int) -> Moment:
        chunk, place = divmod(index - self.forgotten, CHUNK)
        if chunk < len(self.full):
            return self.full[chunk][place]
        return self.recent[index - self.forgotten - CHUNK * len(self.full)]

    def __iter__(self) -> Iterator[Moment]:
        """The moments that are still held."""
        return itertools.chain(*self.full, self.recent)


class Moments(Protocol):
    """Moments by their places."""

    def __getitem__(self, place: int, /) -> Moment:
        """The moment at a place."""


def unobserved_at_end(moments: History | Sequence[Moment], first: int = 0) -> list[Moment]:
    """The moments since the last that was observed, of those from place ``first`` on."""
    begin = len(moments)
    while begin > first and not moments[begin - 1].observed:
        begin -= 1
    return [moments[k] for k in range(begin, len(moments))]


def seen_until(moments: Moments, place: int, first: int) -> float:
    """The model time up to which something is known of a moment.

    Its own where it was observed. Otherwise that of the last moment that was: no track is missing
    for want of a detector. Where the detector is overdue, its own again.

    Parameters
    ----------
    moments, place : the moments, and the place of the one that is asked for.
    first : the first place that is held.
    """
    moment = moments[place]
    if moment.observed:
        return moment.time
    times: list[float] = []
    k = place
    while k >= first and len(times) < 2 and place - k <= 2 * MOST_UNOBSERVED:
        if moments[k].observed:
            times.append(moments[k].time)
        k -= 1
    if len(times) < 2:
        return moment.time
    newest, before = times
    return newest if moment.time - newest <= OVERDUE * (newest - before) else moment.time


def next_moment(
    before: Moment | None, gap: Sequence[Moment], moment: Moment
) -> tuple[tuple[Moment, ...], Moment]:
    """A moment, and those that were not observed before it, in the order of their times.

    Parameters
    ----------
    before, gap : the last moment that was observed, if any, and those since.
    moment : the new one, with time and warp since ``before``; it is returned with the warp since
        the last of the gap. Times that these were expected at are moved before its own.
    """
    if not gap:
        return (), moment
    before_it = warp_of.joined([one.warp for one in gap])
    if len(before_it):
        last = warp_of.joined([warp_of.back(before_it), moment.warp])
        moment = replace(moment, warp=last)
    if before is None or gap[-1].time < moment.time:
        return tuple(gap), moment
    since = before.time
    rate = (moment.time - since) / (gap[-1].time - since) * len(gap) / (len(gap) + 1)
    return tuple(replace(one, time=since + rate * (one.time - since)) for one in gap), moment


def observed_only(moments: Sequence[Moment]) -> list[Moment]:
    """The moments that were observed, with the camera's motion since the one before."""
    out = list[Moment]()
    warps = list[F8]()
    for moment in moments:
        warps.append(moment.warp)
        if moment.observed:
            if len(warps) > 1:
                moment = replace(moment, warp=warp_of.joined(warps))
            out.append(moment)
            warps.clear()
    return out


def open_links(window: Window, most: int | None = None) -> Links:
    """The links of the window's rows, or of the first ``most`` of them."""
    linked = (window.previous[:most] >= 0).nonzero()[0]
    if len(linked):
        return Links(window.row + linked, window.previous[linked], window.gain[linked])
    return NO_LINKS


def measurements(moments: Iterable[Moment]) -> MeasurementHistory:
    """The measurements of all moments."""
    # As an iterator: by its length, which counts what is forgotten, a list would ask for too much
    # memory.
    held = list(iter(moments))
    columns = [m.columns() for m in held]
    count = [len(index) for index in columns]
    each = list(zip(held, columns, strict=True))
    shown = [m.z[:, index] for m, index in each if len(index)]
    shown = shown or [m.z for m in held[:1]] or [np.zeros((0, 0))]
    moved = any(len(m.warp) for m in held)
    return MeasurementHistory(
        np.array([m.number for m in held], np.int64),
        np.array([m.time for m in held]),
        np.concatenate(([0], np.cumsum(count, dtype=np.int64))),
        np.hstack(shown),
        np.array([m.warp if len(m.warp) else np.eye(3) for m in held if moved]).reshape(-1, 3, 3),
        np.concatenate([np.zeros(0, np.int64), *(m.row[index] for m, index in each)]),
        np.concatenate([np.zeros(0, np.int64), *(m.class_id[index] for m, index in each)]),
        np.concatenate([np.zeros(0), *(m.score[index] for m, index in each)]),
        _embeddings([(m.embeddings, index) for m, index in each]),
        _pace(held),
    )


def descriptors(detections: Detections) -> F4:
    """(N, D) the embeddings of detections; (0, 0) without."""
    if detections.embeddings is None:
        return NO_DESCRIPTORS
    return detections.embeddings


def _pace(moments: list[Moment]) -> F8:
    """(F,) `Moment.pace` of each; of one that was not observed that of the next that was."""
    pace = np.array([m.pace for m in moments])
    for k in range(len(moments) - 2, -1, -1):
        if not moments[k].observed:
            pace[k] = pace[k + 1]
    return pace


def _embeddings(each: list[tuple[F4, I8]]) -> F4:
    """(Z, D) the descriptors of all measurements, zeros where they are not known; (0, 0) where none
    is.
    """
    sizes = [known.shape[1] for known, _ in each if len(known)]
    if not sizes:
        return np.zeros((0, 0), np.float32)
    parts = list[F4]()
    for known, index in each:
        if not len(known) or known.shape[1] != sizes[-1]:
            parts.append(np.zeros((len(index), sizes[-1]), np.float32))
        else:
            usable = np.isfinite(known).all(axis=1, keepdims=True)
            parts.append(np.where(usable, known, 0.0)[index].astype(np.float32))
    return np.concatenate(parts)


def rows_of(
    moments: list[Moment], at: I8, name: I8, bridge_gaps: bool, model: Model
) -> list[Tracks]:
    """The rows of tracks: one for each state, and those of gaps.

    Parameters
    ----------
    moments : all frames.
    at : (S,) the states of the tracks, one track after the other, counted through all moments.
    name : (S,) the identity of each.
    bridge_gaps : with predicted rows between states that are more than one frame apart.
    model : of the last frame.
    """
    if not len(at):
        return []
    every = [m.estimates for m in moments]
    start = np.concatenate(([0], np.cumsum([len(e) for e in every])))
    place = np.searchsorted(start, at, side="right") - 1
    number = np.array([m.number for m in moments])
    time = np.array([m.time for m in moments])
    weight = np.concatenate([e.weight for e in every])[at]
    boxes = np.concatenate([e.xyxy for e in every])[at]
    detection = np.concatenate([m.rows for m in moments])[at]
    parts = [Tracks.of(number[place], name, boxes, weight, detection)]
    # Gaps of the same intervals are bridged together, as thousands of them take their time; under a
    # moving camera by place.
    alike = dict[tuple[float, ...], list[int]]()
    gap = (np.diff(place) > 1) & (np.diff(name) == 0)
    gap &= np.diff(time[place]) <= LONGEST_BRIDGE * model.rate + 1e-9
    for before in np.flatnonzero(gap).tolist() if bridge_gaps else ():
        k, m = place[before : before + 2].tolist()
        moving = any(len(moment.warp) for moment in moments[k + 1 : m + 1])
        alike.setdefault((k if moving else -1, *np.diff(time[k : m + 1]).tolist()), []).append(
            before
        )
    for (since, *steps), gaps in alike.items():
        n = np.array(gaps)
        k = int(since)
        length = len(steps) - 1
        (x, p), (y, q) = (
            _states(every, place[end], (at - start[place])[end]) for end in (n, n + 1)
        )
        warps = [moment.warp for moment in moments[k + 1 : k + length + 2]] if k >= 0 else []
        between = bridge(model.motion, (x, p, y, q), np.array(steps), warps).reshape(x.shape[1], -1)
        numbers = number[(place[n][:, None] + np.arange(1, length + 1)).ravel()]
        sure = np.repeat(np.minimum(weight[n], weight[n + 1]), length)
        parts.append(
            Tracks.of(numbers, np.repeat(name[n], length), model.sensor.boxes(between), sure, -1)
        )
    return parts


def _states(every: list[Estimates], place: I8, index: I8) -> tuple[F8, F8]:
    """(n, d) means and (n, d, d) covariances of the states at ``index`` (n,) of the frames at
    ``place`` (n,).
    """
    both = list(zip(place.tolist(), index.tolist(), strict=True))
    return np.stack([every[k].state[:, i] for k, i in both]), np.stack(
        [every[k].covariance[i] for k, i in both]
    )
