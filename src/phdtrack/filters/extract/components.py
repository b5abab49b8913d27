"""States from what is no cloud of particles: the components of a mixture, samples of a joint state, detections.

Where the filter has merged what lies together, a component is a target, or several that no measurement has parted yet: one
of weight 2.3 stands for two [V06 Table III, E13 §4]. Vo and Ma report it twice; two states in one place are of no use to a
tracker, which is why it is reported once unless ``repeat`` says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import Positive, Share, check
from phdtrack.filters.extract.peaks import LIGHTEST_COMPONENT, finish, heaviest, join_unresolved, kept
from phdtrack.filters.intensities import Cardinalised, JointSamples, parts
from phdtrack.kernels.mixtures import Gaussians
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Estimates, GaussianMixture, Particles


@dataclass(frozen=True, slots=True)
class Components:
    """Settings of the extraction from a mixture.

    Parameters
    ----------
    min_weight : components of less weight are not targets; Vo and Ma's 0.5.
    repeat : report a component as often as its weight says, rounded, as Vo and Ma do. Joining is off then.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    counted : of a cardinalised filter, report as many states as its number of targets says; of others it changes nothing.
    """

    min_weight: Positive = 0.5
    repeat: bool = False
    merge_iou: Share = 0.4
    counted: bool = True

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: GaussianMixture | Cardinalised[GaussianMixture], z: F8, model: Model) -> Estimates:
        """The means of the components heavy enough to be targets [V06 Table III], and their tags [P09 §III].

        Parameters
        ----------
        state : the intensity.
        z : (m, N) measurements of the frame.
        model : of the world.

        Returns
        -------
        states : in the order of the components.
        """
        intensity, number = parts(state, counted=self.counted)
        if number is None:
            return self._peaks(intensity, self.min_weight, z, model)
        return heaviest(self._peaks(intensity, LIGHTEST_COMPONENT, z, model), number)

    def _peaks(self, state: GaussianMixture, lightest: float, z: F8, model: Model) -> Estimates:
        """The components of at least this weight."""
        heavy = np.flatnonzero(state.weight >= lightest)
        if self.repeat:
            heavy = np.repeat(heavy, np.maximum(np.rint(state.weight[heavy]).astype(np.int64), 1))
        peaks = kept(Gaussians(state.weight, state.mean, state.covariance), heavy)
        if self.repeat:
            peaks = peaks._replace(weight=peaks.weight / np.bincount(heavy)[heavy])
        else:
            peaks, part = join_unresolved(peaks, model.sensor, self.merge_iou)
            heavy = heavy[part]
        found = finish(peaks, z, model)
        # A mixture that no filter has touched has no tags.
        return replace(found, tag=state.tag[heavy]) if len(state.tag) else found


@dataclass(frozen=True, slots=True)
class Joint:
    """Settings of the extraction from joint samples: which targets are there in most of them, and where on average [K05].

    Parameters
    ----------
    min_weight : targets that are there with less probability are not reported.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice; 1 for never.
    """

    min_weight: Positive = 0.5
    merge_iou: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: JointSamples, z: F8, model: Model) -> Estimates:
        """Mean and covariance of the samples of every target that is there, with its label [K05].

        Parameters
        ----------
        state : samples of the joint state.
        z : (m, N) measurements of the frame.
        model : of the world.

        Returns
        -------
        states : in the order of the labels.
        """
        there = np.flatnonzero(state.existence >= self.min_weight)
        peaks, part = join_unresolved(_moments(state, there), model.sensor, self.merge_iou)
        return replace(finish(peaks, z, model), tag=state.label[there[part]])


def _moments(state: JointSamples, targets: I8) -> Gaussians:
    """Probabilities, means and covariances of the targets."""
    n, count = state.chance.shape
    x = state.state.reshape(len(state.state), n, count)[:, targets]
    share = state.chance[targets] / state.chance[targets].sum(axis=1, keepdims=True)
    mean = np.ascontiguousarray((x * share).sum(axis=2))
    apart = (x - mean[:, :, None]) * np.sqrt(share)
    return Gaussians(state.existence[targets], mean, np.einsum("ikn,jkn->kij", apart, apart))


@dataclass(frozen=True, slots=True)
class Raw:
    """One state per detection, with the covariance of what one detection shows: for ``--filter none``."""

    def extract(self, state: Particles, z: F8, model: Model) -> Estimates:
        """The detections as states at rest."""
        x, cov = model.sensor.states(z)
        return Estimates(x, cov, np.ones(len(cov)), model.sensor.boxes(x), np.arange(len(cov)))
