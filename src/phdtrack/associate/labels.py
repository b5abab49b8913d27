"""Identities by the labels of filters that follow targets one by one (`Estimates.tag`), instead of
links between states.

Where a filter revises the past (`Estimates.past`), its last word stands in corrected tracks and in
the online rows that ``output_delay`` holds back.

With ``coast_by_evidence`` a confirmed track that has been missing for a seconds is shown while

    f(a) + PRIOR·[a ≤ max_coast] > SHARE (f(a) + l(a) + PRIOR)

Of the tracks that the filter went on reporting for a seconds or longer without a detection, f were
then found where they were predicted, and l elsewhere or not in time (`kernels.coasting`). Where a
track was predicted is where its box was going. A track that the filter has dropped counts for as
long as it was reported: what comes later could not have been shown. Old verdicts fade with new
ones, not with time. Ages are in the model's time: the length of frames makes no difference, nor do
frames left out.

Where a detector ran, a row without a detection is shown if its box lies on a target more probably
than not (`models.predicted_boxes`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.associate.history import (
    HISTORY,
    MOST_UNOBSERVED,
    NO_LINKS,
    History,
    Moment,
    descriptors,
    measurements,
    next_moment,
    rows_of,
    seen_until,
    unobserved_at_end,
)
from phdtrack.associate.reidentification import Names, Returns, reidentified
from phdtrack.errors import Checked, Count, InputError, NonNegative, PositiveCount
from phdtrack.kernels import Records
from phdtrack.kernels.appearance import Looks
from phdtrack.kernels.coasting import STEPS, Followed
from phdtrack.kernels.label_table import LABEL, counted_frame, detected_rows, due_rows
from phdtrack.models.box import BoxSensor
from phdtrack.models.predicted_boxes import SHOWN, on_target
from phdtrack.models.warp import warp_states
from phdtrack.protocols import Model
from phdtrack.types import (
    F8,
    I8,
    Appeared,
    Detections,
    Estimates,
    Exchange,
    MeasurementHistory,
    Return,
    Tracks,
    state_record,
)

# Verdicts that ``max_coast`` counts for; the share of those found again from which a missing track
# is shown; how many are remembered of each age.
PRIOR = 3.0
SHARE = 0.5
REMEMBERED = 200.0
# Seconds, and frames, after which a missing track is not found in time: the later of the two.
PATIENCE = 0.8
PATIENT_FRAMES = 20.0
_NONE = np.zeros(0)
_NO_BOX = np.zeros((0, 4))
_NO_LABELS: I8 = np.zeros(0, np.int64)
NO_TRACKS = Followed(np.zeros(0, np.int64), _NONE, _NONE, _NO_BOX, _NO_BOX, np.zeros((2, STEPS)))


@state_record
class LabelledState:
    """The state that is carried from frame to frame.

    Attributes
    ----------
    history, recent : frames that no revision reaches any more, and those that one may reach.
    table : (a,) of `kernels.label_table.LABEL`, what is known of the labels in the first.
    time, used : model time; the highest identity of online rows.
    followed : the tracks that may be missing, and how missing ones came back; none unless
        ``coast_by_evidence``.
    returns : what targets looked like, and who came back.
    """

    history: History = field(default_factory=History)
    recent: tuple[Moment, ...] = ()
    table: Records = field(default_factory=lambda: np.zeros(0, LABEL))
    time: float = 0.0
    used: int = 0
    followed: Followed = NO_TRACKS
    returns: Returns = field(default_factory=Returns)

    def __len__(self) -> int:
        return len(self.history) + len(self.recent)

    def __getitem__(self, place: int) -> Moment:
        settled = len(self.history)
        if place < settled:
            return self.history[place]
        return self.recent[place - settled]

    def seen_until(self, place: int) -> float:
        """See `history.seen_until`."""
        return seen_until(self, place, self.history.forgotten)


@dataclass(frozen=True, slots=True)
class Labelled(Checked):
    """Settings of identities by label.

    Parameters
    ----------
    min_track_length : states that rest on detections below which a track is discarded (offline) or
        not confirmed (online).
    output_delay : frames by which the online output lags, so that what follows can revise states
        and confirm tracks.
    max_coast : seconds for which, at most, a confirmed track is continued online past its last
        detection. Corrected tracks end with their last one.
    coast_by_evidence : such a track is shown while, in this stream, more of those missing as long
        were found again where they were predicted than not; ``max_coast`` is what is expected
        before any are known.
    bridge_gaps : fill gaps of up to two seconds with predicted rows, smoothed in corrected
        tracks. Otherwise every row rests on a detection.
    history : seconds of the filter's time (`time.longest_interval`) after which the past is
        forgotten; 0: never. Corrected tracks then go no further back than this and a little more,
        and a label that is seen again later is a new identity.
    """

    min_track_length: PositiveCount = 5
    output_delay: Count = 0
    max_coast: NonNegative = 0.05
    coast_by_evidence: bool = True
    bridge_gaps: bool = True
    history: NonNegative = HISTORY

    def start(self) -> LabelledState:
        """Nothing seen."""
        return LabelledState()

    def extend(
        self,
        state: LabelledState,
        estimates: Estimates,
        z: F8,
        detections: Detections,
        number: int,
        dt: float,
        model: Model,
    ) -> tuple[LabelledState, Tracks]:
        """The state with those of frame ``number`` and what they revise, and the online rows that
        are now due.

        The past of the estimates counts, too. Raises `InputError` if states have no label.
        """
        gap = list[Moment]()
        if state.recent and not state.recent[-1].observed:
            gap = unobserved_at_end(state.recent)
        if len(gap) >= MOST_UNOBSERVED and not detections.observed:
            return state, Tracks.empty()
        observed = state.recent[: len(state.recent) - len(gap)]
        timed, now = next_moment(
            observed[-1] if observed else None,
            gap,
            Moment(
                number,
                state.time + dt,
                0,
                _one_each(estimates),
                NO_LINKS,
                z,
                detections.row,
                detections.class_id,
                detections.confidence,
                model.warp,
                detections.observed,
                descriptors(detections),
                model.pace,
            ),
        )
        recent = [*observed, *timed]
        settled = 0
        if now.observed:
            settled = _revise(recent, estimates.past)
        else:
            known = np.isin(now.estimates.tag, state.table["label"])
            now = replace(now, estimates=now.estimates.select(known))
        recent.append(now)
        interval = dt if now.observed and self.coast_by_evidence else 0.0
        flat = _flat(recent)
        table, present, followed = self._counted(state, recent, flat, settled, interval, model)
        history = state.history
        for moment in recent[:settled]:
            history = history.append(moment)
        returns = state.returns
        if now.observed and model.appearance is not None:
            returns, change = self._returned(returns, estimates, now, present, model.appearance)
            if change:
                table = _renamed(table, change)
                present = _renamed(present, change)
        time = now.time if now.observed else state.time
        extended = LabelledState(
            history, tuple(recent[settled:]), table, time, state.used, followed, returns
        )
        due = len(extended) - 1 - self.output_delay
        if due < 0:
            return extended, Tracks.empty()
        open_labels = flat[0][sum(len(moment.estimates.tag) for moment in recent[:settled]) :]
        return self._emit(extended, due, present, open_labels, model)

    def _counted(
        self,
        state: LabelledState,
        moments: Sequence[Moment],
        flat: tuple[I8, I8, F8],
        settled: int,
        dt: float,
        model: Model,
    ) -> tuple[Records, Records, Followed]:
        """The table with the states of the first ``settled`` moments counted, and with those of
        all; and the tracks that may be missing after the newest one, with its verdicts. After an
        interval of 0 these are as they were.

        Every label of the moments, which are ``flat`` as of `_flat`, gets a row.
        """
        now = moments[-1]
        before = state.followed
        interval = dt / model.rate
        if dt and len(model.warp) and len(before.label):
            x, y, w, h = to_cxcywh(before.xyxy)
            x, y, _, _, w, h = warp_states(np.stack([x, y, 0 * x, 0 * y, w, h]), model.warp)
            before = before._replace(xyxy=to_xyxy(np.stack([x, y, w, h])))
        table, present, followed = counted_frame(
            state.table,
            flat,
            settled,
            tuple(before),
            now.estimates.xyxy,
            self.min_track_length,
            (
                model.rate,
                now.time / model.rate,
                interval,
                max(PATIENCE, PATIENT_FRAMES * interval),
                1 - 1 / REMEMBERED,
            ),
            dt > 0,
        )
        return table, present, Followed(*followed)

    def _returned(
        self,
        returns: Returns,
        estimates: Estimates,
        now: Moment,
        present: Records,
        looks: Looks,
    ) -> tuple[Returns, dict[int, int]]:
        """`reidentified` with the newest frame."""
        label, identity = (present[name].copy() for name in ("label", "identity"))
        names = Names(label, identity)
        here = now.estimates
        rows, sure = detected_rows(
            present, here.tag, here.detection, now.row, self.min_track_length
        )
        return reidentified(returns, estimates, rows, now.number, looks, sure, names)

    def flush(self, state: LabelledState, model: Model) -> Tracks:
        """The online rows of the last ``output_delay`` frames."""
        parts = []
        for due in range(max(0, len(state) - self.output_delay), len(state)):
            flat = _flat(state.recent)
            _, present, _ = self._counted(state, state.recent, flat, 0, 0.0, model)
            state, tracks = self._emit(state, due, present, flat[0], model)
            parts.append(tracks)
        return Tracks.concatenate(parts)

    def finish(self, state: LabelledState, model: Model) -> Tracks:
        """The corrected tracks, identities from 1 in order of appearance, from first to last
        detection.
        """
        moments = [*iter(state.history), *state.recent]
        if not moments:
            return Tracks.empty()
        seen = np.flatnonzero(np.concatenate([m.estimates.detection for m in moments]) >= 0)
        label = np.concatenate([m.estimates.tag for m in moments])[seen]
        _, first, which, count = np.unique(
            label, return_index=True, return_inverse=True, return_counts=True
        )
        # One track after the other, by their first states.
        order = np.argsort(first[which], kind="stable")
        order = order[count[which[order]] >= self.min_track_length]
        name = 1 + np.cumsum(np.diff(which[order], prepend=which[order[:1]]) != 0)
        return Tracks.concatenate(rows_of(moments, seen[order], name, self.bridge_gaps, model))

    def measurements(self, state: LabelledState) -> MeasurementHistory:
        """The measurements of everything that is remembered."""
        return measurements(itertools.chain(state.history, state.recent))

    def returns(self, state: LabelledState) -> tuple[Return, ...]:
        """The identities that were given back."""
        return state.returns.pairs

    def exchanges(self, state: LabelledState) -> tuple[Exchange, ...]:
        """The identities that targets have exchanged."""
        return state.returns.exchanges

    def appeared(self, state: LabelledState, seen: Appeared) -> Appeared:
        """The same: labels are the filter's."""
        return seen

    def oldest(self, state: LabelledState) -> int:
        """The number of the first frame that is remembered."""
        first = next(itertools.chain(state.history, state.recent), None)
        return first.number if first else 0

    def numbered_after(self, state: LabelledState, identity: int) -> LabelledState:
        """The state that numbers new tracks from ``identity`` + 1 on."""
        return replace(state, used=identity)

    def _emit(
        self, state: LabelledState, due: int, present: Records, open_labels: I8, model: Model
    ) -> tuple[LabelledState, Tracks]:
        """The state with the identities of the frame at place ``due`` and without what is
        forgotten, and the frame's rows as it is seen now. ``open_labels``: of the recent frames.
        """
        newest = state.recent[-1]
        moment = newest if due == len(state) - 1 else state[due]
        e = moment.estimates
        here = moment.time if moment.observed else state.seen_until(due)
        until = newest.time if newest.observed else state.seen_until(len(state) - 1)
        history, since, kept_labels = self._remembered(state, (due, moment), open_labels, model)
        chance = _NONE
        if type(model.sensor) is not BoxSensor and np.count_nonzero(e.detection < 0):
            chance = on_target(model, e.state, e.covariance)
        table, used, columns = due_rows(
            (state.table, present),
            (e.tag, e.detection, e.xyxy, e.weight),
            (e.state, e.covariance, chance),
            moment.row,
            state.followed.verdicts,
            (
                here,
                until,
                self.max_coast * model.rate + 1e-9,
                model.rate,
            ),
            (PRIOR, SHARE, SHOWN),
            (self.min_track_length, moment.number, state.used),
            (self.bridge_gaps, self.coast_by_evidence, moment.observed),
            (since, kept_labels),
        )
        after = LabelledState(
            history, state.recent, table, state.time, used, state.followed, state.returns
        )
        frame, names, boxes, weight, detection, sure = columns
        one_class = np.zeros(len(frame), np.int64)
        return after, Tracks(frame, names, boxes, weight, detection, sure, one_class)

    def _remembered(
        self, state: LabelledState, due: tuple[int, Moment], open_labels: I8, model: Model
    ) -> tuple[History, float, I8]:
        """The settled frames without those that are forgotten, the time since when labels are
        remembered, and the labels that are in any case.

        Rows that are still due, from the place and the frame ``due`` on, stay. A label of a frame
        that may still be revised has a record: these are the ``open_labels``.
        """
        if self.history == 0:
            return state.history, -np.inf, _NO_LABELS
        place, moment = due
        since = min(state.time - self.history * model.rate, moment.time)
        settled = len(state.history)
        if place < settled:
            waiting = [state[k].estimates.tag for k in range(place, settled)]
            open_labels = np.concatenate([*waiting, open_labels])
        return state.history.since(since), since, open_labels


