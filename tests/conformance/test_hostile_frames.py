"""No frame makes an update slow, wrong or unbounded: how many detections, where they are, and of
what size.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack import Tracker, pipeline
from phdtrack.config import load
from phdtrack.detect.convert import DiscardedBoxes, Limits
from phdtrack.errors import InputError
from phdtrack.filters import hypotheses
from phdtrack.filters.mcmc import rivals
from phdtrack.kernels.grid import uncrowded

SIZE = (1920, 1080)
GAUSSIAN = ["none", "pmb", "pmbm", "mht", "gm-phd", "gm-cphd"]
KINDS = [*GAUSSIAN, "particle-phd", "particle-cphd", "mcmc"]


def spread(count: int, seed: int = 0) -> np.ndarray:
    left = np.random.default_rng(seed).uniform((0, 0), (1880, 980), (count, 2))
    return np.hstack([left, left + np.array([40, 100])])


def one_place(count: int) -> np.ndarray:
    return np.tile([900.0, 500, 940, 600], (count, 1))


def tracker_of(kind: str, **more) -> Tracker:
    small = (
        {"particles_per_target": 50}
        if kind.startswith("particle")
        else {"samples": 20}
        if kind == "mcmc"
        else {}
    )
    born = {"birth": {"particles": 20}} if small else {}
    return Tracker(SIZE, filter={"kind": kind} | small, **born | more)


@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_detections_in_one_place_are_as_few(
    kind: str, caplog: pytest.LogCaptureFixture
):
    """The old state needed 13 s for 2 000 of them, and grew with the square of their number."""
    few, many = (tracker_of(kind, limits={"max_in_one_place": 25}) for _ in range(2))
    for _ in range(4):
        few.update(one_place(25))
        many.update(one_place(10_000))
        assert many.step is not None
        assert few.step is not None
        assert len(many.step.detections) == 25
        assert many.step.info.mass == few.step.info.mass
        assert len(many.state.intensity) == len(few.state.intensity)
    assert many.left_out == DiscardedBoxes(crowded=4 * 9_975)
    said = [record.getMessage() for record in caplog.records if record.name == "phdtrack.tracker"]
    assert said == ["frame 1: 9975 boxes left out: more in one place than limits.max_in_one_place"]


@pytest.mark.parametrize("kind", KINDS)
def test_of_too_many_detections_the_highest_scores_are_taken(kind: str):
    tracker = tracker_of(kind, limits={"max_detections": 30})
    boxes = spread(200)
    score = np.linspace(0, 1, 200)
    rows = [tracker.update(np.column_stack([boxes, score])) for _ in range(6)]
    assert tracker.step is not None
    assert np.array_equal(tracker.step.detections.xyxy, boxes[-30:])
    assert tracker.left_out.surplus == 6 * 170
    used = np.concatenate([each.detection for each in rows])
    # Rows count detections as they were given.
    assert len(used) > 0
    assert set(used.tolist()) <= {-1, *range(170, 200)}


def test_equal_scores_are_taken_in_their_order():
    assert Limits(max_detections=3).best(np.array([0.5, 0.9, 0.5, 0.5, 0.9])).tolist() == [0, 1, 4]


def test_each_filter_takes_as_many_as_it_can_use():
    usual = {kind: load(filter_name=kind).as_dict()["limits"]["max_detections"] for kind in KINDS}
    assert usual == dict.fromkeys(KINDS, 1000) | {
        "gm-cphd": 500,
        "particle-phd": 400,
        "particle-cphd": 400,
        "mcmc": 100,
    }
    given_one = load(None, ["limits.max_detections=7"], filter_name="mcmc")
    assert given_one.values("limits")["max_detections"] == 7


def test_crowded_boxes_beyond_the_limit_are_found():
    rng = np.random.default_rng(0)
    at = rng.uniform(0, 100, (2, 400))
    half = rng.uniform(1, 30, (2, 400))
    kept = np.ones(400, bool)
    for i in range(400):
        near = np.abs(at[:, :i] - at[:, i : i + 1]) <= np.minimum(half[:, :i], half[:, i : i + 1])
        kept[i] = (near.all(axis=0) & kept[:i]).sum() < 5
    assert 50 < kept.sum() < 350
    assert np.array_equal(uncrowded(at, half, 5), kept)


@pytest.mark.parametrize("kind", ["mht", "pmbm"])
def test_a_cluster_of_many_measurements_keeps_fewer_hypotheses(
    kind: str, monkeypatch: pytest.MonkeyPatch
):
    """What is done for a cluster is counted, and bounded; 1 000 spread detections took 57 s."""
    done = []

    def counted(
        leaf,
        weight,
        pair,
        columns,
        missed,
        unassigned,
        begins,
        limits,
        children=hypotheses.children,
    ):
        done.append(limits[0] * len(columns) * (len(pair[0]) + leaf.shape[1]))
        return children(leaf, weight, pair, columns, missed, unassigned, begins, limits)

    monkeypatch.setattr(hypotheses, "children", counted)
    tracker = tracker_of(kind)
    for k in range(3):
        tracker.update(spread(1_000) + k)
    # Of the largest cluster the best hypothesis alone is more.
    assert 1e6 < max(done) <= hypotheses.WORK


def test_pairs_of_candidates_share_a_measurement():
    """As by comparing all with all, which needed memory for the square of their number."""
    first = np.array([0, 3, 5, 8, 9])
    seen_by = np.array([-1, 0, 2, -1, 2, -1, 0, 1, -1])
    assert rivals(first, seen_by).tolist() == [[0, 1], [0, 2]]


@pytest.mark.parametrize("kind", KINDS)
def test_boxes_that_no_picture_shows_are_left_out_and_said_once(
    kind: str, caplog: pytest.LogCaptureFixture
):
    """A box 1e-6 px wide gave a count of 4.5e21 with gm-phd."""
    odd = [
        [100, 100, 100 + 1e-6, 200], [5e-324, 0, 1e-323, 10], [-1e300, -1e300, 1e300, 1e300],
        [1e300, 0, 1.1e300, 50],
        [50_000, 0, 50_040, 100], [0, 0, 30_000, 20_000], [-1.7e308, 0, 1.7e308, 9],
    ]  # fmt: skip
    plain = tracker_of(kind)
    other = tracker_of(kind)
    for k in range(5):
        plain.update(spread(3) + k)
        rows = other.update(np.vstack([spread(3) + k, odd]))
        assert plain.step is not None
        assert other.step is not None
        assert other.step.info.mass == plain.step.info.mass
        assert np.isfinite(rows.xyxy).all()
    assert other.left_out == DiscardedBoxes(misplaced=5 * len(odd))
    assert (
        sum(
            "a side below 0.001 pixels or above 10 frames" in one.getMessage()
            for one in caplog.records
        )
        == 1
    )


_NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(-3000, 3000),
    st.sampled_from([0.0, 5e-324, 1e300, -1e300]),
)
_BOXES = st.lists(st.tuples(_NUMBERS, _NUMBERS, st.floats(0, 3e4), st.floats(0, 3e4)), max_size=6)


@pytest.mark.parametrize("kind", GAUSSIAN)
@settings(max_examples=15, deadline=None)
@given(frames=st.lists(_BOXES, min_size=1, max_size=4))
def test_any_finite_boxes_keep_every_count_and_state_finite(kind: str, frames: list):
    keeps_finite(kind, frames)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in GAUSSIAN])
@settings(max_examples=15, deadline=None)
@given(frames=st.lists(_BOXES, min_size=1, max_size=4))
def test_any_finite_boxes_keep_particles_finite(kind: str, frames: list):
    keeps_finite(kind, frames)


def keeps_finite(kind: str, frames: list) -> None:
    tracker = tracker_of(kind)
    taken = 0
    for found in frames:
        table = np.array([(x, y, x + w, y + h) for x, y, w, h in found]).reshape(-1, 4)
        try:
            rows = tracker.update(table)
        except InputError:
            assert not np.isfinite(table).all()
            continue
        assert tracker.step is not None
        taken += len(tracker.step.detections)
        mass = tracker.step.info.mass
        estimates = tracker.step.estimates
        # Everyone was seen once, or is born in this frame beside a detection.
        assert 0 <= mass <= taken + len(tracker.step.detections) + 1e-6
        assert math.isfinite(mass)
        assert np.isfinite(estimates.state).all()
        assert np.isfinite(estimates.covariance).all()
        assert np.isfinite(rows.xyxy).all()


def test_the_links_of_a_vertex_are_bounded():
    """Of raw detections in one place, each would be linked to all of two seconds."""
    tracker = tracker_of("none", limits={"max_in_one_place": 400, "max_detections": 400})
    for _ in range(4):
        tracker.update(one_place(400))
    links = np.diff(tracker.state.association.window.start)
    assert links.max() == 512


def test_new_classes_share_one_replay_of_empty_frames(monkeypatch: pytest.MonkeyPatch):
    """However many classes a frame brings, of which the first hundred are tracked."""
    many = tracker_of("none")
    alone = tracker_of("none")
    done = []
    for tracker in (many, alone):
        tracker.update(np.hstack([one_place(1), [[1.0, 3.0]]]))
        for _ in range(20):
            tracker.update(np.zeros((0, 4)))

    def counted(*given, advance=pipeline.advance):
        done.append(1)
        return advance(*given)

    boxes = np.column_stack([spread(300), np.ones(300), np.arange(10, 310)])
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "advance", counted)
        many.update(boxes)
    # 21 frames for all of them, then a step of each.
    assert len(done) == 21 + 100
    assert many.left_out == DiscardedBoxes(classes=201)
    alone.update(boxes[:1])
    assert many.states[10].number == alone.states[10].number == 22
