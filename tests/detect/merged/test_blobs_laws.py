"""What holds of explained blobs whatever the scene: what may change, what may not, and that order does not matter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack import config
from phdtrack.arrays import to_cxcywh
from phdtrack.detect.merged import Expected, Explained
from phdtrack.errors import InputError
from phdtrack.protocols import Model
from phdtrack.types import F8, Detections, Explanation, SequenceInfo

INFO = SequenceInfo(640, 480, 25.0)
MODEL: Model = config.build(config.load(), INFO).model
ALWAYS = Explained(known=0.0, split=0.2)


def expected(boxes: F8, **given: F8) -> Expected:
    """Targets at rest that were seen well at these boxes (n, 4)."""
    n = len(boxes)
    state, covariance = MODEL.sensor.states(to_cxcywh(boxes))
    size = to_cxcywh(boxes)[2:].T
    values = {"hidden": np.zeros(n), "pieces": np.zeros(n), "alone": np.full(n, 9.0)} | given
    return Expected(state, covariance * 0.05, np.full(n, 0.99), values["hidden"], values["pieces"], values["alone"], size)


def explain(targets: Expected, blobs: F8, rule: Explained = ALWAYS) -> tuple[Expected, Explanation]:
    return rule.explain(targets, Detections.of(blobs), MODEL, 1.0)


PAIR = np.array([[100.0, 100, 140, 200], [125, 104, 165, 204]])
BLOB = np.array([[98.0, 99, 168, 205]])
boxes = st.lists(
    st.tuples(st.integers(0, 300), st.integers(0, 200), st.integers(20, 60), st.integers(40, 120)), min_size=0, max_size=7
).map(lambda rows: np.array([[x, y, x + w, y + h] for x, y, w, h in rows], np.float64).reshape(-1, 4))


def test_one_blob_of_two_targets_becomes_a_detection_of_each_size_at_its_edges() -> None:
    _, told = explain(expected(PAIR), BLOB)
    assert told.changed
    assert len(told.detections) == 2
    assert told.source.tolist() == [0, 0]
    assert told.part.tolist() == [0]
    left, right = told.detections.xyxy[np.argsort(told.target)]
    np.testing.assert_allclose([left[0], right[2]], [98, 168])
    np.testing.assert_allclose([left[2] - left[0], right[2] - right[0]], [40, 40])
    assert (told.detections.xyxy[:, 1] >= 99).all()
    assert (told.detections.xyxy[:, 3] <= 205).all()


def test_two_blobs_of_two_targets_stay_as_they_are() -> None:
    _, told = explain(expected(PAIR), PAIR + 1.0)
    assert not told.changed
    np.testing.assert_array_equal(told.detections.xyxy, PAIR + 1.0)


def test_a_blob_of_one_targets_size_is_not_two_where_the_other_is_elsewhere() -> None:
    apart = np.array([[100.0, 100, 140, 200], [136, 100, 176, 200], [400, 100, 440, 200]])
    _, told = explain(expected(apart), np.array([[100.0, 100, 140, 200], [138, 101, 178, 200]]))
    assert not told.changed


def test_pieces_of_one_target_become_their_union() -> None:
    pieces = np.array([[100.0, 100, 138, 140], [103, 147, 140, 200]])
    after, told = explain(expected(PAIR[:1]), pieces)
    assert told.changed
    assert told.source.tolist() == [0]
    assert told.part.tolist() == [0, 0]
    np.testing.assert_allclose(told.detections.xyxy, [[100, 100, 140, 200]])
    assert after.pieces[0] == pytest.approx(1 / 25)


def test_a_blob_of_nobody_is_no_piece() -> None:
    found = np.array([[100.0, 100, 140, 200], [128, 90, 228, 260]])
    _, told = explain(expected(PAIR[:1]), found)
    assert not told.changed


@pytest.mark.parametrize(
    ("rule", "given"),
    [
        (Explained(merge=0.0), {}),
        (Explained(known=0.4), {"alone": np.array([9.0, 0.3])}),
    ],
)
def test_a_blob_is_not_parted_where_the_settings_say_so(rule: Explained, given: dict[str, F8]) -> None:
    _, told = explain(expected(PAIR, **given), BLOB, rule)
    assert not told.changed


def test_who_hides_for_longer_than_patience_does_not_hide_any_more() -> None:
    inside = np.array([[100.0, 100, 160, 200], [110, 100, 140, 200]])
    blob = inside[:1]
    before, told = explain(expected(inside), blob)
    assert told.changed
    assert before.hidden.tolist() == [0.0, pytest.approx(1 / 25)]
    _, told = explain(expected(inside, hidden=np.array([0.0, 3.1])), blob)
    assert not told.changed


def test_pieces_that_last_are_several() -> None:
    pieces = np.array([[100.0, 100, 138, 140], [103, 147, 140, 200]])
    _, told = explain(expected(PAIR[:1], pieces=np.array([1.1])), pieces)
    assert not told.changed


@settings(deadline=None, max_examples=150)
@given(boxes, boxes)
def test_each_blob_is_told_once_or_parted_and_order_does_not_matter(targets: F8, blobs: F8) -> None:
    state = expected(targets)
    _, told = explain(state, blobs)
    # Every blob went somewhere, and everything told rests on a blob.
    assert len(told.part) == len(blobs)
    assert len(told.source) == len(told.detections) == len(told.target)
    whole = {int(s) for s in told.source}
    assert whole == {int(told.source[p]) for p in told.part}
    shared = np.bincount(told.source, minlength=len(blobs))
    named = told.target[told.target >= 0]
    assert len(named) == len(set(named.tolist()))
    for b in np.flatnonzero(shared > 1):
        assert (told.target[told.source == b] >= 0).all()
    order = np.random.default_rng(len(blobs) + 7 * len(targets)).permutation(len(blobs))
    _, other = explain(state, blobs[order])
    mine, theirs = (np.round(d.detections.xyxy, 9).tolist() for d in (told, other))
    assert sorted(mine) == sorted(theirs)


@settings(deadline=None, max_examples=60)
@given(boxes)
def test_without_two_targets_at_a_blob_or_two_blobs_at_a_target_nothing_changes(blobs: F8) -> None:
    far = np.array([[500.0, 300, 540, 400]])
    _, told = explain(expected(far), blobs)
    assert not told.changed
    np.testing.assert_array_equal(told.detections.xyxy, blobs)


def test_given_noise_grows_where_nobody_sees_the_target() -> None:
    inside = np.array([[100.0, 100, 180, 200], [120, 100, 150, 200]])
    noise = np.diag([4.0, 4, 9, 9])
    blob = Detections(inside[:1], np.ones(1), np.zeros(1, np.int64), noise[None])
    _, told = ALWAYS.explain(expected(inside), blob, MODEL, 1.0)
    assert told.changed
    assert told.detections.covariance is not None
    seen, unseen = told.detections.covariance[np.argsort(told.target)]
    assert seen[0, 0] == 4.0
    assert unseen[0, 0] > 100.0


def test_settings_are_checked() -> None:
    with pytest.raises(InputError, match=r"^Explained.merge"):
        Explained(merge=1.5)
    with pytest.raises(InputError, match="does not fit"):
        config.load(None, ("filter.kind=none", "merged_measurements.kind=explained"))