def _flat(moments: Sequence[Moment]) -> tuple[I8, I8, F8]:
    """The labels and measurements (n,) of the states of all m moments, one moment after the other;
    and their times and then their numbers of states (2m,).
    """
    states = [moment.estimates for moment in moments]
    tags = [each.tag for each in states]
    numbers = [moment.time for moment in moments]
    numbers += [len(tag) for tag in tags]
    return (
        np.concatenate(tags),
        np.concatenate([each.detection for each in states]),
        np.array(numbers, np.float64),
    )


def _renamed(table: Records, change: dict[int, int]) -> Records:
    """The table with these identities, by label, of those of the labels that have a record."""
    label = np.array(sorted(change))
    identity = np.array([change[each] for each in sorted(change)])
    place = np.minimum(table["label"].searchsorted(label), len(table) - 1)
    there = table["label"][place] == label
    renamed = table.copy()
    renamed["identity"][place[there]] = identity[there]
    return renamed


def _revise(recent: list[Moment], past: tuple[Estimates | None, ...]) -> int:
    """Write what a filter's past revises into the recent moments, the last of which it reaches.

    Returns how many moments it reaches no more.
    """
    observed = [k for k, moment in enumerate(recent) if moment.observed]
    beyond = len(observed) - len(past)
    settled = observed[beyond - 1] + 1 if beyond > 0 else 0
    reached = observed[max(beyond, 0) :]
    for k, revised in zip(reached, past[len(past) - len(reached) :], strict=True):
        if revised is not None:
            recent[k] = recent[k].with_estimates(_one_each(revised))
    return settled


def _one_each(e: Estimates) -> Estimates:
    """The states without their past and looks; of those that share a label the heaviest."""
    if len(e.tag) != len(e):
        raise InputError(
            f"{len(e)} states bring no labels to identify them by",
            where="associate.kind=labelled",
            cure="Use associate.kind=graph, or a filter that labels targets",
        )
    single = e
    if e.past or len(e.followed):
        single = Estimates(e.state, e.covariance, e.weight, e.xyxy, e.detection, e.tag)
    # Counted, as `all` takes several times as long.
    if np.count_nonzero(e.tag[1:] > e.tag[:-1]) + 1 >= len(e.tag):
        return single
    heaviest = np.argsort(-e.weight, kind="stable")
    _, first = np.unique(e.tag[heaviest], return_index=True)
    if len(first) == len(e):
        return single
    return single.select(np.sort(heaviest[first]))
