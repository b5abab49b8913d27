"""Where a comparison keeps what it has, and what decides whether it still holds.

There is a folder for each run and for each set of detections, whole or not there at all. Its ``run.json`` has a digest of
everything that decides the result: settings, seed, files by their contents, phdtrack by its version and its sources.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

import phdtrack
from phdtrack.compare.plans import Case, DetectorRun, Run
from phdtrack.metrics import Scores
from phdtrack.metrics.counts import Counts
from phdtrack.metrics.scores import scores_of
from phdtrack.report.words import json_value, write_run
from phdtrack.video.sources import SUFFIXES

RUN = "run.json"
TRACKS = "tracks.csv"
DETECTIONS = "detections.csv"
# Sources on which no track and no score depends, but for the runs themselves; and those on which detections depend.
_RUNS = "compare/runs.py"
_NO_RESULT = ("cli", "label", "report", "compare", "detect", "video", "groups", "tracker.py", "__main__.py")
_DETECTING = ("detect", "video", "formats", _RUNS)
# Sections of the settings on which no track depends; the detector's are among what decides the detections.
_NO_TRACK = ("detector", "groups", "contours", "life_cycle", "encounters")


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


@contextmanager
def whole(place: Path) -> Iterator[Path]:
    """A folder to write into, which takes the place of ``place`` when it is done and vanishes where that fails."""
    part = place.with_name(f".{place.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        yield part
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    shutil.rmtree(place, ignore_errors=True)
    part.rename(place)


def write_about(folder: Path, decided_by: Mapping[str, object], **more: object) -> None:
    """Write ``run.json`` of a run or a set of detections: its digest, ``more``, and what decided it."""
    write_run(folder / RUN, json_value({"digest": digest(decided_by), **more, "decided_by": decided_by}))


def read_about(folder: Path) -> dict[str, Any]:
    """The same read back; empty where it cannot be read."""
    try:
        document = json.loads((folder / RUN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


def kept(folder: Path, decided_by: Mapping[str, object]) -> RunResult | None:
    """The result that is kept there, if it was decided by the same."""
    document = read_about(folder)
    if document.get("digest") != digest(decided_by) or not (folder / TRACKS).is_file():
        return None
    try:
        outcome = dict(document["outcome"])
        counts = outcome.pop("counts")
        return RunResult(**outcome, counts=None if counts is None else _record(Counts, counts))
    except (KeyError, TypeError, ValueError):
        return None


def digest(value: Mapping[str, object]) -> str:
    """32 hexadecimal digits for plain values."""
    text = json.dumps(json_value(value), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()[:32]


def contents(path: Path) -> str:
    """The digest of a file's contents; a folder stands for the images in it. A file is read again when its time changes."""
    if path.is_file():
        return _contents(path, path.stat().st_mtime_ns)
    return _digest_of(sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES))


@lru_cache(maxsize=4096)
def _contents(path: Path, changed: int) -> str:
    return _digest_of([path])


def decides_run(run: Run, detections: str, iou: float) -> dict[str, object]:
    """What decides the result of a run.

    Parameters
    ----------
    run : the run.
    detections : digest of what decides its detections.
    iou : overlap from which boxes match.

    Returns
    -------
    Plain values by name.
    """
    cell, case = run.cell, run.cell.case
    settings = {name: value for name, value in cell.method.settings.as_dict().items() if name not in _NO_TRACK}
    truth = case.sequence.truth
    return {
        "phdtrack": phdtrack.__version__,
        "sources": sources(_tracking_sources()),
        "sequence": asdict(case.info) | {"name": case.sequence.name},
        "detections": detections,
        "truth": "" if truth is None else contents(truth),
        "clutter": cell.rate,
        "seed": run.seed,
        "iou": iou,
        "settings": settings,
        "files": {name: contents(Path(name)) for name in _files(settings)},
    }


def decides_detections(case: Case) -> dict[str, object]:
    """What decides the detections of a case."""
    given = case.detections
    if not isinstance(given, DetectorRun):
        return {"file": contents(given.file)}
    return {
        "phdtrack": phdtrack.__version__,
        "sources": sources(_DETECTING),
        "video": contents(Path(case.sequence.source)),
        "detector": given.name,
        "parameters": dict(given.parameters),
        "max_width": given.max_width,
    }


def changed(before: Mapping[str, object], now: Mapping[str, object]) -> list[str]:
    """The names of what decides a run and is not as it was; ``before`` as JSON has it."""
    return [name for name, value in json_value(now).items() if before.get(name) != value]


@lru_cache(maxsize=4)
def sources(parts: tuple[str, ...]) -> str:
    """The digest of these files and folders of phdtrack's sources."""
    home = Path(phdtrack.__file__).parent
    return _digest_of(
        file for part in parts for file in (sorted((home / part).rglob("*.py")) if (home / part).is_dir() else [home / part])
    )


def _tracking_sources() -> tuple[str, ...]:
    home = Path(phdtrack.__file__).parent
    found = (path.name for path in home.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file())
    return (*sorted(name for name in found if name not in _NO_RESULT), _RUNS)


def _digest_of(files: Iterable[Path]) -> str:
    total = hashlib.sha256()
    for file in files:
        total.update(file.name.encode("utf-8", "surrogateescape") + b"\0")
        with file.open("rb") as content:
            total.update(hashlib.file_digest(content, "sha256").digest())
    return total.hexdigest()[:32]


def _files(value: object) -> list[str]:
    """The settings that name files, as a camera or a learned scene."""
    if isinstance(value, Mapping):
        return [name for part in value.values() for name in _files(part)]
    return [value] if isinstance(value, str) and value and Path(value).is_file() else []


def _record(kind: type[Any], values: Mapping[str, Any]) -> Any:
    """A record of numbers, arrays and such records, from what JSON made of it."""
    hints = get_type_hints(kind)
    made = {name: _record(hints[name], value) if isinstance(value, dict) else value for name, value in values.items()}
    return kind(**{name: np.array(value) if isinstance(value, list) else value for name, value in made.items()})
