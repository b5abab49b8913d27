"""The chains of the MCMC filter again, in plain Python: the same numbers from the same generator."""

from __future__ import annotations

import itertools

import numpy as np


def penalty(a: np.ndarray, b: np.ndarray, boxes: bool) -> float:
    """Of two rows of places."""
    if not boxes:
        return float(np.exp(-0.5 * ((a[:2] - b[:2]) ** 2).sum()))
    side = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    if (side <= 0).any():
        return 0.0
    shared = side.prod()
    return float(shared / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - shared))


def total_penalty(place: np.ndarray, boxes: bool) -> float:
    """Of all pairs of rows."""
    return sum(penalty(a, b, boxes) for a, b in itertools.combinations(place, 2))


def independent_chain(target, weight, height, start, place, strength, boxes, greedy, keep):
    """Accept or reject proposals, each for one target."""
    n, now, cached = len(start), list(range(len(start))), list(start)
    kept, accepted = [], 0
    for s, t in enumerate(target):
        ratio = weight[s] - cached[t]
        if strength:
            trial = now.copy()
            trial[t] = n + s
            ratio -= strength * (total_penalty(place[trial], boxes) - total_penalty(place[now], boxes))
        if ratio >= (0 if greedy else height[s]):
            now[t], cached[t], accepted = n + s, weight[s], accepted + 1
        elif greedy:
            cached[t] = ratio
        if s >= keep[0] and (s - keep[0] + 1) % keep[1] == 0:
            kept.append(now.copy())
    return np.array(kept, np.int64).reshape(-1, n).T, accepted


def linear_chain(origin, z, inverse, step, root, running, log_proposal, switch, keep, rng):
    """The kept samples (d, n, N), and the counts."""
    d, n = len(origin), z.shape[1]
    before = origin.reshape(d, n, -1)
    precision = [np.array([[a, b], [b, c]]) for a, b, c in inverse]

    def moved(t: int, r: int) -> np.ndarray:
        return step @ before[:, t, r] + root @ np.array([rng.standard_normal() for _ in range(d)])

    def fit(t: int, x: np.ndarray) -> float:
        apart = z[:, t] - x[:2]
        return -0.5 * apart @ precision[t] @ apart

    def ancestor_drawn() -> int:
        return int(np.searchsorted(running, rng.random() * running[-1], side="right"))

    def accepted(gain: float) -> bool:
        return gain >= 0 or rng.random() < np.exp(gain)

    counts, kept = np.zeros((2, 2), np.int64), []
    r = ancestor_drawn()
    now = [moved(t, r) for t in range(n)]
    for s, switching in enumerate(switch):
        counts[int(switching), 0] += 1
        if switching:
            other = ancestor_drawn()
            new = [moved(t, other) for t in range(n)]
            gain = sum(fit(t, new[t]) - fit(t, now[t]) for t in range(n)) + log_proposal[r] - log_proposal[other]
            if accepted(gain):
                now, r = new, other
                counts[1, 1] += 1
        else:
            t = int(rng.random() * n)
            new = moved(t, r)
            if accepted(fit(t, new) - fit(t, now[t])):
                now[t] = new
                counts[0, 1] += 1
        if s >= keep[0] and (s - keep[0] + 1) % keep[1] == 0:
            kept.append(np.stack(now, axis=1))
    return np.stack(kept, axis=2), counts


def option_tables(candidate, which, weight, absent):
    """For each candidate a list of options (measurement, weight, [(entry, running sum)]), the first that he is not there."""
    out = []
    for c, gone in enumerate(absent):
        options = [(-1, gone, [])]
        own = np.flatnonzero(candidate == c)
        for j in sorted(set(which[own].tolist())):
            entries = own[which[own] == j]
            options.append((j, weight[entries].sum(), list(zip(entries, np.cumsum(weight[entries]), strict=True))))
        out.append(options)
    return out


