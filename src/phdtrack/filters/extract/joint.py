"""States of labelled targets from samples of their joint state: who is there in most of them, and where on average [K05]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import Positive, Share, check
from phdtrack.filters.extract import clusters
from phdtrack.filters.extract.resolution import joined
from phdtrack.filters.intensities import JointSamples
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Estimates


@dataclass(frozen=True, slots=True)
class Joint:
    """Settings of the extraction from joint samples.

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
        """Mean and covariance of the samples of every target that is there, with its label [K05]."""
        weight = state.existence
        there = np.flatnonzero(weight >= self.min_weight)
        mean, cov = _moments(state, there)
        weight, mean, cov, part = joined(weight[there], mean, cov, model.sensor, self.merge_iou)
        found = clusters.finish(weight, mean, cov, z, model)
        return replace(found, tag=state.label[there[part]])


def _moments(state: JointSamples, targets: I8) -> tuple[F8, F8]:
    """(d, k) means and (k, d, d) covariances of the targets."""
    n, count = state.chance.shape
    x = state.state.reshape(len(state.state), n, count)[:, targets]
    share = state.chance[targets] / state.chance[targets].sum(axis=1, keepdims=True)
    mean = np.ascontiguousarray((x * share).sum(axis=2))
    apart = (x - mean[:, :, None]) * np.sqrt(share)
    return mean, np.einsum("ikn,jkn->kij", apart, apart)
