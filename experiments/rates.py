"""Frame rates: the same settings from one image in five minutes to a hundred a second, and with
lost frames.

Sequences of 25 and 30 images a second are thinned, truth and detections alike, and the tracker gets
the rate. Peers had the same detections and, if they have such a setting, the rate
(`rates_peers.csv`: SORT, ByteTrack, OC-SORT, BoT-SORT and C-BIoU of the package `trackers` 2.6.1
with their defaults, without images, and norfair 2.4.3 with its IoU distance up to 0.7).

For rates above those of the data, truth is interpolated to four times the rate; its detections are
simulated: 90 % of the boxes, 5 % jitter. This is compared with every fourth frame of the same
detections. A fifth of the frames is lost in another test: the tracker gets the numbers of the
others; without loss it has all frames, and both runs are scored on the remaining ones.
"""

from __future__ import annotations

import csv
import importlib
import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments.cameras import bench, folder_of
from experiments.common import Options, in_parallel, need_data, table, write
from experiments.peers import SEQUENCES
from phdtrack import Tracker, Tracks
from phdtrack.formats import read_seqinfo, write_tracks
from phdtrack.types import F8, SequenceInfo

RATES = ("full", "15", "10", "5")
OUTPUTS = ("online", "corrected")
# The sequences for interpolation, and the number of their frames.
FAST = ("basketball-1", "football-1", "MDMT-57-1")
FAST_FRAMES = 250
CELLS = ("GOWT1-01", "threshold")
CELLS_RATE = 1 / 300
# The change to a sequence, its name, its detections.
RateRun = tuple[str, str, str]


def rows_of(path: Path) -> F8:
    """The rows of a MOT file; (0, 9) if it is missing or empty."""
    lines = path.read_text(encoding="utf-8").split() if path.is_file() else []
    return np.array([[float(cell) for cell in line.split(",")[:9]] for line in lines]).reshape(
        len(lines), 9
    )


def renumbered(rows: F8, kept: F8) -> F8:
    """The rows of the frames ``kept``, renumbered from 1."""
    out = rows[np.isin(rows[:, 0], kept)] if len(rows) else rows
    return (
        np.column_stack([np.searchsorted(kept, out[:, 0]) + 1.0, out[:, 1:]]) if len(out) else out
    )


