"""The MCMC update where every measurement's target is known [D14 Alg. 1, K05].

The last row of z is a target's label. With the samples x^r of the frame before, what is predicted is the mixture
(1/M) Σ_r Π_t f(x_t | x_t^r), and what is sampled, (r, x) jointly,

    p(r, x | z) ∝ Π_t f(x_t | x_t^r) g(z_t | x_t) · Π ψ(x_s, x_t)

whose marginal of x is the exact posterior of that mixture. Two kinds of moves leave it as it is:

* redraw: for one target, x_t' ~ f(·|x_t^r). What is left of the Hastings ratio is g(z_t|x_t') / g(z_t|x_t) and the
  interaction: f stands in target and proposal, and need have no density.
* another ancestor: r' ~ q, and all targets anew from f(·|x^r'). The ratio is that of Π g / q(r). See below for q.

With ancestors of their own a target's r_t is redrawn along with it, which makes of the mixture the product of every target's
own (1/M) Σ_r f(x_t|x_t^r) [K05]. All proposals can then be drawn at once.

A target whose label is new has N draws about its measurement, with what the sensor knows from it alone: the posterior
under a flat prior of its position. In its first frame it takes no part in the interaction.

Of M samples few predict a precise measurement well, and of many targets hardly any does for all at once. A proposal that
knows the scan, q(r) ∝ Π_t p̂(z_t | x_t^r), finds them. It is a fixed law while a frame's chain runs, so any will do as long
as it leaves nobody out; the better it is, the more is accepted.

p̂ is the Gaussian view of ∫ g(z|x) f(x|x^r) dx: N(z; H F x^r, H Q Hᵀ + R), exact for linear models. Where the sensor is not
linear, it is the mean of g over a few draws of f. A small share of the proposals is uniform, for what either leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import draw
from phdtrack.errors import InputError
from phdtrack.filters.intensities import JointSamples
from phdtrack.kernels.gaussian import gaussian_parts
from phdtrack.kernels.mcmc import independent_chain, linear_chain, total_penalty
from phdtrack.models import PlaneMotion, PlaneSensor, PointMotion, PointSensor
from phdtrack.protocols import Model, Sensor
from phdtrack.types import F8, I8, Bool, ChainInfo, GaussianMixture, UpdateInfo

MOVES = ("redraw", "ancestor")
# Share of uniform proposals among those that know the scan, and draws where there is no linear view.
UNIFORM, DRAWS = 0.05, 8


@dataclass(frozen=True, slots=True)
class Interaction:
    """``strength`` of the pairwise potential, 0 for none; of ``boxes``, or of points with a ``reach`` [K05]."""

    strength: float
    boxes: bool
    reach: float

    def places(self, x: F8, sensor: Sensor) -> F8:
        """(L, 4) where states are, as `kernels.mcmc` wants it; (0, 4) where nobody asks."""
        if self.strength == 0:
            return np.zeros((0, 4))
        if self.boxes:
            return np.ascontiguousarray(sensor.boxes(x))
        return np.ascontiguousarray(np.vstack([x[:2] / self.reach, np.zeros((2, x.shape[1]))]).T)


@dataclass(frozen=True, slots=True)
class Chain:
    """A chain of ``samples`` kept after ``burn`` steps, one of every ``thin``, with an interaction of targets."""

    samples: int
    burn: int
    thin: int
    interaction: Interaction

    @property
    def steps(self) -> int:
        """How many there are in all."""
        return self.burn + self.thin * self.samples


@dataclass(frozen=True, slots=True)
class Ancestry:
    """Of the form with given associations: see `mcmc.MCMC`."""

    joint: bool
    switch: float
    informed: bool
    greedy: bool


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


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A law q over M samples: ``log`` (M,) log q, ``running`` (M,) sums of q."""

    log: F8
    running: F8


def choose(proposal: Proposal, uniform: F8) -> I8:
    """Draws of q by uniform numbers (k,) in [0, 1)."""
    place: I8 = np.searchsorted(proposal.running, uniform * proposal.running[-1], side="right")
    return place


def proposals(
    informed: bool, joint: bool, origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator
) -> list[Proposal]:
    """One q for all targets together (``joint``), or one each, of samples ``origin`` (d, n·M) for measurements (m, n)."""
    n = z.shape[1]
    many = origin.shape[1] // n
    if not informed:
        flat = Proposal(np.full(many, -np.log(many)), np.arange(1.0, many + 1))
        return [flat] * (1 if joint else n)
    parts = linear_parts(model, z, dt) if dt else None
    if parts is None:
        fits = _fits(origin, dt, z[:, np.repeat(np.arange(n), many)], model, rng).reshape(n, many)
    else:
        fits = parts.fits(origin)
    if joint:
        fits = fits.sum(axis=0, keepdims=True)
    return [_law(fit) for fit in fits]


def _law(fit: F8) -> Proposal:
    weight = np.exp(fit - fit.max())
    share = (1 - UNIFORM) * weight / weight.sum() + UNIFORM / len(weight)
    return Proposal(np.log(share), np.cumsum(share))


