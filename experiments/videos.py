"""From a video to tracks: `phdtrack track` on real video, with and without the filter.

PETS09-S2L1 with three detectors, TUD-Campus and CAVIAR's shop corridor with two; shipped defaults for all. The run
directories are kept under runs/videos/, to be looked at. They are made anew each time, but for
what was detected.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from experiments.common import ROOT, Options, in_parallel, need_data, table, write
from phdtrack.detect import BACKGROUND

FILTERS = ("none", "pmb")
SCORES = ("MODA", "MODP", "MOTA", "MOTP", "IDF1", "HOTA")
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
    Video("PETS09-S2L1", "mot15/PETS09-S2L1/PETS09-S2L1.mp4", "mot15/PETS09-S2L1/gt/gt.txt", "change"),
    Video("PETS09-S2L1", "mot15/PETS09-S2L1/PETS09-S2L1.mp4", "mot15/PETS09-S2L1/gt/gt.txt", "mog2"),
    Video("PETS09-S2L1", "mot15/PETS09-S2L1/PETS09-S2L1.mp4", "mot15/PETS09-S2L1/gt/gt.txt", "person"),
    Video("TUD-Campus", "mot15/TUD-Campus/TUD-Campus.mp4", "mot15/TUD-Campus/gt/gt.txt", "change"),
    Video("TUD-Campus", "mot15/TUD-Campus/TUD-Campus.mp4", "mot15/TUD-Campus/gt/gt.txt", "person"),
    Video("OneLeaveShop1cor", "caviar/OneLeaveShop1cor.mpg", "caviar/cols1gt.xml", "change"),
    Video("OneLeaveShop1cor", "caviar/OneLeaveShop1cor.mpg", "caviar/cols1gt.xml", "person"),
)


@dataclass(frozen=True, slots=True)
class VideoRun:
    """A video, a filter, and the folder of the run directories."""

    video: Video
    filter: str
    runs: Path

    @property
    def found(self) -> Path:
        """What was detected on the video."""
        return self.runs / f"{self.video.name}-{self.video.detector}"


def detect(job: VideoRun) -> None:
    """Detect once per video and detector; what is there already is used again."""
    video, out = job.video, job.found
    if not (out / "detections.csv").exists():
        _phdtrack("detect", str(need_data() / video.source), "--detector", video.detector, "--out", str(out))


def work(job: VideoRun) -> dict[str, object]:
    """One run of the command line on the video and its detections; its JSON."""
    video, filter_name, found = job.video, job.filter, job.found
    data = need_data()
    given: tuple[str, ...] = ("--detections", str(found / "detections.csv"), "--truth", str(data / video.truth))
    given = (*given, "--filter", filter_name)
    if video.detector in BACKGROUND and filter_name != "none":
        # As `phdtrack track` does with such a detector; of a file it does not know what made it.
        given = (*given, "--set", "merged_measurements.kind=explained")
    if filter_name == "pmb":
        given = (*given, "--preset", "mot15")
    text = _phdtrack("track", str(data / video.source), *given, "--out", str(found / filter_name), "--overwrite", "--json")
    document: dict[str, object] = json.loads(text)
    return document


def _phdtrack(*arguments: str) -> str:
    """What the command line prints; RuntimeError with its words where it fails."""
    command = [sys.executable, "-m", "phdtrack", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with status {done.returncode}:\n{done.stderr}")
    return done.stdout


def main(options: Options) -> Path:
    """Run everything and write videos.md."""
    runs = ROOT / "runs" / ("videos-quick" if options.quick else "videos")
    runs.mkdir(parents=True, exist_ok=True)
    videos = [video for video in VIDEOS if video.name == SHORT] if options.quick else VIDEOS
    in_parallel(detect, [VideoRun(video, FILTERS[0], runs) for video in videos], "detecting", options)
    jobs = [VideoRun(video, name, runs) for video in videos for name in FILTERS]
    rows = [_row(job, document) for job, document in zip(jobs, in_parallel(work, jobs, "videos", options), strict=True)]
    header = ("video", "detector", "filter", *SCORES, "switches", "delay", "false tracks")
    return write("videos", options, table=table(header, rows))


def _row(job: VideoRun, document: dict[str, object]) -> list[object]:
    video, name = job.video, job.filter
    scores = document["scores"]
    assert isinstance(scores, dict)
    numbers = [float(scores[key]) for key in SCORES]
    delay = scores["delay_mean"]
    late = "–" if delay is None else f"{delay:.1f}"
    return [video.name, video.detector, name, *numbers, scores["id_switches"], late, scores["false_tracks"]]
