"""States of the most probable hypothesis, and the past as it tells it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.checks import Share, check
from phdtrack.filters.extract.resolution import resolved
from phdtrack.filters.hypotheses import Hypotheses, before
from phdtrack.protocols import Model
from phdtrack.types import F8, Estimates


@dataclass(frozen=True, slots=True)
class BestHypothesis:
    """Settings of the extraction from hypotheses.

    Parameters
    ----------
    min_weight : targets that are there with less probability, if the hypothesis is true, are not reported. A target that was
        measured again later was there.
    merge_iou : of targets whose boxes overlap by more (IoU) the one that has been followed for longer is reported; 1: all.
    """

    min_weight: Share = 0.5
    merge_iou: Share = 0.4

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Hypotheses, z: F8, model: Model) -> Estimates:
        """The targets of each cluster's best hypothesis, by label; their weight is the probability that they are there.

        `Estimates.past` are the same targets, and those that have ended since, in the frames before.
        """
        at = state.best()
        weight, frames = np.zeros(len(at)), []
        for nodes in reversed(state.layers):
            known = np.flatnonzero(at >= 0)
            weight[known] = np.maximum(weight[known], nodes.exist[at[known]])
            told = known[weight[known] >= self.min_weight]
            here = nodes.take(at[told])
            boxes = model.sensor.boxes(here.mean)
            found = Estimates(here.mean, here.covariance, weight[told], boxes, here.detection, here.label)
            # Labels rise with the frame in which a track began.
            frames.append(found.take(resolved(boxes, self.merge_iou)))
            at = before(nodes, at)
        return replace(frames[0], past=tuple(frames[:0:-1]))
