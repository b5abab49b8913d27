"""Identities by the filter's labels: what is given online, what is revised, what the corrected
tracks are.
"""

from dataclasses import replace

import numpy as np
import pytest
from association_cases import measured, model_of, run, same, states, table

from phdtrack.associate.labels import Labelled, LabelledState
from phdtrack.errors import InputError
from phdtrack.state import from_bytes, to_bytes, unpack
from phdtrack.types import Estimates

MODEL = model_of()
PLAIN = Labelled(min_track_length=3, output_delay=0, max_coast=0.2, bridge_gaps=True)


def seen(*targets: tuple[int, float] | tuple[int, float, int], weight=None) -> Estimates:
    """States (label, x[, detection]) at y = 100, the i-th on detection i unless said otherwise."""
    x = [target[1] for target in targets]
    found = states(
        np.column_stack([x, np.full(len(x), 100.0)]), velocity=np.tile([5.0, 0.0], (len(x), 1))
    )
    rests = [target[2] if len(target) == 3 else i for i, target in enumerate(targets)]
    mass = np.ones(len(x)) if weight is None else np.asarray(weight, np.float64)
    return replace(
        found,
        tag=np.array([t[0] for t in targets], np.int64),
        detection=np.array(rests, np.int64),
        weight=mass,
    )


def with_past(frames: list[Estimates], depth: int) -> list[Estimates]:
    return [replace(e, past=tuple(frames[max(0, k - depth) : k])) for k, e in enumerate(frames)]


def test_a_label_is_an_identity_from_one_in_order_of_appearance():
    frames = [
        seen((70, 10.0 + 5 * k), (12, 300.0), *([(5, 500.0)] if k > 1 else [])) for k in range(6)
    ]
    result = run(PLAIN, frames)
    assert [rows.identity.tolist() for rows in result.emitted] == [[1, 2]] * 2 + [[1, 2, 3]] * 4
    assert result.online.confirmed[result.online.identity == 1].tolist() == [False] * 2 + [True] * 4
    assert result.online.confirmed[result.online.identity == 3].tolist() == [False] * 2 + [True] * 2
    assert table(result.tracks) == [
        (k + 1, i + 1, i) for k in range(6) for i in range(3 if k > 1 else 2)
    ]
    np.testing.assert_array_equal(result.tracks.xyxy[0], frames[0].xyxy[0])


def test_short_tracks_are_dropped_and_identities_renumbered():
    frames = [seen((1, 10.0), (2, 300.0)) if k < 2 else seen((2, 300.0)) for k in range(4)]
    assert table(run(PLAIN, frames).tracks) == [(1, 1, 1), (2, 1, 1), (3, 1, 0), (4, 1, 0)]
    assert len(run(replace(PLAIN, min_track_length=1), frames).tracks) == 6


def test_track_ends_with_its_last_detection():
    frames = [seen((1, 10.0 + 5 * k, 0 if k in (0, 3, 4) else -1)) for k in range(12)]
    result = run(PLAIN, frames)
    # Confirmed with the third detection; then 0.2 s = 5 time units of coasting.
    assert result.online.frame.tolist() == [1, *range(4, 11)]
    assert result.online.confirmed.tolist() == [False] * 2 + [True] * 6
    assert table(result.tracks) == [(1, 1, 0), (2, 1, -1), (3, 1, -1), (4, 1, 0), (5, 1, 0)]
    bare = run(replace(PLAIN, bridge_gaps=False), frames)
    assert table(bare.online) == table(bare.tracks) == [(1, 1, 0), (4, 1, 0), (5, 1, 0)]


def test_gaps_without_states_are_bridged():
    frames = [seen((1, 10.0 + 5 * k)) if k not in (4, 5) else seen() for k in range(9)]
    corrected = run(PLAIN, frames).tracks
    assert corrected.predicted.nonzero()[0].tolist() == [4, 5]
    centres = corrected.xyxy[:, [0, 2]].mean(axis=1)
    np.testing.assert_allclose(centres, 10 + 5 * np.arange(9), atol=1.0)


@pytest.mark.parametrize(("missed", "bridged"), [(49, True), (50, False)])
def test_gaps_of_more_than_two_seconds_stay_empty(missed: int, bridged: bool):
    """25 frames a second; the identity goes on."""
    there = [0, 1, 2, *range(3 + missed, 6 + missed)]
    frames = [seen((1, 10.0 + 5 * k)) if k in there else seen() for k in range(6 + missed)]
    corrected = run(PLAIN, frames).tracks
    assert set(corrected.identity.tolist()) == {1}
    assert len(corrected) == 6 + missed * bridged


def test_corrected_tracks_and_delayed_rows_show_the_revised_past():
    """The filter changes its mind in the fifth frame: since the third, target 1 was what it had
    called 2.
    """
    first = [seen((1, 10.0 + 5 * k)) for k in range(2)] + [
        seen((1, 90.0), (2, 20.0 + 5 * k, 1)) for k in range(2)
    ]
    second = [*first[:2], *(seen((1, 20.0 + 5 * k, 1)) for k in range(2))]
    last = seen((1, 30.0))
    frames = [*with_past(first, 3), replace(last, past=tuple(second[1:]))]
    result = run(PLAIN, frames)
    assert [rows.identity.tolist() for rows in result.emitted] == [[1], [1], [1, 2], [1, 2], [1]], (
        "what was given stays"
    )
    assert table(result.tracks) == [(1, 1, 0), (2, 1, 0), (3, 1, 1), (4, 1, 1), (5, 1, 0)]
    np.testing.assert_array_equal(result.tracks.xyxy[2:4], np.vstack([e.xyxy for e in second[2:]]))
    held = run(replace(PLAIN, output_delay=2), frames)
    assert [len(rows) for rows in held.emitted] == [0, 0, 1, 1, 1]
    assert same(held.online, result.tracks)


