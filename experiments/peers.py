"""Our filters and widely used trackers: same detections, no score threshold, one set of parameters,
TrackEval's scores.

Writes two pages: peers.md, and defaults.md, which compares the filters and the parts of the default
one.

Peers' scores come from `bench/peers.csv` next to the real sequences, and the clutter cases from
`bench/make_clutter.py`: no peer is run here. Every filter has its defaults. Truth that the
benchmark marks as ignored is left out, as TrackEval does for MOT15, so that scores are comparable.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy import stats

from experiments.common import Case, Options, built, followed, in_parallel, need_data, table, write
from experiments.degraded_inputs import OLD_SEQUENCES
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_seqinfo, read_truth
from phdtrack.metrics import Scores, evaluate, pool
from phdtrack.types import Truth

MADE: tuple[str, ...] = ("PETS09-S2L1", "TUD-Campus")
SEQUENCES: Mapping[str, tuple[str, ...]] = OLD_SEQUENCES
RATES = (0, 5, 20)
# Uniform clutter, and the same with five places with repeated false boxes.
CLUTTER = tuple(f"{kind}{rate}" for kind in "up" for rate in RATES)
# Peers are scored on the first.
SEEDS = 3
# Name, filter, and changes to the defaults.
TRACKERS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "pmb": ("pmb", ()),
    "pmb, 3 frames late": ("pmb", ("associate.output_delay=3",)),
    "particle-phd": ("particle-phd", ()),
    "gm-phd": ("gm-phd", ()),
    "mht": ("mht", ()),
    "none": ("none", ()),
}
SHOWN = ("HOTA", "MOTA", "IDF1")
# Changes to the defaults: parts switched off,
PARTS: Mapping[str, tuple[str, ...]] = {
    "as shipped": (),
    "corrected tracks not smoothed": ("smooth.smoothing=false",),
    "corrected tracks not stitched": ("smooth.stitching=false",),
    "neither": ("smooth.smoothing=false", "smooth.stitching=false"),
    "no occlusion of targets": ("filter.mean_visible_time=0",),
    "no static clutter": ("filter.static_clutter_prior=0",),
    "no new velocities": ("filter.turns_per_second=0",),
    "p_D as set": ("filter.detection_memory=0",),
    "scores not used": ("detection_scores.kind=none",),
    "no lasting clutter": ("filter.lasting_clutter_prior=0",),
    "noises as the model's": ("filter.noise_freedom=0",),
    "one acceleration": ("filter.acceleration_factors=[1]",),
    "no motion of the camera": ("common_motion.kind=none",),
    "one hypothesis a target": ("filter.max_hypotheses=1",),
    "the past not revised": ("filter.history=1",),
    "targets that overlap are all reported": ("extract.merge_iou=1",),
    "association by graph, not by label": ("associate.kind=graph",),
}
# and numbers changed.
NUMBERS: Mapping[str, tuple[str, ...]] = {
    "box noise half (0.07)": ("sensor.box_noise=0.07",),
    "box noise twice (0.28)": ("sensor.box_noise=0.28",),
    "acceleration twice (0.01)": ("motion.acceleration=0.01",),
    "acceleration half (0.0025)": ("motion.acceleration=0.0025",),
    "size noise half (0.055)": ("motion.size_noise=0.055",),
    "survival of M07 (0.99)": ("motion.survival_probability=0.7778",),
    "p_D 0.9": ("sensor.detection_probability=0.9",),
    "p_D 0.7": ("sensor.detection_probability=0.7",),
    "false alarms half (0.21)": ("clutter.clutter_per_detection=0.21",),
    "false alarms twice (0.84)": ("clutter.clutter_per_detection=0.84",),
    "births twice (0.001 a frame)": ("birth.births_per_detection=0.025",),
    "hidden twice as long (0.6 s)": ("filter.mean_occluded_time=0.6",),
    "static clutter detected more often (0.5)": (
        "filter.static_clutter_detection_probability=0.5",
    ),
}
ABLATED = "pmb"


@dataclass(frozen=True, slots=True)
class PeerRun:
    """One run on one sequence; ``case``: frcnn, public, or a clutter case with its seed, as
    peers.csv names them.
    """

    case: str
    sequence: str
    method: str
    seed: int = 1
    sets: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PeerScores:
    """Scores of the online rows, without delay, and of the corrected tracks."""

    online: Scores
    offline: Scores


def bench() -> Path:
    """The folder of the comparison; `InputError` if it is missing."""
    folder = need_data().parent / "bench"
    if not (folder / "peers.csv").is_file():
        raise InputError(
            "the peers' scores are missing",
            where=folder,
            cure="Put bench/ with peers.csv and make_clutter.py there",
        )
    return folder


@lru_cache(maxsize=1)
def simulated_detections() -> tempfile.TemporaryDirectory[str]:
    """The clutter cases in a temporary folder of this process, made once."""
    folder = tempfile.TemporaryDirectory()
    script = (bench() / "make_clutter.py", "--gt-root", need_data() / "mot15", "--out", folder.name)
    rates = map(str, RATES)
    seeds = map(str, range(1, SEEDS + 1))
    options = ("--seqs", *MADE, "--lambdas", *rates, "--seeds", *seeds)
    subprocess.run(
        [sys.executable, *map(str, script), *options], check=True, stdout=subprocess.DEVNULL
    )
    return folder


def work(job: PeerRun) -> PeerScores:
    """Score one run."""
    folder = need_data() / "mot15" / job.sequence
    info = read_seqinfo(folder)
    truth = counted(read_truth(folder / "gt" / "gt.txt"))
    if job.case in SEQUENCES:
        found = folder / f"det_{job.case}" / "det.txt"
    else:
        found = Path(simulated_detections().name) / job.case / job.sequence / "det" / "det.txt"
    run = followed(
        built(info, job.method, job.sets),
        Case(job.sequence, info, truth, read_detections(found)),
        job.seed,
    )
    online = evaluate(truth, run.online.select(run.online.confirmed), frames=info.frames)
    return PeerScores(online, evaluate(truth, run.corrected, frames=info.frames))


def counted(truth: Truth) -> Truth:
    """The rows that count."""
    rows = ~truth.distractor
    return Truth(truth.frame[rows], truth.identity[rows], truth.xyxy[rows], truth.distractor[rows])


@dataclass(frozen=True, slots=True, eq=False)
class ComparedRuns:
    """All runs; the peers' rows by case and sequence; ``sequences`` of each case, ``trackers`` and
    number of ``seeds``.
    """

    results: Mapping[PeerRun, PeerScores]
    peers: Mapping[tuple[str, str], Sequence[Mapping[str, str]]]
    sequences: Mapping[str, tuple[str, ...]]
    trackers: tuple[str, ...]
    seeds: int

    def runs(
        self, case: str, sequence: str, method: str, sets: tuple[str, ...] = ()
    ) -> list[PeerScores]:
        """One outcome for each seed."""
        return [
            self.results[_job(case, sequence, method, seed, sets)]
            for seed in range(1, self.seeds + 1)
        ]

    def mean(
        self, case: str, method: str, kind: str, score: str, sets: tuple[str, ...] = ()
    ) -> float:
        """A score pooled over all sequences of a case, its mean over the seeds, in points."""
        runs = zip(
            *(self.runs(case, sequence, method, sets) for sequence in self.sequences[case]),
            strict=True,
        )
        pooled = (pool([getattr(run, kind) for run in each]) for each in runs)
        return float(np.mean([100 * getattr(one, score) for one in pooled]))

    def best(self, case: str, sequence: str, score: str) -> tuple[float, str]:
        """The best peer's score in points, and its name; NaN if none was scored."""
        rows = [
            row
            for row in self.peers.get((_peers_case(case), sequence), ())
            if row["name"] != "oracle"
        ]
        return max(((float(row[score]), row["name"]) for row in rows), default=(float("nan"), "–"))


