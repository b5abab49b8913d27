"""The MCMC particle filter: Metropolis–Hastings over the joint state of all targets [K05, D14 Alg. 1].

A frame's posterior is that of everybody at once, given what the frame before left and this scan:

    p(X | Z) ∝ g(Z | X) · Π ψ(x_s, x_t) · p(X | Z before)

with ψ = exp(−strength · penalty) for every pair of targets, the interaction that keeps them apart [K05]. A Markov chain
draws samples of it: the first ``burn`` steps are dropped, then one of every ``thin`` is kept, until there are N.

Where it is known which target gave which measurement, as D14 has it, see `mcmc_given`; where it is not, targets come and go:
see below. What is asked of the scene's model is the same as for the PHD filters. Unlike them this filter knows
its targets one by one: a label is one for a target's life.

The MCMC update where nobody says which target gave which measurement [K05].

What is sampled is who is there, who gave which measurement, and where everybody is, (E, a, X). Every target gives one
measurement at most, with probability p_D, every measurement comes of one target at most, and the rest is Poisson clutter of
density κ. In units of the scan's being all clutter,

    p(E, a, X | Z) ∝ Π_there [1 − p_D(x)  or  p_D(x) g(z_a|x) / κ(z_a)] p_t(x) · Π_not there (1 − e_t) · Π ψ(x_s, x_t)

* For a target of the frame before, p_t is what `predict` left: N weighed states, together e_t, the probability that it is
  there still. Targets come and go and move independently of each other until the scan couples them [K05].
* A newborn target is one that this scan shows: one at most at each measurement, p_t = γ(x) as drawn by the birth model. (One
  that nothing shows is born when something does.) All samples that add it there give it the same label.

So the law is discrete: every candidate has a table of states for each measurement that may be his and for none, and of
it a total weight. That makes the moves of the reversible-jump form exact without any tuning: a step draws an option of a
candidate from the free ones by weight, and then a state from its table (add, delete, leave, come back, update, reassign), or
options of two candidates at once (exchange). This is their conditional law but for the interaction, whose ratio is what is
left of Hastings' [K05]: α = min(1, Π ψ' / Π ψ). Adding and deleting need no Jacobian: each
draws what the other drops.

Of each kept sample a target's state and ``chance`` are kept, the probability that it is there given the rest of the
sample. Their mean over samples is the probability that it is there, with less noise than how often it was, and weighs
targets that are in no sample at all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from phdtrack.arrays import draw, region_radius2, sum_by
from phdtrack.checks import Count, NonNegative, Positive, PositiveCount, Probability, check
from phdtrack.errors import InputError
from phdtrack.filters.intensities import JointSamples
from phdtrack.filters.mcmc_given import Ancestry, Chain, Interaction, effective_samples, given_update
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.kernels.mcmc import Options, jump_chain, option_tables
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, ChainInfo, GaussianMixture, Particles, UpdateInfo

MOVES = ("add", "delete", "leave", "come back", "update", "reassign", "exchange")
# Density of clutter below which it is taken for this: where there is none, everything else that explains a measurement wins.
LEAST_CLUTTER = 1e-100
# Weight of a target's not being there where it surely is: the chain passes through it.
SURELY = 1e-12


@dataclass(frozen=True, slots=True)
class Jumps:
    """Of the form without given associations: share of moves of two targets, and the least probability of one."""

    exchange: float
    faintest: float


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
        compares. Who has none in a scan has left.
    ancestors : for ``given``. ``joint``: all targets of a sample come of the same sample of the frame before, which moves of
        the chain exchange; the chain's law is the posterior of the mixture of all of them. ``each``: every target has
        an ancestor of its own [K05], which takes what correlation there was between targets for none.
    ancestor_move_probability : for ``joint``, the share of steps that propose another ancestor.
    informed : for ``given``, propose ancestors by how well they predict the scan, with the ratio that this asks for; False:
        all alike [K05], of which few are accepted where there are many targets or precise measurements.
    greedy : for ``given``, D14's Alg. 1 as printed: only proposals of ratio 1 and above are accepted, and a rejected one's
        ratio takes the place of the target's likelihood. That does not sample, and because a likelihood is then compared
        with a ratio it depends on the unit of positions; ancestors are ``each``, all alike.
    swap_probability : for ``none``, the share of steps that move two candidates that compete for a measurement.
    interaction_strength : of the interaction; 0 for none, which is faster. Where the detector fires twice on one person it
        keeps the two apart; where associations are given there is less need.
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
    informed: bool = True
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

    @property
    def _chain(self) -> Chain:
        interaction = Interaction(self.interaction_strength, self.interaction == "overlap", self.interaction_distance)
        return Chain(self.samples, self.burn_in, self.thin, interaction)

    def start(self, model: Model, rng: np.random.Generator) -> JointSamples:
        """The initial targets, N states each; none where none were given."""
        if self.initial is None:
            return JointSamples.empty(model.motion.dim, self.samples)
        n = len(self.initial)
        state = draw(self.initial, self.samples, 1.0, rng).state
        chance = np.repeat(self.initial.weight[:, None], self.samples, axis=1)
        return JointSamples(state, chance, np.arange(n), n, state[:, :0])

    def predict(self, state: JointSamples, model: Model, dt: float, rng: np.random.Generator) -> JointSamples:
        """Every target of every sample moved by f, and there with the probability p_S of what it had [K05]."""
        if len(state) == 0:
            return state
        origin = model.warp_states(state.state)
        stays = model.motion.p_survive(origin, dt / model.rate).reshape(state.chance.shape)
        moved = model.motion.sample(origin, dt, rng)
        return replace(state, state=moved, chance=state.chance * stays, origin=origin, interval=dt)

    def update(
        self, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[JointSamples, UpdateInfo]:
        """N samples of the posterior by the chain [K05, D14 Alg. 1]."""
        if self.associations == "given":
            ancestry = Ancestry(self.ancestors == "joint", self.ancestor_move_probability, self.informed, self.greedy)
            return given_update(self._chain, ancestry, state, z, model, rng)
        return jump_update(self._chain, Jumps(self.swap_probability, self.min_weight), state, z, model, dt, rng)

    def reduce(self, state: JointSamples, rng: np.random.Generator) -> JointSamples:
        """There are N samples already."""
        return state

    def step(
        self, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[JointSamples, UpdateInfo]:
        """Predict and update in turn; with given associations the chain moves what it needs itself."""
        if self.associations == "given":
            origin = model.warp_states(state.state)
            return self.update(replace(state, state=origin, origin=origin, interval=dt), z, model, dt, rng)
        return self.update(self.predict(state, model, dt, rng), z, model, dt, rng)


@dataclass(frozen=True, slots=True, eq=False)
class Entries:
    """States that candidates may have, by measurement, sorted by candidate and measurement.

    Attributes
    ----------
    candidate, which, member : (T,) whose state, seen in which measurement (−1: in none), and which column of ``state``.
    weight : (T,) of each.        state : (d, L).
    """

    candidate: I8
    which: I8
    member: I8
    weight: F8
    state: F8


def jump_update(
    chain: Chain, jumps: Jumps, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
) -> tuple[JointSamples, UpdateInfo]:
    """Samples of the targets that there are after the scan ``z`` (m, M)."""
    old = len(state.label)
    kappa = model.clutter.intensity(z)
    against = np.maximum(kappa, LEAST_CLUTTER)
    born = model.birth.sample(z, _covered(state, z, model), model.sensor, dt / model.rate, rng)
    entries = _entries(state, born, z, against, model)
    evidence = sum_by(entries.which + 1, entries.weight, z.shape[1] + 1)[1:] * against
    seen = np.unique(entries.candidate[entries.candidate >= old])
    candidate = np.where(entries.candidate < old, entries.candidate, old + np.searchsorted(seen, entries.candidate))
    label = np.concatenate([state.label, state.fresh + seen - old])
    absent = np.concatenate([np.maximum(1 - state.existence, SURELY), np.ones(len(seen))])
    first, seen_by, total, start, running = option_tables(candidate, entries.which, entries.weight, absent)
    place = chain.interaction.places(entries.state, model.sensor)
    apart = chain.interaction
    can = Options(first, seen_by, total, start, running, entries.member, place, apart.strength, apart.boxes)
    keep = np.array([chain.burn, chain.thin, chain.samples])
    pairs = _rivals(can.first, can.seen_by)
    options, states, chance, counts = jump_chain(old, z.shape[1], can, pairs, jumps.exchange, keep, rng)
    kept = np.flatnonzero(chance.mean(axis=1) >= jumps.faintest)
    x = np.ascontiguousarray(entries.state[:, states[kept].ravel()])
    fresh = state.fresh + z.shape[1]
    samples = JointSamples(x, chance[kept], label[kept], fresh, x[:, :0])
    mass = state.mass + born.mass
    vanished = int(np.count_nonzero(evidence + kappa == 0))
    number = (options > can.first[:-1, None]).sum(axis=0)
    histogram = np.bincount(number) / len(number)
    return samples, UpdateInfo(mass, born.mass, samples.mass, evidence, kappa, vanished, histogram, _told(samples, counts))


def _told(samples: JointSamples, counts: I8) -> ChainInfo:
    """How well the chain moved, by the positions of targets that are there more often than not."""
    likely = samples.existence >= 0.5
    series = samples.state[:2].reshape(2, *samples.chance.shape)[:, likely].reshape(-1, samples.chance.shape[1])
    return ChainInfo(MOVES, counts[:, 0], counts[:, 1], effective_samples(series))


def _covered(state: JointSamples, z: F8, model: Model) -> F8:
    """(M,) the predicted mass in the region around each measurement."""
    point, which = points_in_rectangles(state.state[0], state.state[1], *model.sensor.gate(z))
    near = model.sensor.distance2(z[:, which], state.state[:, point]) <= region_radius2(len(model.sensor.observed))
    return sum_by(which[near], state.weight[point[near]], z.shape[1])


def _entries(state: JointSamples, born: Particles, z: F8, kappa: F8, model: Model) -> Entries:
    """What every candidate may be: unseen or seen, where and how likely; newborn candidate n + j is at measurement j."""
    n, count = state.chance.shape
    x = np.hstack([state.state, born.state])
    weight = np.concatenate([state.weight, born.weight])
    shown = model.sensor.p_detect(x)
    unseen = np.arange(n * count)
    member, which = points_in_rectangles(x[0], x[1], *model.sensor.gate(z))
    ratio = np.exp(model.sensor.log_likelihood(z[:, which], x[:, member]) - np.log(kappa[which]))
    candidate = np.where(member < n * count, member // max(1, count), n + which)
    candidate = np.concatenate([unseen // max(1, count), candidate])
    which = np.concatenate([np.full(n * count, -1), which])
    member = np.concatenate([unseen, member])
    told = (weight * shown)[member[n * count :]] * ratio
    entry = np.concatenate([(weight * (1 - shown))[unseen], told])
    order = np.argsort(candidate * (z.shape[1] + 1) + which + 1, kind="stable")
    # A candidate that not even the best guess explains is none.
    alive = order[(entry[order] > 0) | (which[order] < 0)]
    return Entries(candidate[alive], which[alive], member[alive], entry[alive], x)


def _rivals(first: I8, seen_by: I8) -> I8:
    """(K, 2) pairs of candidates that may have given the same measurement, a < b."""
    candidate = np.repeat(np.arange(len(first) - 1), np.diff(first))
    shared = (seen_by[:, None] == seen_by) & (seen_by >= 0)
    one, two = np.nonzero(shared & (candidate[:, None] < candidate))
    return np.unique(np.stack([candidate[one], candidate[two]], axis=1), axis=0)
