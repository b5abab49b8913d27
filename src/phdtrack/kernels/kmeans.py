"""Modified K-means on particles in blocks: assignment, means, and the division of clusters that are too heavy [M07 §3].

Distances are measured in units of the noise at the centre where a cluster began; a new centre takes over those of the
cluster that it divides. A cluster holds particles in a window of positions about the place where it began. Most blocks have
one centre in reach, or lie nearer to it than to any other by all of their box: their sums are known, and none of their
particles is looked at. Only blocks near a centre that has moved are looked at again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phdtrack.kernels.blocks import F8, I8, Blocks, Real, U, add_products, holds, load_steps, reaching, weigh
from phdtrack.kernels.cache import njit
from phdtrack.kernels.em import Candidates
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR
from phdtrack.kernels.grid import Grid
from phdtrack.kernels.mixtures import Gaussians

I4 = NDArray[np.int32]
# A centre that has moved by less than this many deviations has not moved.
STILL = 0.02
# A cluster with less than this share of all mass does not move: the difference of larger sums says nothing of its place.
DUST = 1e-12
# A cluster is not divided any more after this many divisions in which one part got less than this share of the split
# mass: its farthest particles were strays, and peeling them off one by one would not end.
PATIENCE, STRAY = 4, 0.05


class Rule(NamedTuple):
    """``reach``: half a window's side in deviations. ``split``: heavier clusters are divided. ``iterations``: how often a
    centre may move, and again after each division of its cluster."""

    reach: float
    split: float
    iterations: int


class Centres(NamedTuple):
    """k centres: ``at``, ``per`` (k, d) with one over the deviations for distances; ``low``, ``high`` (2, k) windows."""

    at: F8
    per: F8
    low: F8
    high: F8


class Scratch(NamedTuple):
    """Of one block: ``row`` (2e + 4, n), e = d or d + 1 even: steps from the block's middle, distance², the least of them,
    weights, weights of one cluster, and these times the steps; ``which`` (n,) the place in ``among`` (≥ k,) of each
    particle's cluster; ``among`` entries of candidates."""

    row: Real
    which: I4
    among: I8


@njit(**INNER)
def even(d: int) -> int:
    """The rows in which d components are summed, two at a time."""
    return d + d % 2


@njit(**VECTOR)
def _least_excess(at: F8, per: F8, a: int, b: int, low: F8, high: F8, block: int) -> float:
    """The least of |x − c_b|² − |x − c_a|², each in its own deviations, over a block's box: above 0 nothing is nearer to b.

    A sum over components of parabolas, each of which is least at an end of its side or at its vertex.
    """
    total = 0.0
    for r in range(at.shape[1]):
        pa, pb = per[a, r] * per[a, r], per[b, r] * per[b, r]
        ca, cb = at[a, r], at[b, r]
        left, right = low[block, r], high[block, r]
        least = pb * (left - cb) * (left - cb) - pa * (left - ca) * (left - ca)
        at_right = pb * (right - cb) * (right - cb) - pa * (right - ca) * (right - ca)
        least = at_right if at_right < least else least
        if pb > pa:
            vertex = (pb * cb - pa * ca) / (pb - pa)
            if left < vertex < right:
                at_vertex = pb * (vertex - cb) * (vertex - cb) - pa * (vertex - ca) * (vertex - ca)
                least = at_vertex if at_vertex < least else least
        total += least
    return total


@njit(**VECTOR)
def _nearest_middle(at: F8, per: F8, middle: F8, b: int, component: I8, begin: int, end: int) -> int:
    """Which of the entries of a block has the centre nearest to the block's middle; −1 without entries."""
    best, least = begin if end > begin else -1, np.inf
    for e in range(begin, end if end > begin + 1 else begin):
        j, distance2 = component[e], 0.0
        for r in range(at.shape[1]):
            step = (middle[b, r] - at[j, r]) * per[j, r]
            distance2 += step * step
        if distance2 < least:
            best, least = e, distance2
    return best


