"""Right uses of phdtrack, in which a type checker finds no mistake. Nobody runs this file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phdtrack import (
    CameraMotion,
    Detections,
    InputError,
    Tracker,
    Tracks,
    config,
    evaluate,
    export_tracks,
    read_tracks,
)
from phdtrack.final_rows import FinalTracks
from phdtrack.formats import Conventions, read_detections, read_truth
from phdtrack.live.events import Watch, place_events, tallies
from phdtrack.live.zones import read_places
from phdtrack.types import SequenceInfo
from phdtrack.video import open_source

if TYPE_CHECKING:
    from phdtrack.config.section_types import FilterKind, PresetName, SensorSection

SIZE = (1920, 1080)
BOXES = np.array([[100.0, 100.0, 140.0, 200.0]])
IMAGE = np.zeros((1080, 1920, 3), np.uint8)
tracker = Tracker(SIZE, fps=25)

# Settings.
Tracker(frame_size=(640, 480), fps=29.97, seed=3)
Tracker(IMAGE.shape[1::-1], settings="mine.toml")
Tracker(SIZE, settings=Path("mine.toml"), preset="m09")
Tracker(SIZE, filter="gm-phd", associate={"output_delay": 5, "max_coast": 1})
Tracker(SIZE, filter={"kind": "particle-phd", "particles_per_target": 500, "threads": 0})
Tracker(SIZE, filter={"acceleration_factors": [1, 4]}, extract={"merge_iou": 0.3})
Tracker(SIZE, sensor={"detection_probability": 0.9, "scaling": "fixed", "fixed_noise": (3, 3)})
Tracker(SIZE, motion={"kind": "plane"}, camera={"file": "a.xml", "region": [-9, 0, 9.5, 40]})
Tracker(SIZE, birth={"kind": "places", "places": [[0, 0, 0.1, 1, 1], (5, 0, 0.1, 1, 1.5)]})
Tracker(SIZE, scene="street.scene.json", appearance={"kind": "none"})
Tracker(SIZE, scene={"file": "street.scene.json", "use": ["births"]})
Tracker(SIZE, classes={"together": [[2, 7], ["car", "van"]], "only": ("person", 2)})
Tracker(SIZE, classes={"person": {"min_score": 0.3, "sensor": {"box_noise": 0.1}}})
Tracker(SIZE, classes={"names": ["person", "car"], "car": {"min_size": 20}})
Tracker(SIZE, classes={"names": {0: "person", 2: "car"}})
Tracker(SIZE, filter="pmbm" if tracker.highest else "pmb", common_motion={"kind": "none"})


def tracker_of(kind: FilterKind, preset: PresetName, sensor: SensorSection) -> Tracker:
    return Tracker(SIZE, filter=kind, preset=preset, sensor=sensor)


def with_any(settings: dict[str, Any]) -> Tracker:
    return Tracker(SIZE, **settings)


loaded = config.overlay(config.load(preset="m07"), {"filter": {"kind": "gm-phd"}})
Tracker(stages=config.build(loaded, SequenceInfo(1920, 1080, 25.0)), fps=25)


# Boxes.
@dataclass
class Boxes:
    """What a detector of one's own may return."""

    xyxy: NDArray[np.float32]
    confidence: NDArray[np.float32]


@dataclass
class Result:
    """What a detector with one result for each picture may return."""

    boxes: Boxes


class Tensor:
    """What NumPy makes an array of."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return BOXES


mine = Boxes(BOXES.astype(np.float32), np.ones(1, np.float32))
tracker.update(BOXES)
tracker.update([])
tracker.update([[100, 100, 140, 200, 0.9]], frame=7)
tracker.update(mine, timestamp=0.28, image=IMAGE)
tracker.update(Result(mine), embeddings=np.ones((1, 128), np.float32))
tracker.update([Result(mine)], embeddings=[[0.5, 0.5]])
tracker.update(Tensor(), image=Tensor())
tracker.update(Detections.empty(observed=False))
tracker.update(Detections.of([[100, 100, 140, 200]], [0.9], np.array([1])))
tracker.update(BOXES, warp=CameraMotion()(IMAGE, BOXES))
tracker.update(BOXES, warp=[[1, 0, 4], [0, 1, 1]])


# Results.
def moved(rows: Tracks) -> Iterator[tuple[int, float]]:
    for identity, box in rows:
        yield identity, float(box[0])


rows = tracker.update(BOXES)
print(len(rows), rows[0].xyxy, rows[rows.frame > 10].identity.tolist(), rows[:3].confidence)
confirmed: Tracks = rows.select(rows.confirmed & ~rows.predicted)
names: dict[int, float] = dict(moved(confirmed))
if tracker.step is not None:
    print(tracker.step.number, tracker.step.info.clutter_probability.max())
tracker.on_warning = print
state = tracker.state_dict()
tracker.load_state_dict(state, same_settings=False)
final = FinalTracks(tracker, lag=60)
final.due().to_dataframe().to_csv("rows.csv")
for given in tracker.returns:
    print(given.identity, given.odds, [one.labels for one in tracker.exchanges])
export_tracks("tracks.csv", tracker.tracks())
export_tracks(Path("tracks.xml"), final.rest(), names={0: "person"})
tracker.tracks().save("tracks.jsonl", names={0: "person"})
print(len(Tracks.load(Path("tracks.jsonl"))), Tracks.load("zero.txt", first_frame=0).identity)
again = read_tracks("tracks.csv", conventions=Conventions(units="pixels"))
scores = evaluate(read_truth("gt.txt"), again, frames=750)
print(scores.MOTA, scores.as_dict()["HOTA"])
table = read_detections("det.txt")
for number in range(1, table.last + 1):
    tracker.update(table.at(number), number)
try:
    for frame in open_source("street.mp4"):
        tracker.update(BOXES, frame.number, frame.time, image=frame.image)
except InputError as error:
    print(error.where, error.problem, error.cure)
watch = Watch(read_places("crossing.toml"), dwell=30)
events = place_events(watch, again, 750, 25.0)
print(tallies(watch, events, 0, 30))
