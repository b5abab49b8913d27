"""A comparison from plan to results: what is kept already and still holds is taken, everything else is run and kept.

First every detector looks at every video once. Then each case and method runs with the first seed, and with the others where
they may give something else, because clutter was added or something was drawn at random. Work is shared out to processes:
one that dies, of memory for example, takes no other result along.

There is a folder for each run and for each set of detections, whole or not there at all. Its ``run.json`` has a digest of
everything that decides the result: settings, seed, files by their contents, phdtrack by its version and its sources.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import shutil
import signal
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import phdtrack
from phdtrack import config, pipeline
from phdtrack.compare.plans import Case, Plan, Run
from phdtrack.detect import make_detector
from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError, interrupted
from phdtrack.files import json_value
from phdtrack.formats import DetectionsWriter, read_detections, read_truth, write_tracks
from phdtrack.metrics import Scores
from phdtrack.metrics.counts import Counts, count
from phdtrack.metrics.matching import build
from phdtrack.metrics.scores import scores_of
from phdtrack.report.words import write_run
from phdtrack.simulate import add_clutter
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Tracks, Truth
from phdtrack.video import open_source
from phdtrack.video.sources import SUFFIXES

Advance = Callable[[int], object]
T = TypeVar("T")
RUN, TRACKS, DETECTIONS = "run.json", "tracks.csv", "detections.csv"
# Sources on which no track and no score depends, but for this file; and those on which detections depend.
_THIS = "compare/runs.py"
_NO_RESULT = ("cli", "label", "report", "compare", "detect", "video", "groups", "tracker.py", "__main__.py")
_DETECTING = ("detect", "video", "formats")
# Sections of the settings on which no track depends; the detector's are among what decides the detections.
_NO_TRACK = ("detector", "groups", "contours", "life_cycle", "encounters")


@dataclass(frozen=True, slots=True)
class Failed:
    """Why a piece of work has no result, in a sentence."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """The result of a run.

    Attributes
    ----------
    frames, detections, tracks, rows : numbers of them; detections with the added clutter.
    drawn : whether the method drew at random: another seed may give something else.
    seconds : the median over the frames of filter, extraction and association together; the first frames of a process
        load kernels and are no measure.
    counts : the sums behind the scores; None without truth.
    iou : the overlap that made a match in them.
    warning : what a user should know; empty where there is nothing.
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

    @property
    def scores(self) -> Scores | None:
        """The scores that follow from the counts."""
        return None if self.counts is None else scores_of(self.counts, self.iou)


@dataclass(slots=True, eq=False)
class Comparison:
    """The results of a plan, kept in ``folder``.

    Attributes
    ----------
    results : by `Run.place`, of the runs that were needed: where nothing is random, the first seed stands for all.
    detected : by `Case.place`, the folders of what detectors saw.
    reused : runs that were there already.
    outdated : what had changed for runs that were there and ran again, by the names that ``run.json`` has for it.
    """

    plan: Plan
    folder: Path
    results: dict[Path, RunResult | Failed] = field(default_factory=dict)
    detected: dict[Path, Path | Failed] = field(default_factory=dict)
    reused: int = 0
    outdated: list[str] = field(default_factory=list)

    def result(self, run: Run) -> RunResult | Failed:
        """Of a run, or of the one that stands for it."""
        found = self.results.get(run.place)
        return self.results[replace(run, seed=self.plan.seeds[0]).place] if found is None else found

    @property
    def runs(self) -> list[tuple[Run, RunResult | Failed]]:
        """All runs that were needed, in the plan's order."""
        return [(run, self.results[run.place]) for run in self.plan.runs if run.place in self.results]

    @property
    def failed(self) -> list[tuple[Run, str]]:
        """The runs without a result, and why."""
        return [(run, result.reason) for run, result in self.runs if isinstance(result, Failed)]