@njit(**(INNER | {"inline": "always"}))
def _contenders(centres: Centres, blocks: Blocks, near: Candidates, b: int, among: I8) -> tuple[int, bool]:
    """Write the entries of ``near`` that may own a particle of block b into ``among``: how many, and if one owns all."""
    begin, end, kept, whole = near.first[b], near.first[b + 1], 0, False
    best = _nearest_middle(centres.at, centres.per, blocks.middle, b, near.component, begin, end)
    if best >= 0:
        owner = near.component[best]
        whole = holds(centres.low, centres.high, owner, blocks.low, blocks.high, b)
        for e in range(begin, end):
            other = near.component[e]
            if (
                not whole
                or e == best
                or not (_least_excess(centres.at, centres.per, owner, other, blocks.low, blocks.high, b) > 0.0)
            ):
                among[kept] = e
                kept += 1
    return kept, whole and kept == 1


@njit(**(VECTOR | {"inline": "always"}))
def _load(blocks: Blocks, b: int, row: Real) -> int:
    """Write the steps of the particles of block b from its middle, and their weights; gives their number."""
    begin: int = blocks.start[b]
    n: int = blocks.start[b + 1] - begin
    at, w = U(begin), even(blocks.state.shape[0]) + 2
    load_steps(blocks.state, begin, n, blocks.middle, b, row)
    for i in range(U(n)):
        row[w, i] = blocks.weight[0]
    if blocks.weight.size > 1:
        for i in range(U(n)):
            row[w, i] = blocks.weight[at + i]
    return n


@njit(**VECTOR)
def _distances2(row: Real, n: int, middle: F8, b: int, centres: F8, per: F8, j: int) -> None:
    """Write the scaled squared distances of n particles from centre j: two components at a time."""
    e, real, d = even(centres.shape[1]), row.dtype.type, centres.shape[1]
    for r in range(0, d, 2):
        s = r + 1 if r + 1 < d else r
        x, y = real(centres[j, r] - middle[b, r]), real(centres[j, s] - middle[b, s])
        per_x, per_y = real(per[j, r]), real(per[j, s] if s > r else 0.0)
        if r == 0:
            for i in range(U(n)):
                p, q = (row[r, i] - x) * per_x, (row[r + 1, i] - y) * per_y
                row[e, i] = p * p + q * q
        else:
            for i in range(U(n)):
                p, q = (row[r, i] - x) * per_x, (row[r + 1, i] - y) * per_y
                row[e, i] += p * p + q * q


@njit(**VECTOR)
def _only_inside(row: Real, e: int, n: int, left: Real, top: Real, right: Real, bottom: Real) -> None:
    """Make the squared distances of particles outside of a window infinite."""
    beyond = row.dtype.type(np.inf)
    for i in range(U(n)):
        # Read before it is asked for: a reading that depends on a condition becomes a branch.
        now, x, y = row[e, i], row[0, i], row[1, i]
        row[e, i] = now if (x >= left) & (x <= right) & (y >= top) & (y <= bottom) else beyond


@njit(**VECTOR)
def _keep_closer(row: Real, which: I4, e: int, n: int, c: int) -> None:
    """Give the c-th contender the particles that are nearer to it than to those before."""
    name = np.int32(c)
    for i in range(U(n)):
        now, least, before = row[e, i], row[e + 1, i], which[i]
        closer = now < least
        row[e + 1, i] = now if closer else least
        which[i] = name if closer else before


