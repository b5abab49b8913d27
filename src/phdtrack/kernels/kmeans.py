"""Modified K-means on particles in blocks: assignment, means, and the division of clusters that are
too heavy [M07 §3].

Distances are in units of the noise at the centre where a cluster began; a new centre inherits the
units of the cluster that it divides. A cluster holds particles in a window of positions about the
place where it began. Most blocks have one centre in reach, or lie nearer to it than to any other
with all of their box: their sums are known, and none of their particles is visited. Only blocks
near a centre that has moved are visited again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phdtrack.kernels import F8, I4, I8, Real
from phdtrack.kernels.cache import njit
from phdtrack.kernels.fast32 import ENTRY, FAST, INNER, VECTOR, whole
from phdtrack.kernels.mixtures import Candidates, Gaussians
from phdtrack.kernels.particle_blocks import (
    Blocks,
    U,
    add_products,
    load_row,
    load_steps,
    reaching,
    weigh,
)
from phdtrack.kernels.small_arrays import copy_into, copy_rows

# A centre that has moved by less than this many deviations has not moved.
STILL = 0.02
# A cluster with less than this share of all mass does not move: its sums are differences of larger
# ones, mere rounding.
DUST = 1e-12
# A cluster is divided no more after this many divisions in which one part got less than this share
# of the split mass: its farthest particles were strays, and peeling them off one by one would not
# end.
PATIENCE = 4
STRAY = 0.05
# Pairs of a block and a centre in its reach after which nothing is divided any more: hundreds of
# targets in one heap.
MOST_PAIRS = 400_000
# Rounds of divisions of a rule that divides until all clusters are light; each adds a centre to
# every heavy one.
MOST_ROUNDS = 200


class Rule(NamedTuple):
    """``reach``: half a window's side in deviations. ``split``: heavier clusters are divided.
    ``iterations``: how often a centre may move, and again after each division of its cluster.
    ``until_light``: divide until no cluster is heavier, whatever the parts are."""

    reach: float
    split: float
    iterations: int
    until_light: bool = False


class Centres(NamedTuple):
    """k centres: ``at``, ``per`` (k, d) with one over the deviations for distances; ``window`` (4,
    k): left, top, right and bottom of each one's window."""

    at: F8
    per: F8
    window: F8


class Scratch(NamedTuple):
    """Working space for one block, in whole vector registers.

    ``row`` (2e + 4, n), e = d or d + 1 even: steps from the block's middle, distance², the least of
    them, weights, weights of one cluster, and these times the steps; ``which`` (n,) the index in
    ``among`` of each particle's cluster; ``among`` (2, ≥ k): entries of candidates and their
    centres.
    """

    row: Real
    which: I4
    among: I8


@njit(**INNER)
def even(d: int) -> int:
    """The rows in which d components are summed, two at a time."""
    return d + d % 2


@njit(**VECTOR)
def _least_excess(at: F8, per: F8, a: int, b: int, box: F8, block: int) -> float:
    """The least of |x − c_b|² − |x − c_a|², each in its own deviations, over a block's box: above 0
    nothing is nearer to b.

    A sum over components of parabolas, each of which is least at an end of its side or at its
    vertex.
    """
    total = 0.0
    i = U(a)
    j = U(b)
    p = U(block)
    for r in range(U(at.shape[1])):
        pa = per[i, r] * per[i, r]
        pb = per[j, r] * per[j, r]
        ca = at[i, r]
        cb = at[j, r]
        left = box[p, U(0), r]
        right = box[p, U(1), r]
        # Without a branch, which would be mispredicted; NaN, or a vertex outside, becomes an end.
        vertex = min(right, max(left, (pb * cb - pa * ca) / (pb - pa)))
        at_left = pb * (left - cb) * (left - cb) - pa * (left - ca) * (left - ca)
        at_right = pb * (right - cb) * (right - cb) - pa * (right - ca) * (right - ca)
        at_vertex = pb * (vertex - cb) * (vertex - cb) - pa * (vertex - ca) * (vertex - ca)
        total += min(at_left, at_right, at_vertex)
    return total


