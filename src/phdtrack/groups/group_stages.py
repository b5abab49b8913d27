"""The groups of a sequence, frame by frame, from tracks, from a filter's intensity, or from known
positions.

`on_ground` follows the people of any tracks on the ground. `mixture_of` turns the state of a filter
into Gaussians, and `carriers` assigns a Gaussian to each track. `GroupStages.advance` processes one
frame as a pure function: clusters, identities, contours, events and warnings.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from phdtrack.filters.cardinality import Cardinalised
from phdtrack.filters.extract import FromParticles
from phdtrack.groups.clusters import Grouping, Groups, group_moments
from phdtrack.groups.contours import Contours
from phdtrack.groups.encounters import Encounter, EncounterWarning
from phdtrack.groups.life_cycle import Event, GroupLifeCycle, LifeCycleState
from phdtrack.groups.pairs import Pairs, PairState, Walkers
from phdtrack.protocols import AnyStages, Model
from phdtrack.smooth.paths import paths_of
from phdtrack.smooth.sequence import Sequence
from phdtrack.types import F8, I8, Detections, GaussianMixture, MeasurementHistory, Step, Tracks

# Head count from which a cluster without a track is a group: Vo and Ma's threshold for a target.
UNNAMED = 0.5
# Squared Mahalanobis radius of the 99 % region in two dimensions: the gate between tracks and
# Gaussians.
REACH = 9.21
# Smallest standard deviation of a cluster of particles, metres and metres per second: a few
# particles may coincide.
_MIN_DEVIATION = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class GroupFrame:
    """The groups of one frame.

    Attributes
    ----------
    number, time : of the frame, from 1, and in seconds.
    identity : (G,) of each group; 0 if no member has an identity yet.
    groups : their counts and positions, and in ``label`` the group of every Gaussian.
    contours : for each group its level curves, (2, K) metres.
    member, membership : (n,) the people with an identity and the group of each.
    events : the changes that became certain with this frame.
    warnings : the groups that are expected to meet.
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
    """The settings of all steps from people to groups, events and warnings."""

    grouping: Grouping | Pairs = field(default_factory=Pairs)
    contours: Contours = field(default_factory=Contours)
    life_cycle: GroupLifeCycle = field(default_factory=GroupLifeCycle)
    encounters: EncounterWarning = field(default_factory=EncounterWarning)

    def people(
        self, state: LifeCycleState, walkers: Walkers, label: I8, weight: F8, number: int
    ) -> tuple[LifeCycleState, GroupFrame]:
        """Process the people of a frame, who all have identities: the new state, and the groups.

        Parameters
        ----------
        state : after the previous frame.
        walkers : the people, in the order of their identities.
        label : (n,) the group of each according to `Pairs`.
        weight : (n,) existence probability of each.
        number : of the frame, from 1.
        """
        mixture = GaussianMixture(weight, walkers.mean, walkers.covariance)
        carrier = np.arange(len(label))
        return self._frame(state, mixture, label, walkers.identity, carrier, (number, walkers.time))

    def advance(
        self,
        state: LifeCycleState,
        mixture: GaussianMixture,
        member: I8,
        carrier: I8,
        number: int,
        time: float,
    ) -> tuple[LifeCycleState, GroupFrame]:
        """Process the intensity of a frame: the new state, and the groups [E13 §5]. Raises
        `TypeError` if groups are found from pairs.

        People with an identity are in the group that they accepted (`GroupLifeCycle`). A Gaussian
        without a track joins the heaviest person of its cluster. A cluster without any track is a
        group without identity, so that everybody is counted, if its weight is half a person or
        more: lighter ones are more likely false alarms.

        Parameters
        ----------
        state : after the previous frame.
        mixture : over (px, py, vx, vy).
        member, carrier : (n,) identities of people, and the Gaussian of each. People without one
            (−1), or with one that is too light, have no group in this frame.
        number, time : of the frame, from 1, and in seconds.
        """
        if not isinstance(self.grouping, Grouping):
            raise TypeError("groups of an intensity need groups.kind=intensity")
        label = self.grouping.groups(mixture).label
        grouped = np.append(label, -1)[carrier] >= 0
        return self._frame(state, mixture, label, member[grouped], carrier[grouped], (number, time))

    def _frame(
        self,
        state: LifeCycleState,
        mixture: GaussianMixture,
        cluster: I8,
        member: I8,
        carrier: I8,
        when: tuple[int, float],
    ) -> tuple[LifeCycleState, GroupFrame]:
        """Process a frame with these clusters (J,) of the Gaussians, −1 for none; the Gaussian of
        every member is in one.
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
        warnings = self.encounters.expected(np.append(identity, 0)[label], mixture)
        return state, GroupFrame(
            number, time, identity, groups, contours, member, membership, events, warnings
        )


def _groups(label: I8, weight: F8, carrier: I8, membership: I8) -> tuple[I8, I8]:
    """The group (J,) of each Gaussian, −1 if it is too light, and the identities (G,) of groups, 0
    for none.

    ``label`` (J,) are the clusters, ``carrier`` and ``membership`` (n,) the Gaussians of people and
    their groups.
    """
    identity = np.zeros(len(label), np.int64)
    # Backwards, so that the first of several people on one Gaussian is written last.
    identity[carrier[::-1]] = membership[::-1]
    leader: dict[int, int] = {}
    for j in np.argsort(-weight, kind="stable").tolist():
        if identity[j] > 0:
            leader.setdefault(int(label[j]), int(identity[j]))
    # A cluster without a track gets a negative number.
    trackless = np.flatnonzero((label >= 0) & (identity == 0))
    identity[trackless] = [
        leader.get(int(cluster), -1 - int(cluster)) for cluster in label[trackless]
    ]
    heavy = label >= 0
    heads = np.bincount(label[heavy], weight[heavy])
    heavy[heavy] = (identity[heavy] > 0) | (heads[label[heavy]] >= UNNAMED)
    names, group = np.unique(identity[heavy], return_inverse=True)
    out = np.full(len(label), -1, np.int64)
    out[heavy] = group
    return out, np.maximum(names, 0)


def on_ground(
    tracks: Tracks, measured: MeasurementHistory, model: Model
) -> tuple[list[Walkers], list[F8]]:
    """The people of each frame of ``measured``, in the order of their identities, and the
    confidence (n,) of each. Their tracks are smoothed on the ground, from the first detection to
    the last.

    Parameters
    ----------
    tracks : of any filter and model; ``detection`` is the detection that a row used.
    measured : the same detections as measurements on the ground, NaN for feet off the ground.
    model : of people on the ground.
    """
    column = measured.columns(tracks)
    detected = np.flatnonzero(tracks.detection >= 0)
    off_ground = detected[np.isnan(measured.z[:, column[detected]]).any(axis=0)]
    detection = tracks.detection.copy()
    detection[off_ground] = -1
    paths = paths_of(replace(tracks, detection=detection), measured)
    states = Sequence.of(measured, model).smooth(paths)
    # Rows in gaps are not among those of the tracks: they get the confidence of the row before.
    row = paths.row[np.maximum.accumulate(np.where(paths.row >= 0, np.arange(len(paths.row)), 0))]
    identity = tracks.identity[row]
    confidence = tracks.confidence[row]
    order = np.lexsort((identity, paths.frame))
    starts = np.searchsorted(paths.frame[order], np.arange(1, len(measured.number)))
    walkers = list[Walkers]()
    weights = list[F8]()
    for k, rows in enumerate(np.split(order, starts)):
        mean = np.ascontiguousarray(states.mean[rows, :4].T)
        covariance = states.covariance[rows][:, :4, :4]
        time = float(measured.time[k]) / model.rate
        walkers.append(Walkers(identity[rows], mean, covariance, time))
        weights.append(confidence[rows])
    return walkers, weights


def mixture_of(
    intensity: Any, step: Step, z: F8, stages: AnyStages, min_weight: float
) -> GaussianMixture:
    """The posterior after a step as Gaussians over (px, py, vx, vy).

    Filters of Gaussians have them. Particles are replaced by the clusters of the extraction,
    including those too light to be reported as people, down to ``min_weight``: otherwise one missed
    detection would remove a person from the group.

    Parameters
    ----------
    intensity : the filter's state.
    step : the result of the frame.
    z : (m, N) measurements.
    stages : of the run.
    min_weight : smallest weight of a cluster of particles.
    """
    if isinstance(intensity, Cardinalised):
        intensity = intensity.intensity
    if isinstance(intensity, GaussianMixture):
        return intensity
    estimates = step.estimates
    if isinstance(stages.extractor, FromParticles) and (min_weight < stages.extractor.min_weight):
        extractor = replace(stages.extractor, min_weight=min_weight)
        estimates = extractor.extract(intensity, z, stages.model)
    covariance = estimates.covariance + _MIN_DEVIATION**2 * np.eye(len(estimates.state))
    return GaussianMixture(estimates.weight, estimates.state, covariance)


def carriers(mixture: GaussianMixture, position: F8, min_weight: float) -> I8:
    """(M,) the Gaussian of each track: the nearest in Mahalanobis distance, −1 if none is within
    the gate.

    A row with a detection is close to the Gaussian that it comes from; a predicted row is close to
    the one that the filter still has for it.

    Parameters
    ----------
    mixture : Gaussians over (px, py, vx, vy).
    position : (2, M) of the tracks, metres; NaN if unknown.
    min_weight : lighter Gaussians belong to no track.
    """
    heavy = np.flatnonzero(mixture.weight >= min_weight)
    if len(heavy) == 0 or position.shape[1] == 0:
        return np.full(position.shape[1], -1, np.int64)
    offset = position[:, :, None] - mixture.mean[:2, None, heavy]
    inverse = np.linalg.inv(mixture.covariance[heavy][:, :2, :2])
    distance = np.nan_to_num(np.einsum("imj,jik,kmj->mj", offset, inverse, offset), nan=np.inf)
    nearest = distance.argmin(axis=1)
    near = distance[np.arange(len(nearest)), nearest] <= REACH
    return np.where(near, heavy[nearest], -1)


class OnlineGroups:
    """Groups from past and present frames, frame by frame; numbered from ``first``."""

    def __init__(self, groups: GroupStages, stages: AnyStages, first: int = 1) -> None:
        self._groups = groups
        self._stages = stages
        self._min_weight = 0.0
        if isinstance(groups.grouping, Grouping):
            self._min_weight = groups.grouping.min_weight
        self._pairs = PairState()
        self._life = LifeCycleState(following=first)

    def mixture(self, intensity: Any, step: Step) -> GaussianMixture:
        """The people after a step as Gaussians."""
        z = self._stages.model.sensor.measure(step.detections)
        z = np.ascontiguousarray(z[:, np.isfinite(z).all(axis=0)])
        return mixture_of(intensity, step, z, self._stages, self._min_weight)

    def events(
        self, mixture: GaussianMixture, rows: Tracks, number: int, time: float
    ) -> tuple[Event, ...]:
        """The events that became certain in a frame.

        Parameters
        ----------
        mixture : the result of `mixture`.
        rows : the confirmed rows of the frame.
        number, time : of the frame, from 1, and in seconds.
        """
        rows = rows.select(np.argsort(rows.identity, kind="stable"))
        position = self._stages.model.sensor.measure(Detections.of(rows.xyxy))[:2]
        carrier = carriers(mixture, position, self._min_weight)
        if isinstance(self._groups.grouping, Pairs):
            rows = rows.select(carrier >= 0)
            carrier = carrier[carrier >= 0]
            covariance = mixture.covariance[carrier, :4, :4]
            walkers = Walkers(
                rows.identity, np.ascontiguousarray(mixture.mean[:4, carrier]), covariance, time
            )
            self._pairs, label = self._groups.grouping.extend(self._pairs, walkers)
            self._life, frame = self._groups.people(
                self._life, walkers, label, rows.confidence, number
            )
        else:
            self._life, frame = self._groups.advance(
                self._life, mixture, rows.identity, carrier, number, time
            )
        return frame.events
