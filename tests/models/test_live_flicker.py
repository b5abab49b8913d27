"""Learning where a scene flickers while it is tracked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack import config
from phdtrack.models.clutter import ScoredClutter
from phdtrack.models.flicker_odds import FlickerOdds
from phdtrack.models.live_flicker import MEMORY, FlickerSeen, LiveFlicker
from phdtrack.scene.flicker import FlickerMap
from phdtrack.state import from_bytes, to_bytes, unpack
from phdtrack.types import Detections, SequenceInfo, Step, Tracks, UpdateInfo

FPS = 25.0
SIZE = (640.0, 360.0)
HERE = np.array([[285.0, 170.0, 315.0, 230.0]])
ELSEWHERE = HERE + 200
MODEL = config.build(config.load(), SequenceInfo(640, 360, FPS)).model


def step(number: int, boxes: np.ndarray, tracks: Tracks | None = None) -> Step:
    found = Detections.of(boxes)
    stages = config.build(config.load(), SequenceInfo(640, 360, FPS))
    nothing = stages.extractor.extract(
        stages.filter.start(MODEL, np.random.default_rng(0)), np.zeros((4, 0)), MODEL
    )
    return Step(
        number,
        number / FPS,
        found,
        UpdateInfo.without_update(0.0),
        nothing,
        Tracks.empty() if tracks is None else tracks,
        (0.0, 0.0, 0.0),
    )


def blinking(seconds: float, begin: int = 1, state: FlickerSeen | None = None) -> FlickerSeen:
    """The state after bursts of half a second, every two."""
    learning = LiveFlicker(SIZE)
    state = learning.start() if state is None else state
    empty = step(1, np.zeros((0, 4)))
    full = step(1, HERE)
    for k in range(begin, begin + int(seconds * FPS)):
        now = full if k % 50 < 12 else empty
        state = learning.advance(state, replace(now, number=k, time=k / FPS))
    return state


def odds(state: FlickerSeen, box: np.ndarray) -> float:
    model = LiveFlicker(SIZE).with_scores(state, MODEL, Detections.of(box))
    if not isinstance(model.clutter, ScoredClutter):
        return 1.0
    return float(model.clutter.odds[0])


def test_a_camera_learns_where_it_flickers_and_forgets() -> None:
    state = blinking(20)
    assert odds(state, HERE) == 1
    state = blinking(70, 501, state)
    assert odds(state, HERE) < 0.2
    assert odds(state, ELSEWHERE) == 1
    # Nothing flickers any more.
    learning = LiveFlicker(SIZE)
    later = 90 + 4 * MEMORY
    empty = step(1, np.zeros((0, 4)))
    for k in range(20):
        time = 90 + (later - 90) * (k + 1) / 20
        state = learning.advance(state, replace(empty, number=3000 + k, time=time))
    assert odds(state, HERE) == 1


def test_a_track_that_stays_counts_once() -> None:
    """Somebody sits for three minutes."""
    learning = LiveFlicker(SIZE)
    state = learning.start()
    rows = np.zeros(1, np.int64)
    for k in range(1, int(180 * FPS), 5):
        tracks = Tracks(np.array([k]), rows + 7, HERE, np.ones(1), rows, rows == 0)
        state = learning.advance(state, replace(step(1, HERE, tracks), number=k, time=k / FPS))
    assert state.learned.arrivals.max(initial=0.0) <= 1
    assert odds(state, HERE) == 1


def test_the_state_can_be_saved() -> None:
    state = blinking(40)
    packed = from_bytes(to_bytes(state), "state")
    again = unpack(packed, FlickerSeen, LiveFlicker(SIZE).start())
    assert odds(again, HERE) == odds(state, HERE) < 1
    assert (again.xyxy == state.xyxy).all()


def test_odds_multiply_those_of_scores() -> None:
    learned = blinking(60).learned
    plain = FlickerOdds(learned).with_scores(None, MODEL, Detections.of(HERE))
    scored = ScoredClutter(MODEL.clutter, np.array([0.5]), np.zeros(1))
    both = FlickerOdds(learned).with_scores(
        None, replace(MODEL, clutter=scored), Detections.of(HERE)
    )
    assert both.clutter.odds[0] == 0.5 * plain.clutter.odds[0]
    nothing = FlickerOdds(FlickerMap())
    assert nothing.with_scores(None, MODEL, Detections.of(HERE)) is MODEL
