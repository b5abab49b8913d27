"""Plain twins of the fused filter's kernels: one number at a time, in integers, fractions and double precision."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

WORD = 0xFFFFFFFF


def philox(counter, key, rounds):
    """Philox 4x32 as its authors write it, in Python's integers [Salmon et al. 2011]."""
    c, k = list(counter), list(key)
    for _ in range(rounds):
        a, b = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(b >> 32) ^ c[1] ^ k[0], b & WORD, (a >> 32) ^ c[3] ^ k[1], a & WORD]
        k = [(k[0] + 0x9E3779B9) & WORD, (k[1] + 0xBB67AE85) & WORD]
    return tuple(c)


def unit(word):
    return ((word >> 9) + 0.5) / 2**23


def xoroshiro(a, b):
    """A word of xoroshiro64* and the state after it, as its authors write it [Blackman and Vigna 2021]."""
    word = (a * 0x9E3779BB) & WORD
    b ^= a
    return word, (turned(a, 26) ^ b ^ (b << 9)) & WORD, turned(b, 13)


def turned(word, by):
    return ((word << by) | (word >> (32 - by))) & WORD


def normals(i, block, stage, key):
    """The four normals of particle i of a block [Box and Muller 1958]."""
    words = philox((i % 16, block, stage, 0), key, 7)
    out = []
    for state in (words[:2], words[2:]):
        for _ in range(2 * (i // 16)):
            _, *state = xoroshiro(*state)
        first, *state = xoroshiro(*state)
        second, *_ = xoroshiro(*state)
        radius, angle = math.sqrt(-2 * math.log(unit(first))), 2 * math.pi * unit(second)
        out += [radius * math.cos(angle), radius * math.sin(angle)]
    return out


def move(x, normal, dt, acceleration, resize, smallest, scaled):
    """One box moved by four normals [M09 (11)]."""
    unit_x, unit_y = (max(x[4], smallest), max(x[5], smallest)) if scaled else (1.0, 1.0)
    push = acceleration * math.sqrt(dt) * unit_x * normal[0], acceleration * math.sqrt(dt) * unit_y * normal[1]
    return np.array([
        x[0] + dt * (x[2] + push[0] / 2),
        x[1] + dt * (x[3] + push[1] / 2),
        x[2] + push[0],
        x[3] + push[1],
        smallest + abs(x[4] + resize * math.sqrt(dt) * unit_x * normal[2] - smallest),
        smallest + abs(x[5] + resize * math.sqrt(dt) * unit_y * normal[3] - smallest),
    ])  # fmt: skip


def survives(x, width, height):
    """Whether some of the box lies in the frame."""
    return -x[4] / 2 < x[0] < width + x[4] / 2 and -x[5] / 2 < x[1] < height + x[5] / 2


def distance2(z, x, sigma):
    return sum(((a - b) / s) ** 2 for a, b, s in zip(z, (x[0], x[1], x[4], x[5]), sigma, strict=True))


def likelihood(z, x, sigma):
    """g(z|x) for deviations ``sigma`` of (px, py, w, h)."""
    return math.exp(-0.5 * distance2(z, x, sigma)) / ((2 * math.pi) ** 2 * math.prod(sigma))


def own_sigma(x, spread, floor):
    """Deviations that follow the particle's size."""
    sw, sh = max(spread * x[4], floor), max(spread * x[5], floor)
    return sw / 2, sh / 2, sw, sh


def newborn_weight(x, z, sigma, many, limit, kept, rate, flat):
    """γ(x) / Σ_i J_i p_i(x) [M07 §2]: ``flat`` density of births, or ``rate`` around every detection (flat None)."""
    p = x[0], x[1], x[4], x[5]
    if min(p[2:]) <= 0:
        return 0.0
    proposal, gamma = 0.0, flat or 0.0
    for j in range(z.shape[1]):
        d2 = distance2(z[:, j], x, sigma[:, j])
        if d2 <= limit:
            proposal += many[j] * math.exp(-0.5 * d2) / ((2 * math.pi) ** 2 * math.prod(sigma[:, j])) / kept
        if flat is None:
            zx, zy, w, h = z[:, j]
            near = abs(p[0] - zx) <= w and abs(p[1] - zy) <= h
            if near and w / 2 <= p[2] <= 1.5 * w and h / 2 <= p[3] <= 1.5 * h:
                gamma += rate / (2 * w * 2 * h * w * h)
    return gamma / proposal


def touches(box, lower, upper, j):
    """Whether the closed box (left, top, right, bottom) and rectangle j meet."""
    return lower[0, j] <= box[2] and upper[0, j] >= box[0] and lower[1, j] <= box[3] and upper[1, j] >= box[1]


def neighbours(z, reach, lower, upper, local):
    """For each detection: the gates that its newborn can lie in, and all whose gate, proposal or births can matter."""
    n, out = z.shape[1], []
    for j in range(n):
        box = (*(z[:2, j] - reach[:, j]), *(z[:2, j] + reach[:, j]))
        gates, all_ = set(), set()
        for k in range(n):
            half = [max(reach[a, k], z[2 + a, k]) if local else reach[a, k] for a in (0, 1)]
            low = np.array([[min(z[a, k] - half[a], lower[a, k])] for a in (0, 1)])
            high = np.array([[max(z[a, k] + half[a], upper[a, k])] for a in (0, 1)])
            if touches(box, lower, upper, k):
                gates.add(k)
            if touches(box, low, high, 0):
                all_.add(k)
        out.append((gates, all_))
    return out


def comb(mass, order, count, offset):
    """Teeth of each source, by exact fractions of masses in steps of 2⁻³²; and where each source begins and ends."""
    size = [int(m * 2**32) for m in mass]
    total, reached = sum(size), 0
    teeth, span = {}, {}
    for i in order:
        begin, end = Fraction(reached * count, total), Fraction((reached + size[i]) * count, total)
        teeth[i] = [k for k in range(count) if begin <= k + Fraction(offset) < end]
        span[i] = (float(begin), float(end))
        reached += size[i]
    return teeth, span


def teeth_on(weight, phase, width, teeth):
    """Which point each tooth falls on, teeth at phase, phase + 1, … of a stretch ``width`` wide; and how near to an edge."""
    ends = np.cumsum(np.asarray(weight, np.float64))
    ends *= width / ends[-1]
    at = phase + np.arange(teeth)
    chosen = np.minimum(np.searchsorted(ends, at, side="right"), len(ends) - 1)
    margin = np.abs(at[:, None] - ends[None, :]).min(1)
    return chosen, margin


def account(pairs, alive, unit, base, gains, kappa, p_detect):
    """Evidence and masses from dictionaries: pairs[(block, j)] = Σg, gains[(i, j)] = Σ weight·g by groups of newborn."""
    n = len(kappa)
    evidence = np.zeros(n)
    for (_, j), g in pairs.items():
        evidence[j] += p_detect * unit * g
    for (_, j), groups in gains.items():
        evidence[j] += p_detect * sum(groups)
    weight = np.divide(p_detect, kappa + evidence, out=np.zeros(n), where=kappa + evidence > 0)
    old = (1 - p_detect) * unit * np.array(alive, float)
    for (b, j), g in pairs.items():
        old[b] += unit * weight[j] * g
    new = [(1 - p_detect) * np.array(groups, float) for groups in base]
    for (i, j), groups in gains.items():
        new[i] = new[i] + weight[j] * np.array(groups)
    return evidence, weight, old, new