def _fits(origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator) -> F8:
    """(L,) log p̂(z|ξ), up to what is the same for all, of pairs of columns of ``z`` (m, L) and ``origin`` (d, L)."""
    sensor = model.sensor
    if dt == 0:
        return sensor.log_likelihood(z, origin)
    if not sensor.linear:
        trials = [sensor.log_likelihood(z, model.motion.sample(origin, dt, rng)) for _ in range(DRAWS)]
        return np.asarray(np.logaddexp.reduce(trials, axis=0))
    mean, _, noise = model.motion.transition(origin, dt)
    rows = list(sensor.observed)
    spread = noise[:, rows][:, :, rows] + sensor.covariance(z, mean)
    apart = sensor.innovation(z, sensor.expected(mean))
    distance2, log_det = gaussian_parts(apart, spread)
    return np.asarray(-0.5 * (distance2 + log_det))


@dataclass(frozen=True, slots=True, eq=False)
class LinearParts:
    """x = F ξ + L ν, z = (px, py) + noise of covariance R.

    Attributes
    ----------
    step, root : (d, d) F and L, with Q = L Lᵀ of whatever rank.
    z : (2, n) measured positions.        inverse : (n, 3) R⁻¹ of each, packed as xx, xy, yy.
    predictive : (n, 2, 2) (H L Lᵀ Hᵀ + R)⁻¹.
    """

    step: F8
    root: F8
    z: F8
    inverse: F8
    predictive: F8

    def fits(self, origin: F8) -> F8:
        """(n, M) log N(z; H F ξ, H Q Hᵀ + R) of each target's samples ``origin`` (d, n·M), up to a constant."""
        n = self.z.shape[1]
        apart = self.z[:, :, None] - (self.step[:2] @ origin).reshape(2, n, -1)
        (a, b), (_, c) = self.predictive.transpose(1, 2, 0)[:, :, :, None]
        out: F8 = -0.5 * (a * apart[0] ** 2 + 2 * b * apart[0] * apart[1] + c * apart[1] ** 2)
        return out


def linear_parts(model: Model, z: F8, dt: float) -> LinearParts | None:
    """The parts for measurements ``z`` (m, n) after ``dt``, or None where the model is none of those known to be linear."""
    if not isinstance(model.motion, PlaneMotion | PointMotion) or not isinstance(model.sensor, PlaneSensor | PointSensor):
        return None
    # Of both, F and Q are the same for all states and R for all states of one measurement.
    _, step, noise = model.motion.transition(np.zeros((model.motion.dim, 1)), dt)
    size, axes = np.linalg.eigh(noise[0])
    spread = model.sensor.covariance(z, np.zeros((model.motion.dim, z.shape[1])))
    inverse = np.linalg.inv(spread)
    total: F8 = spread + noise[0, :2, :2]
    predictive = np.asarray(np.linalg.inv(total), np.float64)
    packed = np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], axis=1)
    root = axes * np.sqrt(np.maximum(size, 0.0))
    return LinearParts(
        np.ascontiguousarray(step[0]), np.ascontiguousarray(root), np.ascontiguousarray(z[:2]), packed, predictive
    )


def given_update(
    chain: Chain, ancestry: Ancestry, state: JointSamples, z: F8, model: Model, rng: np.random.Generator
) -> tuple[JointSamples, UpdateInfo]:
    """Samples of the targets that ``z`` (m, n), labelled in its last row, names, and of nobody else."""
    label = _labels(z)
    order = np.argsort(label, kind="stable")
    known = np.isin(label[order], state.label)
    old, new = order[known], order[~known]
    n, dim, count = len(order), model.motion.dim, chain.samples
    origin = _of(state, np.searchsorted(state.label, label[old]))
    none = np.zeros(1, np.int64)
    everybody, info = np.empty((dim, n, count)), ChainInfo(MOVES[:1], none, none, float("nan"))
    if len(old):
        seen = np.ascontiguousarray(z[:, old])
        kept, info = _run(chain, ancestry, origin, state.interval, seen, model, rng)
        everybody[:, known] = kept.reshape(dim, len(old), count)
    mean, cov = model.sensor.states(z[:, new])
    born = draw(GaussianMixture(np.ones(len(new)), mean, cov), count, 1.0, rng)
    everybody[:, ~known] = born.state.reshape(dim, len(new), count)
    fresh = max(state.fresh, int(label.max(initial=-1)) + 1)
    samples = JointSamples(everybody.reshape(dim, -1), np.ones((n, count)), label[order], fresh, np.zeros((dim, 0)))
    number = np.eye(1, n + 1, n)[0]
    return samples, UpdateInfo(float(n), float(len(new)), float(n), np.ones(n), np.zeros(n), 0, number, info)


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


def _of(state: JointSamples, place: I8) -> F8:
    """The states that the targets at ``place`` are predicted from."""
    n, count = state.chance.shape
    before = state.origin if state.interval else state.state
    return np.ascontiguousarray(before.reshape(len(before), n, count)[:, place].reshape(len(before), -1))


