"""Simulated streets to learn while tracking, and runs over them with and without learning."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from phdtrack import config, pipeline
from phdtrack.metrics import evaluate
from phdtrack.models.learning import SceneState, scene_of
from phdtrack.scene.online import SceneUpdate
from phdtrack.simulate import DetectorModel, make_scene
from phdtrack.simulate.detector import detect
from phdtrack.types import Detections, DetectionTable, SequenceInfo, Tracks, Truth

DETECTOR = DetectorModel(occlusion=2.0, clutter_rate=1.0, places=5, place_fire=0.5)


@dataclass(frozen=True)
class Run:
    """Corrected tracks, what was learned at the end, and on the way."""

    tracks: Tracks
    learned: SceneState | None
    course: list[SceneUpdate]


def street(seed, frames, detector=DETECTOR):
    return make_scene("street", seed, detector, frames=frames)


def seen_again(scene, seed, detector=DETECTOR):
    """The same people, other places and false alarms."""
    return detect(scene.truth, scene.info, np.random.default_rng(seed), detector).table


def joined(parts):
    """One table of (table, first frame, last frame) one after the other."""
    frames, boxes = [], []
    for table, first, last in parts:
        rows = (table.frame >= first) & (table.frame <= last)
        frames.append(table.frame[rows])
        boxes.append(table.detections.xyxy[rows])
    return DetectionTable(np.concatenate(frames), Detections.of(np.concatenate(boxes)))


def tracked(info: SequenceInfo, table: DetectionTable, *sets: str, kind: str = "gm-phd") -> Run:
    """``sets`` are settings of the section learn; without any nothing is learned.

    By a PHD filter, which has nothing of its own against places that fire. Tracks are not joined: those that false alarms of
    one place make would be one, and their number would say nothing.
    """
    options = [
        f"filter.kind={kind}",
        "smooth.stitching=false",
        *(f"learn.{text}" for text in ("kind=online", *sets) if sets),
    ]
    # The default reads scores, which here tell all false alarms.
    preset = "mot15" if kind == "pmb" else ""
    stages, rng = config.build(config.load(sets=options, preset=preset), info), np.random.default_rng(0)
    frames = ((k, (k - 1) / info.fps, table.at(k)) for k in range(1, info.frames + 1))
    course, state = [], pipeline.start(stages, rng)
    for number, time, seen in frames:
        state, _ = pipeline.advance(stages, state, seen, number, time, rng)
        scene = scene_of(state.learned)
        last = None if scene is None else scene.known.last
        if last is not None and (not course or last is not course[-1]):
            course.append(last)
    return Run(pipeline.finish(stages, state), scene_of(state.learned), course)


def scores(truth: Truth, tracks: Tracks, first: int, last: int):
    """Of the frames ``first`` to ``last``."""
    rows = (truth.frame >= first) & (truth.frame <= last)
    there = Truth(truth.frame[rows] - first + 1, truth.identity[rows], truth.xyxy[rows], truth.distractor[rows])
    rows = (tracks.frame >= first) & (tracks.frame <= last)
    ours = replace(tracks.take(rows), frame=tracks.frame[rows] - first + 1)
    found = evaluate(there, ours, frames=last - first + 1).as_dict()
    return SimpleNamespace(**{name.lower(): value for name, value in found.items()})
