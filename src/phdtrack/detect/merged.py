"""The merged-measurement model: divides one box of a background detector among several targets.

Boxes and predicted targets that touch are explained together in small groups. An explanation
assigns each target one box or none; its log-likelihood is the sum of the logarithms of

    missed target      1 − r (p_D + (1 − p_D) c)
    box of 1 target    r p_D N(z; h(x), R + H P Hᵀ)
    box of k targets   ∏ r p_D · ρ^(k−1) · N(edges of the box; the targets' outermost edges)
    box of no target   κ(z)

with r the target's probability of existence, c the share of it that a box covers, and ρ the
probability that touching targets are reported as one box. In the best explanation every target of a
merged box gets a detection of its predicted size, placed by the edges of the box. Each edge of the
box is the edge of the target that is predicted to lie outermost on that side. With the sensor's
noise, the centre's deviation being half of the size's, the edges of one box are independent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.errors import Checked, NonNegative, Probability
from phdtrack.kernels.merged import MAX_EXISTENCE, Lives, Rule, continued, explained
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Detections, DividedDetections, Estimates


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedTargets:
    """The targets of the last frames, before or after prediction.

    Attributes
    ----------
    state : (d, n).      covariance : (n, d, d).
    existence : (n,) probability r that each exists.
    hidden : (n,) seconds for which neither its left nor its right edge was visible in a merged box.
    separate : (n,) seconds for which each had a box of its own.
    """

    state: F8
    covariance: F8
    existence: F8
    hidden: F8
    separate: F8

    def __len__(self) -> int:
        return len(self.existence)

    def lives(self, model: Model) -> Lives:
        """The parameters of the targets that kernels need, except positions."""
        return Lives(self.existence, model.sensor.p_detect(self.state), self.hidden, self.separate)

    def select(self, index: I8 | Bool) -> ExpectedTargets:
        """The targets at ``index`` (integers or a mask)."""
        others = (self.covariance, self.existence, self.hidden, self.separate)
        return ExpectedTargets(
            np.ascontiguousarray(self.state[:, index]), *(part[index] for part in others)
        )

    def joined(self, other: ExpectedTargets) -> ExpectedTargets:
        """The targets of this and the other record."""
        if not len(self):
            return other
        if not len(other):
            return self
        return ExpectedTargets(
            np.hstack([self.state, other.state]),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.existence, other.existence]),
            np.concatenate([self.hidden, other.hidden]),
            np.concatenate([self.separate, other.separate]),
        )


@dataclass(frozen=True, slots=True)
class MergedMeasurements(Checked):
    """The merged-measurement model for boxes in the image.

    Parameters
    ----------
    merge_probability : ρ, probability that touching targets are reported as one box; 0: boxes are
        never divided.
    min_separate_time : seconds for which a target must have had a box of its own before it may
        share one.
    max_hidden_time : seconds for which a target may stay hidden in a merged box, between the edges
        of others.
    """

    merge_probability: Probability = 0.5
    min_separate_time: NonNegative = 0.4
    max_hidden_time: NonNegative = 3.0

    def start(self) -> ExpectedTargets:
        """The state before the first frame: no targets."""
        return ExpectedTargets(
            np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0), np.zeros(0), np.zeros(0)
        )

    def explain(
        self, state: ExpectedTargets, detections: Detections, z: F8, model: Model, dt: float
    ) -> tuple[ExpectedTargets, DividedDetections]:
        """Predict the targets, and divide merged detections among them for the filter."""
        targets = _predicted(state, model, dt)
        if not (detections.observed and len(targets) and len(detections)):
            return targets, DividedDetections.unchanged(detections)
        sensor = model.sensor
        x = targets.state
        known = np.isfinite(z).all(axis=0)
        clutter = np.ones(len(detections))
        clutter[known] = model.clutter.intensity(np.ascontiguousarray(z[:, known]))
        noise = (
            np.ascontiguousarray(sensor.target_noise(x)),
            np.ascontiguousarray(sensor.measurement_noise(z)),
        )
        rule = Rule(self.merge_probability, self.min_separate_time, self.max_hidden_time)
        xyxy, source, part, target, hidden, separate = explained(
            np.ascontiguousarray(detections.xyxy),
            known,
            clutter,
            sensor.boxes(x),
            targets.covariance,
            sensor.observed,
            noise,
            targets.lives(model),
            rule,
            dt / model.rate,
        )
        targets = ExpectedTargets(x, targets.covariance, targets.existence, hidden, separate)
        if len(source) == len(detections):
            return targets, DividedDetections(detections, source, part, target)
        parts = replace(detections.select(source), xyxy=xyxy)
        if parts.embeddings is not None:
            # A box that shows several targets looks like none of them.
            shared = np.bincount(source)[source] > 1
            parts = replace(parts, embeddings=parts.embeddings * ~shared[:, None])
        return targets, DividedDetections(parts, source, part, target, changed=True)

    def advance(
        self,
        state: ExpectedTargets,
        divided: DividedDetections,
        estimates: Estimates,
        model: Model,
        dt: float,
    ) -> ExpectedTargets:
        """The targets after the frame: the estimates, and missed targets that may still exist.

        A missed target keeps the probability r ← r (1 − p_D)/(1 − r p_D).
        """
        if not divided.detections.observed:
            return state
        x = np.ascontiguousarray(estimates.state)
        covariance = estimates.covariance
        k = len(estimates)
        weight = np.minimum(estimates.weight, MAX_EXISTENCE)
        if not len(state):
            return ExpectedTargets(x, covariance, weight, np.zeros(k), np.zeros(k))
        hidden, separate, missed_existence, missed_hidden, remains = continued(
            (divided.target, estimates.detection, x),
            state.state,
            state.covariance,
            model.sensor.noise(state.state),
            state.lives(model),
            self.max_hidden_time,
            dt / model.rate,
        )
        now = ExpectedTargets(x, covariance, weight, hidden, separate)
        if not remains.any():
            return now
        missed = ExpectedTargets(
            state.state, state.covariance, missed_existence, missed_hidden, state.separate
        )
        return now.joined(missed.select(remains))


def _predicted(targets: ExpectedTargets, model: Model, dt: float) -> ExpectedTargets:
    """Predict the targets ``dt`` time units ahead."""
    if not len(targets):
        return targets
    state, before = model.warp_gaussians(targets.state, targets.covariance)
    mean, jacobian, noise = model.motion.transition(np.ascontiguousarray(state), dt)
    covariance = np.ascontiguousarray(jacobian @ before @ jacobian.transpose(0, 2, 1) + noise)
    existence = targets.existence * model.motion.p_survive(targets.state, dt / model.rate)
    return ExpectedTargets(
        np.ascontiguousarray(mean), covariance, existence, targets.hidden, targets.separate
    )