def _peers_case(case: str) -> str:
    return case if case in SEQUENCES else f"{case}-s1"


def _job(case: str, sequence: str, method: str, seed: int, sets: tuple[str, ...] = ()) -> PeerRun:
    """The run for a seed; real detections with filters without randomness need only one."""
    if case not in SEQUENCES:
        return PeerRun(
            f"{case}-s{seed}", sequence, method, seed if method == "particle-phd" else 1, sets
        )
    return PeerRun(case, sequence, method, seed if method == "particle-phd" else 1, sets)


def main(options: Options) -> Path:
    """Run everything and write peers.md."""
    quick = options.quick
    sequences = dict.fromkeys(SEQUENCES, ("TUD-Campus",)) if quick else dict(SEQUENCES)
    sequences |= dict.fromkeys(CLUTTER[:1] if quick else CLUTTER, MADE[1:] if quick else MADE)
    trackers = tuple(TRACKERS)[:2] if quick else tuple(TRACKERS)
    seeds = 1 if quick else SEEDS
    changes = [*PARTS.values(), *([] if quick else NUMBERS.values())]
    methods = [TRACKERS[name] for name in trackers] + [(ABLATED, sets) for sets in changes]
    every = (
        _job(case, sequence, method, seed, sets)
        for method, sets in methods
        for case, names in sequences.items()
        for sequence in names
        for seed in range(1, seeds + 1)
    )
    jobs = list(dict.fromkeys(every))
    results = dict(zip(jobs, in_parallel(work, jobs, "peers", options), strict=True))
    found = ComparedRuns(results, read_peers(), sequences, trackers, seeds)
    real = [case for case in sequences if case in SEQUENCES]
    clutter = [case for case in sequences if case not in SEQUENCES]
    numbers = _parts_table(found, {} if quick else NUMBERS)
    write(
        "defaults",
        options,
        seeds=seeds,
        filters=_filters_table(found),
        parts=_parts_table(found, PARTS),
        numbers=numbers,
    )
    tables = {"real": _pooled_table(found, real), "clutter": _pooled_table(found, clutter)}
    return write("peers", options, seeds=seeds, sequences=_sequence_table(found, real), **tables)


