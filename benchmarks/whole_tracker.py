"""Whole trackers, detections in and tracks out: phdtrack against SORT and ByteTrack of `trackers`,
and Norfair.

The scenes (constant density, people come and go every 150 frames, see `benchmarks.workload`): easy
has p_D = 0.95 and one false alarm per 20 objects and frame; hard has p_D = 0.85 and ten times the
clutter, so 10 → 100 per frame at 200 objects. All scores are 1, so that motion alone decides. The
peers run in an environment of their own, on its default settings or the best of those that `TUNED`
names, by its MOTA on the smaller scenes; only their update call is timed.

What counts is what `update` returns, MOTA at IoU 0.5: of phdtrack all rows, also those that it
flags as not confirmed yet; of a peer the rows with an identity, or all boxes that it returns where
that is better for it.

If the data of the experiments lies beside the project (`experiments.common.data_place`), the same
is done on real detections, at the frame rate of each sequence and with the settings found above.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.parts import Outcome, Row, Scale, Skipped
from benchmarks.timing import Spread, clock, took
from benchmarks.workload import RATE, Crowd, Stream, draw
from phdtrack import Tracker
from phdtrack.formats import read_truth
from phdtrack.metrics import evaluate
from phdtrack.types import F8, Detections, DetectionTable, Tracks

KEYS = ("tracker_ms", "trackers")
ROOT = Path(__file__).resolve().parent.parent
PYTHON = ROOT / ".venv-peers" / "bin" / "python"
SCRIPT = Path(__file__).resolve().parent / "peer_process.py"
WARM_UP = 20
# Goals: how many times as fast as the fastest peer, which no machine decides alone.
LEAST_RATIO = {
    "10 easy": 1.5,
    "20 easy": 2.0,
    "20 hard": 2.2,
    "200 easy": 5.0,
    "200 hard": 9.0,
}
# Real detections: the sequences of `experiments.cameras` with a detector, so many frames of each;
# goals for the mean ratio and for the least one.
REAL = (
    ("MOT17-09", "yolox"),
    ("MOT17-11", "yolox"),
    ("MOT20-01", "yolox"),
    ("KITTI-0001-car", "rrc"),
    ("dancetrack0026", "yolox"),
    ("football-1", "u5"),
)
REAL_FRAMES = 300
LEAST_MEAN = 1.2
LEAST_WORST = 0.8
LIFE = 150
# Settings tried, each library's own defaults first (Norfair has no default threshold): tracks kept
# shorter, confirmed sooner or later. The scenes' frame_rate is given to those that ask for it.
TUNED: dict[str, tuple[dict[str, Any], ...]] = {
    "sort": ({}, {"lost_track_buffer": 15}, {"minimum_consecutive_frames": 2}),
    "bytetrack": (
        {},
        {"lost_track_buffer": 15},
        {"minimum_consecutive_frames": 3, "minimum_iou_threshold": 0.2},
    ),
    "norfair": (
        {"distance_threshold": 0.7},
        {"distance_threshold": 0.7, "hit_counter_max": 10, "initialization_delay": 4},
        {"distance_threshold": 0.7, "hit_counter_max": 8, "initialization_delay": 3},
    ),
}
ERRORS = {"false_positives": "false", "misses": "missed", "id_switches": "switches"}
Case = tuple[str, Crowd]


def cases(scale: Scale) -> list[Case]:
    """Names and scenes."""
    out = []
    for objects in scale.peer_objects:
        easy = objects / 20
        hard = objects / 2
        common = {
            "targets": objects,
            "frames": scale.peer_frames,
            "life": min(LIFE, scale.peer_frames),
        }
        out.append((f"{objects} easy", Crowd(clutter=easy, p_detect=0.95, **common)))
        out.append((f"{objects} hard", Crowd(clutter=hard, p_detect=0.85, **common)))
    return out


def real_streams(scale: Scale) -> dict[str, Stream]:
    """Real detections with their truth; none if the data is not there, or the scale is small."""
    from experiments.cameras import boxes_of, folder_of
    from experiments.common import data_place

    if not scale.others or not (data_place() / "more").is_dir():
        return {}
    out = {}
    for sequence, detector in REAL:
        info, frame, boxes = boxes_of(sequence, detector)
        frames = min(info.frames, REAL_FRAMES)
        order = np.argsort(frame, kind="stable")
        order = order[frame[order] <= frames]
        truth = read_truth(folder_of(sequence) / "gt" / "gt.txt")
        early = truth.frame <= frames
        found = Detections.of(boxes[order, :4], boxes[order, 4])
        out[f"{sequence} {detector}"] = Stream(
            replace(info, frames=frames),
            replace(
                truth,
                frame=truth.frame[early],
                identity=truth.identity[early],
                xyxy=truth.xyxy[early],
                distractor=truth.distractor[early],
            ),
            DetectionTable(frame[order], found),
        )
    return out


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Ours and the peers on every case."""
    scenes = cases(scale)
    streams = {name: draw(crowd, 1) for name, crowd in scenes}
    real = real_streams(scale)
    few = {
        name: streams[name] for name, crowd in scenes if crowd.targets == min(scale.peer_objects)
    }
    chosen = {}
    reasons = {}
    for peer in TUNED:
        say(f"{peer}, settings")
        try:
            chosen[peer] = _best(peer, few)
        except Skipped as reason:
            reasons[peer] = str(reason)
    results: dict[str, dict[str, dict[str, Any]]] = {who: {} for who in ("phdtrack", *chosen)}
    for name, stream in (streams | real).items():
        say(name)
        for who, result in _in_turns(stream, chosen, scale.rounds).items():
            results[who][name] = result
    rows = [row for name in (*streams, *real) for row in _rows(name, results)]
    if real and chosen:
        ratios = np.array([fastest_ratio(name, results)[0] for name in real])
        what = "real detections: phdtrack against the fastest peer"
        rows.append(Row(f"{what}, mean", float(ratios.mean()), "×", least=LEAST_MEAN))
        rows.append(Row(f"{what}, least", float(ratios.min()), "×", least=LEAST_WORST))
    if not real:
        rows.append(Row("real detections", float("nan"), "", note="skipped: no data beside it"))
    rows += [
        Row(peer, float("nan"), "", note=f"skipped: {reason}") for peer, reason in reasons.items()
    ]
    entries = {
        "tracker_ms": {
            who: {case: r["ms"]["median"] for case, r in of.items()} for who, of in results.items()
        },
        "trackers": {
            "results": results,
            "skipped": reasons,
            "scenes": {name: _scene(crowd) for name, crowd in scenes},
        },
    }
    return Outcome(tuple(rows), entries)


