"""Two classes crossing: cars of one drive and people of another, overlaid, tracked together and
separately.

Both sequences have the size of the larger and the frames of the shorter one. *Apart*: a tracker for
each class. *Classes*: one tracker with class labels. *Without*: one without them; a track then gets
the class of most of its detections. Each class is scored on its own, without the benchmarks'
ignored regions.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.cameras import folder_of
from experiments.common import Options, in_parallel, table, write
from phdtrack import Tracker, Tracks
from phdtrack.formats import read_detections, read_seqinfo, read_truth
from phdtrack.metrics import evaluate
from phdtrack.types import I8, Detections, DetectionTable, SequenceInfo, Truth

CAR = 1
PERSON = 2
NAMES = {CAR: "car", PERSON: "person"}
PEOPLE = "KITTI-0015-ped"
CARS = ("KITTI-0001-car", "KITTI-0007-car", "KITTI-0009-car", "KITTI-0011-car", "KITTI-0014-car")
DETECTORS = ("rrc", "pointrcnn")
OUTPUTS = ("online", "corrected")
SCORES = ("HOTA", "MOTA", "IDF1")
WAYS = ("apart", "classes", "without")


class Crossing(NamedTuple):
    """The drive overlaid on the people, the detector of both, and the preset."""

    cars: str
    detector: str
    preset: str


class Found(NamedTuple):
    """Scores in points (2 outputs, 2 classes, 3 scores), and the number of identities with
    detections of both classes.
    """

    scores: np.ndarray
    mixed: list[int]
    identities: list[int]


def laid_over(cars: str, detector: str) -> tuple[SequenceInfo, DetectionTable, dict[int, Truth]]:
    """The sequence, the detections of both classes, and the truth of each."""
    parts = []
    truth = {}
    infos = [read_seqinfo(folder_of(name)) for name in (cars, PEOPLE)]
    last = min(info.frames for info in infos)
    for label, name in ((CAR, cars), (PERSON, PEOPLE)):
        found = read_detections(folder_of(name) / f"det_{detector}" / "det.txt")
        early = found.frame <= last
        one = found.detections.select(early)
        parts.append((found.frame[early], replace(one, class_id=np.full(len(one), label))))
        all_of_it = read_truth(folder_of(name) / "gt" / "gt.txt")
        keep = all_of_it.frame <= last
        columns = (all_of_it.frame, all_of_it.identity, all_of_it.xyxy, all_of_it.distractor)
        truth[label] = Truth(*(column[keep] for column in columns))
    info = SequenceInfo(
        max(i.width for i in infos),
        max(i.height for i in infos),
        infos[0].fps,
        last,
        f"{cars} and people",
    )
    frame = np.concatenate([part[0] for part in parts])
    order = np.argsort(frame, kind="stable")
    each = [part[1] for part in parts]
    boxes, score, label = (
        np.concatenate([getattr(x, name) for x in each])
        for name in ("xyxy", "confidence", "class_id")
    )
    return info, DetectionTable(frame[order], Detections(boxes, score, label).select(order)), truth


def tracked(info: SequenceInfo, detections: DetectionTable, preset: str) -> tuple[Tracks, Tracks]:
    """Online and corrected rows."""
    tracker = Tracker((info.width, info.height), fps=info.fps, preset=preset)
    online = [
        tracker.update(detections.at(number), frame=number) for number in range(1, info.frames + 1)
    ]
    return Tracks.concatenate([*online, tracker.flush()]), tracker.tracks()


def classes_of(rows: Tracks, detections: DetectionTable) -> I8:
    """(M,) the class of the detection that each row uses, 0 for none."""
    start = np.searchsorted(detections.frame, rows.frame)
    used = np.minimum(start + np.maximum(rows.detection, 0), len(detections) - 1)
    return np.where(rows.detection >= 0, detections.detections.class_id[used], 0)


def by_majority(rows: Tracks, seen: I8) -> Tracks:
    """The rows with the most frequent class of the detections of their identity."""
    _, place = np.unique(rows.identity, return_inverse=True)
    cars, people = (np.bincount(place, seen == label) for label in (CAR, PERSON))
    return replace(rows, class_id=np.where(people > cars, PERSON, CAR)[place])


def crossing(job: tuple[Crossing, str]) -> Found:
    """Track one crossing in one way."""
    (cars, detector, preset), way = job
    info, detections, truth = laid_over(cars, detector)
    label = detections.detections.class_id
    scores = np.zeros((2, 2, 3))
    mixed = []
    identities = []
    if way == "apart":
        each = []
        for one in (CAR, PERSON):
            mine = DetectionTable(
                detections.frame[label == one], detections.detections.select(label == one)
            )
            each.append(tracked(info, mine, preset))
        outputs = list(zip(*each, strict=True))
    else:
        inputs = (
            detections
            if way == "classes"
            else replace(detections, detections=replace(detections.detections, class_id=0 * label))
        )
        outputs = [(rows, rows) for rows in tracked(info, inputs, preset)]
    for k, pair in enumerate(outputs):
        if way != "apart":
            seen = classes_of(pair[0], detections)
            rows = pair[0] if way == "classes" else by_majority(pair[0], seen)
            pair = (rows, rows)
            both = [set(rows.identity[seen == one].tolist()) for one in (CAR, PERSON)]
            mixed.append(len(both[0] & both[1]))
            identities.append(len(both[0] | both[1]))
        for c, (one, rows) in enumerate(zip((CAR, PERSON), pair, strict=True)):
            found = evaluate(
                truth[one], rows.select(rows.class_id == one), frames=info.frames
            ).as_dict()
            scores[k, c] = [100 * float(found[name] or 0.0) for name in SCORES]
    return Found(scores, mixed or [0, 0], identities or [0, 0])


def main(options: Options) -> Path:
    """Track all crossings in all ways, and write classes.md."""
    cars, presets = (CARS[-1:], ("default",)) if options.quick else (CARS, ("default", "mot15"))
    cases = [
        Crossing(name, detector, preset)
        for preset in presets
        for detector in DETECTORS
        for name in cars
    ]
    jobs = [(case, way) for case in cases for way in WAYS]
    found = dict(zip(jobs, in_parallel(crossing, jobs, "classes", options), strict=True))
    lines = []
    apart = 0.0
    for preset in presets:
        mine = [case for case in cases if case.preset == preset]
        for k, output in enumerate(OUTPUTS):
            for way in WAYS:
                scores = np.mean([found[case, way].scores[k] for case in mine], axis=0)
                mixed, of = (
                    sum(getattr(found[c, way], name)[k] for c in mine)
                    for name in ("mixed", "identities")
                )
                cells = [" / ".join(f"{value:.1f}" for value in one) for one in scores]
                lines.append(
                    [preset, output, way, *cells, "–" if way == "apart" else f"{mixed} of {of}"]
                )
    for case in cases:
        apart = max(
            apart, float(np.abs(found[case, "classes"].scores - found[case, "apart"].scores).max())
        )
    head = ["preset", "rows", "tracked", "cars", "people", "identities on both"]
    return write(
        "classes", options, scores=table(head, lines), cases=len(cases), apart=f"{apart:.2f}"
    )
