"""``run.json``: what was run, with what, how fast and how well, for programs.

The document is plain JSON: values that are not numbers (NaN, infinity) become null, arrays lists, paths strings. Keys keep
their names and order; new ones are added at the end.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.report.record import RunRecord, sentences


def run_document(record: RunRecord, config: Mapping[str, object]) -> dict[str, object]:
    """The run as JSON values: ``config`` is the whole configuration as nested mappings.

    Times are seconds. ``frames_per_second`` is that of detection and tracking, without drawing and without the
    ``frames_left_out`` in which kernels were compiled or loaded; ``stages`` are milliseconds per frame, whose sum may
    exceed a frame's share of the time because stages overlap. ``chain`` is null but for MCMC filters.
    """
    about, series, info = record.about, record.series, record.info
    document = {
        "command": about.command,
        "title": about.title,
        "summary": list(sentences(record)),
        "versions": dict(about.versions),
        "seed": about.seed,
        "started": about.started,
        "seconds": about.seconds,
        "source": {"name": info.name, "width": info.width, "height": info.height, "fps": info.fps},
        "frames": len(series),
        "frames_per_second": record.frames_per_second,
        "stages": {
            s.name: {"mean": s.mean, "median": s.median, "p95": s.high, "share": s.share} for s in record.stage_times[:-1]
        },
        "tracks": record.n_objects,
        "track_rows": len(record.tracks),
        "predicted_rows": int(record.tracks.predicted.sum()),
        "detections": int(series.n_detections.sum()),
        "expected_false_alarms": record.false_alarms,
        "expected_count_mean": float(series.mass.mean()) if len(series) else math.nan,
        "scores": dict(about.scores),
        "warnings": list(about.warnings),
        "notes": list(about.notes),
        "configuration": config,
        "frames_left_out": about.left_out,
        "chain": record.chain,
    }
    return {key: json_value(value) for key, value in document.items()}


def write_run(path: Path, document: Mapping[str, object]) -> None:
    """Write the document as indented UTF-8. Raises `InputError` where the file cannot be written."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 and make the folder. Raises `InputError` where that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # File names may hold bytes that are no text; their escape is also how JSON spells them.
        path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
    except OSError as error:
        raise InputError(
            f"could not be written: {error.strerror or error}", where=path, cure="Choose another output folder."
        ) from error


def json_value(value: object) -> Any:
    """``value`` in the types that JSON knows; NaN and infinity become None, what is unknown its text."""
    match value:
        case None | bool() | str() | int():
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case np.generic():
            return json_value(value.item())
        case np.ndarray():
            return json_value(value.tolist())
        case Mapping():
            return {str(k): json_value(v) for k, v in value.items()}
        case list() | tuple() | set() | frozenset():
            return [json_value(v) for v in value]
        case _ if is_dataclass(value) and not isinstance(value, type):
            return {f.name: json_value(getattr(value, f.name)) for f in fields(value)}
        case _:
            return str(value)


def flattened(config: Mapping[str, object], prefix: str = "") -> tuple[tuple[str, str], ...]:
    """Pairs (dotted name, text) of a nested configuration, in its order: the form that ``--set`` takes."""
    pairs: list[tuple[str, str]] = []
    for key, value in config.items():
        if isinstance(value, Mapping):
            pairs += flattened(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", json.dumps(json_value(value), ensure_ascii=False)))
    return tuple(pairs)
