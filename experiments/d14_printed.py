"""D14's printed Tables I–III beside ours, cell by cell, and its claims.

The paper prints errors of four targets, for three measurement variances and four numbers of
particles, of two filters: 96 cells. The figures of its MCMC filter double when σ² doubles, as mean
squared errors do and roots do not, so both are shown.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from experiments.claims import MENDED, WORDS, Claim, decided
from experiments.common import table
from experiments.d14_runs import IN_ALL, CorridorRun, RunErrors
from experiments.verdicts import all_hold, most_hold, with_seeds
from phdtrack.types import F8

PHD, MCMC = "SMC PHD", "MCMC greedy"
SAMPLER = "MCMC"
WORLD = "corridor"
# By σ² and N: errors of the targets and seconds, of the MCMC filter and of the SMC PHD filter.
Cells = tuple[float, float, float, float]
PRINTED: Mapping[float, Mapping[int, tuple[Cells, float, Cells, float]]] = {
    0.5: {
        100: ((0.12, 0.14, 0.28, 0.31), 3.06, (0.01, 0.02, 0.72, 0.20), 2.00),
        500: ((0.12, 0.13, 0.27, 0.30), 9.25, (0.003, 0.01, 0.40, 0.11), 7.21),
        1000: ((0.11, 0.13, 0.27, 0.30), 16.9, (0.003, 0.008, 0.32, 0.10), 13.8),
        4000: ((0.11, 0.12, 0.27, 0.30), 63.4, (0.002, 0.006, 0.18, 0.07), 53.1),
    },
    1.0: {
        100: ((0.21, 0.28, 0.55, 0.59), 3.14, (0.01, 0.05, 0.92, 0.30), 1.74),
        500: ((0.22, 0.29, 0.54, 0.59), 9.25, (0.01, 0.03, 0.58, 0.18), 7.32),
        1000: ((0.23, 0.28, 0.53, 0.60), 17.0, (0.008, 0.02, 0.40, 0.14), 13.5),
        4000: ((0.24, 0.28, 0.52, 0.60), 62.8, (0.008, 0.02, 0.27, 0.13), 53.4),
    },
    2.0: {
        100: ((0.51, 0.52, 1.12, 1.28), 3.13, (0.04, 0.07, 1.11, 0.48), 1.72),
        500: ((0.50, 0.51, 1.14, 1.27), 9.37, (0.03, 0.06, 0.68, 0.33), 7.10),
        1000: ((0.46, 0.50, 1.14, 1.27), 17.1, (0.03, 0.06, 0.48, 0.30), 13.8),
        4000: ((0.45, 0.48, 1.10, 1.27), 63.6, (0.03, 0.06, 0.40, 0.28), 53.3),
    },
}

Results = Mapping[CorridorRun, RunErrors]


def each_square(
    results: Results, name: str, number: int, variance: float, seeds: int, of: str = "truth"
) -> F8:
    """(seeds, G) mean squared errors of the targets, per axis: to the ``truth``, or to the
    ``measurement``; NaN for a target that was never located.
    """
    return np.array(
        [
            getattr(results[CorridorRun(WORLD, name, number, variance, seed)], of) ** 2
            for seed in range(seeds)
        ]
    )


def squares(results: Results, name: str, number: int, variance: float, seeds: int) -> F8:
    """(G,) mean squared errors of the targets to the truth, per axis, over the seeds."""
    return _known_mean(each_square(results, name, number, variance, seeds))


def _known_mean(values: F8) -> F8:
    """The means over the first axis of the values that are numbers; NaN without any."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    mean: F8 = np.divide(total, count, out=np.full(np.shape(total), np.nan), where=count > 0)
    return mean


def cells_table(results: Results, numbers: Sequence[int], seeds: int) -> str:
    """All cells: a row for each filter, variance and N; for every target the printed figure, our
    mean square and our root.
    """
    rows = []
    for name, which in ((MCMC, 0), (PHD, 2)):
        for variance, of in PRINTED.items():
            for number in numbers:
                ours = squares(results, name, number, variance, seeds)
                cells = (
                    f"{printed:g} / {mine:.2f} / {np.sqrt(mine):.2f}"
                    for printed, mine in zip(of[number][which], ours, strict=True)
                )
                rows.append((name, f"{variance:g}", number, *cells))
    return table(("", "σ²", "N", *(f"target {k}" for k in range(1, 5))), rows)


def readings_table(results: Results, numbers: Sequence[int], seeds: int) -> str:
    """The root of the SMC PHD filter's mean squared error over targets and variances, with N for
    each estimated target and N in all, and the share of frames in which a target is located.
    """
    rows = []
    for number in numbers:
        cells: list[str] = []
        for name in (PHD, IN_ALL):
            each = [squares(results, name, number, variance, seeds) for variance in PRINTED]
            located = [
                results[CorridorRun(WORLD, name, number, variance, seed)].located
                for variance in PRINTED
                for seed in range(seeds)
            ]
            cells += [f"{np.sqrt(np.mean(each)):.2f}", f"{100 * np.mean(located):.0f} %"]
        rows.append((number, *cells))
    return table(("N", "for each target", "located", "in all", "located"), rows)


def claims(results: Results, numbers: Sequence[int], seeds: int) -> list[Claim]:
    """D14's claims, word by word and with the sampler in place of the chain as printed."""

    def mine(name: str, number: int, variance: float) -> F8:
        return each_square(results, name, number, variance, seeds)

    def detected(name: str, number: int, variance: float) -> F8:
        return each_square(results, name, number, variance, seeds, "measurement")

    chains = ((WORDS, MCMC), (MENDED, SAMPLER))
    return [
        *(_order("the truth", form, numbers, mine, chain) for form, chain in chains),
        _order("the detections", WORDS, numbers, detected, MCMC),
        *(_saturates(form, numbers, mine, chain) for form, chain in chains),
        _falls(numbers, mine),
        *(_doubles(form, numbers, mine, chain) for form, chain in chains),
        _faster(results, numbers, seeds),
    ]


