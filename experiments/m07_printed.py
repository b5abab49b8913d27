"""M07 Table 1 on detections of other detectors, public ones and those of a network: the preset
`m07`, its filter with association against association alone.

A section of m07.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments import m07_qcif
from experiments.cases import CASES, Named, cluttered, drawn, short
from experiments.claims import OURS, WORDS, Claim, claims_table
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
from experiments.m07_qcif import FORMS, FOUR, MT, Method
from phdtrack.metrics import pool
from phdtrack.report.pages import counted

PAIR = (MT, WORDS)
# What we would use is another filter on boxes of an object detector than on moving regions.
METHODS = {**m07_qcif.METHODS, OURS: Method("pmb", "", random=False)}
RATES = (0, 5, 20)
SEEDS = 2
FEW = 1
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
    how = METHODS[job.method]
    case = cluttered(drawn(job.case, job.seed), job.rate, job.seed)
    return measure(case, how.filter, job.seed, how.sets, how.preset)


@dataclass(frozen=True, slots=True, eq=False)
class PrintedResults:
    """All runs of the ``cases`` with these ``rates`` of added clutter, for so many ``seeds``."""

    found: Found
    cases: tuple[Named, ...]
    rates: tuple[int, ...]
    seeds: int


def run_all(options: Options) -> PrintedResults:
    """Do all runs."""
    cases = short(CASES)[:1] if options.quick else CASES
    rates = RATES[:: len(RATES) - 1] if options.quick else RATES
    seeds = options.number(SEEDS, FEW)
    jobs = [
        PrintedRun(c, rate, method, k)
        for c in cases
        for rate in rates
        for method, how in METHODS.items()
        for k in range(1, (seeds if how.random or rate else 1) + 1)
    ]
    scored = in_parallel(work, jobs, "m07, other detectors", options)
    return PrintedResults(dict(zip(jobs, scored, strict=True)), cases, rates, seeds)


def section(results: PrintedResults, judged: Sequence[Claim], options: Options) -> str:
    """Draw; return the section of the page."""
    found = results.found
    cases = results.cases
    rates = results.rates
    curve(found, rates, options.folder / "m07-clutter.png")
    paths(cases[0] if options.quick else PICTURE, options.folder / "m07-tracks.png")
    return filled(
        "m07_printed",
        claims=claims_table(judged),
        seeds=counted(results.seeds, "seed"),
        pairs=table(
            ("clutter added", "case", *FOUR),
            [_row(found, case, rate) for rate in rates for case in cases],
        ),
        ahead=table(
            ("clutter added", "of", *(f"{form}: {of}" for form in FORMS for of in _AHEAD)),
            [(rate, len(cases), *_ahead(found, cases, rate)) for rate in rates],
        ),
        curve_rates=", ".join(map(str, rates)),
        heavy=rates[-1],
        pictured=(cases[0] if options.quick else PICTURE)[0],
    )


def claims(results: PrintedResults) -> list[Claim]:
    """The claim of Table 1 on these detections, in each form, without and with added clutter."""
    out = []
    for rate in (results.rates[0], results.rates[-1]):
        for form in FORMS:
            gaps = {
                " ".join(case): _gaps(results.found, case, rate, form) for case in results.cases
            }
            won = sum(gap > 0 for each in gaps.values() for gap in each)
            middle = np.median([each[-1] for each in gaps.values()])
            out.append(
                Claim(
                    f"PHD-MT above MT in {', '.join(FOUR)} (other detectors, {rate} false alarms"
                    " a frame added)",
                    "16 of 16",
                    form,
                    f"{won} of {4 * len(gaps)} pairs, MOTA {middle:+.2f} in the median",
                    {name: all(gap > 0 for gap in each) for name, each in gaps.items()},
                )
            )
    return out


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
        mean(found, case, rate, method, score) - mean(found, case, rate, MT, score)
        for score in FOUR
    ]


_AHEAD = ("ahead in MODA and MOTA", "in all four")


def _ahead(found: Found, cases: Sequence[Named], rate: int) -> list[int]:
    """The number of cases in which each form is ahead of MT in MODA and MOTA, and in all four."""
    out = []
    for form in FORMS:
        gaps = [dict(zip(FOUR, _gaps(found, case, rate, form), strict=True)) for case in cases]
        out.append(sum(min(gap["MODA"], gap["MOTA"]) > 0 for gap in gaps))
        out.append(sum(min(gap.values()) > 0 for gap in gaps))
    return out


def curve(found: Found, rates: Sequence[int], path: Path) -> None:
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
        how = METHODS[method]
        stages = built(case.info, how.filter, how.sets, how.preset)
        tracks = followed(stages, case, 1).corrected
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
