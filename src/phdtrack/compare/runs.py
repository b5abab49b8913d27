"""A comparison from plan to results: what is kept already and still holds is taken, everything else
is run and kept.

First every detector looks at every video once. Then each case and method runs with the first seed,
and with the others where they may give something else, because clutter was added or something was
drawn at random. Work is shared out to processes: one that dies, of memory for example, takes no
other result along.

There is a folder for each run and for each set of detections, whole or not there at all. Its
``run.json`` says what decided the result: settings, seed, files by their contents, phdtrack by its
version and its sources.
"""

from __future__ import annotations

import json
import math
import shutil
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from itertools import count as count_from
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import phdtrack
from phdtrack import config
from phdtrack.arrays import half_if_exact
from phdtrack.clock import Clock
from phdtrack.compare.plans import Case, Plan, Run
from phdtrack.detect.convert import within_frame
from phdtrack.detect.table_detector import frames_walked
from phdtrack.errors import InputError
from phdtrack.files import json_value, write_text
from phdtrack.formats import (
    DetectionsWriter,
    read_detections,
    read_truth,
    write_tracks,
)
from phdtrack.metrics import Scores, explain
from phdtrack.metrics.agreement import other_reading
from phdtrack.metrics.counts import Counts, count
from phdtrack.metrics.labelled import detections_in_frames, in_frames
from phdtrack.metrics.matching import pair_frames
from phdtrack.metrics.scores import scores_of
from phdtrack.parallel import Failed, outcomes
from phdtrack.report.pages import write_run
from phdtrack.report.record import known_mean
from phdtrack.run.camera_motion import Mover, mover_of
from phdtrack.run.descriptors import picture_describer, with_descriptors
from phdtrack.run.detection_log import load_detections, save_detections
from phdtrack.run.environment import HOME, detecting_packages, files_digest, sources_digest
from phdtrack.run.inputs import detected_frames, open_inputs
from phdtrack.run.loop import DetectedFrame, TrackedFrame, table_frames, track_frames
from phdtrack.run.requests import SourceRequest
from phdtrack.run.scored_files import labelled_frames
from phdtrack.simulate import add_clutter
from phdtrack.tracker import Tracker
from phdtrack.types import I8, Detections, DetectionTable, SequenceInfo, Tracks, Truth
from phdtrack.video import open_source
from phdtrack.video.image_folder import SUFFIXES

Advance = Callable[[int], object]
RUN = "run.json"
TRACKS = "tracks.csv"
DETECTIONS = "detections.csv"
LOG = "detections.log"
EMBEDDINGS = "detections.npy"
# Sections of the settings on which no track depends; the detector's are among what decides the
# detections.
_NO_TRACK = ("detector", "embedding", "groups", "contours", "encounters")


@dataclass(frozen=True, slots=True, eq=False)
class ComparedRun:
    """The result of a run.

    Attributes
    ----------
    frames, detections, tracks, rows : numbers of them; detections with the added clutter.
    drawn : whether the method drew at random: another seed may give something else.
    seconds : the median over the frames of filter, extraction and association together; the first
        frames of a process load kernels and are no measure.
    counts : the sums behind the scores; None without truth.
    iou : the overlap that made a match in them.
    warning : what a user should know; empty where there is nothing.
    errors : number of errors by cause, by `metrics.errors.SUMS`; {} without truth.
    log_evidence : of the filter, mean over the frames; None where it has none.
    tracking_warnings : those of the tracker.
    """

    frames: int
    detections: int
    tracks: int
    rows: int
    drawn: bool
    seconds: float
    counts: Counts | None
    iou: float
    warning: str
    errors: Mapping[str, int]
    log_evidence: float | None
    tracking_warnings: Sequence[str] = ()

    @property
    def scores(self) -> Scores | None:
        """The scores that follow from the counts."""
        if self.counts is None:
            return None
        return scores_of(self.counts, self.iou)