def interpolated(truth: F8, times: int) -> F8:
    """Truth with ``times`` as many frames: boxes of an identity in consecutive frames are
    interpolated.
    """
    parts = []
    for identity in np.unique(truth[:, 1]):
        rows = truth[truth[:, 1] == identity]
        rows = rows[np.argsort(rows[:, 0])]
        steps = np.arange(times * (rows[0, 0] - 1), times * (rows[-1, 0] - 1) + 1)
        near = np.isin(steps // times + 1, rows[:, 0]) & np.isin(-(-steps // times) + 1, rows[:, 0])
        columns = [np.interp(steps / times + 1, rows[:, 0], rows[:, k]) for k in range(2, 6)]
        one = np.ones(len(steps))
        parts.append(np.column_stack([steps + 1, identity * one, *columns, one, -one, -one])[near])
    return np.concatenate(parts)


def drawn(truth: F8) -> F8:
    """Simulated detections: 90 % of the boxes, each coordinate jittered by 5 % of the size, score
    1.
    """
    rng = np.random.default_rng(1)
    out = truth[rng.random(len(truth)) < 0.9].copy()
    out[:, 2:6] += 0.05 * out[:, [4, 5, 4, 5]] * rng.standard_normal((len(out), 4))
    return out


def tracked(info: SequenceInfo, rows: F8, numbers: F8) -> tuple[Tracks, Tracks]:
    """Online and corrected rows of the frames ``numbers``, with the preset for any camera."""
    boxes = np.column_stack([rows[:, 2:4], rows[:, 2:4] + rows[:, 4:6], rows[:, 6]])
    whole = (rows[:, 4:6] > 0).all(axis=1)
    tracker = Tracker((info.width, info.height), fps=info.fps, preset="default")
    online = [
        tracker.update(boxes[whole & (rows[:, 0] == number)], frame=int(number))
        for number in numbers
    ]
    return Tracks.concatenate([*online, tracker.flush()]), tracker.tracks()


def hota(job: RateRun) -> tuple[float, float]:
    """HOTA of the online and of the corrected rows, in points, by the scorer next to the data."""
    change, sequence, detector = job
    folder = folder_of(sequence)
    info = read_seqinfo(folder)
    truth, ignored = (rows_of(folder / "gt" / name) for name in ("gt.txt", "ignore.txt"))
    detections = rows_of(folder / f"det_{detector}" / "det.txt")
    fps = CELLS_RATE if sequence == CELLS[0] else info.fps
    kept = every = np.arange(1.0, info.frames + 1)
    if change in ("fast", "every fourth"):
        ignored = truth[:0]
        truth = interpolated(truth[truth[:, 0] <= FAST_FRAMES], 4)
        kept = every = np.arange(1.0, 4 * FAST_FRAMES - 2)
        detections = drawn(truth)
        fps = 4 * fps
    if change in RATES[1:] or change == "every fourth":
        step = 4 if change == "every fourth" else math.ceil(info.fps / float(change) - 1e-9)
        kept = every[::step]
        fps = fps / step
        truth, ignored, detections = (
            renumbered(rows, kept) for rows in (truth, ignored, detections)
        )
        kept = every = np.arange(1.0, len(kept) + 1)
    if change in ("lost", "none lost"):
        kept = every[np.append(True, np.random.default_rng(1).random(info.frames - 1) >= 0.2)]
    seen = SequenceInfo(info.width, info.height, fps, len(every))
    outputs = tracked(seen, detections, kept if change == "lost" else every)
    with tempfile.TemporaryDirectory() as place:
        root = Path(place) / sequence
        (root / "gt").mkdir(parents=True)
        size = f"imWidth={info.width}\nimHeight={info.height}\n"
        header = f"[Sequence]\nname={sequence}\nframeRate={fps!r}\nseqLength={len(kept)}\n{size}"
        (root / "seqinfo.ini").write_text(header, encoding="utf-8")
        for name, rows in (("gt.txt", truth), ("ignore.txt", ignored)):
            if len(rows):
                np.savetxt(root / "gt" / name, renumbered(rows, kept), delimiter=",", fmt="%.7g")
        sys.path.insert(0, str(bench()))
        scorer = importlib.import_module("score_more").MoreScorer(Path(place))
        found = []
        for tracks in outputs:
            left = tracks.select(np.isin(tracks.frame, kept))
            numbered = replace(left, frame=np.searchsorted(kept, left.frame) + 1)
            write_tracks(Path(place) / "tracks.txt", numbered)
            found.append(
                float(scorer.row(scorer.sequence(sequence, Path(place) / "tracks.txt"))["HOTA"])
            )
    return found[0], found[1]


def peers() -> dict[tuple[str, str, str], float]:
    """HOTA of the best peer, by rate, sequence and detector."""
    best: dict[tuple[str, str, str], float] = {}
    with (Path(__file__).parent / "rates_peers.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            key = row["rate"], row["sequence"], row["detector"]
            best[key] = max(best.get(key, 0.0), float(row["HOTA"]))
    return best


def cases_of(quick: bool) -> dict[str, list[tuple[str, str]]]:
    """The sequences of at least 25 images a second with their detections, by group."""
    with (bench() / "groups.csv").open(newline="", encoding="utf-8") as file:
        groups = {row["sequence"]: row["group"] for row in csv.DictReader(file)}
    groups |= {name: "MOT15" for those in SEQUENCES.values() for name in those}
    found: dict[str, list[tuple[str, str]]] = {}
    for name, group in groups.items():
        if read_seqinfo(folder_of(name)).fps >= 25 and not (quick and name != "TUD-Campus"):
            dets = (need_data() / ("mot15" if group == "MOT15" else "more") / name).glob("det_*")
            found.setdefault(group, []).extend((name, det.name[4:]) for det in sorted(dets))
    return found


def fall(values: Sequence[float]) -> str:
    """The values at all rates as text, in points."""
    return " / ".join(f"{value:.1f}" for value in values)


def main(options: Options) -> Path:
    """Track everything at all rates, and write rates.md."""
    groups = cases_of(options.quick)
    cases = [case for those in groups.values() for case in those]
    fast = [] if options.quick else [(name, "u5") for name in FAST]
    kinds: Mapping[str, list[tuple[str, str]]] = {
        **dict.fromkeys((*RATES, "lost", "none lost"), cases),
        "fast": fast,
        "every fourth": fast,
        "cells": [CELLS],
    }
    jobs = [(change, *case) for change, those in kinds.items() for case in those]
    found = dict(zip(jobs, in_parallel(hota, jobs, "rates", options), strict=True))
    theirs = peers()
    lines = []
    means = []
    for group, those in groups.items():
        best = [float(np.mean([theirs[change, *case] for case in those])) for change in RATES]
        ours = [
            [float(np.mean([found[change, *case][k] for case in those])) for change in RATES]
            for k in range(2)
        ]
        means.append([best, *ours])
        lines.append([f"{group} ({len(those)})", *(fall(values) for values in means[-1])])
    lines.append(["mean of groups", *(fall(values) for values in np.mean(means, axis=0))])
    pairs = {
        "a fifth of the frames lost": ("none lost", "lost", cases),
        "four times the rate": ("every fourth", "fast", fast),
    }
    more = []
    for name, (before, after, those) in pairs.items():
        if those:
            values = np.array(
                [[found[change, *case] for change in (before, after)] for case in those]
            ).mean(axis=0)
            more.append([name, len(those), *(f"{a:.1f} → {b:.1f}" for a, b in values.T)])
    return write(
        "rates",
        options,
        rates=table(["group (cases)", "best peer", "online", "corrected"], lines),
        falls=fall([values[0] - values[-1] for values in np.mean(means, axis=0)]),
        more=table(["what", "cases", "online", "corrected"], more),
        cells=" and ".join(
            f"{value:.1f} {output}"
            for value, output in zip(found["cells", *CELLS], OUTPUTS, strict=True)
        ),
    )