def run(plan: Plan, folder: Path, jobs: int = 1, *, anew: bool = False, advance: Advance = lambda done: None) -> Comparison:
    """Run what is not kept in ``folder`` yet. Whatever ends this call, what is done by then is kept, and reused by the next.

    Parameters
    ----------
    plan : what to run.
    folder : where results are kept.
    jobs : processes; the results do not depend on it. Above 1 a program calls this under ``if __name__ == "__main__"``.
    anew : whether to run everything again.
    advance : is called with the number of `steps` that are done.

    Returns
    -------
    The results.

    Raises
    ------
    InputError : the folder cannot be written into, or an input has gone since it was planned.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = f"cannot be written into ({error.strerror or error})"
        raise InputError(problem, where=folder, cure="Choose another folder.") from error
    work = _Work(Comparison(plan, folder), jobs, anew, advance)
    try:
        work.detect()
        work.track([run for run in plan.runs if run.seed == plan.seeds[0]])
        others = [run for run in plan.runs if run.seed != plan.seeds[0]]
        firsts = [work.done.result(run) for run in others]
        random = [one.rate > 0 or isinstance(r, Failed) or r.drawn for one, r in zip(others, firsts, strict=True)]
        work.count(len(others) - sum(random))
        work.track([run for run, needed in zip(others, random, strict=True) if needed])
    finally:
        for part in folder.rglob(".*.part"):  # of processes that were stopped
            shutil.rmtree(part, ignore_errors=True)
    return work.done


def steps(plan: Plan) -> int:
    """The last number that `run` gives to ``advance``: videos looked at by detectors, and runs."""
    return sum(case.file is None for case in plan.cases) + len(plan.runs)


@dataclass(slots=True)
class _Work:
    """What is done so far."""

    done: Comparison
    jobs: int
    anew: bool
    advance: Advance
    steps: int = 0
    digests: dict[Path, str] = field(default_factory=dict)

    def count(self, number: int = 1) -> None:
        """So many steps more are done, or not needed."""
        self.steps += number
        self.advance(self.steps)

    def detect(self) -> None:
        """Every detector on its videos, where that is not kept."""
        todo: list[tuple[Case, Callable[[], None]]] = []
        for case in self.done.plan.cases:
            decided_by = _decides_detections(case)
            self.digests[case.place] = _digest(decided_by)
            if case.file is not None:
                continue
            place = self.done.detected[case.place] = self.done.folder / "detections" / case.place
            if not self.anew and _read(place, decided_by, DETECTIONS):
                self.count()
            else:
                todo.append((case, partial(_detect, case, place, decided_by)))
        for number, result in outcomes([work for _, work in todo], self.jobs):
            if isinstance(result, Failed):
                self.done.detected[todo[number][0].place] = result
            self.count()

    def track(self, runs: Sequence[Run]) -> None:
        """These runs, where they are not kept."""
        done, todo = self.done, list[tuple[Run, Callable[[], RunResult]]]()
        for run in runs:
            place, detected = done.folder / run.place, done.detected.get(run.case.place)
            decided_by = _decides_run(run, self.digests[run.case.place], done.plan.iou)
            before = detected if isinstance(detected, Failed) else None if self.anew else _kept(place, decided_by)
            if before is not None:
                done.results[run.place] = before
                done.reused += isinstance(before, RunResult)
                self.count()
                continue
            assert not isinstance(detected, Failed)
            todo.append((run, partial(_track, run, done.plan.iou, place, detected, decided_by)))
            earlier = {} if self.anew else read_about(place).get("decided_by", {})
            new = [name for name, value in json_value(decided_by).items() if earlier and earlier.get(name) != value]
            done.outdated += [name for name in new if name not in done.outdated]
        for number, result in outcomes([work for _, work in todo], self.jobs):
            done.results[todo[number][0].place] = result
            self.count()


def _detect(case: Case, place: Path, decided_by: Mapping[str, object]) -> None:
    """A detector's look at a video, kept at ``place``: detections, numbers and times of the frames."""
    numbers, times, began = list[int](), list[float](), time.perf_counter()
    detector = make_detector(case.detections, max_width=case.max_width, **case.parameters)
    source = open_source(case.source)
    with _whole(place, decided_by) as (folder, about):
        with DetectionsWriter(folder / DETECTIONS) as writer:
            for frame in source:
                writer.append(frame.number, detector(frame))
                numbers.append(frame.number)
                times.append(frame.time)
        seconds = (time.perf_counter() - began) / max(len(times), 1)
        about |= {"seconds_per_frame": seconds, "warning": source.problem, "numbers": numbers, "times": times}


def _track(run: Run, iou: float, place: Path, detected: Path | None, decided_by: Mapping[str, object]) -> RunResult:
    """Track, score, and keep at ``place``; ``detected`` as in `run_input`."""
    given = run_input(run, detected)
    tracks, drawn, seconds = tracked(run, given)
    counts, frames = None, given.info.frames
    if given.truth is not None:
        if not frames:
            raise InputError("no frame was read, and there is nothing to score", where=run.case.name)
        counts = count(build(given.truth, tracks, frames), iou)
    numbers = (frames, len(given.table), len(np.unique(tracks.identity)), len(tracks))
    result = RunResult(*numbers, drawn, seconds, counts, iou, given.warning)
    scores = {} if result.scores is None else result.scores.as_dict()
    with _whole(place, decided_by) as (folder, about):
        write_tracks(folder / TRACKS, tracks)
        about |= {"run": str(run), "scores": scores, "configuration": run.method.settings.as_dict(), "outcome": result}
    return result


