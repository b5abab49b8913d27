"""D14's Metropolis–Hastings filter with known associations of measurements and targets [D14 Alg. 1,
K05].

The last row of z is a target's label. With the samples x^r of the previous frame, (r, x) is sampled
jointly,

    p(r, x | z) ∝ Π_t f(x_t | x_t^r) g(z_t | x_t)

The marginal of x is the posterior of the mixture over all samples of the previous frame. Two kinds
of moves leave this density invariant:

* redraw: for one target, x_t' ~ f(·|x_t^r). The Hastings ratio reduces to g(z_t|x_t') / g(z_t|x_t).
* another ancestor: r' ~ q, and new states of all targets from f(·|x^r'). The ratio is that of Π g /
  q(r).

With separate ancestors, a target's r_t is redrawn along with it: the product of every target's own
mixture [K05]. Few samples predict a precise measurement well, and hardly any does so for many
targets at once, so q uses the scan: q(r) ∝ Π_t p̂(z_t|x_t^r) with p̂ = N(z; H F x^r, H Q Hᵀ + R). A
share of q is uniform. A target whose label is new has N draws about its measurement. There is no
interaction: the labels keep targets apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from experiments.given_chain import Ancestors, Chain, given_chain
from phdtrack.arrays import draw
from phdtrack.errors import Count, InputError, PositiveCount, Probability, check
from phdtrack.filters.mcmc import JointSamples
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, I8, GaussianMixture, UpdateInfo

# Share of uniform proposals of ancestors; the others use the scan.
UNIFORM = 0.05


@dataclass(frozen=True, slots=True)
class GivenMCMC(Filter[JointSamples]):
    """Settings of the chain; a target without a measurement in a scan has left.

    Parameters
    ----------
    samples : N, joint samples kept from the chain of a frame.
    burn_in : B, steps before the first kept sample.
    thin : steps for each kept sample.
    ancestors : ``joint``: all targets of a sample have the same ancestor sample, which the chain
        changes; the chain samples the posterior of the mixture of all ancestors. ``each``: every
        target has its own ancestor [K05], which neglects correlation between targets.
    ancestor_move_probability : for ``joint``, the share of steps that propose another ancestor.
    greedy : D14's Alg. 1 as printed: only proposals of ratio 1 and above are accepted, and a
        rejected one's ratio takes the place of the target's likelihood. This does not sample the
        posterior, and because a likelihood is then compared with a ratio, it depends on the unit of
        positions; ancestors are ``each``, proposed uniformly.
    """

    samples: PositiveCount = 1000
    burn_in: Count = 50
    thin: PositiveCount = 1
    ancestors: Literal["joint", "each"] = "joint"
    ancestor_move_probability: Probability = 0.25
    greedy: bool = False

    def __post_init__(self) -> None:
        check(self)

    def start(self, model: Model, rng: np.random.Generator) -> JointSamples:
        """The state without targets."""
        return JointSamples.empty(model.motion.dim, self.samples)

    def predict(
        self, state: JointSamples, model: Model, dt: float, rng: np.random.Generator
    ) -> JointSamples:
        """The samples of the previous frame, unchanged: the chain moves them."""
        return state

    def update(
        self, state: JointSamples, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[JointSamples, UpdateInfo]:
        """Samples of the targets whose labels are in the last row of ``z`` (m, n); all others have
        left.
        """
        label = _labels(z)
        order = np.argsort(label, kind="stable")
        known = np.isin(label[order], state.label)
        old = order[known]
        new = order[~known]
        n = len(order)
        dim = model.motion.dim
        count = self.samples
        every_target = np.empty((dim, n, count))
        if len(old):
            origin = state.state.reshape(dim, *state.chance.shape)[
                :, np.searchsorted(state.label, label[old])
            ]
            every_target[:, known] = self._sampled(
                origin, dt, np.ascontiguousarray(z[:, old]), model, rng
            )
        mean, cov = model.sensor.states(z[:, new])
        born = draw(GaussianMixture(np.ones(len(new)), mean, cov), count, 1.0, rng)
        every_target[:, ~known] = born.state.reshape(dim, len(new), count)
        fresh = max(state.fresh, int(label.max(initial=-1)) + 1)
        samples = JointSamples(
            every_target.reshape(dim, -1), np.ones((n, count)), label[order], fresh
        )
        number = np.eye(1, n + 1, n)[0]
        return samples, UpdateInfo(
            float(n), float(len(new)), float(n), np.ones(n), np.zeros(n), np.zeros(n), 0, number
        )

    def _sampled(self, origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator) -> F8:
        """The kept samples (d, n, N) of targets with states ``origin`` (d, n, M) in the previous
        frame.
        """
        joint = self.ancestors == "joint" and not self.greedy
        fit = np.zeros(origin.shape[1:]) if self.greedy else _fits(origin, dt, z, model)
        fit = fit.sum(axis=0, keepdims=True) if joint else fit
        weight = np.exp(fit - fit.max(axis=1, keepdims=True))
        law = (1 - UNIFORM) * weight / weight.sum(axis=1, keepdims=True) + UNIFORM / fit.shape[1]
        flat = np.ascontiguousarray(origin).reshape(len(origin), -1)
        ancestors = Ancestors(flat, np.cumsum(law, axis=1), np.log(law))
        motion = model.motion.particle_model(dt, dt / model.rate)
        sensor = model.sensor.particle_model(z)
        kept = np.empty((len(origin), z.shape[1] * self.samples))
        moves = float(self.ancestor_move_probability)
        chain = Chain(self.burn_in, self.thin, self.samples, moves, joint, self.greedy)
        given_chain(motion, sensor.model, sensor.table, ancestors, chain, rng, kept)
        return kept.reshape(len(origin), -1, self.samples)


def _labels(z: F8) -> I8:
    """(n,) the labels in the last row of ``z``."""
    label: I8 = z[-1].astype(np.int64)
    if (label != z[-1]).any() or len(np.unique(label)) < len(label) or (label < 0).any():
        raise InputError(
            "expected in the last row of z one target's label each, whole numbers from 0, got"
            f" {z[-1].tolist()}"
        )
    return label


def _fits(origin: F8, dt: float, z: F8, model: Model) -> F8:
    """(n, M) log p̂(z|x^r) of the measurement of each target, up to a constant, from its states
    ``origin`` (d, n, M).
    """
    # F and Q at the mean of each target's states: any distribution will do for proposals, and it is
    # exact for linear models.
    sensor = model.sensor
    mean = np.ascontiguousarray(origin.mean(axis=2))
    moved, step, noise = model.motion.transition(mean, dt)
    rows = np.array(sensor.observed)
    inverse = np.linalg.inv(noise[:, rows[:, None], rows] + sensor.covariance(z, moved))
    apart = (step[:, rows] @ (origin - mean[:, :, None]).transpose(1, 0, 2)).transpose(1, 0, 2)
    apart = sensor.innovation(z, sensor.predicted_measurements(moved))[:, :, None] - apart
    return np.asarray(-0.5 * np.einsum("inr,nij,jnr->nr", apart, inverse, apart))