@njit(**(VECTOR | {"inline": "always"}))
def _nearest(blocks: Blocks, b: int, centres: Centres, near: Candidates, some: int, scratch: Scratch) -> int:
    """Load block b and write the nearest of the first ``some`` contenders in whose window each particle is (−1: none)."""
    row, which, e = scratch.row, scratch.which, even(blocks.state.shape[0])
    real = row.dtype.type
    n: int = _load(blocks, b, row)
    row[e + 1, :n], which[:n] = real(np.inf), -1
    for c in range(some):
        j = near.component[scratch.among[c]]
        _distances2(row, n, blocks.middle, b, centres.at, centres.per, j)
        if not holds(centres.low, centres.high, j, blocks.low, blocks.high, b):
            left, right = real(centres.low[0, j] - blocks.middle[b, 0]), real(centres.high[0, j] - blocks.middle[b, 0])
            top, bottom = real(centres.low[1, j] - blocks.middle[b, 1]), real(centres.high[1, j] - blocks.middle[b, 1])
            _only_inside(row, e, n, left, top, right, bottom)
        _keep_closer(row, which, e, n, c)
    return n


@njit(**VECTOR)
def _share(row: Real, which: I4, e: int, n: int, c: int) -> None:
    """Write the weights of the particles of the c-th contender, 0 for the others'."""
    name, nothing = np.int32(c), row.dtype.type(0)
    for i in range(U(n)):
        weight = row[e + 2, i]
        row[e + 3, i] = weight if which[i] == name else nothing


@njit(**VECTOR)
def _sums(row: Real, n: int, out: F8, at: int) -> None:
    """Write Σw and Σw·s of one cluster into row ``at`` of ``out`` (P, 1 + d)."""
    d, total = out.shape[1] - 1, row.dtype.type(0)
    w = even(d) + 3
    for i in range(U(n)):
        total += row[w, i]
    out[at, 0] = total
    for r in range(d):
        total = row.dtype.type(0)
        for i in range(U(n)):
            total += row[w, i] * row[r, i]
        out[at, 1 + r] = total


@njit(**(INNER | {"inline": "always"}))
def _assign(blocks: Blocks, b: int, centres: Centres, near: Candidates, scratch: Scratch, sums: F8) -> None:
    """Give the particles of block b to the nearest centres: mass and Σw·(x − middle) of each of its entries of ``near``."""
    d = blocks.state.shape[0]
    some, whole = _contenders(centres, blocks, near, b, scratch.among)
    sums[near.first[b] : near.first[b + 1]] = 0.0
    if whole:
        e = scratch.among[0]
        sums[e, 0] = blocks.mass[b]
        for r in range(d):
            sums[e, 1 + r] = blocks.first[b, r]
        return
    n = _nearest(blocks, b, centres, near, some, scratch)
    for c in range(some):
        _share(scratch.row, scratch.which, even(d), n, c)
        _sums(scratch.row, n, sums, scratch.among[c])


@njit(**INNER)
def _move(blocks: Blocks, near: Candidates, sums: F8, centres: Centres, mass: F8, steps: I8, moved: I8, limit: int) -> bool:
    """Put the centres that may still move on their means; whether any has. Writes ``mass`` and ``moved`` (k,)."""
    k, d = centres.at.shape
    mean, total = np.zeros((k, d)), 0.0
    for j in range(k):
        mass[j] = 0.0
    for b in range(near.first.size - 1):
        for e in range(near.first[b], near.first[b + 1]):
            j = near.component[e]
            mass[j] += sums[e, 0]
            for r in range(d):
                mean[j, r] += sums[e, 1 + r] + sums[e, 0] * (blocks.middle[b, r] - centres.at[j, r])
    for j in range(k):
        total += mass[j]
    going = False
    for j in range(k):
        away = False
        for r in range(d):
            mean[j, r] = mean[j, r] / mass[j] if mass[j] > DUST * total else 0.0
            away |= abs(mean[j, r]) * centres.per[j, r] > STILL
        moved[j] = 1 if away and steps[j] < limit else 0
        steps[j] += moved[j]
        for r in range(d if moved[j] else 0):
            centres.at[j, r] += mean[j, r]
        going |= moved[j] == 1
    return going


