"""Ignored rows: KITTI's label files against TrackEval's own preprocessing, regions, and ignore
lists.
"""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from trackeval_oracle import trackeval

from phdtrack.arrays import area, intersection, iou
from phdtrack.errors import InputError
from phdtrack.formats import ignoring, read_tracks, read_truth
from phdtrack.metrics import evaluate, explain
from phdtrack.metrics.matching import pair_frames

TYPES = ("Car", "Van", "Pedestrian", "Person_sitting", "Cyclist", "DontCare")


def label_line(frame, identity, kind, truncated, occluded, box, score=None):
    end = "" if score is None else f" {score}"
    corners = " ".join(f"{value:.3f}" for value in box)
    return (
        f"{frame} {identity} {kind} {truncated} {occluded} -10 {corners} 1.5 1.6 3.9 0 0 0 0{end}"
    )


def drawn(rng, folder: Path):
    """Label files of truth and results, with small boxes, hidden objects, neighbours and regions,
    beside their rows.
    """
    truth = []
    found = []
    for frame in range(12):
        for i in range(rng.integers(3, 9)):
            kind = TYPES[rng.integers(0, 6)]
            corner = rng.uniform(0, 200, 2)
            size = rng.uniform(18, 60, 2) * (2 if kind == "DontCare" else 1)
            box = np.round(np.concatenate([corner, corner + size]), 3)
            hidden = int(rng.random() < 0.2), int(rng.integers(0, 4))
            truth.append((frame, -1 if kind == "DontCare" else i, kind, *hidden, box))
            if rng.random() < 0.8 and kind != "DontCare":
                moved = np.round(box + rng.normal(0, 3, 4), 3)
                found.append((frame, i, "Car" if rng.random() < 0.7 else kind, moved))
        for i in range(rng.integers(0, 4)):
            corner = rng.uniform(0, 250, 2)
            found.append(
                (frame, 50 + i, "Car", np.round([*corner, *(corner + rng.uniform(15, 50, 2))], 3))
            )
    (folder / "gt.txt").write_text("\n".join(label_line(*row) for row in truth))
    (folder / "found.txt").write_text(
        "\n".join(label_line(f, i, kind, -1, -1, box, 0.5) for f, i, kind, box in found)
    )
    return truth, found


def by_trackeval(truth, found, kind: str) -> list[tuple[list, list]]:
    """Boxes of truth and output in each frame that TrackEval leaves to be scored."""
    names = {name.lower().replace("person_sitting", "person"): k for k, name in enumerate(TYPES)}
    frames = range(1 + max(row[0] for row in truth))
    own = [[row for row in truth if row[0] == frame and row[2] != "DontCare"] for frame in frames]
    out = [[row for row in found if row[0] == frame] for frame in frames]
    care = [[row for row in truth if row[0] == frame and row[2] == "DontCare"] for frame in frames]

    def boxes(rows):
        return np.array([row[-1] for row in rows]).reshape(-1, 4)

    raw = {
        "num_timesteps": len(own),
        "seq": "case",
        "gt_ids": [np.array([row[1] for row in rows], int) for rows in own],
        "gt_dets": [boxes(rows) for rows in own],
        "gt_classes": [np.array([TYPES.index(row[2]) for row in rows], int) for rows in own],
        "gt_extras": [
            {
                "truncation": np.array([row[3] for row in rows]),
                "occlusion": np.array([row[4] for row in rows]),
            }
            for rows in own
        ],
        "gt_crowd_ignore_regions": [boxes(rows) for rows in care],
        "tracker_ids": [np.array([row[1] for row in rows], int) for rows in out],
        "tracker_dets": [boxes(rows) for rows in out],
        "tracker_classes": [np.array([TYPES.index(row[2]) for row in rows], int) for rows in out],
        "tracker_confidences": [np.ones(len(rows)) for rows in out],
        "similarity_scores": [iou(boxes(a), boxes(b)) for a, b in zip(own, out, strict=True)],
    }
    kitti = trackeval.datasets.Kitti2DBox
    settings = SimpleNamespace(
        class_name_to_class_id=names,
        max_occlusion=2,
        max_truncation=0,
        min_height=25,
        _calculate_box_ious=lambda a, b, box_format, do_ioa: intersection(a, b) / area(a)[:, None],
        _check_unique_ids=lambda data: None,
    )
    data = kitti.get_preprocessed_seq_data(settings, raw, kind)
    return list(zip(data["gt_dets"], data["tracker_dets"], strict=True))


