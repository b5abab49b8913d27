"""Corrected tracks: false hypotheses undone, gaps bridged, short tracks left out, identities kept
at crossings.
"""

import numpy as np
import pytest
from association_cases import (
    links,
    matching_of,
    measured,
    model_of,
    run,
    same,
    states,
    table,
    walkers,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.types import Estimates, Tracks

seeds = st.integers(0, 2**32 - 1)
AT_REST = [[200.0, 200.0]]


def resting(frames: int) -> list[Estimates]:
    return [states(AT_REST, velocity=[[0, 0]]) for _ in range(frames)]


def names_by_source(result, who) -> tuple[dict[int, set[int]], dict[int, set[int]]]:
    """Which identities each target had, and which targets each identity, by the detections of the
    corrected tracks.
    """
    names = {}
    targets = {}
    for frame, name, detection in table(result.tracks):
        if detection >= 0:
            target = int(who[frame - 1][detection])
            names.setdefault(target, set()).add(name)
            targets.setdefault(name, set()).add(target)
    return names, targets


def false_hypothesis():
    """A target at rest is missed once, while a false alarm stands near it and seems to move away;
    then it is there again.
    """
    stray = states([[209.0, 200.0]], velocity=[[25.0, 0.0]])
    return [*resting(8), stray, *resting(8)]


def test_a_later_frame_undoes_a_false_link():
    result = run(matching_of(), false_hypothesis())
    assert (8, 7) in links(result.states[8]), "at its time the false alarm was the best link"
    assert (8, 7) not in links(result.states[9])
    assert (9, 7) in links(result.states[9])
    assert set(result.tracks.identity) == {1}
    ninth = result.tracks.select(result.tracks.frame == 9)
    assert ninth.detection.tolist() == [-1], "the false alarm is no part of the corrected track"
    np.testing.assert_allclose(ninth.xyxy, [[180, 180, 220, 220]], atol=1)


def test_with_a_delay_the_correction_is_in_the_online_rows_too():
    online = run(matching_of(output_delay=2), false_hypothesis()).online
    assert set(online.identity[(online.detection >= 0) & (online.frame != 9)]) == {1}
    ninth = online.select((online.frame == 9) & (online.detection >= 0))
    assert ninth.identity.tolist() != [1]
    assert not ninth.confirmed.any()


@pytest.mark.parametrize(
    ("gap", "interval", "joined"),
    [(1, 1.0, True), (9, 1.0, True), (10, 1.0, False), (9, 2.0, False)],
)
def test_span_closes_links(gap: int, interval: float, joined: bool):
    """10 frames at 25 Hz are 0.4 s: a state 10 frames back can still be linked, one 11 frames back
    cannot.
    """
    frames = [*resting(6), *[states([])] * gap, *resting(6)]
    patient = matching_of(window=0.4, loose_end_distance=8.0, miss=0.9)
    tracks = run(patient, frames, intervals=[interval] * len(frames)).tracks
    assert set(tracks.identity) == ({1} if joined else {1, 2})
    assert len(tracks) == 12 + (gap if joined else 0)


@pytest.mark.parametrize("seed", range(4))
def test_crossing_targets_keep_their_identities(seed: int):
    """They pass at half a box's height, from opposite sides, and come in random order."""
    rng = np.random.default_rng(seed)
    truth = [np.array([[200 + 3 * k, 200], [380 - 3 * k, 220]]) for k in range(60)]
    frames = []
    who = []
    for points in truth:
        order = rng.permutation(2)
        frames.append(
            states(
                (points + rng.normal(0, 1, (2, 2)))[order],
                velocity=np.array([[3, 0], [-3, 0]])[order],
            )
        )
        who.append(order)
    names, targets = names_by_source(run(matching_of(), frames), who)
    assert all(len(found) == 1 for found in (*names.values(), *targets.values()))


def occluded(gap: int) -> tuple[list[Estimates], np.ndarray]:
    """One target at constant velocity, hidden for ``gap`` frames in the middle; the true
    centres.
    """
    truth = np.array([[100 + 3.0 * k, 200 + 1.0 * k] for k in range(60 + gap)])
    hidden = range(30, 30 + gap)
    rng = np.random.default_rng(gap)
    frames = [
        states(
            [] if k in hidden else [p + rng.normal(0, 0.7, 2)],
            velocity=[] if k in hidden else [[3, 1]],
        )
        for k, p in enumerate(truth)
    ]
    return frames, truth


@pytest.mark.parametrize("gap", [1, 5, 20])
def test_an_occluded_target_is_bridged(gap: int):
    frames, truth = occluded(gap)
    tracks = run(matching_of(miss=0.9, loose_end_distance=6.0), frames).tracks
    assert set(tracks.identity) == {1}
    assert tracks.frame.tolist() == list(range(1, len(frames) + 1))
    np.testing.assert_array_equal(np.flatnonzero(tracks.detection < 0), np.arange(30, 30 + gap))
    np.testing.assert_array_equal(tracks.predicted, tracks.detection < 0)
    centre = (tracks.xyxy[:, :2] + tracks.xyxy[:, 2:]) / 2
    assert np.abs(centre - truth).max() < 4
    assert tracks.confirmed.all()
    assert ((tracks.confidence > 0) & (tracks.confidence <= 1)).all()
    bare = run(matching_of(miss=0.9, loose_end_distance=6.0, bridge_gaps=False), frames).tracks
    assert same(bare, tracks.select(tracks.detection >= 0))


@pytest.mark.parametrize(("shortest", "rows"), [(5, 0), (4, 6)])
def test_short_tracks_are_left_out(shortest: int, rows: int):
    """The length is counted in states and not in bridged rows."""
    frames = [*resting(2), states([]), states([]), *resting(2), states([])]
    assert (
        len(
            run(
                matching_of(min_track_length=shortest, miss=0.9, loose_end_distance=8.0), frames
            ).tracks
        )
        == rows
    )


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_identities_start_at_1_and_stand_once_in_a_frame(seed: int):
    frames, _ = walkers(np.random.default_rng(seed), 40, clutter=3.0)
    tracks = run(matching_of(min_track_length=3), frames).tracks
    assert set(tracks.identity) == set(range(1, len(set(tracks.identity)) + 1))
    assert len({*zip(tracks.frame, tracks.identity, strict=True)}) == len(tracks)
    np.testing.assert_array_equal(
        np.lexsort((tracks.identity, tracks.frame)), np.arange(len(tracks))
    )
    appears = [
        tracks.frame[tracks.identity == i].min()
        for i in range(1, tracks.identity.max(initial=0) + 1)
    ]
    assert appears == sorted(appears)
    used = [(frame, detection) for frame, _, detection in table(tracks) if detection >= 0]
    assert len(set(used)) == len(used), "a detection supports one row"


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_the_order_of_states_in_a_frame_does_not_matter(seed: int):
    rng = np.random.default_rng(seed)
    frames, _ = walkers(rng, 30, clutter=2.0)
    shuffled = []
    for estimates in frames:
        order = rng.permutation(len(estimates))
        rows = [
            part[order]
            for part in (
                estimates.covariance,
                estimates.weight,
                estimates.xyxy,
                estimates.detection,
            )
        ]
        shuffled.append(Estimates(np.ascontiguousarray(estimates.state[:, order]), *rows))

    def content(tracks: Tracks) -> set:
        groups = {}
        for (frame, name, detection), box in zip(table(tracks), tracks.xyxy, strict=True):
            groups.setdefault(name, []).append((frame, *np.round(box, 6).tolist(), detection))
        return {tuple(sorted(group)) for group in groups.values()}

    assert content(run(matching_of(), frames).tracks) == content(
        run(matching_of(), shuffled).tracks
    )


def test_writing_into_rows_that_were_given_changes_no_later_row():
    """People scale the boxes they get in place."""
    matching = matching_of()
    model = model_of()
    frames = resting(12)
    wanted = run(matching, frames).tracks
    state = matching.start()
    for number, estimates in enumerate(frames, 1):
        state, rows = matching.extend(state, estimates, *measured(estimates), number, 1.0, model)
        rows.xyxy[:] = -1
        rows.identity[:] = 99
        rows.confidence[:] = 0
    assert same(matching.finish(state, model), wanted)
