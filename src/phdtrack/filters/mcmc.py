"""The MCMC particle filter: Metropolis–Hastings over the joint state of all targets [K05].

Equations: docs/methods.md, MCMC. A Markov chain (`kernels.mcmc`) draws which targets exist, which
measurement each gave, and where each is, given what the frame before left and this scan. Unlike the
PHD filters this one knows its targets one by one: a label is one for a target's life.

* For a target of the frame before, p_t is what `predict` left: N weighted states, together e_t, the
  probability that it still exists. Targets come and go and move independently of each other until
  the scan couples them [K05].
* A newborn target is one that this scan shows: one at most at each measurement, p_t = γ(x) as drawn
  by the birth model. All samples that add it there give it the same label.

The law is discrete: every candidate has a table of states for each measurement that it may have
given and for none. So the moves of the reversible-jump form need no tuning: a step draws a free
option of a candidate by weight, and then a state from its table (add, delete, leave, come back,
update, reassign), or options of two candidates at once (exchange). This is the conditional law
except for the interaction, whose ratio is what is left of Hastings' [K05]: α = min(1, Π ψ' / Π ψ).
Adding and deleting need no Jacobian: each draws what the other drops. Of each kept sample a
target's state is kept, and its ``chance``, the probability that it exists given the rest of the
sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import chi2_quantile, draw, sum_by
from phdtrack.errors import (
    Checked,
    Count,
    InputError,
    NonNegative,
    Positive,
    PositiveCount,
    Share,
    check,
)
from phdtrack.filters.extract import finish, join_unresolved
from phdtrack.filters.phd_particle import ParticlePHD
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.kernels.mcmc import Chain, jump_chain, make_options, pair_likelihoods
from phdtrack.kernels.mixtures import Gaussians
from phdtrack.kernels.particle_models import kernel_for
from phdtrack.protocols import Filter, Model, Sensor
from phdtrack.types import (
    F8,
    I8,
    Estimates,
    GaussianMixture,
    Particles,
    UpdateInfo,
    false_alarm_share,
)

# The share of steps that move two candidates that compete for a measurement.
SWAP_PROBABILITY = 0.2
# The least density of clutter: where there is none, everything else that explains a measurement
# wins.
LEAST_CLUTTER = 1e-100
# The least weight of a target's absence: the chain passes through it.
SURELY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class JointSamples:
    """Samples of the joint state of labelled targets; sample s is the s-th state of every target.

    Attributes
    ----------
    state : (d, n·N) the N states of each of n targets, those of a target side by side.
    chance : (n, N) the probability that the target exists, given its state and the others' in that
        sample.
    label : (n,) int64 ascending, one for a target's life.
    fresh : the next new target's label, above all labels so far.
    """

    state: F8
    chance: F8
    label: I8
    fresh: int

    @classmethod
    def empty(cls, dim: int, samples: int) -> JointSamples:
        """No targets of dimension ``dim``."""
        return cls(np.zeros((dim, 0)), np.zeros((0, samples)), np.zeros(0, np.int64), 0)

    def __len__(self) -> int:
        return self.chance.size

    @property
    def weight(self) -> F8:
        """(n·N,) weights with which the states are the intensity."""
        return np.asarray(self.chance.ravel() / self.chance.shape[1])

    @property
    def existence(self) -> F8:
        """(n,) the probability that each target exists."""
        return np.asarray(self.chance.mean(axis=1))

    @property
    def mass(self) -> float:
        """The expected number of targets."""
        return float(self.existence.sum())


@dataclass(frozen=True, slots=True)
class MCMC(Filter[JointSamples]):
    """Settings of the MCMC particle filter.

    Parameters
    ----------
    samples : N, joint samples that are kept of a frame's chain.
    burn_in : B, sweeps before the first that is kept. A sweep has as many steps as there are
        candidates: targets of the last frame and measurements.
    thin : sweeps for each kept sample.
    interaction_strength : how much boxes that overlap keep apart; 0: not at all, which is faster.
        Where the detector fires twice on one person it keeps the two apart.
    min_weight : targets less probable than that are dropped.
    initial : targets before the first frame, one a Gaussian, its weight the probability that it
        exists.
    """

    samples: PositiveCount = 1000
    burn_in: Count = 50
    thin: PositiveCount = 1
    interaction_strength: NonNegative = 4.0
    min_weight: NonNegative = 1e-3
    initial: GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.initial is not None and self.initial.weight.max(initial=0) > 1:
            raise InputError(
                "expected probabilities for the weights of single targets, got"
                f" {self.initial.weight.max():g}",
                where="MCMC.initial",
                cure="Give one Gaussian a target",
            )

    def start(self, model: Model, rng: np.random.Generator) -> JointSamples:
        """The initial targets, N states each; none without an initial mixture."""
        if self.initial is None:
            return JointSamples.empty(model.motion.dim, self.samples)
        n = len(self.initial)
        state = draw(self.initial, self.samples, 1.0, rng).state
        chance = np.repeat(self.initial.weight[:, None], self.samples, axis=1)
        return JointSamples(state, chance, np.arange(n), n)

    def predict(
        self, state: JointSamples, model: Model, dt: float, rng: np.random.Generator
    ) -> JointSamples:
        """Every target of every sample moved by f, its probability to exist multiplied by p_S
        [K05], as of a PHD.
        """
        particles = Particles(state.state, state.chance.ravel(), np.array([0, len(state)]))
        moved = ParticlePHD().predict(particles, model, dt, rng).particles()
        return replace(state, state=moved.state, chance=moved.weight.reshape(state.chance.shape))

    def update(
        self, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[JointSamples, UpdateInfo]:
        """N samples of the posterior by the chain [K05]."""
        # Clutter κ(z), and births where no target covers a measurement
        old = len(state.label)
        kappa = model.clutter.intensity(z)
        against = np.maximum(kappa, LEAST_CLUTTER)
        near = member, which, distance2, _ = _pairs(state.state, z, model.sensor)
        inside = distance2 <= chi2_quantile(len(model.sensor.observed), 0.99)
        covered = sum_by(which[inside], state.weight[member[inside]], z.shape[1])
        born = model.birth.sample(z, covered, model.sensor, model.birth_seconds(dt), rng)
        # Candidates: the targets of the frame before, and one new target a measurement
        candidate, which, member, weight, x = _entries(state, born, near, z, against, model)
        evidence = sum_by(which + 1, weight, z.shape[1] + 1)[1:] * against
        seen = np.unique(candidate[candidate >= old])
        candidate = np.where(candidate < old, candidate, old + np.searchsorted(seen, candidate))
        label = np.concatenate([state.label, state.fresh + seen - old])
        absent = np.concatenate([np.maximum(1 - state.existence, SURELY), np.ones(len(seen))])
        box = model.sensor.boxes(x) if self.interaction_strength > 0 else np.zeros((0, 4))
        # Sample the joint state by Metropolis–Hastings [K05]
        can = make_options(candidate, which, member, weight, absent, np.ascontiguousarray(box))
        pairs = rivals(can.first, can.measurement)
        chain = Chain(
            self.burn_in,
            self.thin,
            self.samples,
            SWAP_PROBABILITY,
            float(self.interaction_strength),
        )
        options, states, chance = jump_chain(z.shape[1], can, pairs, chain, rng)
        # Keep the targets that may exist
        kept = np.flatnonzero(chance.mean(axis=1) >= self.min_weight)
        x = np.ascontiguousarray(x[:, states[kept].ravel()])
        samples = JointSamples(x, chance[kept], label[kept], state.fresh + z.shape[1])
        vanished = int(np.count_nonzero(evidence + kappa == 0))
        number = (options > can.first[:-1, None]).sum(axis=0)
        histogram = np.bincount(number) / len(number)
        mass = state.mass + born.mass
        false_alarm = false_alarm_share(kappa, evidence)
        return samples, UpdateInfo(
            mass, born.mass, samples.mass, evidence, kappa, false_alarm, vanished, histogram
        )


def _pairs(x: F8, z: F8, sensor: Sensor) -> tuple[I8, I8, F8, F8]:
    """State, measurement, d² and g(z|x) (P,) of the pairs of states (d, L) and measurements within
    the gates.
    """
    x = np.ascontiguousarray(x, np.float64)
    numbers = sensor.particle_model(z)
    member, which = points_in_rectangles(x[:2], *sensor.gate(z))
    likelihoods = kernel_for(pair_likelihoods, numbers.model)
    return member, which, *likelihoods(x, numbers.model, numbers.table, member, which)


def _entries(
    state: JointSamples,
    born: Particles,
    near: tuple[I8, I8, F8, F8],
    z: F8,
    kappa: F8,
    model: Model,
) -> tuple[I8, I8, I8, F8, F8]:
    """Entries (T,), sorted by candidate and measurement, of what every candidate may be, and the
    states (d, L).

    Whose state, seen in which measurement (−1: in none), which column of the states, and how
    likely. Newborn candidate n + j is at measurement j.
    """
    n, count = state.chance.shape
    x = np.hstack([state.state, born.state])
    weight = np.concatenate([state.weight, born.weight])
    shown = model.sensor.p_detect(x)
    unseen = np.arange(n * count)
    new = _pairs(born.state, z, model.sensor)
    member, which, _, g = (
        np.concatenate(parts) for parts in zip(near, (new[0] + n * count, *new[1:]), strict=True)
    )
    ratio = g / kappa[which]
    candidate = np.where(member < n * count, member // max(1, count), n + which)
    entry = np.concatenate([(weight * (1 - shown))[unseen], (weight * shown)[member] * ratio])
    candidate = np.concatenate([unseen // max(1, count), candidate])
    which = np.concatenate([np.full(n * count, -1), which])
    member = np.concatenate([unseen, member])
    order = np.argsort(candidate * (z.shape[1] + 1) + which + 1, kind="stable")
    # A candidate that not even the best guess explains is none.
    alive = order[(entry[order] > 0) | (which[order] < 0)]
    return candidate[alive], which[alive], member[alive], entry[alive], x


def rivals(first: I8, measurement: I8) -> I8:
    """(K, 2) pairs of candidates that may have given the same measurement, a < b."""
    candidate = np.repeat(np.arange(len(first) - 1), np.diff(first))
    order = np.argsort(measurement, kind="stable")
    order = order[measurement[order] >= 0]
    parts = [np.zeros((0, 2), np.int64)]
    for some in np.split(candidate[order], np.flatnonzero(np.diff(measurement[order])) + 1):
        one, two = np.triu_indices(len(some), 1)
        parts.append(np.stack([some[one], some[two]], axis=1))
    return np.unique(np.concatenate(parts), axis=0)


@dataclass(frozen=True, slots=True)
class Joint(Checked):
    """Settings of the extraction from joint samples: the targets that exist in most of them, at
    their mean states [K05].

    Parameters
    ----------
    min_weight : targets that exist with less probability are not reported.
    merge_iou : states whose boxes overlap by more (IoU) are one object that the detector saw twice;
        1 for never.
    """

    min_weight: Positive = 0.5
    merge_iou: Share = 0.4

    def extract(self, state: JointSamples, z: F8, model: Model) -> Estimates:
        """Mean and covariance of the samples of every target that probably exists, with its label
        [K05].

        They are in the order of the labels.
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
