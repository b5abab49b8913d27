"""What nearer boxes hide lowers p_D, of boxes in the image and of people on the ground; nothing else does."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.models import BoxSensor, PlaneSensor
from phdtrack.types import Detections
from plane_cases import FRAME, LevelCamera

BOXES = BoxSensor(detection=0.8, occlusion=True, least=0.2)
GROUND = PlaneSensor(detection=0.8, occlusion=True, least=0.2, camera=LevelCamera(), frame_size=FRAME, spread=(0.05, 0.01))
CLEAR = [[10.0, 300, 40, 400]]


def of_boxes(*boxes) -> np.ndarray:
    """(6, n) states at rest with these boxes."""
    left, top, right, bottom = np.array(boxes, float).T
    nothing = np.zeros(len(boxes))
    return np.stack([(left + right) / 2, (top + bottom) / 2, nothing, nothing, right - left, bottom - top])


def standing(*places) -> np.ndarray:
    """(4, n) people at rest."""
    x, y = np.array(places, float).T
    return np.stack([x, y, 0 * x, 0 * x])


def test_a_share_of_the_box_is_hidden_and_no_more_than_all_but_the_least():
    """A target of 40 by 100 behind boxes that cover a quarter, half and all of it, and one that reaches above it."""
    x = of_boxes([100, 200, 140, 300])
    for hider, part in (
        ([130, 100, 190, 400], 0.25), ([60, 250, 240, 400], 0.5), ([50, 100, 300, 420], 1.0), ([50, 100, 300, 299], 0.0),
    ):  # fmt: skip
        p = BOXES.watching(Detections.of([hider])).p_detect(x)
        np.testing.assert_allclose(p, 0.8 * max(1 - part, 0.2))


def test_the_largest_share_counts():
    hiders = Detections.of([[130, 100, 190, 400], [60, 250, 240, 400], *CLEAR])
    np.testing.assert_allclose(BOXES.watching(hiders).p_detect(of_boxes([100, 200, 140, 300])), 0.8 * 0.5)


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_the_box_that_a_target_may_have_given_hides_nothing(scaling: str):
    sensor = BoxSensor(detection=0.8, occlusion=True, scaling=scaling)
    own = [[100, 200, 140, 301.0]]
    np.testing.assert_array_equal(sensor.watching(Detections.of(own)).p_detect(of_boxes([100, 200, 140, 300])), 0.8)


def test_who_is_seen_is_not_hidden():
    """A detection of its own says so, whatever stands before it; without that detection it is hidden."""
    x, before, own = of_boxes([100, 200, 140, 300]), [60, 250, 240, 400.0], [101, 201, 141, 299.0]
    np.testing.assert_array_equal(BOXES.watching(Detections.of([before, own])).p_detect(x), 0.8)
    np.testing.assert_allclose(BOXES.watching(Detections.of([before])).p_detect(x), 0.4)


def test_nobody_is_hidden_where_nothing_is_nearer(rng):
    """Boxes whose lower edges are higher, or that are elsewhere; and no box at all."""
    x = of_boxes(*([left, 200, left + 40, 300] for left in rng.uniform(0, 600, 50)))
    corner = np.stack([rng.uniform(0, 600, 20), rng.uniform(0, 190, 20)], axis=1)
    behind = Detections.of(np.hstack([corner, corner + np.array([60, 100])]))
    np.testing.assert_array_equal(BOXES.watching(behind).p_detect(x), 0.8)
    np.testing.assert_array_equal(BOXES.watching(Detections.of([[100, 310, 140, 420]])).p_detect(x), 0.8)
    assert BOXES.watching(Detections.empty()) is BOXES


def test_without_the_setting_nothing_is_hidden():
    constant = BoxSensor(detection=0.8)
    assert constant.watching(Detections.of([[50, 100, 300, 420]])) is constant
    ground = PlaneSensor(camera=LevelCamera(), occlusion=False)
    assert ground.watching(Detections.of([[50, 100, 300, 420]])) is ground
    plan = PlaneSensor(scaling="fixed")
    assert plan.watching(Detections.of([[50, 100, 300, 420]])) is plan


def test_on_the_ground_the_nearer_hides_the_farther():
    """Two in line with the camera, one beside them; the one in front stands four metres nearer."""
    x = standing([0, 16], [0, 12], [2, 16])
    seen = Detections.of(GROUND.boxes(standing([0, 12])))
    behind, front, beside = GROUND.watching(seen).p_detect(x)
    assert front == beside == pytest.approx(0.8)
    box, hider = GROUND.boxes(x)[0], seen.xyxy[0]
    part = (min(box[3], hider[3]) - max(box[1], hider[1])) / (box[3] - box[1])
    assert 0.3 < part < 1
    assert behind == pytest.approx(0.8 * (1 - part))


def test_on_the_ground_what_has_no_foot_hides_nobody():
    above = Detections.of([[250, -400, 390, 30]])
    np.testing.assert_allclose(GROUND.watching(above).p_detect(standing([0, 16], [1, 12])), 0.8)


def test_order_does_not_matter(rng):
    corner = rng.uniform(0, 400, (60, 2))
    hiders = np.hstack([corner, corner + rng.uniform(20, 150, (60, 2))])
    x = of_boxes(*np.hstack([corner[:30] + 5, corner[:30] + rng.uniform(30, 120, (30, 2))]))
    p = BOXES.watching(Detections.of(hiders)).p_detect(x)
    assert len(set(p)) > 6
    shuffled = rng.permutation(60)
    np.testing.assert_array_equal(BOXES.watching(Detections.of(hiders[shuffled])).p_detect(x), p)
    back = rng.permutation(30)
    np.testing.assert_array_equal(BOXES.watching(Detections.of(hiders)).p_detect(x[:, back]), p[back])
