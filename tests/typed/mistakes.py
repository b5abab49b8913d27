"""Mistakes in programs that use phdtrack, which a type checker finds.

The test expects an error of mypy in each line with a mark at its end, with the code there, and
in no other; and of basedpyright an error in the same lines. Nobody runs this file.
"""

from __future__ import annotations

import numpy as np

import phdtrack
from phdtrack import CameraMotion, Detections, Tracker, Tracks, evaluate, filters, models
from phdtrack.final_rows import FinalTracks
from phdtrack.formats import export_tracks, read_detections, read_tracks, read_truth
from phdtrack.live.events import Watch
from phdtrack.video import open_source

SIZE = (1920, 1080)
BOXES = np.array([[100.0, 100.0, 140.0, 200.0]])
tracker = Tracker(SIZE, fps=25)

# Settings.
Tracker(SIZE, asociate={"output_delay": 5})  # wrong: call-arg
Tracker(SIZE, associate={"output_dely": 5})  # wrong: typeddict-unknown-key
Tracker(SIZE, associate={"output_delay": "5"})  # wrong: typeddict-item
Tracker(SIZE, associate={"kind": "graphs"})  # wrong: typeddict-item
Tracker(SIZE, associate=5)  # wrong: arg-type
Tracker(SIZE, sensor={"scaling": "detections"})  # wrong: typeddict-item
Tracker(SIZE, filter="kalman")  # wrong: arg-type
Tracker(SIZE, filter={"kind": "pmb", "max_hypothesis": 20})  # wrong: arg-type
Tracker(SIZE, preset="mot17")  # wrong: arg-type
Tracker(SIZE, appearance={"kind": "colours"})  # wrong: typeddict-item
Tracker(SIZE, camera_motion={"kind": "ecc"})  # wrong: typeddict-item
Tracker(SIZE, classes={"person": {"min_scor": 0.3}})  # wrong: dict-item
Tracker(SIZE, birth={"places": "door"})  # wrong: typeddict-item
Tracker(SIZE, detector={"min_area": 0.001})  # wrong: call-arg

# Names.
phdtrack.Trakcer(SIZE)  # wrong: attr-defined
filters.PMBN()  # wrong: attr-defined
models.BoxMotions()  # wrong: attr-defined

# Calls.
Tracker("1920x1080")  # wrong: arg-type
Tracker(SIZE, fps="25")  # wrong: arg-type
tracker.update("detections.txt")  # wrong: arg-type
tracker.update(BOXES, image="frame.png")  # wrong: arg-type
tracker.update(BOXES, 1, timestamps=0.04)  # wrong: call-arg
tracker.track()  # wrong: attr-defined
Detections.of("100,100,140,200")  # wrong: arg-type
CameraMotion()("frame.png", BOXES)  # wrong: arg-type
evaluate(read_detections("det.txt"), tracker.tracks())  # wrong: arg-type
FinalTracks(tracker.tracks())  # wrong: arg-type
export_tracks(tracker.tracks(), "tracks.csv")  # wrong: arg-type

# Results.
rows = tracker.update(BOXES)
print(rows.identities)  # wrong: attr-defined
print(rows.bbox)  # wrong: attr-defined
for box, identity in rows:
    print(identity, box[0])  # wrong: index
print(tracker.step.number)  # wrong: union-attr
if tracker.step is not None:
    tracker.step.info.vanished = 0  # wrong: misc
print(evaluate(read_truth("gt.txt"), rows)["MOTA"])  # wrong: index
print(read_tracks("tracks.csv").detections)  # wrong: attr-defined
print(read_detections("det.txt").xyxy)  # wrong: attr-defined
for frame in open_source("street.mp4"):
    print(frame.index)  # wrong: attr-defined
Watch().advance(rows, 1, 0.04)  # wrong: call-arg
first: Tracks = next(iter(rows))  # wrong: assignment
rows.save(rows)  # wrong: arg-type
