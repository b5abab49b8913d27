"""The Poisson multi-Bernoulli filter with hypotheses about each target: labels and existence inside the recursion [W15].

Targets that have never been detected are a Poisson process, whose intensity is the model's γ. Every first detection starts
a Bernoulli target: it is there with probability r, under its label, in a state that a few hypotheses describe, each with a
Kalman filter and a past of its own. With κ, p_S and q_i(z) = N(z; H m_i, S_i) as in `gm_phd`, and p_i the probability that
hypothesis i of a target is detected,

    predict   r ← p_S r,  m_i ← f(m_i),  P_i ← F P_i Fᵀ + Q
    missed    1 − r Σ w_i p_i;  given that, there with r Σ w_i (1 − p_i) / (1 − r Σ w_i p_i)
    taken     r w_i p_i q_i(z)                    by hypothesis i
    nobody's  κ(z) + γ̂(z),  γ̂ = ∫ p_D g(z|x) γ(x) dx:  a new target of r = γ̂/(κ + γ̂)

The probability of each pair over all ways to give every target one measurement at most, and every measurement one target,
is found by loopy belief propagation (`kernels.marginals`). Then r is the probability of all hypotheses of the target that
are left, and they are weighed by theirs: the product of Bernoulli densities that is nearest to the posterior [W15],
but that the hypotheses of a target are kept apart, each with its past, instead of their mean. So who cannot be told apart
for some frames is not blurred, and what happened is read from the hypothesis that wins.

Two things are known of detectors that a constant p_D does not say, and both are hidden states of a hypothesis.

A target is **hidden** for a while, behind another or for the detector's own reasons: misses come in rows. In view it is
detected with the sensor's p_D, hidden never; it gets hidden and comes into view at rates 1/``mean_visible_time`` and
1/``mean_occluded_time``, a Markov chain in continuous time that starts in view at a first detection.

A **source** of false alarms fires again and again in one place. It is no target that moves: a first detection is a source's
with probability ``static_clutter_prior``, it stays where it is, which is never known for sure, and fires with probability
``static_clutter_detection_probability``. Who moves, or is seen more steadily than that, is soon known to be a target.
Sources compete for measurements like targets do and are never reported.

This file is the definition, for any model that keeps the protocols; for the shipped box model `PMB.step` is the same in one
kernel (`kernels.pmb_step`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile, sum_by
from phdtrack.checks import NonNegative, Positive, PositiveCount, Probability, Share, check
from phdtrack.errors import InputError
from phdtrack.filters.bernoullis import Bernoullis, Layer, nobody
from phdtrack.filters.composed import composed_step
from phdtrack.filters.gm_box import box_model
from phdtrack.filters.pmb.fused import fused_step, settings_of
from phdtrack.filters.pmb.update import Terms, measured, merged
from phdtrack.filters.transforms import Transform, moved
from phdtrack.kernels.pmb_rows import SURE
from phdtrack.kernels.pmb_update import BELIEVED
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, GaussianMixture, Particles, UpdateInfo


@dataclass(frozen=True, slots=True)
class PMB:
    """Settings of the Poisson multi-Bernoulli filter.

    Parameters
    ----------
    existence_threshold : targets that exist with less probability are deleted, unless that probability has just risen: a
        detection that no existing target explains better may start a target, however rare births are.
    hypothesis_threshold : hypotheses of a target that are less probable are dropped.
    max_hypotheses : hypotheses kept of a target, the most probable.
    merge_distance : hypotheses of a target within so many deviations of a heavier one, all in all, are taken for it.
    gate_probability : part of the measurements of a hypothesis inside its gate; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    mean_visible_time : seconds for which, on average, a target can be detected at a stretch; 0: for ever.
    mean_occluded_time : seconds for which, on average, it then cannot.
    static_clutter_prior : probability that the first detection of what is no single false alarm is that of a static source.
    static_clutter_detection_probability : probability that a source is detected in a frame.
    history : frames for which the hypotheses of the past are kept: so far back the past is revised.
    initial : targets before the first frame; a weight is the probability that there is one.
    """

    existence_threshold: Share = 1e-3
    hypothesis_threshold: Share = 0.01
    max_hypotheses: PositiveCount = 10
    merge_distance: NonNegative = 0.1
    gate_probability: Share = GATE
    transform: Transform = "linear"
    mean_visible_time: NonNegative = 2.0
    mean_occluded_time: Positive = 0.4
    static_clutter_prior: Probability = 0.05
    static_clutter_detection_probability: Probability = 0.5
    history: PositiveCount = 10
    initial: GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)

    def start(self, model: Model, rng: np.random.Generator) -> Bernoullis:
        """The initial targets, each with one hypothesis; none where none were given."""
        none = np.zeros((2, 0), np.int64)
        if self.initial is None:
            return Bernoullis((nobody(model.motion.dim),), none, 0)
        given = self.initial
        n = len(given)
        exist, label, unseen = np.minimum(given.weight, 1.0), np.arange(n), np.full(n, -1)
        layer = Layer(
            exist, label, np.arange(n + 1), np.ones(n), np.array(given.mean, order="C"), np.array(given.covariance),
            np.zeros(n, np.bool_), np.zeros(n), unseen, unseen, label, exist, exist,
        )  # fmt: skip
        return Bernoullis((layer,), none, n)

    def predict(self, state: Bernoullis, model: Model, dt: float, rng: np.random.Generator) -> Bernoullis:
        """A further layer: every hypothesis through f, there with p_S of its probability; sources stay where they are.

        Raises `InputError` where the motion spawns: spawned targets have no Gaussian form.
        """
        now = state.present
        mean, cov = model.carried_gaussians(now.mean, now.covariance)
        mean, cov = mean.copy(), cov.copy()
        survive = model.motion.p_survive(mean, dt / model.rate)
        moving = np.flatnonzero(~now.static)
        if len(moving):
            x = np.ascontiguousarray(mean[:, moving])
            if len(model.motion.spawn(Particles(x, now.weight[moving]), dt, rng)):
                raise InputError(
                    "the PMB filter has no spawning", where="motion.births", cure="Use NoSpawn, or the particle filter"
                )
            mean[:, moving], cov[moving] = moved(x, cov[moving], model.motion, dt, self.transform)
        _left_alone(mean, cov, np.flatnonzero(now.static), model.sensor)
        target = now.target
        stay = sum_by(target, now.weight * survive, len(now.exist))
        weight = np.where(stay[target] > 0, now.weight * survive / np.where(stay > 0, stay, 1.0)[target], now.weight)
        lost, found = self._turns(dt / model.rate)
        hidden = np.where(now.static, 0.0, now.hidden * (1 - found) + (1 - now.hidden) * lost)
        exist = now.exist * stay
        presence = exist * sum_by(target, np.where(now.static, 0.0, weight), len(exist))
        layer = replace(
            now, exist=exist, weight=weight, mean=mean, covariance=cov, hidden=hidden, detection=np.full(len(now), -1),
            parent=np.arange(len(now)), presence=presence,
        )  # fmt: skip
        return self._further(state, layer)

    def _gate(self, model: Model) -> float:
        """The gate in deviations of the innovation."""
        return math.sqrt(chi2_quantile(len(model.sensor.observed), self.gate_probability))

    def _further(self, state: Bernoullis, layer: Layer) -> Bernoullis:
        """With one more layer, and what is too far back forgotten."""
        ended = state.ended + np.array([[1], [0]])
        return Bernoullis((*state.layers[-self.history :], layer), ended[:, ended[0] <= self.history], state.fresh)

    def _turns(self, seconds: float) -> tuple[float, float]:
        """Probabilities to be hidden ``seconds`` after being in view, and in view after being hidden."""
        if self.mean_visible_time == 0:
            return 0.0, 1.0
        rate = 1 / self.mean_visible_time + 1 / self.mean_occluded_time
        turned = -math.expm1(-rate * seconds) / rate
        return turned / self.mean_visible_time, turned / self.mean_occluded_time

    def update(
        self, state: Bernoullis, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Bernoullis, UpdateInfo]:
        """Every target with the probabilities of what it may have taken, and new targets.

        In the information returned ``evidence`` and ``clutter`` are scaled so that `UpdateInfo.clutter_probability` is the
        probability that a detection is a false alarm, a source's included.
        """
        terms = Terms(
            self.existence_threshold,
            self.hypothesis_threshold,
            self.max_hypotheses,
            self._gate(model),
            self.transform,
            self.static_clutter_prior,
            self.static_clutter_detection_probability,
        )
        layer, info, fresh = measured(state.present, z, model, dt, terms, state.fresh)
        ended = np.hstack([state.ended, given_up(state.present, layer)])
        return Bernoullis((*state.layers[:-1], layer), ended, fresh), info

    def reduce(self, state: Bernoullis, rng: np.random.Generator) -> Bernoullis:
        """Hypotheses of one target that have become the same are one."""
        return Bernoullis((*state.layers[:-1], merged(state.present, self.merge_distance)), state.ended, state.fresh)

    def step(
        self, state: Bernoullis, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Bernoullis, UpdateInfo]:
        """Predict, update and reduce in turn; of the shipped box model in one kernel.

        The kernel leaves out covariances between the axes, and between size and place: what a turning camera mixes into
        them (the angle times the difference of the axes' variances), and what learned births have of them.
        """
        box = box_model(model, dt) if self.transform == "linear" else None
        if box is None:
            return composed_step(self, state, z, model, dt, rng)
        lost, found = self._turns(dt / model.rate)
        now = state.present
        if len(model.warp):
            mean, cov = model.carried_gaussians(now.mean, now.covariance)
            now = replace(now, mean=mean, covariance=cov)
        settings = settings_of(
            self.existence_threshold,
            self.hypothesis_threshold,
            self.max_hypotheses,
            self.merge_distance,
            self._gate(model),
            self.static_clutter_prior,
            self.static_clutter_detection_probability,
            self.history,
            lost,
            found,
        )
        return fused_step(state, now, z, box, settings, self._gate(model), self.history)


def _left_alone(mean: F8, cov: F8, static: I8, sensor: Sensor) -> None:
    """Predict the ``static`` hypotheses, in place: where a source fires is never known better than `SURE` allows.

    A target's place is not either, because it moves. Were a source's known better and better, whoever stands still would
    be explained by one better and better, however steadily he is detected.
    """
    if len(static):
        noise = sensor.noise(np.ascontiguousarray(mean[:, static]))
        for row in sensor.observed:
            cov[static, row, row] = np.maximum(cov[static, row, row], SURE * noise[row] ** 2)


def given_up(before: Layer, layer: Layer) -> I8:
    """(2, E) of targets somebody may have believed in that are there no more: one layer back, and where there."""
    gone = np.flatnonzero((before.believed >= BELIEVED) & (before.best >= 0))
    gone = gone[~np.isin(before.label[gone], layer.label)]
    return np.vstack([np.ones(len(gone), np.int64), before.best[gone]])
