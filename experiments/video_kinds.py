"""Videos by kind of scene: the first command, settings chosen without a kind, and its warnings.

The truth of most videos is sparse: boxes on some frames, the others are ignored. A setting is
judged by the mean over kinds of scenes, so that many videos of one kind do not outweigh another.
Settings of the change detector are chosen anew without each kind, and judged on that kind alone.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from experiments.common import Options, in_parallel, need_data, phdtrack, table
from experiments.doubt import JudgedRun, doubt_table, error_table
from phdtrack.arrays import iou
from phdtrack.formats import read_tracks
from phdtrack.types import Tracks
from phdtrack.video import open_source

DETECTORS = ("change", "mog2")
# The scene whose worst frame is drawn, and the overlap from which two boxes match.
SHOWN = "arcade"
MATCH = 0.5
# Values around the shipped one that is in the middle, tried one by one.
TRIED = {
    "detector.false_alarm": (0.003, 0.0055, 0.01),
    "detector.closing": (0.018, 0.026, 0.036),
}


@dataclass(frozen=True, slots=True)
class KindVideo:
    """A video of some kind of scene.

    Attributes
    ----------
    kind, name : of the scene, and of the video.
    source, truth : files below the data, or below the runs if the scene is rendered; an empty
        truth: nothing is there.
    ignored : file of regions and frames that do not count, or "".
    rendered : whether the scene is rendered.
    masks : whether the truth is boxes around what moves.
    empty : the last frame without objects, of an empty truth.
    """

    kind: str
    name: str
    source: str
    truth: str = ""
    ignored: str = ""
    rendered: bool = False
    masks: bool = False
    empty: int = 0


def _sparse(kind: str, name: str) -> KindVideo:
    """A video with boxes on some of its frames."""
    folder = f"video/{name}"
    truth = f"{folder}/gt/gt.txt"
    return KindVideo(kind, name, f"{folder}/{name}.mp4", truth, f"{folder}/gt/ignore.csv")


def _masked(kind: str, name: str) -> KindVideo:
    """A video whose truth is masks."""
    folder = f"video/{name}"
    return KindVideo(kind, name, f"{folder}/{name}.mp4", f"{folder}/gt/boxes.txt", masks=True)


def _mot15(name: str) -> KindVideo:
    """A sequence of MOT15."""
    folder = f"mot15/{name}"
    return KindVideo("street", name, f"{folder}/{name}.mp4", f"{folder}/gt/gt.txt")


def _rendered(kind: str, name: str) -> KindVideo:
    """A scene of `phdtrack simulate`."""
    return KindVideo(kind, name, f"{name}/scene.mp4", f"{name}/gt/gt.txt", rendered=True)


# The short form's.
SHORT = "TUD-Campus"
VIDEOS = (
    _mot15("PETS09-S2L1"),
    _mot15(SHORT),
    KindVideo("indoor", "OneLeaveShop1cor", "caviar/OneLeaveShop1cor.mpg", "caviar/cols1gt.xml"),
    _sparse("indoor", "reader-indoor"),
    _sparse("indoor", "worker-gif"),
    _sparse("crowd", "crowd-hall"),
    _sparse("traffic", "motorway-cctv"),
    _sparse("traffic", "carpark-gif"),
    _sparse("shadows", "pets2001-d3c1"),
    _rendered("shadows", "arcade"),
    _rendered("trees", "yard"),
    _rendered("trees", "garden"),
)
# Videos without boxes of objects.
UNBOXED = (
    _masked("traffic", "cdnet-highway"),
    _masked("jitter", "cdnet-traffic-jitter"),
    KindVideo(
        "trees",
        "wallflower-WavingTrees",
        "video/wallflower-WavingTrees/wallflower-WavingTrees.mp4",
        empty=242,
    ),
)


@dataclass(frozen=True, slots=True)
class KindRun:
    """A run of the first command on a video.

    Attributes
    ----------
    video : what is tracked.
    detector : its name.
    runs : folder of the run directories and of rendered scenes.
    setting : as ``NAME=VALUE``; "": all as shipped.
    """

    video: KindVideo
    detector: str
    runs: Path
    setting: str = ""

    @property
    def out(self) -> Path:
        """The run directory."""
        return (
            self.runs / "kinds" / f"{self.video.name}-{self.detector}-{self.setting or 'default'}"
        )


@dataclass(frozen=True, slots=True)
class KindScore:
    """The scores of a run."""

    mota: float
    idf1: float
    false_tracks: int
    misses: int
    false_positives: int


def scored(run: KindRun) -> KindScore:
    """Track the video with ``phdtrack track`` and score its corrected tracks."""
    video = run.video
    base = run.runs if video.rendered else need_data()
    source = base / video.source
    if video.rendered and not source.exists():
        phdtrack("simulate", video.name, "--out", str(run.runs / video.name))
    options = ["--detector", run.detector, "--no-video", "--overwrite", "--detect-again"]
    if run.setting:
        options += ["--set", run.setting]
    phdtrack("track", str(source), *options, "--out", str(run.out))
    judge = ["evaluate", "--truth", str(base / video.truth), "--json"]
    if video.ignored:
        judge += ["--ignore", str(base / video.ignored)]
    scores = json.loads(phdtrack(*judge, "--tracks", str(run.out / "tracks.csv")))
    return KindScore(
        float(scores["MOTA"] or 0.0),
        float(scores["IDF1"] or 0.0),
        int(scores["false_tracks"]),
        int(scores["misses"]),
        int(scores["false_positives"]),
    )


def mean_of_kinds(kinds: Sequence[str], values: Sequence[float]) -> float:
    """The mean over kinds of the mean over the videos of a kind."""
    return float(
        np.mean(
            [
                np.mean([value for one, value in zip(kinds, values, strict=True) if one == kind])
                for kind in sorted(set(kinds))
            ]
        )
    )


def chosen_elsewhere(
    kinds: Sequence[str], values: dict[str, Sequence[float]]
) -> tuple[float, dict[str, str]]:
    """The mean over kinds if the setting for each kind is the best on the other kinds; and that
    setting of each kind.

    ``values``: for each setting, the scores of all videos.
    """
    choices = dict[str, str]()
    means = list[float]()
    for kind in sorted(set(kinds)):
        outside = [k for k, one in enumerate(kinds) if one != kind]
        inside = [k for k, one in enumerate(kinds) if one == kind]
        choices[kind] = max(
            values,
            key=lambda name: mean_of_kinds(
                [kinds[k] for k in outside], [values[name][k] for k in outside]
            ),
        )
        means.append(float(np.mean([values[choices[kind]][k] for k in inside])))
    return float(np.mean(means)), choices


def draw_worst(run: KindRun, path: Path) -> int:
    """Write a picture of the frame with the most errors of a run on a rendered scene: truth in
    white, tracks in orange. Returns its number.
    """
    base = run.runs if run.video.rendered else need_data()
    truth = read_tracks(base / run.video.truth)
    tracks = read_tracks(run.out / "tracks.csv")
    worst = max(np.unique(truth.frame), key=lambda number: _errors(truth, tracks, int(number)))
    for frame in open_source(str(base / run.video.source)):
        if frame.number == worst:
            picture = cv2.resize(frame.image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
            for rows, colour in ((truth, (255, 255, 255)), (tracks, (0, 140, 255))):
                for left, top, right, bottom in 2 * rows.xyxy[rows.frame == worst].round():
                    corners = (int(left), int(top)), (int(right), int(bottom))
                    cv2.rectangle(picture, *corners, colour, 2)
            cv2.imwrite(str(path), picture)
            break
    return int(worst)


def _errors(truth: Tracks, tracks: Tracks, number: int) -> int:
    """Boxes of both kinds that overlap none of the other kind by half in a frame."""
    there = truth.xyxy[truth.frame == number]
    found = tracks.xyxy[tracks.frame == number]
    near = iou(there, found) >= MATCH
    return int((~near.any(axis=1)).sum() + (~near.any(axis=0)).sum())


def kinds_tables(options: Options, runs: Path) -> dict[str, str]:
    """The tables of the page: by video, by kind, of the settings, and of the warnings."""
    videos = [video for video in VIDEOS if video.name == SHORT or not options.quick]
    tried = {} if options.quick else TRIED
    jobs = [KindRun(video, detector, runs) for detector in DETECTORS for video in videos]
    found = in_parallel(scored, jobs, "kinds", options)
    default = found[: len(videos)]
    other = found[len(videos) :]
    kinds = [video.kind for video in videos]
    by_video = [
        [
            video.name,
            video.kind,
            score.mota,
            score.idf1,
            score.misses,
            score.false_positives,
            score.false_tracks,
            plain.mota,
            plain.idf1,
        ]
        for video, score, plain in zip(videos, default, other, strict=True)
    ]
    shown = [job for job in jobs[: len(videos)] if job.video.name == SHOWN]
    worst = [draw_worst(job, options.folder / "videos-worst.png") for job in shown]
    judged = [
        JudgedRun.of(job.video.name, job.video.kind, job.out, score.mota)
        for job, score in zip(jobs, found, strict=True)
    ]
    return {
        "kinds": _by_kind(kinds, default, other),
        "videos": table(
            (
                "video",
                "kind",
                "MOTA",
                "IDF1",
                "misses",
                "false boxes",
                "false tracks",
                "MOTA, mog2",
                "IDF1, mog2",
            ),
            by_video,
        ),
        "worst": ", ".join(map(str, worst)) or "–",
        "settings": _settings(tried, videos, default, options, runs),
        "doubt": doubt_table(judged),
        "warnings": error_table(judged),
    }


def _by_kind(kinds: Sequence[str], default: Sequence[KindScore], other: Sequence[KindScore]) -> str:
    """The means by kind, and over the kinds."""
    rows = list[list[object]]()
    for kind in [*sorted(set(kinds)), ""]:
        chosen = [k for k, one in enumerate(kinds) if kind in (one, "")]
        within = [kinds[k] for k in chosen]
        cells = [
            mean_of_kinds(within, [getattr(scores[k], name) for k in chosen])
            for scores in (default, other)
            for name in ("mota", "idf1")
        ]
        rows.append([kind or "mean of kinds", *cells])
    return table(("kind", "MOTA", "IDF1", "MOTA, mog2", "IDF1, mog2"), rows)


def _settings(
    tried: dict[str, tuple[float, ...]],
    videos: Sequence[KindVideo],
    default: Sequence[KindScore],
    options: Options,
    runs: Path,
) -> str:
    """For each setting the mean over kinds at each value, and with the value chosen elsewhere."""
    kinds = [video.kind for video in videos]
    jobs = [
        KindRun(video, DETECTORS[0], runs, f"{name}={value:g}")
        for name, values in tried.items()
        for value in values
        if value != values[1]
        for video in videos
    ]
    found = dict(zip(jobs, in_parallel(scored, jobs, "settings", options), strict=True))
    rows = list[list[object]]()
    for name, values in tried.items():
        by_value = dict[str, Sequence[float]]()
        for value in values:
            runs_of = [KindRun(video, DETECTORS[0], runs, f"{name}={value:g}") for video in videos]
            scores = default if value == values[1] else [found[run] for run in runs_of]
            by_value[f"{value:g}"] = [score.mota for score in scores]
        elsewhere, choices = chosen_elsewhere(kinds, by_value)
        rows.append(
            [
                name,
                *(
                    f"{value}: {mean_of_kinds(kinds, motas):.3f}"
                    for value, motas in by_value.items()
                ),
                elsewhere,
                ", ".join(sorted(set(choices.values()), key=float)),
            ]
        )
    return table(
        ("setting", "lower", "as shipped", "higher", "chosen on the other kinds", "values chosen"),
        rows,
    )
