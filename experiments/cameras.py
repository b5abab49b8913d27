"""New cameras and current detectors: two presets and 18 motion-only trackers, cross-validated over
groups.

The sequences are those in the folder ``more`` of the real data (MOT17, MOT20, DanceTrack, KITTI,
cells, players, aerial views) and those of MOT15. All are tracked with the same settings and without
camera motion. Boxes without an area are skipped. The scorer and the peers' scores are in the folder
``bench`` next to the data.

The preset ``mot15`` was chosen on MOT15. The default was chosen among its `VARIANTS` on all groups;
cross-validation estimates its effect elsewhere: each group is tracked with the variant that is best
on the other groups, by the mean over groups of the mean distance of the online rows to the best
peer.

Synthetic cameras (`experiments.synthetic_cameras`), on which one threshold was chosen, show what
the default and its variants are worth elsewhere. Each is a group of its own, because each is drawn
independently of the others: the error of their mean is that of independent cameras.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from experiments.common import Options, in_parallel, need_data, table, without_warnings, write
from experiments.peers import SEQUENCES, counted
from experiments.synthetic_cameras import FINAL, KINDS, described, drawn, name_of, seed_of
from experiments.synthetic_cases import DETECTOR, camera_case, peers_of_cameras, points
from experiments.synthetic_detector import SCORE_LAWS
from phdtrack import Tracker, Tracks
from phdtrack.errors import InputError
from phdtrack.formats import read_seqinfo, read_truth, write_tracks
from phdtrack.metrics import evaluate
from phdtrack.types import F8, I8, SequenceInfo

SCORES = ("HOTA", "MOTA", "IDF1")
OUTPUTS = ("online", "delayed", "corrected")
# Seconds by which delayed rows lag behind.
DELAY = 0.3
# One short sequence of some groups, for the short form.
SHORT = ("KITTI-0014-car", "GOWT1-01", "MOT17-09")
OURS = ("pmb", "gm-phd", "phdtrack")
# The peers that run on synthetic cameras, by their names on the real sequences.
OF_TRACKERS = ("rf-sort", "rf-bytetrack", "rf-ocsort")
# Cameras of the short form.
FEW = 2
Sets = Mapping[str, Mapping[str, object]]
# The preset and the settings that differ from it.
VARIANTS: Mapping[str, tuple[str, Sets]] = {
    "mot15": ("mot15", {}),
    "default": ("default", {}),
    "one agility (0.028)": ("default", {"filter": {"acceleration_factors": (5.6,)}}),
    "agility of 1 and 10": ("default", {"filter": {"acceleration_factors": (1.0, 10.0)}}),
    "noises as the model's": ("default", {"filter": {"noise_freedom": 0.0}}),
    "noise freedom 20": ("default", {"filter": {"noise_freedom": 20.0}}),
    "camera not looked for": ("default", {"common_motion": {"kind": "none"}}),
    "never hidden": ("default", {"filter": {"mean_visible_time": 0.0}}),
    "time as of videos": ("default", {"time": {"longest_interval": 0.0}}),
    "no decay of clutter": ("default", {"filter": {"clutter_decay": 0.0}}),
    "boxes as filtered": ("default", {"smooth": {"detection_share": False}}),
    "smoothed with one noise": ("default", {"smooth": {"noise_by_track": False}}),
    "scores not used": ("default", {"detection_scores": {"kind": "none"}}),
    "scores, slope 1": ("default", {"detection_scores": {"kind": "scores", "slope": 1.0}}),
    "no lasting clutter": ("default", {"filter": {"lasting_clutter_prior": 0.0}}),
    "lasting clutter 0.05": ("default", {"filter": {"lasting_clutter_prior": 0.05}}),
    "lasting clutter 0.2": ("default", {"filter": {"lasting_clutter_prior": 0.2}}),
    "overlap 0.63": ("default", {"extract": {"merge_iou": 0.63}}),
    "coast as set": ("default", {"associate": {"coast_by_evidence": False}}),
    "coast 0.12 s": ("default", {"associate": {"max_coast": 0.12}}),
    "no static clutter": ("default", {"filter": {"static_clutter_prior": 0.0}}),
    "no new velocities": ("default", {"filter": {"turns_per_second": 0.0}}),
    "p_D as set": ("default", {"filter": {"detection_memory": 0.0}}),
    "false alarms not counted": ("default", {"detection_scores": {"usual_alone": 1.0}}),
    "box noise 0.1": ("default", {"sensor": {"box_noise": 0.1}}),
    "box noise 0.2": ("default", {"sensor": {"box_noise": 0.2}}),
    "size noise 0.08": ("default", {"motion": {"size_noise": 0.08}}),
    "false alarms 0.3": ("default", {"clutter": {"clutter_per_detection": 0.3}}),
    "false alarms 1": ("default", {"clutter": {"clutter_per_detection": 1.0}}),
}
SHOWN = ("mot15", "default")
# Largest distance to the best peer, in points, that is not listed.
BEHIND = {"online": 5.0, "corrected": 2.0}
# Variant, folder of the sequence, name of the detections, folder of the results, and True for
# delayed rows only.
CameraRun = tuple[str, str, str, str, bool]
Row = Mapping[str, str]


def bench() -> Path:
    """The folder with the scorer and the peers' scores; `InputError` if it is missing."""
    folder = need_data().parent / "bench"
    if not (folder / "score_more.py").is_file() or not (need_data() / "more").is_dir():
        raise InputError("the sequences of new cameras, or their scorer, are missing", where=folder)
    return folder


