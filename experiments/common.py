"""Shared parts of the experiments: options, sequences, one run of the tracker, parallel work,
Markdown tables and pages.

An experiment is a module with ``main(options) -> Path``: it measures, writes its page (and
pictures) to ``options.out`` and returns the page. A page is a template, ``pages/NAME.md``, into
which figures and tables are filled.
"""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from experiments import made
from experiments.claims import Claim, claims_table, claims_text
from experiments.delays import first_output_delays
from phdtrack import config, pipeline
from phdtrack.compare.statistics import Interval
from phdtrack.detect import make_detector
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_seqinfo, read_truth
from phdtrack.metrics import Scores, evaluate
from phdtrack.models import BoxClutter, MeasurementBirth
from phdtrack.models.scene import SceneBirth, SceneClutter, in_one_volume
from phdtrack.protocols import AnyStages, Model
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects
from phdtrack.types import F8, Detections, DetectionTable, Frame, SequenceInfo, Tracks, Truth

ROOT = Path(__file__).resolve().parents[1]
# `make peers` makes it.
PEERS_PYTHON = ROOT / ".venv-peers" / "bin" / "python"
# Of the peers with appearance: made by hand, `python -m venv .venv-boxmot`, with `boxmot` 25.0.0
# and torch from pip.
BOXMOT_PYTHON = ROOT / ".venv-boxmot" / "bin" / "python"
RESULTS = ROOT / "docs" / "results"
QUICK_RESULTS = ROOT / "runs" / "experiments-quick"
PAGES = Path(__file__).parent / "pages"
# Seconds between progress lines if stderr is not a terminal.
QUIET = 10.0
# The first line of the page of a short form, and the line above each part of a page.
_NO_RESULTS = (
    "*The short form of an experiment: everything ran, but these figures are no results.*\n\n"
)
_PART = "<!-- part: {} -->"

