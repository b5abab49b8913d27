"""Plain twins of the fused filter's kernels: one number at a time, in integers, fractions and
double precision.
"""

from __future__ import annotations

import math

WORD = 0xFFFFFFFF


def philox(counter, key, rounds):
    """Philox 4x32 as its authors write it, in Python's integers [Salmon et al. 2011]."""
    c = list(counter)
    k = list(key)
    for _ in range(rounds):
        a = 0xD2511F53 * c[0]
        b = 0xCD9E8D57 * c[2]
        c = [(b >> 32) ^ c[1] ^ k[0], b & WORD, (a >> 32) ^ c[3] ^ k[1], a & WORD]
        k = [(k[0] + 0x9E3779B9) & WORD, (k[1] + 0xBB67AE85) & WORD]
    return tuple(c)


def unit(word):
    return ((word >> 9) + 0.5) / 2**23


def xoroshiro(a, b):
    """A word of xoroshiro64* and the state after it, as its authors write it [Blackman and Vigna
    2021].
    """
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
        radius = math.sqrt(-2 * math.log(unit(first)))
        angle = 2 * math.pi * unit(second)
        out += [radius * math.cos(angle), radius * math.sin(angle)]
    return out
