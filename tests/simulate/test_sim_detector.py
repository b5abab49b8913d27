"""Statistics of the simulated detector, each within 4 standard errors at a fixed seed."""

from dataclasses import replace

import numpy as np
import pytest

from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.errors import InputError
from phdtrack.simulate import Detected, DetectorModel, add_clutter, detect
from phdtrack.simulate.scenes import truth_rows
from phdtrack.types import Detections, DetectionTable, SequenceInfo, Truth

INFO = SequenceInfo(640, 480, 25.0, 400, "test")
PERFECT = DetectorModel(p_detect=1.0, jitter=0.0, jitter_size=0.0, clutter_rate=0.0)
CLUTTERED = DetectorModel(clutter_rate=20.0, places=5)


@pytest.fixture(scope="module")
def truth() -> Truth:
    rng = np.random.default_rng(0)
    frame = np.repeat(np.arange(1, 401), 10)
    identity = np.tile(np.arange(1, 11), 400)
    size = np.repeat([[30.0], [80.0]], 4000, axis=1) * rng.uniform(0.5, 1.5, 4000)
    centre = rng.random((2, 4000)) * np.array([[640], [480]])
    return truth_rows(frame, identity, to_xyxy(np.concatenate([centre, size])))


def run(truth: Truth, settings: DetectorModel = PERFECT, **changes: object) -> Detected:
    return detect(truth, INFO, np.random.default_rng(1), replace(settings, **changes))  # type: ignore[arg-type]


def targets(found: Detected) -> np.ndarray:
    """Rows (frame, identity, xyxy) of the detections of targets, in the truth's order."""
    real = found.source > 0
    table = np.column_stack(
        [found.table.frame[real], found.source[real], found.table.detections.xyxy[real]]
    )
    return table[np.lexsort((table[:, 1], table[:, 0]))]


@pytest.mark.parametrize("p_detect", [0.0, 0.3, 0.9, 1.0])
def test_detection_probability_is_observed(truth: Truth, p_detect: float) -> None:
    got = targets(run(truth, p_detect=p_detect))
    assert abs(len(got) / len(truth) - p_detect) <= 4 * np.sqrt(
        p_detect * (1 - p_detect) / len(truth)
    )
    if p_detect == 1:
        assert np.allclose(got[:, 2:], truth.xyxy)


@pytest.mark.parametrize(("centre", "size"), [(0.05, 0.05), (0.075, 0.15), (0.0, 0.02)])
def test_box_noise_is_as_set(truth: Truth, centre: float, size: float) -> None:
    got = to_cxcywh(targets(run(truth, jitter=centre, jitter_size=size))[:, 2:])
    true = to_cxcywh(truth.xyxy)
    errors = np.concatenate([(got[:2] - true[:2]) / true[2:], got[2:] / true[2:] - 1])
    for error, sd in zip(errors, (centre, centre, size, size), strict=True):
        assert abs(error.mean()) <= 4 * sd / np.sqrt(len(truth)) + 1e-12
        assert abs(error.std() - sd) <= 4 * sd / np.sqrt(2 * len(truth)) + 1e-12
    if centre and size:
        assert np.abs(np.corrcoef(errors) - np.eye(4)).max() < 4 / np.sqrt(len(truth))


@pytest.mark.parametrize("rate", [2.0, 20.0])
def test_clutter_is_poisson_and_uniform(truth: Truth, rate: float) -> None:
    found = run(truth, clutter_rate=rate)
    false = found.source == 0
    number = np.bincount(found.table.frame[false], minlength=401)[1:]
    assert abs(number.mean() - rate) <= 4 * np.sqrt(rate / 400)
    assert abs(number.var() / rate - 1) < 4 * np.sqrt(2 / 400)
    x, y, w, h = to_cxcywh(found.table.detections.xyxy[false])
    for place in (x / 640, y / 480):
        assert ((place >= 0) & (place <= 1)).all()
        assert abs(place.mean() - 0.5) < 4 / np.sqrt(12 * len(x))
        assert abs(place.var() - 1 / 12) < 4 * np.sqrt(1 / 180 / len(x))
    sizes = np.round(to_cxcywh(truth.xyxy)[2:].T, 6)
    assert set(map(tuple, np.round(np.stack([w, h], axis=1), 6))) <= set(map(tuple, sizes))