def test_what_no_revision_reaches_any_more_stands():
    """A past of two frames, then none: the frames before stay as they were seen last."""
    frames = with_past([seen((1, 10.0 * k)) for k in range(8)], 2)
    frames[5] = replace(frames[5], past=(seen((1, 31.0)), seen((1, 41.0))))
    frames[6:] = [replace(e, past=()) for e in frames[6:]]
    corrected = run(PLAIN, frames).tracks
    np.testing.assert_allclose(
        corrected.xyxy[:, [0, 2]].mean(axis=1), [0, 10, 20, 31, 41, 50, 60, 70]
    )


def test_confirmed_online_as_soon_as_what_follows_shows_it():
    frames = [seen((1, 10.0 + 5 * k)) for k in range(6)]
    given = run(replace(PLAIN, output_delay=2), frames).emitted
    assert [rows.confirmed.tolist() for rows in given] == [[], [], [True], [True], [True], [True]]
    # Once confirmed, always: the filter takes two of three detections back.
    taken = [
        *with_past(frames[:3], 3),
        replace(seen((1, 25.0, -1)), past=(frames[0],) + (seen((1, 20.0, -1)),) * 2),
    ]
    assert run(PLAIN, taken).emitted[3].confirmed.tolist() == [True]


@pytest.mark.parametrize(
    ("deviation", "weight", "rows"),
    [(2.0, 1.0, 7), (60.0, 1.0, 6), (2.0, 0.45, 6), (8.0, 0.9, 7), (8.0, 0.6, 6)],
)
def test_a_gap_has_rows_where_the_target_probably_is(deviation, weight, rows):
    """Whether it exists, and whether its box of 40 pixels is where it is drawn."""
    frames = [seen((1, 10.0 + 5 * k)) for k in range(7)]
    missed = seen((1, 25.0, -1), weight=[weight])
    covariance = missed.covariance.copy()
    covariance[:, [0, 1], [0, 1]] = deviation**2
    frames[3] = replace(missed, covariance=covariance)
    online = run(replace(PLAIN, output_delay=2, max_coast=0.5), frames).online
    assert len(online) == rows
    assert online.predicted.sum() == rows - 6


def test_of_states_with_one_label_the_heaviest_stands():
    frames = [seen((1, 10.0), (1, 50.0), (2, 99.0), weight=[0.4, 0.9, 0.5]) for _ in range(4)]
    result = run(PLAIN, frames)
    assert table(result.emitted[0]) == [(1, 1, 1), (1, 2, 2)]
    np.testing.assert_allclose(result.emitted[0].confidence, [0.9, 0.5])
    assert len(result.tracks) == 8


def test_states_without_labels_are_an_error():
    with pytest.raises(
        InputError,
        match=r"^associate\.kind=labelled: 2 states bring no labels .* associate\.kind=graph",
    ):
        run(PLAIN, [states([[1.0, 2.0], [30.0, 4.0]])])


@pytest.mark.parametrize("depth", [0, 4])
def test_a_saved_state_goes_on_as_if_nothing_had_happened(depth: int):
    """Enough frames for the history to be packed into chunks."""
    frames = with_past(
        [seen((7, 10.0 + k), *([(k, 300.0)] if k % 9 == 0 else [])) for k in range(100)], depth
    )
    held = replace(PLAIN, output_delay=3)
    whole = run(held, frames)
    half = unpack(from_bytes(to_bytes(whole.states[69])), LabelledState)
    for number, estimates in enumerate(frames[70:], start=71):
        half, rows = held.extend(half, estimates, *measured(estimates), number, 1.0, MODEL)
        assert same(rows, whole.emitted[number - 1])
    assert same(held.finish(half, MODEL), whole.tracks)
    assert same(held.flush(half, MODEL), whole.flushed)
    assert len(whole.tracks) == 100


def test_a_camera_that_runs_for_days_forgets():
    """One target for ever and a new label in every frame: with ``history`` the state stops growing
    and identities stay.
    """
    frames = with_past([seen((1, 10.0), (k + 2, 300.0)) for k in range(608)], 5)
    ours = run(replace(PLAIN, history=2.0), frames)
    theirs = run(PLAIN, frames)
    sizes = [
        len(to_bytes(state)) for state in (ours.states[319], ours.states[447], ours.states[-1])
    ]
    assert max(sizes) < 1.3 * min(sizes)
    assert len(to_bytes(theirs.states[-1])) > 4 * sizes[0]
    assert table(ours.online) == table(theirs.online)
    assert 400 < ours.tracks.frame.min() <= 600 - 50


@pytest.mark.parametrize("settled", [False, True])
def test_missing_target_keeps_identity_with_short_history(settled: bool):
    """Its states are in frames that may still be revised, and none is settled yet; the past stands,
    or comes again.
    """
    frames = [seen((1, 10.0), *([(2, 300.0)] if k % 4 == 0 else [])) for k in range(20)]
    given = (
        with_past(frames, 5)
        if not settled
        else [replace(e, past=(None,) * min(k, 5)) for k, e in enumerate(frames)]
    )
    rows = run(replace(PLAIN, history=2.0, max_coast=0.0), given).emitted
    assert {tuple(r.identity.tolist()) for r in rows[::4]} == {(1, 2)}
    assert {tuple(r.identity.tolist()) for k, r in enumerate(rows) if k % 4} == {(1,)}