@pytest.mark.parametrize("kind", ["Car", "Pedestrian"])
@pytest.mark.parametrize("seed", range(6))
def test_kitti_preprocessing_agrees_with_trackeval(tmp_path: Path, kind: str, seed: int):
    truth, found = drawn(np.random.default_rng(seed), tmp_path)
    annotated, tracks = (
        read(tmp_path / name, kitti=kind)
        for read, name in ((read_truth, "gt.txt"), (read_tracks, "found.txt"))
    )
    scene = pair_frames(annotated, tracks)
    kept = {
        pair.number: (annotated.xyxy[pair.truth_row], tracks.xyxy[pair.output_row])
        for pair in scene.pairs
    }
    empty = np.zeros((0, 4)), np.zeros((0, 4))
    expected = by_trackeval(truth, found, kind.lower())
    assert len(expected) == 12
    for number, sides in enumerate(expected, start=1):
        for ours, theirs in zip(kept.get(number, empty), sides, strict=True):
            assert sorted(map(tuple, ours)) == sorted(map(tuple, theirs))
    assert scene.ignored > 0
    assert explain(annotated, tracks).ignored == scene.ignored


def test_a_kitti_file_needs_a_type(tmp_path: Path):
    drawn(np.random.default_rng(1), tmp_path)
    with pytest.raises(InputError, match="--kitti Car"):
        read_truth(tmp_path / "gt.txt")
    path = tmp_path / "broken.txt"
    path.write_text("1,1,0,0,20,40,1,-1,-1,-1")
    with pytest.raises(InputError, match="expected a KITTI label file"):
        read_truth(path, kitti="Car")
    path.write_text(
        label_line(0, 1, "Car", 0, 0, [0, 0, 9, 9])
        + "\n"
        + label_line(1, 1, "Car", "x", 0, [0, 0, 9, 9])
    )
    with pytest.raises(InputError, match=r"line 2.*"):
        read_truth(path, kitti="Car")


GT = "1,1,0,0,20,40,1,-1,-1,-1\n2,1,0,0,20,40,1,-1,-1,-1\n"
# Frame 1: right. Frame 2: far away, where regions may be; 12 of 20 pixels of its width are left of
# 112.
FOUND = "1,9,0,0,20,40,1,-1,-1,-1\n2,9,100,0,20,40,1,-1,-1,-1\n"


@pytest.mark.parametrize(
    ("listed", "false"),
    [
        ("2,90,0,22,60\n", 0),
        ("2,90,0,20,60\n", 1),  # exactly a half
        ("1,90,0,22,60\n", 1),
        ("frame,x,y,w,h\n,90,0,22,60\n", 0),
        ("frame;left;top;right;bottom\n;90;0;112;60\n", 0),
        ("2,-1,90,0,22,60,0,-1,-1,-1\n", 0),
        # A distractor takes what matches it, and nothing else.
        ("2,7,90,0,22,60,0,-1,-1,-1\n", 1),
        ("2,7,100,0,20,40,0,-1,-1,-1\n", 0),
        ("frame,id,x,y,w,h\n2,7,100,0,20,40\n", 0),
        # What is right stays right.
        ("frame,x,y,w,h\n,0,0,500,500\n", 0),
        ("", 1),
    ],
)
def test_ignore_lists_are_applied(tmp_path: Path, listed: str, false: int):
    for name, text in (("gt.txt", GT), ("found.txt", FOUND), ("ignore.csv", listed)):
        (tmp_path / name).write_text(text)
    truth = ignoring(read_truth(tmp_path / "gt.txt"), tmp_path / "ignore.csv")
    tracks = read_tracks(tmp_path / "found.txt")
    scores = evaluate(truth, tracks)
    assert (scores.false_positives, scores.misses, scores.matches) == (false, 1, 1)
    assert explain(truth, tracks).ignored == 1 - false


@pytest.mark.parametrize(
    "listed",
    [
        "frame,x,y,w,h\n2,90,0,0,60\n",
        "frame,id,x,y,w,h\n,7,1,1,20,40\n",
        "frame,x,y\n1,2,3\n",
        "1,a,2,3,4\n",
    ],
)
def test_malformed_ignore_lists_are_refused(tmp_path: Path, listed: str):
    (tmp_path / "gt.txt").write_text(GT)
    (tmp_path / "ignore.csv").write_text(listed)
    with pytest.raises(InputError, match=r"ignore\.csv"):
        ignoring(read_truth(tmp_path / "gt.txt"), tmp_path / "ignore.csv")


def test_table_with_a_region_column(tmp_path: Path):
    (tmp_path / "gt.csv").write_text(
        "frame,id,x,y,w,h,region\n1,1,0,0,20,40,0\n2,-1,90,0,50,60,1\n"
    )
    truth = read_truth(tmp_path / "gt.csv")
    assert truth.regions.tolist() == [[2, 90, 0, 140, 60]]
    assert truth.frame.tolist() == [1]
