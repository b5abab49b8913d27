"""Frames in which no detector ran change nothing but the rows that are shown in them: a stream of
which every fifth frame is observed is tracked as one of a fifth as many frames.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from phdtrack import Detections, Tracker, Tracks
from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.models.warp import after, warp_states
from phdtrack.types import STILL

KINDS = ["pmb", "gm-phd", "mht", "pmbm", "mcmc", "particle-phd", "none"]
EVERY = 5
OBSERVED = 24
UNSEEN = Detections.empty(observed=False)
# How a camera moves from each frame to the next.
MOVING = np.array([[1.001, 0.0, 1.5], [0.0, 1.001, -0.8], [0.0, 0.0, 1.0]])
TURNING = np.array([[1.001, 0.001, 1.5], [-0.001, 1.001, -0.8], [0.0, 0.0, 1.0]])
CAMERAS = {"still": STILL, "moving": MOVING}


class Update(NamedTuple):
    """The arguments of an update."""

    found: np.ndarray | Detections
    frame: int | None
    warp: np.ndarray | None


def boxes(camera: np.ndarray) -> list[np.ndarray]:
    """Two people who walk, missed now and then, and some false alarms, in the pixels of the
    observed frames.
    """
    rng = np.random.default_rng(3)
    out = []
    place = np.eye(3)
    for k in range(OBSERVED):
        x = 8.0 * k
        people = np.array([[200 + x, 200, 240 + x, 300], [700 - x, 350, 740 - x, 450]])
        people += rng.normal(0, 1, (2, 4))
        # The second is away for three frames; both are missed in a tenth of the frames.
        seen = (rng.random(2) > 0.1) | (k < 6)
        seen[1] &= k not in (12, 13, 14)
        alarms = rng.uniform(50, 500, (int(rng.random() < 0.3), 2))
        world = to_cxcywh(np.vstack([people[seen], np.hstack([alarms, alarms + 60])]))
        still = np.zeros_like(world[:2])
        out.append(
            to_xyxy(warp_states(np.vstack([world[:2], still, world[2:]]), place)[[0, 1, 4, 5]])
        )
        place = after([place, *[camera] * EVERY])
    return out


def left_out(camera: np.ndarray) -> list[Update]:
    """The observed frames by their numbers."""
    whole = after([camera] * EVERY) if len(camera) else None
    return [Update(found, 1 + EVERY * k, whole) for k, found in enumerate(boxes(camera))]


def unobserved(camera: np.ndarray) -> list[Update]:
    """All frames, those between as unobserved ones."""
    one = camera if len(camera) else None
    out = []
    for found in boxes(camera):
        out += [Update(found, None, one), *[Update(UNSEEN, None, one)] * (EVERY - 1)]
    return out


def slow(camera: np.ndarray) -> list[Update]:
    """The observed frames as a stream of a fifth as many frames a second."""
    return [update._replace(frame=None) for update in left_out(camera)]


def tracker_of(kind: str, fps: float = 25.0, **settings) -> Tracker:
    own = {"filter": {"kind": kind}}
    if kind == "mcmc":
        own["filter"]["samples"] = 200
    elif kind == "particle-phd":
        own["filter"]["particles_per_target"] = 200
        own["birth"] = {"particles": 200}
    return Tracker((1280, 720), fps=fps, **own, **settings)


def fed(tracker: Tracker, updates: list[Update]) -> tuple[Tracks, Tracks]:
    """Online rows and corrected tracks."""
    rows = [tracker.update(*update[:2], warp=update.warp) for update in updates]
    return Tracks.concatenate([*rows, tracker.flush()]), tracker.tracks()


def observed(rows: Tracks) -> Tracks:
    """The rows in observed frames."""
    return rows.select(rows.frame % EVERY == 1)


def check_same(a: Tracks, b: Tracks, tolerance: float = 1e-6) -> None:
    """The same rows, the identities up to their names."""
    assert len(a) > OBSERVED
    assert len(a) == len(b)
    assert len(set(zip(a.identity.tolist(), b.identity.tolist(), strict=True))) == len(
        set(a.identity.tolist())
    ), "one name for another"
    for name in ("frame", "detection", "confirmed"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    np.testing.assert_allclose(a.xyxy, b.xyxy, rtol=0, atol=tolerance)
    np.testing.assert_allclose(a.confidence, b.confidence, atol=1e-6)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", KINDS)
def test_unobserved_frames_are_as_frames_left_out(kind: str, camera: str) -> None:
    motion = CAMERAS[camera]
    by_number = fed(tracker_of(kind), left_out(motion))
    by_mark = fed(tracker_of(kind), unobserved(motion))
    by_rate = fed(tracker_of(kind, 25.0 / EVERY), slow(motion))
    for numbered, marked, slower in zip(by_number, by_mark, by_rate, strict=True):
        check_same(numbered, observed(marked))
        check_same(numbered, replace(slower, frame=1 + EVERY * (slower.frame - 1)))


def test_what_a_stream_teaches_of_births_and_clutter_is_the_same() -> None:
    """However the frames between are left out."""
    taught = []
    for fps, updates in ((25.0, left_out(STILL)), (25.0, unobserved(STILL)), (5.0, slow(STILL))):
        tracker = tracker_of("pmb", fps)
        fed(tracker, updates)
        state = tracker.state
        scores = state.detection_scores
        taught.append([state.intensity.hidden, *scores.near, *scores.near_alone, *scores.alone])
    np.testing.assert_allclose(taught[1], taught[0], rtol=1e-9)
    np.testing.assert_allclose(taught[2], taught[0], rtol=1e-9)
    assert taught[0][0] > 0


@pytest.mark.parametrize("mark", ["left out", "unobserved"])
def test_slow_detectors_show_objects_at_the_second_detection(mark: str) -> None:
    """Walkers at 25 frames a second, of whom the detector sees every 14th frame; most of them were
    not there in the first one.
    """
    rng = np.random.default_rng(2)
    tracker = Tracker((1920, 1080), fps=25)
    shown = []
    for k in range(0, 14 * 5, 14):
        x = np.array([200, 600, 1000, 1400]) + 1.5 * k
        found = np.stack([x, 0 * x + 300, x + 60, 0 * x + 460], axis=1)
        found += rng.normal(0, 2, found.shape)
        begun = 1 if k == 0 else 4
        rows = tracker.update(found[:begun], 1 + k)
        shown.append(len(rows))
        if mark == "unobserved":
            for between in range(1, 14):
                tracker.update(UNSEEN, 1 + k + between)
    assert shown[2:] == [4, 4, 4]


@pytest.mark.parametrize("kind", KINDS)
def test_unobserved_frames_under_a_turning_camera(kind: str) -> None:
    numbered, corrected = fed(tracker_of(kind), left_out(TURNING))
    marked, smoothed = fed(tracker_of(kind), unobserved(TURNING))
    check_same(numbered, observed(marked))
    # Noises of a target's two directions are mixed in each frame, not once in five.
    check_same(corrected, observed(smoothed), tolerance=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_a_state_saved_at_an_unobserved_frame_goes_on_the_same(kind: str) -> None:
    updates = unobserved(MOVING)[:60]
    whole = tracker_of(kind)
    fed(whole, updates)
    first = tracker_of(kind)
    fed(first, updates[:33])
    second = tracker_of(kind)
    second.load_state_dict(first.state_dict())
    fed(second, updates[33:])
    for a, b in ((whole.tracks(), second.tracks()), (whole.flush(), second.flush())):
        np.testing.assert_array_equal(a.xyxy, b.xyxy)
        np.testing.assert_array_equal(a.identity, b.identity)
    np.testing.assert_array_equal(whole.step.tracks.xyxy, second.step.tracks.xyxy)


@pytest.mark.parametrize("second", [0, 2, 7])
def test_later_classes_begin_the_same_with_unobserved_frames(second: int) -> None:
    def classed(updates: list[Update]) -> list[Update]:
        out = []
        for update in updates:
            found = update.found
            if isinstance(found, np.ndarray):
                label = np.where(found[:, 1] > 250, second, 0)
                found = np.column_stack([found, np.full(len(found), 0.9), label])
            out.append(update._replace(found=found))
        return out[20:] if len(out) > OBSERVED else out[4:]

    numbered = fed(tracker_of("pmb"), classed(left_out(MOVING)))
    marked = fed(tracker_of("pmb"), [Update(UNSEEN, 20, None), *classed(unobserved(MOVING))])
    for rows, others in zip(numbered, marked, strict=True):
        check_same(rows, observed(others))


@pytest.mark.parametrize("kind", KINDS)
def test_unobserved_frames_before_the_first_change_nothing(kind: str) -> None:
    plain = tracker_of(kind)
    later = tracker_of(kind)
    for _ in range(3):
        assert len(later.update(UNSEEN, warp=MOVING)) == 0
    updates = left_out(MOVING)
    shifted = [update._replace(frame=update.frame + 3) for update in updates]
    for rows, others in zip(fed(plain, updates), fed(later, shifted), strict=True):
        check_same(rows, replace(others, frame=others.frame - 3))


# Nothing is computed for such frames but rows: by labels, or by the graph.
ROWS = ("pmb", "gm-phd")


@pytest.mark.parametrize(
    "kind", [*ROWS, *(pytest.param(k, marks=pytest.mark.slow) for k in KINDS if k not in ROWS)]
)
def test_a_thousand_unobserved_frames_stay_bounded_and_fast(kind: str) -> None:
    plain = tracker_of(kind)
    paused = tracker_of(kind)
    updates = left_out(STILL)[:12]
    fed(plain, updates)
    fed(paused, updates)
    last = paused.state.number
    intensity = paused.state.intensity
    began = time.perf_counter()
    for _ in range(1000):
        assert len(paused.update(UNSEEN)) <= 2
    assert time.perf_counter() - began < 20.0
    assert paused.state.intensity is intensity
    remembered = paused.stages.associator.measurements(paused.state.association)
    assert len(remembered.number) < 400
    found = updates[-1].found
    resumed = paused.update(found)
    alone = plain.update(found, last + 1001)
    np.testing.assert_allclose(resumed.xyxy, alone.xyxy, atol=1e-6)
    np.testing.assert_array_equal(resumed.identity, alone.identity)


@pytest.mark.parametrize("kind", KINDS)
def test_a_delay_gives_every_row_of_observed_frames_once(kind: str) -> None:
    plain, _ = fed(tracker_of(kind), unobserved(STILL))
    for delay in (1, 7):
        settings = {"associate": {"output_delay": delay}}
        delayed, _ = fed(tracker_of(kind, **settings), unobserved(STILL))
        pairs = list(zip(delayed.frame.tolist(), delayed.identity.tolist(), strict=True))
        assert len(set(pairs)) == len(pairs)
        assert (np.diff(delayed.frame) >= 0).all()
        seen = delayed.select(delayed.detection >= 0)
        assert set(seen.frame.tolist()) >= set(plain.frame[plain.detection >= 0].tolist())
        assert (seen.frame % EVERY == 1).all()


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", KINDS)
def test_corrected_tracks_go_on_through_unobserved_frames(kind: str, camera: str) -> None:
    updates = unobserved(CAMERAS[camera])
    _, tracks = fed(tracker_of(kind), updates)
    for identity in np.unique(tracks.identity):
        frames = np.sort(tracks.frame[tracks.identity == identity])
        np.testing.assert_array_equal(frames, np.arange(frames[0], frames[-1] + 1))
    assert (tracks.detection[tracks.frame % EVERY != 1] == -1).all()
    _, sparse = fed(tracker_of(kind, associate={"bridge_gaps": False}), updates)
    assert (sparse.frame % EVERY == 1).all()


@pytest.mark.parametrize("every", [2, 5, 12])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "mcmc"])
def test_tracks_go_on_until_the_detector_is_overdue(kind: str, every: int) -> None:
    """A walker at 25 frames a second; the detector runs in every so many frames, then no more. A
    predicted row is as near as the walker's next steps can be known.
    """
    rng = np.random.default_rng(0)
    tracker = Tracker((1280, 720), fps=25, filter=kind, seed=1)
    last = 12 * every
    shown = []
    for k in range(last + 4 * every):
        box = np.array([[50 + 2.5 * k, 300, 110 + 2.5 * k, 480]])
        runs = k % every == 0 and k <= last
        rows = tracker.update(box + rng.normal(0, 1, (1, 4)) if runs else UNSEEN)
        shown.append(len(rows))
        if k <= last and kind != "none":
            assert (np.abs(rows.xyxy - box) < 15).all()
    assert shown[8 * every : last + 1] == [1] * (4 * every + 1)
    overdue = last + 1 + 3 * every // 2
    assert shown[last:overdue] == [1] * (overdue - last)
    # Tracks that the detector has missed may go on for 0.2 s.
    assert not any(shown[max(overdue, last + 6) :])


@pytest.mark.parametrize("kind", KINDS)
def test_motions_of_unobserved_frames_add_up(kind: str) -> None:
    plain = tracker_of(kind)
    marked = tracker_of(kind)
    steps = []
    for numbered, update in zip(left_out(MOVING)[:8], boxes(MOVING), strict=False):
        plain.update(*numbered[:2], warp=numbered.warp)
        marked.update(update, warp=MOVING)
        steps.append(marked.step.warp)
        np.testing.assert_allclose(after(steps), after([plain.step.warp]), atol=1e-6)
        steps = []
        for _ in range(EVERY - 1):
            marked.update(UNSEEN, warp=MOVING)
            steps.append(marked.step.warp)
