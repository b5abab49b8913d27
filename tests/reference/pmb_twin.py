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


def updated(targets, z, h, noise, p_d, clutter, new, s, scores, rounds, settled):
    """The update of the Poisson multi-Bernoulli filter, one target, hypothesis and measurement at a
    time [W15].

    ``targets`` is a list of (r, [Hypothesis, …]); ``z`` a list of measurements with expected value
    ``h`` @ mean and noise ``noise``; ``clutter`` κ of each; ``new`` a list of (λ̂, mean,
    covariance) of each; ``s`` the settings of `filters.PMB`; ``scores`` the odds and the log odds
    of each, against false alarms of one frame and against lasting ones. Gives the targets that are
    left as (index before, −1 for new ones, r, [Hypothesis, …]), and of each measurement the
    probability that it is a false alarm, static and lasting clutter included.
    """
    n = len(z)
    share = {}
    psi = np.zeros((len(targets), len(z)))
    odds, log_odds = scores
    lasting = s.lasting_clutter_prior
    start = np.log((1 - lasting) / lasting) if lasting else np.inf
    new = [(gamma * scored(start, odds[j]), *rest) for j, (gamma, *rest) in enumerate(new)]
    alone = np.array([kappa + gamma for kappa, (gamma, *_) in zip(clutter, new, strict=True)])
    seen = [
        [
            s.static_clutter_detection_probability if x.static else (1 - x.occluded) * p_d
            for x in forms
        ]
        for _, forms in targets
    ]
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
    out = []
    false = [p * kappa / total for p, kappa, total in zip(p_new, clutter, alone, strict=True)]
    for t, (r, forms) in enumerate(targets):
        unseen = sum(x.weight * (1 - p) for x, p in zip(forms, seen[t], strict=True))
        exists = r * unseen / (1 - r * (1 - unseen))
        options = []
        for c, x in enumerate(forms):
            if unseen > 0:
                hidden = 0.0 if x.static else x.occluded / (1 - seen[t][c])
                weight = nothing[t] * exists * x.weight * (1 - seen[t][c]) / unseen
                options.append(replace(x, weight=weight, occluded=hidden, source=c))
            for j in range(n):
                if (t, c, j) not in share:
                    continue
                probability = pair[t, j] * share[t, c, j] / psi[t, j]
                false[j] += probability * (1.0 if x.static else 1 / (1 + np.exp(x.genuine)))
                mean, cov, _ = corrected(x.mean, x.cov, z[j], h, noise)
                known = x.freedom
                scale = x.scale
                if known:
                    scale = tuple(
                        (known * np.array(scale) + distances(x, z[j], h, noise)) / (known + 2)
                    )
                    known += 2
                genuine = x.genuine
                if lasting and not (genuine >= start + PROVED and log_odds[j] < 0):
                    genuine = np.clip(genuine + log_odds[j], -8, 8)
                options.append(
                    Hypothesis(
                        probability, mean, cov, x.static, 0.0, j, c, scale, known, x.motion, genuine
                    )
                )
        after = sum(x.weight for x in options)
        kept = sorted(
            (x for x in options if x.weight > 0 and x.weight >= s.hypothesis_threshold * after),
            key=lambda x: -x.weight,
        )
        kept = kept[: s.max_hypotheses]
        if kept and (after >= s.existence_threshold or after > r):
            out.append(
                (
                    t,
                    after,
                    [replace(x, weight=x.weight / sum(y.weight for y in kept)) for x in kept],
                )
            )
    for j, (gamma, mean, cov) in enumerate(new):
        exists = p_new[j] * gamma / alone[j]
        prior = s.static_clutter_prior
        real = 1 / (1 + np.exp(-(np.clip(start + log_odds[j], -8, 8) if lasting else start)))
        false[j] += exists * (1 - (1 - prior) * real)
        if exists > 0 and exists >= min(s.existence_threshold, 0.5 * gamma / alone[j]):
            motions = len(s.acceleration_factors)
            kinds = [
                *(((1 - prior) / motions, False, k) for k in range(motions)),
                *([(prior, True, 0)] if prior else []),
            ]
            genuine = np.clip(start + log_odds[j], -8, 8) if lasting else start
            out.append(
                (
                    -1,
                    exists,
                    [
                        Hypothesis(
                            w,
                            mean,
                            cov,
                            static,
                            0.0,
                            j,
                            freedom=s.noise_freedom,
                            motion=k,
                            genuine=genuine,
                        )
                        for w, static, k in kinds
                    ],
                )
            )
    return out, false


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