@dataclass(slots=True, eq=False)
class Comparison:
    """The results of a plan, kept in ``folder``.

    Attributes
    ----------
    plan, folder : what was run, and where results are kept.
    results : by `Run.place`, of the runs that were needed: where nothing is random, the first seed
        stands for all.
    reused : runs that were there already.
    outdated : what had changed for runs that were there and ran again, by the names that
        ``run.json`` has for it.
    """

    plan: Plan
    folder: Path
    results: dict[Path, ComparedRun | Failed] = field(default_factory=dict)
    reused: int = 0
    outdated: list[str] = field(default_factory=list)

    def result(self, run: Run) -> ComparedRun | Failed:
        """The result of a run, or of the one that stands for it.

        Parameters
        ----------
        run : one of the plan's.
        """
        found = self.results.get(run.place)
        if found is None:
            return self.results[replace(run, seed=self.plan.seeds[0]).place]
        return found

    @property
    def runs(self) -> list[tuple[Run, ComparedRun | Failed]]:
        """All runs that were needed, in the plan's order."""
        return [
            (run, self.results[run.place]) for run in self.plan.runs if run.place in self.results
        ]

    @property
    def failed(self) -> list[tuple[Run, str]]:
        """The runs without a result, and why."""
        return [(run, result.reason) for run, result in self.runs if isinstance(result, Failed)]


