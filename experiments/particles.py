"""How many particles do real detections need? The shipped defaults next to M07's numbers, and less.

The seven cases of `cases`, natural and with clutter added, several seeds each. Differences are paired by
case, clutter and seed; the error is the standard error of their mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.cases import CASES, Named, cluttered, given, short
from experiments.common import Options, ScoredCase, in_parallel, measure, table, write

# Particles per target ρ and newborn per detection Jmax; M07's numbers are the reference.
SIZES = ((1500, 1000), (750, 500), (300, 200))
RATES = (0, 5)
SEEDS = 6
SCORES = ("MODA", "MOTA", "IDF1", "HOTA")
ParticleRun = tuple[str, str, int, int, int, int]


def work(job: ParticleRun) -> ScoredCase:
    """One run."""
    sequence, kind, rate, seed, particles_per_target, most = job
    sets = (f"filter.particles_per_target={particles_per_target}", f"birth.particles={most}")
    return measure(cluttered(given(sequence, kind), rate, seed), "particle-phd", seed, sets)


def main(options: Options) -> Path:
    """Run everything and write particles.md."""
    cases, seeds = short(CASES) if options.quick else CASES, range(1, options.number(SEEDS, 2) + 1)
    jobs = [(*case, rate, seed, *size) for case in cases for rate in RATES for seed in seeds for size in SIZES]
    results = dict(zip(jobs, in_parallel(work, jobs, "particles", options), strict=True))
    tables = {f"table{rate}": _rate_table(results, cases, seeds, rate) for rate in RATES}
    counts = {"cases": len(cases), "seeds": len(seeds), "many": SIZES[0], "shipped": SIZES[1]}
    return write("particles", options, **counts, **tables)


def _rate_table(results: dict[ParticleRun, ScoredCase], cases: Sequence[Named], seeds: Sequence[int], rate: int) -> str:
    """Means, and differences from M07's numbers, at a rate of added clutter."""
    rows = [_row(results, cases, seeds, rate, size) for size in SIZES]
    return table(("particles, newborn", *SCORES, "ms"), rows)


def _row(
    results: dict[ParticleRun, ScoredCase], cases: Sequence[Named], seeds: Sequence[int], rate: int, size: tuple[int, int]
) -> list[object]:
    ours, reference = (
        [results[(*case, rate, seed, *which)] for case in cases for seed in seeds] for which in (size, SIZES[0])
    )
    cells = []
    for score in SCORES:
        values = np.array([getattr(run.scores, score) for run in ours])
        apart = values - np.array([getattr(run.scores, score) for run in reference])
        error = apart.std(ddof=1) / math.sqrt(len(apart))
        cells.append(f"{values.mean():.3f}" + ("" if size == SIZES[0] else f" ({apart.mean():+.3f} ± {error:.3f})"))
    return [f"{size[0]}, {size[1]}", *cells, f"{1e3 * np.mean([run.seconds_per_frame for run in ours]):.1f}"]
