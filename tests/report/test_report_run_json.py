from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_runs import run_record, step

from phdtrack.errors import InputError
from phdtrack.files import json_value
from phdtrack.report import About, Recorder, run_document, sentences, write_run
from phdtrack.report.pages import counted, duration, grouped, percent
from phdtrack.types import SequenceInfo, Tracks

KEYS = """
command title summary versions seed started seconds source frames frames_per_second stages tracks
track_rows predicted_rows detection_rate detections expected_false_alarms expected_count_mean scores
warnings notes configuration frames_left_out
log_evidence_mean log_evidence doubtful_boxes
"""


def test_run_document_has_its_keys_and_values() -> None:
    about = About(
        "T",
        "c",
        5,
        "now",
        2.5,
        (("phdtrack", "1"),),
        (("MOTA", 0.5), ("GOSPA", float("nan"))),
        ("w",),
        ("n",),
    )
    document = run_document(run_record(9, 2, about=about), {"filter": {"name": "gm"}})
    assert list(document) == KEYS.split()
    assert document["scores"] == {"MOTA": 0.5, "GOSPA": None}
    assert document["versions"] == {"phdtrack": "1"}
    assert (document["frames"], document["tracks"], document["detections"]) == (9, 2, 18)
    assert (document["track_rows"], document["predicted_rows"]) == (18, 6)
    assert document["detection_rate"] == pytest.approx(12 / 18)
    assert document["frames_per_second"] == pytest.approx(100)
    stages = document["stages"]
    assert isinstance(stages, dict)
    assert list(stages) == ["detect", "filter", "extract", "associate"]
    assert stages["filter"] == pytest.approx({"mean": 4.0, "median": 4.0, "p95": 4.0, "share": 0.4})
    assert document["configuration"] == {"filter": {"name": "gm"}}
    assert document["source"] == {"name": "walk", "width": 160, "height": 120, "fps": 10.0}


def test_evidence_of_every_frame_is_kept() -> None:
    """Σ log(κ + C) − ∫ p_D D⁺; null where a filter does not say."""
    recorder = Recorder(SequenceInfo(160, 120, 10.0))
    for number, detected in ((1, 1.5), (2, np.nan), (3, 0.5)):
        one = step(number, np.array([[0, 0, 9, 9.0], [20, 20, 30, 40]]))
        info = replace(
            one.info, evidence=np.array([0.5, 2.0]), clutter=np.array([0.5, 1.0]), detected=detected
        )
        recorder.add(None, replace(one, info=info), 0.0)
    document = run_document(recorder.record(Tracks.empty(), About()), {})
    assert document["log_evidence"] == [
        pytest.approx(np.log(3) - 1.5),
        None,
        pytest.approx(np.log(3) - 0.5),
    ]
    assert document["log_evidence_mean"] == pytest.approx(np.log(3) - 1)


def test_an_empty_run_is_valid_json(tmp_path: Path) -> None:
    document = run_document(Recorder(SequenceInfo(0, 0, 0.0)).record(Tracks.empty(), About()), {})
    path = tmp_path / "deep" / "run.json"
    write_run(path, document)
    assert json.loads(path.read_text(encoding="utf-8")) == document
    assert document["frames_per_second"] is None
    assert document["stages"] == {}


def test_values_of_every_kind_become_json() -> None:
    value = {
        "array": np.array([1.0, np.inf]),
        "truth": np.True_,
        "tuple": (1, Path("x")),
        3: SequenceInfo(1, 2, np.nan),
    }
    info = {"width": 1, "height": 2, "fps": None, "frames": 0, "name": ""}
    info |= {"pixel_aspect": 1.0}
    assert json_value(value) == {"array": [1.0, None], "truth": True, "tuple": [1, "x"], "3": info}
    assert json_value(value)["truth"] is True


def test_unwritable_path_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"run\.json"):
        write_run(tmp_path / "file" / "run.json", {})


def test_numbers_are_formatted_for_people() -> None:
    assert grouped(1234567.4) == "1,234,567"
    assert (counted(1, "box", "boxes"), counted(2, "box", "boxes"), counted(0, "frame")) == (
        "1 box",
        "2 boxes",
        "0 frames",
    )
    assert (duration(8.24), duration(114), duration(7500)) == ("8.2 s", "1 min 54 s", "2 h 5 min")
    assert (percent(1, 3), percent(0.05), percent(0, 0), percent(0)) == (
        "33\u00a0%",
        "5.0\u00a0%",
        "–",
        "0\u00a0%",
    )
    for sentence in sentences(run_record(5)):
        sentence.encode("cp1252")  # legacy terminals can print it
