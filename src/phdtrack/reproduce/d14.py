"""D14 Tables I–III: SMC PHD and MCMC filters on centroids of people in a corridor, by number of particles and noise.

    python -m phdtrack.reproduce.d14

The runs are those of `d14_runs`; the page's text stands in d14.md, its numbers and verdicts are computed here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phdtrack.reproduce.common import Options, in_parallel, table, write
from phdtrack.reproduce.d14_pictures import footage, pictures
from phdtrack.reproduce.d14_runs import (
    BURN,
    FILTERS,
    GATE,
    INFOS,
    JOINT,
    KALMAN,
    VARIANCES,
    Job,
    Outcome,
    jobs_of,
    posterior_deviation,
    scene,
    seeds_of,
    work,
)
from phdtrack.simulate.corridor import centroids
from phdtrack.types import F8

SEEDS = 20
NUMBERS = (100, 500, 1000, 4000)
WORLDS = {"model": "Drawn from the model", "corridor": "Simulated corridor", "caviar": "CAVIAR, OneLeaveShop1cor"}
PEOPLE = ("corridor", "caviar")
# Where a chain goes with more samples than D14's grid has; of the points drawn from the model.
BEYOND = 16000
PHD, TRUE, GREEDY = FILTERS
CHAINS = (TRUE, JOINT, GREEDY)
# D14's figures over all settings and at N = 4000, with the seconds that this took; its MCMC filter is the greedy one.
PAPER = {PHD: ("0.002–1.11", "0.002–0.40", "53"), GREEDY: ("0.11–1.28", "0.11–1.27", "63")}
Results = Mapping[Job, Outcome]
Measure = Callable[[Outcome], float]


@dataclass(frozen=True, slots=True)
class Found:
    """The outcomes of all runs, and how many there were."""

    results: Results
    numbers: Sequence[int]
    seeds: int

    def values(self, world: str, name: str, number: int, variance: float, of: Callable[[Outcome], F8 | float]) -> F8:
        """(seeds, …) of every run of a setting."""
        number = 0 if name == KALMAN else number
        return np.array(
            [of(self.results[Job(world, name, number, variance, seed)]) for seed in range(seeds_of(world, self.seeds))]
        )

    def mean(self, name: str, number: int, of: Measure, worlds: Sequence[str] = tuple(WORLDS)) -> float:
        """Mean over worlds, variances and seeds."""
        each = [self.values(world, name, number, variance, of).mean() for world in worlds for variance in VARIANCES]
        return float(np.mean(each))

    def far(self, name: str, number: int) -> float:
        """Distance from the exact posterior mean where the model is true, over the seeds of the chains."""
        few = range(seeds_of("model", self.seeds))
        jobs = (Job("model", name, number, variance, seed) for variance in VARIANCES for seed in few)
        return float(np.mean([self.results[job].beside for job in jobs]))


def overall(outcome: Outcome) -> float:
    return outcome.overall


def settled(outcome: Outcome) -> float:
    return outcome.settled


def beside(outcome: Outcome) -> float:
    return outcome.beside


def detected(outcome: Outcome) -> float:
    return outcome.detected


def located(outcome: Outcome) -> float:
    return float(outcome.located.mean())


def seconds(outcome: Outcome) -> float:
    return outcome.seconds


def interval(values: F8) -> float:
    """Half the width of the 95 % confidence interval of the mean of ``values`` (n,), by Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(len(values) - 1, 0.975) * values.std(ddof=1) / math.sqrt(len(values)))


def located_mean(values: F8) -> F8:
    """(G,) means over seeds of (seeds, G) errors, without the runs in which a target was never located; NaN without any."""
    there = np.isfinite(values)
    total, count = np.where(there, values, 0.0).sum(axis=0), there.sum(axis=0)
    mean: F8 = np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)
    return mean


def spread(values: F8, digits: int = 2) -> str:
    """Mean and confidence interval as a cell; a single value alone."""
    if len(values) < 2:
        return f"{values.mean():.{digits}f}"
    return f"{values.mean():.{digits}f} ± {interval(values):.{digits}f}"


