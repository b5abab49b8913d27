"""Trackers, boxes and a scene for the tests of the tracker."""

from __future__ import annotations

import numpy as np

from phdtrack import Tracker
from phdtrack.simulate import DetectorModel, make_scene
from phdtrack.types import Detections, Tracks

SIZE = (640, 480)
# Few particles, so that tests are quick.
FEW = {"filter": {"particles_per_target": 500}, "birth": {"particles": 400}}
PARTICLES = {"kind": "particle-phd"}
FIELDS = ("frame", "identity", "xyxy", "confidence", "detection", "confirmed", "class_id")


def tracker_of(*, seed: int = 0, fps: float = 25.0, **sections) -> Tracker:
    """A tracker with other settings by section, and with few particles where the filter has any."""
    if sections.get("filter", {}).get("kind", "").startswith("particle"):
        sections = sections | {name: few | sections.get(name, {}) for name, few in FEW.items()}
    return Tracker(SIZE, seed=seed, fps=fps, **sections)


def boxes(k: int) -> np.ndarray:
    """Two people who walk towards each other, at frame k from 0."""
    return np.array(
        [[100.0 + 3 * k, 100, 140 + 3 * k, 200], [400.0 - 3 * k, 250, 440 - 3 * k, 350]]
    )


def equal(a: Tracks, b: Tracks) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in FIELDS)


def feed(tracker: Tracker, frames) -> list[Tracks]:
    return [tracker.update(found) for found in frames]


def street() -> list[Detections]:
    """Frames of detections with clutter."""
    made = make_scene("street", 3, DetectorModel(clutter_rate=3), frames=60, lead_in=-4.0)
    return [made.detections.at(k) for k in range(1, 61)]


def two_people(count: int) -> list[np.ndarray]:
    """Two people who walk past each other, misses and false alarms."""
    rng = np.random.default_rng(5)
    out = []
    for k in range(count):
        boxes = np.array(
            [[100 + 4.0 * k, 100, 140 + 4.0 * k, 200], [500 - 3.0 * k, 220, 545 - 3.0 * k, 330]]
        )
        seen = (boxes + rng.normal(0, 1.5, (2, 4)))[rng.random(2) < 0.9]
        corner = rng.uniform([0, 0], [580, 380], (rng.poisson(0.5), 2))
        out.append(
            np.vstack([seen, np.hstack([corner, corner + rng.uniform(30, 60, corner.shape)])])
        )
    return out
