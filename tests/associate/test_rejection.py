"""Tracks that stay where false alarms are: never confirmed; those that leave are, from there on."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from association_cases import matching_of, model_of, run, same, states
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.arrays import to_xyxy
from phdtrack.associate.labels import Labelled
from phdtrack.associate.rejection import FalseTrackRejection, without_false_tracks
from phdtrack.types import Estimates, Tracks

MODEL = model_of()


@dataclass(frozen=True)
class Strip:
    """Those that are followed are left of ``end``, the surer the further; of any there are twenty
    times as many.
    """

    end: float = 200.0

    def log(self, z):
        return (self.end - z[0]) / 10 + np.array([[0.0], [np.log(20)]])


STRIP = Strip()
INNER = {
    "graph": matching_of(min_track_length=3, back_dating=0),
    "graph, delayed": matching_of(min_track_length=3, output_delay=3),
    "labelled": Labelled(min_track_length=3),
    "labelled, delayed": Labelled(min_track_length=3, output_delay=3),
}
each = pytest.mark.parametrize("inner", INNER.values(), ids=INNER)


def frame(*targets: tuple[int, float] | tuple[int, float, float]) -> Estimates:
    """States of targets (label, x[, velocity]), at rest unless said otherwise, each label on its
    own height.
    """
    label = np.array([t[0] for t in targets], np.int64)
    points = np.column_stack([[t[1] for t in targets], 60.0 * label])
    velocity = [(t[2] if len(t) == 3 else 0.0, 0.0) for t in targets]
    return replace(states(points, velocity=velocity), tag=label)


def centre(tracks: Tracks) -> np.ndarray:
    return tracks.xyxy[:, [0, 2]].mean(axis=1)


def furthest(rows: Tracks, plain: Tracks) -> np.ndarray:
    """How far right the target of each row has been up to its frame."""
    pairs = zip(rows.identity, rows.frame, strict=True)
    return np.array(
        [centre(plain.select((plain.identity == i) & (plain.frame <= k))).max() for i, k in pairs]
    )


# 1 trembles where alarms are, 2 walks out of there, 3 walks beside it, 4 walks in from the right.
STREET = [
    frame(
        (1, 100.0 + k % 2),
        (2, 150.0 + 5 * k, 5.0),
        (3, 400.0 + 5 * k, 5.0),
        (4, 280.0 - 5 * k, -5.0),
    )
    for k in range(25)
]


@each
def test_online_rows_are_confirmed_if_ratio_and_associator_agree(inner):
    plain, rows = (
        run(associator, STREET).online
        for associator in (inner, FalseTrackRejection(inner, STRIP, immediate_confirmation=0.0))
    )
    assert same(rows, plain, "confirmed")
    np.testing.assert_array_equal(rows.confirmed, plain.confirmed & (furthest(rows, plain) > 200))
    assert 0 < rows.confirmed.sum() < plain.confirmed.sum()


@each
def test_who_is_surely_an_object_is_confirmed_at_once(inner):
    """As soon as it has been there, and from then on; the others as before, and so are corrected
    tracks.
    """
    slow = run(FalseTrackRejection(inner, STRIP, immediate_confirmation=0.0), STREET)
    fast = run(FalseTrackRejection(inner, STRIP, immediate_confirmation=20 * np.exp(-15.0)), STREET)
    rows = fast.online
    before = slow.online.confirmed
    np.testing.assert_array_equal(
        rows.confirmed, before | (furthest(rows, run(inner, STREET).online) > 350)
    )
    assert (rows.confirmed & ~before).any() == (inner.output_delay == 0)
    assert same(fast.tracks, slow.tracks)


@each
def test_corrected_tracks_begin_where_they_are_believed(inner):
    associator = FalseTrackRejection(inner, STRIP, immediate_confirmation=0.0)
    result = run(associator, STREET)
    plain = run(inner, STREET).tracks
    tracks = result.tracks
    assert set(plain.identity) == {1, 2, 3, 4}
    assert set(tracks.identity) == {1, 2, 3}, "identities from 1"
    # A track that leaves is reported from the first box on at which an object is likelier, one that
    # enters to its end.
    assert np.count_nonzero(tracks.frame == 1) == 2
    assert centre(tracks).min() == pytest.approx(280 - 5 * 24, abs=2)
    out = tracks.select(tracks.identity == 1)
    np.testing.assert_allclose(centre(out), 205 + 5 * np.arange(len(out)), atol=0.5)
    assert same(tracks, without_false_tracks(plain, STRIP))
    assert associator.measurements(result.states[-1]).z.shape == (4, 100)


row = st.tuples(
    st.integers(1, 9),
    st.integers(1, 4),
    st.sampled_from([100.0, 190.0, 210.0, 400.0]),
    st.booleans(),
)
tables = st.lists(row, max_size=25, unique_by=lambda r: r[:2])


def table(rows) -> Tracks:
    """Rows (frame, identity, x, whether detected); identities are 3 apart."""
    frames, identity, x, seen = (
        (np.array(column) for column in zip(*rows, strict=True)) if rows else [np.zeros(0)] * 4
    )
    n = len(rows)
    xyxy = to_xyxy(np.stack([x, np.full(n, 90.0), np.full(n, 40.0), np.full(n, 80.0)]))
    detection = np.where(seen, np.arange(n), -1).astype(np.int64)
    frames = frames.astype(np.int64)
    identity = 3 * identity.astype(np.int64)
    return Tracks(frames, identity, xyxy, np.full(n, 0.9), detection, np.ones(n, np.bool_))


@given(rows=tables, shortest=st.integers(1, 3), order=st.randoms())
def test_track_begins_at_its_first_likely_detection(rows, shortest, order):
    """Against the definition, row by row; the order of the rows says nothing, rows without
    detections decide nothing.
    """
    wanted = []
    for k, (number, who, _, _) in enumerate(rows):
        way = sorted(
            (r for r in rows if r[1] == who and r[0] <= number and r[3]), key=lambda r: r[0]
        )
        if any(x > 200 for _, _, x, _ in way):
            wanted.append(k)
    left = [rows[k][1] for k in wanted if rows[k][3]]
    wanted = [k for k in wanted if left.count(rows[k][1]) >= shortest]
    names = {who: name for name, who in enumerate(sorted({rows[k][1] for k in wanted}), start=1)}
    found = without_false_tracks(table(rows), STRIP, shortest)
    assert same(
        found, replace(table(rows).select(np.array(wanted, np.int64)), identity=found.identity)
    )
    assert found.identity.tolist() == [names[rows[k][1]] for k in wanted]
    mixed = [*range(len(rows))]
    order.shuffle(mixed)
    other = without_false_tracks(table(rows).select(np.array(mixed, np.int64)), STRIP, shortest)
    assert same(Tracks.concatenate([other]), Tracks.concatenate([found]))


@dataclass(frozen=True)
class FixedRows:
    """An associator that gives the rows of a table, each ``delay`` frames late; its state is the
    frame's number.
    """

    rows: Tracks
    delay: int

    def start(self) -> int:
        return 0

    def extend(self, state, estimates, z, detections, number, dt, model):
        return number, self.rows.select(self.rows.frame == number - self.delay)

    def flush(self, state, model):
        return self.rows.select(self.rows.frame > state - self.delay)

    def finish(self, state, model):
        return self.rows


@given(rows=tables, delay=st.integers(0, 9))
def test_online_the_same_rows_are_believed(rows, delay):
    """With any delay: those that are kept of the corrected tracks, where both are the same rows."""
    tracks = Tracks.concatenate([table(rows)])
    associator = FalseTrackRejection(FixedRows(tracks, delay), STRIP)
    result = run(associator, [states([])] * 9)
    found = result.online
    assert same(found, tracks, "confirmed")
    assert same(
        replace(found.select(found.confirmed), identity=result.tracks.identity), result.tracks
    )
