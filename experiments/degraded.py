"""The real sequences with worse detections: without scores, with one score for all, at a third of
the rate, and with half of the detections.

The cases are those of `experiments.cameras`. The peers (SORT, ByteTrack, OC-SORT, BoT-SORT and
C-BIoU of `trackers` 2.6.1, their defaults) track the same detections. Their scores are kept in
`experiments/degraded_peers.csv`; without that file they run in their environment (`make peers`).
"""

from __future__ import annotations

import csv
import importlib
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.common import (
    Options,
    in_parallel,
    need_data,
    run_peers,
    table,
    without_warnings,
    write,
)
from experiments.degraded_inputs import CHANGES, PEERS, CameraCase, cases, changed, write_truth
from phdtrack import Tracker, Tracks
from phdtrack.errors import InputError
from phdtrack.formats import write_tracks

SCORES = ("HOTA", "MOTA", "IDF1")
OUTPUTS = ("online", "corrected")
CSV = Path(__file__).with_name("degraded_peers.csv")
# One short sequence of some groups, for the short form.
SHORT = ("KITTI-0014-car", "GOWT1-01", "TUD-Campus")
# Of several cases in one group the mean of a tracker: group, then one value for each score.
Means = dict[str, list[float]]


@dataclass(frozen=True, slots=True)
class DegradedRun:
    """A case after a change, and the folder ``place`` of truth and tracks."""

    case: CameraCase
    change: str
    place: Path


@dataclass(frozen=True, slots=True)
class DegradedScores:
    """HOTA, MOTA and IDF1, in points, of a tracker in one case after a change."""

    change: str
    tracker: str
    group: str
    case: str
    values: tuple[float, float, float]


def all_cases() -> list[CameraCase]:
    """The cases below the folder of real sequences; `InputError` if the scorer is missing."""
    groups = need_data().parent / "bench" / "groups.csv"
    if not groups.is_file() or not (need_data() / "more").is_dir():
        raise InputError(
            "the sequences of new cameras, or their scorer, are missing", where=groups.parent
        )
    return cases(need_data(), groups)


def track(run: DegradedRun) -> None:
    """Track one case with the default; rows to PLACE/CHANGE/{online,corrected}/DETECTOR."""
    case = run.case
    given = changed(case, run.change)
    write_truth(case, given, run.place / "truth" / run.change / case.sequence)
    boxes = given.xyxy
    if run.change != "no scores":
        boxes = np.column_stack([boxes, given.score])
    tracker = Tracker(given.size, fps=given.fps)
    with without_warnings():
        rows = [
            tracker.update(boxes[given.frame == number], frame=number)
            for number in range(1, given.frames + 1)
        ]
    made = {
        "online": Tracks.concatenate([*rows, tracker.flush()]),
        "corrected": tracker.tracks(),
    }
    for output, tracks in made.items():
        write_tracks(tracks_path(run, output), tracks)


def tracks_path(run: DegradedRun, tracker: str) -> Path:
    """Where a tracker's rows of a case are."""
    case = run.case
    return run.place / "tracks" / run.change / tracker / case.detector / f"{case.sequence}.txt"


def scored(run: DegradedRun) -> list[DegradedScores]:
    """The scores of all trackers that have rows for the case."""
    folder = str(need_data().parent / "bench")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    module = importlib.import_module("score_more")
    scorer = module.MoreScorer(run.place / "truth" / run.change)
    found = []
    for tracker in (*OUTPUTS, *PEERS):
        path = tracks_path(run, tracker)
        if path.is_file():
            row = scorer.row(scorer.sequence(run.case.sequence, path))
            hota, mota, idf1 = (float(row[score]) for score in SCORES)
            found.append(
                DegradedScores(
                    run.change, tracker, run.case.group, run.case.name, (hota, mota, idf1)
                )
            )
    return found


def kept_peers() -> list[DegradedScores]:
    """The peers' scores in `CSV`."""
    with CSV.open(newline="", encoding="utf-8") as file:
        return [
            DegradedScores(
                row["change"],
                row["tracker"],
                row["group"],
                row["case"],
                (float(row["HOTA"]), float(row["MOTA"]), float(row["IDF1"])),
            )
            for row in csv.DictReader(file)
        ]


