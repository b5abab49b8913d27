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
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from experiments.common import Options, in_parallel, need_data, table, write
from experiments.peers import SEQUENCES, counted
from phdtrack import Tracker, Tracks
from phdtrack.errors import InputError
from phdtrack.formats import read_seqinfo, read_truth, write_tracks
from phdtrack.metrics import evaluate

SCORES = ("HOTA", "MOTA", "IDF1")
OUTPUTS = ("online", "delayed", "corrected")
# Seconds by which delayed rows lag behind.
DELAY = 0.3
# One short sequence of some groups, for the short form.
SHORT = ("KITTI-0014-car", "GOWT1-01", "MOT17-09")
OURS = ("pmb", "gm-phd", "phdtrack")
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


def track(job: CameraRun) -> None:
    """Track one sequence; its rows go to RESULTS/VARIANT/OUTPUT/DETECTOR/SEQUENCE.txt."""
    variant, sequence, detector, results, delayed = job
    preset, sets = VARIANTS[variant]
    folder = folder_of(sequence)
    info = read_seqinfo(folder)
    rows = np.loadtxt(folder / f"det_{detector}" / "det.txt", delimiter=",", ndmin=2)
    rows = rows[(rows[:, 4:6] > 0).all(axis=1)]
    boxes = np.column_stack([rows[:, 2:4], rows[:, 2:4] + rows[:, 4:6], rows[:, 6]])
    late = {"output_delay": round(DELAY * info.fps) if delayed else 0}
    settings = {**sets, "associate": {**sets.get("associate", {}), **late}}
    tracker = Tracker((info.width, info.height), fps=info.fps, preset=preset, **settings)
    online = []
    for number in range(1, info.frames + 1):
        online.append(tracker.update(boxes[rows[:, 0] == number], frame=number))
    online_rows = Tracks.concatenate([*online, tracker.flush()])
    made = (
        {"delayed": online_rows}
        if delayed
        else {"online": online_rows, "corrected": tracker.tracks()}
    )
    for output, tracks in made.items():
        keep(tracks, Path(results) / variant, output, sequence, detector)


def keep(tracks: Tracks, place: Path, output: str, sequence: str, detector: str) -> None:
    """Keep the rows of one case for `scored`: those of new cameras, of MOT15 their scores."""
    folder = folder_of(sequence)
    if folder.parent.name != "mot15":
        write_tracks(place / output / detector / f"{sequence}.txt", tracks)
        return
    truth = counted(read_truth(folder / "gt" / "gt.txt"))
    scores = evaluate(truth, tracks, frames=read_seqinfo(folder).frames)
    values = [str(100 * getattr(scores, score)) for score in SCORES]
    place.mkdir(parents=True, exist_ok=True)
    text = ",".join(["MOT15", sequence, detector, *values])
    (place / f"{output}-{sequence}-{detector}.csv").write_text(text, encoding="utf-8")


def scored(job: tuple[str, str, str]) -> list[Row]:
    """The scores of every case and of every group (whose sequence is ALL) of a variant's output.

    New cameras are scored by the scorer in the folder next to the data. MOT15 was scored while
    tracking; its group is the mean of its cases.
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
    old = [
        dict(zip(names, file.read_text(encoding="utf-8").split(","), strict=True))
        for file in sorted(results.glob(f"{output}-*.csv"))
    ]
    if not old:
        return _read(kept)
    mean = {score: str(np.mean([float(row[score]) for row in old])) for score in SCORES}
    return [*_read(kept), *old, {"group": "MOT15", "sequence": "ALL", "detector": "ALL", **mean}]


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


def main(options: Options) -> Path:
    """Track every case, score the rows, and write cameras.md."""
    groups = _read(bench() / "groups.csv")
    names = [row["sequence"] for row in groups if not options.quick or row["sequence"] in SHORT]
    cases = [
        (name, det.name[4:])
        for name in names
        for det in sorted((need_data() / "more" / name).glob("det_*"))
    ]
    cases += [
        (name, kind) for kind, those in SEQUENCES.items() for name in those if not options.quick
    ]
    variants = SHOWN if options.quick else tuple(VARIANTS)
    peers = peers_of_cases()
    of_groups = peers_of_groups()
    rows = dict[tuple[str, str], list[Row]]()

    def run(some: Sequence[str], outputs: Sequence[str], place: str) -> None:
        late = "delayed" in outputs
        in_parallel(
            track,
            [(variant, *case, place, late) for variant in some for case in cases],
            "cameras",
            options,
        )
        scoring_jobs = [(variant, output, place) for variant in some for output in outputs]
        rows.update(
            zip(
                [job[:2] for job in scoring_jobs],
                in_parallel(scored, scoring_jobs, "scores", options),
                strict=True,
            )
        )

    with tempfile.TemporaryDirectory() as place:
        run(variants, ("online", "corrected"), place)
        away = {
            output: {name: distances(rows[name, output], peers) for name in variants}
            for output in BEHIND
        }
        chosen = left_out({name: away["online"][name] for name in variants if name != "mot15"})
        run(sorted({*SHOWN, *chosen.values()}), ("delayed",), place)
    kept: dict[tuple[str, str], list[Row]] = {
        (name, output): rows[name, output] for name in SHOWN for output in OUTPUTS
    }
    for output in OUTPUTS:
        kept["left out", output] = [
            row
            for group, name in chosen.items()
            for row in rows[name, output]
            if row["group"] == group
        ]
    lines = []
    for group in chosen:
        known = [row for row in of_groups if row["group"] == group]
        cells = [_cell(best(known))] if known else ["-"]
        for name, output in [
            *((name, "online") for name in SHOWN),
            *(("default", output) for output in OUTPUTS[1:]),
        ]:
            (row,) = (row for row in _groups(kept[name, output]) if row["group"] == group)
            cells.append(_cell([float(row[score]) for score in SCORES]))
        cells += [f"{away['online'][name][group]:+.1f}" for name in SHOWN]
        lines.append([group, *cells, chosen[group]])
    won = []
    for (name, output), found in kept.items():
        new, old = (
            [row for row in found if (row["group"] == "MOT15") is is_old]
            for is_old in (False, True)
        )
        mean = np.mean(list(distances(found, peers).values()))
        won.append(
            [
                name,
                output,
                "{} of {}".format(*pairs_won(new, peers)),
                "{} of {}".format(*pairs_won(old, peers)),
                f"{mean:+.1f}",
            ]
        )
    compared = []
    for name in variants:
        changes = [difference(away[output][name], away[output]["default"]) for output in BEHIND]
        cells = [
            "" if name == "default" else f"{mean:+.2f} ± {error:.2f}" for mean, error in changes
        ]
        compared.append(
            [name, *cells, *(f"{value:+.1f}" for value in away["online"][name].values())]
        )
    return write(
        "cameras",
        options,
        cases=len(cases),
        hota=_hota_error(),
        groups=table(
            [
                "group",
                "best peer",
                "mot15",
                "default",
                "default, 0.3 s later",
                "default, corrected",
                "mot15 away",
                "default away",
                "variant left out",
            ],
            lines,
        ),
        won=table(["values", "rows", "new cameras", "MOT15", "mean distance"], won),
        behind=table(
            ["rows", "group", "case", "score", "default", "best peer"], behind(kept, peers)
        ),
        variants=table(["variant", *BEHIND, *chosen], compared),
    )


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
