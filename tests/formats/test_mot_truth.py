"""Truth and tracks of MOTChallenge, and the benchmark's rule about classes against its own
evaluation code.
"""

import importlib
from pathlib import Path

import numpy as np
import pytest
from format_cases import put, refused

from phdtrack.errors import InputError
from phdtrack.formats import read_tracks, read_truth


def test_mot15_skips_rows_of_confidence_zero(tmp_path: Path) -> None:
    truth = read_truth(
        put(tmp_path, "1,1,0,0,5,5,1,-1,-1,-1\n1,2,9,9,5,5,0,-1,-1,-1\n2,2,9,9,5,5,1,1.5,2.5,0\n")
    )
    assert (truth.frame.tolist(), truth.identity.tolist(), truth.distractor.any()) == (
        [1, 2],
        [1, 2],
        False,
    )
    assert len(read_truth(put(tmp_path, "1 1 0 0 5 5\n1 2 9 9 5 5\n"))) == 2


def test_a_header_may_mark_distractors(tmp_path: Path) -> None:
    rows = "frame,id,x1,y1,x2,y2,ignore,conf\n1,1,0,0,5,5,1,0\n1,2,0,0,5,5,0,1\n2,2,0,0,5,5,0,0\n"
    truth = read_truth(put(tmp_path, rows))
    assert truth.frame.tolist() == [1, 1]
    assert truth.distractor.tolist() == [True, False]
    with pytest.raises(InputError, match=r"line 2: expected 0 or 1 for distractor, got 2"):
        read_truth(put(tmp_path, "frame,id,x1,y1,x2,y2,distractor\n1,1,0,0,5,5,2\n"))


def test_repeated_identity_in_a_frame_is_refused(tmp_path: Path) -> None:
    path = put(tmp_path, "2,7,0,0,5,5\n1,7,0,0,5,5\n\n2,7,9,9,5,5\n")
    for reader in (read_truth, read_tracks):
        with pytest.raises(
            InputError,
            match=r"line 4: identity 7 is in frame 2 \(counted from 1\) already, in line 1",
        ):
            reader(path)


def test_class_outside_the_benchmark_is_refused(tmp_path: Path) -> None:
    rows = "1,1,0,0,5,5,1,1,1\n1,2,0,0,5,5,1,14,1\n"
    path = put(tmp_path, rows, "MOT17-02/gt/gt.txt")
    refused(
        read_truth, path, ", line 2", "expected a whole number from 1 to 13 for the class, got 14"
    )
    nine_without_classes = "1,1,0,0,5,5,1,-1,-1\n1,2,9,9,5,5,0,-1,-1\n"
    assert read_truth(put(tmp_path, nine_without_classes)).identity.tolist() == [1]


def test_distractor_classes_of_mot16_and_mot20(tmp_path: Path) -> None:
    rows = "1,1,0,0,5,5,1,1,1\n1,2,0,0,5,5,0,6,1\n1,3,0,0,5,5,0,7,1\n1,4,0,0,5,5,0,3,1\n"
    assert read_truth(put(tmp_path, rows)).identity.tolist() == [1, 3]
    assert read_truth(put(tmp_path, rows, "MOT20-01/gt/gt.txt")).identity.tolist() == [1, 2, 3]


@pytest.mark.parametrize("benchmark", ["MOT16", "MOT20"])
@pytest.mark.filterwarnings("ignore")
def test_scored_classes_agree_with_trackeval(
    tmp_path: Path, benchmark: str, rng: np.random.Generator
) -> None:
    """Every class with either flag, in boxes that do not touch."""
    trackeval = importlib.import_module("trackeval")
    cases = [(frame, i) for frame in (1, 2, 3) for i in range(26)]
    rows = [
        (k, i + 1, 100.0 * i + rng.integers(0, 20), 50.0, 40, 80, i % 2, i // 2 + 1)
        for k, i in cases
    ]
    name = f"{benchmark}-99"
    truth_file = put(
        tmp_path,
        "".join("{},{},{},{},{},{},{},{},1\n".format(*row) for row in rows),
        f"gt/{name}/gt/gt.txt",
    )
    output = "".join("{},{},{},{},{},{},1,-1,-1,-1\n".format(*row[:6]) for row in rows)
    put(tmp_path, output, f"trackers/ours/data/{name}.txt")
    dataset = trackeval.datasets.MotChallenge2DBox(
        {
            "GT_FOLDER": str(tmp_path / "gt"),
            "TRACKERS_FOLDER": str(tmp_path / "trackers"),
            "BENCHMARK": benchmark,
        }
        | {"SEQ_INFO": {name: 3}, "SKIP_SPLIT_FOL": True, "PRINT_CONFIG": False}
    )
    data = dataset.get_preprocessed_seq_data(dataset.get_raw_seq_data("ours", name), "pedestrian")
    ours = read_truth(truth_file)
    for frame in (1, 2, 3):
        scored, ignored = (
            set(ours.xyxy[(ours.frame == frame) & (ours.distractor == distractor), 0])
            for distractor in (False, True)
        )
        assert set(data["gt_dets"][frame - 1][:, 0]) == scored
        assert {row[2] for row in rows if row[0] == frame} - set(
            data["tracker_dets"][frame - 1][:, 0]
        ) == ignored
    assert ours.distractor.sum() == 3 * 2 * (5 if benchmark == "MOT20" else 4)


@pytest.mark.parametrize(
    "text",
    [
        "1,1,0,0,5,5,1,1,0.9\n1,2,0,0,5,5,0,8,0.2\n1,3,0,0,5,5,0,3,1\n",
        "frame,id,left,top,width,height,ignored\n1,1,0,0,5,5,0\n1,2,0,0,5,5,1\n",
        "frame,id,left,top,width,height,region\n1,1,0,0,5,5,0\n1,-1,0,0,5,5,1\n",
    ],
)
def test_truth_read_as_tracks_has_only_scored_rows(tmp_path: Path, text: str) -> None:
    assert read_tracks(put(tmp_path, text)).identity.tolist() == [1]


def test_tracks_of_other_programs(tmp_path: Path) -> None:
    tracks = read_tracks(
        put(
            tmp_path, "2,1,0,0,5,5,-1,-1,-1,-1\n1,2,0,0,5,5,0.25,-1,-1,-1\n1,1,0,0,5,5,3,-1,-1,-1\n"
        )
    )
    assert (tracks.frame.tolist(), tracks.identity.tolist()) == ([1, 1, 2], [1, 2, 1])
    assert tracks.confidence.tolist() == [3, 0.25, -1]
    assert tracks.detection.tolist() == [-1, -1, -1]
    assert tracks.confirmed.all()
    path = put(tmp_path, "frame,track_id,xc,yc,w,h,detection,confirmed\n1,3,5,5,10,10,2,0\n")
    tracks = read_tracks(path)
    assert tracks.xyxy.tolist() == [[0, 0, 10, 10]]
    assert (tracks.detection.tolist(), tracks.confirmed.tolist(), tracks.confidence.tolist()) == (
        [2],
        [False],
        [1],
    )
    for end, words in (
        ("0.5,1", "whole number of -1 or more for the detection"),
        ("0,2", "0 or 1 for confirmed"),
    ):
        refused(read_tracks, put(tmp_path, f"1,1,0,0,5,5,1,-1,-1,-1,{end}\n"), ", line 1", words)