@njit(**INNER)
def _settle(
    blocks: Blocks, near: Candidates, centres: Centres, moved: I8, steps: I8, limit: int, scratch: Scratch, sums: F8
) -> F8:  # fmt: skip
    """Assignment and means in turn until no centre moves, each ``limit`` times at most: (k,) the masses of the clusters.

    ``moved`` (k,): whose blocks are to be looked at first. ``sums`` (P, 1 + d) of the entries of ``near`` are kept up.
    """
    mass, going = np.empty(moved.size), True
    while going:
        for b in range(near.first.size - 1):
            changed = 0
            for e in range(near.first[b], near.first[b + 1]):
                changed |= moved[near.component[e]]
            if changed:
                _assign(blocks, b, centres, near, scratch, sums)
        going = _move(blocks, near, sums, centres, mass, steps, moved, limit)
    return mass


@njit(**INNER)
def _farthest(blocks: Blocks, near: Candidates, centres: Centres, heavy: I8, scratch: Scratch) -> I8:
    """(k,) of each ``heavy`` cluster the particle farthest from its centre; −1 of the others, or where all are there."""
    k, d = centres.at.shape
    row, apart, far, least = scratch.row, np.zeros(k), np.full(k, -1), even(d) + 1
    for b in range(near.first.size - 1):
        concerned = 0
        for e in range(near.first[b], near.first[b + 1]):
            concerned |= heavy[near.component[e]]
        if not concerned:
            continue
        some, _ = _contenders(centres, blocks, near, b, scratch.among)
        n = _nearest(blocks, b, centres, near, some, scratch)
        for i in range(n):
            j = near.component[scratch.among[scratch.which[i]]] if scratch.which[i] >= 0 else -1
            if j >= 0 and heavy[j] and row[least, i] > apart[j]:
                apart[j], far[j] = row[least, i], blocks.start[b] + i
    return far


@njit(**INNER)
def _begun(at: F8, per: F8, reach: float) -> Centres:
    """Centres with windows about where they are."""
    low, high = np.empty((2, at.shape[0])), np.empty((2, at.shape[0]))
    for j in range(at.shape[0]):
        for r in range(2):
            low[r, j], high[r, j] = at[j, r] - reach / per[j, r], at[j, r] + reach / per[j, r]
    return Centres(at, per, low, high)


@njit(**INNER)
def _divided(blocks: Blocks, centres: Centres, far: I8, parent: I8, reach: float) -> Centres:
    """The centres, and new ones on the particles ``far`` of the clusters ``parent``."""
    d = centres.at.shape[1]
    at, per = np.empty((parent.size, d)), np.empty((parent.size, d))
    for c in range(parent.size):
        for r in range(d):
            at[c, r], per[c, r] = blocks.state[r, far[parent[c]]], centres.per[parent[c], r]
    new = _begun(at, per, reach)
    return Centres(
        np.concatenate((centres.at, at)),
        np.concatenate((centres.per, per)),
        np.concatenate((centres.low, new.low), axis=1),
        np.concatenate((centres.high, new.high), axis=1),
    )


@njit(**INNER)
def _grown(sums: F8, old: Candidates, new: Candidates) -> F8:
    """The sums of entries where new centres stand behind the old ones of each block."""
    out = np.zeros((new.component.size, sums.shape[1]))
    for b in range(old.first.size - 1):
        for e in range(old.first[b + 1] - old.first[b]):
            out[new.first[b] + e] = sums[old.first[b] + e]
    return out


@njit(**INNER)
def _with_zeros(numbers: I8, size: int) -> I8:
    """The numbers, followed by zeros."""
    out = np.zeros(size, np.int64)
    out[: numbers.size] = numbers
    return out