def _run(
    chain: Chain, ancestry: Ancestry, origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator
) -> tuple[F8, ChainInfo]:
    """The kept samples (d, n·N) of targets with states ``origin`` (d, n·M) in the frame before."""
    n = z.shape[1]
    if ancestry.greedy or not ancestry.joint:
        kept, counts = each_chain(chain, ancestry, origin, dt, z, model, rng)
    else:
        switches = rng.random(chain.steps) < ancestry.switch
        parts = linear_parts(model, z, dt) if chain.interaction.strength == 0 and dt > 0 else None
        proposal = proposals(ancestry.informed, True, origin, dt, z, model, rng)[0]
        if parts is None:
            kept, counts = joint_chain(chain, switches, proposal, origin, dt, z, model, rng)
        else:
            kept, keep = np.empty((len(origin), n * chain.samples)), np.array([chain.burn, chain.thin])
            counts = linear_chain(
                origin, parts.z, parts.inverse, parts.step, parts.root, proposal.running, proposal.log, switches, keep,
                rng, kept,
            )  # fmt: skip
    effective = effective_samples(kept[:2].reshape(2 * n, chain.samples))
    return kept, ChainInfo(MOVES[: len(counts)], counts[:, 0], counts[:, 1], effective)


def _moved(x: F8, dt: float, model: Model, rng: np.random.Generator) -> F8:
    """Draws of f(·|x); of no time at all ``x`` itself."""
    return model.motion.sample(np.ascontiguousarray(x), dt, rng) if dt else x


def each_chain(
    chain: Chain, ancestry: Ancestry, origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator
) -> tuple[F8, I8]:
    """Every target with ancestors of its own; any model [K05, D14 Alg. 1]."""
    n, steps = z.shape[1], chain.steps
    many = origin.shape[1] // n
    # The chain starts at one proposal for each target.
    target = np.concatenate([np.arange(n), rng.integers(n, size=steps)])
    ancestor, log_proposal = np.empty(len(target), np.int64), np.empty(len(target))
    informed = ancestry.informed and not ancestry.greedy
    for t, proposal in enumerate(proposals(informed, False, origin, dt, z, model, rng)):
        own = np.flatnonzero(target == t)
        ancestor[own] = choose(proposal, rng.random(len(own)))
        log_proposal[own] = proposal.log[ancestor[own]]
    x = _moved(origin[:, target * many + ancestor], dt, model, rng)
    weight = model.sensor.log_likelihood(z[:, target], x)
    if not ancestry.greedy:
        # Alg. 1's weight is the likelihood alone. Where a ratio takes a weight's place, a common factor does not cancel.
        weight -= log_proposal
    place = chain.interaction.places(x, model.sensor)
    kept, accepted = independent_chain(
        target[n:], weight[n:], -rng.standard_exponential(steps), weight[:n], place, chain.interaction.strength,
        chain.interaction.boxes, ancestry.greedy, np.array([chain.burn, chain.thin]),
    )  # fmt: skip
    return np.ascontiguousarray(x[:, kept.ravel()]), np.array([[steps, accepted]])


def joint_chain(
    chain: Chain, switches: Bool, proposal: Proposal, origin: F8, dt: float, z: F8, model: Model, rng: np.random.Generator
) -> tuple[F8, I8]:
    """One ancestor for all targets, for any model: what `kernels.mcmc.linear_chain` does, in the open.

    Slow, because what the next proposals are drawn from is known only when an ancestor has been accepted or not.
    """
    n, dim = z.shape[1], len(origin)
    columns = np.arange(n) * (origin.shape[1] // n)
    counts = np.zeros((2, 2), np.int64)
    ancestor = int(choose(proposal, rng.random(1))[0])
    now = _moved(origin[:, columns + ancestor], dt, model, rng)
    fit, crowd = model.sensor.log_likelihood(z, now), _crowded(chain, now, model)
    kept = np.empty((dim, n, chain.samples))
    for s, switching in enumerate(switches.tolist()):
        changed, source = np.array([rng.integers(n)]), ancestor
        if switching:
            changed, source = np.arange(n), int(choose(proposal, rng.random(1))[0])
        new, fits = now.copy(), fit.copy()
        new[:, changed] = _moved(origin[:, columns[changed] + source], dt, model, rng)
        fits[changed] = model.sensor.log_likelihood(z[:, changed], new[:, changed])
        crowds = _crowded(chain, new, model)
        gain = (fits - fit).sum() - (crowds - crowd) - (proposal.log[source] - proposal.log[ancestor])
        counts[int(switching), 0] += 1
        if gain >= -rng.standard_exponential():
            now, fit, crowd, ancestor = new, fits, crowds, source
            counts[int(switching), 1] += 1
        if s >= chain.burn and (s - chain.burn + 1) % chain.thin == 0:
            kept[:, :, (s - chain.burn) // chain.thin] = now
    return kept.reshape(dim, -1), counts


def _crowded(chain: Chain, x: F8, model: Model) -> float:
    """−log Π ψ of the targets at ``x`` (d, n) [K05]."""
    interaction = chain.interaction
    if interaction.strength == 0:
        return 0.0
    return interaction.strength * float(total_penalty(interaction.places(x, model.sensor), interaction.boxes))
