"""D14 Tables I–III: SMC PHD and MCMC filters on centroids of people in a corridor, by number of
particles and noise.

The runs are those of `d14_runs`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from experiments import d14_printed
from experiments.common import Options, in_parallel, table, write
from experiments.corridor import centroids
from experiments.d14_pictures import pictures
from experiments.d14_runs import (
    BURN,
    FILTERS,
    GATE,
    INFOS,
    KALMAN,
    VARIANCES,
    CorridorRun,
    RunErrors,
    jobs_of,
    posterior_deviation,
    scene,
    seeds_of,
    work,
)
from experiments.verdicts import rule
from phdtrack.compare.statistics import interval
from phdtrack.report.pages import counted
from phdtrack.types import F8

# As many as there must be for errors: a seed costs three minutes of processor time.
SEEDS = 3
NUMBERS = (100, 500, 1000, 4000)
WORLDS = {
    "model": "Drawn from the model",
    "corridor": "Simulated corridor",
    "caviar": "CAVIAR, OneLeaveShop1cor",
}
PEOPLE = ("corridor", "caviar")
# More samples than in D14's grid, for the points drawn from the model.
BEYOND = 16000
PHD, JOINT, TRUE, GREEDY = FILTERS
CHAINS = (JOINT, TRUE, GREEDY)
Results = Mapping[CorridorRun, RunErrors]
Measure = Callable[[RunErrors], float]


@dataclass(frozen=True, slots=True)
class CorridorErrors:
    """The outcomes of all runs, and how many there were."""

    results: Results
    numbers: Sequence[int]
    seeds: int

    @property
    def all_numbers(self) -> tuple[int, ...]:
        """Numbers of samples of the chains, including those beyond the grid."""
        few = {job.number for job in self.results if job.filter in CHAINS}
        return tuple(sorted(few))

    def values(
        self,
        world: str,
        name: str,
        number: int,
        variance: float,
        of: Callable[[RunErrors], F8 | float],
    ) -> F8:
        """(seeds, …) values of all runs of a setting."""
        number = 0 if name == KALMAN else number
        return np.array(
            [
                of(self.results[CorridorRun(world, name, number, variance, seed)])
                for seed in range(seeds_of(world, self.seeds))
            ]
        )

    def mean(
        self, name: str, number: int, of: Measure, worlds: Sequence[str] = tuple(WORLDS)
    ) -> float:
        """Mean over worlds, variances and seeds."""
        each = [
            self.values(world, name, number, variance, of).mean()
            for world in worlds
            for variance in VARIANCES
        ]
        return float(np.mean(each))

    def far(self, name: str, number: int) -> float:
        """Distance from the exact posterior mean on data from the model, over the seeds of the
        chains.
        """
        few = range(seeds_of("model", self.seeds))
        jobs = (
            CorridorRun("model", name, number, variance, seed)
            for variance in VARIANCES
            for seed in few
        )
        return float(np.mean([self.results[job].to_posterior for job in jobs]))


def overall(outcome: RunErrors) -> float:
    return outcome.overall


def detected(outcome: RunErrors) -> float:
    return outcome.detected


def located(outcome: RunErrors) -> float:
    return float(outcome.located.mean())


def seconds(outcome: RunErrors) -> float:
    return outcome.seconds


def with_misses(outcome: RunErrors) -> float:
    """RMSE per axis over all frames of all targets; the error of an unlocated target is the
    gate.
    """
    near = np.where(outcome.located > 0, outcome.truth, 0.0) ** 2
    return math.sqrt((outcome.located * near + (1 - outcome.located) * GATE**2 / 2).mean())


def located_mean(values: F8) -> F8:
    """(G,) means over seeds of (seeds, G) errors, without the runs in which a target was never
    located; NaN without any.
    """
    there = np.isfinite(values)
    total = np.where(there, values, 0.0).sum(axis=0)
    count = there.sum(axis=0)
    mean: F8 = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    return mean


def spread(values: F8) -> str:
    """Mean and confidence interval as a cell; a single value without an interval."""
    found = interval(values.tolist())
    return f"{found.mean:.2f} ± {found.half:.2f}" if found.seeds > 1 else f"{found.mean:.2f}"


def whole(found: CorridorErrors, of: Measure, shares: bool = False) -> str:
    """A table for all worlds: a row for each variance and N, a column for each filter.

    ``shares`` adds the percentage of frames in which a target was located to each value.
    """
    rows: list[tuple[object, ...]] = []
    for world, title in WORLDS.items():
        for variance in VARIANCES:
            for number in found.numbers:
                cells = []
                for name in (*FILTERS, KALMAN):
                    share = 100 * found.values(world, name, number, variance, located).mean()
                    cell = spread(found.values(world, name, number, variance, of))
                    cells.append(f"{cell} ({share:.0f} %)" if shares else cell)
                rows.append(
                    (title, f"{variance:g}", number, *cells, f"{posterior_deviation(variance):.2f}")
                )
    return table(("", "σ²", "N", *FILTERS, KALMAN, "posterior"), rows)


def falls(found: CorridorErrors, name: str, worlds: Sequence[str]) -> str:
    """The number of steps from one N to the next in which the error with misses falls."""
    steps = [
        found.values(w, name, more, v, with_misses).mean()
        < found.values(w, name, less, v, with_misses).mean()
        for w in worlds for v in VARIANCES for less, more in pairwise(found.numbers)
    ]  # fmt: skip
    return f"{sum(steps)} of {len(steps)}"


def overview(found: CorridorErrors) -> str:
    """For each filter, at the smallest and the largest N: error, share located and error with
    misses; and the number of steps in which the latter falls.
    """
    rows: list[tuple[object, ...]] = []
    ends = (found.numbers[0], found.numbers[-1])
    for place, worlds in (("the model is true", ("model",)), ("people", PEOPLE)):
        for name in (*FILTERS, KALMAN):
            cells: list[str] = []
            for number in ends:
                near, far = (found.mean(name, number, of, worlds) for of in (overall, with_misses))
                cells.append(
                    f"{near:.3f} ({100 * found.mean(name, number, located, worlds):.1f} %)"
                )
                cells.append(f"{far:.3f}")
            rows.append((place, name, *cells, "" if name == KALMAN else falls(found, name, worlds)))
    columns = [
        f"{column}, N = {number}" for number in ends for column in ("px (located)", "with misses")
    ]
    return table(("", "", *columns, "steps of N in which that falls"), rows)


def target_tables(found: CorridorErrors) -> str:
    """D14's tables, one for each world and variance: for every target the error to the truth and,
    in brackets, to z.
    """
    parts = []
    for world, title in WORLDS.items():
        names = np.unique(scene(world).identity).tolist()
        for variance in VARIANCES:
            rows = []
            for name, number in [(name, n) for name in FILTERS for n in found.numbers] + [
                (KALMAN, 0)
            ]:
                truth, seen, share = (
                    located_mean(found.values(world, name, number, variance, of))
                    for of in (lambda o: o.truth, lambda o: o.measurement, lambda o: o.located)
                )
                cells = (f"{a:.2f} ({b:.2f})" for a, b in zip(truth, seen, strict=True))
                rows.append((name, number or "", *cells, f"{100 * share.mean():.1f}"))
            header = ("", "N", *(f"target {one}" for one in names), "located, %")
            parts.append(f"### {title}, σ² = {variance:g}\n\n{table(header, rows)}")
    return "\n".join(parts)


def ranges(found: CorridorErrors) -> str:
    """Our ranges over variances, worlds and targets, of means over seeds."""
    rows = []
    for name in FILTERS:
        cells = []
        for numbers in (found.numbers, found.numbers[-1:]):
            for of in (lambda o: o.truth, lambda o: o.measurement):
                each = np.concatenate([
                    located_mean(found.values(world, name, number, variance, of))
                    for world in PEOPLE for variance in VARIANCES for number in numbers
                ])  # fmt: skip
                cells.append(f"{np.nanmin(each):.2f}–{np.nanmax(each):.2f}")
        rows.append((name, *cells))
    each_n = ("truth", "z")
    last = (f"{one}, N = {found.numbers[-1]}" for one in each_n)
    return table(("", *each_n, *last), rows)


def typical(found: CorridorErrors, world: str, name: str, number: int) -> float:
    """Seconds of processor time for a sequence, the median over variances and seeds."""
    return float(
        np.median([found.values(world, name, number, variance, seconds) for variance in VARIANCES])
    )


def times(found: CorridorErrors) -> str:
    """Seconds for each sequence, by filter and N. The paper's values, means over its variances, are
    in the rows of the corridor.
    """
    rows = []
    for world, title in WORLDS.items():
        for number in found.numbers:
            each = [typical(found, world, name, number) for name in FILTERS]
            paper = ["", ""]
            if world == d14_printed.WORLD:
                cells = [each_of[number] for each_of in d14_printed.PRINTED.values()]
                paper = [f"{np.mean([one[k] for one in cells]):.1f}" for k in (3, 1)]
            rows.append(
                (
                    f"{title}, {INFOS[world].frames} frames",
                    number,
                    *(f"{s:.2f}" for s in each),
                    *paper,
                )
            )
    return table(("", "N", *FILTERS, "paper, PHD", "paper, MCMC"), rows)


def distances(found: CorridorErrors) -> str:
    """A row for each N: the distance of the chains' means from the exact posterior mean on data
    from the model.
    """
    rows = [(number, *(found.far(name, number) for name in CHAINS)) for number in found.all_numbers]
    return table(("N", *CHAINS), rows)


def error_words(seeds: int) -> dict[str, str]:
    """Sentences on the errors of values and of the bars in the picture, which one seed has not."""
    if seeds == 1:
        return {"errors": "single values, without an interval", "bars": "One run of each setting."}
    return {
        "errors": "means ± half their 95 % interval (Student's t)",
        "bars": "Medians over seeds; bars contain 95 % of the runs.",
    }


def _seeds_text(seeds: int) -> str:
    """The number of seeds, and that of the points drawn from the model if it differs."""
    model = seeds_of("model", seeds)
    text = counted(seeds, "seed")
    if model == seeds:
        return text
    return f"{text} ({counted(model, 'seed')} for the points drawn from the model)"


def figures(found: CorridorErrors) -> dict[str, object]:
    """The values of the page's placeholders."""
    people = scene("caviar")
    steps = [
        np.hypot(*np.diff(centroids(people)[:, people.identity == one])).max()
        for one in np.unique(people.identity)
    ]
    return {
        "far": distances(found),
        "overview": overview(found),
        "truth": whole(found, overall, shares=True),
        "missed": whole(found, with_misses),
        "seen": whole(found, detected),
        "targets": target_tables(found),
        "cells": d14_printed.cells_table(found.results, found.numbers, found.seeds),
        "readings": d14_printed.readings_table(found.results, found.numbers, found.seeds),
        "ranges": ranges(found),
        "times": times(found),
        "seeds": _seeds_text(found.seeds),
        "model_seeds": counted(seeds_of("model", found.seeds), "seed"),
        **error_words(found.seeds),
        "high": found.numbers[-1],
        "paper_frames": INFOS["corridor"].frames,
        "gate": f"{GATE:g}",
        "burn": BURN,
        "jump": f"{max(steps):.0f}",
        "rule": rule(),
        "theory": ", ".join(f"{posterior_deviation(variance):.2f}" for variance in VARIANCES),
    }


def beyond(seeds: int) -> list[CorridorRun]:
    """The chains with more samples than the grid has."""
    few = range(seeds_of("model", seeds))
    return [
        CorridorRun("model", name, BEYOND, variance, seed)
        for name in CHAINS
        for variance in VARIANCES
        for seed in few
    ]


def main(options: Options) -> Path:
    """Run everything; write the page and its pictures."""
    seeds = options.number(SEEDS, 1)
    numbers = NUMBERS[:2] if options.quick else NUMBERS
    jobs = jobs_of(numbers, seeds) + ([] if options.quick else beyond(seeds))
    found = CorridorErrors(
        dict(zip(jobs, in_parallel(work, jobs, "d14", options), strict=True)), numbers, seeds
    )
    pictures(found.results, numbers, seeds, options.folder)
    claims = d14_printed.claims(found.results, numbers, seeds)
    return write("d14", options, claims, **figures(found))
