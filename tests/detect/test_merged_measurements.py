"""The merged-measurement model: what it may change, and identities through a merged blob in the
whole tracker.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.common import Case
from experiments.meetings import PARTINGS, leaving, met
from phdtrack import config
from phdtrack.arrays import intersection, to_cxcywh
from phdtrack.detect.merged import ExpectedTargets, MergedMeasurements
from phdtrack.errors import InputError
from phdtrack.protocols import Model
from phdtrack.tracker import Tracker
from phdtrack.types import F8, Detections, DetectionTable, DividedDetections, SequenceInfo, Tracks

INFO = SequenceInfo(640, 480, 25.0)
MODEL: Model = config.build(config.load(), INFO).model
ALWAYS = MergedMeasurements(min_separate_time=0.0)


def expected(boxes: F8, **given: F8) -> ExpectedTargets:
    """Targets at rest that were seen well at these boxes (n, 4)."""
    n = len(boxes)
    state, covariance = MODEL.sensor.states(to_cxcywh(boxes))
    values = {"hidden": np.zeros(n), "separate": np.full(n, 9.0)} | given
    return ExpectedTargets(state, covariance * 0.05, np.full(n, 0.99), **values)


def explain(
    targets: ExpectedTargets, blobs: F8, rule: MergedMeasurements = ALWAYS
) -> tuple[ExpectedTargets, DividedDetections]:
    seen = Detections.of(blobs)
    return rule.explain(targets, seen, MODEL.sensor.measure(seen), MODEL, 1.0)


PAIR = np.array([[100.0, 100, 140, 200], [125, 104, 165, 204]])
BLOB = np.array([[98.0, 99, 168, 205]])
boxes = st.lists(
    st.tuples(st.integers(0, 300), st.integers(0, 200), st.integers(20, 60), st.integers(40, 120)),
    min_size=0,
    max_size=7,
).map(
    lambda rows: np.array([[x, y, x + w, y + h] for x, y, w, h in rows], np.float64).reshape(-1, 4)
)


def test_merged_box_is_divided_by_its_edges() -> None:
    _, found = explain(expected(PAIR), BLOB)
    assert found.changed
    assert len(found.detections) == 2
    assert found.source.tolist() == [0, 0]
    assert found.part.tolist() == [0]
    left, right = found.detections.xyxy[np.argsort(found.target)]
    np.testing.assert_allclose([left[0], right[2]], [98, 168])
    np.testing.assert_allclose([left[2] - left[0], right[2] - right[0]], [40, 40])
    assert (found.detections.xyxy[:, 1] >= 99).all()
    assert (found.detections.xyxy[:, 3] <= 205).all()


def test_merged_box_looks_like_none_of_its_targets() -> None:
    alone = PAIR[:1] + 300.0
    blobs = np.vstack([BLOB, alone])
    seen = Detections.of(blobs, embeddings=np.ones((2, 5)))
    targets = expected(np.vstack([PAIR, alone]))
    _, found = ALWAYS.explain(targets, seen, MODEL.sensor.measure(seen), MODEL, 1.0)
    assert found.source.tolist() == [0, 0, 1]
    embeddings = found.detections.embeddings
    assert embeddings is not None
    assert embeddings.dtype == np.float32
    assert embeddings.any(axis=1).tolist() == [False, False, True]


def test_separate_boxes_are_unchanged() -> None:
    _, found = explain(expected(PAIR), PAIR + 1.0)
    assert not found.changed
    np.testing.assert_array_equal(found.detections.xyxy, PAIR + 1.0)


@pytest.mark.parametrize(
    ("rule", "given"),
    [
        (MergedMeasurements(merge_probability=0.0), {}),
        (MergedMeasurements(min_separate_time=0.4), {"separate": np.array([9.0, 0.3])}),
    ],
)
def test_zero_merge_probability_divides_no_box(
    rule: MergedMeasurements, given: dict[str, F8]
) -> None:
    _, found = explain(expected(PAIR, **given), BLOB, rule)
    assert not found.changed


def test_target_stays_hidden_for_max_hidden_time() -> None:
    inside = np.array([[100.0, 100, 160, 200], [110, 100, 140, 200]])
    blob = inside[:1]
    before, found = explain(expected(inside), blob)
    assert found.changed
    assert before.hidden.tolist() == [0.0, pytest.approx(1 / 25)]
    _, found = explain(expected(inside, hidden=np.array([0.0, 3.1])), blob)
    assert not found.changed


@settings(deadline=None, max_examples=150)
@given(boxes, boxes)
def test_every_box_is_used_in_any_order(targets: F8, blobs: F8) -> None:
    state = expected(targets)
    _, found = explain(state, blobs)
    # Every blob went somewhere, and every detection rests on a blob.
    assert len(found.part) == len(blobs)
    assert len(found.source) == len(found.detections) == len(found.target)
    whole = {int(s) for s in found.source}
    assert whole == {int(found.source[p]) for p in found.part}
    shared = np.bincount(found.source, minlength=len(blobs))
    named = found.target[found.target >= 0]
    assert len(named) == len(set(named.tolist()))
    for b in np.flatnonzero(shared > 1):
        assert (found.target[found.source == b] >= 0).all()
    order = np.random.default_rng(len(blobs) + 7 * len(targets)).permutation(len(blobs))
    _, other = explain(state, blobs[order])
    mine, theirs = (np.round(d.detections.xyxy, 9).tolist() for d in (found, other))
    assert sorted(mine) == sorted(theirs)


def test_raw_detections_are_not_divided() -> None:
    with pytest.raises(InputError, match="does not fit"):
        config.load(None, ("filter.kind=none", "merged_measurements.kind=explained"))


SEEDS = range(3)


def shared(boxes: F8) -> F8:
    """The boxes of two as a change detector sees them: one blob where they overlap."""
    touching = len(boxes) == 2 and float(intersection(boxes[:1], boxes[1:])[0, 0]) > 0
    return (
        np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])[None]
        if touching
        else boxes
    )


def merging(parting: str, seed: int) -> Case:
    """A meeting whose blobs are the truth's boxes with a little noise."""
    scene = met("crossing" if parting == "crossing" else "turning back", seed)
    rng = np.random.default_rng(seed)
    frame = []
    boxes = []
    for number in range(1, scene.info.frames + 1):
        found = shared(scene.truth.xyxy[scene.truth.frame == number])
        frame.append(np.full(len(found), number))
        boxes.append(found + rng.normal(0, 1.0, found.shape))
    table = DetectionTable(np.concatenate(frame), Detections.of(np.concatenate(boxes)))
    return Case(parting, scene.info, scene.truth, table)