def _best(peer: str, streams: dict[str, Stream]) -> dict[str, Any]:
    """The setting whose MOTA is best, summed over the streams."""
    given = [
        settings if peer == "norfair" else {"frame_rate": RATE, **settings}
        for settings in TUNED[peer]
    ]
    return max(
        given,
        key=lambda settings: sum(
            theirs(peer, settings, stream)["MOTA"] for stream in streams.values()
        ),
    )


def _in_turns(
    stream: Stream, chosen: dict[str, dict[str, Any]], turns: int
) -> dict[str, dict[str, Any]]:
    """All trackers on one stream, in rounds; of each the round with the least median."""
    rounds: dict[str, list[dict[str, Any]]] = {who: [] for who in ("phdtrack", *chosen)}
    for _ in range(turns):
        rounds["phdtrack"].append(ours(stream))
        for peer, settings in chosen.items():
            rounds[peer].append({**theirs(peer, settings, stream), "settings": settings})
    return {who: min(results, key=lambda r: r["ms"]["median"]) for who, results in rounds.items()}


def _scene(crowd: Crowd) -> dict[str, float]:
    return {
        "objects": crowd.targets,
        "p_detect": crowd.p_detect,
        "clutter": crowd.false_alarms,
        "life": crowd.life,
    }


def ours(stream: Stream) -> dict[str, Any]:
    """phdtrack's default settings: all rows that `Tracker.update` returns, and beside them what
    else can be had.

    Those are the rows that it has confirmed, and the corrected tracks of the end.
    """
    tracker = Tracker((stream.info.width, stream.info.height), fps=stream.info.fps)
    spent = []
    parts = []
    for found in stream.detections():
        boxes = np.column_stack([found.xyxy, found.confidence])
        began = clock()
        tracks = tracker.update(boxes)
        spent.append(took(began, clock()))
        parts.append(tracks)
    given = Tracks.concatenate(parts)
    wall, cpu = np.array(spent).T
    result = _result(wall, cpu, stream, given)
    more = {"MOTA_confirmed": given.select(given.confirmed), "MOTA_corrected": tracker.tracks()}
    scores = {
        name: evaluate(stream.truth, rows, frames=stream.info.frames).MOTA
        for name, rows in more.items()
    }
    return {**result, **scores, "settings": "defaults"}