@njit(**VECTOR)
def _contenders(
    at: F8, per: F8, window: F8, box: F8, component: I8, begin: int, end: int, b: int, among: I8
) -> tuple[int, bool]:
    """Write the entries that may own a particle of block b, and their centres, into ``among``.

    Returns how many there are, and whether one owns all particles. ``box`` (B, 3, d): the blocks'
    corners and middles; ``component``: the centres of the entries.
    """
    best = begin
    least = np.inf
    kept = 0
    for e in range(begin, end):
        j = U(component[e])
        distance2 = 0.0
        for r in range(U(at.shape[1])):
            step = (box[U(b), U(2), r] - at[j, r]) * per[j, r]
            distance2 += step * step
        if distance2 < least:
            best = e
            least = distance2
    if end == begin:
        return 0, False
    owner = component[best]
    held = _holds(window, owner, box, b)
    for e in range(begin, end):
        if not held or e == best or not (_least_excess(at, per, owner, component[e], box, b) > 0.0):
            among[0, kept] = e
            among[1, kept] = component[e]
            kept += 1
    return kept, held and kept == 1


@njit(**VECTOR)
def _holds(window: F8, j: int, box: F8, b: int) -> bool:
    """True if window j contains all of block b."""
    across: bool = (window[0, j] <= box[b, 0, 0]) & (box[b, 1, 0] <= window[2, j])
    along: bool = (window[1, j] <= box[b, 0, 1]) & (box[b, 1, 1] <= window[3, j])
    return across & along


@njit(**VECTOR)
def _load(state: Real, weight: Real, start: I8, box: F8, b: int, row: Real) -> int:
    """Write the steps of the particles of block b from its middle, and their weights, in whole
    registers; returns how many numbers that are.
    """
    begin: int = start[b]
    n = start[b + 1] - begin
    w = even(state.shape[0]) + 2
    full: int = load_steps(state, begin, n, box[b, 2], row)
    if weight.size > 1:
        load_row(row, w, n, weight, begin)
    else:
        for i in range(U(n)):
            row[w, i] = weight[0]
        for i in range(U(n), U(full)):
            row[w, i] = row.dtype.type(0)
    return full


@njit(**VECTOR)
def _distances2(row: Real, n: int, box: F8, b: int, centres: F8, per: F8, j: int) -> None:
    """Write the scaled squared distances of n particles from centre j: two components at a time."""
    e = even(centres.shape[1])
    real = row.dtype.type
    d = centres.shape[1]
    for r in range(0, d, 2):
        s = r + 1 if r + 1 < d else r
        x = real(centres[j, r] - box[b, 2, r])
        y = real(centres[j, s] - box[b, 2, s])
        per_x = real(per[j, r])
        per_y = real(per[j, s] if s > r else 0.0)
        if r == 0:
            for i in range(U(n)):
                p = (row[r, i] - x) * per_x
                q = (row[r + 1, i] - y) * per_y
                row[e, i] = p * p + q * q
        else:
            for i in range(U(n)):
                p = (row[r, i] - x) * per_x
                q = (row[r + 1, i] - y) * per_y
                row[e, i] += p * p + q * q


@njit(**VECTOR)
def _only_inside(
    row: Real, e: int, n: int, left: Real, top: Real, right: Real, bottom: Real
) -> None:
    """Make the squared distances of particles outside of a window infinite."""
    beyond = row.dtype.type(np.inf)
    for i in range(U(n)):
        # Read before it is asked for: a reading that depends on a condition becomes a branch.
        now = row[e, i]
        x = row[0, i]
        y = row[1, i]
        row[e, i] = now if (x >= left) & (x <= right) & (y >= top) & (y <= bottom) else beyond


@njit(**VECTOR)
def _keep_closer(row: Real, which: I4, e: int, n: int, c: int) -> None:
    """Give the c-th contender the particles that are nearer to it than to those before."""
    name = np.int32(c)
    for i in range(U(n)):
        now = row[e, i]
        least = row[e + 1, i]
        before = which[i]
        closer = now < least
        row[e + 1, i] = now if closer else least
        which[i] = name if closer else before


