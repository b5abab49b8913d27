"""Written files can be read back, and every frame is on disk at once."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from phdtrack.errors import InputError
from phdtrack.formats import (
    DetectionsWriter,
    StatesWriter,
    TracksWriter,
    read_detections,
    read_tracks,
    read_truth,
    write_detections,
    write_tracks,
    write_truth,
)
from phdtrack.types import (
    F8,
    Detections,
    DetectionTable,
    Estimates,
    Step,
    Tracks,
    Truth,
    UpdateInfo,
)


def boxes(draw: st.DrawFn, n: int) -> F8:
    corner = draw(hnp.arrays(np.float64, (n, 2), elements=st.floats(-5000, 5000)))
    size = draw(hnp.arrays(np.float64, (n, 2), elements=st.floats(0.1, 3000)))
    return np.hstack([corner, corner + size])


@st.composite
def tracks(draw: st.DrawFn) -> Tracks:
    keys = sorted(draw(st.sets(st.tuples(st.integers(1, 9), st.integers(1, 99)), max_size=12)))
    n = len(keys)
    table = np.array(keys, dtype=np.int64).reshape(n, 2)
    return Tracks(
        table[:, 0],
        table[:, 1],
        boxes(draw, n),
        draw(hnp.arrays(np.float64, n, elements=st.floats(0, 1))),
        draw(hnp.arrays(np.int64, n, elements=st.integers(-1, 500))),
        draw(hnp.arrays(np.bool_, n)),
    )


@st.composite
def detection_tables(draw: st.DrawFn) -> DetectionTable:
    n = draw(st.integers(0, 12))
    frame = np.sort(draw(hnp.arrays(np.int64, n, elements=st.integers(1, 10**6))))
    root = draw(hnp.arrays(np.float64, (n, 4, 4), elements=st.floats(-20, 20)))
    found = Detections(
        boxes(draw, n),
        draw(hnp.arrays(np.float64, n, elements=st.floats(-500, 500))),
        draw(hnp.arrays(np.int64, n, elements=st.integers(-1, 90))),
        root @ root.transpose(0, 2, 1) if draw(st.booleans()) else None,
    )
    return DetectionTable(frame, found)


@given(tracks(), st.booleans())
def test_tracks_and_truth_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, original: Tracks, placed: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "tracks.csv"
    n = len(original)
    place = np.arange(2.0 * n).reshape(2, n) - 3
    place[1, ::3] = np.nan
    with TracksWriter(path) as file:
        file.append(original, place if placed else None)
    again = read_tracks(path)
    for name in ("frame", "identity", "detection", "confirmed"):
        np.testing.assert_array_equal(getattr(again, name), getattr(original, name))
    np.testing.assert_allclose(again.xyxy, original.xyxy, rtol=0, atol=2e-3)
    np.testing.assert_allclose(again.confidence, original.confidence, rtol=1e-6)
    columns = (
        np.array([line.split(",")[7:10] for line in path.read_text().splitlines()], np.float64)
        .reshape(-1, 3)
        .T
    )
    known = np.isfinite(place[1]) & placed
    np.testing.assert_array_equal(columns[:, known], np.vstack([place, np.zeros(n)])[:, known])
    np.testing.assert_array_equal(columns[:, ~known], -1)
    truth = Truth(original.frame, original.identity, original.xyxy, original.confirmed & placed)
    write_truth(path, truth)
    same = read_truth(path)
    for name in ("frame", "identity", "distractor"):
        np.testing.assert_array_equal(getattr(same, name), getattr(truth, name))
    np.testing.assert_allclose(same.xyxy, truth.xyxy, rtol=0, atol=2e-3)
    for more in ({"regions": np.zeros((1, 5))}, {"least_height": 25.0}):
        with pytest.raises(InputError, match="no regions to ignore and no least height"):
            write_truth(path, replace(truth, **more))


@given(detection_tables())
def test_detections_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, original: DetectionTable
) -> None:
    path = tmp_path_factory.getbasetemp() / "detections.csv"
    write_detections(path, original)
    again = read_detections(path)
    np.testing.assert_array_equal(again.frame, original.frame)
    a = again.detections
    b = original.detections
    np.testing.assert_allclose(a.xyxy, b.xyxy, rtol=0, atol=2e-6)
    np.testing.assert_allclose(a.confidence, b.confidence, rtol=1e-9)
    np.testing.assert_array_equal(a.class_id, b.class_id)
    if b.covariance is None or not len(b):
        assert a.covariance is None
    else:
        assert a.covariance is not None
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-9, atol=1e-12)


def one_row() -> Tracks:
    box = np.array([[1.5, 2.0, 11.25, 42.0]])
    arrays = np.array([3]), np.array([8]), box, np.array([1.25]), np.array([-1]), np.array([False])
    for array in arrays:
        array.setflags(write=False)  # nothing is written into them
    return Tracks(*arrays)


def test_invalid_covariance_is_refused(tmp_path: Path) -> None:
    good = "1,-1,0,0,5,5,1,-1,-1,-1,0,1,0,0,0,1,0,0,1,0,1\n"
    path = tmp_path / "d.csv"
    path.write_text(good)
    assert read_detections(path).detections.covariance is not None
    path.write_text(good + good.replace("0,1,0,0,0,1", "0,1,9,0,0,1"))
    with pytest.raises(InputError, match=r"d.csv, line 2: .*positive semidefinite"):
        read_detections(path)


def test_frames_are_on_disk_before_the_writer_is_closed(
    tmp_path: Path,
) -> None:
    found = Detections.of([[0, 0, 1, 1], [2, 2, 4, 4]], [0.5, -7])
    info = UpdateInfo.without_update(0.0)
    state = Estimates(
        np.arange(12.0).reshape(6, 2),
        np.zeros((2, 6, 6)),
        np.array([1, 0.5]),
        found.xyxy,
        np.array([0, -1]),
    )
    with (
        DetectionsWriter(tmp_path / "d.csv") as detections,
        TracksWriter(tmp_path / "new" / "t.csv") as written,
        StatesWriter(tmp_path / "s.csv") as states,
    ):
        for frame in (1, 2, 3):
            detections.append(frame, found if frame != 2 else Detections.empty())
            written.append(one_row() if frame == 1 else Tracks.empty())
            states.append(
                Step(
                    frame,
                    frame / 25,
                    found,
                    info,
                    state if frame != 2 else Estimates.empty(6),
                    Tracks.empty(),
                )
            )
        with pytest.raises(InputError, match="not complete"):
            read_detections(tmp_path / "d.csv.part")
        for name in ("d.csv", "new/t.csv", "s.csv"):
            assert not (tmp_path / name).exists()
            shutil.copy(tmp_path / f"{name}.part", tmp_path / name)
        assert read_detections(tmp_path / "d.csv").frame.tolist() == [1, 1, 3, 3]
        assert read_detections(tmp_path / "s.csv").frame.tolist() == [1, 1, 3, 3]
        assert (
            tmp_path / "new" / "t.csv"
        ).read_bytes() == b"3,8,1.5,2,9.75,40,1.25,-1,-1,-1,-1,0\n"
        assert (tmp_path / "s.csv").read_text().splitlines() == [
            "frame,time,weight,detection,left,top,width,height,s0,s1,s2,s3,s4,s5",
            "1,0.040000,1,0,0,0,1,1,0,2,4,6,8,10",
            "1,0.040000,0.5,-1,2,2,2,2,1,3,5,7,9,11",
            "3,0.120000,1,0,0,0,1,1,0,2,4,6,8,10",
            "3,0.120000,0.5,-1,2,2,2,2,1,3,5,7,9,11",
        ]
        (tmp_path / "s.csv").unlink()
        states.close()
        states.close()  # closing twice does no harm
    assert (tmp_path / "s.csv").read_text().count("\n") == 5
    assert not list(tmp_path.rglob("*.part"))


def test_unwritable_path_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file" / "t.csv", tmp_path):
        with pytest.raises(InputError, match="cannot be written") as caught:
            write_tracks(path, Tracks.empty())
        assert caught.value.where == str(path)
