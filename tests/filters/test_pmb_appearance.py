"""What boxes look like as evidence in the PMB filter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from appearance_cases import (
    FPS,
    TURN,
    D,
    frame_of,
    identity_of,
    measured,
    pacing,
    prototypes,
    tracker_of,
    turning,
)
from inner_kernels import from_python
from phdtrack import Tracker, pipeline
from phdtrack.filters import PMB
from phdtrack.kernels.appearance_law import looks_and_law
from phdtrack.kernels.association import EDGE
from phdtrack.kernels.verdicts import DOUBTFUL, MISSED, write_verdicts
from phdtrack.protocols import Filter
from phdtrack.types import F8, Detections, Tracks
from reference.pmb_twin import enumerated
from tracker_cases import equal

(verdicts_of,) = from_python(write_verdicts)

LOOKS = prototypes(6)
NONE = {"appearance": {"kind": "none"}}
SEEDS = 12


def turn(seed: int, away: int, step: float) -> Callable[[int, int], F8]:
    """`turning`; who goes where is drawn."""
    rng = np.random.default_rng([seed, 9])
    return measured(turning(bool(rng.random() < 0.5), away, step), seed)


@cache
def learned(kind: str) -> dict[str, Any]:
    """The state before they meet."""
    tracker = tracker_of(appearance={"kind": kind})
    for k in range(TURN - 10):
        tracker.update(frame_of([0, 1, 2], k, LOOKS, turn(0, 0, 0.0)))
    return tracker.state_dict()


def met(
    kind: str,
    seed: int,
    *,
    hidden: bool = True,
    away: int = 0,
    step: float = 30.0,
    unknown: int = 0,
) -> tuple[bool, Tracker]:
    """Whether both have the identities that they had before they met, and the tracker.

    ``hidden``: they are not detected while they are near each other. ``unknown``: frames after it
    whose detections have no descriptors.
    """
    tracker = tracker_of(appearance={"kind": kind})
    tracker.load_state_dict(learned(kind))
    place = turn(seed, away, step)
    rows = Tracks.empty()
    for k in range(TURN - 10, TURN + away + 25):
        gone = hidden and k < TURN + away
        found = frame_of([2] if gone else [0, 1, 2], k, LOOKS, place)
        if 0 <= k - TURN - away < unknown:
            found = replace(found, embeddings=None)
        rows = tracker.update(found)
    # Identities began with detections in their order.
    return [identity_of(rows, 0), identity_of(rows, 1)] == [1, 2], tracker


def kept(kind: str, **scene: Any) -> int:
    """In how many of `SEEDS` scenes the identities are kept."""
    return sum(met(kind, seed, **scene)[0] for seed in range(SEEDS))


def test_looks_tell_who_came_out_where():
    """Without them it is by chance: 12 flips of a coin, but for 1 in 1000."""
    assert kept("learned") == SEEDS
    assert 1 <= kept("none") <= 10


def test_a_swap_is_undone_as_soon_as_looks_are_known():
    """Both hypotheses of each target are kept for some frames, and have pasts of their own."""
    assert kept("learned", unknown=1) == SEEDS
    assert kept("learned", unknown=2) >= SEEDS - 2


@pytest.mark.parametrize(
    "scene",
    [{"hidden": False, "away": 20, "step": 0.0}, {"unknown": 5}],
    ids=["in one place", "unknown after it"],
)
def test_corrected_tracks_are_parted_where_they_met(scene: dict[str, Any]):
    """Detected in one place for two seconds, whose boxes show nothing meanwhile; or hidden, and
    without descriptors for a while when they come back, so that tracks go on with the other one.
    """
    end = TURN + scene.get("away", 0) + 25
    right = 0
    for seed in range(SEEDS):
        _, tracker = met("learned", seed, **scene)
        tracks = tracker.tracks()
        ends = tracks.select(np.isin(tracks.frame, [50, end]))
        own = [set(ends.identity[ends.detection == person].tolist()) for person in (0, 1)]
        right += [len(names) for names in own] == [1, 1] and own[0] != own[1]
    assert right == SEEDS


def crowd(frames: int, embed: Callable[[int, int], Any]) -> Iterator[Detections]:
    """Frames of people with misses and false alarms; ``embed`` gives descriptors by frame and
    number of boxes.
    """
    rng = np.random.default_rng(2)
    for k in range(frames):
        people = [p for p in range(5) if rng.random() < 0.9]
        boxes = [pacing(p, k) + rng.normal(0, 1.5, 4) for p in people]
        corner = rng.uniform(0, 600, 2)
        boxes.append(np.append(corner, corner + np.array([40, 90])))
        yield Detections.of(np.reshape(boxes, (-1, 4)), embeddings=embed(k, len(boxes)))


def unknown(k: int, n: int) -> np.ndarray:
    return np.full((n, D), np.nan if k % 2 else 0.0)


@pytest.mark.parametrize(
    "embed",
    [lambda k, n: None, unknown, lambda k, n: np.ones((n, 1)), lambda k, n: np.ones((n, D))],
    ids=["none", "unknown", "D = 1", "constant"],
)
def test_without_looks_all_is_bit_for_bit_as_without(embed: Callable[[int, int], Any]):
    """Online rows, corrected tracks, and the filter's targets."""
    plain = tracker_of(**NONE)
    other = tracker_of()
    for found in crowd(120, embed):
        assert equal(
            plain.update(replace(found, embeddings=None)),
            other.update(found),
        )
        a = plain.state.intensity.present
        b = other.state.intensity.present
        names = [name for name in a.hypotheses.dtype.names if name != "past"]
        np.testing.assert_array_equal(a.hypotheses[names], b.hypotheses[names])
        np.testing.assert_array_equal(a.targets, b.targets)
        np.testing.assert_array_equal(a.mean, b.mean)
        np.testing.assert_array_equal(a.covariance, b.covariance)
    assert equal(plain.tracks(), other.tracks())


