"""The MCMC particle filter: Metropolis–Hastings over the joint state of all targets [K05, D14 Alg. 1].

The posterior of a frame is that of all targets at once, given what the frame before left and this scan:

    p(X | Z) ∝ g(Z | X) · p(X | Z before)

A Markov chain draws samples of it (`kernels.mcmc`). Unlike the PHD filters this one knows its targets one by one: a label is
one for a target's life.

**Associations unknown** [K05]. Sampled are which targets exist, which gave which measurement, and where each is, (E, a,
X). Every target gives one measurement at most, with probability p_D, every measurement comes of one target at most, and the
rest is Poisson clutter of density κ. With ψ = exp(−strength · penalty) for every pair of targets, the interaction that
keeps them apart [K05], and in units of the scan's being all clutter,

    p(E, a, X | Z) ∝ Π_there [1 − p_D(x)  or  p_D(x) g(z_a|x) / κ(z_a)] p_t(x) · Π_not there (1 − e_t) · Π ψ(x_s, x_t)

* For a target of the frame before, p_t is what `predict` left: N weighted states, together e_t, the probability that it is
  there still. Targets come and go and move independently of each other until the scan couples them [K05].
* A newborn target is one that this scan shows: one at most at each measurement, p_t = γ(x) as drawn by the birth model. All
  samples that add it there give it the same label.

So the law is discrete: every candidate has a table of states for each measurement that may be his and for none, and of it a
total weight. That makes the moves of the reversible-jump form exact without any tuning: a step draws an option of a
candidate from the free ones by weight, and then a state from its table (add, delete, leave, come back, update, reassign),
or options of two candidates at once (exchange). This is their conditional law but for the interaction, whose ratio is what
is left of Hastings' [K05]: α = min(1, Π ψ' / Π ψ). Adding and deleting need no Jacobian: each draws what the other drops.
Of each kept sample a target's state and its ``chance`` are kept, the probability that it is there given the rest of the
sample.

**Associations given** [D14 Alg. 1]. The last row of z is a target's label. With the samples x^r of the frame before, what is
sampled is (r, x) jointly,

    p(r, x | z) ∝ Π_t f(x_t | x_t^r) g(z_t | x_t)

whose marginal of x is the posterior of the mixture over all samples of the frame before. Two kinds of moves leave it as it
is:

* redraw: for one target, x_t' ~ f(·|x_t^r). What is left of the Hastings ratio is g(z_t|x_t') / g(z_t|x_t).
* another ancestor: r' ~ q, and all targets anew from f(·|x^r'). The ratio is that of Π g / q(r).

With ancestors of their own a target's r_t is redrawn along with it: the product of every target's own mixture [K05]. Few
samples predict a precise measurement well, and of many targets hardly any does for all at once, so q knows the scan:
q(r) ∝ Π_t p̂(z_t|x_t^r) with p̂ = N(z; H F x^r, H Q Hᵀ + R), or the mean of g over draws of f where the sensor is not
linear. A share of q is uniform. A target whose label is new has N draws about its measurement. There is no interaction: the
labels keep targets apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from phdtrack.arrays import chi2_quantile, draw, sum_by
from phdtrack.errors import Count, InputError, NonNegative, Positive, PositiveCount, Probability, check
from phdtrack.filters.intensities import JointSamples
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.kernels.mcmc import Ancestors, Chain, Options, given_chain, jump_chain, option_tables
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, ChainInfo, GaussianMixture, Particles, UpdateInfo

MOVES = ("add", "delete", "leave", "come back", "update", "reassign", "exchange")
GIVEN_MOVES = ("redraw", "ancestor")
# Density of clutter below which it is taken for this: where there is none, everything else that explains a measurement wins.
LEAST_CLUTTER = 1e-100
# Weight of a target's not being there where it surely is: the chain passes through it.
SURELY = 1e-12
# Share of uniform proposals of ancestors among those that know the scan, and draws where there is no linear view.
UNIFORM, DRAWS = 0.05, 8


@dataclass(frozen=True, slots=True)
class MCMC:
    """Settings of the MCMC particle filter.

    Parameters
    ----------
    samples : N, joint samples that are kept of a frame's chain.
    burn_in : B, steps before the first that is kept; D14's is 50. Without given associations a step is a sweep, as
        many steps as there are candidates: targets of the last frame and measurements.
    thin : steps, or sweeps, for each kept sample.
    associations : ``none``: which target gave which measurement is part of what is sampled, and targets come and go;
        ``given``: the last row of z is the label of the target that gave each measurement, whose others the sensor's g
        compares. A target without a measurement in a scan has left.
    ancestors : for ``given``. ``joint``: all targets of a sample come of the same sample of the frame before, which moves of
        the chain exchange; the chain's law is the posterior of the mixture of all of them. ``each``: every target has
        an ancestor of its own [K05], which takes what correlation there was between targets for none.
    ancestor_move_probability : for ``joint``, the share of steps that propose another ancestor.
    greedy : for ``given``, D14's Alg. 1 as printed: only proposals of ratio 1 and above are accepted, and a rejected one's
        ratio takes the place of the target's likelihood. That does not sample, and because a likelihood is then compared
        with a ratio it depends on the unit of positions; ancestors are ``each``, proposed all alike.
    swap_probability : for ``none``, the share of steps that move two candidates that compete for a measurement.
    interaction_strength : for ``none``, of the interaction; 0: there is none, which is faster. Where the detector fires
    twice
        on one person it keeps the two apart.
    interaction : what targets keep apart by: ``overlap`` of their boxes (intersection over union), or ``distance``.
    interaction_distance : for ``distance``, the distance that counts as one, in units of the position.
    min_weight : for ``none``, targets less probable than that are dropped.
    initial : targets before the first frame, one a Gaussian, there with the probability that is its weight.
    """

    samples: PositiveCount = 1000
    burn_in: Count = 50
    thin: PositiveCount = 1
    associations: Literal["none", "given"] = "none"
    ancestors: Literal["joint", "each"] = "joint"
    ancestor_move_probability: Probability = 0.25
    greedy: bool = False
    swap_probability: Probability = 0.2
    interaction_strength: NonNegative = 4.0
    interaction: Literal["overlap", "distance"] = "overlap"
    interaction_distance: Positive = 1.0
    min_weight: NonNegative = 1e-3
    initial: GaussianMixture | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.greedy and self.associations == "none":
            raise InputError(
                "greedy acceptance is that of given associations [D14 Alg. 1]",
                where="MCMC.greedy",
                cure="Set associations to given, or leave greedy out",
            )
        if self.initial is not None and self.initial.weight.max(initial=0) > 1:
            raise InputError(
                f"expected probabilities for the weights of single targets, got {self.initial.weight.max():g}",
                where="MCMC.initial",
                cure="Give one Gaussian a target",
            )

    def start(self, model: Model, rng: np.random.Generator) -> JointSamples:
        """The initial targets, N states each; none where none were given."""
        if self.initial is None:
            return JointSamples.empty(model.motion.dim, self.samples)
        n = len(self.initial)
        state = draw(self.initial, self.samples, 1.0, rng).state
        chance = np.repeat(self.initial.weight[:, None], self.samples, axis=1)
        return JointSamples(state, chance, np.arange(n), n, state[:, :0])

    def predict(self, state: JointSamples, model: Model, dt: float, rng: np.random.Generator) -> JointSamples:
        """Every target of every sample moved by f, and there with the probability p_S of what it had [K05].

        Parameters
        ----------
        state : samples of the frame before.
        model : of this frame.
        dt : interval in the model's time unit.
        rng : draws of f.

        Returns
        -------
        The predicted samples.
        """
        if len(state) == 0:
            return state
        origin = model.warp_states(state.state)
        stays = model.motion.p_survive(origin, dt / model.rate).reshape(state.chance.shape)
        moved = model.motion.sample(origin, dt, rng)
        return replace(state, state=moved, chance=state.chance * stays, origin=origin, interval=dt)

    def update(
        self, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[JointSamples, UpdateInfo]:
        """N samples of the posterior by the chain [K05, D14 Alg. 1].

        Parameters
        ----------
        state : predicted samples; given associations move the states of the frame before by themselves.
        z : (m, M) measurements.
        model : of this frame.
        dt : interval in the model's time unit.
        rng : draws of the chain.

        Returns
        -------
        The samples, and what the update learned.
        """
        updated = _given_update if self.associations == "given" else _jump_update
        return updated(self, state, z, model, dt, rng)

    def reduce(self, state: JointSamples, rng: np.random.Generator) -> JointSamples:
        """There are N samples already."""
        return state

    def step(
        self, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[JointSamples, UpdateInfo]:
        """Predict and update in turn.

        Parameters
        ----------
        state : samples of the frame before.
        z : (m, M) measurements.
        model : of this frame.
        dt : interval in the model's time unit.
        rng : draws of f and of the chain.

        Returns
        -------
        The samples, and what the update learned.
        """
        before = state if self.associations == "given" else self.predict(state, model, dt, rng)
        return self.update(before, z, model, dt, rng)

    def _chain(self, share: float, joint: bool = False) -> Chain:
        """How the chain runs, with this share of steps that move several targets."""
        overlap, strength = self.interaction == "overlap", float(self.interaction_strength)
        return Chain(self.burn_in, self.thin, self.samples, float(share), strength, overlap, joint, self.greedy)


def _jump_update(
    settings: MCMC, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
) -> tuple[JointSamples, UpdateInfo]:
    """Samples of the targets that there are after the scan ``z`` (m, M)."""
    old = len(state.label)
    kappa = model.clutter.intensity(z)
    against = np.maximum(kappa, LEAST_CLUTTER)
    born = model.birth.sample(z, _covered(state, z, model), model.sensor, dt / model.rate, rng)
    candidate, which, member, weight, x = _entries(state, born, z, against, model)
    evidence = sum_by(which + 1, weight, z.shape[1] + 1)[1:] * against
    seen = np.unique(candidate[candidate >= old])
    candidate = np.where(candidate < old, candidate, old + np.searchsorted(seen, candidate))
    label = np.concatenate([state.label, state.fresh + seen - old])
    absent = np.concatenate([np.maximum(1 - state.existence, SURELY), np.ones(len(seen))])
    first, seen_by, total, start, running = option_tables(candidate, which, weight, absent)
    can = Options(first, seen_by, total, start, running, member, _places(settings, x, model))
    pairs = _rivals(can.first, can.seen_by)
    options, states, chance, counts = jump_chain(
        old, z.shape[1], can, pairs, settings._chain(settings.swap_probability), rng
    )
    kept = np.flatnonzero(chance.mean(axis=1) >= settings.min_weight)
    x = np.ascontiguousarray(x[:, states[kept].ravel()])
    samples = JointSamples(x, chance[kept], label[kept], state.fresh + z.shape[1], x[:, :0])
    # How well the chain moved shows in targets that are there more often than not.
    likely = x[:2].reshape(2, *chance[kept].shape)[:, samples.existence >= 0.5]
    info = ChainInfo(MOVES, counts[:, 0], counts[:, 1], effective_samples(likely.reshape(-1, settings.samples)))
    vanished = int(np.count_nonzero(evidence + kappa == 0))
    number = (options > can.first[:-1, None]).sum(axis=0)
    histogram = np.bincount(number) / len(number)
    mass = state.mass + born.mass
    return samples, UpdateInfo(mass, born.mass, samples.mass, evidence, kappa, vanished, histogram, info)


def _covered(state: JointSamples, z: F8, model: Model) -> F8:
    """(M,) the predicted mass in the region around each measurement."""
    point, which = points_in_rectangles(state.state[0], state.state[1], *model.sensor.gate(z))
    near = model.sensor.distance2(z[:, which], state.state[:, point]) <= chi2_quantile(len(model.sensor.observed), 0.99)
    return sum_by(which[near], state.weight[point[near]], z.shape[1])


def _entries(state: JointSamples, born: Particles, z: F8, kappa: F8, model: Model) -> tuple[I8, I8, I8, F8, F8]:
    """Entries (T,), sorted by candidate and measurement, of what every candidate may be, and the states (d, L).

    Whose state, seen in which measurement (−1: in none), which column of the states, and how likely. Newborn candidate n + j
    is at measurement j.
    """
    n, count = state.chance.shape
    x = np.hstack([state.state, born.state])
    weight = np.concatenate([state.weight, born.weight])
    shown = model.sensor.p_detect(x)
    unseen = np.arange(n * count)
    member, which = points_in_rectangles(x[0], x[1], *model.sensor.gate(z))
    ratio = np.exp(model.sensor.log_likelihood(z[:, which], x[:, member]) - np.log(kappa[which]))
    candidate = np.where(member < n * count, member // max(1, count), n + which)
    entry = np.concatenate([(weight * (1 - shown))[unseen], (weight * shown)[member] * ratio])
    candidate = np.concatenate([unseen // max(1, count), candidate])
    which = np.concatenate([np.full(n * count, -1), which])
    member = np.concatenate([unseen, member])
    order = np.argsort(candidate * (z.shape[1] + 1) + which + 1, kind="stable")
    # A candidate that not even the best guess explains is none.
    alive = order[(entry[order] > 0) | (which[order] < 0)]
    return candidate[alive], which[alive], member[alive], entry[alive], x


def _rivals(first: I8, seen_by: I8) -> I8:
    """(K, 2) pairs of candidates that may have given the same measurement, a < b."""
    candidate = np.repeat(np.arange(len(first) - 1), np.diff(first))
    shared = (seen_by[:, None] == seen_by) & (seen_by >= 0)
    one, two = np.nonzero(shared & (candidate[:, None] < candidate))
    return np.unique(np.stack([candidate[one], candidate[two]], axis=1), axis=0)


def _places(settings: MCMC, x: F8, model: Model) -> F8:
    """(L, 4) where states (d, L) are, for the interaction: boxes, or positions in units of its range."""
    if settings.interaction_strength == 0:
        return np.zeros((0, 4))
    if settings.interaction == "overlap":
        return np.ascontiguousarray(model.sensor.boxes(x))
    return np.ascontiguousarray(np.vstack([x[:2] / settings.interaction_distance, np.zeros((2, x.shape[1]))]).T)


def _given_update(
    settings: MCMC, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
) -> tuple[JointSamples, UpdateInfo]:
    """Samples of the targets that ``z`` (m, n), labelled in its last row, names, and of no others."""
    label = _labels(z)
    order = np.argsort(label, kind="stable")
    known = np.isin(label[order], state.label)
    old, new = order[known], order[~known]
    n, dim, count = len(order), model.motion.dim, settings.samples
    none = np.zeros(1, np.int64)
    every_target, chain = np.empty((dim, n, count)), ChainInfo(GIVEN_MOVES[:1], none, none, float("nan"))
    if len(old):
        before = replace(state, origin=model.warp_states(state.state), interval=dt) if state.interval == 0 else state
        origin = before.origin.reshape(dim, *state.chance.shape)[:, np.searchsorted(state.label, label[old])]
        kept, chain = _given_samples(settings, origin, before.interval, np.ascontiguousarray(z[:, old]), model, rng)
        every_target[:, known] = kept
    mean, cov = model.sensor.states(z[:, new])
    born = draw(GaussianMixture(np.ones(len(new)), mean, cov), count, 1.0, rng)
    every_target[:, ~known] = born.state.reshape(dim, len(new), count)
    fresh = max(state.fresh, int(label.max(initial=-1)) + 1)
    samples = JointSamples(every_target.reshape(dim, -1), np.ones((n, count)), label[order], fresh, np.zeros((dim, 0)))
    number = np.eye(1, n + 1, n)[0]
    return samples, UpdateInfo(float(n), float(len(new)), float(n), np.ones(n), np.zeros(n), 0, number, chain)


def _labels(z: F8) -> I8:
    """(n,) the labels in the last row of ``z``."""
    label: I8 = z[-1].astype(np.int64)
    if (label != z[-1]).any() or len(np.unique(label)) < len(label) or (label < 0).any():
        raise InputError(
            f"expected in the last row of z one target's label each, whole numbers from 0, got {z[-1].tolist()}",
            where="MCMC.associations=given",
            cure="Put the labels below each measurement's components, or use associations=none",
        )
    return label


def _given_samples(
    settings: MCMC, origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator
) -> tuple[F8, ChainInfo]:
    """The kept samples (d, n, N) of targets with states ``origin`` (d, n, M) in the frame before; how the chain moved."""
    joint = settings.ancestors == "joint" and not settings.greedy
    fit = np.zeros(origin.shape[1:]) if settings.greedy else _fits(origin, dt, z, model, rng)
    fit = fit.sum(axis=0, keepdims=True) if joint else fit
    weight = np.exp(fit - fit.max(axis=1, keepdims=True))
    law = (1 - UNIFORM) * weight / weight.sum(axis=1, keepdims=True) + UNIFORM / fit.shape[1]
    flat = np.ascontiguousarray(origin).reshape(len(origin), -1)
    ancestors = Ancestors(flat, np.cumsum(law, axis=1), np.log(law))
    motion, sensor = model.motion.particle_model(dt, dt / model.rate), model.sensor.particle_model(z)
    kept = np.empty((len(origin), z.shape[1] * settings.samples))
    chain = settings._chain(settings.ancestor_move_probability, joint)
    counts = given_chain(motion, sensor.model, sensor.table, ancestors, chain, rng, kept)[: 1 + joint]
    effective = effective_samples(kept[:2].reshape(-1, settings.samples))
    info = ChainInfo(GIVEN_MOVES[: len(counts)], counts[:, 0], counts[:, 1], effective)
    return kept.reshape(len(origin), -1, settings.samples), info


def _fits(origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator) -> F8:
    """(n, M) log p̂(z|x^r) of the measurement of each target, up to a constant, from its states ``origin`` (d, n, M)."""
    sensor, (dim, n, many) = model.sensor, origin.shape
    if not sensor.linear:
        flat, shown = np.ascontiguousarray(origin).reshape(dim, -1), np.repeat(z, many, axis=1)
        trials = [sensor.log_likelihood(shown, model.motion.sample(flat, dt, rng)) for _ in range(DRAWS)]
        return np.asarray(np.logaddexp.reduce(trials, axis=0)).reshape(n, many)
    # F and Q at the mean of each target's states: any law will do for proposals, and that of linear models is exact.
    mean = np.ascontiguousarray(origin.mean(axis=2))
    moved, step, noise = model.motion.transition(mean, dt)
    rows = np.array(sensor.observed)
    inverse = np.linalg.inv(noise[:, rows[:, None], rows] + sensor.covariance(z, moved))
    apart = (step[:, rows] @ (origin - mean[:, :, None]).transpose(1, 0, 2)).transpose(1, 0, 2)
    apart = sensor.innovation(z, sensor.expected(moved))[:, :, None] - apart
    return np.asarray(-0.5 * np.einsum("inr,nij,jnr->nr", apart, inverse, apart))


def effective_samples(series: F8) -> float:
    """How many independent draws would tell the means of ``series`` (k, N) as well: least over its rows, by batch means.

    With b = √N batches the variance of a batch's mean, times its length, is that of the chain's asymptotic error; NaN for
    no rows or fewer than four samples, N where a row is constant.
    """
    count = series.shape[1]
    length = int(np.sqrt(count))
    if len(series) == 0 or length < 2:
        return float("nan")
    used = series[:, : count // length * length]
    means = used.reshape(len(series), -1, length).mean(axis=2)
    spread, batches = used.var(axis=1), length * means.var(axis=1, ddof=1)
    share = np.divide(spread, batches, out=np.ones(len(series)), where=batches > 0)
    return float(count * min(1.0, share.min()))