def keep_peers(found: Sequence[DegradedScores]) -> None:
    """Write the peers' scores to `CSV`."""
    with CSV.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["change", "tracker", "group", "case", *SCORES])
        for one in found:
            values = (f"{value:.3f}" for value in one.values)
            writer.writerow([one.change, one.tracker, one.group, one.case, *values])


def group_means(found: Sequence[DegradedScores], change: str, tracker: str) -> Means:
    """The mean scores over the cases of each group."""
    values: dict[str, list[tuple[float, float, float]]] = {}
    for one in found:
        if (one.change, one.tracker) == (change, tracker):
            values.setdefault(one.group, []).append(one.values)
    return {group: np.mean(those, axis=0).tolist() for group, those in values.items()}


def best_peers(found: Sequence[DegradedScores], change: str) -> Means:
    """The best peer in each score: in each group, and under ``mean`` over the groups, where one
    peer is best by its mean over all of them.
    """
    each = [group_means(found, change, name) for name in PEERS]
    best = {group: np.max([one[group] for one in each], axis=0).tolist() for group in each[0]}
    best["mean"] = np.max([overall(one) for one in each], axis=0).tolist()
    return best


def overall(means: Means) -> list[float]:
    """The mean over the groups."""
    return [float(value) for value in np.mean(list(means.values()), axis=0)]


def cell(values: Sequence[float]) -> str:
    """HOTA / MOTA / IDF1 of a cell."""
    return " / ".join(f"{value:.1f}" for value in values)


def pairs_won(found: Sequence[DegradedScores], change: str, tracker: str) -> tuple[int, int]:
    """In how many (case, score) pairs a tracker reaches the best peer, and of how many."""
    of_case: dict[str, list[tuple[float, float, float]]] = {}
    for one in found:
        if one.change == change and one.tracker in PEERS:
            of_case.setdefault(one.case, []).append(one.values)
    won = 0
    pairs = 0
    for one in found:
        if (one.change, one.tracker) == (change, tracker):
            won += int((np.array(one.values) >= np.max(of_case[one.case], axis=0)).sum())
            pairs += len(SCORES)
    return won, pairs


def change_tables(found: Sequence[DegradedScores]) -> str:
    """A table for each change: the groups, and the mean over them."""
    parts = []
    for change in CHANGES:
        best = best_peers(found, change)
        own = [group_means(found, change, output) for output in OUTPUTS]
        rows = [(group, cell(best[group]), *(cell(one[group]) for one in own)) for group in own[0]]
        rows.append(("mean", cell(best["mean"]), *(cell(overall(one)) for one in own)))
        won = ["{} of {}".format(*pairs_won(found, change, output)) for output in OUTPUTS]
        rows.append(("pairs won", "", *won))
        title = change if change.startswith("p_D") else change.capitalize()
        parts.append(f"## {title}\n\n")
        parts.append(table(("group", "best peer", *OUTPUTS), rows) + "\n")
    return "".join(parts)


def main(options: Options) -> Path:
    """Track and score everything, write degraded.md, and print the means."""
    of = [one for one in all_cases() if not options.quick or one.sequence in SHORT]
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        runs = [DegradedRun(case, change, place) for change in CHANGES for case in of]
        if not CSV.is_file():
            groups = need_data().parent / "bench" / "groups.csv"
            run_peers("degraded", [need_data(), groups, place / "tracks"], options.jobs)
        in_parallel(track, runs, "degraded", options)
        rows = [one for those in in_parallel(scored, runs, "scores", options) for one in those]
    if not CSV.is_file():
        keep_peers([one for one in rows if one.tracker in PEERS])
    own = [one for one in rows if one.tracker in OUTPUTS]
    names = {one.case for one in own}
    found = [*own, *(one for one in kept_peers() if one.case in names)]
    for change in CHANGES:
        means = [overall(group_means(found, change, output)) for output in OUTPUTS]
        print(
            f"{change}: best peer {cell(best_peers(found, change)['mean'])}; "
            + "; ".join(f"{output} {cell(one)}" for output, one in zip(OUTPUTS, means, strict=True))
        )
    return write("degraded", options, cases=len(of), tables=change_tables(found))
