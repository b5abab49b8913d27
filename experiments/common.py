"""What the experiments share: how they are asked for, sequences, one run of the tracker, parallel work, tables in Markdown.

An experiment is a module with ``main(options: Options = Options()) -> Path``: it measures, writes its page (and pictures)
to ``options.out`` and returns the page. `in_parallel` keeps outcomes in ``options.folder``.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from phdtrack import config, pipeline
from phdtrack.compare.digest import sources
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_seqinfo, read_truth
from phdtrack.metrics import Scores, evaluate, first_output_delays
from phdtrack.protocols import AnyStages
from phdtrack.types import DetectionTable, SequenceInfo, Tracks, Truth

# In a checkout the pages of results are the committed ones; an installed package writes where it is run.
_CHECKOUT = Path(__file__).resolve().parents[3]
ROOT = _CHECKOUT if (_CHECKOUT / "pyproject.toml").is_file() else Path.cwd()
RESULTS = ROOT / "docs" / "results" if ROOT == _CHECKOUT else ROOT / "phdtrack-results"

A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True, slots=True)
class Options:
    """How an experiment is run.

    Attributes
    ----------
    runs : Monte Carlo runs (seeds) of each case; 0: the experiment's own number. One that draws nothing does not ask.
    quick : a short form: that everything works is seen in a minute or two, and its figures are no results.
    out : where pages and pictures are written.
    folder : where outcomes are kept, so that a run that was broken off goes on; None: nowhere.

    The real sequences are where the environment says (`need_data`), because worker processes need them too.
    """

    runs: int = 0
    quick: bool = False
    out: Path = RESULTS
    folder: Path | None = None

    def number(self, usual: int, quick: int) -> int:
        """Number of runs: as asked for, else ``quick`` in the short form and ``usual`` in the full one."""
        return self.runs or (quick if self.quick else usual)


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A sequence with truth and one set of detections."""

    name: str
    info: SequenceInfo
    truth: Truth
    table: DetectionTable


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Corrected tracks, the rows given online, and the seconds that a frame took in filter, extraction and association."""

    corrected: Tracks
    online: Tracks
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What one run gave."""

    scores: Scores
    delay: float
    seconds_per_frame: float


def need_data() -> Path:
    """The folder of real sequences, $PHDTRACK_DATA or shared/data beside the checkout; `InputError` where it is missing."""
    data = Path(os.environ.get("PHDTRACK_DATA", ROOT.parent / "shared" / "data"))
    if not (data / "mot15").is_dir():
        raise InputError(
            "the real sequences are missing", where=data, cure="Set PHDTRACK_DATA to the folder that holds mot15/"
        )
    return data


def mot15(sequence: str, kind: str) -> Case:
    """A MOT15 sequence with its ``public`` or ``frcnn`` detections."""
    folder = need_data() / "mot15" / sequence
    table = read_detections(folder / f"det_{kind}" / "det.txt")
    return Case(f"{sequence} {kind}", read_seqinfo(folder), read_truth(folder / "gt" / "gt.txt"), table)


def track(case: Case, filter_name: str, seed: int, sets: Sequence[str] = (), preset: str = "") -> tuple[Tracks, float]:
    """Corrected tracks of a case, and the seconds that a frame took in filter, extraction and association."""
    run = followed(built(case.info, filter_name, sets, preset), case, seed)
    return run.corrected, run.seconds


def built(info: SequenceInfo, filter_name: str, sets: Sequence[str] = (), preset: str = "") -> AnyStages:
    """The stages of a filter, with ``sets``, which may be settings that no other filter has."""
    return config.build(config.load(None, (f"filter.kind={filter_name}", *sets), preset), info)


def followed(stages: AnyStages, case: Case, seed: int) -> Run:
    """One run of the tracker over a case."""
    rng, spent, online = np.random.default_rng(seed), 0.0, []
    state = pipeline.start(stages, rng)
    for number in range(1, case.info.frames + 1):
        state, step = pipeline.advance(stages, state, case.table.at(number), number, (number - 1) / case.info.fps, rng)
        online.append(step.tracks)
        spent += sum(step.seconds)
    online.append(stages.associator.flush(state.association, stages.model))
    return Run(pipeline.finish(stages, state), Tracks.concatenate(online), spent / case.info.frames)


def measure(case: Case, filter_name: str, seed: int, sets: Sequence[str] = (), preset: str = "") -> Result:
    """Track and score a case."""
    tracks, seconds = track(case, filter_name, seed, sets, preset)
    delays = first_output_delays(case.truth, tracks, case.table).delay
    delay = float(np.nanmean(delays)) if np.isfinite(delays).any() else float("nan")
    return Result(evaluate(case.truth, tracks, frames=case.info.frames), delay, seconds)


@dataclass(frozen=True, slots=True)
class Kept(Generic[A, B]):
    """``work``, with the outcomes of jobs that were done before read from ``folder``.

    A job is known by the name of the work and its own representation: a record, or a tuple of numbers and words. The folder
    remembers the sources that it was begun with; `in_parallel` says when they are others now.
    """

    work: Callable[[A], B]
    folder: Path

    def __call__(self, job: A) -> B:
        """The outcome of a job, from its file where there is one."""
        name = f"{self.work.__module__}.{self.work.__qualname__}"
        path = self.folder / f"{name}-{hashlib.sha256(repr(job).encode()).hexdigest()[:16]}.pickle"
        if path.exists():
            outcome: B = pickle.loads(path.read_bytes())
            return outcome
        outcome = self.work(job)
        path.parent.mkdir(parents=True, exist_ok=True)
        # Whole or not at all: a run that is broken off leaves no half of a file.
        part = path.with_suffix(f".{os.getpid()}.part")
        part.write_bytes(pickle.dumps(outcome))
        part.replace(path)
        return outcome


def in_parallel(work: Callable[[A], B], jobs: Sequence[A], label: str, folder: Path | None = None) -> list[B]:
    """``work`` over ``jobs``, a process for each core; progress on stderr; outcomes are kept in ``folder`` if given."""
    if folder is not None:
        _say_if_older(folder)
    began = time.perf_counter()
    out = []
    with ProcessPoolExecutor(max_workers=os.cpu_count()) as pool:
        for done, result in enumerate(pool.map(Kept(work, folder) if folder else work, jobs), start=1):
            out.append(result)
            print(f"\r{label}: {done} of {len(jobs)}, {time.perf_counter() - began:.0f} s", end="", file=sys.stderr)
    print(file=sys.stderr)
    return out


def _say_if_older(folder: Path) -> None:
    """Warn that the outcomes in ``folder`` come of other sources of phdtrack than today's; a new folder is given today's."""
    note, now = folder / "sources", sources(("",))
    if not note.exists():
        folder.mkdir(parents=True, exist_ok=True)
        note.write_text(now, encoding="utf-8")
    elif note.read_text(encoding="utf-8") != now:
        print(f"{folder}: outcomes may be kept there of an earlier phdtrack; without it all are run again", file=sys.stderr)


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; floats with three digits."""
    lines = [" | ".join(header), " | ".join("---" for _ in header)]
    lines += [" | ".join(f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row) for row in rows]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def write(name: str, text: str, out: Path = RESULTS) -> Path:
    """Write a page of results to the folder ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / name
    path.write_text(text, encoding="utf-8")
    print(path, file=sys.stderr)
    return path