def read_peers() -> dict[tuple[str, str], list[Mapping[str, str]]]:
    """The rows of peers.csv by case and sequence (``ALL``: pooled)."""
    out: dict[tuple[str, str], list[Mapping[str, str]]] = {}
    with (bench() / "peers.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            out.setdefault((row["case"], row["seq"]), []).append(row)
    return out


def _pooled_table(found: ComparedRuns, cases: Sequence[str]) -> str:
    header = (
        "case",
        "tracker",
        *(f"{score} {kind}" for kind in ("online", "corrected") for score in SHOWN),
    )
    rows: list[tuple[object, ...]] = []
    for case in cases:
        best = (
            f"{value:.1f} {name}"
            for value, name in (found.best(case, "ALL", score) for score in SHOWN)
        )
        rows.append((case, "best peer in each", *best, "", "", ""))
        for name in found.trackers:
            method, sets = TRACKERS[name]
            kinds = ((kind, score) for kind in ("online", "offline") for score in SHOWN)
            cells = (f"{found.mean(case, method, kind, score, sets):.1f}" for kind, score in kinds)
            rows.append((case, name, *cells))
    return table(header, rows)


def _sequence_table(found: ComparedRuns, cases: Sequence[str]) -> str:
    """Scores of corrected tracks minus the best peer's, sequence by sequence."""
    header = (
        "case",
        "sequence",
        "tracker",
        *(f"{score} (less the best peer's)" for score in SHOWN),
    )
    rows = []
    for case in cases:
        for sequence in found.sequences[case]:
            for name in found.trackers:
                method, sets = TRACKERS[name]
                if sets:
                    continue
                cells = []
                for score in SHOWN:
                    runs = found.runs(case, sequence, method)
                    ours = float(np.mean([100 * getattr(run.offline, score) for run in runs]))
                    cells.append(f"{ours:.1f} ({ours - found.best(case, sequence, score)[0]:+.1f})")
                rows.append((case, sequence, method, *cells))
    return table(header, rows)


def _filters_table(found: ComparedRuns) -> str:
    """All filters: means over kinds of detections."""
    cases = {
        "real": [case for case in found.sequences if case in SEQUENCES],
        "uniform clutter": [case for case in found.sequences if case.startswith("u")],
        "places": [
            case for case in found.sequences if case.startswith("p") and case not in SEQUENCES
        ],
    }
    kinds = {name: group for name, group in cases.items() if group}
    header = (
        "filter",
        *(f"{name} {score}" for name in kinds for score in SHOWN),
        "online, real IDF1",
    )
    rows = []
    for name in found.trackers:
        method, sets = TRACKERS[name]
        if sets:
            continue
        means = ((group, "offline", score) for group in kinds.values() for score in SHOWN)
        cells = [
            np.mean([found.mean(case, method, kind, score) for case in group])
            for group, kind, score in means
        ]
        online = np.mean([found.mean(case, method, "online", "IDF1") for case in kinds["real"]])
        rows.append((name, *(f"{cell:.1f}" for cell in (*cells, online))))
    return table(header, rows)


def _parts_table(found: ComparedRuns, parts: Mapping[str, tuple[str, ...]]) -> str:
    """Corrected tracks with each part changed, as differences to the defaults."""
    groups = {"real": [case for case in found.sequences if case in SEQUENCES]}
    groups |= {case: [case] for case in found.sequences if case in ("u20", "p20")}
    header = ("change", *(f"{name} {score}" for name in groups for score in SHOWN))
    rows = []
    for name, sets in parts.items():
        cells = []
        for group in groups.values():
            for score in SHOWN:
                value, half = _gain(found, group, score, sets)
                cells.append(f"{value:+.1f} ± {half:.1f}" if sets else f"{value:.1f}")
        rows.append((name, *cells))
    return table(header, rows)


def _gain(
    found: ComparedRuns, cases: Sequence[str], score: str, sets: tuple[str, ...]
) -> tuple[float, float]:
    """The effect of a change on the default, pooled, in points, and half the width of its 95 %
    interval over the runs.

    By the jackknife: the change of the difference if one sequence (with simulated clutter: of one
    seed) is left out (Efron and Tibshirani 1993, 11.5). For the defaults themselves, the score.
    """
    runs = {
        which: [
            run.offline
            for case in cases
            for sequence in found.sequences[case]
            for run in found.runs(case, sequence, ABLATED, which)[
                : 1 if case in SEQUENCES else found.seeds
            ]
        ]
        for which in {(), sets}
    }

    def pooled(which: tuple[str, ...], out: int = -1) -> float:
        return 100 * float(
            getattr(pool([one for k, one in enumerate(runs[which]) if k != out]), score)
        )

    if not sets:
        return pooled(()), 0.0
    n = len(runs[sets])
    without = (
        np.array([pooled(sets, out) - pooled((), out) for out in range(n)])
        if n > 1
        else np.full(1, np.nan)
    )
    deviation = float(np.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum()))
    return pooled(sets) - pooled(()), float(stats.t.ppf(0.975, max(n - 1, 1))) * deviation