@njit(**VECTOR)
def _nearest(
    row: Real, which: I4, n: int, at: F8, per: F8, window: F8, box: F8, among: I8, some: int, b: int
) -> None:
    """Write the nearest of the first ``some`` contenders whose window contains each of n loaded
    particles (−1: none).
    """
    e = even(at.shape[1])
    real = row.dtype.type
    none = np.int32(-1)
    x = box[b, 2, 0]
    y = box[b, 2, 1]
    for i in range(U(n)):
        row[e + 1, i] = real(np.inf)
        which[i] = none
    for c in range(some):
        j = among[1, c]
        _distances2(row, n, box, b, at, per, j)
        if not _holds(window, j, box, b):
            left = real(window[0, j] - x)
            right = real(window[2, j] - x)
            _only_inside(row, e, n, left, real(window[1, j] - y), right, real(window[3, j] - y))
        _keep_closer(row, which, e, n, c)


@njit(**VECTOR)
def _all_equal(which: I4, n: int) -> bool:
    """True if n particles have the same cluster."""
    differs = np.int32(0)
    first = which[0]
    for i in range(U(n)):
        differs |= which[i] ^ first
    equal: bool = differs == 0
    return equal


@njit(**VECTOR)
def _share(row: Real, which: I4, e: int, n: int, c: int) -> None:
    """Write the weights of the particles of the c-th contender, 0 for the others'."""
    name = np.int32(c)
    nothing = row.dtype.type(0)
    for i in range(U(n)):
        weight = row[e + 2, i]
        row[e + 3, i] = weight if which[i] == name else nothing


@njit(**VECTOR)
def _sums(row: Real, n: int, out: F8, at: int) -> None:
    """Write Σw and Σw·s of one cluster into row ``at`` of ``out`` (P, 1 + d)."""
    d = out.shape[1] - 1
    total = row.dtype.type(0)
    w = even(d) + 3
    for i in range(U(n)):
        total += row[w, i]
    out[at, 0] = total
    for r in range(d):
        total = row.dtype.type(0)
        for i in range(U(n)):
            total += row[w, i] * row[r, i]
        out[at, 1 + r] = total


@njit(**INNER)
def _move(
    box: F8,
    near: Candidates,
    sums: F8,
    centres: Centres,
    mass: F8,
    steps: I8,
    moved: I8,
    stale: I8,
    limit: int,
) -> bool:
    """Move the ``stale`` centres that may still move to their means; True if any has moved. Writes
    ``mass``, ``moved`` (k,).
    """
    at = centres.at
    per = centres.per
    first = near.first
    component = near.component
    k, d = at.shape
    mean = np.zeros((k, d))
    going = False
    for j in range(k):
        if stale[j]:
            mass[j] = 0.0
    for b in range(first.size - 1):
        for e in range(first[b], first[b + 1]):
            j = component[e]
            m = sums[e, 0]
            if stale[j]:
                mass[j] += m
                for r in range(d):
                    mean[j, r] += sums[e, 1 + r] + m * (box[b, 2, r] - at[j, r])
    least = DUST * mass.sum()
    for j in range(k):
        away = False
        for r in range(d):
            mean[j, r] = mean[j, r] / mass[j] if mass[j] > least else 0.0
            away |= abs(mean[j, r]) * per[j, r] > STILL
        moved[j] = away and steps[j] < limit
        if moved[j]:
            steps[j] += 1
            for r in range(d):
                at[j, r] += mean[j, r]
            going = True
        stale[j] = 0
    return going


