"""M07 Table 1 on given detections: the particle PHD filter against the same association on raw detections.

    python -m phdtrack.reproduce.detections

Seven cases of real detections, natural and with Poisson clutter added; the same parameters for all of them. M07's sequences
are not public; its finding is that the filter is ahead in every score on every sequence, most where clutter is heavy.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from phdtrack.metrics import pool
from phdtrack.reproduce.common import Case, Result, in_parallel, measure, mot15, table, write
from phdtrack.simulate import add_clutter

CASES = (
    ("PETS09-S2L1", "public"),
    ("PETS09-S2L1", "frcnn"),
    ("TUD-Campus", "public"),
    ("TUD-Campus", "frcnn"),
    ("KITTI-17", "public"),
    ("KITTI-17", "frcnn"),
    ("ADL-Rundle-6", "frcnn"),
)
# No default was chosen by these scores; but they were seen between rounds, and their overlapping boxes were examined.
HELD_OUT = (("ETH-Sunnyday", "public"), ("ETH-Sunnyday", "frcnn"))
RATES = (0, 2, 5, 10, 20)
SEEDS = (1, 2)
CLUTTER_SEEDS = (1,)
FILTERS = ("none", "particle-phd")

Job = tuple[str, str, int, str, int]


@lru_cache(maxsize=8)
def _case(sequence: str, kind: str) -> Case:
    return mot15(sequence, kind)


def cluttered(case: Case, rate: float, seed: int) -> Case:
    """The case with Poisson(``rate``) clutter boxes per frame added, of the truth's sizes."""
    if rate == 0:
        return case
    sizes = case.truth.xyxy[:, 2:] - case.truth.xyxy[:, :2]
    return replace(case, table=add_clutter(case.table, case.info, rate, np.random.default_rng(seed), sizes))


def work(job: Job) -> Result:
    """One run."""
    sequence, kind, rate, filter_name, seed = job
    return measure(cluttered(_case(sequence, kind), rate, seed), filter_name, seed)


def jobs(rates: tuple[int, ...] = RATES) -> list[Job]:
    """All runs; the association on raw natural detections draws nothing at random and needs one."""
    return [
        (*case, rate, name, seed)
        for case in CASES + HELD_OUT
        for rate in (rates if case in CASES else rates[:1])
        for name in FILTERS
        for seed in _seeds(rate, name)
    ]


def _seeds(rate: int, name: str) -> tuple[int, ...]:
    if rate:
        return CLUTTER_SEEDS
    return SEEDS if name != "none" else SEEDS[:1]


def main() -> None:
    """Run everything and write docs/results/detections.md."""
    todo = jobs()
    results = dict(zip(todo, in_parallel(work, todo, "given detections"), strict=True))
    write("detections.md", page(results))


