"""New cameras and today's detectors, on which nothing was chosen: the default tracker and ten motion-only trackers.

The sequences are in the folder ``more`` of the real data (MOT17, MOT20, DanceTrack, KITTI, cells, players, aerial views).
All are tracked with one set of defaults, and the camera's motion is not given. Boxes without an area are left out. The
scorer and the peers' scores are in the folder ``bench`` next to the data."""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from experiments.common import Options, in_parallel, need_data, table, write
from phdtrack import Tracker, Tracks
from phdtrack.errors import InputError
from phdtrack.formats import read_seqinfo, write_tracks

SCORES = ("HOTA", "MOTA", "IDF1")
OUTPUTS = ("online", "corrected")
# One short sequence of some groups, for the short form.
SHORT = ("KITTI-0014-car", "GOWT1-01", "MOT17-09")
OURS = ("pmb", "gm-phd", "phdtrack")
# Folder of the sequence, name of the detections, folder of the results.
CameraRun = tuple[str, str, str]
Row = Mapping[str, str]


def bench() -> Path:
    """The folder with the scorer and the peers' scores; `InputError` where it is missing."""
    folder = need_data().parent / "bench"
    if not (folder / "score_more.py").is_file() or not (need_data() / "more").is_dir():
        raise InputError("the sequences of new cameras, or their scorer, are missing", where=folder)
    return folder


def track(job: CameraRun) -> None:
    """Track one sequence with the defaults; its rows go to FOLDER/OUTPUT/DETECTOR/SEQUENCE.txt."""
    sequence, detector, results = job
    folder = need_data() / "more" / sequence
    info = read_seqinfo(folder)
    rows = np.loadtxt(folder / f"det_{detector}" / "det.txt", delimiter=",", ndmin=2)
    rows = rows[(rows[:, 4:6] > 0).all(axis=1)]
    boxes = np.column_stack([rows[:, 2:4], rows[:, 2:4] + rows[:, 4:6], rows[:, 6]])
    tracker, online = Tracker((info.width, info.height), fps=info.fps), []
    for number in range(1, info.frames + 1):
        online.append(tracker.update(boxes[rows[:, 0] == number], frame=number))
    given = Tracks.concatenate([*online, tracker.flush()])
    for output, tracks in zip(OUTPUTS, (given, tracker.tracks()), strict=True):
        write_tracks(Path(results) / output / detector / f"{sequence}.txt", tracks)


def scored(results: Path, output: str) -> list[Row]:
    """The scores of every case and of every group (whose sequence is ALL), by the scorer in the folder next to the data."""
    kept = results / f"{output}.csv"
    command = [sys.executable, str(bench() / "score_more.py"), "--data", str(need_data() / "more")]
    command += ["--results", str(results / output), "--name", output, "--out", str(kept)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"the scorer failed: {done.stderr.strip()[-300:]}", where=bench() / "score_more.py")
    return _read(kept)


def best(peers: Sequence[Row]) -> list[float]:
    """The best peer's value in each score, another peer for each."""
    others = [row for row in peers if not row["name"].startswith(OURS)]
    return [max(float(row[score]) for row in others) for score in SCORES]


def pairs_won(rows: Sequence[Row], peers: Sequence[Row]) -> tuple[int, int]:
    """In how many (case, score) pairs the value is at least the best peer's, and how many pairs there are."""
    won = of = 0
    for row in (row for row in rows if row["sequence"] != "ALL"):
        peer_best = best([p for p in peers if (p["sequence"], p["detector"]) == (row["sequence"], row["detector"])])
        won += sum(float(row[score]) >= value for score, value in zip(SCORES, peer_best, strict=True))
        of += len(SCORES)
    return won, of


def main(options: Options) -> Path:
    """Track every case, score the rows, and write cameras.md."""
    folder, groups = bench(), _read(bench() / "groups.csv")
    names = [row["sequence"] for row in groups if not options.quick or row["sequence"] in SHORT]
    with tempfile.TemporaryDirectory() as place:
        jobs = [(name, det.name[4:], place) for name in names for det in sorted((need_data() / "more" / name).glob("det_*"))]
        in_parallel(track, jobs, "cameras", options)
        rows = {output: scored(Path(place), output) for output in OUTPUTS}
    peers, of_groups = _read(folder / "peers_more.csv"), _read(folder / "peers_more_groups.csv")
    lines = []
    for online, corrected in zip(*(_groups(rows[output]) for output in OUTPUTS), strict=True):
        peer_best = best([row for row in of_groups if row["group"] == online["group"]])
        values = [[float(row[score]) for score in SCORES] for row in (online, corrected)]
        lines.append([online["group"], *(" / ".join(f"{v:.1f}" for v in cells) for cells in (peer_best, *values))])
    won = {output: pairs_won(rows[output], peers) for output in OUTPUTS}
    return write(
        "cameras",
        options,
        cases=len(jobs),
        groups=table(["group", "best peer", "online", "corrected"], lines),
        won=table(["rows", "won", "of"], [[output, *won[output]] for output in OUTPUTS]),
    )


def _groups(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["sequence"] == "ALL"]


def _read(path: Path) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
