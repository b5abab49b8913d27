"""The chain of D14's filter: Metropolis–Hastings over targets with known measurements [D14 Alg. 1,
K05].
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from phdtrack.kernels.particle_models import BLOCK, distance, move, normals, prepare, seen
from phdtrack.types import F8, I8

# Rows of the counts: the kind of proposal.
REDRAW, ANCESTOR = range(2)


class Chain(NamedTuple):
    """Settings of a chain.

    ``burn`` steps before the first kept sample, then one of every ``thin`` steps until ``samples``
    are kept; ``share`` of steps that propose another ancestor; whether all targets of a sample have
    a ``joint`` ancestor, and whether acceptance is ``greedy`` [D14 Alg. 1].
    """

    burn: int
    thin: int
    samples: int
    share: float
    joint: bool
    greedy: bool


class Ancestors(NamedTuple):
    """The possible ancestors of targets.

    ``origin`` (d, n·M): the M states of each of n targets in the previous frame, grouped by target.
    ``running``, ``log`` (k, M): proposal distribution of ancestors, for all targets together (k =
    1) or for each (k = n): cumulative probabilities, and their logarithms.
    """

    origin: F8
    running: F8
    log: F8


@njit(error_model="numpy")
def _draw(
    world: Any, ancestors: Ancestors, t: int, r: int, scratch: F8, rng: np.random.Generator, out: F8
) -> float:
    """log g of measurement t and a draw of f(·|x) of state r of target t, which is written to
    ``out`` (d,).
    """
    motion, sensor, table = world
    origin = ancestors.origin
    column = t * (origin.shape[1] // table.shape[1]) + r
    d = out.size
    for a in range(d):
        scratch[a * BLOCK] = origin[a, column]
    for k in range(normals(motion)):
        scratch[(8 + k) * BLOCK] = rng.standard_normal()
    move(motion, scratch, 0)
    for a in range(d):
        out[a] = scratch[a * BLOCK]
    prepare(sensor, scratch, 0)
    d2, factor = distance(sensor, seen(sensor, table, t), scratch, 0)
    return math.log(float(factor)) - 0.5 * float(d2)


@njit(error_model="numpy")
def _ancestor(ancestors: Ancestors, law: int, rng: np.random.Generator) -> int:
    """An ancestor drawn from its proposal distribution."""
    running = ancestors.running[law]
    return int(np.searchsorted(running, rng.random() * running[-1], side="right"))


@njit(nogil=True, error_model="numpy")
def given_chain(
    motion: Any,
    sensor: Any,
    table: Any,
    ancestors: Ancestors,
    chain: Chain,
    rng: np.random.Generator,
    kept: F8,
) -> I8:
    """Samples of targets whose measurements are known, from the samples of the previous frame [D14
    Alg. 1].

    Parameters
    ----------
    motion, sensor : records of `kernels.particle_models`.
    table : (k, n) measurement of each target, as the sensor has it.
    ancestors : the states of the previous frame.
    chain : its settings.
    kept : (d, n·N) receives the kept samples.

    Returns
    -------
    (2, 2) proposed and accepted: redraws of one target (first row) and changes of the common
    ancestor.
    """
    n = table.shape[1]
    scratch = np.empty(16 * BLOCK)
    counts = np.zeros((2, 2), np.int64)
    # In row 0 the present sample, in row 1 the proposal.
    x = np.empty((2, n, kept.shape[0]))
    fit = np.zeros((2, n))
    ancestor = np.zeros((2, n), np.int64)
    for step in range(-1, chain.burn + chain.thin * chain.samples):
        # The chain starts at a proposal for all.
        everything = step < 0 or (chain.joint and rng.random() < chain.share)
        first = 0 if everything else int(rng.random() * n)
        last = n if everything else first + 1
        gain = 0.0
        common = _ancestor(ancestors, 0, rng) if chain.joint and everything else ancestor[0, first]
        for t in range(first, last):
            ancestor[1, t] = common if chain.joint else _ancestor(ancestors, t, rng)
            fit[1, t] = _draw(
                (motion, sensor, table), ancestors, t, ancestor[1, t], scratch, rng, x[1, t]
            )
            # Alg. 1's weight is the likelihood: if a ratio replaces it, a common factor does not
            # cancel.
            fit[1, t] -= 0.0 if chain.joint or chain.greedy else ancestors.log[t, ancestor[1, t]]
            gain += fit[1, t] - fit[0, t]
        accepted = step < 0
        kind = ANCESTOR if everything else REDRAW
        if not accepted:
            if everything:
                gain -= ancestors.log[0, common] - ancestors.log[0, ancestor[0, 0]]
            accepted = gain >= (0.0 if chain.greedy else math.log(1.0 - rng.random()))
            counts[kind, 0] += 1
            counts[kind, 1] += accepted
        for t in range(first, last):
            # D14's Alg. 1 takes the ratio for the weight of a state that stays.
            fit[0, t] = fit[1, t] if accepted else gain if chain.greedy else fit[0, t]
            ancestor[0, t] = ancestor[1, t] if accepted else ancestor[0, t]
            for a in range(kept.shape[0]):
                x[0, t, a] = x[1, t, a] if accepted else x[0, t, a]
        if step >= chain.burn and (step - chain.burn + 1) % chain.thin == 0:
            for t in range(n):
                for a in range(kept.shape[0]):
                    kept[a, t * chain.samples + (step - chain.burn) // chain.thin] = x[0, t, a]
    return counts