def folder_of(sequence: str) -> Path:
    """The folder of a sequence, of MOT15 or of the new cameras."""
    old = need_data() / "mot15" / sequence
    return old if old.is_dir() else need_data() / "more" / sequence


def boxes_of(sequence: str, detector: str) -> tuple[SequenceInfo, I8, F8]:
    """A sequence, and the frames (M,) and boxes (M, 5) of a detector; (M, 4) without scores."""
    if detector == DETECTOR:
        case = camera_case(sequence)
        found = case.table.detections
        has_scores = bool((found.confidence < 1).any())
        boxes = np.column_stack([found.xyxy, found.confidence]) if has_scores else found.xyxy
        return case.info, case.table.frame, boxes
    folder = folder_of(sequence)
    rows = np.loadtxt(folder / f"det_{detector}" / "det.txt", delimiter=",", ndmin=2)
    rows = rows[(rows[:, 4:6] > 0).all(axis=1)]
    boxes = np.column_stack([rows[:, 2:4], rows[:, 2:4] + rows[:, 4:6], rows[:, 6]])
    return read_seqinfo(folder), rows[:, 0].astype(np.int64), boxes


def track(job: CameraRun) -> None:
    """Track one sequence; its rows go to RESULTS/VARIANT/OUTPUT/DETECTOR/SEQUENCE.txt."""
    variant, sequence, detector, results, delayed = job
    preset, sets = VARIANTS[variant]
    info, frame, boxes = boxes_of(sequence, detector)
    late = {"output_delay": round(DELAY * info.fps) if delayed else 0}
    settings = {**sets, "associate": {**sets.get("associate", {}), **late}}
    tracker = Tracker((info.width, info.height), fps=info.fps, preset=preset, **settings)
    online = []
    with without_warnings():
        for number in range(1, info.frames + 1):
            online.append(tracker.update(boxes[frame == number], frame=number))
    online_rows = Tracks.concatenate([*online, tracker.flush()])
    made = (
        {"delayed": online_rows}
        if delayed
        else {"online": online_rows, "corrected": tracker.tracks()}
    )
    for output, tracks in made.items():
        keep(tracks, Path(results) / variant, output, sequence, detector)


