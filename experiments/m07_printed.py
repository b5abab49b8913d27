"""M07 Table 1 on detections of other detectors, public ones and those of a network: the preset
`m07`, its filter with association against association alone.

A section of m07.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.cases import CASES, Named, cluttered, drawn, short
from experiments.claims import OURS, WORDS, Claim, claims_table
from experiments.common import (
    Options,
    ScoredCase,
    built,
    filled,
    followed,
    in_parallel,
    pyplot,
    table,
)
from experiments.m07_table import (
    FEW,
    FORMS,
    FOUR,
    METHODS,
    MT,
    RATES,
    SEEDS,
    Method,
    TableResults,
    TableRun,
    ahead,
    jobs_of,
    scored,
)
from experiments.verdicts import rule
from phdtrack.metrics import pool
from phdtrack.report.pages import counted

PAIR = (MT, WORDS)
# What we would use is another filter on boxes of an object detector than on moving regions.
HERE = {**METHODS, OURS: Method("pmb", "", random=False)}
PICTURE = ("PETS09-S2L1", "public")
PICTURED = 200


def work(job: tuple[TableRun, Named]) -> ScoredCase:
    """One run, scored."""
    run, case = job
    return scored(run, drawn(case, run.seed), HERE[run.method])


def run_all(options: Options) -> TableResults:
    """Do all runs."""
    named = {" ".join(case): case for case in (short(CASES)[:1] if options.quick else CASES)}
    rates = RATES[:: len(RATES) - 1] if options.quick else RATES
    jobs = jobs_of(dict.fromkeys(named, rates), options.number(SEEDS, FEW))
    done = in_parallel(
        work, [(job, named[job.case]) for job in jobs], "m07, other detectors", options
    )
    return TableResults(dict(zip(jobs, done, strict=True)), tuple(named), rates)


def section(found: TableResults, judged: Sequence[Claim], options: Options) -> str:
    """Draw; return the section of the page."""
    pictured = short(CASES)[0] if options.quick else PICTURE
    curve(found, options.folder / "m07-clutter.png")
    paths(pictured, options.folder / "m07-tracks.png")
    return filled(
        "m07_printed",
        claims=claims_table(judged),
        rule=rule(),
        seeds=counted(options.number(SEEDS, FEW), "seed"),
        pairs=table(
            ("clutter added", "case", *FOUR),
            [
                (rate, case, *found.cells(case, rate, 3))
                for rate in found.rates
                for case in found.cases
            ],
        ),
        ahead=table(
            ("clutter added", "of", *(f"{form}: {of}" for form in FORMS for of in _AHEAD)),
            [(rate, len(found.cases), *_ahead(found, rate)) for rate in found.rates],
        ),
        curve_rates=", ".join(map(str, found.rates)),
        heavy=found.rates[-1],
        pictured=pictured[0],
    )


def claims(found: TableResults) -> list[Claim]:
    """The claim of Table 1 on these detections, in each form, without and with added clutter."""
    return [
        ahead(found, form, rate, f"other detectors, {rate} false alarms a frame added")
        for rate in (found.rates[0], found.rates[-1])
        for form in FORMS
    ]


_AHEAD = ("ahead in MODA and MOTA", "in all four")


def _ahead(found: TableResults, rate: int) -> list[int]:
    """The number of cases in which each form is ahead of MT in MODA and MOTA, and in all four."""
    return [
        sum(all(found.gap(case, rate, form, score) > 0 for score in scores) for case in found.cases)
        for form in FORMS
        for scores in (("MODA", "MOTA"), FOUR)
    ]


def curve(found: TableResults, path: Path) -> None:
    """Draw MODA and MOTA pooled over the cases against the added clutter."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    for axis, score in zip(axes, ("MODA", "MOTA"), strict=True):
        for method in METHODS:
            runs = {
                rate: [
                    one.scores
                    for run, one in found.scored.items()
                    if (run.rate, run.method) == (rate, method)
                ]
                for rate in found.rates
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
        how = HERE[method]
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
