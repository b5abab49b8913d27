"""The groups of a sequence, frame by frame, from tracks, from a filter's intensity, or from known
positions.

`on_ground` follows the people of any tracks on the ground. `mixture_of` makes Gaussians of what a
filter knows of a frame, `carriers` says which Gaussian belongs to which track.
`GroupStages.advance` is one frame as a pure function: clusters, identities, contours, events and
warnings.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from phdtrack.filters.cardinality import Cardinalised
from phdtrack.filters.extract import KMeans, Mixture
from phdtrack.groups.clusters import Contours, Grouping, Groups, group_moments
from phdtrack.groups.life_cycle import (
    Encounter,
    EncounterWarning,
    Event,
    GroupLifeCycle,
    LifeCycleState,
)
from phdtrack.groups.pairs import Pairs, PairState, Walkers
from phdtrack.protocols import AnyStages, Model
from phdtrack.smooth.paths import paths_of
from phdtrack.smooth.smoothing import Sequence
from phdtrack.types import F8, I8, Detections, GaussianMixture, MeasurementHistory, Step, Tracks

# Heads from which on a cluster without a track is a group: Vo and Ma's weight of a target.
UNNAMED = 0.5
# Squared Mahalanobis radius of the 99 % region in two dimensions: within it a Gaussian belongs to a
# track.
REACH = 9.21
# Metres, and metres per second: no cluster of particles is known better, few of them may lie in one
# place.
_FINEST = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class GroupFrame:
    """The groups of one frame.

    Attributes
    ----------
    identity : (G,) of each group; 0 where no member has an identity yet. ``groups`` has their
        counts and places, and in ``label`` the group of every Gaussian.
    contours : for each group its level curves, (2, K) metres.
    member, membership : (n,) the people with an identity and the group of each.
    events, warnings : what became certain with this frame, and which groups are expected to meet.
    """

    number: int
    time: float
    identity: I8
    groups: Groups
    contours: tuple[tuple[F8, ...], ...]
    member: I8
    membership: I8
    events: tuple[Event, ...]
    warnings: tuple[Encounter, ...]

    def __len__(self) -> int:
        return len(self.identity)

    @property
    def people(self) -> float:
        """Expected number of people in all groups."""
        return float(self.groups.count.sum())

    @property
    def deviation(self) -> float:
        """Standard deviation of that number."""
        return float(np.sqrt((self.groups.deviation**2).sum()))

    @property
    def named(self) -> int:
        """Number of groups with an identity."""
        return int(np.count_nonzero(self.identity))


@dataclass(frozen=True, slots=True)
class GroupStages:
    """The settings of everything that is done with groups."""

    grouping: Grouping | Pairs = field(default_factory=Pairs)
    contours: Contours = field(default_factory=Contours)
    life_cycle: GroupLifeCycle = field(default_factory=GroupLifeCycle)
    encounters: EncounterWarning = field(default_factory=EncounterWarning)

    def people(
        self, state: LifeCycleState, walkers: Walkers, label: I8, weight: F8, number: int
    ) -> tuple[LifeCycleState, GroupFrame]:
        """The state with the people of a frame, who all have identities, and the groups.

        Parameters
        ----------
        state : after the frame before.
        walkers : who is there, in the order of their identities.
        label : (n,) the group of each, as `Pairs` finds it.
        weight : (n,) probability that each is there.
        number : of the frame, from 1.
        """
        mixture = GaussianMixture(weight, walkers.mean, walkers.covariance)
        return self._frame(
            state, mixture, label, walkers.identity, np.arange(len(label)), (number, walkers.time)
        )

    def advance(
        self,
        state: LifeCycleState,
        mixture: GaussianMixture,
        member: I8,
        carrier: I8,
        number: int,
        time: float,
    ) -> tuple[LifeCycleState, GroupFrame]:
        """The state with the intensity of a frame, and its groups [E13 §5]. Raises `TypeError`
        where pairs find the groups.

        People with an identity are in the group that they have accepted (`GroupLifeCycle`). A
        Gaussian without a track goes with the heaviest person of its cluster. A cluster without any
        track is a group without identity, so that no head is lost, from half a head on: what weighs
        less there is rather a false alarm.

        Parameters
        ----------
        state : after the frame before.
        mixture : over (px, py, vx, vy).
        member, carrier : (n,) identities of people, and the Gaussian of each. People without one
            (−1), or with one that is too light to count, have no group in this frame.
        number, time : of the frame, from 1, and in seconds.
        """
        if not isinstance(self.grouping, Grouping):
            raise TypeError("groups of an intensity need groups.kind=intensity")
        label = self.grouping.groups(mixture).label
        counted = np.append(label, -1)[carrier] >= 0
        return self._frame(state, mixture, label, member[counted], carrier[counted], (number, time))

    def _frame(
        self,
        state: LifeCycleState,
        mixture: GaussianMixture,
        cluster: I8,
        member: I8,
        carrier: I8,
        when: tuple[int, float],
    ) -> tuple[LifeCycleState, GroupFrame]:
        """A frame whose Gaussians are in these clusters (J,), −1 for none; every member's Gaussian
        is in one.
        """
        number, time = when
        state, membership, events = self.life_cycle.extend(
            state, member, cluster[carrier], mixture.weight[carrier], number, time
        )
        label, identity = _groups(cluster, mixture.weight, carrier, membership)
        groups = group_moments(mixture, label)
        contours = tuple(
            self.contours.of(mixture, label == group) for group in range(len(identity))
        )
        warned = self.encounters.expected(np.append(identity, 0)[label], mixture)
        return state, GroupFrame(
            number, time, identity, groups, contours, member, membership, events, warned
        )


def _groups(label: I8, weight: F8, carrier: I8, membership: I8) -> tuple[I8, I8]:
    """The group (J,) of each Gaussian, −1 where it is too light, and the identities (G,), 0 for a
    group without.

    ``label`` (J,) are the clusters, ``carrier`` and ``membership`` (n,) the Gaussians of people and
    their groups.
    """
    identity = np.zeros(len(label), np.int64)
    # Written from the last to the first: of several people on one Gaussian the first counts.
    identity[carrier[::-1]] = membership[::-1]
    leader: dict[int, int] = {}
    for j in np.argsort(-weight, kind="stable").tolist():
        if identity[j] > 0:
            leader.setdefault(int(label[j]), int(identity[j]))
    orphans = np.flatnonzero((label >= 0) & (identity == 0))
    identity[orphans] = [leader.get(int(cluster), -1 - int(cluster)) for cluster in label[orphans]]
    heavy = label >= 0
    heads = np.bincount(label[heavy], weight[heavy])
    heavy[heavy] = (identity[heavy] > 0) | (heads[label[heavy]] >= UNNAMED)
    names, group = np.unique(identity[heavy], return_inverse=True)
    out = np.full(len(label), -1, np.int64)
    out[heavy] = group
    return out, np.maximum(names, 0)


def on_ground(
    tracks: Tracks, seen: MeasurementHistory, model: Model
) -> tuple[list[Walkers], list[F8]]:
    """The people of each frame of ``seen``, in the order of their identities, and the confidence of
    each: where those of tracks stand, smoothed on the ground from their first detection to their
    last.

    Parameters
    ----------
    tracks : of any filter in any world; ``detection`` says which detection a row rests on.
    seen : the same detections as the ground's sensor measures them, NaN where a foot stands on no
        ground.
    model : of people on the ground.
    """
    place = np.searchsorted(seen.number, tracks.frame)
    column = seen.start[place] + tracks.detection
    rests = np.flatnonzero(tracks.detection >= 0)
    nowhere = rests[np.isnan(seen.z[:, column[rests]]).any(axis=0)]
    detection = tracks.detection.copy()
    detection[nowhere] = -1
    paths = paths_of(replace(tracks, detection=detection), seen)
    states = Sequence.of(seen, model).smooth(paths)
    # Rows of gaps come from no row of the tracks: they are as sure as the one before.
    row = paths.row[np.maximum.accumulate(np.where(paths.row >= 0, np.arange(len(paths.row)), 0))]
    identity = tracks.identity[row]
    sure = tracks.confidence[row]
    order = np.lexsort((identity, paths.frame))
    walkers = list[Walkers]()
    weights = list[F8]()
    for k, here in enumerate(
        np.split(order, np.searchsorted(paths.frame[order], np.arange(1, len(seen.number))))
    ):
        mean = np.ascontiguousarray(states.mean[here, :4].T)
        covariance = states.covariance[here][:, :4, :4]
        walkers.append(Walkers(identity[here], mean, covariance, float(seen.time[k]) / model.rate))
        weights.append(sure[here])
    return walkers, weights


def mixture_of(
    intensity: Any, step: Step, z: F8, stages: AnyStages, lightest: float
) -> GaussianMixture:
    """What is known after a step as Gaussians over (px, py, vx, vy).

    A filter of Gaussians has them. Of particles the clusters of the extraction are taken, here also
    those that are too light to be reported as people, down to ``lightest``: else one miss would
    drop a person from the group.

    Parameters
    ----------
    intensity : the filter's state.
    step : what the frame brought.
    z : (m, N) measurements.
    stages : of the run.
    lightest : smallest weight of a cluster of particles.
    """
    if isinstance(intensity, Cardinalised):
        points = intensity.intensity
    else:
        points = intensity
    if isinstance(points, GaussianMixture):
        return points
    found = step.estimates
    if isinstance(stages.extractor, KMeans | Mixture) and lightest < stages.extractor.min_weight:
        found = replace(stages.extractor, min_weight=lightest).extract(points, z, stages.model)
    return GaussianMixture(
        found.weight, found.state, found.covariance + _FINEST**2 * np.eye(len(found.state))
    )


def carriers(mixture: GaussianMixture, place: F8, lightest: float) -> I8:
    """(M,) the Gaussian of each track: the nearest by its own covariance, −1 where none is near
    enough.

    A corrected row lies near the Gaussian that it rests on; a row that was only predicted finds the
    one that the filter still has for it.

    Parameters
    ----------
    mixture : Gaussians over (px, py, vx, vy).
    place : (2, M) of the tracks, metres; NaN where unknown.
    lightest : lighter Gaussians belong to no track.
    """
    heavy = np.flatnonzero(mixture.weight >= lightest)
    if len(heavy) == 0 or place.shape[1] == 0:
        return np.full(place.shape[1], -1, np.int64)
    off = place[:, :, None] - mixture.mean[:2, None, heavy]
    inverse = np.linalg.inv(mixture.covariance[heavy][:, :2, :2])
    distance = np.nan_to_num(np.einsum("imj,jik,kmj->mj", off, inverse, off), nan=np.inf)
    nearest = distance.argmin(axis=1)
    near = distance[np.arange(len(nearest)), nearest] <= REACH
    return np.where(near, heavy[nearest], -1)


class OnlineGroups:
    """Groups by what was seen so far, frame by frame; numbered from ``first``."""

    def __init__(self, groups: GroupStages, stages: AnyStages, first: int = 1) -> None:
        self._groups = groups
        self._stages = stages
        if isinstance(groups.grouping, Pairs):
            self._light = 0.0
        else:
            self._light = groups.grouping.min_weight
        self._pairs = PairState()
        self._life = LifeCycleState(following=first)

    def mixture(self, intensity: Any, step: Step) -> GaussianMixture:
        """What is known of people after a step."""
        z = self._stages.model.sensor.measure(step.detections)
        return mixture_of(
            intensity,
            step,
            np.ascontiguousarray(z[:, np.isfinite(z).all(axis=0)]),
            self._stages,
            self._light,
        )

    def events(
        self, mixture: GaussianMixture, rows: Tracks, number: int, time: float
    ) -> tuple[Event, ...]:
        """What happened to groups in a frame.

        Parameters
        ----------
        mixture : from `mixture`.
        rows : confirmed ones of the frame.
        number, time : of the frame, and in seconds.
        """
        rows = rows.select(np.argsort(rows.identity, kind="stable"))
        carrier = carriers(
            mixture, self._stages.model.sensor.measure(Detections.of(rows.xyxy))[:2], self._light
        )
        if isinstance(self._groups.grouping, Pairs):
            rows = rows.select(carrier >= 0)
            carrier = carrier[carrier >= 0]
            covariance = mixture.covariance[carrier, :4, :4]
            walkers = Walkers(
                rows.identity, np.ascontiguousarray(mixture.mean[:4, carrier]), covariance, time
            )
            self._pairs, label = self._groups.grouping.extend(self._pairs, walkers)
            self._life, found = self._groups.people(
                self._life, walkers, label, rows.confidence, number
            )
        else:
            self._life, found = self._groups.advance(
                self._life, mixture, rows.identity, carrier, number, time
            )
        return tuple(found.events)
