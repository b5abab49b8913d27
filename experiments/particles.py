"""How many particles do real detections need? The shipped defaults beside M07's numbers, and less.

    phdtrack reproduce particles

The seven cases of `cases`, natural and with clutter added, several seeds each. Differences are paired by
case, clutter and seed; the error is the standard error of their mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from experiments.cases import CASES, Named, cluttered, given, short
from experiments.common import Options, Result, in_parallel, measure, table, write

# Particles per target ρ and newborn per detection Jmax; M07's numbers are the reference.
SIZES = ((1500, 1000), (750, 500), (300, 200))
RATES = (0, 5)
SEEDS = 6
SCORES = ("MODA", "MOTA", "IDF1", "HOTA")
Job = tuple[str, str, int, int, int, int]


def work(job: Job) -> Result:
    """One run."""
    sequence, kind, rate, seed, particles_per_target, most = job
    sets = (f"filter.particles_per_target={particles_per_target}", f"birth.particles={most}")
    return measure(cluttered(given(sequence, kind), rate, seed), "particle-phd", seed, sets)


def main(options: Options | None = None) -> Path:
    """Run everything and write particles.md."""
    options = options or Options()
    cases, seeds = short(CASES) if options.quick else CASES, range(1, options.number(SEEDS, 2) + 1)
    jobs = [(*case, rate, seed, *size) for case in cases for rate in RATES for seed in seeds for size in SIZES]
    results = dict(zip(jobs, in_parallel(work, jobs, "particles", options.folder), strict=True))
    return write("particles.md", page(results, cases, seeds), options.out)


def page(results: dict[Job, Result], cases: Sequence[Named], seeds: Sequence[int]) -> str:
    """The page: means, and differences from M07's numbers."""
    parts = [
        "# How many particles\n",
        f"Written by `phdtrack reproduce particles`. Means over {len(cases)} cases of real detections (see m07.md) "
        f"and seeds {seeds[0]} to {seeds[-1]}; in brackets the paired difference from M07's numbers "
        f"({SIZES[0][0]} particles per target, {SIZES[0][1]} newborn per detection) ± its standard error. The shipped "
        f"default is {SIZES[1][0]} and {SIZES[1][1]}; `--preset m07` and `m09` keep M07's. *ms* per frame, of the whole "
        "tracker, while other runs share the machine.\n",
    ]
    for rate in RATES:
        title = f"With {rate} false alarms per frame added" if rate else "As detected"
        parts.append(f"## {title}\n")
        rows = [_row(results, cases, seeds, rate, size) for size in SIZES]
        parts.append(table(("particles, newborn", *SCORES, "ms"), rows))
    return "\n".join(parts)


def _row(
    results: dict[Job, Result], cases: Sequence[Named], seeds: Sequence[int], rate: int, size: tuple[int, int]
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


if __name__ == "__main__":
    main()
