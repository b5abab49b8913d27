"""The learner on samples of known mixtures, with the grids and the numbers of samples of M09.

Four places well apart, in six dimensions (births, from a 12 × 10 grid, 320 samples) and in four (false alarms, from 16 × 14,
1800 samples), with a uniform part beside them of a thousandth or of a tenth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.common import table
from phdtrack.compare.statistics import interval
from phdtrack.scene import ContextDensity, RecursiveEM, grid
from phdtrack.scene.learning import BIRTH_GRID, CLUTTER_GRID
from phdtrack.types import F8

# State components (px, py, vx, vy, w, h) of the places.
_MEAN = np.array(
    [[100.0, 300, 500, 650], [100, 350, 250, 430], [3, -3, 0, 2], [0, 1, -4, 2], [40, 40, 50, 30], [90, 100, 120, 80]]
)
_DEVIATION = np.array([25.0, 20, 1, 1, 6, 12])
_WEIGHT = np.array([0.4, 0.3, 0.2, 0.1])
_LOW, _HIGH = np.array([0.0, 0, -20, -20, 0, 0]), np.array([720.0, 480, 20, 20, 120, 200])
_ROWS = {"births": [0, 1, 2, 3, 4, 5], "false alarms": [0, 1, 4, 5]}
GRIDS = {"births": BIRTH_GRID, "false alarms": CLUTTER_GRID}
SAMPLES = {"births": 320, "false alarms": 1800}
UNIFORM = (1e-3, 0.1)
UNSEEN = 4000
# A component with less than this weight is no place.
PLACE = 0.03
# Importance samples that integrate a density.
_POINTS = 20_000


@dataclass(frozen=True, slots=True)
class Job:
    """Samples of ``what``, with a share ``uniform`` spread evenly, drawn with ``seed``."""

    what: str
    uniform: float
    seed: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """What was learned.

    ``left``: components of the grid that are left, ``places`` those of weight above 0.03; ``weight``: the largest error of
    a place's weight, ``mean`` that of a mean in standard deviations of the place; ``learned``, ``batch`` and ``truth``:
    nats per unseen sample above the uniform density; ``integral`` of the density over the volume.
    """

    left: int
    places: int
    weight: float
    mean: float
    learned: float
    batch: float
    truth: float
    integral: float


def jobs_of(quick: bool, seeds: int) -> list[Job]:
    """All of them."""
    return [
        Job(what, share, seed) for what in SAMPLES for share in UNIFORM[: 1 if quick else 2] for seed in range(1, seeds + 1)
    ]


def known(what: str, uniform: float) -> ContextDensity:
    """The density that samples are drawn from."""
    rows = _ROWS[what]
    cov = np.tile(np.diag(_DEVIATION[rows] ** 2), (4, 1, 1))
    return ContextDensity(_LOW[rows], _HIGH[rows], uniform, _WEIGHT, _MEAN[rows], cov)


def work(job: Job) -> Outcome:
    """Learn from one set of samples."""
    p, rng = known(job.what, job.uniform), np.random.default_rng(job.seed)
    samples, unseen = p.sample(SAMPLES[job.what], rng), p.sample(UNSEEN, rng)
    centre, spread = samples.mean(axis=1), samples.std(axis=1)
    if p.dim == 6:
        centre[2:4] = 0
    start = grid(p.low, p.high, GRIDS[job.what], centre, spread)
    found = RecursiveEM().learn(start, samples)
    heavy = np.flatnonzero(found.weight > PLACE)
    nearest = [heavy[np.argmin(np.hypot(*(found.mean[:2, heavy] - p.mean[:2, m, None])))] for m in range(4)]
    deviation = np.sqrt(np.einsum("mrr->rm", p.covariance))
    worth = [float(one.log(unseen).mean() + np.log(p.volume)) for one in (found, batch_em(p, samples), p)]
    return Outcome(
        len(found),
        len(heavy),
        float(np.abs(found.weight[nearest] - p.weight).max()),
        float((np.abs(found.mean[:, nearest] - p.mean) / deviation).max()),
        worth[0],
        worth[1],
        worth[2],
        integral(found, rng),
    )


def integral(p: ContextDensity, rng: np.random.Generator) -> float:
    """∫ p over its volume, by importance sampling from half of p itself and half of the uniform density."""
    flat = rng.uniform(p.low[:, None], p.high[:, None], (p.dim, _POINTS))
    points = np.concatenate([known_draws(p, rng), flat], axis=1)
    density = p(points)
    return float((density / (0.5 * parts(p, points) + 0.5 / p.volume)).mean())


def known_draws(p: ContextDensity, rng: np.random.Generator) -> F8:
    """(d, n) draws of the Gaussians of p, wherever they fall: their density is known without knowing what is cut off."""
    which = rng.choice(len(p), size=_POINTS, p=p.weight)
    root = np.linalg.cholesky(p.covariance)
    draws: F8 = p.mean[:, which] + np.einsum("jrs,sj->rj", root[which], rng.standard_normal((p.dim, _POINTS)))
    return draws


def parts(p: ContextDensity, x: F8) -> F8:
    """(L,) the density of `known_draws`."""
    total = np.zeros(x.shape[1])
    for weight, mean, cov in zip(p.weight, p.mean.T, p.covariance, strict=True):
        total += weight * np.exp(log_gaussian(x, mean, cov))
    return total


def log_gaussian(x: F8, mean: F8, cov: F8) -> F8:
    """(L,) log N(x; mean, cov)."""
    step = x - mean[:, None]
    distance2 = np.einsum("rn,rn->n", step, np.linalg.solve(cov, step))
    out: F8 = -0.5 * (distance2 + np.linalg.slogdet(2 * np.pi * cov)[1])
    return out


def batch_em(p: ContextDensity, samples: F8, iterations: int = 300) -> ContextDensity:
    """Maximum likelihood of the whole model by batch EM, begun at the truth ``p``: what can be had from these samples."""
    uniform, weight, mean, cov = p.uniform, p.weight, p.mean, p.covariance
    flat = -np.log(p.volume)
    for _ in range(iterations):
        gaussians = [
            np.log((1 - uniform) * w) + log_gaussian(samples, m, c) for w, m, c in zip(weight, mean.T, cov, strict=True)
        ]
        logs = np.array([np.full(samples.shape[1], np.log(uniform) + flat), *gaussians])
        share = np.exp(logs - np.logaddexp.reduce(logs, axis=0))
        uniform = max(1e-3, float(share[0].mean()))
        mass = share[1:].sum(axis=1)
        weight, mean = mass / mass.sum(), samples @ share[1:].T / mass
        cov = np.array([_scatter(samples - m[:, None], s) for m, s in zip(mean.T, share[1:], strict=True)])
    return ContextDensity(p.low, p.high, uniform, weight, mean, cov)


def _scatter(step: F8, share: F8) -> F8:
    out: F8 = (share * step) @ step.T / share.sum()
    return out


def summary(jobs: Sequence[Job], outcomes: Mapping[Job, Outcome]) -> str:
    """A row for each case: means over the seeds, largest errors of all."""
    header = (
        "samples", "uniform part", "grid", "components left", "four places", "largest error of a weight",
        "of a mean, deviations", "learned", "batch EM", "the truth", "behind batch EM", "integral",
    )  # fmt: skip
    rows = []
    for what, share in dict.fromkeys((job.what, job.uniform) for job in jobs):
        some = [outcomes[job] for job in jobs if (job.what, job.uniform) == (what, share)]
        across, down = GRIDS[what]
        left = sorted(one.left for one in some)
        means = (float(np.mean([getattr(one, key) for one in some])) for key in ("learned", "batch", "truth"))
        behind = interval([one.batch - one.learned for one in some])
        rows.append(
            (
                f"{SAMPLES[what]} {what}", f"{share:g}", f"{across} × {down}", f"{left[0]} to {left[-1]}",
                f"{sum(one.places == 4 for one in some)} of {len(some)}", max(one.weight for one in some),
                max(one.mean for one in some), *means, f"{behind.mean:.3f} ± {behind.half:.3f}",
                f"{min(one.integral for one in some):.3f} to {max(one.integral for one in some):.3f}",
            )
        )  # fmt: skip
    return table(header, rows)