def test_appearance_none_uses_no_descriptors():
    plain = tracker_of(**NONE)
    other = tracker_of(**NONE)
    for found in crowd(60, lambda k, n: np.random.default_rng(k).normal(0, 1, (n, D))):
        assert equal(plain.update(found), other.update(replace(found, embeddings=None)))
    assert plain.state.appearance is None
    assert equal(plain.tracks(), other.tracks())


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 4))
def test_verdicts_leave_no_doubt(seed: int, targets: int, n: int):
    """By all ways in which the measurements can be shared out: 0.99 at least."""
    rng = np.random.default_rng(seed)
    psi = np.exp(rng.normal(-2, 6, (targets, n))) * (rng.random((targets, n)) < 0.7)
    edges = np.zeros(np.count_nonzero(psi), EDGE)
    edges["target"], edges["measurement"] = np.nonzero(psi)
    found = np.empty(targets, np.int64)
    verdicts_of(edges, psi[psi > 0], n, found)
    pair, missed, _ = enumerated(psi)
    for t, verdict in enumerate(found.tolist()):
        if verdict == MISSED:
            assert missed[t] > 0.99
        elif verdict != DOUBTFUL:
            assert pair[t, verdict] >= 0.99 - 1e-12
        elif n == 1 and targets == 1:
            assert 0.009 < missed[t] < 0.991


def _all_free(*arguments: Any) -> tuple[Any, ...]:
    """`looks_and_law`, as if no box covered another."""
    (unit, seen, mean, free, *rest), law = looks_and_law(*arguments)
    return (unit, seen, mean, np.ones(len(free)), *rest), law


def test_hypotheses_of_a_target_have_pasts_of_their_own():
    """Two measurements near one target: what each hypothesis remembers is the one it took."""
    tracker = tracker_of()
    for k in range(30):
        tracker.update(frame_of([0, 2, 3], k, LOOKS))
    box = pacing(0, 30)
    both = np.array([box - 4, box + 4])
    looks = np.stack([LOOKS[0], LOOKS[4]])
    others = frame_of([2, 3], 30, LOOKS)
    assert others.embeddings is not None
    # Seen as if neither covered the other: the model knows no order of depth.
    found = Detections.of(
        np.vstack([both, others.xyxy]), embeddings=np.vstack([looks, others.embeddings])
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phdtrack.models.appearance.looks_and_law", _all_free)
        tracker.update(found)
    state = tracker.state.intensity
    own = state.present.hypotheses[state.present.hypotheses["target"] == 0]
    unit = looks / np.linalg.norm(looks, axis=1)[:, None]
    for j in (0, 1):
        past = own["past"][own["detection"] == j]
        assert len(past)
        np.testing.assert_allclose(state.pasts.looks[past, 1], unit[[j] * len(past)], atol=1e-6)
    missed = own["past"][own["detection"] < 0]
    assert not np.isin(missed, own["past"][own["detection"] >= 0]).any()
    assert state.pasts.rows["time"][own["past"][own["detection"] >= 0]].max() == pytest.approx(3.0)


def test_descriptors_of_another_length_begin_anew():
    """As when a pipeline is given another network."""
    stages = tracker_of().stages
    rng = np.random.default_rng(0)
    state = pipeline.start(stages, rng)
    for k in range(80):
        found = frame_of([0, 1, 2], k, LOOKS).numbered()
        assert found.embeddings is not None
        looks = found.embeddings[:, : D if k < 40 else 5]
        found = replace(found, embeddings=looks)
        state, step = pipeline.advance(stages, state, found, k + 1, 0.1 * k, rng)
    assert state.intensity.pasts.looks.shape[2] == 5
    assert set(step.tracks.identity.tolist()) == {1, 2, 3}
    corrected = pipeline.finish(stages, state)
    assert len(np.unique(corrected.identity)) == 3


@dataclass(frozen=True)
class Composed(Filter):
    """The filter by its parts: predict, then update."""

    inner: PMB

    def start(self, model, rng):
        return self.inner.start(model, rng)

    def predict(self, state, model, dt, rng):
        return self.inner.predict(state, model, dt, rng)

    def update(self, state, z, model, dt, rng):
        return self.inner.update(state, z, model, dt, rng)


def test_a_step_is_predict_and_update_to_the_last_digit(monkeypatch: pytest.MonkeyPatch):
    """And one call: neither kernel is called by itself, with looks or without."""
    rng = np.random.default_rng(4)
    frames = list(crowd(100, lambda k, n: rng.normal(0, 1, (n, D)) + np.resize(LOOKS, (n, D))))
    frames[60] = replace(frames[60], embeddings=None)
    stages = tracker_of().stages
    parts = Tracker(stages=replace(stages, filter=Composed(stages.filter)), fps=FPS)
    rows = [parts.update(found) for found in frames]
    tracker = tracker_of()
    for name in ("predicted_layer", "updated_layer"):
        monkeypatch.delattr(f"phdtrack.filters.pmb.{name}")
    for found, expected in zip(frames, rows, strict=True):
        assert equal(tracker.update(found), expected)
    assert equal(tracker.tracks(), parts.tracks())
    assert len(tracker.state.intensity.pasts.rows) == len(parts.state.intensity.pasts.rows) > 0