class JumpChain:
    """The chain over existence, association and states; see `kernels.mcmc.jump_chain` for what the arguments are."""

    def __init__(self, old, measurements, options, member, place, strength, boxes, rng):
        self.old, self.options, self.member, self.place = old, options, member, place
        self.strength, self.boxes, self.rng = strength, boxes, rng
        self.option = [0] * len(options)
        self.state = [-1] * len(options)
        self.counts = np.zeros((7, 2), np.int64)

    def holders(self, *besides):
        """Measurements that others hold."""
        return {self.options[c][o][0] for c, o in enumerate(self.option) if c not in besides} - {-1}

    def weights(self, c, *besides):
        held = self.holders(c, *besides)
        return [0.0 if j in held else w for j, w, _ in self.options[c]]

    def pick(self, weights):
        aim, chosen = self.rng.random() * sum(weights), None
        for k, w in enumerate(weights):
            if w > 0:
                chosen = k
                aim -= w
                if aim < 0:
                    break
        return chosen

    def drawn(self, c, o):
        entries = self.options[c][o][2]
        aim = self.rng.random() * entries[-1][1]
        return int(self.member[next(e for e, reached in entries if reached > aim)])

    def crowd(self, state):
        return total_penalty(self.place[[i for i in state if i >= 0]], self.boxes) if self.strength else 0.0

    def refused(self, state):
        more = self.crowd(state) - self.crowd(self.state)
        return more > 1e-15 and self.rng.random() >= np.exp(-self.strength * more)

    def one(self, c):
        o = self.pick(self.weights(c))
        i = self.drawn(c, o) if o else -1
        was = self.option[c]
        if o == was == 0:
            return
        if was == 0:
            kind = 0 if c >= self.old else 3
        elif o == 0:
            kind = 1 if c >= self.old else 2
        else:
            kind = 4 if was == o else 5
        self.counts[kind, 0] += 1
        trial = self.state.copy()
        trial[c] = i
        if not self.refused(trial):
            self.counts[kind, 1] += 1
            self.option[c], self.state = o, trial

    def two(self, a, b):
        first, second = self.weights(a, b), self.weights(b, a)
        pairs = [(o, p) for o in range(len(first)) for p in range(len(second))]
        weights = [
            0.0 if self.options[a][o][0] >= 0 and self.options[a][o][0] == self.options[b][p][0] else first[o] * second[p]
            for o, p in pairs
        ]
        o, p = pairs[self.pick(weights)]
        trial = self.state.copy()
        trial[a] = self.drawn(a, o) if o else -1
        trial[b] = self.drawn(b, p) if p else -1
        self.counts[6, 0] += 1
        if not self.refused(trial):
            self.counts[6, 1] += 1
            self.option[a], self.option[b], self.state = o, p, trial

    def chance(self, c):
        weights = self.weights(c)
        gone, there = weights[0], sum(weights[1:])
        i = self.state[c]
        if i < 0:
            i = self.drawn(c, 1 + self.pick(weights[1:]))
        with_him = self.state.copy()
        with_him[c] = i
        without = self.state.copy()
        without[c] = -1
        there *= np.exp(-self.strength * (self.crowd(with_him) - self.crowd(without)))
        return i, there / (there + gone)

    def run(self, pairs, exchange, keep):
        """Options, states, chance, counts."""
        out, many = [], len(self.options)
        for sweep in range(keep[0] + keep[1] * keep[2]):
            for _ in range(many):
                if len(pairs) and self.rng.random() < exchange:
                    self.two(*pairs[int(self.rng.random() * len(pairs))])
                else:
                    self.one(int(self.rng.random() * many))
            if sweep >= keep[0] and (sweep - keep[0] + 1) % keep[1] == 0:
                out.append([(o, *self.chance(c)) for c, o in enumerate(self.option)])
        options, states, chance = (np.array([[row[c][k] for row in out] for c in range(many)]) for k in range(3))
        return options, states, chance, self.counts