def keep(tracks: Tracks, place: Path, output: str, sequence: str, detector: str) -> None:
    """Keep the rows of one case for `scored`: those of new cameras; of MOT15 and of synthetic
    cameras their scores.
    """
    if detector == DETECTOR:
        values = points(camera_case(sequence), tracks)
        _keep_scores(place, output, sequence, sequence, detector, values)
        return
    folder = folder_of(sequence)
    if folder.parent.name != "mot15":
        write_tracks(place / output / detector / f"{sequence}.txt", tracks)
        return
    truth = counted(read_truth(folder / "gt" / "gt.txt"))
    scores = evaluate(truth, tracks, frames=read_seqinfo(folder).frames)
    values = [str(100 * getattr(scores, name)) for name in SCORES]
    _keep_scores(place, output, "MOT15", sequence, detector, values)


def _keep_scores(
    place: Path, output: str, group: str, sequence: str, detector: str, values: Sequence[str]
) -> None:
    """Write the scores of one case."""
    place.mkdir(parents=True, exist_ok=True)
    text = ",".join([group, sequence, detector, *values])
    (place / f"{output}-{sequence}-{detector}.csv").write_text(text, encoding="utf-8")


def scored(job: tuple[str, str, str]) -> list[Row]:
    """The scores of every case and of every group (whose sequence is ALL) of a variant's output.

    New cameras are scored by the scorer in the folder next to the data. MOT15 and synthetic cameras
    were scored while tracking; the group MOT15 is the mean of its cases.
    """
    variant, output, place = job
    results = Path(place) / variant
    kept = Path(place) / variant / f"{output}.csv"
    command = [sys.executable, str(bench() / "score_more.py"), "--data", str(need_data() / "more")]
    command += ["--results", str(results / output), "--name", output, "--out", str(kept)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise InputError(
            f"the scorer failed: {done.stderr.strip()[-300:]}", where=bench() / "score_more.py"
        )
    names = ("group", "sequence", "detector", *SCORES)
    others = [
        dict(zip(names, file.read_text(encoding="utf-8").split(","), strict=True))
        for file in sorted(results.glob(f"{output}-*.csv"))
    ]
    rows = [*_read(kept), *others]
    old = [row for row in others if row["group"] == "MOT15"]
    if old:
        mean = {name: str(np.mean([float(row[name]) for row in old])) for name in SCORES}
        rows.append({"group": "MOT15", "sequence": "ALL", "detector": "ALL", **mean})
    return rows


def peers_of_cases() -> list[Row]:
    """The peers' scores in every case, of new cameras and of MOT15."""
    old = [
        {
            "group": "MOT15",
            "sequence": row["seq"],
            "detector": row["case"],
            **{key: row[key] for key in ("name", *SCORES)},
        }
        for row in _read(bench() / "peers.csv")
        if row["name"] != "oracle" and row["seq"] in SEQUENCES.get(row["case"], ())
    ]
    return [*_read(bench() / "peers_more.csv"), *newer_peers(), *old]


def newer_peers() -> list[Row]:
    """The newer peers' scores in every case of new cameras; a header that the file repeats is left
    out.
    """
    return [row for row in _read(bench() / "peers_new.csv") if row["part"] != "part"]


def peers_of_groups() -> list[Row]:
    """The peers' scores in every group of new cameras; those of the newer ones by `pooled`.

    A peer that lacks a case of a group has no row for it.
    """
    rows = _read(bench() / "peers_more_groups.csv")
    cases = {row["group"]: int(row["cases"]) for row in rows}
    found: dict[tuple[str, str], list[Row]] = {}
    for row in newer_peers():
        found.setdefault((row["group"], row["name"]), []).append(row)
    for (group, name), those in found.items():
        if len(those) == cases[group]:
            scores = pooled(those, [true_boxes(row["sequence"]) for row in those])
            values = {score: f"{value:.3f}" for score, value in scores.items()}
            rows.append({"group": group, "name": name, **values})
    return rows


def pooled(rows: Sequence[Row], true: Sequence[int]) -> dict[str, float]:
    """The scores of several cases together, from the scores and errors of each, in points.

    MOTA and IDF1 are exact: their parts follow from the numbers of true boxes, misses and false
    boxes. HOTA, whose parts are not known, is the mean weighted by the boxes of truth and tracks.

    Parameters
    ----------
    rows : one for each case, with the scores and FP, FN and IDSW.
    true : number of true boxes in each case.
    """
    errors = np.array([[float(row[key]) for key in ("FP", "FN", "IDSW")] for row in rows])
    count = np.array(true, np.float64)
    # Boxes of the truth and of the tracks, which are the true ones less the misses, and the false.
    boxes = 2 * count - errors[:, 1] + errors[:, 0]
    means = {
        score: float(np.average([float(row[score]) for row in rows], weights=boxes))
        for score in ("HOTA", "IDF1")
    }
    return {**means, "MOTA": 100 * float(1 - errors.sum() / count.sum())}


def hota_errors(rows: Sequence[Row], groups: Sequence[Row]) -> list[float]:
    """The errors of the HOTA of `pooled`, in points, for peers of which the exact one is known.

    Parameters
    ----------
    rows : scores of cases.
    groups : exact scores of groups, the number of cases in ``cases``; those that lack cases among
        ``rows``, and ourselves, are left out.
    """
    found = []
    for exact in groups:
        those = [row for row in rows if all(row[k] == exact[k] for k in ("group", "name"))]
        if len(those) == int(exact["cases"]) and not exact["name"].startswith(OURS):
            scores = pooled(those, [true_boxes(row["sequence"]) for row in those])
            found.append(scores["HOTA"] - float(exact["HOTA"]))
    return found


@cache
def true_boxes(sequence: str) -> int:
    """The number of boxes in the truth of a sequence that count."""
    return int((~read_truth(folder_of(sequence) / "gt" / "gt.txt").distractor).sum())


def best(peers: Sequence[Row]) -> list[float]:
    """The best peer's value in each score; each score may have another best peer."""
    others = [row for row in peers if not row["name"].startswith(OURS)]
    return [max(float(row[score]) for row in others) for score in SCORES]


def pairs_won(rows: Sequence[Row], peers: Sequence[Row]) -> tuple[int, int]:
    """The number of (case, score) pairs with a value at or above the best peer's, and the number of
    pairs.
    """
    won = of = 0
    for row in (row for row in rows if row["sequence"] != "ALL"):
        peer_best = best(
            [
                p
                for p in peers
                if (p["sequence"], p["detector"]) == (row["sequence"], row["detector"])
            ]
        )
        won += sum(
            float(row[score]) >= value for score, value in zip(SCORES, peer_best, strict=True)
        )
        of += len(SCORES)
    return won, of


def distances(rows: Sequence[Row], peers: Sequence[Row]) -> dict[str, float]:
    """For each group, the mean distance to the best peer over its cases and scores, points."""
    found: dict[str, list[float]] = {}
    for row in (row for row in rows if row["sequence"] != "ALL"):
        peer_best = best(
            [
                p
                for p in peers
                if (p["sequence"], p["detector"]) == (row["sequence"], row["detector"])
            ]
        )
        away = np.mean(
            [float(row[score]) - value for score, value in zip(SCORES, peer_best, strict=True)]
        )
        found.setdefault(row["group"], []).append(float(away))
    return {group: float(np.mean(values)) for group, values in found.items()}


def difference(one: Mapping[str, float], other: Mapping[str, float]) -> tuple[float, float]:
    """The mean over groups of the difference, and its standard error by the jackknife that leaves
    out one group in turn.
    """
    values = np.array([one[group] - other[group] for group in other])
    n = len(values)
    without = (values.sum() - values) / max(n - 1, 1)
    return float(values.mean()), float(
        np.sqrt((n - 1) / n * np.square(without - without.mean()).sum())
    )


def behind(kept: Mapping[tuple[str, str], Sequence[Row]], peers: Sequence[Row]) -> list[list[str]]:
    """The pairs in which the default is more than `BEHIND` below the best peer, largest distance
    first.
    """
    found = []
    for output, most in BEHIND.items():
        for row in (row for row in kept["default", output] if row["sequence"] != "ALL"):
            of_case = [
                p
                for p in peers
                if (p["sequence"], p["detector"]) == (row["sequence"], row["detector"])
            ]
            for score, value in zip(SCORES, best(of_case), strict=True):
                if (away := float(row[score]) - value) < -most:
                    case = f"{row['sequence']} {row['detector']}"
                    found.append(
                        (
                            output,
                            away,
                            [
                                output,
                                row["group"],
                                case,
                                score,
                                f"{float(row[score]):.1f}",
                                f"{value:.1f}",
                            ],
                        )
                    )
    return [cells for _, _, cells in sorted(found, key=lambda one: (one[0] != "online", one[1]))]


def left_out(by_variant: Mapping[str, Mapping[str, float]]) -> dict[str, str]:
    """For each group, the variant that is best on average on the other groups; ``by_variant`` as
    from `distances`.
    """
    groups = next(iter(by_variant.values()))
    return {
        group: max(
            by_variant, key=lambda name: sum(v for g, v in by_variant[name].items() if g != group)
        )
        for group in groups
    }


@dataclass(frozen=True, slots=True, eq=False)
class CameraResults:
    """The rows of all variants, and the peers' scores.

    Attributes
    ----------
    rows : of real sequences, by variant and output.
    synthetic : of synthetic cameras.
    peers : of all cases.
    """

    rows: Mapping[tuple[str, str], Sequence[Row]]
    synthetic: Mapping[tuple[str, str], Sequence[Row]]
    peers: Sequence[Row]

    def away(self, variant: str, output: str) -> dict[str, float]:
        """For each real group the distance to the best peer."""
        return distances(self.rows[variant, output], self.peers)

    def synthetic_away(self, variant: str, output: str) -> dict[str, float]:
        """For each synthetic camera the distance to the best peer."""
        return distances(self.synthetic[variant, output], self.peers)

    def chosen(self) -> dict[str, str]:
        """For each real group the variant that is best on the other groups."""
        names = {name for name, output in self.rows if output == "online" and name != "mot15"}
        return left_out({name: self.away(name, "online") for name in VARIANTS if name in names})


def real_cases(*, quick: bool) -> list[tuple[str, str]]:
    """Sequence and detector of all real cases; a few in the short form."""
    names = [row["sequence"] for row in _read(bench() / "groups.csv")]
    cases = [
        (name, det.name[4:])
        for name in names
        if not quick or name in SHORT
        for det in sorted((need_data() / "more" / name).glob("det_*"))
    ]
    old = [(name, kind) for kind, those in SEQUENCES.items() for name in those]
    return cases if quick else [*cases, *old]


def measured(
    cases: Sequence[tuple[str, str]], peers: Sequence[Row], options: Options
) -> CameraResults:
    """Track all cases with all variants, and with delay with those that are shown or chosen."""
    found = dict[tuple[str, str], list[Row]]()

    def results() -> CameraResults:
        of_camera, of_real = (
            {
                key: [row for row in rows if (row["detector"] == DETECTOR) is synthetic]
                for key, rows in found.items()
            }
            for synthetic in (True, False)
        )
        return CameraResults(of_real, of_camera, peers)

    def run(some: Sequence[str], outputs: Sequence[str], place: str) -> None:
        late = "delayed" in outputs
        jobs = [(variant, *case, place, late) for variant in some for case in cases]
        in_parallel(track, jobs, "cameras", options)
        scoring = [(variant, output, place) for variant in some for output in outputs]
        rows = in_parallel(scored, scoring, "scores", options)
        found.update(zip([job[:2] for job in scoring], rows, strict=True))

    with tempfile.TemporaryDirectory() as place:
        run(SHOWN if options.quick else tuple(VARIANTS), ("online", "corrected"), place)
        chosen = results().chosen()
        run(sorted({*SHOWN, *chosen.values()}), ("delayed",), place)
    return results()


def main(options: Options) -> Path:
    """Track every case, score the rows, and write cameras.md."""
    first = FINAL[0] if options.seed is None else options.seed
    seeds = range(first, first + (FEW if options.quick else len(FINAL)))
    cases = real_cases(quick=options.quick)
    synthetic = peers_of_cameras(seeds, options)
    theirs = [{**row, "detector": DETECTOR} for row in synthetic]
    all_cases = [*cases, *((name_of(seed), DETECTOR) for seed in seeds)]
    results = measured(all_cases, [*peers_of_cases(), *theirs], options)
    kept = shown_rows(results)
    return write(
        "cameras",
        options,
        cases=len(cases),
        hota=_hota_error(),
        groups=groups_table(results, kept),
        won=won_table(kept, results.peers),
        behind=table(
            ["rows", "group", "case", "score", "default", "best peer"],
            behind(kept, results.peers),
        ),
        variants=variants_table(results),
        cameras=len(seeds),
        seeds=f"{seeds[0]} to {seeds[-1]}",
        gap=gap_table(results),
        laws=laws_table(results),
        synthetic=synthetic_table(results),
        unproved=", ".join(unproved(results)) or "none",
    )


def shown_rows(results: CameraResults) -> dict[tuple[str, str], Sequence[Row]]:
    """The rows of the shown variants, and as ``left out`` those of the chosen ones."""
    kept = {(name, output): results.rows[name, output] for name in SHOWN for output in OUTPUTS}
    for output in OUTPUTS:
        kept["left out", output] = [
            row
            for group, name in results.chosen().items()
            for row in results.rows[name, output]
            if row["group"] == group
        ]
    return kept


def groups_table(results: CameraResults, kept: Mapping[tuple[str, str], Sequence[Row]]) -> str:
    """The scores of each group beside the best peer's."""
    of_groups = peers_of_groups()
    shown = [(name, "online") for name in SHOWN]
    shown += [("default", output) for output in OUTPUTS[1:]]
    lines = []
    for group, chosen in results.chosen().items():
        known = [row for row in of_groups if row["group"] == group]
        cells = [_cell(best(known))] if known else ["-"]
        for key in shown:
            (row,) = (row for row in _groups(kept[key]) if row["group"] == group)
            cells.append(_cell([float(row[name]) for name in SCORES]))
        cells += [f"{results.away(name, 'online')[group]:+.1f}" for name in SHOWN]
        lines.append([group, *cells, chosen])
    header = ["group", "best peer", "mot15", "default", "default, 0.3 s later"]
    header += ["default, corrected", "mot15 away", "default away", "variant left out"]
    return table(header, lines)


def won_table(kept: Mapping[tuple[str, str], Sequence[Row]], peers: Sequence[Row]) -> str:
    """The numbers of pairs won, and the mean distances."""
    lines = []
    for (name, output), found in kept.items():
        new, old = (
            [row for row in found if (row["group"] == "MOT15") is is_old]
            for is_old in (False, True)
        )
        mean = np.mean(list(distances(found, peers).values()))
        pairs = ["{} of {}".format(*pairs_won(rows, peers)) for rows in (new, old)]
        lines.append([name, output, *pairs, f"{mean:+.1f}"])
    return table(["values", "rows", "new cameras", "MOT15", "mean distance"], lines)


def changes(results: CameraResults, name: str) -> list[tuple[float, float]]:
    """The changes of the mean distance by a variant, with errors: of online and of corrected rows
    of the real groups, then of the synthetic cameras.
    """
    found = []
    for away in (results.away, results.synthetic_away):
        found += [difference(away(name, output), away("default", output)) for output in BEHIND]
    return found


def variants_table(results: CameraResults) -> str:
    """The changes by each variant, and its distance in each group."""
    names = [name for name in VARIANTS if (name, "online") in results.rows]
    groups = list(results.away("default", "online"))
    lines = []
    for name in names:
        cells = [_with_error(change) for change in changes(results, name)]
        if name == "default":
            cells = [""] * len(cells)
        away = [f"{value:+.1f}" for value in results.away(name, "online").values()]
        lines.append([name, *cells, *away])
    outputs = [*BEHIND, *(f"synthetic, {output}" for output in BEHIND)]
    return table(["variant", *outputs, *groups], lines)


def unproved(results: CameraResults) -> list[str]:
    """The variants whose changes are within their errors on real groups and synthetic cameras."""
    return [
        name
        for name in VARIANTS
        if (name, "online") in results.rows
        and name not in SHOWN
        and all(abs(mean) <= error for mean, error in changes(results, name))
    ]


def gap_table(results: CameraResults) -> str:
    """The mean distance of the default on the real groups and on synthetic cameras, and their
    difference.
    """
    # MOT15 has the same peers by the same names.
    three = [row for row in results.peers if row["name"] in OF_TRACKERS or _is_synthetic(row)]
    lines = []
    for output in OUTPUTS:
        rows = results.rows["default", output]
        of_all = mean_of(distances(rows, results.peers).values())
        of_three = mean_of(distances(rows, three).values())
        there = mean_of(results.synthetic_away("default", output).values())
        gap = (there[0] - of_three[0], float(np.hypot(there[1], of_three[1])))
        won = "{} of {}".format(*pairs_won(results.synthetic["default", output], results.peers))
        cells = [_with_error(value) for value in (of_all, of_three, there, gap)]
        lines.append([output, *cells, won])
    header = ["rows", "real groups, all peers", "real groups, three peers"]
    return table([*header, "synthetic, three peers", "gap", "pairs won, synthetic"], lines)


def synthetic_table(results: CameraResults) -> str:
    """The scores on each synthetic camera beside the best peer's, and what it shows."""
    lines = []
    online, corrected = (results.synthetic["default", output] for output in BEHIND)
    for row, final in zip(online, corrected, strict=True):
        those = [p for p in results.peers if p["sequence"] == row["sequence"]]
        values = [[float(one[name]) for name in SCORES] for one in (row, final)]
        away = results.synthetic_away("default", "online")[row["sequence"]]
        cells = [_cell(best(those)), *(_cell(one) for one in values), f"{away:+.1f}"]
        seed = seed_of(row["sequence"])
        lines.append((seed, [seed, *cells, described(*drawn(seed))]))
    header = ["seed", "best peer", "default", "default, corrected", "away", "camera"]
    return table(header, [cells for _, cells in sorted(lines, key=lambda line: line[0])])


def laws_table(results: CameraResults) -> str:
    """The mean distance on synthetic cameras by what they show, and by the law of the scores."""
    titles = {law: f"{law} scores" for law in SCORE_LAWS} | {"none": "no scores"}
    cameras: dict[str, list[str]] = {name: [] for name in (*KINDS, *titles.values())}
    for row in results.synthetic["default", "online"]:
        world, law = drawn(seed_of(row["sequence"]))
        cameras[world.kind].append(row["sequence"])
        cameras[titles[law.scores]].append(row["sequence"])
    away = {output: results.synthetic_away("default", output) for output in OUTPUTS}
    lines = []
    for name, those in cameras.items():
        if those:
            means = [mean_of(away[output][one] for one in those) for output in OUTPUTS]
            lines.append([name, len(those), *(_with_error(mean) for mean in means)])
    return table(["cameras with", "number", *OUTPUTS], lines)


def mean_of(values: Iterable[float]) -> tuple[float, float]:
    """The mean, and its standard error; 0 for a single value."""
    array = np.array([*values])
    if len(array) < 2:
        return float(array.mean()), 0.0
    return float(array.mean()), float(array.std(ddof=1) / np.sqrt(len(array)))


def _is_synthetic(row: Row) -> bool:
    return row["detector"] == DETECTOR


def _with_error(value: tuple[float, float]) -> str:
    mean, error = value
    return f"{mean:+.2f} ± {error:.2f}"


def _hota_error() -> str:
    """The largest error of a newer peer's HOTA of a group that is to be expected, in points."""
    rows = _read(bench() / "peers_more.csv")
    errors = hota_errors(rows, _read(bench() / "peers_more_groups.csv"))
    return f"{max(abs(error) for error in errors):.1f}"


def _cell(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.1f}" for value in values)


def _groups(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["sequence"] == "ALL"]


def _read(path: Path) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