def whole(found: Found, of: Measure, digits: int = 2, bounds: bool = True) -> str:
    """A table for all worlds: a row for each variance and N, a column for each filter, and with ``bounds`` the bounds."""
    rows: list[tuple[object, ...]] = []
    for world, title in WORLDS.items():
        for variance in VARIANCES:
            bound = (spread(found.values(world, KALMAN, 0, variance, of)), f"{posterior_deviation(variance):.2f}")
            for number in found.numbers:
                cells = (spread(found.values(world, name, number, variance, of), digits) for name in FILTERS)
                rows.append((title, f"{variance:g}", number, *cells, *(bound if bounds else ())))
    return table(("", "σ²", "N", *FILTERS, *(("Kalman", "posterior") if bounds else ())), rows)


def per_target(found: Found) -> str:
    """D14's tables, one for each world and variance: of every target the error to the truth and, behind it, to z."""
    parts = []
    for world, title in WORLDS.items():
        names = np.unique(scene(world).identity).tolist()
        for variance in VARIANCES:
            rows = []
            for name, number in [(name, n) for name in FILTERS for n in found.numbers] + [(KALMAN, 0)]:
                truth, seen, share = (
                    located_mean(found.values(world, name, number, variance, of))
                    for of in (lambda o: o.truth, lambda o: o.measurement, lambda o: o.located)
                )
                cells = (f"{a:.2f} ({b:.2f})" for a, b in zip(truth, seen, strict=True))
                rows.append((name, number or "", *cells, f"{100 * share.mean():.1f}"))
            header = ("", "N", *(f"target {one}" for one in names), "located, %")
            parts.append(f"### {title}, σ² = {variance:g}\n\n{table(header, rows)}")
    return "\n".join(parts)


def ranges(found: Found) -> str:
    """The paper's ranges beside ours, over variances, worlds and targets, of means over seeds."""
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
        paper = PAPER.get(name, ("", "", ""))
        rows.append((name, paper[0], *cells[:2], paper[1], *cells[2:]))
    each_n = ("ours, truth", "ours, z")
    last = (f"paper, N = {NUMBERS[-1]}", *(f"{one}, N = {found.numbers[-1]}" for one in each_n))
    return table(("", "paper, all N", *each_n, *last), rows)


def times(found: Found) -> str:
    """Seconds of processor time for each sequence, the median over variances and seeds, beside the paper's."""
    rows = []
    for world, title in WORLDS.items():
        for number in found.numbers:
            each = [
                float(np.median([found.values(world, name, number, variance, seconds) for variance in VARIANCES]))
                for name in FILTERS
            ]
            paper = [PAPER.get(name, ("", "", ""))[2] for name in (PHD, GREEDY)] if number == NUMBERS[-1] else ["", ""]
            rows.append((f"{title}, {INFOS[world].frames} frames", number, *(f"{s:.2f}" for s in each), *paper))
    return table(("", "N", *FILTERS, "paper, PHD", "paper, MCMC"), rows)


