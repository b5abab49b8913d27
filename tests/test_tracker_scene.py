"""The tracker with a learned scene: tracks that stay where false alarms are learned are not
reported.
"""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from experiments.common import with_scene
from phdtrack import Tracker, config
from phdtrack.arrays import to_xyxy
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.models.scene import FalseAlarmRatio
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects
from phdtrack.types import Detections, SequenceInfo, Tracks
from tracker_cases import PARTICLES, SIZE, equal, feed

LOW = np.array([0.0, 0, -30, -30, 0, 0])
HIGH = np.array([640.0, 480, 30, 30, 640, 480])
SHOWN = [0, 1, 4, 5]
FLAG = np.array([[520.0, 100, 40, 70]]).T
WALK = np.array([[300.0, 320, 40, 100]]).T


def place(at: np.ndarray, deviation: np.ndarray, uniform: float) -> SceneDensity:
    return SceneDensity(
        LOW[SHOWN], HIGH[SHOWN], uniform, np.ones(1), at, np.diag(np.square(deviation))[None]
    )


CLUTTER = LearnedDensity(2.0, place(FLAG, np.array([6.0, 6, 4, 6]), 0.2))
OBJECTS = TrackedObjects(0.5, LearnedDensity(1.0, place(WALK, np.array([150.0, 40, 8, 15]), 0.3)))
# They come in on the left.
ENTRY = np.array([[90.0, 320, 6, 0, 40, 100]]).T, np.diag(np.square([30.0, 40, 2, 1, 8, 15]))[None]
BIRTHS = LearnedDensity(0.01, SceneDensity(LOW, HIGH, 0.2, np.ones(1), *ENTRY))


def tracker_of(held_back: bool = True, sure: float = 0.0, **sections) -> Tracker:
    values = (
        {"filter": PARTICLES | {"particles_per_target": 400}, "birth": {"particles": 300}}
        if "particles" in sections
        else {}
    )
    delay = {"associate": {"output_delay": sections.get("delay", 0)}}
    stages = config.build(
        config.overlay(config.load(), values | delay, "a test"), SequenceInfo(*SIZE, 25.0)
    )
    if held_back:
        model = with_scene(stages.model, BIRTHS, CLUTTER, OBJECTS, 300)
        stages = replace(
            stages,
            model=model,
            associator=FalseTrackRejection(
                stages.associator, FalseAlarmRatio(CLUTTER, OBJECTS, BIRTHS), sure
            ),
        )
    return Tracker(stages=stages, seed=3)


def scans(count: int = 60) -> list[Detections]:
    """A flag in the wind, detected four times in five, and somebody who walks past below."""
    rng = np.random.default_rng(7)
    out = []
    for k in range(count):
        flag = (
            FLAG[:, 0]
            + np.array([8 * np.sin(k / 3), 4 * np.cos(k / 4), 0, 0])
            + rng.normal(0, 1, 4)
        )
        walker = np.array([80.0 + 6 * k, 320, 40, 100]) + rng.normal(0, 1, 4)
        seen = np.array([flag, walker])[[rng.random() < 0.8, rng.random() < 0.95]]
        out.append(Detections.of(to_xyxy(seen.T).reshape(-1, 4)))
    return out


def near(tracks: Tracks, at: np.ndarray) -> np.ndarray:
    """Whose centres are within 40 pixels of a height."""
    return np.abs(tracks.xyxy[:, [1, 3]].mean(axis=1) - at[1, 0]) < 40


@pytest.mark.parametrize(
    "section", [{}, {"delay": 3}, {"particles": True}], ids=["default", "delay", "particles"]
)
def test_a_flag_is_rejected_and_a_walker_is_not(section):
    plain = tracker_of(False, **section)
    learned = tracker_of(**section)
    rows = [
        Tracks.concatenate([*feed(tracker, scans()), tracker.flush()])
        for tracker in (plain, learned)
    ]
    without, held = (r.select(r.confirmed) for r in rows)
    assert np.count_nonzero(near(without, FLAG)) > 20, "without the scene the flag becomes a track"
    assert not near(held, FLAG).any()
    assert np.count_nonzero(near(held, WALK)) > 50
    assert np.count_nonzero(near(plain.tracks(), FLAG)) > 20
    corrected = learned.tracks()
    assert near(corrected, WALK).all()
    assert len(corrected) > 50
    assert set(corrected.identity) == {1}


@pytest.mark.parametrize("section", [{}, {"particles": True}], ids=["default", "particles"])
def test_a_walker_away_from_false_alarms_is_reported_at_once(section):
    """The walker from the first state on; the flag is rejected all the same, and corrected tracks
    are the same.
    """
    trackers = [tracker_of(sure=odds, **section) for odds in (0.0, 0.1)]
    slow, early = (
        Tracks.concatenate([*feed(tracker, scans()), tracker.flush()]) for tracker in trackers
    )
    first = [int(rows.frame[rows.confirmed & near(rows, WALK)].min()) for rows in (slow, early)]
    assert first[1] == slow.frame[near(slow, WALK)].min() < first[0]
    assert not near(early.select(early.confirmed), FLAG).any()
    assert equal(trackers[0].tracks(), trackers[1].tracks())


@pytest.mark.parametrize("section", [{"delay": 3}, {"particles": True}], ids=["delay", "particles"])
def test_a_resumed_run_is_bit_identical(section):
    whole, first, second = (tracker_of(**section) for _ in range(3))
    wanted = feed(whole, scans())
    feed(first, scans()[:25])
    second.load_state_dict(pickle.loads(pickle.dumps(first.state_dict())))
    rest = feed(second, scans()[25:])
    assert all(equal(x, y) for x, y in zip(rest, wanted[25:], strict=True))
    assert equal(second.flush(), whole.flush())
    assert equal(second.tracks(), whole.tracks())
