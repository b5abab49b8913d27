"""Merged measurements: one detection for each of the targets that a background detector reports as
one blob.

Small groups of blobs and expected targets that touch are explained together. An explanation gives
each target one blob or none; its log-likelihood is the sum over

    missed target     1 − r (p_D + (1 − p_D) c)      r: probability that it exists; c: share of it
    that a blob covers blob of one       r p_D N(z; h(x), R + H P Hᵀ) blob of k         ∏ r p_D ·
    ρ^(k−1) · N(edges of the blob; the targets' outermost edges) blob of none      κ(z)

with ρ the probability that targets that touch are reported as one blob. In the best explanation
every target of a merged blob gets a detection of its expected size where the blob's edges put it.
The blob's edge on each side is that of the target that is expected to lie outermost there. In the
sensor's noise, with the centre's deviation half the size's, the edges of one box are independent.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from phdtrack.errors import Checked, NonNegative, Probability
from phdtrack.kernels.merged import MAX_EXISTENCE, Lives, Rule, continued, explained
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Detections, Estimates, Explanation


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedTargets:
    """Targets that the last frames showed, before or after a frame.

    Attributes
    ----------
    state : (d, n).      covariance : (n, d, d).
    existence : (n,) probability r that each is there.
    hidden : (n,) seconds for which neither its left nor its right edge was visible in a merged
        blob.
    separate : (n,) seconds for which each had a blob to itself.
    """

    state: F8
    covariance: F8
    existence: F8
    hidden: F8
    separate: F8

    def __len__(self) -> int:
        return len(self.existence)

    def lives(self, model: Model) -> Lives:
        """What the kernels are told of them, but where they are."""
        return Lives(self.existence, model.sensor.p_detect(self.state), self.hidden, self.separate)

    def select(self, index: I8 | Bool) -> ExpectedTargets:
        """The targets at ``index`` (integers or a mask)."""
        others = (self.covariance, self.existence, self.hidden, self.separate)
        return ExpectedTargets(
            np.ascontiguousarray(self.state[:, index]), *(part[index] for part in others)
        )

    def joined(self, other: ExpectedTargets) -> ExpectedTargets:
        """The targets of both."""
        if not len(self) or not len(other):
            return self if len(self) else other
        pairs = [(getattr(self, field.name), getattr(other, field.name)) for field in fields(self)]
        return ExpectedTargets(np.hstack(pairs[0]), *(np.concatenate(pair) for pair in pairs[1:]))


@dataclass(frozen=True, slots=True)
class MergedMeasurements(Checked):
    """The merged-measurement model, for boxes in the image.

    Parameters
    ----------
    merge_probability : ρ, probability that targets that touch are reported as one blob; 0: blobs
        are never divided.
    min_separate_time : seconds for which a target must have had a blob to itself before it may
        share one.
    max_hidden_time : seconds for which a target may stay hidden in a merged blob, between the edges
        of others.
    """

    merge_probability: Probability = 0.5
    min_separate_time: NonNegative = 0.4
    max_hidden_time: NonNegative = 3.0

    def start(self) -> ExpectedTargets:
        """No targets are expected."""
        return ExpectedTargets(
            np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0), np.zeros(0), np.zeros(0)
        )

    def explain(
        self, state: ExpectedTargets, detections: Detections, model: Model, dt: float
    ) -> tuple[ExpectedTargets, Explanation]:
        """The targets expected in this frame, and the detections that the filter gets for them."""
        targets = _predicted(state, model, dt)
        if not (detections.observed and len(targets) and len(detections)):
            return targets, Explanation.unchanged(detections)
        sensor = model.sensor
        x = targets.state
        seconds = dt / model.rate
        boxes = sensor.boxes(x)
        z = sensor.measure(detections)
        known = np.isfinite(z).all(axis=0)
        clutter = np.ones(len(detections))
        clutter[known] = model.clutter.intensity(np.ascontiguousarray(z[:, known]))
        noise = (
            np.ascontiguousarray(sensor.target_noise(x)),
            np.ascontiguousarray(sensor.measurement_noise(z)),
        )
        rule = Rule(self.merge_probability, self.min_separate_time, self.max_hidden_time)
        blobs = np.ascontiguousarray(detections.xyxy)
        lives = targets.lives(model)
        xyxy, source, part, target, hidden, separate = explained(
            blobs,
            known,
            clutter,
            boxes,
            targets.covariance,
            sensor.observed,
            noise,
            lives,
            rule,
            seconds,
        )
        targets = ExpectedTargets(x, targets.covariance, targets.existence, hidden, separate)
        if len(source) == len(detections):
            return targets, Explanation(detections, source, part, target)
        return targets, Explanation(
            replace(detections.select(source), xyxy=xyxy), source, part, target, changed=True
        )

    def advance(
        self,
        state: ExpectedTargets,
        explanation: Explanation,
        estimates: Estimates,
        model: Model,
        dt: float,
    ) -> ExpectedTargets:
        """The targets after the frame: the estimates, and expected targets that these do not show
        but that may be there.

        A target that was missed stays with probability r ← r (1 − p_D)/(1 − r p_D).
        """
        if not explanation.detections.observed:
            return state
        x = np.ascontiguousarray(estimates.state)
        covariance = estimates.covariance
        k = len(estimates)
        weight = np.minimum(estimates.weight, MAX_EXISTENCE)
        if not len(state):
            return ExpectedTargets(x, covariance, weight, np.zeros(k), np.zeros(k))
        found = (explanation.target, estimates.detection, x)
        noise = model.sensor.noise(state.state)
        hidden, separate, there, unseen, left = continued(
            found,
            state.state,
            state.covariance,
            noise,
            state.lives(model),
            self.max_hidden_time,
            dt / model.rate,
        )
        now = ExpectedTargets(x, covariance, weight, hidden, separate)
        if not left.any():
            return now
        return now.joined(
            ExpectedTargets(state.state, state.covariance, there, unseen, state.separate).select(
                left
            )
        )


def _predicted(targets: ExpectedTargets, model: Model, dt: float) -> ExpectedTargets:
    """The targets ``dt`` time units later."""
    if not len(targets):
        return targets
    state, before = model.warp_gaussians(targets.state, targets.covariance)
    mean, jacobian, noise = model.motion.transition(np.ascontiguousarray(state), dt)
    covariance = np.ascontiguousarray(jacobian @ before @ jacobian.transpose(0, 2, 1) + noise)
    there = targets.existence * model.motion.p_survive(targets.state, dt / model.rate)
    return ExpectedTargets(
        np.ascontiguousarray(mean), covariance, there, targets.hidden, targets.separate
    )
