"""What the simulated scenarios of points share: one filter over one realisation, many runs, what they come to.

OSPA is one distance between two sets of points, for where they are and how many (Schuhmacher, Vo, Vo 2008):

    OSPA(x, y) = [ 1/max(n, m) ( min_π Σ min(d(x_i, y_π(i)), c)^p + c^p |n − m| ) ]^(1/p)

where π maps the smaller set into the larger; c is the price of a point too many. Two empty sets are at distance 0. (Stone
Soup maps for the least Σ min(d, c) whatever p is, and so gives more than the least for p > 1 at times.) With order 1 it has
two parts: the cut-off distances of the pairs, and c for each state too many or too few, both over the larger number.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common import Options, in_parallel, pyplot, table
from phdtrack.compare.statistics import Interval, interval
from phdtrack.metrics.matching import cheapest
from phdtrack.protocols import Extractor, Filter, Model
from phdtrack.types import F8, I8

Stages = tuple[Filter[Any], Extractor[Any]]


@dataclass(frozen=True, slots=True)
class FilterRun:
    """One run of one ``filter`` in one ``case`` of a scenario; ``seed`` decides the scans, whatever the filter."""

    filter: str
    case: str
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Realisation:
    """Scans of a scenario: (m, N) measurements and (d, n) true states of each, and the model that filters are given.

    ``interval`` seconds between scans, ``cutoff`` metres of the OSPA distance.
    """

    model: Model
    scans: tuple[F8, ...]
    truth: tuple[F8, ...]
    interval: float
    cutoff: float


@dataclass(frozen=True, slots=True, eq=False)
class SetErrors:
    """Per scan: ``ospa`` and its part ``number`` in metres, ``error`` the number of states less that of targets.

    ``seconds`` of processor time that filter and extraction took for a scan.
    """

    ospa: F8
    number: F8
    error: F8
    seconds: float


def ospa(x: F8, y: F8, c: float, p: float = 1.0) -> float:
    """The OSPA distance of order p, cut off at c, between points under the Euclidean distance: columns (d, n) and (d, m)."""
    cost = np.minimum(np.sqrt(((x[:, :, None] - y[:, None, :]) ** 2).sum(axis=0)), c) ** p
    n, m = cost.shape
    return float(((cost[cheapest(cost)].sum() + c**p * abs(n - m)) / max(n, m, 1)) ** (1 / p))


def followed(given: Realisation, stages: Stages, seed: int) -> Iterator[tuple[F8, float]]:
    """(d, n) states that a filter reports of each scan, and the seconds of processor time that they took."""
    recursion, extractor = stages
    rng = np.random.default_rng([seed, 1])
    state = recursion.start(given.model, rng)
    for z in given.scans:
        began = time.thread_time()
        state, _ = recursion.step(state, z, given.model, given.interval, rng)
        found = extractor.extract(state, z, given.model).state
        yield found, time.thread_time() - began


def measured(given: Realisation, states: Iterable[tuple[F8, float]]) -> SetErrors:
    """What the ``states`` of the scans, as `followed` gives them, come to."""
    scans = len(given.scans)
    distance, number, error, seconds = (np.zeros(scans) for _ in range(4))
    for k, (found, spent) in enumerate(states):
        truth = given.truth[k]
        n, m = truth.shape[1], found.shape[1]
        distance[k] = ospa(found[:2], truth[:2], given.cutoff)
        number[k] = given.cutoff * abs(n - m) / max(n, m, 1)
        error[k], seconds[k] = m - n, spent
    # The first scans compile.
    return SetErrors(distance, number, error, float(np.median(seconds)))


RunErrors = dict[tuple[str, str], list[SetErrors]]
"""By case and filter, one outcome for each seed."""


def measure(
    run: Callable[[FilterRun], SetErrors], runs: Mapping[tuple[str, str], int], label: str, options: Options
) -> RunErrors:
    """So many ``runs`` of every pair of a case and a filter, from seed 0."""
    # Seed by seed: several processes then begin with different filters, and each kernel is compiled once.
    jobs = [
        FilterRun(name, case, seed) for seed in range(max(runs.values())) for case, name in runs if seed < runs[case, name]
    ]
    outcomes = dict(zip(jobs, in_parallel(run, jobs, label, options), strict=True))
    return {(case, name): [outcomes[FilterRun(name, case, seed)] for seed in range(n)] for (case, name), n in runs.items()}


@dataclass(frozen=True, slots=True)
class Summary:
    """Over ``runs``: mean OSPA with half the width of its 95 % interval, its parts, count errors, milliseconds a scan."""

    runs: int
    ospa: float
    within: float
    place: float
    number: float
    count: float
    bias: float
    milliseconds: float

    @classmethod
    def of(cls, outcomes: Sequence[SetErrors]) -> Summary:
        """Means over scans and runs; the time is the median of the runs'."""
        distance = interval([outcome.ospa.mean() for outcome in outcomes])
        number = float(np.mean([outcome.number for outcome in outcomes]))
        counts = np.concatenate([outcome.error for outcome in outcomes])
        spent = 1000 * float(np.median([outcome.seconds for outcome in outcomes]))
        return cls(
            len(outcomes),
            distance.mean,
            distance.half,
            distance.mean - number,
            number,
            float(np.abs(counts).mean()),
            float(counts.mean()),
            spent,
        )

    def cells(self) -> tuple[str, ...]:
        """The cells of a row under `HEADER`."""
        return (
            str(self.runs),
            f"{self.ospa:.2f} ± {self.within:.2f}",
            f"{self.place:.2f}",
            f"{self.number:.2f}",
            f"{self.count:.2f}",
            f"{self.bias:+.2f}",
            f"{self.milliseconds:.1f}",
        )


