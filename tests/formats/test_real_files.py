"""The real sequences, against counting that knows nothing of the readers."""

from pathlib import Path

import numpy as np
import pytest

from phdtrack.formats import find_seqinfo, read_detections, read_tracks, read_truth

pytestmark = pytest.mark.data


def cells(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().split() if line]


def test_every_real_detection_file_is_read(data: Path) -> None:
    files = sorted(data.glob("mot15/*/det_*/det.txt"))
    assert len(files) == 9
    for path in files:
        table = read_detections(path)
        rows = cells(path)
        assert len(table) == len(rows)
        assert table.last == max(int(row[0]) for row in rows)
        assert table.detections.confidence.sum() == pytest.approx(
            sum(float(row[6]) for row in rows)
        )
        width = table.detections.xyxy[:, 2] - table.detections.xyxy[:, 0]
        assert width.sum() == pytest.approx(sum(float(row[4]) for row in rows))
        info = find_seqinfo(path)
        assert info is not None
        assert info.name == path.parent.parent.name
        assert 0 < table.last <= info.frames


def test_every_real_truth_file_is_read(data: Path) -> None:
    files = sorted(data.glob("mot15/*/gt/gt.txt"))
    assert len(files) == 5
    for path in files:
        truth = read_truth(path)
        rows = [row for row in cells(path) if row[6] != "0"]
        assert len(truth) == len(rows)
        assert set(truth.identity.tolist()) == {int(row[1]) for row in rows}
        assert (
            np.bincount(truth.frame).tolist() == np.bincount([int(row[0]) for row in rows]).tolist()
        )
        assert not truth.distractor.any()
        assert len(read_tracks(path)) == len(cells(path))


@pytest.mark.parametrize(
    ("name", "element", "frames", "people", "middle"),
    [
        ("pets2009/PETS2009-S1L1-1.xml", "<box ", 221, 46, 630.1302),
        ("caviar/cols1gt.xml", "<object ", 295, 6, None),
    ],
)
def test_real_cvml_files_are_read(
    data: Path, name: str, element: str, frames: int, people: int, middle: float | None
) -> None:
    path = data / name
    text = path.read_text()
    truth = read_truth(path)
    assert len(truth) == len(read_detections(path)) == text.count(element)
    assert truth.frame.max() == text.count("<frame ") == frames
    assert len(np.unique(truth.identity)) == people
    assert middle is None or truth.xyxy[0, [0, 2]].mean() == pytest.approx(middle)
