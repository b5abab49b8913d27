"""Merged measurements: two who meet and share a blob, and videos with background detectors.

    phdtrack reproduce blobs

Rendered meetings are seen through the change detector; the videos are those of `videos`.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.blobs_outcomes import Leave, outcome
from experiments.blobs_pictures import meeting_picture
from experiments.blobs_scenes import PARTINGS, Parting, filmed
from experiments.common import Case, Options, followed, in_parallel, mot15, need_data, table, write
from phdtrack import config
from phdtrack.detect import make_detector
from phdtrack.metrics import Scores, evaluate, pool
from phdtrack.types import Detections, DetectionTable
from phdtrack.video import open_source

FILTERS = ("pmb", "gm-phd")
EXPLAINED = "merged_measurements.kind=explained"
# Settings by the name that the page gives them.
WAYS = {"as detected": (), "explained": (EXPLAINED,)}
VIDEOS = (("PETS09-S2L1", "change"), ("PETS09-S2L1", "mog2"), ("TUD-Campus", "change"))
_LEAVES: tuple[Leave, ...] = ("right", "swapped", "new", "lost")


@dataclass(frozen=True, slots=True)
class Job:
    """One case, by kind, name and seed; a filter and settings."""

    kind: str
    name: str
    seed: int
    filter: str
    sets: tuple[str, ...]
    folder: str = ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Scores of the corrected tracks and of the online rows; with which identities two left a blob, of either."""

    corrected: Scores
    online: Scores
    leave: tuple[Leave, Leave] | None


def case_of(job: Job) -> Case:
    """The sequence of a job; what had to be filmed or detected is read from the job's folder."""
    path = Path(job.folder) / f"{job.kind}-{job.name}-{job.seed}.npz"
    if not path.exists():
        case = seen(job)
        detections = case.table.detections
        np.savez(path, frame=case.table.frame, xyxy=detections.xyxy)
    with np.load(path) as kept:
        table = DetectionTable(kept["frame"], Detections.of(kept["xyxy"]))
    if job.kind == "video":
        case = mot15(job.name.partition(" ")[0], "public")
        return Case(job.name, case.info, case.truth, table)
    case = filmed((_parting(job.name), job.seed), detector=False)
    return Case(job.name, case.info, case.truth, table)


def seen(job: Job) -> Case:
    """A meeting, or a video, through the background detector."""
    if job.kind != "video":
        return filmed((_parting(job.name), job.seed))
    sequence, _, name = job.name.partition(" ")
    case, detector = mot15(sequence, "public"), make_detector(name)
    found = [(f.number, detector(f)) for f in open_source(need_data() / "mot15" / sequence / f"{sequence}.mp4")]
    frame = np.repeat([n for n, _ in found], [len(d) for _, d in found])
    boxes = np.concatenate([np.zeros((0, 4)), *(d.xyxy for _, d in found)])
    return Case(job.name, case.info, case.truth, DetectionTable(frame, Detections.of(boxes)))


def prepare(job: Job) -> int:
    """Have the case's detections in the folder; how many there are."""
    return len(case_of(job).table)


def work(job: Job) -> Outcome:
    """Track a case."""
    case = case_of(job)
    run = followed(config.build(config.load(None, job.sets), case.info, job.filter), case, 1)
    online = run.online.take(run.online.confirmed)
    scores = [evaluate(case.truth, tracks, frames=case.info.frames) for tracks in (run.corrected, online)]
    leave = (outcome(case, run.corrected), outcome(case, online)) if job.kind == "meeting" else None
    return Outcome(scores[0], scores[1], leave)


def main(options: Options | None = None) -> Path:
    """Run everything and write blobs.md and its picture."""
    options = options or Options()
    with tempfile.TemporaryDirectory() as folder:
        return _written(options, options.folder or Path(folder))