@njit(**INNER)
def _assign(
    blocks: Blocks,
    box: F8,
    near: Candidates,
    centres: Centres,
    moved: I8,
    stale: I8,
    scratch: Scratch,
    sums: F8,
) -> None:
    """Assign the particles of blocks near a centre that has ``moved`` to the nearest centres.

    Writes the ``sums`` of these blocks' entries, and 1 for their centres into ``stale``.
    """
    at, per, window = centres
    row, which, among = scratch
    first = near.first
    component = near.component
    state = blocks.state
    weight = blocks.weight
    start = blocks.start
    mass = blocks.mass
    block_first = blocks.first
    d = state.shape[0]
    for b in range(first.size - 1):
        begin = first[b]
        end = first[b + 1]
        changed = 0
        for e in range(begin, end):
            changed |= moved[component[e]]
        # Windows do not move: what lies in the only one that reaches a block is its centre's for
        # good.
        if changed == 0 or (end == begin + 1 and sums[begin, 0] > 0.0):
            continue
        some, owned = _contenders(at, per, window, box, component, begin, end, b, among)
        owner = 0
        n = 0
        if not owned:
            n = _load(state, weight, start, box, b, row)
            _nearest(row, which, n, at, per, window, box, among, some, b)
            owner = which[0]
            owned = which[0] >= 0 and _all_equal(which, n)
        for e in range(begin, end):
            stale[component[e]] = 1
            for r in range(1 + d):
                sums[e, r] = 0.0
        if owned:
            sums[among[0, owner], 0] = mass[b]
            for r in range(d):
                sums[among[0, owner], 1 + r] = block_first[b, r]
            continue
        for c in range(some):
            _share(row, which, even(d), n, c)
            _sums(row, n, sums, among[0, c])


@njit(**INNER)
def _settle(
    blocks: Blocks,
    box: F8,
    near: Candidates,
    centres: Centres,
    moved: I8,
    steps: I8,
    limit: int,
    scratch: Scratch,
    sums: F8,
) -> F8:
    """Assign particles and move centres in turn until no centre moves, each at most ``limit``
    times: (k,) the masses of the clusters.

    ``moved`` (k,): centres whose blocks are visited first. ``sums`` (P, 1 + d), mass and Σw·(x −
    middle) of the entries of ``near``, are kept up to date.
    """
    mass = np.empty(moved.size)
    stale = np.ones(moved.size, np.int64)
    going = True
    while going:
        _assign(blocks, box, near, centres, moved, stale, scratch, sums)
        going = _move(box, near, sums, centres, mass, steps, moved, stale, limit)
    return mass


@njit(**INNER)
def _farthest(
    blocks: Blocks, box: F8, near: Candidates, centres: Centres, heavy: I8, scratch: Scratch
) -> I8:
    """(k,) the particle farthest from the centre of each ``heavy`` cluster; −1 for the others, or
    if all are at the centre.
    """
    at, per, window = centres
    row, which, among = scratch
    start, first, component = near
    k, d = at.shape
    apart = np.zeros(k)
    far = np.full(k, -1)
    least = even(d) + 1
    for b in range(first.size - 1):
        concerned = 0
        for e in range(first[b], first[b + 1]):
            concerned |= heavy[component[e]]
        if not concerned:
            continue
        some, _ = _contenders(at, per, window, box, component, first[b], first[b + 1], b, among)
        n = _load(blocks.state, blocks.weight, start, box, b, row)
        _nearest(row, which, n, at, per, window, box, among, some, b)
        for i in range(start[b + 1] - start[b]):
            if which[i] < 0:
                continue
            j = among[1, which[i]]
            if heavy[j] and row[least, i] > apart[j]:
                apart[j] = row[least, i]
                far[j] = start[b] + i
    return far


@njit(**INNER)
def _begun(at: F8, per: F8, reach: float) -> Centres:
    """Centres with windows about where they are."""
    window = np.empty((4, at.shape[0]))
    for r in range(2):
        window[r] = at[:, r] - reach / per[:, r]
        window[2 + r] = at[:, r] + reach / per[:, r]
    return Centres(at, per, window)


@njit(**INNER)
def _divided(blocks: Blocks, centres: Centres, far: I8, parent: I8, reach: float) -> Centres:
    """New centres on the particles ``far`` of the clusters ``parent``."""
    at = np.empty((parent.size, centres.at.shape[1]))
    for c in range(parent.size):
        for r in range(at.shape[1]):
            at[c, r] = blocks.state[r, far[parent[c]]]
    out: Centres = _begun(at, centres.per[parent], reach)
    return out