@njit(**INNER)
def _moments(blocks: Blocks, near: Candidates, centres: Centres, scratch: Scratch, sums: F8) -> Gaussians:
    """Masses, means and covariances of the clusters, of which ``sums`` are known; one without particles keeps its centre."""
    k, d = centres.at.shape
    row, e = scratch.row, even(d)
    mean, mass, first, cov = centres.at.T.copy(), np.zeros(k), np.zeros((k, d)), np.zeros((k, d, d))
    second, shift = np.empty((d, d)), np.empty(d)
    for b in range(near.first.size - 1):
        some, whole = _contenders(centres, blocks, near, b, scratch.among)
        if some == 0:
            continue
        n = _load(blocks, b, row) if whole else _nearest(blocks, b, centres, near, some, scratch)
        if whole:
            scratch.which[:n] = 0
        for c in range(some):
            at, j = scratch.among[c], near.component[scratch.among[c]]
            m = sums[at, 0]
            if not m > 0.0:
                continue
            second[:] = 0.0
            if whole and blocks.weight.size == 1:
                add_products(row, 0, n, second)
                second *= float(blocks.weight[0])
            else:
                _share(row, scratch.which, e, n, c)
                weigh(row, e + 3, n, d)
                add_products(row, e + 4, n, second)
            mass[j] += m
            for r in range(d):
                shift[r] = blocks.middle[b, r] - mean[r, j]
                first[j, r] += sums[at, 1 + r] + m * shift[r]
                for q in range(r + 1):
                    cov[j, r, q] += second[r, q] + sums[at, 1 + r] * shift[q] + shift[r] * (sums[at, 1 + q] + m * shift[q])
    for j in range(k):
        for r in range(d if mass[j] > 0.0 else 0):
            first[j, r] /= mass[j]
            mean[r, j] += first[j, r]
            for q in range(r + 1):
                cov[j, r, q] = cov[j, r, q] / mass[j] - first[j, r] * first[j, q]
                cov[j, q, r] = cov[j, r, q]
    return Gaussians(mass, mean, cov)


@njit(**(ENTRY | {"fastmath": FAST}))
def kmeans(blocks: Blocks, grid: Grid, centres: F8, scales: F8, rule: Rule) -> Gaussians:
    """Masses, means and covariances of the clusters that start at k centres.

    Parameters
    ----------
    blocks, grid : the particles, and the grid over their blocks' boxes.
    centres, scales : (k, d) where clusters start, and the deviations for distances from them.
    rule : windows, division and number of iterations.
    """
    widest, k = max(np.max(np.diff(blocks.start)), 1), centres.shape[0]
    row, which = np.zeros((2 * even(centres.shape[1]) + 4, widest), blocks.state.dtype), np.empty(widest, np.int32)
    now, steps, strays = _begun(centres.copy(), 1.0 / scales, rule.reach), np.zeros(k, np.int64), np.zeros(k, np.int64)
    near, moved = reaching(blocks, grid, now.low, now.high), np.ones(k, np.int64)
    sums, parent = np.zeros((near.component.size, 1 + centres.shape[1])), np.empty(0, np.int64)
    far = parent
    for turn in range(1 + int(np.ceil(2.0 * blocks.mass.sum() / rule.split))):
        if turn > 0:
            now, before = _divided(blocks, now, far, parent, rule.reach), near
            near, k = reaching(blocks, grid, now.low, now.high), now.at.shape[0]
            sums, strays, steps = _grown(sums, before, near), _with_zeros(strays, k), _with_zeros(steps, k)
            steps[parent], moved = 0, _with_zeros(moved, k)
            moved[k - parent.size :] = 1
        scratch = Scratch(row, which, np.empty(k, np.int64))
        mass = _settle(blocks, near, now, moved, steps, rule.iterations, scratch, sums)
        for c in range(parent.size):
            i, j = parent[c], k - parent.size + c
            if max(mass[i], mass[j]) > rule.split and min(mass[i], mass[j]) < STRAY * rule.split:
                strays[i] += 1
                strays[j] = strays[i]
        heavy = ((mass > rule.split) & (strays < PATIENCE)).astype(np.int64)
        far = _farthest(blocks, near, now, heavy, scratch)
        parent = np.flatnonzero(far >= 0)
        if parent.size == 0:
            break
    out: Gaussians = _moments(blocks, near, now, scratch, sums)
    return out