@dataclass(frozen=True, slots=True, eq=False)
class RunInput:
    """What a run works on: detections with the added clutter, ``numbers`` and ``times`` (F,) of the frames, truth if any."""

    info: SequenceInfo
    table: DetectionTable
    numbers: I8
    times: F8
    truth: Truth | None
    warning: str


def run_input(run: Run, detected: Path | None) -> RunInput:
    """What the run works on; ``detected`` is the folder of what a detector saw, None where the case has a file.

    The clutter depends on the sequence's name, on the rate and on the seed: it is the same for every method, and in the same
    places for every set of detections.
    """
    case, info, warnings = run.case, run.case.info, tuple[str, ...]()
    if case.file is None:
        assert detected is not None
        about = read_about(detected)
        table, warnings = read_detections(detected / DETECTIONS), (str(about["warning"]),)
        times, numbers = np.array(about["times"], np.float64), np.array(about["numbers"], np.int64)
        info = replace(info, frames=int(numbers.max(initial=0)))
    else:
        table, warnings = within_frame(read_detections(case.file), info, case.file)
        numbers = np.arange(1, info.frames + 1)
        times = (numbers - 1) / info.fps
    truth = None if case.truth is None else read_truth(case.truth)
    if run.rate:
        sizes = np.zeros((0, 2)) if truth is None else truth.xyxy[:, 2:] - truth.xyxy[:, :2]
        name = zlib.crc32(case.sequence.encode("utf-8", "surrogateescape"))
        table = add_clutter(table, info, run.rate, np.random.default_rng([run.seed, round(1e6 * run.rate), name]), sizes)
    return RunInput(info, table, numbers, times, truth, "; ".join(filter(None, warnings)))


def tracked(run: Run, given: RunInput) -> tuple[Tracks, bool, float]:
    """Corrected tracks, whether anything was drawn at random, and the median of the seconds per frame."""
    detector = run.case.detections if run.case.file is None else ""
    stages = config.build(config.for_detector(run.method.settings, detector), given.info)
    rng = np.random.default_rng(run.seed)
    state, seconds = pipeline.start(stages, rng), list[float]()
    for number, moment in zip(given.numbers.tolist(), given.times.tolist(), strict=True):
        state, step = pipeline.advance(stages, state, given.table.at(number), number, moment, rng)
        seconds.append(sum(step.seconds))
    tracks = pipeline.finish(stages, state)
    # What a generator has drawn moves its state on; what it has spawned it counts.
    used, fresh = rng.bit_generator, np.random.default_rng(run.seed).bit_generator
    drawn = used.state != fresh.state or getattr(used.seed_seq, "n_children_spawned", 0) > 0
    return tracks, drawn, float(np.median(seconds)) if seconds else 0.0


def outcomes(work: Sequence[Callable[[], T]], jobs: int) -> Iterator[tuple[int, T | Failed]]:
    """The number (from 0) and the result of each piece of work, as they come, by ``jobs`` processes; with 1 by this one.

    Work and results must be of classes and functions that a fresh interpreter can import. Where a process dies, the pieces
    that may have been its own are done again, each in a process by itself; what then dies again has failed.
    """
    if min(jobs, len(work)) <= 1:
        for number, piece in enumerate(work):
            yield number, _tried(piece)
        return
    left, careful = dict(enumerate(work)), 0
    while left:
        size = 1 if careful else min(jobs, len(left))
        batch = dict(list(left.items())[: 1 if careful else len(left)])
        for number, result in _in_processes(batch, size):
            del left[number]
            yield number, result
        if careful and (number := next(iter(batch))) in left:
            del left[number]
            yield number, Failed("its process died (out of memory?)")
        # Pieces are begun in their order, one more than there are processes.
        careful = careful - 1 if careful else min(jobs + 1, len(left))


def _in_processes(work: Mapping[int, Callable[[], T]], size: int) -> Iterator[tuple[int, T | Failed]]:
    """The results of the pieces by their numbers, until a process dies."""
    # Ctrl-C is for the parent, which ends its processes.
    ignore, context = (signal.SIGINT, signal.SIG_IGN), multiprocessing.get_context("spawn")
    before, pool = set(multiprocessing.active_children()), ProcessPoolExecutor(size, context, signal.signal, ignore)
    try:
        futures = {pool.submit(_tried, piece): number for number, piece in work.items()}
        for future in as_completed(futures):
            if not isinstance(future.exception(), BrokenProcessPool):
                yield futures[future], future.result()
    finally:
        # None of them has anything to do any more, but after Ctrl-C.
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        pool.shutdown(cancel_futures=True)


