"""A comparison from plan to results: what is kept already is taken, everything else is run and kept.

First every detector looks at every video once. Then each cell runs with its first seed, and with the others where they may
give something else, because clutter was added or something was drawn at random. Work is shared out to processes: one that
dies, of memory for example, is reported as failed, and another takes its place.
"""

from __future__ import annotations

import multiprocessing
import shutil
import signal
import tempfile
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from phdtrack import config, pipeline
from phdtrack.compare import store
from phdtrack.compare.plans import Case, Cell, DetectorRun, Plan, Run
from phdtrack.compare.store import DETECTIONS, RunResult
from phdtrack.detect import make_detector
from phdtrack.detect.convert import within_frame
from phdtrack.errors import InputError, interrupted
from phdtrack.formats import DetectionsWriter, read_detections, read_truth, write_tracks
from phdtrack.metrics.counts import count
from phdtrack.metrics.matching import build
from phdtrack.simulate import add_clutter
from phdtrack.types import F8, I8, DetectionTable, SequenceInfo, Tracks, Truth
from phdtrack.video import open_source

T = TypeVar("T")
Advance = Callable[[int], object]


@dataclass(frozen=True, slots=True)
class Failed:
    """Why a piece of work has no result, in a sentence."""

    reason: str


@dataclass(slots=True, eq=False)
class Comparison:
    """The results of a plan, kept in ``folder``.

    Attributes
    ----------
    results : by `Run.place`, of the runs that were needed: where nothing is random, the first seed stands for all.
    detected : by `Case.place`, the folders of what detectors saw.
    reused : runs that were there already.
    outdated : what had changed for runs that were there and ran again, by the names of `decides_run`.
    """

    plan: Plan
    folder: Path
    results: dict[Path, RunResult | Failed] = field(default_factory=dict)
    detected: dict[Path, Path | Failed] = field(default_factory=dict)
    reused: int = 0
    outdated: list[str] = field(default_factory=list)

    def result(self, cell: Cell, seed: int) -> RunResult | Failed:
        """Of a cell at a seed."""
        found = self.results.get(Run(cell, seed).place)
        return self.results[Run(cell, self.plan.seeds[0]).place] if found is None else found

    def is_random(self, cell: Cell) -> bool:
        """Whether another seed may give something else."""
        first = self.result(cell, self.plan.seeds[0])
        return isinstance(first, Failed) or first.drawn

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
        needed = [run for run in others if run.cell.rate or work.done.is_random(run.cell)]
        work.count(len(others) - len(needed))
        work.track(needed)
    finally:
        for part in folder.rglob(".*.part"):  # of processes that were stopped
            shutil.rmtree(part, ignore_errors=True)
    return work.done


def steps(plan: Plan) -> int:
    """The last number that `run` gives to ``advance``: videos looked at by detectors, and runs."""
    return sum(isinstance(case.detections, DetectorRun) for case in plan.cases) + len(plan.runs)


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
        todo: list[Detect] = []
        for case in self.done.plan.cases:
            decided_by = store.decides_detections(case)
            self.digests[case.place] = store.digest(decided_by)
            if not isinstance(case.detections, DetectorRun):
                continue
            place = self.done.detected[case.place] = self.done.folder / "detections" / case.place
            there = store.read_about(place).get("digest") == self.digests[case.place] and (place / DETECTIONS).is_file()
            if there and not self.anew:
                self.count()
            else:
                todo.append(Detect(case, place, decided_by))
        for number, result in outcomes(todo, self.jobs):
            if isinstance(result, Failed):
                self.done.detected[todo[number].case.place] = result
            self.count()

    def track(self, runs: Sequence[Run]) -> None:
        """These runs, where they are not kept."""
        todo: list[Track] = []
        for run in runs:
            case, place = run.cell.case.place, self.done.folder / run.place
            detected = self.done.detected.get(case)
            decided_by = store.decides_run(run, self.digests[case], self.done.plan.iou)
            before = detected if isinstance(detected, Failed) else None if self.anew else store.kept(place, decided_by)
            if before is not None:
                self.done.results[run.place] = before
                self.done.reused += isinstance(before, RunResult)
                self.count()
                continue
            assert not isinstance(detected, Failed)
            todo.append(Track(run, self.done.plan.iou, place, detected, decided_by))
            earlier = {} if self.anew else store.read_about(place).get("decided_by", {})
            new = store.changed(earlier, decided_by) if earlier else []
            self.done.outdated += [name for name in new if name not in self.done.outdated]
        for number, result in outcomes(todo, self.jobs):
            self.done.results[todo[number].run.place] = result
            self.count()


