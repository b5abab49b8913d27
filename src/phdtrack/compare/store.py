"""Where a comparison keeps what it has: a folder for each run and for each set of detections, whole or not there at all."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

import numpy as np

from phdtrack.metrics import Scores
from phdtrack.metrics import Settings as ScoreSettings
from phdtrack.metrics.scores import Counts, scores_of
from phdtrack.report.run_json import json_value, write_run

RUN = "run.json"
TRACKS = "tracks.csv"
DETECTIONS = "detections.csv"

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came of a run.

    Attributes
    ----------
    frames, detections, tracks, rows : numbers of them; detections with the added clutter.
    drawn : the method drew at random: another seed may give something else.
    seconds : the median over the frames of filter, extraction and association together; the first frames of a process
        load kernels and are no measure.
    counts : the sums behind the scores; None where there is no truth.
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
        return None if self.counts is None else scores_of(self.counts, ScoreSettings(self.iou))


@contextmanager
def whole(place: Path) -> Iterator[Path]:
    """A folder to write into, which takes the place of ``place`` when it is done; nothing is left of it where it is not."""
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


def write_about(folder: Path, digest: str, decided_by: Mapping[str, object], **more: object) -> None:
    """``run.json`` of a run or a set of detections."""
    write_run(folder / RUN, json_value({"digest": digest, **more, "decided_by": decided_by}))


def read_about(folder: Path) -> dict[str, Any]:
    """The same read back; empty where there is none that can be read."""
    try:
        document = json.loads((folder / RUN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


def kept(folder: Path, digest: str) -> Outcome | None:
    """The outcome that is kept there, if it is of this digest."""
    document = read_about(folder)
    if document.get("digest") != digest or not (folder / TRACKS).is_file():
        return None
    try:
        return _made(Outcome, document["outcome"])
    except (KeyError, TypeError, ValueError):
        return None


def _made(kind: type[T], values: Mapping[str, Any]) -> T:
    """A frozen record of plain values, arrays and such records, from what JSON made of it."""
    hints = get_type_hints(kind)
    out: dict[str, Any] = {}
    for entry in fields(kind):
        hint, value = hints[entry.name], values[entry.name]
        if hint == Counts | None:
            hint = Counts
        if value is not None and is_dataclass(hint) and isinstance(hint, type):
            value = _made(hint, value)
        out[entry.name] = np.array(value) if isinstance(value, list) else value
    return kind(**out)