@dataclass(frozen=True, slots=True)
class _Piece:
    """Work whose result is kept in the folder ``place``; ``work`` writes files into a folder and
    gives its ``run.json``.
    """

    place: Path
    decided_by: Mapping[str, Any]
    work: Callable[[Path], dict[str, object]]

    def __call__(self) -> dict[str, Any]:
        """Do it, in a folder that takes its place when it is whole; what ``run.json`` says."""
        part = self.place.with_name(f".{self.place.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        write_run(part / RUN, self.work(part) | {"decided_by": self.decided_by})
        shutil.rmtree(self.place, ignore_errors=True)
        part.rename(self.place)
        return read_about(self.place)


def run(
    plan: Plan,
    folder: Path,
    jobs: int = 1,
    *,
    anew: bool = False,
    advance: Advance = lambda done: None,
) -> Comparison:
    """Run what is not kept in ``folder`` yet. Whatever ends this call, what is done by then is
    kept, and reused by the next. Raises `InputError` where the folder cannot be written into, or an
    input has gone since it was planned.

    Parameters
    ----------
    plan : what to run.
    folder : where results are kept.
    jobs : processes; the results do not depend on it. Above 1 a program calls this under ``if
        __name__ == "__main__"``.
    anew : whether to run everything again.
    advance : is called with the number of `steps` that are done.

    Returns
    -------
    The results of all runs, new and kept.
    """
    write_text(probe := folder / ".probe", "")
    probe.unlink()
    _contents.cache_clear()
    found = Comparison(plan, folder)
    done = count_from(1)
    looks = {
        case.place: _Piece(
            folder / "detections" / case.place,
            json_value(_decides_detections(case)),
            partial(_detect if case.file is None else _describe, case),
        )
        for case in plan.cases
        if case.looked_at
    }
    seen: dict[Path, dict[str, Any] | Failed] = {}
    try:
        for place, document in _documents(found, looks, jobs, anew):
            seen[place] = document
            advance(next(done))
        for seeds in (plan.seeds[:1], plan.seeds[1:]):
            pieces = {}
            for one in (one for one in plan.runs if one.seed in seeds):
                look = seen.get(one.case.place)
                if one.seed == plan.seeds[0] or one.rate:
                    first = None
                else:
                    first = found.result(one)
                if isinstance(look, Failed):
                    found.results[one.place] = look
                elif not isinstance(first, ComparedRun) or first.drawn:
                    pieces[one.place] = _tracking(one, plan.iou, folder)
                    continue
                advance(next(done))
            for place, document in _documents(found, pieces, jobs, anew):
                found.results[place] = (
                    document if isinstance(document, Failed) else _result(document["outcome"])
                )
                advance(next(done))
    finally:
        for part in folder.rglob(".*.part"):  # of work that failed or was stopped
            shutil.rmtree(part, ignore_errors=True)
    return found


def _documents(
    found: Comparison, pieces: Mapping[Path, _Piece], jobs: int, anew: bool
) -> Iterator[tuple[Path, dict[str, Any] | Failed]]:
    """The ``run.json`` of each piece, as it is kept where the same decided it, else of work done
    now.
    """
    todo = []
    for place, piece in pieces.items():
        if anew:
            kept = {}
        else:
            kept = read_about(piece.place)
        before = kept.get("decided_by", {})
        if before == piece.decided_by:
            found.reused += "outcome" in kept
            yield place, kept
            continue
        todo.append(place)
        changed = [
            name for name, value in piece.decided_by.items() if before and before.get(name) != value
        ]
        found.outdated += [name for name in changed if name not in found.outdated]
    for number, result in outcomes([pieces[place] for place in todo], jobs):
        yield todo[number], result


def steps(plan: Plan) -> int:
    """The last number that `run` gives to ``advance``: videos looked at, and runs.

    Parameters
    ----------
    plan : what to run.

    Returns
    -------
    A number of steps.
    """
    return sum(case.looked_at for case in plan.cases) + len(plan.runs)


def read_about(folder: Path) -> dict[str, Any]:
    """The ``run.json`` of a run or a set of detections; empty where it cannot be read."""
    with suppress(OSError, ValueError, TypeError):
        return dict(json.loads((folder / RUN).read_text(encoding="utf-8")))
    return {}


def _result(outcome: Mapping[str, Any]) -> ComparedRun:
    """A result as ``run.json`` has it."""
    sums: dict[str, Any] = outcome["counts"] or {}
    arrays: dict[str, Any] = {
        name: np.array(value) for name, value in sums.items() if isinstance(value, list)
    }
    return ComparedRun(**{**outcome, "counts": Counts(**(sums | arrays)) if sums else None})


def _detect(case: Case, folder: Path) -> dict[str, object]:
    """A detector's detections in a video, written into the folder; numbers and times of the frames
    are in the log.
    """
    request = SourceRequest(case.source, detector=case.detections, max_width=case.max_width)
    began = time.perf_counter()
    inputs = open_inputs(request, case.parameters)
    inputs = with_descriptors(inputs, case.appearance or "none", case.embedding)
    frames = 0
    with (
        DetectionsWriter(folder / DETECTIONS, inputs.names) as writer,
        detected_frames(inputs) as detected,
    ):
        for one in save_detections(folder / LOG, detected):
            writer.append(one.frame.number, one.detections)
            frames += 1
    return {
        "seconds_per_frame": (time.perf_counter() - began) / max(frames, 1),
        "warning": "; ".join(
            filter(None, [*inputs.warnings, inputs.source.note, inputs.source.problem])
        ),
        "names": inputs.names,
    }


def _describe(case: Case, folder: Path) -> dict[str, object]:
    """The embeddings of detections in a file by the pictures, written into the folder: a row for
    each that is tracked, zeros for frames that the video does not have.
    """
    table, _ = _read(case, [])
    describer, _, guesses = picture_describer(case.appearance, case.embedding)
    assert describer is not None
    embeddings = np.zeros((len(table), describer.length), np.float32)
    for frame in open_source(case.source):
        rows = table.places(frame.number)
        if len(rows):
            embeddings[rows] = describer.describe(frame.image, table.detections.xyxy[rows])
    np.save(folder / EMBEDDINGS, half_if_exact(embeddings))
    return {"warning": "; ".join(guesses)}


def _read(case: Case, notices: list[str]) -> tuple[DetectionTable, tuple[str, ...]]:
    """The detections in the file of a case, and sentences about those that are left out."""
    assert case.file is not None
    conventions = case.reading[1]
    found = read_detections(case.file, conventions=conventions, notices=notices)
    units = {"units": conventions.units, "box": conventions.box}
    return within_frame(found, case.info, case.file, **units)


def _tracking(run: Run, iou: float, folder: Path) -> _Piece:
    """A run, scored."""
    case = run.case
    settings = {
        name: value for name, value in run.settings.as_dict().items() if name not in _NO_TRACK
    }
    decided_by = {
        "phdtrack": phdtrack.__version__,
        "sources": sources_digest(HOME),
        "sequence": asdict(case.info) | {"name": case.sequence},
        "detections": _decides_detections(case),
        "truth": "" if case.truth is None else _contents(case.truth),
        "reading": [asdict(one) for one in case.reading],
        "labelled": case.labelled,
        "clutter": run.rate,
        "seed": run.seed,
        "iou": iou,
        "settings": settings,
        "files": {name: _contents(Path(name)) for name in _files(settings)},
    }
    return _Piece(folder / run.place, json_value(decided_by), partial(_track, run, iou, folder))


def _track(run: Run, iou: float, kept: Path, folder: Path) -> dict[str, object]:
    """Track, score, and write the tracks into the folder; ``kept`` as in `run_input`."""
    inputs = run_input(run, kept)
    sequence = tracked(run, inputs)
    tracks = sequence.tracks
    frames = inputs.info.frames
    if inputs.truth is not None and not frames:
        raise InputError("no frame was read, and there is nothing to score", where=run.case.name)
    counts, errors, doubts = _scored(inputs, tracks, iou)
    result = ComparedRun(
        frames,
        len(inputs.table),
        len(np.unique(tracks.identity)),
        len(tracks),
        sequence.drawn,
        sequence.seconds,
        counts,
        iou,
        inputs.warning,
        errors,
        sequence.log_evidence,
        (*sequence.warnings, *doubts),
    )
    scores = result.scores.as_dict() if result.scores else {}
    write_tracks(folder / TRACKS, tracks)
    return {
        "run": str(run),
        "scores": scores,
        "configuration": run.settings.as_dict(),
        "outcome": result,
    }


def _scored(
    inputs: RunInput, tracks: Tracks, iou: float
) -> tuple[Counts | None, dict[str, int], tuple[str, ...]]:
    """The sums behind the scores, the numbers of errors by cause, and doubts about the truth."""
    truth = inputs.truth
    if truth is None:
        return None, {}, ()
    doubts = tuple(filter(None, [other_reading(truth, tracks)]))
    table = inputs.table
    frames = inputs.info.frames
    if len(inputs.labelled):
        truth, tracks = in_frames(truth, tracks, inputs.labelled)
        table = detections_in_frames(table, inputs.labelled)
        frames = len(inputs.labelled)
    counts = count(pair_frames(truth, tracks, frames), iou)
    return counts, explain(truth, tracks, table, frames=frames, iou=iou).sums(), doubts


class RunInput(NamedTuple):
    """The inputs of a run.

    Attributes
    ----------
    info, frames : the sequence, and its frames with detections and added clutter.
    table : the same detections as a table.
    names : what classes are called; None without classes.
    truth : None if nothing is annotated.
    labelled : the frames that are scored, the same for every method; empty for all.
    warning : what a user should know; may be empty.
    """

    info: SequenceInfo
    frames: Sequence[DetectedFrame]
    table: DetectionTable
    names: Mapping[int, str] | None
    truth: Truth | None
    labelled: I8
    warning: str


def run_input(run: Run, kept: Path) -> RunInput:
    """The inputs of a run; ``kept`` is the comparison's folder, with the detections of detectors.

    The clutter depends on the sequence's name, on the rate and on the seed: it is the same for
    every method, and in the same places for every set of detections.
    """
    case = run.case
    info = case.info
    of_truth = case.reading[0]
    folder = kept / "detections" / case.place
    about = read_about(folder)
    names: Mapping[int, str] | None
    if case.file is None:
        frames = list(load_detections(folder / LOG))
        warnings: tuple[str, ...] = (str(about["warning"]),)
        names = about["names"] and {int(code): name for code, name in about["names"].items()}
        last = max((one.frame.number for one in frames), default=0)
        info = replace(info, frames=last)
        table = _table(frames)
    else:
        notices = list[str]()
        table, sentences = _read(case, notices)
        warnings = (*notices, *sentences)
        if case.appearance:
            looks = np.load(folder / EMBEDDINGS, allow_pickle=False).astype(np.float32)
            table = replace(table, detections=replace(table.detections, embeddings=looks))
            warnings = (*warnings, str(about["warning"]))
        names = table.names
        numbers = frames_walked(table, info.frames, info.fps)
        frames = list(table_frames(table, numbers, _clock(case.source, info.fps)))
    told = list[str]()
    truth = None
    labelled: I8 = np.zeros(0, np.int64)
    if case.truth is not None:
        truth = read_truth(case.truth, conventions=of_truth, notices=told)
        labelled = labelled_frames(case.labelled, truth, None, case.truth, told)
    warnings = (*warnings, *told)
    if run.rate:
        table = _with_clutter(run, info, table, truth)
        frames = [one._replace(detections=table.at(one.frame.number)) for one in frames]
    return RunInput(info, frames, table, names, truth, labelled, "; ".join(filter(None, warnings)))


@lru_cache(maxsize=1)
def _clock(source: str, fps: float) -> Clock:
    """The times of the frames of a video; of images, or without any, those of a constant rate."""
    if source:
        times = open_source(source).times
        if times is not None:
            return times()
    return Clock.constant(fps)


def _table(frames: Sequence[DetectedFrame]) -> DetectionTable:
    """The detections of all frames."""
    detections = [one.detections for one in frames]
    number = np.repeat([one.frame.number for one in frames], [len(one) for one in detections])
    joined = Detections.of(
        np.concatenate([np.zeros((0, 4)), *(one.xyxy for one in detections)]),
        np.concatenate([np.zeros(0), *(one.confidence for one in detections)]),
        np.concatenate([np.zeros(0), *(one.class_id for one in detections)]),
    )
    if any(one.embeddings is not None for one in detections):
        looks = [one.embeddings for one in detections if one.embeddings is not None and len(one)]
        joined = replace(joined, embeddings=np.concatenate(looks) if looks else None)
    return DetectionTable(number.astype(np.int64), joined)


def _with_clutter(
    run: Run, info: SequenceInfo, table: DetectionTable, truth: Truth | None
) -> DetectionTable:
    """The detections with false alarms of the truth's sizes added."""
    sizes = np.zeros((0, 2))
    if truth is not None:
        sizes = truth.xyxy[:, 2:] - truth.xyxy[:, :2]
    name = zlib.crc32(run.case.sequence.encode("utf-8", "surrogateescape"))
    rng = np.random.default_rng([run.seed, round(1e6 * run.rate), name])
    return add_clutter(table, info, run.rate, rng, sizes)


class TrackedSequence(NamedTuple):
    """The corrected tracks of a run, whether anything was drawn at random, the median of the
    seconds per frame, the mean log evidence, and the tracker's warnings.
    """

    tracks: Tracks
    drawn: bool
    seconds: float
    log_evidence: float | None
    warnings: tuple[str, ...] = ()


class _Figures:
    """Keeps the time and the evidence of each frame."""

    def __init__(self) -> None:
        self.seconds = list[float]()
        self.evidence = list[float]()

    def take(self, tracked: TrackedFrame) -> None:
        """Keep those of a frame."""
        self.seconds.append(sum(tracked.step.seconds))
        self.evidence.append(tracked.step.info.log_evidence)


def tracked(run: Run, inputs: RunInput) -> TrackedSequence:
    """Track as `phdtrack track` does with the same detections and settings."""
    settings = run.settings
    labels = np.unique(inputs.table.detections.class_id).tolist()
    classes = config.build_classes(settings, inputs.info, inputs.names, labels, moving=True)
    tracker = Tracker(stages=classes, fps=inputs.info.fps, seed=run.seed)
    # They are among the results of the comparison, which says each once.
    tracker.on_warning = unsaid
    mover = mover_of(settings, classes.usual.model, pictures=False)
    figures = _Figures()
    track_frames(tracker, _moved(inputs.frames, mover), (figures,))
    mean = known_mean(np.array(figures.evidence))
    return TrackedSequence(
        tracker.tracks(),
        tracker.drawn,
        float(np.median(figures.seconds)) if figures.seconds else 0.0,
        mean if math.isfinite(mean) else None,
        tracker.warnings,
    )


def unsaid(sentence: str) -> None:
    """Drop a warning that is reported elsewhere."""


def _moved(frames: Iterable[DetectedFrame], mover: Mover | None) -> Iterator[DetectedFrame]:
    """The frames with the camera's motion."""
    for one in frames:
        if mover is not None:
            one = one._replace(warp=mover(one.frame, one.detections, one.pose))
        yield one


def _decides_detections(case: Case) -> dict[str, object]:
    """Everything that decides the detections of a case."""
    if case.file is not None:
        found: dict[str, object] = {"file": _contents(case.file)}
        if case.appearance:
            found["reading"] = asdict(case.reading[1])
    else:
        network = case.detections.partition(":")[2]
        found = {"network": _contents(Path(network))} if network else {}
        found["detector"] = case.detections
        found["parameters"] = dict(case.parameters)
        found["max_width"] = case.max_width
    if case.looked_at:
        found["phdtrack"] = phdtrack.__version__
        found["sources"] = sources_digest(HOME)
        found["packages"] = detecting_packages()
        found["video"] = _contents(Path(case.source))
    if case.appearance:
        describing = case.appearance.partition(":")[2]
        found["appearance"] = case.appearance
        found["embedding"] = dict(case.embedding)
        found["describing_network"] = _contents(Path(describing)) if describing else ""
    return found


@lru_cache(maxsize=4096)
def _contents(path: Path) -> str:
    """The digest of a file's contents; a folder stands for the images in it."""
    return files_digest(
        [path]
        if path.is_file()
        else sorted(f for f in path.iterdir() if f.suffix.lower() in SUFFIXES)
    )


def _files(value: object) -> list[str]:
    """The settings that name files, as a camera or a learned scene."""
    if isinstance(value, Mapping):
        return [name for part in value.values() for name in _files(part)]
    if isinstance(value, str) and value and Path(value).is_file():
        return [value]
    return []
