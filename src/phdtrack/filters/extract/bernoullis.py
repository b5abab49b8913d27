"""States of Bernoulli targets: the best hypothesis of each, and the past as it tells it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.checks import Share, check
from phdtrack.filters.bernoullis import Bernoullis, Layer
from phdtrack.filters.extract.resolution import resolved
from phdtrack.kernels.pmb_past import earlier, reported
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Estimates


@dataclass(frozen=True, slots=True)
class BestBernoullis:
    """Settings of the extraction from Bernoulli targets.

    Parameters
    ----------
    min_weight : targets that are there with less probability are not reported. A target that was measured again later was
        there.
    merge_iou : of targets whose boxes overlap by more (IoU) the one that has been followed for longer is reported; 1: all.
    """

    min_weight: Share = 0.5
    merge_iou: Share = 0.5

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Bernoullis, z: F8, model: Model) -> Estimates:
        """The best hypothesis of each target, by label; their weight is the probability that the target is there.

        `Estimates.past` are the same targets, and those that have ended since, in the frames before; None for frames of
        which nothing is told otherwise than a frame ago.
        """
        layers, ended = state.layers, np.ascontiguousarray(state.ended)
        now = layers[-1]
        place, presence = now.best, now.presence
        found = self._estimates(now, place, presence, model)
        known, before = (layers[-2].best, layers[-2].presence) if len(layers) > 1 else (place, presence)
        frames: list[Estimates | None] = [None] * (len(layers) - 1)
        for back in range(1, len(layers)):
            layer, then = layers[-back], layers[-back - 1]
            place, presence, known, before, same = earlier(
                place, presence, known, before, layer.parent, then.first, then.presence, then.believed, ended, back,
                self.min_weight,
            )  # fmt: skip
            if same:
                break
            frames[-back] = self._estimates(then, place, presence, model)
        return replace(found, past=tuple(frames))

    def _estimates(self, layer: Layer, place: I8, presence: F8, model: Model) -> Estimates:
        """Those of enough presence, but for those in each other's places."""
        mean, covariance, weight, detection, label = reported(
            place, presence, self.min_weight, np.ascontiguousarray(layer.mean), np.ascontiguousarray(layer.covariance),
            layer.detection, layer.label,
        )  # fmt: skip
        boxes = model.sensor.boxes(mean)
        found = Estimates(mean, covariance, weight, boxes, detection, label)
        # Labels rise with the frame in which a target began.
        kept = resolved(boxes, self.merge_iou)
        return found if len(kept) == len(boxes) else found.take(kept)