def _written(options: Options, folder: Path) -> Path:
    """The page; ``folder`` keeps what was detected."""
    seeds = options.number(20, 2)
    filters = FILTERS[:1] if options.quick else FILTERS
    folder.mkdir(parents=True, exist_ok=True)
    kept = str(folder)
    videos = [f"{sequence} {name}" for sequence, name in (VIDEOS[-1:] if options.quick else VIDEOS)]
    meetings = [
        Job("meeting", parting, seed, name, sets, kept)
        for name in filters
        for sets in WAYS.values()
        for parting in PARTINGS
        for seed in range(seeds)
    ]
    films = [Job("video", v, 0, name, sets, kept) for v in videos for name in filters for sets in WAYS.values()]
    first = {(job.kind, job.name, job.seed): job for job in (*meetings, *films)}
    in_parallel(prepare, list(first.values()), "detecting")
    jobs = [*meetings, *films]
    found = dict(zip(jobs, in_parallel(work, jobs, "blobs", options.folder), strict=True))
    options.out.mkdir(parents=True, exist_ok=True)
    meeting_picture(case_of(meetings[0]), filters[0], WAYS, options.out / "blobs.png")
    text = (
        "# Merged measurements\n\nWritten by `phdtrack reproduce blobs`. *As detected*: every blob goes to the filter as "
        "it is; *explained*: `--set merged_measurements.kind=explained`. All else is shipped defaults. Scores at IoU "
        "0.5, pooled; online: confirmed rows as they were given.\n\n"
        "## Two meet, are one blob, and part\n\n"
        f"{seeds} rendered meetings of each kind through the change detector: one blob for 1 to 3 seconds. Share of pairs "
        "that leave with the identities that they came with, by the corrected tracks (in brackets online); what became of "
        "the others: swapped, a new identity for one or both, or one not followed before or after.\n\n"
        + table(("filter", "blobs", "parting", *_LEAVES, "MOTA", "IDF1", "HOTA"), meeting_rows(meetings, found))
        + "\n![One meeting](blobs.png)\n\nWhere the blobs of a meeting lie along the picture (grey), the truth (black), and "
        "the online rows by identity.\n\n"
        "## Videos with background detectors\n\n"
        + table(("video, detector", "filter", "blobs", *_SCORES), _film_rows(films, found))
        + _MEANING
    )
    return write("blobs.md", text, options.out)


_MEANING = """
Parting merged blobs is on with background detectors (`change`, `mog2`, `knn`, `mean-background`). Who crosses slowly inside
a blob is told from who turns back by motion alone, and where both cover each other nothing shows which is which: half of
those who cross come out swapped or new. These detectors join the fragments of one
object themselves; joining more of them before the filter brought nothing on these videos, and cost 12 points of MOTA on one.
"""
_SCORES = ("MOTA", "IDF1", "HOTA", "switches", "MOTA online", "IDF1 online", "HOTA online")


def _parting(name: str) -> Parting:
    return PARTINGS[[str(parting) for parting in PARTINGS].index(name)]


def _scored(outcomes: list[Outcome]) -> list[object]:
    """The columns of `_SCORES`."""
    corrected, online = pool([o.corrected for o in outcomes]), pool([o.online for o in outcomes])
    first: list[object] = [corrected.MOTA, corrected.IDF1, corrected.HOTA, corrected.id_switches]
    return [*first, online.MOTA, online.IDF1, online.HOTA]


def meeting_rows(jobs: list[Job], found: dict[Job, Outcome]) -> list[list[object]]:
    """How pairs left, by filter, way and parting; partings without a job are left out."""
    rows: list[list[object]] = []
    for name, (way, sets), parting in _each(jobs, WAYS, tuple(dict.fromkeys(job.name for job in jobs))):
        those = [found[j] for j in jobs if (j.filter, j.sets, j.name) == (name, sets, parting)]
        left = [o.leave for o in those if o.leave is not None]
        shares: list[object] = []
        for leave in _LEAVES:
            corrected, online = (sum(pair[k] == leave for pair in left) / len(left) for k in (0, 1))
            shares.append(f"{corrected:.2f} ({online:.2f})")
        rows.append([name, way, parting, *shares, *_scored(those)[:3]])
    return rows


def _film_rows(jobs: list[Job], found: dict[Job, Outcome]) -> list[list[object]]:
    ways = {sets: way for way, sets in WAYS.items()}
    return [[job.name, job.filter, ways[job.sets], *_scored([found[job]])] for job in jobs]


def _each(
    jobs: list[Job], ways: dict[str, tuple[str, ...]], names: tuple[str, ...]
) -> list[tuple[str, tuple[str, tuple[str, ...]], str]]:
    """Filters in the order of the jobs, with every way and name."""
    filters = list(dict.fromkeys(job.filter for job in jobs))
    return [(f, way, name) for f in filters for way in ways.items() for name in names]


if __name__ == "__main__":
    main()
