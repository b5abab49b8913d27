"""From a video to tracks: `phdtrack track` on real video, with and without the filter.

    python -m phdtrack.reproduce.videos

PETS09-S2L1 with three detectors, TUD-Campus and CAVIAR's shop corridor with two; shipped defaults for all. The run
directories are kept under runs/videos/, to be looked at.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

from phdtrack.reproduce.common import ROOT, in_parallel, need_data, table, write

RUNS = ROOT / "runs" / "videos"
FILTERS = ("none", "particle-phd")


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


def detect(video: Video) -> None:
    """Detect once per video and detector; what is there already is used again."""
    out = RUNS / f"{video.name}-{video.detector}"
    if not (out / "detections.csv").exists():
        _phdtrack("detect", str(need_data() / video.source), "--detector", video.detector, "--out", str(out))


def work(job: tuple[Video, str]) -> dict[str, object]:
    """One run of the command line on the video and its detections; its JSON."""
    video, filter_name = job
    data = need_data()
    found = RUNS / f"{video.name}-{video.detector}"
    given = ("--detections", str(found / "detections.csv"), "--truth", str(data / video.truth), "--filter", filter_name)
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


def main() -> None:
    """Run everything and write docs/results/videos.md."""
    RUNS.mkdir(parents=True, exist_ok=True)
    in_parallel(detect, VIDEOS, "detecting")
    jobs = [(video, name) for video in VIDEOS for name in FILTERS]
    rows = [_row(job, document) for job, document in zip(jobs, in_parallel(work, jobs, "videos"), strict=True)]
    write(
        "videos.md",
        "# From a video to tracks\n\n"
        "Written by `python -m phdtrack.reproduce.videos` (part of `make experiments`): `phdtrack track VIDEO --truth …`, "
        "with shipped defaults, seed 0. Scores of the corrected tracks at IoU 0.5. *delay*: frames from an object's first "
        "annotated frame to its first output row, over the objects that were found. *false tracks*: identities that never "
        "match an object. Each detector runs once and both filters take its boxes (`phdtrack detect`, then `--detections`), "
        "which gives what `phdtrack track VIDEO --detector …` gives. The runs are kept under `runs/videos/`. The background "
        "detectors' settings were chosen on these videos, PETS09-S2L1 above all.\n\n"
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
    )


def _row(job: tuple[Video, str], document: dict[str, object]) -> list[object]:
    video, name = job
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