def test_persistent_clutter_fires_as_set(truth: Truth) -> None:
    found = run(truth, places=5, place_fire=0.5, place_jitter=0.1)
    assert found.places.shape == (5, 4)
    assert ((found.places >= 0) & (found.places <= [640, 480, 640, 480])).all()
    for p, place in enumerate(to_cxcywh(found.places).T):
        mine = found.source == -(p + 1)
        assert abs(mine.sum() / 400 - 0.5) <= 4 * 0.5 / np.sqrt(400)
        frame = found.table.frame[mine]
        box = to_cxcywh(found.table.detections.xyxy[mine])
        assert len(np.unique(frame)) == len(frame)
        error = (box[:2].T - place[:2]) / place[2:]
        assert np.abs(error.mean(axis=0)).max() < 4 * 0.1 / np.sqrt(len(error))
        assert np.abs(error.std(axis=0) - 0.1).max() < 4 * 0.1 / np.sqrt(2 * len(error))


def test_parts_draw_from_separate_random_streams(truth: Truth) -> None:
    """Targets are the same whatever the clutter, places whatever the Poisson clutter; a higher p_D
    only adds.
    """
    plain = targets(run(truth, CLUTTERED, clutter_rate=0.0, places=0))
    for found in (run(truth, CLUTTERED), run(truth, CLUTTERED, clutter_of_all_sizes=True)):
        assert (targets(found) == plain).all()
    a, b = (run(truth, CLUTTERED, clutter_rate=rate) for rate in (0.0, 10.0))
    assert (a.places == b.places).all()
    box_a, box_b = (np.sort(f.table.detections.xyxy[f.source < 0], axis=0) for f in (a, b))
    assert (box_a == box_b).all()
    less, more = (
        {tuple(r) for r in targets(run(truth, CLUTTERED, p_detect=p))} for p in (0.6, 0.8)
    )
    assert less < more


def test_occlusion_lowers_the_detection_probability() -> None:
    frame = np.repeat(np.arange(1, 401), 2)
    identity = np.tile([1, 2], 400)
    behind = [100.0, 100, 200, 300]
    before = [100.0, 100, 150, 310]
    got = targets(
        run(truth_rows(frame, identity, np.tile([behind, before], (400, 1))), occlusion=2.0)
    )
    expected = (1 - 4 / 9) ** 2  # half of it is hidden, 4 of 9 columns of the grid
    assert (got[:, 1] == 2).sum() == 400
    assert abs((got[:, 1] == 1).sum() / 400 - expected) < 4 * np.sqrt(
        expected * (1 - expected) / 400
    )


def test_invalid_settings_are_refused(truth: Truth) -> None:
    rng = np.random.default_rng(0)
    none = DetectionTable(np.zeros(0, np.int64), Detections.empty())
    sizes = np.zeros((0, 2))
    with pytest.raises(InputError, match="DetectorModel"):
        DetectorModel(p_detect=1.2)
    with pytest.raises(InputError, match="frames"):
        detect(truth, replace(INFO, frames=399), rng, PERFECT)
    for info, rate, words in (
        (replace(INFO, frames=0), 1.0, "number of frames"),
        (INFO, -1.0, "clutter rate"),
    ):
        with pytest.raises(InputError, match=words):
            add_clutter(none, info, rate, rng, sizes)
    assert len(add_clutter(none, INFO, 3.0, rng, sizes)) > 1000


@pytest.mark.parametrize("rate", [0.0, 2.0, 10.0])
def test_added_clutter_keeps_the_detections(rate: float) -> None:
    rng = np.random.default_rng(3)
    sizes = np.array([[20.0, 50.0], [30.0, 90.0]])
    box = np.concatenate([rng.random((2, 500)) * 400, rng.random((2, 500)) * 50 + 5])
    found = Detections(
        to_xyxy(box), rng.random(500), rng.integers(0, 3, 500), np.tile(np.eye(4), (500, 1, 1))
    )
    table = DetectionTable(np.sort(rng.integers(10, 200, 500)), found)
    more = add_clutter(table, INFO, rate, np.random.default_rng(4), sizes)
    assert abs((len(more) - len(table)) / 400 - rate) <= 4 * np.sqrt(rate / 400)
    assert (np.diff(more.frame) >= 0).all()
    assert more.detections.covariance is not None
    assert more.detections.covariance.shape == (len(more), 4, 4)
    old, new = (
        {
            tuple(row)
            for row in np.column_stack([t.frame, t.detections.xyxy, t.detections.confidence])
        }
        for t in (table, more)
    )
    assert old <= new
    if rate:
        assert {1, 400} & set(more.frame[[0, -1]])
        assert len(np.unique(more.frame)) > 0.7 * 400
        added = np.array(sorted(new - old))
        assert set(np.round(added[:, 3] - added[:, 1], 6)) == {20.0, 30.0}
        assert set(more.detections.confidence) <= set(table.detections.confidence)