@dataclass(frozen=True, slots=True)
class Detect:
    """A detector's look at a video, kept at ``place``."""

    case: Case
    place: Path
    decided_by: Mapping[str, object]

    def __call__(self) -> None:
        """Detections and times into the folder. Raises `InputError` where the video cannot be read."""
        given, numbers, times = self.case.detections, list[int](), list[float]()
        assert isinstance(given, DetectorRun)
        detector = make_detector(given.name, max_width=given.max_width, **given.parameters)
        source = open_source(self.case.sequence.source)
        with store.whole(self.place) as folder:
            began = time.perf_counter()
            with DetectionsWriter(folder / DETECTIONS) as writer:
                for frame in source:
                    writer.append(frame.number, detector(frame))
                    numbers.append(frame.number)
                    times.append(frame.time)
            seconds = (time.perf_counter() - began) / max(len(times), 1)
            about = {"seconds_per_frame": seconds, "warning": source.problem, "numbers": numbers, "times": times}
            store.write_about(folder, self.decided_by, **about)


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
    case, rate = run.cell.case, run.cell.rate
    info, warnings = case.info, []
    if isinstance(case.detections, DetectorRun):
        assert detected is not None
        about = store.read_about(detected)
        table, times = read_detections(detected / DETECTIONS), np.array(about["times"], np.float64)
        numbers = np.array(about["numbers"], np.int64)
        info = replace(info, frames=int(numbers.max(initial=0)))
        warnings.append(str(about["warning"]))
    else:
        file = case.detections.file
        table, left_out = within_frame(read_detections(file), info, file)
        warnings += left_out
        numbers = np.arange(1, info.frames + 1)
        times = (numbers - 1) / info.fps
    truth = None if case.sequence.truth is None else read_truth(case.sequence.truth)
    if rate:
        sizes = np.zeros((0, 2)) if truth is None else truth.xyxy[:, 2:] - truth.xyxy[:, :2]
        name = zlib.crc32(case.sequence.name.encode("utf-8", "surrogateescape"))
        table = add_clutter(table, info, rate, np.random.default_rng([run.seed, round(1e6 * rate), name]), sizes)
    return RunInput(info, table, numbers, times, truth, "; ".join(text for text in warnings if text))


@dataclass(frozen=True, slots=True)
class Track:
    """One run, kept at ``place``; ``detected`` as in `run_input`."""

    run: Run
    iou: float
    place: Path
    detected: Path | None
    decided_by: Mapping[str, object]

    def __call__(self) -> RunResult:
        """Track, score, keep."""
        given = run_input(self.run, self.detected)
        tracks, drawn, seconds = tracked(self.run, given)
        counts, frames = None, given.info.frames
        if given.truth is not None:
            if not frames:
                raise InputError("no frame was read, and there is nothing to score", where=self.run.cell.case.name)
            counts = count(build(given.truth, tracks, frames), self.iou)
        numbers = (frames, len(given.table), len(np.unique(tracks.identity)), len(tracks))
        result = RunResult(*numbers, drawn, seconds, counts, self.iou, given.warning)
        scores = {} if result.scores is None else result.scores.as_dict()
        with store.whole(self.place) as folder:
            write_tracks(folder / store.TRACKS, tracks)
            settings = self.run.cell.method.settings.as_dict()
            about = {"run": str(self.run), "scores": scores, "configuration": settings, "outcome": result}
            store.write_about(folder, self.decided_by, **about)
        return result


def tracked(run: Run, given: RunInput) -> tuple[Tracks, bool, float]:
    """Corrected tracks, whether anything was drawn at random, and the median of the seconds per frame."""
    detections = run.cell.case.detections
    detector = detections.name if isinstance(detections, DetectorRun) else ""
    stages = config.build(config.for_detector(run.cell.method.settings, detector), given.info)
    rng = np.random.default_rng(run.seed)
    state, seconds = pipeline.start(stages, rng), list[float]()
    for number, moment in zip(given.numbers.tolist(), given.times.tolist(), strict=True):
        state, step = pipeline.advance(stages, state, given.table.at(number), number, moment, rng)
        seconds.append(sum(step.seconds))
    tracks = pipeline.finish(stages, state)
    drawn = _position(rng) != _position(np.random.default_rng(run.seed))
    return tracks, drawn, float(np.median(seconds)) if seconds else 0.0


def _position(rng: np.random.Generator) -> tuple[str, object]:
    """What a generator has drawn and spawned moves this on."""
    return str(rng.bit_generator.state), getattr(rng.bit_generator.seed_seq, "n_children_spawned", 0)


def outcomes(work: Sequence[Callable[[], T]], jobs: int) -> Iterator[tuple[int, T | Failed]]:
    """The number (from 0) and the result of each piece of work, as they come, by ``jobs`` processes; with 1 by this one.

    Work and results must be of classes and functions that a fresh interpreter can import.
    """
    if min(jobs, len(work)) <= 1:
        for number, piece in enumerate(work):
            yield number, _tried(piece)
        return
    pools: list[ProcessPoolExecutor] = []
    before, worker = set(multiprocessing.active_children()), _Worker(pools)
    threads = ThreadPoolExecutor(min(jobs, len(work)))
    try:
        futures = {threads.submit(worker, piece): number for number, piece in enumerate(work)}
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        threads.shutdown()
        for pool in pools:
            pool.shutdown()


class _Worker(threading.local):
    """For each thread a process, which is replaced when it dies."""

    def __init__(self, pools: list[ProcessPoolExecutor]) -> None:
        self._pools = pools
        self._pool: ProcessPoolExecutor | None = None

    def __call__(self, piece: Callable[[], T]) -> T | Failed:
        if self._pool is None:
            # Ctrl-C is for the parent, which ends its processes.
            ignore, context = (signal.SIGINT, signal.SIG_IGN), multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, context, signal.signal, ignore)
            self._pools.append(self._pool)
        try:
            return self._pool.submit(_tried, piece).result()
        except BrokenProcessPool:
            self._pool = None
            return Failed("its process died (out of memory?)")


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