def _result(wall: F8, cpu: F8, stream: Stream, rows: Tracks) -> dict[str, Any]:
    """Times after the warm-up, and scores with the errors that MOTA counts."""
    skip = min(WARM_UP, len(wall) // 2)
    scores = evaluate(stream.truth, rows, frames=stream.info.frames)
    return {
        "ms": Spread.of(wall[skip:], 1e3).as_dict(),
        "cpu_ms": 1e3 * float(np.median(cpu[skip:])),
        "mean_ms": 1e3 * float(wall[skip:].mean()),
        "MOTA": scores.MOTA,
        "IDF1": scores.IDF1,
        "HOTA": scores.HOTA,
        "false_positives": scores.false_positives,
        "misses": scores.misses,
        "id_switches": scores.id_switches,
    }


def theirs(peer: str, settings: dict[str, Any], stream: Stream) -> dict[str, Any]:
    """A peer in its own process; raises `Skipped` where its environment or the package is
    missing.
    """
    python = Path(os.environ.get("PEERS_PYTHON", PYTHON))
    if not python.exists():
        raise Skipped(
            f"no environment for the peers at {python.parent.parent.name}: make bench makes it"
        )
    if "frame_rate" in settings:
        settings = settings | {"frame_rate": stream.info.fps}
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "in.npz"
        target = Path(folder) / "out.npz"
        table = stream.table
        np.savez(
            source,
            frame=table.frame,
            xyxy=table.detections.xyxy,
            confidence=table.detections.confidence,
            frames=stream.info.frames,
        )
        command = [
            str(python),
            "-P",
            str(SCRIPT),
            peer,
            json.dumps(settings),
            str(source),
            str(target),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Skipped(
                f"{peer} ended with: {(done.stderr.strip().splitlines() or ['no word'])[-1]}"
            )
        with np.load(target) as out:
            wall, cpu, frame, identity, xyxy = (
                out[key] for key in ("seconds", "cpu", "frame", "identity", "xyxy")
            )
    named = identity >= 0
    # A box without identity is an object of its own, in case that scores better.
    every = np.where(named, identity, identity.max(initial=0) + 1 + np.arange(len(identity)))
    results = [
        _result(wall, cpu, stream, _tracks(frame[kept], who[kept], xyxy[kept]))
        for kept, who in ((named, identity), (np.ones(len(named), np.bool_), every))
    ]
    best = max(results, key=lambda result: float(result["MOTA"]))
    return {**best, "MOTA_named": results[0]["MOTA"], "MOTA_returned": results[1]["MOTA"]}


def _tracks(frame: NDArray[Any], identity: NDArray[Any], xyxy: NDArray[Any]) -> Tracks:
    n = len(frame)
    return Tracks(
        frame.astype(np.int64),
        identity.astype(np.int64) + 1,
        xyxy.astype(np.float64),
        np.ones(n),
        np.full(n, -1),
        np.ones(n, np.bool_),
    )


def _rows(case: str, results: dict[str, dict[str, dict[str, Any]]]) -> list[Row]:
    """A case: every tracker's time and MOTA, and how much faster ours is than the fastest peer."""
    rows = []
    mine = results["phdtrack"][case]
    for who, of in results.items():
        result = of[case]
        errors = ", ".join(f"{result[name]:.0f} {words}" for name, words in ERRORS.items())
        note = f"MOTA {result['MOTA']:.3f} ({errors}), IDF1 {result['IDF1']:.3f}"
        if who == "phdtrack":
            note += (
                f"; MOTA of confirmed rows alone {result['MOTA_confirmed']:.3f}, corrected"
                f" {result['MOTA_corrected']:.3f}"
            )
        else:
            note += f"; {json.dumps(result['settings'])}"
        spread = Spread(**result["ms"])
        rows.append(
            Row(f"{case}: {who}", spread.median, "ms", spread, note=note, cpu=result["cpu_ms"])
        )
    if len(results) > 1:
        ratio, of_cpu = fastest_ratio(case, results)
        best = max(of[case]["MOTA"] for who, of in results.items() if who != "phdtrack")
        hard = case == "200 hard"
        rows.append(
            Row(
                f"{case}: phdtrack against the fastest peer",
                ratio,
                "×",
                least=LEAST_RATIO.get(case),
                cpu=of_cpu,
            )
        )
        gain = mine["MOTA"] - best
        rows.append(
            Row(f"{case}: MOTA above the best peer's", gain, "", least=0.0 if hard else None)
        )
    return rows


def fastest_ratio(case: str, results: dict[str, dict[str, dict[str, Any]]]) -> tuple[float, float]:
    """How many times as fast as the fastest peer ours is, by the clock and in processor time."""
    mine = results["phdtrack"][case]
    peers = [of[case] for who, of in results.items() if who != "phdtrack"]
    fastest = min(peers, key=lambda result: float(result["ms"]["median"]))
    ratio = fastest["ms"]["median"] / mine["ms"]["median"]
    return ratio, fastest["cpu_ms"] / mine["cpu_ms"]