HEADER = ("runs", "OSPA", "place", "number", "mean count error", "bias", "ms per scan")


PARTICLES = (("particle-phd", "gm-phd"), ("particle-cphd", "gm-cphd"))
"""The particle forms, each with the Gaussian one that it should come near."""
COMPARED = (("gm-cphd", "gm-phd"), *PARTICLES, ("mht", "gm-cphd"), ("pmb", "mht"))
"""The pairs of filters whose difference is shown."""


def apart(ours: Sequence[SetErrors], theirs: Sequence[SetErrors]) -> Interval:
    """Mean difference of the OSPA, run by run where both have one on the same scans, and its 95 % interval."""
    return interval([a.ospa.mean() - b.ospa.mean() for a, b in zip(ours, theirs, strict=False)])


def differences(outcomes: dict[str, list[SetErrors]], pairs: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str, str]]:
    """Of each pair of filters that ran: which less which, how far apart in metres, and as a share."""
    for ours, theirs in pairs:
        if ours in outcomes and theirs in outcomes:
            difference = apart(outcomes[ours], outcomes[theirs])
            level = np.mean([outcome.ospa.mean() for outcome in outcomes[theirs][: len(outcomes[ours])]])
            yield (
                f"{ours} less {theirs}",
                f"{difference.mean:+.2f} ± {difference.half:.2f}",
                f"{100 * difference.mean / level:+.1f} %",
            )


def compared(
    run: Callable[[FilterRun], SetErrors], runs: Mapping[str, int], filters: Sequence[str], label: str, options: Options
) -> RunErrors:
    """So many ``runs`` of every case with every filter; in the short form of the first case only."""
    cases = dict(list(runs.items())[: 1 if options.quick else None])
    return measure(run, {(case, name): n for case, n in cases.items() for name in filters}, label, options)


def tables(found: RunErrors, elsewhere: Mapping[tuple[str, str], str]) -> dict[str, str]:
    """Errors of every filter in every case, with what other implementations reach, and the differences of some pairs."""
    rows, claims = [], []
    for case in dict.fromkeys(case for case, _ in found):
        outcomes = {name: each for (which, name), each in found.items() if which == case}
        rows += [(case, name, elsewhere.get((case, name), ""), *Summary.of(each).cells()) for name, each in outcomes.items()]
        claims += [(case, *cells) for cells in differences(outcomes, COMPARED)]
    return {
        "rows": table(("", "filter", "elsewhere", *HEADER), rows),
        "claims": table(("", "", "difference of OSPA", "share"), claims),
    }


def curves(outcomes: dict[str, list[SetErrors]], number: I8, path: Path) -> None:
    """Draw OSPA and number of states over the scans, means over runs, with the true ``number`` (scans,)."""
    plt = pyplot()
    figure, axes = plt.subplots(2, 1, figsize=(9, 6), sharex=True, layout="constrained")
    scans = np.arange(1, len(number) + 1)
    axes[1].step(scans, number, "k", where="mid", lw=1.5, label="targets")
    for k, (name, each) in enumerate(outcomes.items()):
        axes[0].plot(scans, np.mean([o.ospa for o in each], axis=0), f"C{k}", lw=1.2, label=name)
        axes[1].plot(scans, number + np.mean([o.error for o in each], axis=0), f"C{k}", lw=1)
    axes[0].set(ylabel="OSPA, m", ylim=(0, None))
    axes[1].set(xlabel="scan", ylabel="number", ylim=(0, None))
    axes[0].legend(fontsize=8, ncols=len(outcomes), loc="upper center")
    axes[1].legend(fontsize=8, loc="upper left")
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[0].set_ylim(0, axes[0].get_ylim()[1] * 1.15)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
