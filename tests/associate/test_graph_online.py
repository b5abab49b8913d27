"""Online rows: given once, never changed, each identity once in a frame; delay, confirmation,
coasting.
"""

import numpy as np
import pytest
from association_cases import (
    HEIGHT,
    WIDTH,
    links,
    matching_of,
    model_of,
    run,
    scattered,
    seen_as,
    states,
    table,
    walkers,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.types import Detections, Estimates

seeds = st.integers(0, 2**32 - 1)
# Hardly ever seen and hardly ever gone: a missing target is waited for as long as is allowed.
PATIENT = model_of(survival_probability=0.999**25, detection=0.3)


def moving(frames: int, *, start=(100.0, 200.0), velocity=(3.0, 0.0)) -> list[Estimates]:
    begin = np.array(start)
    step = np.array(velocity)
    return [states([begin + k * step], velocity=[step]) for k in range(frames)]


@given(seeds, st.integers(0, 12), st.floats(0.1, 3.0))
@settings(max_examples=40, deadline=None)
def test_every_state_is_given_once_and_identities_are_unique(seed: int, delay: int, span: float):
    """Also where corrections make two states claim one identity, and where the delay is longer than
    the window.
    """
    rng = np.random.default_rng(seed)
    frames = scattered(rng, 25, 4, side=60)
    matching = matching_of(
        output_delay=delay, window=span, min_track_length=3, miss=0.7, loose_end_distance=5.0
    )
    online = run(matching, frames).online
    seen = online.select(online.detection >= 0)
    wanted = [(k, i) for k, f in enumerate(frames, 1) for i in range(len(f))]
    assert sorted(zip(seen.frame.tolist(), seen.detection.tolist(), strict=True)) == wanted
    assert len({*zip(online.frame.tolist(), online.identity.tolist(), strict=True)}) == len(online)
    assert online.identity.min(initial=1) >= 1
    assert set(seen.identity) == set(range(1, len(set(seen.identity)) + 1)), (
        "identities are numbered without holes"
    )
    for name in set(online.identity):
        confirmed = online.confirmed[online.identity == name]
        assert not (confirmed[:-1] & ~confirmed[1:]).any(), "once confirmed, always confirmed"


@pytest.mark.parametrize("delay", [0, 3])
def test_frames_without_detector_between_corrected_links(delay: int):
    """An identity may have lost the state that follows its last one to another identity."""
    matching = matching_of(min_track_length=2, miss=0.7, loose_end_distance=5.0, output_delay=delay)
    model = model_of()
    for seed in range(20):
        frames = scattered(np.random.default_rng(seed), 15, 4, side=60)
        state = matching.start()
        plain = matching.start()
        for k, estimates in enumerate(frames):
            z = estimates.state[list(model.sensor.observed)]
            seen = seen_as(z)
            state, rows = matching.extend(state, estimates, z, seen, 2 * k + 1, 1.0, model)
            plain, _ = matching.extend(plain, estimates, z, seen, 2 * k + 1, 1.0, model)
            gap = Detections.empty(observed=False)
            state, between = matching.extend(state, estimates, z, gap, 2 * k + 2, 0.5, model)
            for part in (rows, between):
                assert len(np.unique(part.identity)) == len(part)
        assert links(state) == links(plain)


@given(seeds, st.integers(3, 9))
@settings(max_examples=20, deadline=None)
def test_a_window_shorter_than_the_delay_loses_no_link(seed: int, delay: int):
    """Links that became final while their rows were held back hold for the rows all the same."""
    frames, _ = walkers(np.random.default_rng(seed), 30, n=2, clutter=0.5)
    result = run(matching_of(output_delay=delay, window=0.08), frames)
    first = np.cumsum([0, *(len(f) for f in frames)])
    name = {
        first[frame - 1] + detection: i
        for frame, i, detection in table(result.online)
        if detection >= 0
    }
    final = run(matching_of(window=0.08), frames).states[-1]
    settled = {(b, a) for b, a in links(final) if b < first[-delay - 1]}
    assert all(name[b] == name[a] for b, a in settled)


def test_pause_longer_than_window_keeps_delayed_rows():
    frames = [*moving(8), *moving(8, start=(400.0, 100.0))]
    intervals = [1.0] * 8 + [100.0] + [1.0] * 7
    result = run(matching_of(output_delay=4), frames, intervals=intervals)
    assert result.online.identity.tolist() == [1] * 8 + [2] * 8


@pytest.mark.parametrize("delay", [0, 1, 7])
def test_output_lags_exactly_the_delay(delay: int):
    result = run(matching_of(output_delay=delay), moving(20))
    for number, rows in enumerate(result.emitted, start=1):
        assert rows.frame.tolist() == ([number - delay] if number > delay else [])
    assert result.flushed.frame.tolist() == list(range(21 - delay, 21))
    assert len(run(matching_of(output_delay=delay), moving(3)).online) == 3
    assert len(matching_of(output_delay=delay).flush(matching_of().start(), model_of())) == 0


def test_confirmed_from_the_fifth_state_on_or_by_what_follows():
    for delay, early in ((0, 4), (2, 2), (4, 0), (9, 0)):
        online = run(matching_of(output_delay=delay, min_track_length=5), moving(12)).online
        assert (~online.confirmed).tolist() == [True] * early + [False] * (12 - early)
    assert not run(
        matching_of(output_delay=9, min_track_length=5), moving(4)
    ).online.confirmed.any()
    frames = [*moving(3), states([]), *moving(3, start=(112.0, 200.0))]
    with_gap = run(matching_of(min_track_length=5, miss=0.9), frames).online
    assert with_gap.frame.tolist() == [1, 2, 3, 5, 6, 7], "an unconfirmed track is not continued"
    assert with_gap.confirmed.tolist() == [False] * 4 + [True] * 2


def test_a_missed_target_is_continued_for_as_long_as_coast():
    online = run(matching_of(max_coast=0.3), [*moving(10), *[states([])] * 20], PATIENT).online
    coasted = online.select(online.detection < 0)
    assert coasted.frame.tolist() == list(range(11, 18)), "0.3 s at 25 Hz are 7 frames"
    assert set(coasted.identity) == {1}
    assert coasted.confirmed.all()
    centre = (coasted.xyxy[:, :2] + coasted.xyxy[:, 2:]) / 2
    np.testing.assert_allclose(centre, [[100 + 3 * k, 200] for k in range(10, 17)], atol=1e-9)
    assert (np.diff(coasted.confidence) < 0).all()
    slow = run(
        matching_of(max_coast=0.3),
        [*moving(10), *[states([])] * 20],
        PATIENT,
        [1.0] * 10 + [3.5] * 20,
    ).online
    assert slow.frame[slow.detection < 0].tolist() == [11, 12]


@pytest.mark.parametrize("settings", [{"max_coast": 0.0}, {"bridge_gaps": False}])
def test_nothing_is_continued_when_told_not_to(settings):
    online = run(matching_of(**settings), [*moving(10), *[states([])] * 5], PATIENT).online
    assert (online.detection >= 0).all()


def test_a_target_that_leaves_the_frame_is_not_continued():
    leaving = moving(10, start=(WIDTH - 70.0, HEIGHT / 2), velocity=(6.0, 0.0))
    online = run(matching_of(max_coast=2.0), [*leaving, *[states([])] * 20], PATIENT).online
    last = online.xyxy[online.detection < 0]
    assert (last[:, 0] < WIDTH).all()
    assert online.frame.max() == 15, "in the sixteenth its left edge would be at the border"


def test_a_delay_bridges_the_gap_that_it_sees_the_end_of():
    """The rows lie where the corrected tracks have them, not where the motion model alone would."""
    swerving = [*moving(10), *[states([])] * 4, *moving(8, start=(150.0, 206.0))]
    result = run(matching_of(output_delay=6, miss=0.9, loose_end_distance=6.0), swerving)
    filled = result.online.select(result.online.detection < 0)
    corrected = result.tracks.select(result.tracks.detection < 0)
    assert filled.frame.tolist() == corrected.frame.tolist() == [11, 12, 13, 14]
    assert (np.diff(filled.xyxy[:, 1]) > 0).all(), "drawn to where it was seen again"
    np.testing.assert_allclose(filled.xyxy, corrected.xyxy, atol=1e-9)


@pytest.mark.parametrize(("delay", "ghosts"), [(0, 7), (3, 4), (7, 0), (12, 0)])
def test_a_delay_ends_what_it_knows_to_have_ended(delay: int, ghosts: int):
    online = run(
        matching_of(output_delay=delay, max_coast=0.3), [*moving(10), *[states([])] * 20], PATIENT
    ).online
    assert online.predicted.sum() == ghosts


def flickering(gap: int, times: int) -> list[Estimates]:
    """A target that is seen ten times, then missed ``gap`` times, and so on; after the last gap it
    is gone.
    """
    seen = [(k % (10 + gap)) < 10 for k in range(times * (10 + gap))]
    frames = moving(len(seen), velocity=(1.0, 0.0))
    return [
        *(f if s else states([]) for f, s in zip(frames, seen, strict=True)),
        *[states([])] * 20,
    ]


def test_missing_tracks_coast_as_long_as_others_came_back():
    """By the model's p_D of 0.95 a target missed twice has gone; where gaps of four frames are
    filled, it has not.
    """
    online = run(
        matching_of(max_coast=1.0, miss=0.95, loose_end_distance=6.0), flickering(4, 6)
    ).online
    assert set(online.identity) == {1}
    filled = [int(np.isin(np.arange(11, 15) + 14 * k, online.frame).sum()) for k in range(6)]
    assert filled[0] == 1
    assert filled[2:] == [4, 4, 4, 4]
    assert online.frame.max() == 6 * 14, "no track came back after five"


def test_who_does_not_come_back_is_soon_not_waited_for():
    """One target after the other ends for good; the model thinks that they are only missed."""
    frames: list[Estimates] = []
    for k in range(8):
        frames += [*moving(10, start=(60.0 * k + 60.0, 200.0)), *[states([])] * 10]
    online = run(
        matching_of(max_coast=0.4), frames, model_of(survival_probability=0.99**25, detection=0.5)
    ).online
    ghosts = [
        int((online.predicted & (online.frame > 20 * k) & (online.frame <= 20 * k + 20)).sum())
        for k in range(8)
    ]
    assert ghosts[0] >= 4
    assert ghosts[-1] < ghosts[0]
    assert (np.diff(ghosts) <= 0).all()
