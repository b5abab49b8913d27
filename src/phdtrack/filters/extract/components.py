"""Peaks of a Gaussian mixture: its heavy components [V06 Table III, E13 §4].

The filter has merged what lies together, so a component is a target, or several that no measurement has parted yet: one of
weight 2.3 stands for two. Vo and Ma report it twice; two states in one place are of no use to a tracker, which is why it is
reported once unless ``repeat`` says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import Positive, Share, check
from phdtrack.filters.extract import clusters
from phdtrack.filters.extract.counted import LIGHTEST_COMPONENT, heaviest
from phdtrack.filters.extract.resolution import joined
from phdtrack.filters.intensities import Cardinalised
from phdtrack.protocols import Model
from phdtrack.types import F8, Estimates, GaussianMixture


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
        """The means of the components heavy enough to be targets [V06 Table III], and their tags [P09 §III]."""
        if isinstance(state, GaussianMixture):
            return self._peaks(state, self.min_weight, z, model)
        if not self.counted:
            return self._peaks(state.intensity, self.min_weight, z, model)
        return heaviest(self._peaks(state.intensity, LIGHTEST_COMPONENT, z, model), state.cardinality)

    def _peaks(self, state: GaussianMixture, lightest: float, z: F8, model: Model) -> Estimates:
        """The components of at least this weight."""
        heavy = np.flatnonzero(state.weight >= lightest)
        if self.repeat:
            times = np.maximum(np.rint(state.weight[heavy]).astype(np.int64), 1)
            weight = np.repeat(state.weight[heavy] / times, times)
            heavy = np.repeat(heavy, times)
            mean, cov = np.ascontiguousarray(state.mean[:, heavy]), state.covariance[heavy]
        else:
            weight, mean, cov, part = joined(
                state.weight[heavy], np.ascontiguousarray(state.mean[:, heavy]), state.covariance[heavy],
                model.sensor, self.merge_iou,
            )  # fmt: skip
            heavy = heavy[part]
        found = clusters.finish(weight, mean, cov, z, model)
        # A mixture that no filter has touched has no tags.
        return replace(found, tag=state.tag[heavy]) if len(state.tag) else found
