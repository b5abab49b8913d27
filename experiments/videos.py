"""From a video to tracks: `phdtrack track` on real video, with and without the filter.

PETS09-S2L1 with three detectors, TUD-Campus and CAVIAR's shop corridor with two, rendered scenes
with moving leaves and light with the change detector; defaults for all. Also three videos whose
truth is masks of the moving regions, scored by `bench/score_masks.py` next to the real sequences.
Then the contribution of each part of the change detector: the same without that part; and all
videos with boxes by kind of scene (`experiments.video_kinds`). The run directories are kept under
runs/videos/ for inspection. They are made again each time, except for the detections.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from experiments.common import ROOT, Options, in_parallel, need_data, phdtrack, table, write
from experiments.video_kinds import kinds_tables
from phdtrack.config.presets import usual_preset
from phdtrack.detect import make_detector
from phdtrack.detect.base import Detector
from phdtrack.detect.change import ChangeDetector
from phdtrack.detect.detectors import working_width
from phdtrack.detect.scene_knowledge import study
from phdtrack.detect.wrappers import Rescaled
from phdtrack.formats import read_tracks
from phdtrack.formats.write import DetectionsWriter
from phdtrack.video import VideoSource, VideoWriter, open_source
from phdtrack.video.writing import Coding

FILTERS = ("none", "pmb")
SCORES = ("MODA", "MODP", "MOTA", "MOTP", "IDF1", "HOTA")
# With moving leaves and light; a thousand frames of each.
RENDERED = ("yard", "garden", "arcade")
# The short form's.
SHORT = "TUD-Campus"


@dataclass(frozen=True, slots=True)
class Video:
    """A video with truth, and a detector to try on it."""

    name: str
    source: str
    truth: str
    detector: str


VIDEOS = (
    Video(
        "PETS09-S2L1", "mot15/PETS09-S2L1/PETS09-S2L1.mp4", "mot15/PETS09-S2L1/gt/gt.txt", "change"
    ),
    Video(
        "PETS09-S2L1", "mot15/PETS09-S2L1/PETS09-S2L1.mp4", "mot15/PETS09-S2L1/gt/gt.txt", "mog2"
    ),
    Video(
        "PETS09-S2L1", "mot15/PETS09-S2L1/PETS09-S2L1.mp4", "mot15/PETS09-S2L1/gt/gt.txt", "person"
    ),
    Video("TUD-Campus", "mot15/TUD-Campus/TUD-Campus.mp4", "mot15/TUD-Campus/gt/gt.txt", "change"),
    Video("TUD-Campus", "mot15/TUD-Campus/TUD-Campus.mp4", "mot15/TUD-Campus/gt/gt.txt", "person"),
    Video("OneLeaveShop1cor", "caviar/OneLeaveShop1cor.mpg", "caviar/cols1gt.xml", "change"),
    Video("OneLeaveShop1cor", "caviar/OneLeaveShop1cor.mpg", "caviar/cols1gt.xml", "person"),
    *(Video(name, f"{name}/scene.mp4", f"{name}/gt/gt.txt", "change") for name in RENDERED),
)
MASKS = ("cdnet-highway", "cdnet-traffic-jitter")
# In the first frames of this one only a tree moves.
TREE = "wallflower-WavingTrees"
EMPTY = 242
# Videos to be shaken, with the standard deviations in pixels, like a camera in the wind.
SHAKEN = ("PETS09-S2L1", "TUD-Campus")
PIXELS = (1, 3, 6)
# The command line with a change detector that assumes a fixed camera.
_STANDING = """from phdtrack.cli.app import main
from phdtrack.detect.change import ChangeDetector
ChangeDetector._stabilise = lambda self, pictures: pictures
main()"""
# Parts of the change detector that are left out in turn, with their names on the page.
PARTS = {
    "file": "all that samples of the whole file teach: reference, modes, heights",
    "hidden": (
        "the rule for places that objects hide most of the time: their noise is that around them"
    ),
    "modes": "modes: what was seen at a pixel, or near it, in other samples",
    "heights": "heights of objects by place",
    "join": "joining of fragments",
    "split": "parting of what touches",
}


@dataclass(frozen=True, slots=True)
class VideoRun:
    """A video, a filter, and the folder of the run directories."""

    video: Video
    filter: str
    runs: Path
    without: str = ""

    @property
    def found(self) -> Path:
        """The detections on the video."""
        without = f"-without-{self.without}" if self.without else ""
        return self.runs / f"{self.video.name}-{self.video.detector}{without}"

    def path(self, name: str) -> str:
        """The video or its truth; those of a rendered scene are among the runs."""
        return str((self.runs if self.video.name in RENDERED else need_data()) / name)


def detect(job: VideoRun) -> None:
    """Detect once per video and detector; existing detections are reused."""
    video = job.video
    out = job.found
    if video.name in RENDERED and not Path(job.path(video.source)).exists():
        phdtrack("simulate", video.name, "--out", str(job.runs / video.name))
    if (out / "detections.csv").exists():
        return
    if job.without:
        out.mkdir(parents=True, exist_ok=True)
        source = open_source(job.path(video.source))
        detector = lacking(job.without, source)
        with DetectionsWriter(out / "detections.csv") as writer:
            for frame in source:
                writer.append(frame.number, detector(frame))
    else:
        phdtrack("detect", job.path(video.source), "--detector", video.detector, "--out", str(out))


def lacking(part: str, source: VideoSource) -> Detector:
    """The change detector of `phdtrack track` for a file, without one of the `PARTS`."""
    blobs = {part: 0.0} if part in ("join", "split") else {}
    detector = make_detector(
        "change", max_width=working_width("change", None, source.info), **blobs
    )
    inner = detector.detector if isinstance(detector, Rescaled) else detector
    assert isinstance(inner, ChangeDetector)
    if part == "hidden":
        learn = inner._learn_scene_noise
        inner._learn_scene_noise = lambda samples, hidden=None: learn(samples)  # type: ignore[method-assign]
    if part != "file":
        study(detector, source, source.sample)
    if part == "modes":
        inner._past = inner._past._replace(
            samples=np.zeros((len(inner._past.samples), 0), np.uint8)
        )
    elif part == "heights":
        inner._heights = None
    return detector


def work(job: VideoRun) -> dict[str, object]:
    """Run the command line on the video and its detections; return its JSON."""
    video = job.video
    filter_name = job.filter
    found = job.found
    options: tuple[str, ...] = (
        "--detections",
        str(found / "detections.csv"),
        "--filter",
        filter_name,
    )
    options = (*options, "--truth", job.path(video.truth)) if video.truth else options
    # The command does not know which detector made the boxes of a file.
    options = (*options, "--preset", usual_preset("box", filter_name, video.detector))
    text = phdtrack(
        "track",
        job.path(video.source),
        *options,
        "--out",
        str(found / filter_name),
        "--overwrite",
        "--json",
    )
    document: dict[str, object] = json.loads(text)
    return document


def masked(job: tuple[str, Path]) -> list[object]:
    """Track a video with masks; return found, false boxes a frame, tracks, and tracks with mostly
    false boxes; "–" if unknown.
    """
    name = job[0]
    out = job[1] / job[0]
    video = need_data() / "video" / name / f"{name}.mp4"
    phdtrack("track", str(video), "--no-video", "--out", str(out), "--overwrite", "--detect-again")
    return _by_masks(name, out)


def worth(job: VideoRun) -> str:
    """The score of the change detector, complete or without a part: MOTA, or share found and false
    boxes a frame.
    """
    detect(job)
    document = work(job)
    if job.video.truth:
        scores = document["scores"]
        assert isinstance(scores, dict)
        return f"{float(scores['MOTA']):.3f}"
    _, found, false, *_ = _by_masks(job.video.name, job.found / job.filter)
    return f"{false:.3f}" if job.video.name == TREE else f"{found:.3f}, {false:.3f}"


def shaken(job: tuple[str, int, Path]) -> list[object]:
    """Shake a video by a number of pixels; return MOTA and IDF1 with defaults, and with the camera
    assumed to be fixed.
    """
    name, pixels, runs = job
    video = next(one for one in VIDEOS if one.name == name)
    folder = runs / f"{name}-shaken-{pixels}"
    paths = VideoRun(video, "pmb", runs)
    _shake(paths.path(video.source), paths.path(video.truth), pixels, folder)
    arguments = [
        "track",
        str(folder / "video.mp4"),
        "--truth",
        str(folder / "gt.txt"),
        "--no-video",
        "--overwrite",
        "--json",
    ]
    out = ["--detect-again", "--out", str(folder / "run")]
    row = list[object]([f"{name}, {pixels} pixels"])
    for command in (["-m", "phdtrack"], ["-c", _STANDING]):
        done = subprocess.run(
            [sys.executable, *command, *arguments, *out], capture_output=True, text=True, check=True
        )
        scores = json.loads(done.stdout)["scores"]
        row += [float(scores[key] or 0.0) for key in ("MOTA", "IDF1")]
    return row


def _shake(source: str, truth: str, pixels: float, folder: Path) -> None:
    """Write video.mp4 and gt.txt of a sequence with each frame shifted at random, correlated with
    the previous one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    frames = open_source(source)
    rows = np.loadtxt(truth, delimiter=",")
    rng = np.random.default_rng(0)
    size = (frames.info.width, frames.info.height)
    shift = np.zeros(2)
    shifts = np.zeros((int(rows[:, 0].max()) + 1, 2))
    with VideoWriter(folder / "video.mp4", *size, frames.info.fps, coding=Coding(20)) as out:
        for frame in frames:
            shift = 0.7 * shift + (1 - 0.7**2) ** 0.5 * pixels * rng.standard_normal(2)
            shifts[frame.number : frame.number + 1] = shift
            matrix = np.column_stack([np.eye(2), shift])
            look = {"flags": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REPLICATE}
            out.write(cv2.warpAffine(frame.image, matrix, size, **look))
    rows[:, 2:4] += shifts[rows[:, 0].astype(int)]
    np.savetxt(folder / "gt.txt", rows, fmt="%.6g", delimiter=",")


