"""Metropolis–Hastings over the joint state of targets whose measurements are known [D14 Alg. 1, K05].

`independent_chain` decides about proposals that were drawn beforehand, for any model: each target has ancestors of its own.
`linear_chain` draws, weighs and decides at once, where motion and sensor are linear and Gaussian, and one sample of the
frame before is the ancestor of all targets. What a step proposes, and why it is right, stands in `filters.mcmc_given`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from phdtrack.kernels.fast32 import ENTRY, INNER
from phdtrack.kernels.mcmc_apart import crowding

F8 = NDArray[np.float64]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@njit(**ENTRY)
def independent_chain(
    target: I8, weight: F8, height: F8, start: F8, place: F8, strength: float, boxes: bool, greedy: bool, keep: I8
) -> tuple[I8, int]:
    """Accept or reject proposals, each for one target.

    Parameters
    ----------
    target, weight : (S,) the target of each proposal, and its log-likelihood, less the logarithm of the proposal's law where
        that is not constant; never less it where ``greedy``, in which a constant does not cancel.
    height : (S,) logarithms of uniform numbers.
    start : (n,) those of the states that the chain starts from.
    place : (n + S, 4) where these and the proposals are, see `mcmc_apart`; read where ``strength`` is above 0.
    greedy : accept ratios of 1 and more only, and take the ratio for the target's weight where it is less [D14 Alg. 1].
    keep : (2,) steps before the first kept sample, and steps for each one that is kept.

    Returns
    -------
    kept : (n, N) what each target's state is in each kept sample: a number below n is a start, n + s proposal s.
    accepted : number of accepted proposals.
    """
    n, burn, thin = start.size, keep[0], keep[1]
    kept = np.empty((n, (target.size - burn) // thin), np.int64)
    now, cached = np.arange(n), start.copy()
    accepted = 0
    for s in range(target.size):
        t = target[s]
        gain = weight[s] - cached[t]
        if strength > 0.0:
            gain -= strength * (crowding(place, n + s, now, t, t, boxes) - crowding(place, now[t], now, t, t, boxes))
        if gain >= (0.0 if greedy else height[s]):
            now[t], cached[t] = n + s, weight[s]
            accepted += 1
        elif greedy:
            cached[t] = gain
        if s >= burn and (s - burn + 1) % thin == 0:
            for k in range(n):
                kept[k, (s - burn) // thin] = now[k]
    return kept, accepted


@njit(**INNER)
def _moved(origin: F8, column: int, step: F8, root: F8, rng: np.random.Generator, out: F8) -> None:
    """A draw of N(F ξ, L Lᵀ) about column ``column`` of ``origin`` (d, L), into ``out`` (d,)."""
    d = out.size
    for i in range(d):
        out[i] = 0.0
    for j in range(d):
        x, noise = origin[j, column], rng.standard_normal()
        for i in range(d):
            out[i] += step[i, j] * x + root[i, j] * noise


@njit(**INNER)
def _fit(z: F8, inverse: F8, t: int, x: F8) -> float:
    """log g(z_t|x) up to a constant: −½ dᵀ R⁻¹ d of the position; ``inverse`` (n, 3) holds xx, xy, yy."""
    dx, dy = z[0, t] - x[0], z[1, t] - x[1]
    out: float = -0.5 * (inverse[t, 0] * dx * dx + 2.0 * inverse[t, 1] * dx * dy + inverse[t, 2] * dy * dy)
    return out


@njit(**ENTRY)
def linear_chain(
    origin: F8, z: F8, inverse: F8, step: F8, root: F8, running: F8, log_proposal: F8, switch: Bool, keep: I8,
    rng: np.random.Generator, kept: F8,
) -> I8:  # fmt: skip
    """The chain with one common ancestor, for x = F ξ + L ν and positions as measurements.

    Parameters
    ----------
    origin : (d, n·M) the samples of the frame before, those of a target beside each other.
    z, inverse : (2, n) positions, and (n, 3) R⁻¹ of each, packed as xx, xy, yy.
    step, root : (d, d) F and L.
    running, log_proposal : (M,) the law that ancestors are proposed by: sums of its probabilities, and their logarithms.
    switch : (S,) which steps change the ancestor; the others redraw one target.
    keep : (2,) steps before the first kept sample, and steps for each one that is kept.
    kept : (d, n·N) is filled with the kept samples.

    Returns (2, 2) proposed and accepted, of redraws (first row) and of changes of the ancestor.
    """
    d, n = origin.shape[0], z.shape[1]
    many, count = origin.shape[1] // n, kept.shape[1] // n
    counts = np.zeros((2, 2), np.int64)
    now, new = np.empty((n, d)), np.empty((n, d))
    fit, fits = np.empty(n), np.empty(n)
    ancestor = np.searchsorted(running, rng.random() * running[-1], side="right")
    for t in range(n):
        _moved(origin, t * many + ancestor, step, root, rng, now[t])
        fit[t] = _fit(z, inverse, t, now[t])
    for s in range(switch.size):
        if switch[s]:
            other = np.searchsorted(running, rng.random() * running[-1], side="right")
            gain = log_proposal[ancestor] - log_proposal[other]
            for t in range(n):
                _moved(origin, t * many + other, step, root, rng, new[t])
                fits[t] = _fit(z, inverse, t, new[t])
                gain += fits[t] - fit[t]
            counts[1, 0] += 1
            if gain >= 0.0 or rng.random() < np.exp(gain):
                now, new, fit, fits, ancestor = new, now, fits, fit, other
                counts[1, 1] += 1
        else:
            t = int(rng.random() * n)
            _moved(origin, t * many + ancestor, step, root, rng, new[t])
            trial = _fit(z, inverse, t, new[t])
            counts[0, 0] += 1
            if trial >= fit[t] or rng.random() < np.exp(trial - fit[t]):
                fit[t] = trial
                for i in range(d):
                    now[t, i] = new[t, i]
                counts[0, 1] += 1
        if s >= keep[0] and (s - keep[0] + 1) % keep[1] == 0:
            place = (s - keep[0]) // keep[1]
            for t in range(n):
                for i in range(d):
                    kept[i, t * count + place] = now[t, i]
    return counts
