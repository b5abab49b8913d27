"""M07 Table 1 in the paper's own terms: the preset `m07`, its filter with association against
association alone.

A section of m07.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.cases import CASES, Named, cluttered, drawn, short
from experiments.common import (
    Options,
    ScoredCase,
    built,
    filled,
    followed,
    in_parallel,
    measure,
    pyplot,
    table,
)
from phdtrack.metrics import pool

PAIR = ("MT", "PHD-MT")
LATER = "split at 1.5"
# Filter, and its differences to the preset.
METHODS: dict[str, tuple[str, tuple[str, ...]]] = {
    "MT": ("none", ()),
    "PHD-MT": ("particle-phd", ()),
    LATER: ("particle-phd", ("extract.split_weight=1.5",)),
}
RATES = (0, 1, 2, 5, 10, 20)
TABLED = (0, 5, 20)
SEEDS = 2
FEW = 1
FOUR = ("MODA", "MODP", "MOTA", "MOTP")
PICTURE = ("PETS09-S2L1", "public")
PICTURED = 200


@dataclass(frozen=True, slots=True)
class PrintedRun:
    """One run; ``seed`` is that of clutter and particles."""

    case: Named
    rate: int
    method: str
    seed: int


Found = dict[PrintedRun, ScoredCase]


def work(job: PrintedRun) -> ScoredCase:
    """One run, scored."""
    kind, sets = METHODS[job.method]
    return measure(
        cluttered(drawn(job.case, job.seed), job.rate, job.seed), kind, job.seed, sets, "m07"
    )


def section(options: Options) -> str:
    """Run everything and draw; return the section of the page."""
    cases, rates = (short(CASES)[:2], (0, 20)) if options.quick else (CASES, RATES)
    seeds = range(1, options.number(SEEDS, FEW) + 1)
    jobs = [
        PrintedRun(c, rate, method, k)
        for c in cases
        for rate in rates
        for method in METHODS
        for k in seeds
    ]
    found: Found = dict(zip(jobs, in_parallel(work, jobs, "m07, as printed", options), strict=True))
    curve(found, cases, rates, options.folder / "m07-clutter.png")
    paths(cases[0] if options.quick else PICTURE, options.folder / "m07-tracks.png")
    tabled_rates = [rate for rate in TABLED if rate in rates]
    lost = [row for rate in tabled_rates for case in cases for row in _lost(found, case, rate)]
    return filled(
        "m07_printed",
        seeds=len(seeds),
        pairs=table(
            ("clutter added", "case", *FOUR),
            [_row(found, case, rate) for rate in tabled_rates for case in cases],
        ),
        ahead=table(
            (
                "clutter added",
                "of",
                "as printed: ahead in MODA and MOTA",
                "in all four",
                f"{LATER}: in MODA and MOTA",
                "in all four",
            ),
            [(rate, len(cases), *_ahead(found, cases, rate)) for rate in tabled_rates],
        ),
        lost=table(("clutter added", "case", "MODA", "MOTA", f"{LATER}: MODA", "MOTA"), lost),
        shares=_shares(found),
        curve_rates=", ".join(map(str, rates)),
    )


def mean(found: Found, case: Named, rate: int, method: str, score: str) -> float:
    """A score's mean over the seeds."""
    return float(
        np.mean(
            [
                getattr(s.scores, score)
                for j, s in found.items()
                if (j.case, j.rate, j.method) == (case, rate, method)
            ]
        )
    )


def _row(found: Found, case: Named, rate: int) -> tuple[object, ...]:
    cells = (
        " / ".join(f"{mean(found, case, rate, method, score):.3f}" for method in METHODS)
        for score in FOUR
    )
    return (rate, " ".join(case), *cells)


def _gaps(found: Found, case: Named, rate: int, method: str) -> list[float]:
    return [
        mean(found, case, rate, method, score) - mean(found, case, rate, "MT", score)
        for score in FOUR
    ]


