"""A real street as a hand-held camera would have filmed it: the motion measured in real pictures, real detections."""

from dataclasses import replace

import numpy as np
import pytest

from moving_cases import filmed, handheld, points, seen, step
from phdtrack import CameraMotion, Tracker
from phdtrack.formats import read_detections, read_truth
from phdtrack.metrics import evaluate
from phdtrack.types import DetectionTable
from phdtrack.video import open_source

pytestmark = pytest.mark.data


def identified(table, truth, frames, warps) -> float:
    """IDF1 of the corrected tracks of the default filter."""
    tracker = Tracker((640, 480), fps=25)
    for number, warp in zip(frames, warps, strict=True):
        tracker.update(table.at(number), frame=number, warp=warp)
    return evaluate(truth, tracker.tracks(), frames=len(frames)).IDF1


def test_a_street_by_a_camera_in_a_hand(data):
    folder = data / "mot15" / "TUD-Campus"
    table, truth = read_detections(folder / "det_frcnn" / "det.txt"), read_truth(folder / "gt" / "gt.txt")
    video = next(folder.glob("*.mp4"))
    frames = [frame.number for frame in open_source(str(video))]
    path, motion = handheld(frames[-1], np.random.default_rng(5)), CameraMotion()
    moved = DetectionTable(table.frame, replace(table.detections, xyxy=seen(path, table.frame, table.detections.xyxy)))
    judged = replace(truth, xyxy=seen(path, truth.frame, truth.xyxy))
    corners, measured, errors = np.array([[0.0, 640, 640, 0], [0, 0, 480, 480]]), [], []
    for frame in open_source(str(video)):
        picture = filmed(frame, path, (640, 480)).image
        warp = motion(picture, moved.at(frame.number).xyxy)
        assert motion.measured
        wanted = step(path, frame.number) if frame.number > 1 else np.eye(3)
        errors.append(np.abs(points(warp, corners) - points(wanted, corners)).max())
        measured.append(warp)
    stands = identified(table, truth, frames, [None] * len(frames))
    told, untold = identified(moved, judged, frames, measured), identified(moved, judged, frames, [None] * len(frames))
    assert max(errors) < 0.5
    assert told > stands - 0.02
    assert untold < stands - 0.05