def verdicts(found: Found) -> dict[str, object]:
    """What the page says of the numbers, from the numbers."""
    low, high = found.numbers[0], found.numbers[-1]
    far = {name: [found.far(name, n) for n in (*found.numbers, BEYOND)] for name in CHAINS}
    left = {name: each[-1] / each[-2] for name, each in far.items()}
    bound = found.mean(KALMAN, 0, overall, ["model"])
    late = {name: found.mean(name, high, settled, PEOPLE) for name in (PHD, KALMAN)}
    repeated = [
        np.nanmin(located_mean(found.values(world, name, high, variance, lambda o: o.measurement)))
        for world in PEOPLE
        for name in FILTERS
        for variance in VARIANCES
    ]
    known: dict[str, object] = {
        "z_least": f"{min(repeated):.2f}",
        "low": low,
        "high": high,
        "beyond": BEYOND,
        "model_seeds": seeds_of("model", found.seeds),
        "far": table(("N", *far), zip((*found.numbers, BEYOND), *far.values(), strict=True)),
        "independent": f"{math.sqrt(high / BEYOND):.2f}",
        "bound": f"{bound:.3f}",
        "late": f"{100 * (late[PHD] / late[KALMAN] - 1):.1f}",
        "least": f"{min(found.values(world, KALMAN, 0, v, overall).mean() for world in WORLDS for v in VARIANCES):.2f}",
        "greedy": "The greedy chain saturates" if left[GREEDY] > 0.8 else "The greedy chain does not saturate",
        "true": "The true sampler does not" if left[TRUE] < 0.6 else "So does the true sampler",
    }
    for key, name in (("phd", PHD), ("true", TRUE), ("greedy", GREEDY), ("kalman", KALMAN)):
        for place, worlds in (("model", ["model"]), ("people", PEOPLE)):
            known[f"phd_before_{key}_{place}"] = ahead(found, name, worlds)
            known[f"{key}_{place}"] = f"{found.mean(name, high, overall, worlds):.3f}"
            known[f"{key}_{place}_low"] = f"{found.mean(name, low, overall, worlds):.3f}"
            known[f"{key}_{place}_located"] = f"{100 * found.mean(name, high, located, worlds):.1f}"
            known[f"{key}_{place}_located_low"] = f"{100 * found.mean(name, low, located, worlds):.1f}"
        known[f"{key}_seconds"] = f"{np.median(found.values('corridor', name, high, VARIANCES[0], seconds)):.2f}"
        known[f"{key}_above"] = f"{100 * (found.mean(name, high, overall, ['model']) / bound - 1):.0f}"
        known[f"{key}_left"] = f"{left[name]:.2f}" if name in left else ""
    return known


def ahead(found: Found, rival: str, worlds: Sequence[str]) -> str:
    """In how many settings the PHD filter's error to the truth is below a rival's."""
    settings = [(world, n, variance) for world in worlds for n in found.numbers for variance in VARIANCES]
    wins = [
        found.values(w, PHD, n, v, overall).mean() < found.values(w, rival, n, v, overall).mean() for w, n, v in settings
    ]
    return f"{sum(wins)} of {len(wins)}"


def page(found: Found) -> str:
    """The page of results."""
    people = scene("caviar")
    steps = [np.hypot(*np.diff(centroids(people)[:, people.identity == one])).max() for one in np.unique(people.identity)]
    text = (Path(__file__).parent / "d14.md").read_text(encoding="utf-8")
    return text.format(
        truth=whole(found, overall),
        seen=whole(found, detected),
        share=whole(found, lambda outcome: 100 * located(outcome), digits=1, bounds=False),
        targets=per_target(found),
        ranges=ranges(found),
        times=times(found),
        seeds=found.seeds,
        gate=f"{GATE:g}",
        burn=BURN,
        jump=f"{max(steps):.0f}",
        theory=", ".join(f"{posterior_deviation(variance):.2f}" for variance in VARIANCES),
        **verdicts(found),
    )


def chains(numbers: Sequence[int], seeds: int) -> list[Job]:
    """The runs beside the grid: with more samples, and with one ancestor for all targets."""
    more = [(name, BEYOND) for name in CHAINS] + [(JOINT, number) for number in numbers]
    few = range(seeds_of("model", seeds))
    return [Job("model", name, number, variance, seed) for name, number in more for variance in VARIANCES for seed in few]


def main(options: Options | None = None) -> Path:
    """Run everything; write the page and its pictures, those on real footage only to ``options.folder``."""
    options = options or Options()
    seeds, numbers = options.number(SEEDS, 2), NUMBERS[::3] if options.quick else NUMBERS
    jobs = jobs_of(numbers, seeds) + chains(numbers, seeds)
    found = Found(dict(zip(jobs, in_parallel(work, jobs, "d14", options.folder), strict=True)), numbers, seeds)
    pictures(found.results, numbers, seeds, options.out)
    if options.folder is not None:
        footage(numbers[-1], options.folder)
    return write("d14.md", page(found), options.out)


if __name__ == "__main__":
    main()
