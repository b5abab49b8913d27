"""After a gap without frames every filter's count is right: who was there has left, and few of
those born stayed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from phdtrack import Tracker
from phdtrack.models import PointBirth, PointMotion, PointSensor, UniformClutter
from phdtrack.protocols import LONGEST_LIFE, Model

KINDS = ["pmb", "pmbm", "mht", "gm-phd", "gm-cphd", "particle-phd", "particle-cphd", "mcmc"]
NONE = np.zeros((0, 4))


def boxes(rng: np.random.Generator) -> np.ndarray:
    left = 100.0 + 200.0 * np.arange(5)
    return np.column_stack([left, np.full(5, 100.0), left + 40, np.full(5, 200.0)]) + rng.normal(
        0, 1, (5, 4)
    )


def mass(tracker: Tracker) -> float:
    assert tracker.step is not None
    return tracker.step.info.mass


@cache
def before_the_gap(kind: str) -> tuple[dict[str, Any], float]:
    """The state of a tracker after 30 frames of five people, and its expected number of targets."""
    tracker = Tracker((1280, 720), fps=25, filter=kind)
    rng = np.random.default_rng(0)
    for _ in range(30):
        tracker.update(boxes(rng))
    return tracker.state_dict(), mass(tracker)


@pytest.mark.parametrize("gap", [1.0, 3600.0, 12 * 3600.0, 30 * 86400.0])
@pytest.mark.parametrize("kind", KINDS)
def test_the_count_after_a_gap_is_right(kind: str, gap: float) -> None:
    state, settled = before_the_gap(kind)
    for seen in (True, False):
        tracker = Tracker((1280, 720), fps=25, filter=kind)
        tracker.load_state_dict(state)
        rng = np.random.default_rng(1)
        time = 30 / 25 + gap
        for k in range(20):
            tracker.update(boxes(rng) if seen else NONE, 31 + k, time + k / 25)
            # A birth is believed after a second sighting; nobody is believed in for long who is
            # never seen.
            assert mass(tracker) <= 1.5 * settled
        assert mass(tracker) == pytest.approx(settled if seen else 0.0, abs=0.3)


WORLDS = {
    "scores": {"detection_scores": {"kind": "scores"}},
    "ground": {"motion": {"kind": "plane"}, "sensor": {"scaling": "fixed", "fixed_noise": 1.0}},
}


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("kind", ["pmb", "gm-phd", "gm-cphd"])
def test_a_month_without_a_frame_is_no_more_work_than_a_frame(kind: str, world: str) -> None:
    for seen in (True, False):
        tracker = Tracker((1280, 720), filter=kind, **({"fps": 25.0} | WORLDS[world]))
        rng = np.random.default_rng(0)
        held = 0
        most = 0.0
        for _ in range(30):
            tracker.update(boxes(rng))
            held = max(held, len(tracker.state.intensity))
            most = max(most, mass(tracker))
        time = tracker.state.time + 30 * 86400.0
        for k in range(20):
            tracker.update(boxes(rng) if seen else NONE, 31 + k, time + k / tracker.fps)
            assert len(tracker.state.intensity) <= held
            assert mass(tracker) <= 1.5 * most
        assert mass(tracker) == pytest.approx(most if seen else 0.0, abs=1.0)


@pytest.mark.parametrize("survival", [0.5, 0.99, 1.0])
def test_birth_seconds_are_the_integral_of_survival(survival: float) -> None:
    model = Model(
        PointMotion(survival_probability=survival),
        PointSensor(),
        PointBirth(),
        UniformClutter(1.0, 1.0),
        rate=25.0,
    )
    for seconds in (0.04, 1.0):
        assert model.birth_seconds(25.0 * seconds) == seconds
    life = min(survival, float(np.exp(-1 / LONGEST_LIFE)))
    for seconds in (2.0, 60.0, 3600.0):
        at = np.linspace(1.0, seconds, 200_001)
        wanted = 1.0 + np.trapezoid(life**at, at)
        assert model.birth_seconds(25.0 * seconds) == pytest.approx(wanted, rel=1e-4)
        assert model.survival(25.0 * seconds) == pytest.approx(life**seconds)
        slower = replace(model, pace=0.2)
        assert slower.survival(5.0 * seconds) == pytest.approx(life**seconds)
