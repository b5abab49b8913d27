"""Blobs explained in the whole tracker: identities through a shared blob, rows that rest on it, checkpoints."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

from experiments.blobs_outcomes import outcome
from experiments.blobs_scenes import PARTINGS, in_pieces, meeting
from experiments.common import Case
from phdtrack.arrays import intersection
from phdtrack.cli.configured import Choice, chosen, prepare
from phdtrack.cli.wanted import Wanted
from phdtrack.detect.merged import Explained
from phdtrack.detect.merged.edges import union
from phdtrack.metrics import evaluate
from phdtrack.simulate import DetectorModel, build_scene, make_scene
from phdtrack.tracker import Tracker
from phdtrack.types import F8, Detections, DetectionTable, Tracks

SEEDS = range(3)


def shared(boxes: F8) -> F8:
    """The boxes of two as a change detector sees them: one blob where they overlap."""
    touching = len(boxes) == 2 and float(intersection(boxes[:1], boxes[1:])[0, 0]) > 0
    return union(boxes)[None] if touching else boxes


def merging(parting: str, seed: int) -> Case:
    """A meeting whose blobs are the truth's boxes with a little noise."""
    scene = build_scene(meeting("crossing" if parting == "crossing" else "turning back", seed), seed, DetectorModel())
    rng, frame, boxes = np.random.default_rng(seed), [], []
    for number in range(1, scene.info.frames + 1):
        found = shared(scene.truth.xyxy[scene.truth.frame == number])
        frame.append(np.full(len(found), number))
        boxes.append(found + rng.normal(0, 1.0, found.shape))
    table = DetectionTable(np.concatenate(frame), Detections.of(np.concatenate(boxes)))
    return Case(parting, scene.info, scene.truth, table)


def tracker_of(case: Case, filter_name: str, kind: str, **more: float) -> Tracker:
    size = (case.info.width, case.info.height)
    return Tracker(size, fps=case.info.fps, filter=filter_name, merged_measurements={"kind": kind, **more})


def tracked(case: Case, filter_name: str, kind: str, **more: float) -> tuple[Tracks, list[Tracks]]:
    """Corrected tracks, and the rows of each frame."""
    tracker = tracker_of(case, filter_name, kind, **more)
    rows = [tracker.update(case.table.at(number)) for number in range(1, case.info.frames + 1)]
    return tracker.tracks(), rows


@pytest.mark.parametrize(("filter_name", "partings"), [("pmb", PARTINGS), ("gm-phd", PARTINGS[1:])])
def test_two_leave_a_shared_blob_with_their_identities(filter_name: str, partings: tuple[str, ...]) -> None:
    right = {"none": 0, "explained": 0}
    for parting in partings:
        for seed in SEEDS:
            case = merging(parting, seed)
            for kind in right:
                right[kind] += outcome(case, tracked(case, filter_name, kind)[0]) == "right"
    pairs = len(partings) * len(SEEDS)
    assert right["none"] <= pairs // 3
    assert right["explained"] >= pairs // 2


def test_rows_rest_on_the_blob_that_they_share() -> None:
    case = merging("turning back", 0)
    corrected, _ = tracked(case, "gm-phd", "explained")
    count = np.array([len(case.table.at(int(number))) for number in corrected.frame])
    assert (corrected.detection < count).all()
    alone = [n for n in range(90, case.info.frames) if len(case.table.at(n)) == 1]
    both = [n for n in alone if (corrected.detection[corrected.frame == n] == 0).sum() == 2]
    assert len(both) > 0.7 * len(alone)


@pytest.mark.parametrize("filter_name", ["pmb", "particle-phd"])
def test_a_resumed_run_is_the_run(filter_name: str) -> None:
    case = merging("crossing", 1)
    first, second = (tracker_of(case, filter_name, "explained") for _ in range(2))
    # In the middle of the blob that both share.
    middle = 125
    for number in range(1, middle):
        first.update(case.table.at(number))
    second.load_state_dict(pickle.loads(pickle.dumps(first.state_dict())))
    assert len(case.table.at(middle)) == 1
    for number in range(middle, case.info.frames + 1):
        a, b = first.update(case.table.at(number)), second.update(case.table.at(number))
        np.testing.assert_array_equal(a.xyxy, b.xyxy)
        np.testing.assert_array_equal(a.detection, b.detection)
    np.testing.assert_array_equal(first.tracks().xyxy, second.tracks().xyxy)


def test_pieces_become_one_object() -> None:
    scene = make_scene("street", 1, DetectorModel(p_detect=0.95, clutter_rate=0.0), frames=150)
    case = in_pieces(Case("street", scene.info, scene.truth, scene.detections), 0.3, 1)
    assert len(case.table) > 1.2 * len(scene.detections)
    scores = {
        kind: evaluate(case.truth, tracked(case, "gm-phd", kind, **more)[0], frames=case.info.frames)
        for kind, more in (("none", {}), ("explained", {"split": 0.3}))
    }
    assert scores["explained"].false_positives < scores["none"].false_positives
    assert scores["explained"].MOTA > 0.9


def test_frames_that_nobody_looked_at_and_empty_ones_pass() -> None:
    case = merging("turning back", 2)
    tracker = tracker_of(case, "gm-phd", "explained")
    for number in range(1, case.info.frames + 1):
        found = case.table.at(number)
        if number % 7 == 0:
            found = Detections.empty(observed=False)
        elif number % 11 == 0:
            found = Detections.empty()
        tracker.update(found)
    assert len(np.unique(tracker.tracks().identity)) >= 2


@pytest.mark.parametrize(
    ("detector", "detections", "sets", "kind"),
    [
        ("", False, (), "explained"),
        ("mog2", False, (), "explained"),
        ("person", False, (), "none"),
        ("", True, (), "none"),
        ("", False, ("merged_measurements.kind=none",), "none"),
        ("", False, ("filter.kind=none",), "none"),
    ],
)
def test_blobs_are_explained_where_a_background_model_finds_them(
    tmp_path: Path, detector: str, detections: bool, sets: tuple[str, ...], kind: str
) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for number in range(3):
        cv2.imwrite(str(folder / f"{number:03d}.png"), np.full((48, 64, 3), 90, np.uint8))
    file = tmp_path / "det.txt"
    file.write_text("1,-1,10,10,20,30,0.9\n", encoding="utf-8")
    wanted = Wanted(str(folder), file if detections else None, detector, fps=25.0)
    choice = Choice(sets=sets)
    job = prepare(wanted, choice, chosen(choice), "phdtrack track", video=False)
    assert job.configured("merged_measurements", "kind") == kind
    assert isinstance(job.stages.explainer, Explained) == (kind == "explained")
