"""Marginals of associations and what the Poisson multi-Bernoulli filter makes of them, written
naively.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from phdtrack.arrays import chi2_quantile
from phdtrack.kernels.pmb import PROVED
from reference.gm_twin import corrected, density


def propagated(
    psi: np.ndarray, rounds: int, settled: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Belief propagation on the whole table of odds (T, N): probabilities of pairs (T, N), misses
    (T,), of nobody's (N,).
    """
    mu = np.zeros_like(psi)
    nu = np.ones_like(psi)
    for _ in range(rounds):
        for t, j in np.ndindex(*psi.shape):
            mu[t, j] = psi[t, j] / (
                1 + sum(psi[t, i] * nu[t, i] for i in range(psi.shape[1]) if i != j)
            )
        before = nu.copy()
        for t, j in np.ndindex(*psi.shape):
            nu[t, j] = 1 / (1 + sum(mu[s, j] for s in range(len(psi)) if s != t))
        # Where no pair is, no message goes.
        if np.abs(nu - before)[psi > 0].max(initial=0) <= settled:
            break
    total = 1 + (psi * nu).sum(1)
    return psi * nu / total[:, None], 1 / total, 1 / (1 + mu.sum(0))


def enumerated(psi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same exactly, over every assignment of one measurement at most to each target, and one
    target to each.
    """
    targets, n = psi.shape
    pair = np.zeros_like(psi)
    missed = np.zeros(targets)
    own = np.zeros(n)
    total = 0.0
    for choice in itertools.product(range(-1, n), repeat=targets):
        taken = [j for j in choice if j >= 0]
        if len(taken) != len(set(taken)):
            continue
        weight = float(np.prod([psi[t, j] for t, j in enumerate(choice) if j >= 0]))
        total += weight
        for t, j in enumerate(choice):
            if j < 0:
                missed[t] += weight
            else:
                pair[t, j] += weight
        for j in set(range(n)) - set(taken):
            own[j] += weight
    return pair / total, missed / total, own / total


@dataclass(frozen=True)
class Hypothesis:
    """One of a target: its weight, mean (d,), covariance (d, d), what it is, what it took (−1:
    nothing), and whence.

    How many times the model's its variances are, of position and size, the degrees of freedom of
    that, which factor its acceleration has, and the log odds that it is genuine.
    """

    weight: float
    mean: np.ndarray
    cov: np.ndarray
    static: bool
    occluded: float
    taken: int = -1
    source: int = -1
    scale: tuple[float, float] = (1.0, 1.0)
    freedom: float = 0.0
    motion: int = 0
    genuine: float = np.inf


def distances(x: Hypothesis, z, h, noise) -> np.ndarray:
    """d² of the first two components, and of the others given these, by the model's noises."""
    step = z - h @ x.mean
    spread = h @ x.cov @ h.T + noise
    first = step[:2] @ np.linalg.solve(spread[:2, :2], step[:2])
    return np.array([first, step @ np.linalg.solve(spread, step) - first])


def evidence(x: Hypothesis, z, h, noise) -> float:
    """q(z): Gaussian, or for each two components Student's t, whose normalising constant is 1/2π
    for any freedom.
    """
    step = z - h @ x.mean
    spread = h @ x.cov @ h.T + noise
    n = x.freedom
    c = np.array(x.scale)
    if not n:
        return density(step, spread)
    return density(0 * step, spread) * float(
        np.prod((1 + distances(x, z, h, noise) / (n * c)) ** (-n / 2 - 1) / c)
    )


def scored(genuine: float, odds: float) -> float:
    """p(s) of a hypothesis over that of a false alarm of one frame; that of a lasting false alarm
    is the same.
    """
    p = 1 / (1 + np.exp(-genuine))
    return p * odds + 1 - p


def chance(log_odds: float) -> float:
    """The probability that corresponds to these log odds."""
    return float(1 / (1 + np.exp(-log_odds)))


def with_odds(p: float, ratio: float) -> float:
    """The probability whose odds are ``ratio`` times those of p."""
    return ratio * p / (1 + (ratio - 1) * p)


def learned_odds(counted: tuple[float, float, float], s) -> float:
    """How many times the sensor's the odds of p_D are, after so many detections of so many chances,
    of which the sensor expects so many; its own p_D counts for 30 chances.
    """
    hits, chances, expected = counted
    if not s.detection_memory or not chances:
        return 1.0
    sensor = expected / chances
    learned = np.clip((30 * sensor + hits) / (30 + chances), 0.2, 0.97)
    return float(learned / (1 - learned) / (sensor / (1 - sensor)))


def turned(x: Hypothesis, share: float, dt: float, wide: np.ndarray) -> list[Hypothesis]:
    """A hypothesis, and the same with a new velocity of deviations ``wide`` (2,) since ``dt`` ago,
    which is true with the probability ``share``.
    """
    mean = x.mean.copy()
    cov = x.cov.copy()
    for a in range(2):
        position = x.cov[a, a]
        mean[a] -= dt * x.mean[a + 2]
        mean[a + 2] = 0
        for row in (a, a + 2):
            cov[row] = cov[:, row] = 0
        cov[a, a] = position + (dt * wide[a]) ** 2
        cov[a, a + 2] = cov[a + 2, a] = dt * wide[a] ** 2
        cov[a + 2, a + 2] = wide[a] ** 2
    new = replace(x, weight=share * x.weight, mean=mean, cov=cov, occluded=0.0)
    return [replace(x, weight=(1 - share) * x.weight), new]


def with_new_velocities(targets, z, h, noise, active, s, speed, dt, rate):
    """The targets, each with one hypothesis more if no measurement is near it and one that is near
    no target is in reach of a new velocity; ``speed`` (2,) are the deviations of a usual one.
    """
    radius = chi2_quantile(len(h), s.gate_probability)
    close = np.zeros((len(targets), len(z)), bool)
    for t, (_, forms) in enumerate(targets):
        for (x, p), j in itertools.product(zip(forms, active[t], strict=True), range(len(z))):
            d2 = distances(x, z[j], h, noise)
            close[t, j] |= p > 0 and (d2 / x.scale).sum() <= radius and d2.sum() < 13.3
    out = []
    for t, (r, forms) in enumerate(targets):
        moving = [x for x in forms if not x.static]
        if not moving or close[t].any():
            out.append((r, forms))
            continue
        best = max(moving, key=lambda x: x.weight)
        unknown = best.cov[2, 2] > 0.5 * speed[0] ** 2
        share = 0.1 if unknown else 1 - np.exp(-s.turns_per_second * dt / rate)
        reach = 3 * np.sqrt(np.diag(best.cov)[:2] + (8 * speed * dt) ** 2)
        middle = best.mean[:2] - dt * best.mean[2:4]
        inside = [
            not close[:, j].any() and (abs(one[:2] - middle) < reach).all()
            for j, one in enumerate(z)
        ]
        if any(inside) and r * share >= 0.003 * s.existence_threshold:
            old, new = turned(best, share, dt, 8 * speed)
            forms = [*(old if x is best else x for x in forms), new]
        out.append((r, forms))
    return out


def counts(targets, seen, p_d, pair_weight, missed) -> tuple[float, float, float]:
    """Detections of targets that move and are in view, their number, and the detections that the
    sensor expects: ``pair_weight`` of (t, c, j), ``missed`` of (t, c), the probabilities of both.
    """
    hits = chances = 0.0
    for (t, c, _), probability in pair_weight.items():
        x = targets[t][1][c]
        if not x.static:
            hits += probability * chance(x.genuine)
            chances += probability * chance(x.genuine)
    for (t, c), probability in missed.items():
        x = targets[t][1][c]
        if not x.static:
            # Missed without being occluded
            in_view = (1 - x.occluded - seen[t][c]) / (1 - seen[t][c])
            chances += probability * in_view * chance(x.genuine)
    return hits, chances, chances * p_d


def after_standing(x: Hypothesis, seen: bool, p: float, firing: float) -> float:
    """The log odds that what stands still is a target, after it was detected or not; at most 8."""
    if not x.static:
        return x.genuine
    ratio = p / firing if seen else (1 - p) / (1 - firing)
    return float(np.clip(x.genuine + np.log(ratio), -8, 8))


def after_miss(x: Hypothesis, of_target: float, of_false: float) -> float:
    """The log odds that what moves is genuine, after a miss that is certain if it is occluded; at
    most 8 in size.
    """
    seen = 1 - x.occluded
    ratio = (1 - seen * (1 - of_target)) / (1 - seen * (1 - of_false))
    return float(np.clip(x.genuine + np.log(ratio), -8, 8))


def new_hypotheses(s, genuine: float, mean, cov, j: int) -> list[Hypothesis]:
    """The hypotheses of a new target: its motions and, if there is static clutter, that it stands
    still, as one of 20 targets does and all static clutter.
    """
    clutter = s.static_clutter_prior
    standing = (1 - clutter) / 20 if clutter else 0.0
    still = clutter + standing
    motions = len(s.acceleration_factors)
    first = Hypothesis(1.0, mean, cov, False, 0.0, j, freedom=s.noise_freedom, genuine=genuine)
    out = [replace(first, weight=(1 - still) / motions, motion=k) for k in range(motions)]
    if still:
        odds = float(np.log(standing / clutter))
        out.append(replace(first, weight=still, static=True, genuine=odds))
    return out


def updated(targets, z, h, noise, p_d, clutter, new, s, scores, rounds, settled, odds_of_p_d, turn):
    """The update of the Poisson multi-Bernoulli filter, one target, hypothesis and measurement at a
    time [W15].

    ``targets`` is a list of (r, [Hypothesis, …]); ``z`` a list of measurements with expected value
    ``h`` @ mean and noise ``noise``; ``clutter`` κ of each; ``new`` a list of (λ̂, mean,
    covariance) of each; ``s`` the settings of `filters.PMB`; ``scores`` the odds and the log odds
    of each, against false alarms of one frame and against lasting ones, and the probabilities that
    a visible target and a lasting false alarm are missed; ``odds_of_p_d`` those that were learned,
    as a multiple of the sensor's; ``turn`` what `with_new_velocities` takes of the world, None
    without. Gives the targets that are left as (index before, −1 for new ones, r, [Hypothesis, …]),
    of each measurement the probability that it is a false alarm, static and lasting clutter
    included, and the `counts`.
    """
    n = len(z)
    share = {}
    psi = np.zeros((len(targets), len(z)))
    odds, log_odds, missing = scores
    lasting = s.lasting_clutter_prior
    firing = s.static_clutter_detection_probability
    start = np.log((1 - lasting) / lasting) if lasting else np.inf
    new = [(gamma * scored(start, odds[j]), *rest) for j, (gamma, *rest) in enumerate(new)]
    alone = np.array([kappa + gamma for kappa, (gamma, *_) in zip(clutter, new, strict=True)])

    def of_target(x: Hypothesis) -> float:
        ratio = odds_of_p_d if x.static else min(odds_of_p_d, 1.0)
        return (1 - x.occluded) * with_odds(p_d, ratio)

    def of_any(x: Hypothesis) -> float:
        if not x.static:
            return of_target(x)
        return chance(x.genuine) * of_target(x) + (1 - chance(x.genuine)) * firing

    targets = [(r, [replace(x, source=c) for c, x in enumerate(forms)]) for r, forms in targets]
    seen = [[of_any(x) for x in forms] for _, forms in targets]
    sizes = [len(forms) for _, forms in targets]
    if turn:
        targets = with_new_velocities(targets, z, h, noise, seen, s, *turn)
        seen = [[of_any(x) for x in forms] for _, forms in targets]
    radius = chi2_quantile(len(h), s.gate_probability)
    for t, (r, forms) in enumerate(targets):
        missed = 1 - r * sum(x.weight * p for x, p in zip(forms, seen[t], strict=True))
        for (c, x), j in itertools.product(enumerate(forms), range(n)):
            if (distances(x, z[j], h, noise) / x.scale).sum() <= radius:
                joint = (
                    r
                    * x.weight
                    * seen[t][c]
                    * evidence(x, z[j], h, noise)
                    * scored(x.genuine, odds[j])
                )
                share[t, c, j] = joint / (missed * alone[j])
                psi[t, j] += share[t, c, j]
    pair, nothing, p_new = propagated(psi, rounds, settled)
    pair_weight = {(t, c, j): pair[t, j] * w / psi[t, j] for (t, c, j), w in share.items() if w}
    miss_weight = {}
    out = []
    false = [p * kappa / total for p, kappa, total in zip(p_new, clutter, alone, strict=True)]
    for t, (r, forms) in enumerate(targets):
        unseen = sum(x.weight * (1 - p) for x, p in zip(forms, seen[t], strict=True))
        exists = r * unseen / (1 - r * (1 - unseen))
        options = []
        for c, x in enumerate(forms):
            if unseen > 0:
                p = of_target(x)
                weight = nothing[t] * exists * x.weight * (1 - seen[t][c]) / unseen
                miss_weight[t, c] = weight
                genuine = after_standing(x, False, p, firing)
                if lasting and not x.static and genuine < start + PROVED:
                    genuine = after_miss(x, *missing)
                options.append(
                    replace(x, weight=weight, occluded=x.occluded / (1 - p), genuine=genuine)
                )
            for j in range(n):
                if (t, c, j) not in pair_weight:
                    continue
                probability = pair_weight[t, c, j]
                false[j] += probability * chance(-x.genuine)
                mean, cov, _ = corrected(x.mean, x.cov, z[j], h, noise)
                known = x.freedom
                scale = x.scale
                if known:
                    scale = tuple(
                        (known * np.array(scale) + distances(x, z[j], h, noise)) / (known + 2)
                    )
                    known += 2
                genuine = after_standing(x, True, of_target(x), firing)
                if lasting and not (genuine >= start + PROVED and log_odds[j] < 0):
                    genuine = np.clip(genuine + log_odds[j], -8, 8)
                options.append(
                    replace(
                        x,
                        weight=probability,
                        mean=mean,
                        cov=cov,
                        occluded=0.0,
                        taken=j,
                        scale=scale,
                        freedom=known,
                        genuine=genuine,
                    )
                )
        after = sum(x.weight for x in options)
        moving = sum(x.weight for x in options if not x.static)
        # Those that move are compared with each other, as what stands still may go
        least = {False: s.hypothesis_threshold * moving, True: s.hypothesis_threshold * after}
        kept = sorted(
            (x for x in options if x.weight > 0 and x.weight >= least[x.static]),
            key=lambda x: -x.weight,
        )
        kept = kept[: s.max_hypotheses]
        turns = len(forms) > sizes[t]
        threshold = s.existence_threshold * (0.003 if turns else 1)
        if kept and (after >= threshold or after > r):
            out.append(
                (
                    t,
                    after,
                    [replace(x, weight=x.weight / sum(y.weight for y in kept)) for x in kept],
                )
            )
    for j, (gamma, mean, cov) in enumerate(new):
        exists = p_new[j] * gamma / alone[j]
        genuine = np.clip(start + log_odds[j], -8, 8) if lasting else start
        false[j] += exists * (1 - (1 - s.static_clutter_prior) * chance(genuine))
        if exists > 0 and exists >= min(s.existence_threshold, 0.5 * gamma / alone[j]):
            out.append((-1, exists, new_hypotheses(s, genuine, mean, cov, j)))
    return out, false, counts(targets, seen, p_d, pair_weight, miss_weight)


def merged(forms: list[Hypothesis], distance: float) -> list[Hypothesis]:
    """Of one target's hypotheses, heaviest first, each counted as the first like it within so many
    deviations of that.
    """
    kept: list[Hypothesis] = []
    for x in forms:
        for i, y in enumerate(kept):
            distance2 = ((x.mean - y.mean) ** 2 / np.diag(y.cov)).sum()
            if (x.static, x.motion) == (y.static, y.motion) and distance2 < distance**2:
                kept[i] = replace(y, weight=y.weight + x.weight)
                break
        else:
            kept.append(x)
    return kept
