"""One piece of work, in whatever process: a run, or a detector's look at a video."""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phdtrack import config, pipeline
from phdtrack.compare.records import Case, Detecting, Run
from phdtrack.compare.store import DETECTIONS, TRACKS, Outcome, read_about, whole, write_about
from phdtrack.detect import make_detector
from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError
from phdtrack.formats import DetectionsWriter, read_detections, read_truth, write_tracks
from phdtrack.metrics.matching import build
from phdtrack.metrics.scores import count
from phdtrack.simulate import add_clutter
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Tracks, Truth
from phdtrack.video import open_source


@dataclass(frozen=True, slots=True)
class Look:
    """Run a detector over a video, and keep what it sees at ``place``."""

    case: Case
    place: Path
    digest: str
    decided_by: Mapping[str, object]

    def __call__(self) -> None:
        """Detections and times into the folder. Raises `InputError` where the video cannot be read."""
        seen, numbers, times = self.case.seen, list[int](), list[float]()
        if not isinstance(seen, Detecting):
            raise TypeError(f"{self.case.name} has no detector")
        detector = make_detector(seen.name, max_width=seen.max_width, **seen.parameters)
        source = open_source(self.case.footage.source)
        with whole(self.place) as folder:
            began = time.perf_counter()
            with DetectionsWriter(folder / DETECTIONS) as writer:
                for frame in source:
                    writer.append(frame.number, detector(frame))
                    numbers.append(frame.number)
                    times.append(frame.time)
            seconds = (time.perf_counter() - began) / max(len(times), 1)
            about = {"seconds_per_frame": seconds, "warning": source.problem, "numbers": numbers, "times": times}
            write_about(folder, self.digest, self.decided_by, **about)


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """What a run works on: detections with the added clutter, ``numbers`` and ``times`` (F,) of the frames, truth if any."""

    info: SequenceInfo
    table: DetectionTable
    numbers: I8
    times: F8
    truth: Truth | None
    warning: str


def material(run: Run, detected: Path | None) -> Material:
    """What the run works on; ``detected`` is the folder of what a detector saw, None where the case has a file.

    The clutter depends on the sequence's name, on the rate and on the seed: it is the same for every method, and in the same
    places for every set of detections.
    """
    case, rate = run.cell.case, run.cell.rate
    info, warnings = case.info, []
    if isinstance(case.seen, Detecting):
        if detected is None:
            raise TypeError(f"{case.name} needs the folder of its detections")
        about = read_about(detected)
        table, times = read_detections(detected / DETECTIONS), np.array(about["times"], np.float64)
        numbers = np.array(about["numbers"], np.int64)
        info = replace(info, frames=int(numbers.max(initial=0)))
        warnings.append(str(about["warning"]))
    else:
        table, left_out = within_frame(read_detections(case.seen.file), info, case.seen.file)
        numbers = np.arange(1, info.frames + 1)
        times = (numbers - 1) / info.fps
        warnings += left_out
    truth = None if case.footage.truth is None else read_truth(case.footage.truth)
    if rate:
        sizes = np.zeros((0, 2)) if truth is None else truth.xyxy[:, 2:] - truth.xyxy[:, :2]
        name = zlib.crc32(case.footage.name.encode("utf-8", "surrogateescape"))
        rng = np.random.default_rng([run.seed, round(1e6 * rate), name])
        table = add_clutter(table, info, rate, rng, sizes)
    return Material(info, table, numbers, times, truth, "; ".join(text for text in warnings if text))


@dataclass(frozen=True, slots=True)
class Track:
    """One run, kept at ``place``; ``detected`` as in `material`."""

    run: Run
    iou: float
    place: Path
    detected: Path | None
    digest: str
    decided_by: Mapping[str, object]

    def __call__(self) -> Outcome:
        """Track, score, keep."""
        given = material(self.run, self.detected)
        tracks, drawn, seconds = tracked(self.run, given)
        counts = None
        if given.truth is not None:
            if not given.info.frames:
                raise InputError("no frame was read, and there is nothing to score", where=self.run.cell.case.name)
            counts = count(build(given.truth, tracks, given.info.frames), self.iou)
        outcome = Outcome(
            frames=given.info.frames,
            detections=len(given.table),
            tracks=len(np.unique(tracks.identity)),
            rows=len(tracks),
            drawn=drawn,
            seconds=seconds,
            counts=counts,
            iou=self.iou,
            warning=given.warning,
        )
        scores = {} if outcome.scores is None else outcome.scores.as_dict()
        with whole(self.place) as folder:
            write_tracks(folder / TRACKS, tracks)
            settings = self.run.cell.method.settings.as_dict()
            about = {"run": str(self.run), "scores": scores, "configuration": settings, "outcome": outcome}
            write_about(folder, self.digest, self.decided_by, **about)
        return outcome


def tracked(run: Run, given: Material) -> tuple[Tracks, bool, float]:
    """Corrected tracks, whether anything was drawn at random, and the median of the seconds per frame."""
    seen = run.cell.case.seen
    settings = config.for_detector(run.cell.method.settings, seen.name if isinstance(seen, Detecting) else "")
    stages = config.build(settings, given.info)
    rng = np.random.default_rng(run.seed)
    state, seconds = pipeline.start(stages, rng), list[float]()
    for number, moment in zip(given.numbers.tolist(), given.times.tolist(), strict=True):
        state, step = pipeline.advance(stages, state, given.table.at(number), number, moment, rng)
        seconds.append(sum(step.seconds))
    tracks = pipeline.finish(stages, state)
    drawn = _state(rng) != _state(np.random.default_rng(run.seed))
    return tracks, drawn, float(np.median(seconds)) if seconds else 0.0


def _state(rng: np.random.Generator) -> tuple[str, int]:
    """Where a generator stands; what it was asked for moves it on."""
    seeds = rng.bit_generator.seed_seq
    children = seeds.n_children_spawned if isinstance(seeds, np.random.SeedSequence) else 0
    return str(rng.bit_generator.state), children