A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True, slots=True)
class Options:
    """Options of an experiment.

    Attributes
    ----------
    runs : Monte Carlo runs (seeds) of each case; 0: the experiment's own number. Ignored by
        experiments without randomness.
    quick : a short form that shows that everything works; its figures are not results.
    out : folder for pages and pictures; None: docs/results, in the short form
        runs/experiments-quick.
    jobs : number of processes; 0: one for each core.
    name : of the experiment, which may have pages of other names.
    seed : of cases that are drawn at random; None: the experiment's own. Ignored by experiments
        that draw none.
    only : parts of the page to make; none: all. For experiments whose page has parts.

    The folder of the real sequences comes from the environment (`need_data`), because worker
    processes need it too.
    """

    runs: int = 0
    quick: bool = False
    out: Path | None = None
    jobs: int = 0
    name: str = ""
    seed: int | None = None
    only: tuple[str, ...] = ()

    def parts(self, known: Iterable[str], long: Sequence[str] = ()) -> list[str]:
        """The parts to make, in the order of ``known``: those that were asked for, else all but the
        ``long`` ones. Raises `InputError` for others.
        """
        names = [*known]
        for name in self.only:
            if name not in names:
                raise InputError(
                    f"expected one of {', '.join(names)}, got {name!r}", where=f"{self.name} --only"
                )
        return [name for name in names if name in self.only or not (self.only or name in long)]

    def number(self, usual: int, quick: int) -> int:
        """Number of runs: the requested one, else ``quick`` in the short form and ``usual`` in the
        full one.
        """
        return self.runs or (quick if self.quick else usual)

    @property
    def folder(self) -> Path:
        """The folder for pages and pictures, created if missing."""
        folder = self.out or (QUICK_RESULTS if self.quick else RESULTS)
        folder.mkdir(parents=True, exist_ok=True)
        return folder


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A sequence with truth and one set of detections."""

    name: str
    info: SequenceInfo
    truth: Truth
    table: DetectionTable


@dataclass(frozen=True, slots=True, eq=False)
class TrackedCase:
    """Corrected tracks, online rows, and the seconds per frame of filter, extraction and
    association.
    """

    corrected: Tracks
    online: Tracks
    stages: tuple[float, float, float]

    @property
    def seconds(self) -> float:
        """Seconds per frame in all stages."""
        return sum(self.stages)


@dataclass(frozen=True, slots=True, eq=False)
class ScoredCase:
    """Scores of the corrected tracks, mean delay of the first output in frames, and seconds per
    frame as in `TrackedCase`.
    """

    scores: Scores
    delay: float
    stages: tuple[float, float, float]

    @property
    def seconds_per_frame(self) -> float:
        """Seconds per frame in all stages."""
        return sum(self.stages)


def data_place() -> Path:
    """The folder of the real sequences: $PHDTRACK_DATA or ../shared/data."""
    return Path(os.environ.get("PHDTRACK_DATA", ROOT.parent / "shared" / "data"))


def need_data() -> Path:
    """The folder of real sequences, $PHDTRACK_DATA or ../shared/data; `InputError` if it is
    missing.
    """
    data = data_place()
    if not (data / "mot15").is_dir():
        raise InputError(
            "the real sequences are missing",
            where=data,
            cure="Set PHDTRACK_DATA to the folder that holds mot15/",
        )
    return data


def mot15(sequence: str, kind: str) -> Case:
    """A MOT15 sequence with its ``public`` or ``frcnn`` detections."""
    folder = need_data() / "mot15" / sequence
    table = read_detections(folder / f"det_{kind}" / "det.txt")
    return Case(
        f"{sequence} {kind}", read_seqinfo(folder), read_truth(folder / "gt" / "gt.txt"), table
    )


def detections_in(frames: Iterable[Frame], detector_name: str = "change") -> DetectionTable:
    """The detections of a detector with default settings in the frames of a video."""
    detector = make_detector(detector_name)
    found = [(frame.number, detector(frame)) for frame in frames]
    number = np.repeat([n for n, _ in found], [len(boxes) for _, boxes in found])
    boxes = np.concatenate([np.zeros((0, 4)), *(one.xyxy for _, one in found)])
    return DetectionTable(
        number,
        Detections.of(boxes, np.concatenate([np.zeros(0), *(o.confidence for _, o in found)])),
    )


def built(
    info: SequenceInfo, filter_name: str, sets: Sequence[str] = (), preset: str = ""
) -> AnyStages:
    """The stages of a filter with the settings ``sets``, some of which only this filter may
    have.
    """
    return config.build(config.load(None, (f"filter.kind={filter_name}", *sets), preset), info)


def followed(stages: AnyStages, case: Case, seed: int) -> TrackedCase:
    """One run of the tracker over a case."""
    rng = np.random.default_rng(seed)
    spent = np.zeros(3)
    online = []
    state = pipeline.start(stages, rng)
    for number in range(1, case.info.frames + 1):
        state, step = pipeline.advance(
            stages, state, case.table.at(number), number, (number - 1) / case.info.fps, rng
        )
        online.append(step.tracks)
        spent += step.seconds
    online.append(pipeline.flush(stages, state))
    a, b, c = (spent / case.info.frames).tolist()
    return TrackedCase(pipeline.finish(stages, state), Tracks.concatenate(online), (a, b, c))


def measure(
    case: Case, filter_name: str, seed: int, sets: Sequence[str] = (), preset: str = ""
) -> ScoredCase:
    """Track a case with a filter, changed settings and a preset; return the scores of its corrected
    tracks.
    """
    run = followed(built(case.info, filter_name, sets, preset), case, seed)
    delays = first_output_delays(case.truth, run.corrected, case.table).delay
    delay = float(np.nanmean(delays)) if np.isfinite(delays).any() else float("nan")
    return ScoredCase(
        evaluate(case.truth, run.corrected, frames=case.info.frames), delay, run.stages
    )


def uniform_density(low: F8, high: F8) -> SceneDensity:
    """A learned density that is uniform."""
    d = len(low)
    return SceneDensity(low, high, 1.0, np.zeros(0), np.zeros((d, 0)), np.zeros((0, d, d)))


def with_scene(
    model: Model,
    births: LearnedDensity | None,
    clutter: LearnedDensity | None,
    followed: TrackedObjects | None,
    particles: int,
) -> Model:
    """The model with learned births and false alarms, added to its own if those are the same at
    every scale.

    A part that is None stays unchanged; ``particles`` is Jmax.
    """
    birth = model.birth
    false = model.clutter
    if births is not None:
        own = birth.births_per_detection if isinstance(birth, MeasurementBirth) else 0.0
        rate = births.rate * model.rate
        among = None if followed is None else followed.objects.density
        birth = SceneBirth(
            rate, births.density, particles=particles, births_per_detection=own, among=among
        )
    if clutter is not None:
        own = false.clutter_per_detection if isinstance(false, BoxClutter) else 0.0
        false = SceneClutter(clutter.rate, clutter.density, own)
    birth, false = in_one_volume(birth, false)
    return replace(model, birth=birth, clutter=false)


def in_parallel(work: Callable[[A], B], jobs: Sequence[A], label: str, options: Options) -> list[B]:
    """Run ``work`` on ``jobs`` in worker processes; results in the order of the jobs, progress on
    stderr. A short form runs in this process unless a number of processes is given: loading the
    kernels in each would take longer than the runs.

    On a terminal the progress is one line that is updated, elsewhere a line now and then.
    """
    if options.quick and not options.jobs:
        _say(f"{label}: {len(jobs)} runs")
        return [work(job) for job in jobs]
    processes = min(options.jobs or os.cpu_count() or 1, max(len(jobs), 1))
    _say(f"{label}: {len(jobs)} runs, {processes} at a time")
    began = last_line = time.perf_counter()
    terminal = sys.stderr.isatty()
    # Fresh processes: a copy of this one would wait for OpenCV's threads, which are not copied.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context) as pool:
        futures = [pool.submit(_noted, work, job) for job in jobs]
        for done, future in enumerate(as_completed(futures), start=1):
            if future.exception() is not None:
                pool.shutdown(cancel_futures=True)
                future.result()
            now = time.perf_counter()
            last = done == len(jobs)
            if terminal or last or now - last_line > QUIET:
                _say(
                    f"{label}: {done} of {len(jobs)}, {now - began:.0f} s",
                    changing=terminal,
                    last=last,
                )
                last_line = now
    results = [future.result() for future in futures]
    _LOADED.update(*(modules for _, modules in results))
    return [result for result, _ in results]


# Modules that worker processes have loaded.
_LOADED: set[str] = set()


def _noted(work: Callable[[A], B], job: A) -> tuple[B, set[str]]:
    """The result of a job, and the modules that it loaded."""
    return work(job), made.loaded()


def _say(text: str, *, changing: bool = False, last: bool = True) -> None:
    print(
        f"\r{text}" if changing else text,
        end="\n" if last or not changing else "",
        file=sys.stderr,
        flush=True,
    )


def phdtrack(*arguments: str) -> str:
    """The output of the command line with these arguments. Raises RuntimeError with its message if
    it fails.
    """
    command = [sys.executable, "-m", "phdtrack", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr}")
    return done.stdout


def run_peers(
    name: str, arguments: Sequence[object], jobs: int, python: Path | None = None
) -> None:
    """Run the module experiments.NAME_peers in the environment of the peers, or by another
    ``python``; ``jobs`` as in `Options`. Raises `InputError` if the environment is missing.
    """
    usual = python is None
    python = python or PEERS_PYTHON
    if not python.is_file():
        raise InputError(
            "the peers' scores for this are not kept, so that the peers have to run, and their"
            " environment is missing",
            where=python,
            cure="Say make peers" if usual else f"experiments.{name}_peers says how",
        )
    print(f"{name}: the peers run in their environment", file=sys.stderr, flush=True)
    words = [python, "-m", f"experiments.{name}_peers", *arguments]
    if jobs:
        words += ["--jobs", jobs]
    subprocess.run([str(word) for word in words], cwd=ROOT, check=True)


@contextmanager
def without_warnings() -> Iterator[None]:
    """Mutes the tracker's warnings: those of hundreds of streams say nothing of an experiment."""
    logger = logging.getLogger("phdtrack")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; floats with three digits."""
    lines = [" | ".join(header), " | ".join("---" for _ in header)]
    lines += [
        " | ".join(f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row)
        for row in rows
    ]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def with_interval(value: Interval, digits: int = 3, sign: str = "") -> str:
    """A cell: a mean with half its interval, unless that rounds to 0."""
    mean = f"{value.mean:{sign}.{digits}f}"
    return (
        mean
        if not math.isfinite(value.half) or value.half < 0.5 * 10**-digits
        else f"{mean} ± {value.half:.{digits}f}"
    )


def with_error(values: Sequence[float], digits: int = 3, sign: str = "") -> str:
    """A cell: mean ± standard error; a single value without an error."""
    mean = f"{np.mean(values):{sign}.{digits}f}"
    return (
        mean
        if len(values) < 2
        else f"{mean} ± {np.std(values, ddof=1) / math.sqrt(len(values)):.{digits}f}"
    )


def filled(template: str, **values: object) -> str:
    """The template ``pages/NAME.md`` with its placeholders filled."""
    return (PAGES / f"{template}.md").read_text(encoding="utf-8").format(**values)


def write(name: str, options: Options, claims: Sequence[Claim] = (), **values: object) -> Path:
    """Fill the template of a page, write it with its provenance, and print its path; ``claims`` of
    a paper stand on the page as a table, and are printed.

    The page of a short form states that it is not a result.
    """
    if claims:
        values["claims"] = claims_table(claims)
    text = filled(name, **values)
    if options.quick:
        text = _NO_RESULTS + text
    runs = f" --runs {options.runs}" if options.runs else ""
    seed = "" if options.seed is None else f" --seed {options.seed}"
    command = f"python -m experiments {options.name or name}{runs}{seed}"
    text += made.record(options.folder, name, command, made.loaded() | _LOADED)
    path = options.folder / f"{name}.md"
    path.write_text(text, encoding="utf-8")
    if claims:
        print(claims_text(claims), flush=True)
    _say(f"{path} is written")
    return path


def write_parts(
    name: str,
    options: Options,
    order: Iterable[str],
    parts: Mapping[str, str],
    claims: Sequence[Claim] = (),
) -> Path:
    """Put new ``parts`` into a page, keep the others that it has, each with its own provenance, and
    print its path, and the ``claims`` of a paper. The page begins with its template.

    The page of a short form has the new ones and those of earlier short forms.
    """
    path = options.folder / f"{name}.md"
    old = path.read_text(encoding="utf-8") if path.is_file() else ""
    kept = dict(zip(*_parted(old), strict=True))
    for part, text in parts.items():
        command = f"python -m experiments {name} --only {part}"
        command += f" --runs {options.runs}" if options.runs else ""
        kept[part] = text + made.record_part(
            options.folder, name, part, command, made.loaded() | _LOADED
        )
    text = filled(name)
    if options.quick:
        text = _NO_RESULTS + text
    for part in order:
        if part in kept:
            text += f"\n{_PART.format(part)}\n\n{kept[part].strip()}\n"
    path.write_text(text, encoding="utf-8")
    if claims:
        print(claims_text(claims), flush=True)
    _say(f"{path} is written")
    return path


def _parted(text: str) -> tuple[list[str], list[str]]:
    """The names of the parts of a page of `write_parts`, and their texts."""
    pieces = re.split(_PART.format(r"(\w+)"), text)
    return pieces[1::2], pieces[2::2]


def pyplot() -> Any:
    """Matplotlib's plotting module, drawing to files."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    return plt
