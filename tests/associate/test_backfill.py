"""A confirmed target is led back through the detections that no state rested on."""

import numpy as np
import pytest
from association_cases import matching_of, model_of, run, states

from phdtrack.arrays import to_cxcywh
from phdtrack.types import Estimates, Tracks
from reference import graph_twin as twin

MODEL = model_of()
NONE = states([])


def measured(*points, size: float = 40.0) -> np.ndarray:
    xy = np.asarray(points, np.float64).reshape(-1, 2).T
    return np.vstack([xy, np.full((2, xy.shape[1]), size)])


def tracked(frames, model=MODEL, **settings) -> Tracks:
    """Corrected tracks of a sequence of (states, measurements)."""
    estimates, measured = zip(*frames, strict=True)
    return run(matching_of(**settings), estimates, model, shown=measured).tracks


def walker(begin: int, frames: int = 20, *, stray=()) -> list[tuple[Estimates, np.ndarray]]:
    """One target at 3 pixels a frame, detected always, a state from frame ``begin`` (from 0) on;
    strays first.
    """
    out = []
    for k in range(frames):
        z = measured(*stray, (100 + 3 * k, 200))
        here = states([(100 + 3 * k, 200)], velocity=[(3, 0)]) if k >= begin else NONE
        own = np.full(len(here), len(stray))
        out.append((Estimates(here.state, here.covariance, here.weight, here.xyxy, own), z))
    return out


@pytest.mark.parametrize(
    ("late", "most", "rows"), [(3, 5, 3), (5, 5, 5), (8, 5, 5), (3, 0, 0), (3, 2, 2)]
)
def test_a_track_begins_at_the_detections_that_started_it(late: int, most: int, rows: int):
    tracks = tracked(walker(late), back_dating=most)
    assert set(tracks.identity) == {1}
    assert tracks.frame.tolist() == list(range(late - rows + 1, 21))
    assert (tracks.detection == 0).all()
    centre = to_cxcywh(tracks.xyxy)[0]
    np.testing.assert_allclose(centre, 100 + 3 * (tracks.frame - 1), atol=1e-6)


def test_it_takes_the_detection_that_the_state_predicts():
    tracks = tracked(walker(4, stray=[(300, 300), (150, 260)]), back_dating=5)
    assert tracks.frame.tolist() == list(range(1, 21))
    assert (tracks.detection == 2).all()


def test_it_stops_where_there_is_none():
    frames = walker(5)
    for left in (measured((300, 300)), measured()):
        frames[2] = (NONE, left)
        assert tracked(frames, back_dating=5).frame.tolist() == list(range(4, 21))


def test_states_are_counted_with_what_leads_to_them():
    """Three states and two detections before them make five."""
    frames = [*walker(2, 5), *[(NONE, measured())] * 3]
    assert tracked(frames, back_dating=5, min_track_length=5).frame.tolist() == [1, 2, 3, 4, 5]
    assert len(tracked(frames, back_dating=0, min_track_length=5)) == 0


def test_two_tracks_do_not_share_a_detection():
    frames = []
    for k in range(14):
        z = measured((200, 200)) if k < 4 else measured((200, 200), (206, 204))
        here = states([(200, 200), (206, 204)], velocity=[(0, 0), (0, 0)]) if k >= 4 else NONE
        frames.append((here, z))
    tracks = tracked(frames, back_dating=5)
    assert len({*zip(tracks.frame.tolist(), tracks.detection.tolist(), strict=True)}) == len(tracks)
    assert (np.bincount(tracks.frame)[1:5] == 1).all()


def test_rows_are_the_conditional_means():
    """Each is the mean given the first state and all detections from its own frame on."""
    model = model_of(scaled_noise=False, acceleration=0.8, size_noise=1.0)
    rng = np.random.default_rng(1)
    frames = walker(4)
    noisy = np.hstack([z for _, z in frames[:4]]) + rng.normal(0, 2, (4, 4))
    frames[:4] = [(NONE, noisy[:, [k]]) for k in range(4)]
    first = frames[4][0]
    tracks = tracked(frames, model, back_dating=5)
    assert tracks.frame.tolist() == list(range(1, 21))
    wanted = twin.led_back(
        model.motion, model.sensor, first.state[:, 0], first.covariance[0], noisy, 1.0
    )
    np.testing.assert_allclose(tracks.xyxy[:4], model.sensor.boxes(wanted), atol=1e-8)