def _tried(piece: Callable[[], T]) -> T | Failed:
    """The result, or why there is none. Ctrl-C goes through, also where compiled code has turned it into another error."""
    try:
        return piece()
    except Exception as error:
        if interrupted(error):
            raise KeyboardInterrupt from error
        if isinstance(error, InputError):
            return Failed(str(error))
        first = str(error).partition("\n")[0]
        return Failed(f"{type(error).__name__}: {first}" if first else type(error).__name__)


@contextmanager
def _whole(place: Path, decided_by: Mapping[str, object]) -> Iterator[tuple[Path, dict[str, object]]]:
    """A folder to write into, which takes the place of ``place`` when it is done and vanishes where that fails.

    Its ``run.json`` has the digest of what decided it, what the block puts into the mapping, and what decided it.
    """
    part, about = place.with_name(f".{place.name}.part"), dict[str, object]()
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part, about
        write_run(part / RUN, {"digest": _digest(decided_by), **about, "decided_by": decided_by})
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    shutil.rmtree(place, ignore_errors=True)
    part.rename(place)


def read_about(folder: Path) -> dict[str, Any]:
    """The ``run.json`` of a run or a set of detections; empty where it cannot be read."""
    try:
        return dict(json.loads((folder / RUN).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return {}


def _read(folder: Path, decided_by: Mapping[str, object], file: str) -> dict[str, Any]:
    """The same where it was decided by the same and has its file; empty otherwise."""
    document = read_about(folder)
    return document if document.get("digest") == _digest(decided_by) and (folder / file).is_file() else {}


def _kept(folder: Path, decided_by: Mapping[str, object]) -> RunResult | None:
    """The result that is kept there, if it was decided by the same."""
    try:
        outcome = dict(_read(folder, decided_by, TRACKS)["outcome"])
        sums: dict[str, Any] | None = outcome.pop("counts")
        if sums is None:
            return RunResult(**outcome, counts=None)
        made: dict[str, Any] = {name: np.array(each) if isinstance(each, list) else each for name, each in sums.items()}
        return RunResult(**outcome, counts=Counts(**made))
    except (KeyError, TypeError, ValueError):
        return None


def _decides_run(run: Run, detections: str, iou: float) -> dict[str, object]:
    """What decides the result of a run, ``detections`` being the digest of what decides those, in plain values."""
    case = run.case
    settings = {name: value for name, value in run.method.settings.as_dict().items() if name not in _NO_TRACK}
    return {
        "phdtrack": phdtrack.__version__,
        "sources": source_digests()[0],
        "sequence": asdict(case.info) | {"name": case.sequence},
        "detections": detections,
        "truth": "" if case.truth is None else _contents(case.truth),
        "clutter": run.rate,
        "seed": run.seed,
        "iou": iou,
        "settings": settings,
        "files": {name: _contents(Path(name)) for name in _files(settings)},
    }


def _decides_detections(case: Case) -> dict[str, object]:
    """What decides the detections of a case."""
    if case.file is not None:
        return {"file": _contents(case.file)}
    return {
        "phdtrack": phdtrack.__version__,
        "sources": source_digests()[1],
        "video": _contents(Path(case.source)),
        "detector": case.detections,
        "parameters": dict(case.parameters),
        "max_width": case.max_width,
    }


@lru_cache(maxsize=1)
def source_digests() -> tuple[str, str]:
    """The digests of phdtrack's sources on which tracks depend, and of those on which detections depend."""
    home = Path(phdtrack.__file__).parent
    names = {file: file.relative_to(home).as_posix() for file in sorted(home.rglob("*.py"))}
    tracking = (file for file, name in names.items() if name == _THIS or name.split("/")[0] not in _NO_RESULT)
    detecting = (file for file, name in names.items() if name == _THIS or name.split("/")[0] in _DETECTING)
    return _digest_of(tracking), _digest_of(detecting)


def _digest(value: Mapping[str, object]) -> str:
    """32 hexadecimal digits for plain values."""
    text = json.dumps(json_value(value), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()[:32]


def _digest_of(files: Iterable[Path]) -> str:
    """The same for files by their names and contents."""
    total = hashlib.sha256()
    for file in files:
        total.update(file.name.encode("utf-8", "surrogateescape") + b"\0" + _file_digest(file, file.stat().st_mtime_ns))
    return total.hexdigest()[:32]


@lru_cache(maxsize=4096)
def _file_digest(file: Path, changed: int) -> bytes:
    """A file is read again when its time changes."""
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").digest()


def _contents(path: Path) -> str:
    """The digest of a file's contents; a folder stands for the images in it."""
    if path.is_file():
        return _digest_of([path])
    return _digest_of(sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES))


def _files(value: object) -> list[str]:
    """The settings that name files, as a camera or a learned scene."""
    if isinstance(value, Mapping):
        return [name for part in value.values() for name in _files(part)]
    return [value] if isinstance(value, str) and value and Path(value).is_file() else []