# (seeds, G) errors of a filter with a number of samples, for a variance.
Errors = Callable[[str, int, float], F8]


def _judged(claim: str, printed: str, form: str, figures: str, gaps: Mapping[str, F8]) -> Claim:
    """A claim about differences (seeds,), positive if as claimed, by setting."""
    seeds = len(next(iter(gaps.values())))
    verdicts = {name: decided(each.tolist()) for name, each in gaps.items()}
    return Claim(claim, printed, form, with_seeds(figures, seeds), verdicts)


def _order(of: str, form: str, numbers: Sequence[int], mine: Errors, chain: str) -> Claim:
    """The SMC PHD filter has the lower error for most targets of a setting."""
    printed = [
        phd < mcmc
        for cells in PRINTED.values()
        for of_mcmc, _, of_phd, _ in cells.values()
        for phd, mcmc in zip(of_phd, of_mcmc, strict=True)
    ]
    gaps = {
        f"σ² = {variance:g}, N = {number}": mine(chain, number, variance)
        - mine(PHD, number, variance)
        for variance in PRINTED
        for number in numbers
    }
    won = np.concatenate([_known_mean(each) > 0 for each in gaps.values()])
    seeds = len(next(iter(gaps.values())))
    return Claim(
        f"SMC PHD has a lower error to {of} than MCMC",
        f"in {sum(printed)} of {len(printed)} cells",
        form,
        with_seeds(f"in {int(won.sum())} of {len(won)} cells", seeds),
        {
            name: most_hold(decided(target[np.isfinite(target)].tolist()) for target in each.T)
            for name, each in gaps.items()
        },
    )


def _saturates(form: str, numbers: Sequence[int], mine: Errors, chain: str) -> Claim:
    """The error at the largest N is within 15 % of that at the smallest."""
    few, many = numbers[0], numbers[-1]
    both = {
        f"σ² = {variance:g}": [
            _known_mean(mine(chain, number, variance).T) for number in (many, few)
        ]
        for variance in PRINTED
    }
    printed = [np.mean(cells[4000][0]) / np.mean(cells[100][0]) for cells in PRINTED.values()]
    ratios = [last.mean() / first.mean() for last, first in both.values()]
    return _judged(
        "the MCMC filter's error hardly depends on N",
        f"{', '.join(f'{one:.2f}' for one in printed)} times from N = 100 to 4000",
        form,
        f"{', '.join(f'{one:.2f}' for one in ratios)} times from N = {few} to {many}",
        {name: 0.15 - np.abs(last / first - 1) for name, (last, first) in both.items()},
    )


def _falls(numbers: Sequence[int], mine: Errors) -> Claim:
    """The error falls in every step from one N to the next."""
    steps = {
        f"σ² = {variance:g}": [_known_mean(mine(PHD, number, variance).T) for number in numbers]
        for variance in PRINTED
    }
    printed = [np.mean(cells[4000][2]) / np.mean(cells[100][2]) for cells in PRINTED.values()]
    ratios = [each[-1].mean() / each[0].mean() for each in steps.values()]
    figures = (
        f"{', '.join(f'{one:.2f}' for one in ratios)} times from N = {numbers[0]} to {numbers[-1]}"
    )
    return Claim(
        "the SMC PHD filter's error falls with N",
        f"{', '.join(f'{one:.2f}' for one in printed)} times from N = 100 to 4000",
        WORDS,
        with_seeds(figures, len(next(iter(steps.values()))[0])),
        {
            name: all_hold(decided((a - b).tolist()) for a, b in itertools.pairwise(each))
            for name, each in steps.items()
        },
    )


def _doubles(form: str, numbers: Sequence[int], mine: Errors, chain: str) -> Claim:
    """The mean square grows three to five times if σ² grows four times."""
    both = {
        f"N = {number}": [_known_mean(mine(chain, number, variance).T) for variance in (2.0, 0.5)]
        for number in numbers
    }
    printed = [
        np.mean(PRINTED[2.0][number][0]) / np.mean(PRINTED[0.5][number][0])
        for number in PRINTED[2.0]
    ]
    ratios = [high.mean() / low.mean() for high, low in both.values()]
    return _judged(
        "the MCMC filter's figures grow with σ² as mean squares do: 4 times from 0.5 to 2",
        f"{min(printed):.1f} to {max(printed):.1f} times",
        form,
        f"mean squares {min(ratios):.1f} to {max(ratios):.1f} times, roots"
        f" {min(ratios) ** 0.5:.1f} to {max(ratios) ** 0.5:.1f}",
        {name: 1 - np.abs(high / low - 4) for name, (high, low) in both.items()},
    )


def _faster(results: Results, numbers: Sequence[int], seeds: int) -> Claim:
    """The median over the variances of the seconds of a sequence."""
    spent = {
        number: [
            np.median(
                [
                    [
                        results[CorridorRun(WORLD, name, number, variance, seed)].seconds
                        for variance in PRINTED
                    ]
                    for seed in range(seeds)
                ],
                axis=1,
            )
            for name in (PHD, MCMC)
        ]
        for number in numbers
    }
    last = [each.mean() for each in spent[numbers[-1]]]
    return _judged(
        "SMC PHD takes less time than MCMC",
        "53 and 63 s at N = 4000",
        WORDS,
        f"{last[0]:.1f} and {last[1]:.1f} s at N = {numbers[-1]}",
        {f"N = {number}": mcmc - phd for number, (phd, mcmc) in spent.items()},
    )
