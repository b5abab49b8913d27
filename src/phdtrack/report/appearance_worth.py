"""The worth of appearance in a run: how alike objects look to themselves and to each other, and
what this told of detections.

Pairs are taken as lessons are (`models.appearance`): of targets whose detections motion alone
leaves no doubt of, all the time between.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from phdtrack.kernels.appearance import LEAST_LENGTH, UNKNOWN, Law, plain, typical_ratios
from phdtrack.types import F4, F8, I8, Appeared, Bool, Return

# Similarities are counted in so many bins from −1 to 1.
BINS = 100
# Seconds between the two detections of a pair, and how many pairs of one object are enough to show
# those that are so far apart.
SPANS = (0.2, 0.5, 2.0)
ENOUGH = 50
# Seconds between two frames that are looked at, and the part of a box that must be free for a pair.
PAUSE = 0.2
LEAST_FREE = 0.5
# Pairs, and the weight of the law, below which nothing was learned; and the share of pairs that are
# told apart below which all objects look alike.
FEWEST = 10
LIGHTEST = 0.05
ALIKE = 0.6


class Returned(NamedTuple):
    """An identity that was given back, for readers.

    Attributes
    ----------
    identity : of the online rows.
    last_frame, frame : of the last detection before, and the first one after.
    odds : that it is the same object, against another one.
    seconds : between the two frames; NaN if they are not known any more.
    """

    identity: int
    last_frame: int
    frame: int
    odds: float
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class AppearanceWorth:
    """The worth of appearance in a run.

    Attributes
    ----------
    same, other : (B,) numbers of pairs of detections of one object, and of two, by similarity, from
        −1 to 1.
    apart : seconds between the detections of pairs of one object, their mean; NaN without.
    taken, refused : the mean log-likelihood ratio of the detections that targets took, and of those
        beside them that they did not take, nats; NaN without.
    taken_count, refused_count : how many detections that is.
    law : what similarity said in the end.
    unused : True if the filter follows targets and does not know what they look like.
    returns : identities that were given back, oldest first.
    source : ``colours``, or what else describes the boxes.
    exchanged : pairs of objects that exchanged their identities.
    """

    same: I8
    other: I8
    apart: float
    taken: float
    refused: float
    taken_count: int
    refused_count: int
    law: Law
    unused: bool
    returns: tuple[Returned, ...] = ()
    source: str = "colours"
    exchanged: int = 0

    @property
    def told_apart(self) -> float:
        """The share of pairs of a detection of an object and one of another in which its own looks
        more like what the object looked like before; NaN without pairs.
        """
        total = int(self.same.sum()) * int(self.other.sum())
        if not total:
            return math.nan
        below = np.cumsum(self.other) - 0.5 * self.other
        return float((self.same * below).sum() / total)

    @property
    def back(self) -> int:
        """The number of objects that came back, each once."""
        return len({each.identity for each in self.returns})

    @property
    def about(self) -> float:
        """``apart``, to one digit."""
        return float(f"{self.apart:.1g}")

    @property
    def few(self) -> bool:
        """True if there were too few pairs to learn anything."""
        pairs = min(int(self.same.sum()), int(self.other.sum()))
        return pairs < FEWEST

    @property
    def alike(self) -> bool:
        """True if all objects look alike."""
        return not self.few and (self.told_apart < ALIKE or self.law.weight < LIGHTEST)

    @property
    def edges(self) -> F8:
        """(B + 1,) the bounds of the bins."""
        return np.linspace(-1.0, 1.0, BINS + 1)

    def curves(self, x: F8) -> tuple[F8, F8]:
        """The learned densities of the similarity of one object and of two, at ``x`` (n,)."""
        law = self.law
        fresh = max(math.log(max(self.apart, 0.1) / 0.1), 0.0)
        return (
            _gaussian(x, law.same + law.fading * fresh, law.same_deviation),
            _gaussian(x, law.other, law.other_deviation),
        )

    def as_dict(self) -> dict[str, object]:
        """The numbers for run.json."""
        return {
            "source": self.source,
            "pairs_of_one_object": int(self.same.sum()),
            "pairs_of_two_objects": int(self.other.sum()),
            "seconds_apart": self.apart,
            "told_apart": self.told_apart,
            "nats_of_taken_detections": self.taken,
            "taken_detections": self.taken_count,
            "nats_of_refused_neighbours": self.refused,
            "refused_neighbours": self.refused_count,
            "weight": self.law.weight,
        }


def _gaussian(x: F8, mean: float, deviation: float) -> F8:
    """The density of a Gaussian at ``x`` (n,)."""
    scale = deviation * math.sqrt(2 * math.pi)
    out: F8 = np.exp(-0.5 * ((x - mean) / deviation) ** 2) / scale
    return out


@dataclass(slots=True)
class _Watched:
    """The targets of one pipeline.

    Attributes
    ----------
    since : by label of a target without doubt, the seconds since when it is.
    early : seconds, labels and means of some earlier frames.
    before : labels, means, their numbers, and seconds at the last detection, of the frame before.
    weighed : seconds when detections were last weighed.
    """

    since: dict[int, float] = field(default_factory=dict)
    early: deque[tuple[float, I8, F4]] = field(default_factory=deque)
    before: tuple[I8, F4, F8, F8] | None = None
    weighed: float = -math.inf


class AppearanceRecorder:
    """Counts pairs of detections of a run by how alike they look."""

    def __init__(self) -> None:
        self._watched: list[_Watched] = []
        self._pairs = np.zeros((len(SPANS), 2, BINS), np.int64)
        self._apart = np.zeros((len(SPANS), 2))
        # Sum and number of log-likelihood ratios of taken and of refused detections.
        self._ratios = np.zeros((2, 2))
        self._law = UNKNOWN
        # Whether there were targets, and whether it was known what one looked like.
        self._targets = False
        self._used = False

    def see(self, appeared: Sequence[Appeared]) -> None:
        """Take in the next frame."""
        while len(self._watched) < len(appeared):
            self._watched.append(_Watched())
        for watched, one in zip(self._watched, appeared, strict=False):
            if one.looks.law.weight >= self._law.weight:
                self._law = one.looks.law
            self._targets = self._targets or len(one.estimates) > 0
            self._used = self._used or len(one.estimates.appearance_count) > 0
            self._compare(watched, one)
            self._weigh(watched, one)

    def worth(
        self, source: str, returns: Sequence[Return], numbers: I8, times: F8
    ) -> AppearanceWorth:
        """The worth of appearance so far.

        Parameters
        ----------
        source : what describes the boxes.
        returns : identities that were given back.
        numbers, times : (F,) the frames and their seconds.
        """
        enough = np.flatnonzero(self._pairs[:, 0].sum(axis=1) >= ENOUGH)
        span = int(enough.max(initial=0))
        taken, refused = self._ratios.tolist()
        return AppearanceWorth(
            self._pairs[span, 0],
            self._pairs[span, 1],
            _mean(*self._apart[span].tolist()),
            _mean(*taken),
            _mean(*refused),
            int(taken[1]),
            int(refused[1]),
            self._law,
            self._targets and not self._used,
            tuple(_returned(each, numbers, times) for each in returns),
            source,
        )

    def _compare(self, watched: _Watched, one: Appeared) -> None:
        """Count pairs of targets without doubt: of now, and of some time ago."""
        looks = one.looks
        sure = one.sure[one.sure[:, 1] >= 0]
        now = looks.time
        known = one.sure[:, 0].tolist()
        watched.since = {label: watched.since.get(label, now) for label in known}
        if watched.early and now < watched.early[-1][0] + PAUSE:
            return
        sure = sure[looks.free[sure[:, 1]] >= LEAST_FREE]
        for k, span in enumerate(SPANS):
            moment = next((each for each in reversed(watched.early) if each[0] <= now - span), None)
            if moment is not None and len(sure) and moment[2].shape[1] == looks.seen.shape[1]:
                self._count(k, watched, moment, sure, one)
        means = _of_targets(one, sure[:, 0])
        watched.early.append((now, *means))
        while len(watched.early) > 1 and watched.early[1][0] <= now - SPANS[-1]:
            watched.early.popleft()

    def _count(
        self,
        k: int,
        watched: _Watched,
        moment: tuple[float, I8, F4],
        sure: I8,
        one: Appeared,
    ) -> None:
        """Count the pairs of a span: of the targets ``sure`` (K, 2) with the means of a moment."""
        time, label, mean = moment
        whole = np.array([watched.since.get(each, math.inf) <= time for each in label.tolist()])
        label = label[whole] if len(label) else label
        if not len(label):
            return
        past = mean[whole] - one.looks.mean
        past /= np.maximum(np.linalg.norm(past, axis=1), LEAST_LENGTH)[:, None]
        alike = one.looks.seen[sure[:, 1]] @ past.T
        place = np.clip(((alike + 1) / 2 * BINS).astype(np.int64), 0, BINS - 1)
        same = sure[:, 0][:, None] == label
        self._pairs[k, 0] += np.bincount(place[same], minlength=BINS)
        self._pairs[k, 1] += np.bincount(place[~same], minlength=BINS)
        self._apart[k] += (same.sum() * (one.looks.time - time), same.sum())

    def _weigh(self, watched: _Watched, one: Appeared) -> None:
        """Sum up what appearance said of the detections that targets took, and of those beside."""
        looks = one.looks
        estimates = one.estimates
        before = watched.before
        size = looks.seen.shape[1]
        if not len(estimates.appearance_count):
            watched.before = None
            return
        seen = estimates.detection >= 0
        time = np.where(seen, looks.time, math.nan)
        if before is not None and before[1].shape[1] == size:
            place, known = _places(before[0], estimates.tag)
            time[known & ~seen] = before[3][place[known & ~seen]]
            due = looks.time >= watched.weighed + PAUSE
            if due and looks.law.weight > 0 and len(looks.free):
                watched.weighed = looks.time
                self._sum_up(one, before, np.flatnonzero(known), place)
        watched.before = (
            estimates.tag,
            estimates.appearance,
            np.where(np.isfinite(time), estimates.appearance_count, 0.0),
            time,
        )

    def _sum_up(self, one: Appeared, before: tuple[I8, F4, F8, F8], targets: I8, place: I8) -> None:
        """Add the log-likelihood ratios of the ``targets``, at ``place`` in the frame before."""
        estimates = one.estimates
        looks = one.looks
        boxes = estimates.xyxy[targets]
        own = estimates.detection[targets]
        centre = (boxes[:, :2] + boxes[:, 2:]) / 2
        # Boxes of detections are not known here: those of the targets that took them are.
        took = np.flatnonzero(estimates.detection >= 0)
        others = (estimates.xyxy[took, :2] + estimates.xyxy[took, 2:]) / 2
        far = np.linalg.norm(centre[:, None] - others, axis=2)
        near = far < (boxes[:, 3] - boxes[:, 1])[:, None]
        a, b = np.nonzero(near & (estimates.detection[took] != own[:, None]))
        mine = np.flatnonzero(own >= 0)
        row = np.concatenate([mine, a])
        column = np.concatenate([own[mine], estimates.detection[took][b]])
        kept = (looks.free[column] > 0) & (before[2][place[targets[row]]] > 0)
        past = before[1:]
        ratio = typical_ratios(past, place[targets[row]], column, plain(looks))
        first = np.arange(len(row)) < len(mine)
        for k, of_kind in enumerate((first & kept, ~first & kept)):
            self._ratios[k] += (ratio[of_kind].sum(), of_kind.sum())


def _places(known: I8, wanted: I8) -> tuple[I8, Bool]:
    """The places of the ``wanted`` (n,) labels in those ``known``, and which of them are there."""
    order = np.argsort(known, kind="stable")
    at = np.searchsorted(known[order], wanted)
    if not len(known):
        return np.zeros(len(wanted), np.int64), np.zeros(len(wanted), np.bool_)
    place = order[np.minimum(at, len(known) - 1)]
    return place, known[place] == wanted


def _of_targets(one: Appeared, label: I8) -> tuple[I8, F4]:
    """The targets among ``label`` of which it is known what they look like, and their means."""
    estimates = one.estimates
    if not len(estimates.appearance_count):
        return label[:0], np.zeros((0, one.looks.seen.shape[1]), np.float32)
    place, known = _places(estimates.tag, label)
    known[known] = estimates.appearance_count[place[known]] > 0
    return label[known], estimates.appearance[place[known]]


def _mean(total: float, count: float) -> float:
    """A mean; NaN of nothing."""
    return total / count if count else math.nan


def _returned(pair: Return, numbers: I8, times: F8) -> Returned:
    """A return for readers."""
    ends = np.array([pair.ended[0], pair.began[0]])
    seconds = math.nan
    if np.isin(ends, numbers).all():
        before, after = times[np.searchsorted(numbers, ends)].tolist()
        seconds = after - before
    return Returned(pair.identity, pair.ended[0], pair.began[0], pair.odds, seconds)
