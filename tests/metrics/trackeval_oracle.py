"""TrackEval's figures for the same rows.

TrackEval is installed without its dependencies, because they would replace OpenCV 4 by 5. What is
used here needs only NumPy and SciPy; its import prints a line about pycocotools, which its BURST
data set would need.
"""

import contextlib
import importlib
import io
from dataclasses import dataclass

import numpy as np

from phdtrack.types import Tracks, Truth

with contextlib.redirect_stdout(io.StringIO()):
    trackeval = importlib.import_module("trackeval")

CLASSES = {
    "pedestrian": 1,
    "person_on_vehicle": 2,
    "static_person": 7,
    "distractor": 8,
    "reflection": 12,
}


@dataclass(frozen=True)
class Figures:
    hota: dict
    clear: dict
    identity: dict
    vace: dict


def figures(truth: Truth, tracks: Tracks, frames: int, threshold: float = 0.5) -> Figures:
    data = preprocessed(truth, tracks, frames)
    return Figures(*(metric.eval_sequence(data) for metric in metrics(threshold)))


def pooled(parts: list[Figures], threshold: float = 0.5) -> Figures:
    columns = zip(*((p.hota, p.clear, p.identity, p.vace) for p in parts), strict=True)
    return Figures(
        *(
            metric.combine_sequences({str(i): part for i, part in enumerate(column)})
            for metric, column in zip(metrics(threshold), columns, strict=True)
        )
    )


def metrics(threshold: float) -> list:
    """HOTA, CLEAR, Identity and VACE, whose ATA is the relaxed one at 0.5 whatever the
    threshold.
    """
    config = {"THRESHOLD": threshold, "PRINT_CONFIG": False}
    kinds = trackeval.metrics
    return [kinds.HOTA(), kinds.CLEAR(config), kinds.Identity(config), kinds.VACE()]


def preprocessed(truth: Truth, tracks: Tracks, frames: int) -> dict:
    """Through TrackEval's own MOT16 preprocessing, which takes out distractors, and its own
    overlap.
    """
    mot = trackeval.datasets.MotChallenge2DBox
    dataset = mot.__new__(mot)
    dataset.do_preproc = True
    dataset.benchmark = "MOT16"
    dataset.class_name_to_class_id = CLASSES
    dataset.valid_class_numbers = list(CLASSES.values())
    raw: dict = {"num_timesteps": frames, "seq": "case"}
    keys = (
        "gt_ids",
        "gt_dets",
        "gt_classes",
        "gt_extras",
        "tracker_ids",
        "tracker_dets",
        "tracker_classes",
    )
    for key in (*keys, "tracker_confidences", "similarity_scores"):
        raw[key] = []
    for k in range(1, frames + 1):
        t = truth.frame == k
        o = tracks.frame == k
        raw["gt_ids"].append(truth.identity[t])
        raw["gt_dets"].append(truth.xyxy[t])
        raw["gt_classes"].append(
            np.where(truth.distractor[t], CLASSES["distractor"], CLASSES["pedestrian"])
        )
        raw["gt_extras"].append({"zero_marked": np.ones(t.sum(), np.int64)})
        raw["tracker_ids"].append(tracks.identity[o])
        raw["tracker_dets"].append(tracks.xyxy[o])
        raw["tracker_classes"].append(np.ones(o.sum(), np.int64))
        raw["tracker_confidences"].append(np.ones(o.sum()))
        overlap = mot._calculate_box_ious(
            truth.xyxy[t].copy(), tracks.xyxy[o].copy(), box_format="x0y0x1y1"
        )
        raw["similarity_scores"].append(overlap)
    return dataset.get_preprocessed_seq_data(raw, "pedestrian")
