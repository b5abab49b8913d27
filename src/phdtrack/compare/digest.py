"""What decides a run, as plain values and as one digest of them: as long as it stays the same, so does the result.

Files count by what is in them, phdtrack by its version and by the sources of those parts that tracks and scores come from.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

import phdtrack
from phdtrack import __version__
from phdtrack.compare.records import Case, Detecting, Run
from phdtrack.report.run_json import json_value
from phdtrack.video.sources import SUFFIXES

# Of this package, what makes detections, clutter, tracks and scores.
_WORK = "compare/work.py"
# Parts of phdtrack that no track and no score comes from, beside that.
_ASIDE = (
    *("commands", "report", "reproduce", "web", "compare", "detect", "video", "groups", "grouped.py", "tracker.py"),
    *("statedict.py", "overlap.py", "rundir.py", "compiling.py", "doctor.py", "cli.py", "__main__.py"),
)
# What detections come from, and what writes them down.
_DETECTING = ("detect", "video", "formats", "detections.py", _WORK)
# Sections of the settings that no track depends on; the detector's are in what was detected.
_ELSEWHERE = ("detector", "groups", "contours", "lives", "meetings")
_LUMP = 1 << 20


def digest(value: Mapping[str, object]) -> str:
    """32 hexadecimal digits for plain values."""
    text = json.dumps(json_value(value), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()[:32]


class Contents:
    """Digests of files by their contents; each file is read once. A folder stands for the images in it."""

    def __init__(self) -> None:
        self._known: dict[Path, str] = {}

    def __call__(self, path: Path) -> str:
        """The digest of what is at ``path`` now."""
        if path not in self._known:
            self._known[path] = _digest_of([path] if path.is_file() else _images(path))
        return self._known[path]


def decides_run(run: Run, detected: str, iou: float, contents: Contents) -> dict[str, object]:
    """What decides the outcome of a run; ``detected`` is the digest of its detections."""
    cell, case = run.cell, run.cell.case
    settings = {name: value for name, value in cell.method.settings.as_dict().items() if name not in _ELSEWHERE}
    truth = case.footage.truth
    return {
        "phdtrack": __version__,
        "sources": sources(_parts()),
        "sequence": asdict(case.info) | {"name": case.footage.name},
        "detections": detected,
        "truth": "" if truth is None else contents(truth),
        "clutter": cell.rate,
        "seed": run.seed,
        "iou": iou,
        "settings": settings,
        "files": {name: contents(Path(name)) for name in _files(settings)},
    }


def decides_detections(case: Case, contents: Contents) -> dict[str, object]:
    """What decides the detections of a case."""
    seen = case.seen
    if not isinstance(seen, Detecting):
        return {"file": contents(seen.file)}
    return {
        "phdtrack": __version__,
        "sources": sources(_DETECTING),
        "video": contents(Path(case.footage.source)),
        "detector": seen.name,
        "parameters": dict(seen.parameters),
        "max_width": seen.max_width,
    }


@lru_cache(maxsize=4)
def sources(parts: tuple[str, ...]) -> str:
    """The digest of these parts of phdtrack's own sources."""
    home = Path(phdtrack.__file__).parent
    files = [
        file for part in parts for file in sorted((home / part).rglob("*.py") if (home / part).is_dir() else [home / part])
    ]
    return _digest_of(files)


def _parts() -> tuple[str, ...]:
    home = Path(phdtrack.__file__).parent
    found = (path.name for path in home.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file())
    return (*sorted(name for name in found if name not in _ASIDE), _WORK)


def changed(before: Mapping[str, object], now: Mapping[str, object]) -> list[str]:
    """The names of what decides a run and is not as it was; ``before`` as JSON has it."""
    return [name for name, value in json_value(now).items() if before.get(name) != value]


def _digest_of(files: Iterable[Path]) -> str:
    total = hashlib.sha256()
    for file in files:
        total.update(file.name.encode("utf-8", "surrogateescape") + b"\0")
        with file.open("rb") as content:
            while lump := content.read(_LUMP):
                total.update(lump)
    return total.hexdigest()[:32]


def _images(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES)


def _files(value: object) -> list[str]:
    """The settings that name files, as a camera or a learned scene."""
    if isinstance(value, Mapping):
        return [name for part in value.values() for name in _files(part)]
    return [value] if isinstance(value, str) and value and Path(value).is_file() else []