@njit(**INNER)
def _grown(old: Candidates, sums: F8, new: Candidates, k: int) -> tuple[Candidates, F8]:
    """The entries of each block and their sums, with those of new centres, from number k on, behind
    them.
    """
    first = old.first + new.first
    component = np.empty(first[-1], np.int64)
    out = np.zeros((first[-1], sums.shape[1]))
    for b in range(first.size - 1):
        at = first[b]
        for e in range(old.first[b], old.first[b + 1]):
            component[at] = old.component[e]
            out[at] = sums[e]
            at += 1
        for e in range(new.first[b], new.first[b + 1]):
            component[at] = k + new.component[e]
            at += 1
    return Candidates(old.start, first, component), out


@njit(**INNER)
def _with_zeros(numbers: I8, size: int) -> I8:
    """The numbers, followed by zeros."""
    out = np.zeros(size, np.int64)
    copy_into(numbers, out)
    return out


@njit(**INNER)
def _products(row: Real, which: I4, n: int, c: int, out: F8) -> None:
    """Write the lower triangle of Σ w·s·sᵀ over the particles of the c-th contender."""
    e = even(len(out))
    out[:] = 0.0
    _share(row, which, e, n, c)
    weigh(row, e + 3, n, len(out))
    add_products(row, e + 4, n, out)


@njit(**INNER)
def _with_mass(sums: F8, component: I8, begin: int, end: int, among: I8) -> int:
    """Write the entries with mass, and their centres, into ``among``; returns their number."""
    some = 0
    for e in range(begin, end):
        if sums[e, 0] > 0.0:
            among[0, some] = e
            among[1, some] = component[e]
            some += 1
    return some


@njit(**INNER)
def _moments(
    blocks: Blocks, box: F8, near: Candidates, centres: Centres, scratch: Scratch, sums: F8
) -> Gaussians:
    """Masses, means and covariances of the clusters with these ``sums``; one without particles
    keeps its centre.
    """
    at, per, window = centres
    row, which, among = scratch
    start, near_first, component = near
    k, d = at.shape
    mean = at.T.copy()
    mass = np.zeros(k)
    first = np.zeros((k, d))
    cov = np.zeros((k, d, d))
    part = np.empty((d, d))
    shift = np.empty(d)
    for b in range(near_first.size - 1):
        begin = near_first[b]
        end = near_first[b + 1]
        n = 0
        some = _with_mass(sums, component, begin, end, among)
        owned = some == 1 and sums[among[0, 0], 0] == blocks.mass[b]
        if some > 0 and not owned:
            some, _ = _contenders(at, per, window, box, component, begin, end, b, among)
            n = _load(blocks.state, blocks.weight, start, box, b, row)
            _nearest(row, which, n, at, per, window, box, among, some, b)
        for c in range(some):
            entry = among[0, c]
            j = among[1, c]
            second = blocks.second[b]
            m = sums[entry, 0]
            if not m > 0.0:
                continue
            if not owned:
                second = part
                _products(row, which, n, c, part)
            mass[j] += m
            for r in range(d):
                shift[r] = box[b, 2, r] - mean[r, j]
                one = sums[entry, 1 + r]
                first[j, r] += one + m * shift[r]
                for q in range(r + 1):
                    cov[j, r, q] += (
                        second[r, q]
                        + one * shift[q]
                        + shift[r] * (sums[entry, 1 + q] + m * shift[q])
                    )
    _centre(mass, first, mean, cov)
    return Gaussians(mass, mean, cov)


@njit(**INNER)
def _centre(mass: F8, first: F8, mean: F8, cov: F8) -> None:
    """Turn sums about the old means into means and covariances, in place."""
    d = len(mean)
    for j in range(mass.size):
        for r in range(d if mass[j] > 0.0 else 0):
            first[j, r] /= mass[j]
            mean[r, j] += first[j, r]
            for q in range(r + 1):
                cov[j, r, q] = cov[j, r, q] / mass[j] - first[j, r] * first[j, q]
                cov[j, q, r] = cov[j, r, q]


