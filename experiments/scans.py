"""Shared parts of the simulated point scenarios: one filter over one realisation, many runs, their
scores.

OSPA is a distance between two sets of points that covers positions and number (Schuhmacher, Vo, Vo
2008):

    OSPA(x, y) = [ 1/max(n, m) ( min_π Σ min(d(x_i, y_π(i)), c)^p + c^p |n − m| ) ]^(1/p)

where π maps the smaller set into the larger; c is the cost of an extra point. Two empty sets have
distance 0. (Stone Soup minimises Σ min(d, c) for every p, so for p > 1 its value is sometimes above
the minimum.) With order 1 it has two parts: the cut-off distances of the pairs, and c for each
extra or missing state, both divided by the larger number.

GOSPA (α = 2, order 1) is a sum instead: the distances of the pairs, and c/2 for each missed target
and each extra state. T-GOSPA is the same for whole trajectories, with γ/2 for each mapping that
begins or ends (`metrics.tgospa`), here per scan. Filters with labels have trajectories: the states
of each label, in their final form for every scan.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common import Options, in_parallel, pyplot, table
from phdtrack.arrays import GATE
from phdtrack.compare.statistics import Interval, interval
from phdtrack.filters import (
    GMCPHD,
    GMPHD,
    MHT,
    PMB,
    PMBM,
    BestBernoullis,
    BestHypothesis,
    ParticleCPHD,
    ParticlePHD,
)
from phdtrack.filters.extract import Components, KMeans, Mixture
from phdtrack.metrics.matching import cheapest
from phdtrack.metrics.tgospa import TGospaParts, tgospa
from phdtrack.models.gaussian import Transform
from phdtrack.protocols import Extractor, Filter, Model
from phdtrack.types import F8, I8, Estimates

Stages = tuple[Filter[Any], Extractor[Any]]
# The PMB filter of these scenarios: one noise and one acceleration for all targets, no occlusion,
# no static clutter.
PLAIN_PMB = PMB(
    gate_probability=GATE,
    mean_visible_time=0.0,
    static_clutter_prior=0.0,
    lasting_clutter_prior=0.0,
    noise_freedom=0.0,
    acceleration_factors=(1.0,),
    clutter_decay=0.0,
)
# Particles for each target, and for each measurement where targets are born.
PER_TARGET = 1500
NEWBORN = 500
# Runs of the first case, of the others, and in the short form.
RUNS = 100
SIDE = 50
FEW = 2


def filters_of(transform: Transform) -> dict[str, Stages]:
    """The filters of the standard scenarios. Targets that start together lie in one place: without
    a number a peak counts as often as its mass says.
    """
    return {
        "gm-phd": (GMPHD(1e-5, 2.0, 100, transform=transform), Components(repeat=True)),
        "gm-cphd": (GMCPHD(1e-5, 2.0, 100, transform=transform), Components()),
        "particle-phd": (ParticlePHD(PER_TARGET), KMeans(min_weight=0.5, merge_iou=1.0)),
        "particle-cphd": (ParticleCPHD(PER_TARGET), Mixture(merge_iou=1.0)),
        "mht": (MHT(transform=transform), BestHypothesis()),
        "pmbm": (PMBM(transform=transform), BestHypothesis(smoothed=True)),
        # Of points p_D is constant, and nothing fires in one place.
        "pmb": (
            dataclasses.replace(PLAIN_PMB, transform=transform),
            BestBernoullis(merge_iou=0.5),
        ),
    }


@dataclass(frozen=True, slots=True)
class FilterRun:
    """One run of one ``filter`` in one ``case`` of a scenario; ``seed`` is that of the scans, the
    same for all filters.
    """

    filter: str
    case: str
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Realisation:
    """Scans of a scenario: (m, N) measurements and (d, n) true states of each, and the model that
    the filters have.

    ``identity`` (n,) of the true states of each; ``interval`` seconds between scans, ``cutoff``
    metres of the OSPA distance.
    """

    model: Model
    scans: tuple[F8, ...]
    truth: tuple[F8, ...]
    identity: tuple[I8, ...]
    interval: float
    cutoff: float


@dataclass(frozen=True, slots=True, eq=False)
class SetErrors:
    """Per scan: ``ospa`` and its part ``number`` in metres, ``error``, the number of states minus
    that of targets, and ``gospa``.

    ``seconds`` of processor time of filter and extraction per scan. ``trajectories``: the T-GOSPA
    of a filter with labels in metres and a scan, and its parts.
    """

    ospa: F8
    number: F8
    error: F8
    gospa: F8
    seconds: float
    trajectories: TGospaParts | None = None


def ospa(x: F8, y: F8, c: float, p: float = 1.0) -> float:
    """The OSPA distance of order p, cut off at c, between points under the Euclidean distance:
    columns (d, n) and (d, m).
    """
    cost = np.minimum(np.sqrt(((x[:, :, None] - y[:, None, :]) ** 2).sum(axis=0)), c) ** p
    n, m = cost.shape
    return float(((cost[cheapest(cost)].sum() + c**p * abs(n - m)) / max(n, m, 1)) ** (1 / p))


def followed(realised: Realisation, stages: Stages, seed: int) -> Iterator[tuple[Estimates, float]]:
    """The states that a filter reports in each scan, and the processor time in seconds."""
    recursion, extractor = stages
    rng = np.random.default_rng([seed, 1])
    state = recursion.start(realised.model, rng)
    for z in realised.scans:
        began = time.thread_time()
        state, _ = recursion.step(state, z, realised.model, realised.interval, rng)
        found = extractor.extract(state, z, realised.model)
        yield found, time.thread_time() - began


def measured(realised: Realisation, reports: Iterable[tuple[Estimates, float]]) -> SetErrors:
    """The errors of the ``reports``, the result of `followed`."""
    scans = len(realised.scans)
    final = list[Estimates]()
    distance, number, error, sums, seconds = (np.zeros(scans) for _ in range(5))
    for k, (found, spent) in enumerate(reports):
        truth = realised.truth[k]
        n = truth.shape[1]
        m = found.state.shape[1]
        distance[k] = ospa(found.state[:2], truth[:2], realised.cutoff)
        number[k] = realised.cutoff * abs(n - m) / max(n, m, 1)
        # Order 1: OSPA counts c for each extra or missing state, GOSPA c/2.
        sums[k] = distance[k] * max(n, m, 1) - 0.5 * realised.cutoff * abs(n - m)
        error[k] = m - n
        seconds[k] = spent
        # The first layer of the past is before the first scan.
        for back, then in enumerate(reversed(found.past[-k:] if k else ()), start=1):
            final[k - back] = final[k - back] if then is None else then
        final.append(found)
    trajectories = (
        _trajectories(realised, final)
        if all(len(one.tag) == one.state.shape[1] for one in final)
        else None
    )
    # The first scans compile.
    return SetErrors(distance, number, error, sums, float(np.median(seconds)), trajectories)


def _trajectories(realised: Realisation, final: Sequence[Estimates]) -> TGospaParts:
    """The T-GOSPA of the ``final`` estimates of the scans, per scan, in metres; γ is as large
    as c.
    """
    labels = np.unique(np.concatenate([one.tag for one in final]))
    people = np.unique(np.concatenate(realised.identity))
    there = np.zeros((len(final), len(people)), np.bool_)
    reported = np.zeros((len(final), len(labels)), np.bool_)
    distance = np.ones((len(final), len(people), len(labels)))
    for k, (one, truth, identity) in enumerate(
        zip(final, realised.truth, realised.identity, strict=True)
    ):
        i = np.searchsorted(people, identity)
        j = np.searchsorted(labels, one.tag)
        there[k, i] = True
        reported[k, j] = True
        apart = np.hypot(*(truth[:2, :, None] - one.state[:2, None, :]))
        distance[k][np.ix_(i, j)] = apart / realised.cutoff
    parts = tgospa(distance, there, reported, 1.0)
    scale = realised.cutoff / len(final)
    return TGospaParts(*(scale * value for value in dataclasses.astuple(parts)))


RunErrors = dict[tuple[str, str], list[SetErrors]]
"""By case and filter, one outcome for each seed."""


def measure(
    run: Callable[[FilterRun], SetErrors],
    runs: Mapping[tuple[str, str], int],
    label: str,
    options: Options,
) -> RunErrors:
    """``runs`` runs of every pair of a case and a filter, from seed 0."""
    # Seed by seed, so that processes start with different filters and each kernel is compiled once.
    jobs = [
        FilterRun(name, case, seed)
        for seed in range(max(runs.values()))
        for case, name in runs
        if seed < runs[case, name]
    ]
    outcomes = dict(zip(jobs, in_parallel(run, jobs, label, options), strict=True))
    return {
        (case, name): [outcomes[FilterRun(name, case, seed)] for seed in range(n)]
        for (case, name), n in runs.items()
    }


@dataclass(frozen=True, slots=True)
class Summary:
    """Over ``runs``: mean OSPA with half the width of its 95 % interval, its parts, GOSPA, count
    errors, ms a scan.
    """

    runs: int
    ospa: float
    within: float
    place: float
    number: float
    gospa: float
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
            float(np.mean([outcome.gospa for outcome in outcomes])),
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
            f"{self.gospa:.1f}",
            f"{self.count:.2f}",
            f"{self.bias:+.2f}",
            f"{self.milliseconds:.1f}",
        )


HEADER = ("runs", "OSPA", "place", "number", "GOSPA", "mean count error", "bias", "ms per scan")


PARTICLES = (("particle-phd", "gm-phd"), ("particle-cphd", "gm-cphd"))
"""The particle forms, each with the Gaussian one that it should come near."""
COMPARED = (("gm-cphd", "gm-phd"), *PARTICLES, ("mht", "gm-cphd"), ("pmb", "mht"), ("pmbm", "mht"))
"""The pairs of filters whose difference is shown."""


def apart(ours: Sequence[SetErrors], theirs: Sequence[SetErrors]) -> Interval:
    """Mean difference of the OSPA over the runs that both filters have on the same scans, and its
    95 % interval.
    """
    return interval([a.ospa.mean() - b.ospa.mean() for a, b in zip(ours, theirs, strict=False)])


def differences(
    outcomes: dict[str, list[SetErrors]], pairs: Sequence[tuple[str, str]]
) -> Iterator[tuple[str, str, str]]:
    """For each pair of filters that ran: names, and the difference in metres and as a share."""
    for ours, theirs in pairs:
        if ours in outcomes and theirs in outcomes:
            difference = apart(outcomes[ours], outcomes[theirs])
            level = np.mean(
                [outcome.ospa.mean() for outcome in outcomes[theirs][: len(outcomes[ours])]]
            )
            yield (
                f"{ours} less {theirs}",
                f"{difference.mean:+.2f} ± {difference.half:.2f}",
                f"{100 * difference.mean / level:+.1f} %",
            )


def compared(
    run: Callable[[FilterRun], SetErrors],
    runs: Mapping[str, int],
    filters: Sequence[str],
    label: str,
    options: Options,
) -> RunErrors:
    """Run every case with every filter ``runs`` times; in the short form only the first case."""
    cases = dict(list(runs.items())[: 1 if options.quick else None])
    return measure(
        run, {(case, name): n for case, n in cases.items() for name in filters}, label, options
    )


def tables(found: RunErrors, elsewhere: Mapping[tuple[str, str], str]) -> dict[str, str]:
    """Tables: errors of every filter in every case next to other implementations' values,
    trajectories, and differences of pairs.
    """
    rows = []
    claims = []
    lives = []
    for case in dict.fromkeys(case for case, _ in found):
        outcomes = {name: each for (which, name), each in found.items() if which == case}
        rows += [
            (case, name, elsewhere.get((case, name), ""), *Summary.of(each).cells())
            for name, each in outcomes.items()
        ]
        lives += [
            (case, name, *_life(each)) for name, each in outcomes.items() if each[0].trajectories
        ]
        claims += [(case, *cells) for cells in differences(outcomes, COMPARED)]
    return {
        "rows": table(("", "filter", "elsewhere", *HEADER), rows),
        "claims": table(("", "", "difference of OSPA", "share"), claims),
        "lives": table(("", "filter", "T-GOSPA", "places", "missed", "false", "switches"), lives),
    }


def _life(outcomes: Sequence[SetErrors]) -> tuple[str, ...]:
    """Mean T-GOSPA of the runs with half the width of its 95 % interval, and its parts."""
    parts = np.array([dataclasses.astuple(o.trajectories) for o in outcomes if o.trajectories])
    whole = interval(parts[:, 0].tolist())
    return f"{whole.mean:.1f} ± {whole.half:.1f}", *(
        f"{value:.2f}" for value in parts[:, 1:].mean(axis=0)
    )


def curves(outcomes: dict[str, list[SetErrors]], number: I8, path: Path) -> None:
    """Draw OSPA and number of states over the scans, means over runs, with the true ``number``
    (scans,).
    """
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