def tracked(case: Case, filter_name: str, kind: str) -> Tracks:
    """Corrected tracks."""
    size = (case.info.width, case.info.height)
    tracker = Tracker(
        size, fps=case.info.fps, filter=filter_name, merged_measurements={"kind": kind}
    )
    for number in range(1, case.info.frames + 1):
        tracker.update(case.table.at(number))
    return tracker.tracks()


@pytest.mark.parametrize(("filter_name", "partings"), [("pmb", PARTINGS), ("gm-phd", PARTINGS[1:])])
def test_identities_survive_a_merged_box(filter_name: str, partings: tuple[str, ...]) -> None:
    right = {"none": 0, "explained": 0}
    for parting in partings:
        for seed in SEEDS:
            case = merging(parting, seed)
            for kind in right:
                right[kind] += leaving(case, tracked(case, filter_name, kind)) == "right"
    pairs = len(partings) * len(SEEDS)
    assert right["none"] <= pairs // 3
    assert right["explained"] >= pairs // 2


def test_rows_refer_to_the_merged_detection() -> None:
    case = merging("turning back", 0)
    corrected = tracked(case, "gm-phd", "explained")
    count = np.array([len(case.table.at(int(number))) for number in corrected.frame])
    assert (corrected.detection < count).all()
    alone = [n for n in range(90, case.info.frames) if len(case.table.at(n)) == 1]
    both = [n for n in alone if (corrected.detection[corrected.frame == n] == 0).sum() == 2]
    assert len(both) > 0.7 * len(alone)


@pytest.mark.parametrize(
    ("detector", "sets", "kind"),
    [
        ("change", (), "explained"),
        ("mog2", (), "explained"),
        ("person", (), "none"),
        ("", (), "none"),
        ("change", ("merged_measurements.kind=none",), "none"),
        ("change", ("filter.kind=none",), "none"),
        ("change", ("motion.kind=plane",), "none"),
    ],
)
def test_background_detectors_use_merged_measurements(
    detector: str, sets: tuple[str, ...], kind: str
) -> None:
    assert config.load(None, sets, detector=detector).kind("merged_measurements") == kind