def _by_masks(name: str, out: Path) -> list[object]:
    """The score of a run directory by the masks of its video, as in `masked`."""
    folder = need_data() / "video" / name
    if name == TREE:
        rows = read_tracks(out / "tracks.csv")
        early = rows.select(rows.frame <= EMPTY)
        return [
            name,
            "–",
            len(early) / EMPTY,
            len(np.unique(early.identity)),
            len(np.unique(early.identity)),
        ]
    scorer = need_data().parent / "bench" / "score_masks.py"
    command = [sys.executable, str(scorer), str(folder), str(out / "tracks.csv")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    pattern = r"found ([\d.]+) .*false ([\d.]+) boxes a frame, tracks (\d+), false (\d+)"
    match = re.search(pattern, printed)
    assert match is not None, printed
    return [name, float(match[1]), float(match[2]), int(match[3]), int(match[4])]


def main(options: Options) -> Path:
    """Run everything and write videos.md."""
    runs = ROOT / "runs" / ("videos-quick" if options.quick else "videos")
    runs.mkdir(parents=True, exist_ok=True)
    videos = [video for video in VIDEOS if video.name == SHORT] if options.quick else VIDEOS
    in_parallel(
        detect, [VideoRun(video, FILTERS[0], runs) for video in videos], "detecting", options
    )
    jobs = [VideoRun(video, name, runs) for video in videos for name in FILTERS]
    rows = [
        _row(job, document)
        for job, document in zip(jobs, in_parallel(work, jobs, "videos", options), strict=True)
    ]
    header = ("video", "detector", "filter", *SCORES, "switches", "delay", "false tracks")
    masks = [] if options.quick else [(name, runs) for name in (*MASKS, TREE)]
    moving = table(
        ("video", "found", "false boxes a frame", "tracks", "false"),
        in_parallel(masked, masks, "masks", options),
    )
    jolts = (
        [(name, pixels, runs) for name in SHAKEN for pixels in PIXELS]
        if not options.quick
        else [(SHORT, 3, runs)]
    )
    shaking = table(
        ("video", "MOTA", "IDF1", "MOTA, unsteadied", "IDF1, unsteadied"),
        in_parallel(shaken, jolts, "shaken", options),
    )
    parts = _parts(videos, options, runs)
    tables = {"table": table(header, rows), "masks": moving, "shaking": shaking, "parts": parts}
    return write("videos", options, **tables, **kinds_tables(options, runs))


def _parts(videos: Sequence[Video], options: Options, runs: Path) -> str:
    """The table of the contributions of the parts of the change detector."""
    seen = [video for video in videos if video.detector == "change"]
    if not options.quick:
        seen += [Video(name, f"video/{name}/{name}.mp4", "", "change") for name in (*MASKS, TREE)]
    jobs = [VideoRun(video, "pmb", runs, part) for part in ("", *PARTS) for video in seen]
    cells = in_parallel(worth, jobs, "parts", options)
    rows = [
        [PARTS.get(part, "nothing"), *cells[k * len(seen) : (k + 1) * len(seen)]]
        for k, part in enumerate(("", *PARTS))
    ]
    return table(("without", *(video.name for video in seen)), rows)


def _row(job: VideoRun, document: dict[str, object]) -> list[object]:
    video = job.video
    name = job.filter
    scores = document["scores"]
    assert isinstance(scores, dict)
    numbers = [float(scores[key]) for key in SCORES]
    delay = scores["delay_mean"]
    late = "–" if delay is None else f"{delay:.1f}"
    return [
        video.name,
        video.detector,
        name,
        *numbers,
        scores["id_switches"],
        late,
        scores["false_tracks"],
    ]
