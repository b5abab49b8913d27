"""The MCMC update where nobody says which target gave which measurement [K05].

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

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import sum_by
from phdtrack.filters.intensities import JointSamples
from phdtrack.filters.mcmc_settings import Chain, Jumps, effective_samples
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.kernels.mcmc_jump import Options, jump_chain, option_tables
from phdtrack.protocols import Model
from phdtrack.types import F8, I8, ChainInfo, Particles, UpdateInfo

MOVES = ("add", "delete", "leave", "come back", "update", "reassign", "exchange")
# Density of clutter below which it is taken for this: where there is none, everything else that explains a measurement wins.
LEAST_CLUTTER = 1e-100
# Weight of a target's not being there where it surely is: the chain passes through it.
SURELY = 1e-12
# Squared Mahalanobis radius around a measurement in which predicted mass counts as explaining it [M07 §2].
REGION = 13.28


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
    near = model.sensor.distance2(z[:, which], state.state[:, point]) <= REGION
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
