"""The MCMC particle filter: Metropolis–Hastings over the joint state of all targets [K05, D14 Alg. 1].

A frame's posterior is that of everybody at once, given what the frame before left and this scan:

    p(X | Z) ∝ g(Z | X) · Π ψ(x_s, x_t) · p(X | Z before)

with ψ = exp(−strength · penalty) for every pair of targets, the interaction that keeps them apart [K05]. A Markov chain
draws samples of it: the first ``burn`` steps are dropped, then one of every ``thin`` is kept, until there are N.

Where it is known which target gave which measurement, as D14 has it, see `mcmc_given`; where it is not, and targets come and
go, see `mcmc_jump`. What is asked of the scene's model is the same as for the PHD filters. Unlike them this filter knows
its targets one by one: a label is one for a target's life.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from phdtrack.arrays import draw
from phdtrack.checks import Count, NonNegative, Positive, PositiveCount, Probability, check
from phdtrack.errors import InputError
from phdtrack.filters.intensities import JointSamples
from phdtrack.filters.mcmc_given import given_update
from phdtrack.filters.mcmc_jump import jump_update
from phdtrack.filters.mcmc_settings import Ancestry, Chain, Interaction, Jumps
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture, UpdateInfo


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