@njit(**INNER)
def _joined(old: Centres, new: Centres) -> Centres:
    """The old centres, then the new ones."""
    at = np.concatenate((old.at, new.at))
    per = np.concatenate((old.per, new.per))
    return Centres(at, per, np.concatenate((old.window, new.window), axis=1))


@njit(**VECTOR)
def _count_strays(mass: F8, parent: I8, strays: I8, split: float) -> None:
    """Count divisions in which one part got next to nothing of a heavy cluster.

    The parts of the clusters ``parent`` are the last ones, in their order.
    """
    for c in range(parent.size):
        i = parent[c]
        j = mass.size - parent.size + c
        if max(mass[i], mass[j]) > split and min(mass[i], mass[j]) < STRAY * split:
            strays[i] += 1
            strays[j] = strays[i]


@njit(**INNER)
def _most_rounds(rule: Rule, mass: float) -> int:
    """The largest number of rounds of divisions for particles of this mass."""
    if rule.until_light:
        return MOST_ROUNDS
    return 1 + int(np.ceil(2.0 * mass / rule.split))


@njit(**INNER)
def _to_divide(mass: F8, strays: I8, rule: Rule) -> I8:
    """(k,) 1 for the clusters that are to be divided."""
    patient = (strays < PATIENCE) | rule.until_light
    return ((mass > rule.split) & patient).astype(np.int64)


@njit(**(ENTRY | {"fastmath": FAST}))
def kmeans(blocks: Blocks, centres: F8, scales: F8, rule: Rule) -> Gaussians:
    """Masses, means and covariances of the clusters that start at k ``centres`` (k, d).

    ``scales`` (k, d): the deviations that are the units of distances from them.
    """
    widest = whole(max(np.max(np.diff(blocks.start)), 1))
    k = centres.shape[0]
    d = centres.shape[1]
    row = np.zeros((2 * even(d) + 4, widest), blocks.state.dtype)
    which = np.empty(widest, np.int32)
    box = np.empty((blocks.mass.size, 3, d))
    copy_rows(blocks.low, box[:, 0])
    copy_rows(blocks.high, box[:, 1])
    copy_rows(blocks.middle, box[:, 2])
    now = _begun(centres.copy(), 1.0 / scales, rule.reach)
    steps = np.zeros(k, np.int64)
    strays = np.zeros(k, np.int64)
    near = reaching(blocks, now.window[:2], now.window[2:])
    moved = np.ones(k, np.int64)
    sums = np.zeros((near.component.size, 1 + d))
    parent = np.empty(0, np.int64)
    far = parent
    pairs = 0 * k
    for turn in range(_most_rounds(rule, blocks.mass.sum())):
        if turn > 0:
            # Divide the heavy clusters at their farthest particles.
            new = _divided(blocks, now, far, parent, rule.reach)
            near, sums = _grown(near, sums, reaching(blocks, new.window[:2], new.window[2:]), k)
            now = _joined(now, new)
            k += parent.size
            strays = _with_zeros(strays, k)
            steps = _with_zeros(steps, k)
            steps[parent] = 0
            moved = _with_zeros(moved, k)
            moved[k - parent.size :] = 1
        scratch = Scratch(row, which, np.empty((2, k), np.int64))
        mass = _settle(blocks, box, near, now, moved, steps, rule.iterations, scratch, sums)
        _count_strays(mass, parent, strays, rule.split)
        heavy = _to_divide(mass, strays, rule)
        far = _farthest(blocks, box, near, now, heavy, scratch)
        parent = np.flatnonzero(far >= 0)
        pairs += near.component.size
        if parent.size == 0 or (pairs > MOST_PAIRS and not rule.until_light):
            break
    out: Gaussians = _moments(blocks, box, near, now, scratch, sums)
    return out
