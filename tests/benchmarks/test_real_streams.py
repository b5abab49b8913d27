"""Real detections of the benchmark of whole trackers, if the data lies beside the project."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import whole_tracker
from benchmarks.parts import QUICK, SMOKE

INFO = "[Sequence]\nname=S\nframeRate=30\nseqLength=400\nimWidth=640\nimHeight=480\n"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of data with one sequence, S, of 400 frames with two detections each."""
    folder = tmp_path / "more" / "S"
    (tmp_path / "mot15").mkdir()
    (folder / "det_d").mkdir(parents=True)
    (folder / "gt").mkdir()
    (folder / "seqinfo.ini").write_text(INFO)
    found = [f"{k},-1,{x},10,20,40,0.{x}" for x in (5, 9) for k in range(1, 401)]
    (folder / "det_d" / "det.txt").write_text("\n".join(found))
    truth = [f"{k},7,5,10,20,40,1,1,1" for k in range(1, 401)]
    (folder / "gt" / "gt.txt").write_text("\n".join(truth))
    monkeypatch.setenv("PHDTRACK_DATA", str(tmp_path))
    monkeypatch.setattr(whole_tracker, "REAL", (("S", "d"),))
    return tmp_path


def test_real_detections_are_cut_and_ordered_by_frame(place: Path) -> None:
    (name, stream), *rest = whole_tracker.real_streams(QUICK).items()
    assert (name, rest) == ("S d", [])
    assert (stream.info.frames, stream.info.fps, stream.info.width) == (300, 30.0, 640)
    assert len(stream.truth.frame) == 300
    assert stream.truth.frame.max() == 300
    np.testing.assert_array_equal(stream.table.frame, np.repeat(np.arange(1, 301), 2))
    first = stream.detections()[0]
    np.testing.assert_array_equal(first.xyxy, [[5, 10, 25, 50], [9, 10, 29, 50]])
    np.testing.assert_allclose(first.confidence, [0.5, 0.9])


def test_without_data_or_in_a_small_scale_there_are_none(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert whole_tracker.real_streams(SMOKE) == {}
    monkeypatch.setenv("PHDTRACK_DATA", str(place / "nothing"))
    assert whole_tracker.real_streams(QUICK) == {}


def test_the_fastest_peer_counts() -> None:
    def times(ms: float) -> dict[str, object]:
        return {"ms": {"median": ms}, "cpu_ms": 2 * ms}

    results = {"phdtrack": {"S": times(2.0)}, "a": {"S": times(5.0)}, "b": {"S": times(3.0)}}
    assert whole_tracker.fastest_ratio("S", results) == (1.5, 1.5)