def page(results: dict[Job, Result]) -> str:
    """The page: natural detections in full, then added clutter."""
    ahead = sum(
        _mean(results, case, 0, "particle-phd", "MODA") > _mean(results, case, 0, "none", "MODA")
        and _mean(results, case, 0, "particle-phd", "MOTA") > _mean(results, case, 0, "none", "MOTA")
        for case in CASES
    )
    parts = [
        "# Given detections: the filter against none\n",
        "Written by `python -m phdtrack.reproduce.detections` (part of `make experiments`). Corrected tracks, IoU 0.5, "
        "no score threshold, "
        "shipped defaults for every sequence, mean over seeds 1, 2 (with added clutter, seed 1). `none` is the "
        "same association on the raw detections (M07's MT). *delay*: frames from an object's first detection to its first "
        "output row. *false tracks*: identities that never match an object. *ms* is taken while other runs share the "
        "machine.\n",
        "**The defaults were chosen on these seven cases** (about 140 settings drawn at random, then scans by hand), so the "
        "rows show what the filter adds under one setting for all and are no estimate for other data. ETH-Sunnyday (moving "
        "camera) did not decide any default, but its scores were seen between rounds and its overlapping boxes were "
        "examined: it is nearly, not strictly, held out.\n",
        "M07 Table 1 has PHD-MT ahead of MT in all four scores on all four of its sequences, for example MOTA 0.15 against "
        "−0.58 on its most cluttered one. Its data are not public; these are other sequences and other detectors.\n",
        f"Ahead in MODA and MOTA both on **{ahead} of {len(CASES)}** cases.\n",
        "## As detected\n",
        table(
            ("case", "filter", "MODA", "MODP", "MOTA", "MOTP", "IDF1", "HOTA", "switches", "delay", "false tracks", "ms"),
            [_row(results, case, 0, name) for case in CASES + HELD_OUT for name in FILTERS],
        ),
        "## With Poisson clutter added\n",
        "MODA and MOTA, `none` → `particle-phd`, and the gap. Clutter boxes are uniform over the frame and have the truth's "
        "sizes.\n",
        table(("case", *(f"λ = {rate}" for rate in RATES)), [_sweep(results, case, "MODA") for case in CASES]),
        table(("case", *(f"λ = {rate}" for rate in RATES)), [_sweep(results, case, "MOTA") for case in CASES]).replace(
            "| case |", "| MOTA |", 1
        ),
        "False tracks and delay in frames, `none` → `particle-phd`:\n",
        table(("case", *(f"λ = {rate}" for rate in RATES)), [_false(results, case) for case in CASES]),
        "Pooled over the seven cases:\n",
        table(
            ("λ", "filter", "N-MODA", "MOTA", "IDF1", "HOTA", "false tracks", "delay"),
            [_pooled(results, rate, name) for rate in RATES for name in FILTERS],
        ),
    ]
    return "\n".join(parts).replace("| case | λ", "| MODA | λ", 1)


def _runs(results: dict[Job, Result], case: tuple[str, str], rate: int, name: str) -> list[Result]:
    return [results[key] for seed in SEEDS if (key := (*case, rate, name, seed)) in results]


def _mean(results: dict[Job, Result], case: tuple[str, str], rate: int, name: str, score: str) -> float:
    return float(np.mean([getattr(run.scores, score) for run in _runs(results, case, rate, name)]))


def _row(results: dict[Job, Result], case: tuple[str, str], rate: int, name: str) -> list[object]:
    runs = _runs(results, case, rate, name)
    scores = [_mean(results, case, rate, name, s) for s in ("MODA", "MODP", "MOTA", "MOTP", "IDF1", "HOTA")]
    switches = round(_mean(results, case, rate, name, "id_switches"))
    delay = f"{np.nanmean([run.delay for run in runs]):.1f}"
    false = f"{_mean(results, case, rate, name, 'false_tracks'):.1f}"
    return [
        " ".join(case),
        name,
        *scores,
        switches,
        delay,
        false,
        f"{1e3 * np.mean([r.seconds_per_frame for r in runs]):.1f}",
    ]


def _sweep(results: dict[Job, Result], case: tuple[str, str], score: str) -> list[object]:
    cells = []
    for rate in RATES:
        none, phd = (_mean(results, case, rate, name, score) for name in FILTERS)
        cells.append(f"{none:.2f} → {phd:.2f} (**{phd - none:+.2f}**)")
    return [" ".join(case), *cells]


def _false(results: dict[Job, Result], case: tuple[str, str]) -> list[object]:
    cells = []
    for rate in RATES:
        none, phd = (_mean(results, case, rate, name, "false_tracks") for name in FILTERS)
        late = [np.nanmean([run.delay for run in _runs(results, case, rate, name)]) for name in FILTERS]
        cells.append(f"{none:.0f} → {phd:.0f}, {late[0]:.1f} → {late[1]:.1f}")
    return [" ".join(case), *cells]


def _pooled(results: dict[Job, Result], rate: int, name: str) -> list[object]:
    runs = [_runs(results, case, rate, name) for case in CASES]
    seeds = range(min(len(r) for r in runs))
    pools = [pool([r[s].scores for r in runs]) for s in seeds]
    scores = [float(np.mean([getattr(p, s) for p in pools])) for s in ("N_MODA", "MOTA", "IDF1", "HOTA")]
    false = f"{np.mean([p.false_tracks for p in pools]):.0f}"
    delay = f"{np.nanmean([r.delay for case in runs for r in case]):.1f}"
    return [rate, name, *scores, false, delay]


if __name__ == "__main__":
    main()