def _ahead(found: Found, cases: Sequence[Named], rate: int) -> list[int]:
    """The number of cases in which the filter is ahead in MODA and MOTA, and in all four: as
    printed, and with the higher split threshold.
    """
    out = []
    for method in ("PHD-MT", LATER):
        gaps = [_gaps(found, case, rate, method) for case in cases]
        out += [sum(gap[0] > 0 and gap[2] > 0 for gap in gaps), sum(min(gap) > 0 for gap in gaps)]
    return out


def _lost(found: Found, case: Named, rate: int) -> list[tuple[object, ...]]:
    """The cases in which the printed form is not ahead: differences, also with the higher split
    threshold.
    """
    gaps, later = (_gaps(found, case, rate, method) for method in ("PHD-MT", LATER))
    if gaps[0] > 0 and gaps[2] > 0:
        return []
    return [(rate, " ".join(case), *(f"{gap[k]:+.3f}" for gap in (gaps, later) for k in (0, 2)))]


def _shares(found: Found) -> str:
    """Shares of the stages in the time of a frame, over all runs of the printed form without added
    clutter.
    """
    spent = np.array(
        [s.stages for j, s in found.items() if j.method == "PHD-MT" and j.rate == 0]
    ).sum(axis=0)
    spent = 100 * spent / spent.sum()
    return ", ".join(
        f"{name} {value:.0f} %"
        for name, value in zip(("filter", "K-means", "association"), spent, strict=True)
    )


def curve(found: Found, cases: Sequence[Named], rates: Sequence[int], path: Path) -> None:
    """Draw MODA and MOTA pooled over the cases against the added clutter."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    for axis, score in zip(axes, ("MODA", "MOTA"), strict=True):
        for method in METHODS:
            runs = {
                rate: [s.scores for j, s in found.items() if j.rate == rate and j.method == method]
                for rate in rates
            }
            axis.plot(
                list(runs),
                [getattr(pool(each), score) for each in runs.values()],
                "o-",
                ms=3,
                label=method,
            )
        axis.set(title=score, xlabel="false alarms added per frame", ylim=(-0.5, 1))
        axis.axhline(0, color="0.6", lw=0.8)
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def paths(name: Named, path: Path) -> None:
    """Draw detections with clutter over time, and the tracks of each method, a colour for each
    identity.
    """
    plt = pyplot()
    case = cluttered(drawn(name, 1), RATES[-1], 1)
    figure, axes = plt.subplots(
        1, 4, figsize=(12, 3.6), sharex=True, sharey=True, layout="constrained"
    )
    truth = case.truth
    rows = case.table.frame <= PICTURED
    _strokes(axes[0], truth.frame, truth.identity, truth.xyxy)
    axes[1].plot(
        case.table.frame[rows],
        case.table.detections.xyxy[rows][:, ::2].mean(axis=1),
        ".",
        ms=1,
        color="0.4",
    )
    for axis, method in zip(axes[2:], PAIR, strict=True):
        kind, sets = METHODS[method]
        tracks = followed(built(case.info, kind, sets, "m07"), case, 1).corrected
        _strokes(axis, tracks.frame, tracks.identity, tracks.xyxy)
    for axis, title in zip(axes, ("truth", "detections and clutter", *PAIR), strict=True):
        axis.set(title=title, xlabel="frame", xlim=(0, PICTURED))
    axes[0].set_ylabel("x, pixels")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _strokes(axis: Any, frame: np.ndarray, identity: np.ndarray, xyxy: np.ndarray) -> None:
    """Draw the centres of the boxes over time, a stroke for each identity."""
    for k, who in enumerate(np.unique(identity[frame <= PICTURED]).tolist()):
        mine = (identity == who) & (frame <= PICTURED)
        axis.plot(frame[mine], xyxy[mine][:, ::2].mean(axis=1), lw=1.2, color=f"C{k % 10}")
