"""The real sequences with worse detections, for the experiment on them.

Imports nothing of phdtrack: the environment of the peers has neither its dependencies nor itself.
"""

from __future__ import annotations

import configparser
import csv
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

F8 = npt.NDArray[np.float64]

# What is changed: the scores are taken away, are all the same, two of three frames are left out,
# each detection is lost with probability 1/2.
CHANGES = ("no scores", "constant scores", "a third of the rate", "p_D halved")
CONSTANT = 0.9
THINNING = 3
KEPT = 0.5
PEERS = ("sort", "bytetrack", "ocsort", "botsort", "cbiou")
# The sequences of MOT15 and their sets of detections.
OLD_GROUP = "MOT15"
OLD_SEQUENCES = {
    "frcnn": ("PETS09-S2L1", "TUD-Campus", "ETH-Sunnyday", "KITTI-17", "ADL-Rundle-6"),
    "public": ("PETS09-S2L1", "TUD-Campus", "ETH-Sunnyday", "KITTI-17"),
}


@dataclass(frozen=True, slots=True)
class CameraCase:
    """A sequence with one set of detections. ``folder``: of the sequence."""

    group: str
    sequence: str
    detector: str
    folder: Path

    @property
    def name(self) -> str:
        """Sequence and detector, as the name of a file."""
        return f"{self.sequence}_{self.detector}"

    @property
    def detections(self) -> Path:
        """The file of the detections."""
        return self.folder / f"det_{self.detector}" / "det.txt"


@dataclass(frozen=True, slots=True)
class Input:
    """What a tracker gets, and what it is scored against.

    ``frame`` (M,) from 1, ``xyxy`` (M, 4), ``score`` (M,) of the detections; ``frames`` of
    ``size`` (width, height) at ``fps``; ``truth``: rows of gt.txt; ``ignored``: of ignore.txt.
    """

    frame: npt.NDArray[np.int64]
    xyxy: F8
    score: F8
    frames: int
    size: tuple[int, int]
    fps: float
    truth: F8
    ignored: F8


def cases(data: Path, groups: Path) -> list[CameraCase]:
    """All cases below ``data``; ``groups``: the table of the new cameras' groups."""
    with groups.open(newline="", encoding="utf-8") as file:
        new = [(row["group"], row["sequence"]) for row in csv.DictReader(file)]
    found = [
        CameraCase(group, sequence, one.name.removeprefix("det_"), data / "more" / sequence)
        for group, sequence in new
        for one in sorted((data / "more" / sequence).glob("det_*"))
    ]
    found += [
        CameraCase(OLD_GROUP, sequence, detector, data / "mot15" / sequence)
        for detector, sequences in OLD_SEQUENCES.items()
        for sequence in sequences
    ]
    return found


def changed(case: CameraCase, change: str) -> Input:
    """A case after one of the `CHANGES`; the random ones are the same in every run."""
    whole = read_case(case)
    keep = np.ones(len(whole.frame), bool)
    frame = whole.frame
    score = whole.score
    if change in ("no scores", "constant scores"):
        score = np.full(len(score), CONSTANT)
    elif change == "p_D halved":
        rng = np.random.default_rng(zlib.crc32(case.name.encode()))
        keep = rng.random(len(keep)) < KEPT
    elif change == "a third of the rate":
        keep = (frame - 1) % THINNING == 0
        frame = (frame - 1) // THINNING + 1
    thinning = THINNING if change == "a third of the rate" else 1
    return Input(
        frame[keep],
        whole.xyxy[keep],
        score[keep],
        -(-whole.frames // thinning),
        whole.size,
        whole.fps / thinning,
        _thinned(whole.truth, thinning),
        _thinned(whole.ignored, thinning),
    )


def write_truth(case: CameraCase, given: Input, folder: Path) -> None:
    """Write what the scorer reads of a sequence, seqinfo.ini and gt/, into ``folder``."""
    (folder / "gt").mkdir(parents=True, exist_ok=True)
    ini = configparser.ConfigParser()
    ini.optionxform = str  # type: ignore[assignment, method-assign]
    ini["Sequence"] = {
        "name": case.sequence,
        "seqLength": str(given.frames),
        "imWidth": str(given.size[0]),
        "imHeight": str(given.size[1]),
        "frameRate": str(given.fps),
    }
    with (folder / "seqinfo.ini").open("w", encoding="utf-8") as file:
        ini.write(file)
    np.savetxt(folder / "gt" / "gt.txt", given.truth, delimiter=",", fmt="%g")
    if len(given.ignored):
        np.savetxt(folder / "gt" / "ignore.txt", given.ignored, delimiter=",", fmt="%g")


def read_case(case: CameraCase) -> Input:
    """The case as it is, boxes without an area left out."""
    ini = configparser.ConfigParser()
    ini.read(case.folder / "seqinfo.ini")
    info = ini["Sequence"]
    rows = _table(case.detections)
    rows = rows[with_area(rows)]
    truth = _table(case.folder / "gt" / "gt.txt")
    if case.group == OLD_GROUP:
        truth = truth[truth[:, 6] != 0]
    ignored = case.folder / "gt" / "ignore.txt"
    return Input(
        rows[:, 0].astype(np.int64),
        np.column_stack([rows[:, 2:4], rows[:, 2:4] + rows[:, 4:6]]),
        rows[:, 6],
        int(info["seqLength"]),
        (int(info["imWidth"]), int(info["imHeight"])),
        float(info["frameRate"]),
        truth,
        _table(ignored) if ignored.is_file() else np.zeros((0, 7)),
    )


def with_area(rows: F8) -> npt.NDArray[np.bool_]:
    """(M,) which rows of a file of detections are boxes with an area."""
    found: npt.NDArray[np.bool_] = (rows[:, 4:6] > 0).all(axis=1)
    return found


def _table(path: Path) -> F8:
    """The rows of a file, at least seven columns; a file may be empty."""
    if not path.stat().st_size:
        return np.zeros((0, 7))
    rows = np.loadtxt(path, delimiter=",", ndmin=2)
    return np.asarray(rows, dtype=np.float64)


def _thinned(rows: F8, thinning: int) -> F8:
    """The rows of every ``thinning``-th frame, which are numbered anew."""
    kept = rows[(rows[:, 0] - 1) % thinning == 0].copy()
    kept[:, 0] = (kept[:, 0] - 1) // thinning + 1
    return kept
