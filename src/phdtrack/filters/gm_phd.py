"""The Gaussian-mixture PHD filter [V06, E13 §4].

With a linear Gaussian motion and sensor the intensity of `particle_phd` stays a mixture D(x) = Σ w_i N(x; m_i, P_i), and the
recursion is a Kalman filter for every Gaussian:

    predict   w_i ← p_S w_i,  m_i ← f(m_i),  P_i ← F P_i Fᵀ + Q
    update    D(x) = (1 − p_D) D⁺(x) + Σ_z Σ_i p_D w_i q_i(z) / (κ(z) + C(z)) N(x; m_i + K(z − H m_i), (I − K H) P_i)
              q_i(z) = N(z; H m_i, S_i),  S_i = H P_i Hᵀ + R,  K = P_i Hᵀ S_i⁻¹,  C(z) = Σ_i p_D w_i q_i(z)

Where f or h is not linear, `GMPHD.transform` says how Gaussians go through it (`filters.transforms`).

A mixture grows with every measurement; `GMPHD.reduce` prunes, merges and caps it. What depends on the state (p_D, p_S, F, Q
and the sensor's noise R) is taken at the means; H is a choice of rows, `Sensor.observed`.

Every Gaussian carries a tag, by which its history can be read [P09 §III]: a newborn's is new; prediction and update keep
it, so that the Gaussians that a measurement and a missed one make of one have the same; a union has that of its strongest.
Of those that share a tag and weigh `GMPHD.split_weight` or more after reduction the heaviest keeps it, and the others,
targets
of their own now, are given new ones. Lighter ones may share theirs with a target and take it over when it fades. Tags
count from 0 and none is given twice; `GaussianMixture.fresh` is the next.

This file is the definition, for any model that keeps the protocols. A measurement touches only the Gaussians in whose gate
it is, d² = (z − H m)ᵀ S⁻¹ (z − H m) ≤ G², found through a grid: the cost grows linearly with the number of targets. For the
shipped box model `GMPHD.step` is the same in one kernel (`kernels.gm_step`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile, region_radius2, sum_by
from phdtrack.checks import Count, NonNegative, Share, check
from phdtrack.errors import InputError
from phdtrack.filters.carrying import carried_mixture
from phdtrack.filters.composed import composed_step
from phdtrack.filters.gated import gated_gaussians
from phdtrack.filters.gm_box import box_model, fused_step, limits
from phdtrack.filters.meeting import Meeting, explained
from phdtrack.filters.transforms import Transform, moved, posteriors
from phdtrack.kernels.gm_reduce import reduced, triangles
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture, Particles, UpdateInfo


@dataclass(frozen=True, slots=True)
class GMPHD:
    """Settings of the GM-PHD filter; the defaults are E13's, without its cap.

    Parameters
    ----------
    weight_threshold : Gaussians that weigh less are dropped.
    merge_distance : Mahalanobis distance (not squared) up to which a Gaussian is united with a stronger one, in its own
        covariance.
    max_components : J_max, Gaussians kept, the heaviest; 0 for all, of which there are at most the mass divided by
        ``weight_threshold``. In
        practice there are some for each target, and for each false alarm as long as one that was not seen again takes to
        fade, log(weight / prune) / −log(1 − p_D) frames. E13's is 100.
    keep_mass : what pruning and capping drop is given to the rest, so that the expected number stays; False is as
        Vo and Ma print it.
    gate_probability : part of the measurements of a Gaussian inside its gate; those beyond do not touch it; 1: no gate.
    split_weight : what shares its tag with a heavier Gaussian keeps it below this weight, see above; 0: no two share one.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    skip_empty_frames : leave the intensity as predicted when a frame brings no detection, as D14 does.
    initial : the intensity before the first frame.
    """

    weight_threshold: NonNegative = 1e-5
    merge_distance: NonNegative = 2.0
    max_components: Count = 0
    keep_mass: bool = True
    split_weight: NonNegative = 0.5
    gate_probability: Share = GATE
    transform: Transform = "linear"
    skip_empty_frames: bool = False
    initial: GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)

    def _gate(self, model: Model) -> float:
        """G, the gate in deviations."""
        return math.sqrt(chi2_quantile(len(model.sensor.observed), self.gate_probability))

    def start(self, model: Model, rng: np.random.Generator) -> GaussianMixture:
        """The initial intensity, each Gaussian with a tag; empty where none was given."""
        given = self.initial
        if given is not None:
            # Arrays that lie otherwise in memory would have the kernels compiled once more.
            weight, mean, cov = (np.ascontiguousarray(part) for part in (given.weight, given.mean, given.covariance))
            return tagged(GaussianMixture(weight, mean, cov, np.ascontiguousarray(given.tag), given.fresh))
        d = model.motion.dim
        return GaussianMixture(np.zeros(0), np.zeros((d, 0)), np.zeros((0, d, d)))

    def predict(self, state: GaussianMixture, model: Model, dt: float, rng: np.random.Generator) -> GaussianMixture:
        """Every Gaussian through f, weighed with p_S [V06 (24)–(29)].

        Raises `InputError` where the motion spawns: spawned targets are drawn as particles and have no Gaussian form.
        """
        if len(state) == 0:
            return state
        state = tagged(carried_mixture(state, model))
        if len(model.motion.spawn(Particles(state.mean, state.weight), dt, rng)):
            raise InputError(
                "the GM-PHD filter has no spawning", where="motion.births", cure="Use NoSpawn, or the particle filter"
            )
        weight = state.weight * model.motion.p_survive(state.mean, dt / model.rate)
        alive = weight > 0
        before = np.ascontiguousarray(state.mean[:, alive])
        mean, cov = moved(before, state.covariance[alive], model.motion, dt, self.transform)
        return GaussianMixture(weight[alive], mean, cov, state.tag[alive], state.fresh)

    def update(
        self, state: GaussianMixture, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[GaussianMixture, UpdateInfo]:
        """Add the newborn, then update every Gaussian with every measurement within its gate [V06 (32)–(38)].

        The mass that explains a detection, which decides where targets are born, is that of the Gaussians within
        the 99 % region of it. Where κ(z) + C(z) = 0 the detection's term is 0 and counted in ``info.vanished``.
        """
        meeting = self.meet(state, z, model, dt)
        if z.shape[1] == 0 and self.skip_empty_frames:
            return meeting.intensity, meeting.info(meeting.intensity.mass)
        factor, vanished = explained(meeting.evidence, meeting.clutter)
        result = self.weighed(meeting, 1.0, factor, z, model)
        return result, meeting.info(result.mass, vanished)

    def meet(self, state: GaussianMixture, z: F8, model: Model, dt: float) -> Meeting[GaussianMixture]:
        """Add the newborn, and find what they and ``state`` say about the measurements."""
        sensor = model.sensor
        point, which, distance2, _ = gated_gaussians(state, z, sensor, self._gate(model), self.transform)
        near = distance2 <= region_radius2(len(sensor.observed))
        covered = sum_by(which[near], state.weight[point[near]], z.shape[1])
        born = model.birth.components(z, covered, sensor, dt / model.rate)
        everything = joined(state, born)
        point, which, distance2, log_norm = gated_gaussians(everything, z, sensor, self._gate(model), self.transform)
        seen = everything.weight * sensor.p_detect(everything.mean)
        share = seen[point] * np.exp(log_norm - 0.5 * distance2)
        evidence = sum_by(which, share, z.shape[1])
        missed = everything.weight - seen
        return Meeting(everything, born.mass, missed, point, which, share, evidence, model.clutter.intensity(z))

    def weighed(
        self, meeting: Meeting[GaussianMixture], missed: float, detected: F8, z: F8, model: Model
    ) -> GaussianMixture:
        """The updated mixture: missed terms weighed with ``missed``, those of each measurement with ``detected`` (N,)."""
        before, point, which = meeting.intensity, meeting.point, meeting.which
        mean, cov = posteriors(before, z, point, which, model.sensor, self.transform)
        weight = np.concatenate([missed * meeting.missed, meeting.share * detected[which]])
        mean, cov = np.hstack([before.mean, mean]), np.concatenate([before.covariance, cov])
        return GaussianMixture(weight, mean, cov, np.concatenate([before.tag, before.tag[point]]), before.fresh)

    def reduce(self, state: GaussianMixture, rng: np.random.Generator) -> GaussianMixture:
        """Prune, merge, cap: the strongest first, with all that are near it, moment-matched [V06 Table II, E13 §4].

        Tags as above [P09 §III].
        """
        state = tagged(state)
        axes, mass = tuple(range(len(state.mean))), state.mass if self.keep_mass else -1.0
        return GaussianMixture(
            *reduced(
                state.weight, np.ascontiguousarray(state.mean.T), triangles(state.covariance), state.tag, axes,
                float(self.weight_threshold), float(self.merge_distance), self.max_components, mass,
                float(self.split_weight), state.fresh,
            )
        )  # fmt: skip

    def step(
        self, state: GaussianMixture, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[GaussianMixture, UpdateInfo]:
        """Predict, update and reduce; in one kernel where the model is the shipped box model."""
        # Sigma points are for what is not linear; boxes are.
        box = box_model(model, dt) if self.transform == "linear" else None
        if box is None:
            return composed_step(self, state, z, model, dt, rng)
        settings = limits(
            self._gate(model),
            region_radius2(4),
            self.weight_threshold,
            self.merge_distance,
            self.max_components,
            self.keep_mass,
            self.split_weight,
            self.skip_empty_frames,
        )
        return fused_step(tagged(carried_mixture(state, model)), z, box, settings)


def tagged(mixture: GaussianMixture) -> GaussianMixture:
    """The mixture, with new tags where it has none."""
    if len(mixture.tag) == len(mixture):
        return mixture
    tag = mixture.fresh + np.arange(len(mixture))
    return GaussianMixture(mixture.weight, mixture.mean, mixture.covariance, tag, mixture.fresh + len(mixture))


def joined(state: GaussianMixture, born: GaussianMixture) -> GaussianMixture:
    """The sum of a filter's state and of newborn, who are given new tags in their order."""
    if len(born) == 0:
        return tagged(state)
    state = tagged(state)
    return GaussianMixture(
        np.concatenate([state.weight, born.weight]),
        np.hstack([state.mean, born.mean]),
        np.concatenate([state.covariance, born.covariance]),
        np.concatenate([state.tag, state.fresh + np.arange(len(born))]),
        state.fresh + len(born),
    )
