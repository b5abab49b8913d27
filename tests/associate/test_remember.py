"""What associators remember: every measurement, in little space, or a bounded past."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from association_cases import matching_of, measured, model_of, run, same, seen_as, states, walkers

from phdtrack.associate.history import CHUNK
from phdtrack.associate.labels import Labelled

MODEL = model_of()


def circling(frames: int):
    """Two targets on circles of 100 frames, missed now and then, and a false alarm: a cycle of
    frames, for ever.
    """
    rng = np.random.default_rng(0)
    cycle = []
    for k in range(100):
        angle = 2 * np.pi * k / 100 + np.array([0, np.pi])
        points = np.stack([300 + 120 * np.cos(angle), 240 + 120 * np.sin(angle)], axis=1)[
            rng.random(2) < 0.95
        ]
        cycle.append(states(np.vstack([points, rng.uniform(0, 200, (1, 2))])))
    return (cycle[k % 100] for k in range(frames))


@pytest.mark.slow
def test_the_state_stops_growing():
    """Over 10 000 frames: its bytes after 2000 are those after 10 000."""
    matching = matching_of(history=8.0, back_dating=3)
    state = matching_of().start()
    size = {}
    for number, estimates in enumerate(circling(10_000), start=1):
        state, _ = matching.extend(state, estimates, *measured(estimates), number, 1.0, MODEL)
        if number % 1000 == 0:
            size[number] = len(pickle.dumps(state))
            tracks = matching.finish(state, MODEL)
            held = number - tracks.frame.min() + 1
            assert 8 * 25 <= held <= 8 * 25 + 2 * CHUNK
            assert tracks.frame.max() == number
    assert max(size.values()) <= 1.1 * size[2000]


def test_what_is_remembered_is_as_if_all_were():
    """Online rows are the same; corrected tracks that begin after the forgotten past are too."""
    frames, _ = walkers(np.random.default_rng(1), 700, n=0, clutter=0.0)
    ended = [
        *walkers(np.random.default_rng(2), 60, n=3)[0],
        *frames[:400],
        *walkers(np.random.default_rng(3), 90, n=3)[0],
    ]
    whole = run(matching_of(output_delay=3), ended)
    part = run(matching_of(output_delay=3, history=5.0), ended)
    assert same(whole.online, part.online)
    assert whole.tracks.frame.min() < 60
    recent = whole.tracks.select(whole.tracks.frame > 460)
    assert part.tracks.frame.min() > 460
    assert len(recent) == len(part.tracks) > 200
    np.testing.assert_array_equal(recent.xyxy, part.tracks.xyxy)
    np.testing.assert_array_equal(recent.identity - recent.identity.min() + 1, part.tracks.identity)


@pytest.mark.parametrize("settings", [{"output_delay": 40}, {"window": 6.0}, {"max_coast": 9.0}])
def test_what_open_links_rest_on_is_never_forgotten(settings):
    frames, _ = walkers(np.random.default_rng(4), 500, n=2, p_seen=0.6)
    whole = run(matching_of(**settings), frames)
    part = run(matching_of(history=0.04, **settings), frames)
    assert same(whole.online, part.online)


def remembered(matching, rng: np.random.Generator, frames: int, moving: bool = False):
    """The state after so many frames, and the measurements that they brought: of some, states rest
    on a part.
    """
    state = matching.start()
    given = []
    for number in range(1, frames + 1):
        found = states(rng.uniform(50, 400, (int(rng.integers(0, 4)), 2)))
        found = replace(found, tag=np.arange(len(found)))
        z = np.hstack(
            [
                found.state[list(MODEL.sensor.observed)],
                rng.uniform(10, 90, (4, int(rng.integers(0, 3)))),
            ]
        )
        warp = np.eye(3) + np.array([[0, 0, number], [0, 0, 0], [0, 0, 0]]) * 0.1
        model = replace(MODEL, warp=warp) if moving and number > 1 else MODEL
        state, _ = matching.extend(state, found, z, seen_as(z), 2 * number, 1.5, model)
        given.append((2 * number, z, warp if moving and number > 1 else np.eye(3)))
    return state, given


@pytest.mark.parametrize("matching", [matching_of(), Labelled()], ids=["graph", "labelled"])
@pytest.mark.parametrize("frames", [0, 1, 2 * CHUNK + 3])
@pytest.mark.parametrize("moving", [False, True])
def test_every_measurement_is_remembered(matching, frames: int, moving: bool, rng):
    state, given = remembered(matching, rng, frames, moving)
    measured = matching.measurements(state)
    assert measured.number.tolist() == [number for number, _, _ in given]
    np.testing.assert_allclose(np.diff(measured.time), 1.5)
    assert len(measured.start) == frames + 1
    for place, (_, z, warp) in enumerate(given):
        np.testing.assert_array_equal(
            measured.z[:, measured.start[place] : measured.start[place + 1]], z
        )
        if len(measured.warp):
            np.testing.assert_array_equal(measured.warp[place], warp)
    assert len(measured.warp) == (frames if moving and frames > 1 else 0)


@pytest.mark.parametrize(
    "matching", [matching_of(history=0.5), Labelled(history=0.5)], ids=["graph", "labelled"]
)
def test_what_is_forgotten_is_measured_no_more(matching, rng):
    frames = 6 * CHUNK
    state, given = remembered(matching, rng, frames)
    measured = matching.measurements(state)
    assert CHUNK <= len(measured.number) < frames
    kept = given[-len(measured.number) :]
    assert measured.number.tolist() == [number for number, _, _ in kept]
    np.testing.assert_array_equal(measured.z, np.hstack([z for _, z, _ in kept]))
