"""Appearance on real pictures, for `experiments.appearance`: PETS09-S2L1 and TUD-Campus.

Each case is tracked with a small share of its boxes left out, again and again, because a few
crossings decide a single run. And `phdtrack track` on all videos with boxes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments.appearance_runs import NONE, followed
from experiments.common import (
    ROOT,
    Options,
    filled,
    in_parallel,
    need_data,
    phdtrack,
    table,
    with_error,
)
from experiments.degraded_inputs import CameraCase, read_case, with_area
from experiments.peers import counted
from experiments.video_kinds import SHORT, VIDEOS, KindVideo, mean_of_kinds
from phdtrack.detect.colours import Colours
from phdtrack.formats import read_truth
from phdtrack.metrics import evaluate
from phdtrack.types import F8
from phdtrack.video import open_source

F4 = np.ndarray[tuple[int, ...], np.dtype[np.float32]]

SEQUENCES = ("PETS09-S2L1", SHORT)
DETECTORS = ("frcnn", "public")
# Sources of embeddings, by their names on the page.
COLOURS = "colours"
FILE = "embeddings.npy"
BOTH = "both"
SOURCES = (NONE, COLOURS, FILE, BOTH)
RUNS = 6
# The share of the boxes that is left out.
LEFT_OUT = 0.03
# Seconds within which identities are given back; 0: as long as the odds allow.
LIMITS = (0.1, 0.0)
OUTPUTS = ("online", "corrected")
# Points of IDF1 that colours may cost a video if `track VIDEO` is to use them unasked.
WORST_LOSS = 0.5
# HOTA and IDF1 of online and corrected rows.
PictureScores = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class PictureRun:
    """A case, a source of embeddings, a limit, the seed of what is left out, and the folder of
    colours.
    """

    case: CameraCase
    source: str
    within: float
    seed: int
    place: Path


def cases(sequences: Sequence[str]) -> list[CameraCase]:
    """The cases with real pictures."""
    return [
        CameraCase("MOT15", sequence, detector, need_data() / "mot15" / sequence)
        for sequence in sequences
        for detector in DETECTORS
    ]


def colours_path(case: CameraCase, place: Path) -> Path:
    """The file of the colours of a case."""
    return place / f"{case.name}.npy"


def describe(job: tuple[str, Path]) -> None:
    """Keep the colours of all boxes of a sequence in a folder."""
    sequence, place = job
    colours = Colours()
    given = {case: read_case(case) for case in cases([sequence])}
    found = {
        case: np.zeros((len(one.frame), colours.length), np.float32) for case, one in given.items()
    }
    folder = need_data() / "mot15" / sequence
    for frame in open_source(str(folder / f"{sequence}.mp4")):
        for case, one in given.items():
            here = one.frame == frame.number
            if here.any():
                found[case][here] = colours.describe(frame.image, one.xyxy[here])
    for case, rows in found.items():
        np.save(colours_path(case, place), rows)


def embeddings(run: PictureRun) -> F4 | None:
    """(M, D) the embeddings of a case from a source. Both: one after the other, each of length
    one.
    """
    case = run.case
    if run.source == NONE:
        return None
    colours: F4 = np.load(colours_path(case, run.place))
    rows = np.loadtxt(case.detections, delimiter=",", ndmin=2)
    kept = np.load(case.detections.with_name("embeddings.npy"))[with_area(rows)]
    of_file: F4 = kept.astype(np.float32)
    if run.source == COLOURS:
        return colours
    if run.source == FILE:
        return of_file
    return np.hstack([unit(of_file), unit(colours)])


def unit(rows: F4) -> F4:
    """The rows at length one; zeros stay."""
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    out: F4 = rows / np.maximum(length, 1e-9)
    return out


def scores(run: PictureRun) -> PictureScores:
    """Track a case with some boxes left out; return HOTA and IDF1 of both outputs, in points."""
    given = read_case(run.case)
    looks = embeddings(run)
    kept = np.random.default_rng(run.seed).random(len(given.frame)) >= LEFT_OUT
    fewer = replace(given, frame=given.frame[kept], xyxy=given.xyxy[kept], score=given.score[kept])
    tracks = followed(
        fewer,
        None if looks is None else looks[kept],
        appearance={"reidentify_within": run.within},
    )
    truth = counted(read_truth(run.case.folder / "gt" / "gt.txt"))
    found = [evaluate(truth, each, frames=given.frames) for each in tracks]
    online, corrected = ((100 * one.HOTA, 100 * one.IDF1) for one in found)
    return online, corrected


def section(options: Options) -> str:
    """The part of the page."""
    sequences = SEQUENCES[1:] if options.quick else SEQUENCES
    number = options.number(RUNS, 2)
    of = cases(sequences)
    with TemporaryDirectory() as folder:
        place = Path(folder)
        in_parallel(describe, [(name, place) for name in sequences], "colours", options)
        jobs = [
            PictureRun(case, source, within, seed, place)
            for case in of
            for within in LIMITS
            for source in SOURCES
            for seed in range(1, number + 1)
            # Without embeddings no identity is given back.
            if source != NONE or within == LIMITS[0]
        ]
        found = dict(zip(jobs, in_parallel(scores, jobs, "pictures", options), strict=True))
    return filled(
        "appearance_pictures",
        runs=number,
        left_out=f"{100 * LEFT_OUT:g}",
        short=_tables(found, of, LIMITS[0]),
        default=_tables(found, of, LIMITS[1]),
        verdict=_verdict(found, of),
    )


def _values(
    found: Mapping[PictureRun, PictureScores], case: CameraCase, source: str, within: float
) -> F8:
    """(runs, 2, 2) the scores of all runs, by output, and HOTA or IDF1."""
    wanted = LIMITS[0] if source == NONE else within
    return np.array(
        [
            scores
            for run, scores in found.items()
            if (run.case, run.source, run.within) == (case, source, wanted)
        ]
    )


def _tables(
    found: Mapping[PictureRun, PictureScores], of: Sequence[CameraCase], within: float
) -> str:
    """A table of IDF1 and one of HOTA."""
    parts = []
    for score, name in ((1, "IDF1"), (0, "HOTA")):
        rows = list[list[object]]()
        for output, title in enumerate(OUTPUTS):
            by_case = {
                source: [_values(found, case, source, within)[:, output, score] for case in of]
                for source in SOURCES
            }
            for k, case in enumerate(of):
                cells = [with_error(by_case[source][k].tolist(), 1) for source in SOURCES]
                rows.append([f"{case.sequence} {case.detector}", title, *cells])
            means = [with_error(np.mean(by_case[source], axis=0).tolist(), 1) for source in SOURCES]
            rows.append(["mean", title, *means])
        parts.append(table((name, "rows", *SOURCES), rows))
    return "\n".join(parts)


def _verdict(found: Mapping[PictureRun, PictureScores], of: Sequence[CameraCase]) -> str:
    """What appearance is worth in IDF1, a sentence for each source."""
    sentences = []
    for source in SOURCES[1:]:
        words = []
        worst = (np.inf, "", "")
        for output, title in enumerate(OUTPUTS):
            gains = [
                _values(found, case, source, LIMITS[0])[:, output, 1]
                - _values(found, case, NONE, LIMITS[0])[:, output, 1]
                for case in of
            ]
            mean = np.mean(gains, axis=0)
            words.append(f"{np.mean(mean):+.1f} {title}")
            least = int(np.argmin([each.mean() for each in gains]))
            name = f"{of[least].sequence} {of[least].detector}, {title}"
            worst = min(worst, (float(gains[least].mean()), name, title))
        sentences.append(
            f"With {source}: IDF1 {' and '.join(words)}; the worst case is {worst[0]:+.1f}"
            f" ({worst[1]})."
        )
    return " ".join(sentences)


# A video with boxes, and where embeddings come from.
VideoLooks = tuple[KindVideo, str]


def video_scores(job: VideoLooks) -> tuple[float, float, float, float]:
    """HOTA and IDF1 of the online and the corrected rows of `phdtrack track` on a video."""
    video, source = job
    runs = ROOT / "runs" / "videos"
    base = runs if video.rendered else need_data()
    if video.rendered and not (base / video.source).exists():
        phdtrack("simulate", video.name, "--out", str(runs / video.name))
    out = ROOT / "runs" / "appearance-videos" / f"{video.name}-{source}"
    options = ["--appearance", source, "--no-video", "--overwrite", "--detect-again"]
    phdtrack("track", str(base / video.source), *options, "--out", str(out))
    judge = ["evaluate", "--truth", str(base / video.truth), "--json"]
    if video.ignored:
        judge += ["--ignore", str(base / video.ignored)]
    values = []
    for name in ("tracks_online.csv", "tracks.csv"):
        found = json.loads(phdtrack(*judge, "--tracks", str(out / name)))
        values += [100 * float(found[score] or 0.0) for score in ("HOTA", "IDF1")]
    a, b, c, d = values
    return a, b, c, d


def videos_section(options: Options) -> str:
    """The part of the page on videos, which takes minutes."""
    videos = [one for one in VIDEOS if one.name == SHORT or not options.quick]
    jobs = [(video, source) for video in videos for source in (NONE, COLOURS)]
    found = dict(zip(jobs, in_parallel(video_scores, jobs, "videos", options), strict=True))
    kinds = [video.kind for video in videos]
    rows = list[list[object]]()
    for video in videos:
        pairs = zip(found[video, NONE], found[video, COLOURS], strict=True)
        rows.append([video.name, video.kind, *(f"{a:.1f} → {b:.1f}" for a, b in pairs)])
    means = [
        [mean_of_kinds(kinds, [found[video, source][k] for video in videos]) for k in range(4)]
        for source in (NONE, COLOURS)
    ]
    rows.append(["mean of kinds", "", *(f"{a:.1f} → {b:.1f}" for a, b in zip(*means, strict=True))])
    header = ("video", "kind", "HOTA, online", "IDF1, online", "HOTA, corrected", "IDF1, corrected")
    verdict = videos_verdict(
        [video.name for video in videos],
        np.array([found[video, COLOURS] for video in videos])
        - np.array([found[video, NONE] for video in videos]),
        np.subtract(means[1], means[0]),
    )
    return filled("appearance_videos", table=table(header, rows), verdict=verdict)


def videos_verdict(names: Sequence[str], gains: F8, means: F8) -> str:
    """A sentence or two that say if colours pay on videos.

    Parameters
    ----------
    names, gains : of V videos, and what colours gain (V, 4), as of `video_scores`.
    means : (4,) the mean gain.
    """
    video, output = np.unravel_index(int(gains[:, 1::2].argmin()), (len(names), 2))
    worst = float(gains[video, 1 + 2 * output])
    pays = bool((means[1::2] > 0).all()) and worst >= -WORST_LOSS
    return (
        f"With colours IDF1 {means[1]:+.1f} online and {means[3]:+.1f} corrected; the worst video"
        f" is {worst:+.1f} ({names[video]}, {OUTPUTS[output]}). So `track VIDEO` "
        + ("would gain by colours." if pays else "uses no colours unless it is asked for.")
    )
