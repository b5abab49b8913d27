"""States of Bernoulli targets: the best hypothesis of each, and the past as it tells it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.bernoullis import Bernoullis, Layer
from phdtrack.checks import Share, check
from phdtrack.extract.resolution import resolved
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Estimates


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """Who is told of in a frame: labels, hypotheses and the greatest presence from that frame on (n,), by label."""

    label: I8
    place: I8
    presence: F8

    def earlier(self, layer: Layer, before: Layer) -> _Told:
        """The same a frame before ``layer``: those that were there."""
        place = layer.parent[self.place]
        there = place >= 0
        place = place[there]
        presence = np.maximum(self.presence[there], before.presence[before.target[place]])
        return _Told(self.label[there], place, presence)

    def joined(self, layer: Layer, place: I8) -> _Told:
        """With those that ended in this layer."""
        if len(place) == 0:
            return self
        target = layer.target[place]
        label = np.concatenate([self.label, layer.label[target]])
        order = np.argsort(label, kind="stable")
        places, presences = np.concatenate([self.place, place]), np.concatenate([self.presence, layer.presence[target]])
        return _Told(label[order], places[order], presences[order])

    def reported(self, least: float) -> _Told:
        """Those of enough presence."""
        enough = self.presence >= least
        return _Told(self.label[enough], self.place[enough], self.presence[enough])


@dataclass(frozen=True, slots=True)
class BestBernoullis:
    """Settings of the extraction from Bernoulli targets.

    Parameters
    ----------
    lightest : targets that are there with less probability are not reported. A target that was measured again later was
        there.
    overlap : of targets whose boxes overlap by more (IoU) the one that has been followed for longer is reported; 1: all.
    """

    lightest: Share = 0.5
    overlap: Share = 0.5

    def __post_init__(self) -> None:
        check(self)

    def extract(self, state: Bernoullis, z: F8, model: Model) -> Estimates:
        """The best hypothesis of each target, by label; their weight is the probability that the target is there.

        `Estimates.past` are the same targets, and those that have ended since, in the frames before; None for frames of
        which nothing is told otherwise than a frame ago.
        """
        layers = state.layers
        told, known = _best(layers[-1]), _best(layers[-2]) if len(layers) > 1 else None
        found = self._estimates(layers[-1], told, model)
        frames: list[Estimates | None] = []
        for back in range(1, len(layers)):
            layer, before = layers[-back], layers[-back - 1]
            told = told.earlier(layer, before)
            told = told.joined(before, state.ended[1, state.ended[0] == back])
            if known is not None and back > 1:
                known = known.earlier(layer, before)
                known = known.joined(before, state.ended[1, state.ended[0] == back])
            if known is not None and _same(told, known, before, self.lightest):
                known = None
                frames.append(None)
                break
            frames.append(self._estimates(before, told, model))
        frames += [None] * (len(layers) - 1 - len(frames))
        return replace(found, past=tuple(frames[::-1]))

    def _estimates(self, layer: Layer, told: _Told, model: Model) -> Estimates:
        """Those of enough presence, but for those in each other's places."""
        told = told.reported(self.lightest)
        mean = np.ascontiguousarray(layer.mean[:, told.place])
        boxes = model.sensor.boxes(mean)
        found = Estimates(mean, layer.covariance[told.place], told.presence, boxes, layer.detection[told.place], told.label)
        # Labels rise with the frame in which a target began.
        kept = resolved(boxes, self.overlap)
        return found if len(kept) == len(boxes) else found.take(kept)


def _best(layer: Layer) -> _Told:
    """The targets that may be reported."""
    there = np.flatnonzero(layer.best >= 0)
    return _Told(layer.label[there], layer.best[there], layer.presence[there])


def _same(a: _Told, b: _Told, layer: Layer, least: float) -> bool:
    """Whether the same is told of the same targets, in this layer and, since they then share their pasts, in all before."""
    (one, shown), (other, known) = (_tellable(told, layer, least) for told in (a, b))
    if len(one.label) != len(other.label) or (shown != known).any():
        return False
    return bool((one.place == other.place).all() and (one.label == other.label).all())


def _tellable(told: _Told, layer: Layer, least: float) -> tuple[_Told, Bool]:
    """Those who are reported in this layer or may be in one before it, and who of them are in this."""
    some = (told.presence >= least) | (layer.believed[layer.target[told.place]] >= least)
    return _Told(told.label[some], told.place[some], told.presence[some]), told.presence[some] >= least
