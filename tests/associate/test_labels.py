"""Identities by the filter's labels: what is given online, what is revised, what the corrected tracks are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from association_cases import FIELDS, model_of, states

from phdtrack.associate import Labelled
from phdtrack.errors import InputError
from phdtrack.tracker import pack, unpack
from phdtrack.types import Estimates, Tracks

MODEL = model_of()
NO_Z = np.zeros((4, 0))
PLAIN = Labelled(min_track_length=3, output_delay=0, max_coast=0.2, bridge_gaps=True)


def seen(*targets: tuple[int, float] | tuple[int, float, int], weight=None) -> Estimates:
    """States (label, x[, detection]) at y = 100, the i-th on detection i unless said otherwise."""
    x = [target[1] for target in targets]
    found = states(np.column_stack([x, np.full(len(x), 100.0)]), velocity=np.tile([5.0, 0.0], (len(x), 1)))
    rests = [target[2] if len(target) == 3 else i for i, target in enumerate(targets)]
    mass = np.ones(len(x)) if weight is None else np.asarray(weight, np.float64)
    return replace(found, tag=np.array([t[0] for t in targets], np.int64), detection=np.array(rests, np.int64), weight=mass)


def run(associator: Labelled, frames: list[Estimates], dt: float = 1.0):
    state, given = associator.start(), []
    for number, estimates in enumerate(frames, start=1):
        state, rows = associator.extend(state, estimates, NO_Z, number, dt, MODEL)
        given.append(rows)
    return state, given


def table(tracks: Tracks) -> list[tuple[int, int, int]]:
    """Frame, identity and detection of each row."""
    return list(zip(tracks.frame.tolist(), tracks.identity.tolist(), tracks.detection.tolist(), strict=True))


def with_past(frames: list[Estimates], depth: int) -> list[Estimates]:
    return [replace(e, past=tuple(frames[max(0, k - depth) : k])) for k, e in enumerate(frames)]


def test_a_label_is_an_identity_from_one_in_order_of_appearance():
    frames = [seen((70, 10.0 + 5 * k), (12, 300.0), *([(5, 500.0)] if k > 1 else [])) for k in range(6)]
    state, given = run(PLAIN, frames)
    assert [rows.identity.tolist() for rows in given] == [[1, 2]] * 2 + [[1, 2, 3]] * 4
    assert [rows.confirmed.tolist() for rows in given[:5]] == [[False] * 2, [False] * 2, [True, True, False],
                                                               [True, True, False], [True] * 3]  # fmt: skip
    corrected = PLAIN.finish(state, MODEL)
    assert table(corrected) == [(k + 1, i + 1, i) for k in range(6) for i in range(3 if k > 1 else 2)]
    np.testing.assert_array_equal(corrected.xyxy[0], frames[0].xyxy[0])


def test_short_tracks_are_left_out_and_identities_are_those_of_what_stays():
    frames = [seen((1, 10.0), (2, 300.0)) if k < 2 else seen((2, 300.0)) for k in range(4)]
    state, _ = run(PLAIN, frames)
    assert table(PLAIN.finish(state, MODEL)) == [(1, 1, 1), (2, 1, 1), (3, 1, 0), (4, 1, 0)]
    everything = replace(PLAIN, min_track_length=1)
    assert len(everything.finish(run(everything, frames)[0], MODEL)) == 6


def test_states_without_detections_do_not_count_and_a_track_ends_with_its_last():
    frames = [seen((1, 10.0 + 5 * k, 0 if k in (0, 3, 4) else -1)) for k in range(12)]
    state, given = run(PLAIN, frames)
    # Confirmed with the third detection; then 0.2 s = 5 time units of coasting.
    assert [len(rows) for rows in given] == [1, 0, 0, 1, 1, 1, 1, 1, 1, 1, 0, 0]
    assert [bool(rows.confirmed.all()) for rows in given[3:5]] == [False, True]
    assert table(PLAIN.finish(state, MODEL)) == [(1, 1, 0), (2, 1, -1), (3, 1, -1), (4, 1, 0), (5, 1, 0)]
    bare = replace(PLAIN, bridge_gaps=False)
    state, given = run(bare, frames)
    assert [len(rows) for rows in given] == [1, 0, 0, 1, 1] + [0] * 7
    assert table(bare.finish(state, MODEL)) == [(1, 1, 0), (4, 1, 0), (5, 1, 0)]


def test_gaps_are_filled_between_their_ends_even_where_the_filter_showed_nothing():
    frames = [seen((1, 10.0 + 5 * k)) if k not in (4, 5) else seen() for k in range(9)]
    corrected = PLAIN.finish(run(PLAIN, frames)[0], MODEL)
    assert corrected.predicted.nonzero()[0].tolist() == [4, 5]
    centres = corrected.xyxy[:, [0, 2]].mean(axis=1)
    np.testing.assert_allclose(centres, 10 + 5 * np.arange(9), atol=1.0)


def test_corrected_tracks_and_delayed_rows_show_the_revised_past():
    """The filter changes its mind in the fifth frame: since the third, target 1 was what it had called 2."""
    first = [seen((1, 10.0 + 5 * k)) for k in range(2)] + [seen((1, 90.0), (2, 20.0 + 5 * k, 1)) for k in range(2)]
    second = [*first[:2], *(seen((1, 20.0 + 5 * k, 1)) for k in range(2))]
    last = seen((1, 30.0))
    frames = [*with_past(first, 3), replace(last, past=tuple(second[1:]))]
    state, given = run(PLAIN, frames)
    assert [rows.identity.tolist() for rows in given] == [[1], [1], [1, 2], [1, 2], [1]], "what was given stays"
    corrected = PLAIN.finish(state, MODEL)
    assert table(corrected) == [(1, 1, 0), (2, 1, 0), (3, 1, 1), (4, 1, 1), (5, 1, 0)]
    np.testing.assert_array_equal(corrected.xyxy[2:4], np.vstack([e.xyxy for e in second[2:]]))
    held = replace(PLAIN, output_delay=2)
    state, given = run(held, frames)
    assert [len(rows) for rows in given] == [0, 0, 1, 1, 1]
    online = Tracks.concatenate([*given, held.flush(state, MODEL)])
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(online, name), getattr(corrected, name))


def test_what_no_revision_reaches_any_more_stands():
    """A past of two frames, then none: the frames before stay as they were seen last."""
    frames = with_past([seen((1, 10.0 * k)) for k in range(8)], 2)
    frames[5] = replace(frames[5], past=(seen((1, 31.0)), seen((1, 41.0))))
    frames[6:] = [replace(e, past=()) for e in frames[6:]]
    corrected = PLAIN.finish(run(PLAIN, frames)[0], MODEL)
    np.testing.assert_allclose(corrected.xyxy[:, [0, 2]].mean(axis=1), [0, 10, 20, 31, 41, 50, 60, 70])


def test_confirmed_online_as_soon_as_what_follows_shows_it():
    frames = [seen((1, 10.0 + 5 * k)) for k in range(6)]
    _, given = run(replace(PLAIN, output_delay=2), frames)
    assert [rows.confirmed.tolist() for rows in given] == [[], [], [True], [True], [True], [True]]
    # Once believed, always: the filter takes two of three detections back.
    taken = [*with_past(frames[:3], 3), replace(seen((1, 25.0, -1)), past=(frames[0],) + (seen((1, 20.0, -1)),) * 2)]
    _, given = run(PLAIN, taken)
    assert given[3].confirmed.tolist() == [True]


def test_of_states_with_one_label_the_heaviest_stands():
    frames = [seen((1, 10.0), (1, 50.0), (2, 99.0), weight=[0.4, 0.9, 0.5]) for _ in range(4)]
    state, given = run(PLAIN, frames)
    assert table(given[0]) == [(1, 1, 1), (1, 2, 2)]
    np.testing.assert_allclose(given[0].confidence, [0.9, 0.5])
    assert len(PLAIN.finish(state, MODEL)) == 8


def test_states_without_labels_are_an_error():
    with pytest.raises(InputError, match=r"^associate\.kind=labelled: 2 states bring no labels .* associate\.kind=graph"):
        PLAIN.extend(PLAIN.start(), states([[1.0, 2.0], [30.0, 4.0]]), NO_Z, 1, 1.0, MODEL)


@pytest.mark.parametrize("depth", [0, 4])
def test_a_saved_state_goes_on_as_if_nothing_had_happened(depth: int):
    """Enough frames for the history to be packed into chunks."""
    frames = with_past([seen((7, 10.0 + k), *([(k, 300.0)] if k % 9 == 0 else [])) for k in range(100)], depth)
    held = replace(PLAIN, output_delay=3)
    whole, given = run(held, frames)
    half, _ = run(held, frames[:70])
    half = unpack(pack(half))
    for number, estimates in enumerate(frames[70:], start=71):
        half, rows = held.extend(half, estimates, NO_Z, number, 1.0, MODEL)
        for name in FIELDS:
            np.testing.assert_array_equal(getattr(rows, name), getattr(given[number - 1], name))
    for ours, theirs in ((held.finish, held.finish), (held.flush, held.flush)):
        np.testing.assert_array_equal(ours(half, MODEL).xyxy, theirs(whole, MODEL).xyxy)
    assert len(held.finish(whole, MODEL)) == 100


def size(state) -> int:
    """Elements of all arrays of a state."""

    def count(value) -> int:
        if isinstance(value, np.ndarray):
            return value.size
        values = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        return sum(count(item) for item in values)

    return count(pack(state))


def test_a_camera_that_runs_for_days_forgets():
    """One target for ever and a new label in every frame: with ``history`` the state stops growing and identities stay."""
    frames = with_past([seen((1, 10.0), (k + 2, 300.0)) for k in range(608)], 5)
    forgetful = replace(PLAIN, history=2.0)
    sizes = [size(run(forgetful, frames[:n])[0]) for n in (320, 448, 608)]
    assert max(sizes) < 1.3 * min(sizes)
    assert size(run(PLAIN, frames)[0]) > 4 * sizes[0]
    _, ours = run(forgetful, frames)
    _, theirs = run(PLAIN, frames)
    for a, b in zip(ours, theirs, strict=True):
        assert table(a) == table(b)
    corrected = forgetful.finish(run(forgetful, frames)[0], MODEL)
    assert corrected.frame.min() <= 600 - 50
    assert corrected.frame.min() > 400


@pytest.mark.parametrize("settled", [False, True])
def test_who_is_not_told_of_for_a_while_keeps_his_identity_where_little_is_remembered(settled: bool):
    """His states are in frames that may still be revised, and none is settled yet; the past stands, or is told again."""
    frames = [seen((1, 10.0), *([(2, 300.0)] if k % 4 == 0 else [])) for k in range(20)]
    given = with_past(frames, 5) if not settled else [replace(e, past=(None,) * min(k, 5)) for k, e in enumerate(frames)]
    _, rows = run(replace(PLAIN, history=2.0, max_coast=0.0), given)
    assert {tuple(r.identity.tolist()) for r in rows[::4]} == {(1, 2)}
    assert {tuple(r.identity.tolist()) for k, r in enumerate(rows) if k % 4} == {(1,)}
