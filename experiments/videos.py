"""From a video to tracks: `phdtrack track` on real video, with and without the filter.

    phdtrack reproduce videos

PETS09-S2L1 with three detectors, TUD-Campus and CAVIAR's shop corridor with two; shipped defaults for all. The run
directories are kept, under runs/videos/ if nothing else is said, to be looked at. They are made anew each time, but for
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
class Job:
    """A video, a filter, and the folder of the run directories."""

    video: Video
    filter: str
    runs: Path

    @property
    def found(self) -> Path:
        """What was detected on the video."""
        return self.runs / f"{self.video.name}-{self.video.detector}"


def detect(job: Job) -> None:
    """Detect once per video and detector; what is there already is used again."""
    video, out = job.video, job.found
    if not (out / "detections.csv").exists():
        _phdtrack("detect", str(need_data() / video.source), "--detector", video.detector, "--out", str(out))


def work(job: Job) -> dict[str, object]:
    """One run of the command line on the video and its detections; its JSON."""
    video, filter_name, found = job.video, job.filter, job.found
    data = need_data()
    given: tuple[str, ...] = (
        "--detections",
        str(found / "detections.csv"),
        "--truth",
        str(data / video.truth),
        "--filter",
        filter_name,
    )
    if video.detector in BACKGROUND and filter_name != "none":
        # As `phdtrack track` does with such a detector; of a file it does not know what made it.
        given = (*given, "--set", "merged_measurements.kind=explained")
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


def main(options: Options | None = None) -> Path:
    """Run everything and write videos.md."""
    options = options or Options()
    runs = options.folder or ROOT / "runs" / "videos"
    runs.mkdir(parents=True, exist_ok=True)
    videos = [video for video in VIDEOS if video.name == SHORT] if options.quick else VIDEOS
    in_parallel(detect, [Job(video, FILTERS[0], runs) for video in videos], "detecting")
    jobs = [Job(video, name, runs) for video in videos for name in FILTERS]
    rows = [_row(job, document) for job, document in zip(jobs, in_parallel(work, jobs, "videos"), strict=True)]
    return write(
        "videos.md",
        "# From a video to tracks\n\n"
        "Written by `phdtrack reproduce videos`: `phdtrack track VIDEO --truth …`, shipped defaults, seed 0. Scores of the "
        "corrected tracks at IoU 0.5. *delay*: frames from an object's first annotated frame to its first output row, over "
        "the objects that were found. *false tracks*: identities that never match an object. Each detector runs once and "
        "both filters take its boxes (`phdtrack detect`, then `--detections`), which gives what "
        "`phdtrack track VIDEO --detector …` gives. The background detectors' settings were chosen on these videos, "
        "PETS09-S2L1 above all.\n\n"
        + table(
            (
                "video",
                "detector",
                "filter",
                "MODA",
                "MODP",
                "MOTA",
                "MOTP",
                "IDF1",
                "HOTA",
                "switches",
                "delay",
                "false tracks",
            ),
            rows,
        ),
        options.out,
    )


def _row(job: Job, document: dict[str, object]) -> list[object]:
    video, name = job.video, job.filter
    scores = document["scores"]
    assert isinstance(scores, dict)
    numbers = [float(scores[key]) for key in ("MODA", "MODP", "MOTA", "MOTP", "IDF1", "HOTA")]
    delay = scores["delay_mean"]
    return [
        video.name,
        video.detector,
        name,
        *numbers,
        scores["id_switches"],
        "–" if delay is None else f"{delay:.1f}",
        scores["false_tracks"],
    ]


if __name__ == "__main__":
    main()
