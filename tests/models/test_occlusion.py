"""What nearer boxes hide lowers p_D, of boxes in the image and of people on the ground; nothing else does."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack import config, pipeline
from phdtrack.models import BoxSensor, PlaneSensor
from phdtrack.types import Detections, SequenceInfo
from plane_cases import FRAME, LevelCamera

BOXES = BoxSensor(detection_probability=0.8, occlusion=True, min_detection_probability=0.2)
GROUND = PlaneSensor(
    detection_probability=0.8,
    occlusion=True,
    min_detection_probability=0.2,
    camera=LevelCamera(),
    frame_size=FRAME,
    box_noise=(0.05, 0.01),
)
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
    """A target of 40 by 100 behind others that cover a quarter, half and all of it, and one that reaches above it."""
    x = of_boxes([100, 200, 140, 300])
    for hider, part in (
        ([130, 100, 190, 400], 0.25), ([60, 250, 240, 400], 0.5), ([50, 100, 300, 420], 1.0), ([50, 100, 300, 299], 0.0),
    ):  # fmt: skip
        p = BOXES.watching(of_boxes(hider)).p_detect(x)
        np.testing.assert_allclose(p, 0.8 * max(1 - part**1.5, 0.2))
    several = of_boxes([130, 100, 190, 400], [60, 250, 240, 400], *CLEAR)
    np.testing.assert_allclose(BOXES.watching(several).p_detect(x), 0.8 * (1 - 0.5**1.5))


@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed"])
def test_a_target_does_not_hide_itself(scaling: str):
    sensor = BoxSensor(detection_probability=0.8, occlusion=True, scaling=scaling)
    itself = of_boxes([100, 200, 140, 302.0])
    np.testing.assert_array_equal(sensor.watching(itself).p_detect(of_boxes([100, 200, 140, 300])), 0.8)
    another = of_boxes([115, 220, 155, 320.0])
    assert sensor.watching(another).p_detect(of_boxes([100, 200, 140, 300]))[0] < 0.7


def test_particles_of_a_target_are_hidden_by_another_and_not_by_their_own_peak(rng):
    """Ninety-nine of a hundred particles spread by the noise about their target are within its region."""
    near, far = of_boxes([105, 180, 165, 330]), of_boxes([100, 200, 140, 300])
    spread = BoxSensor(box_noise=0.15, min_noise=0).noise(far)
    cloud = far + spread * rng.standard_normal((6, 20000)) * np.array([1, 1, 0, 0, 1, 1])[:, None]
    alone, both = (BOXES.watching(targets).p_detect(cloud) for targets in (far, np.hstack([far, near])))
    # Half of the one in a hundred stand higher than their peak and could be hidden by it.
    assert (alone < 0.8).mean() == pytest.approx(0.005, abs=0.005)
    assert (both < 0.4).mean() > 0.9


def test_in_a_crowd_a_state_is_that_of_the_nearest_hider_alone():
    """Two people within the noise of each other, 1 m apart one behind the other: the farther one is hidden all the same."""
    sensor = PlaneSensor(
        detection_probability=0.8, scaling="fixed", fixed_noise=0.7, occlusion=True, camera=LevelCamera(), frame_size=FRAME
    )
    crowd = standing((0, 20), (0, 21))
    near, far = sensor.watching(crowd).p_detect(crowd)
    assert near == 0.8
    assert far < 0.3
    assert sensor.watching(crowd[:, 1:]).p_detect(crowd)[1] == 0.8


def test_nobody_is_hidden_where_nobody_is_nearer(rng):
    """Targets whose lower edges are higher, or that are elsewhere; and nobody at all."""
    x = of_boxes(*([left, 200, left + 40, 300] for left in rng.uniform(0, 600, 50)))
    corner = np.stack([rng.uniform(0, 600, 20), rng.uniform(0, 190, 20)], axis=1)
    behind = of_boxes(*np.hstack([corner, corner + np.array([60, 100])]))
    np.testing.assert_array_equal(BOXES.watching(behind).p_detect(x), 0.8)
    np.testing.assert_array_equal(BOXES.watching(of_boxes([100, 310, 140, 420])).p_detect(x), 0.8)
    assert BOXES.watching(x[:, :0]) is BOXES


def test_on_the_ground_the_nearer_hides_the_farther():
    """Two in line with the camera, one beside them; the one in front stands four metres nearer."""
    x = standing([0, 16], [0, 12], [2, 16])
    behind, front, beside = GROUND.watching(x).p_detect(x)
    assert front == beside == pytest.approx(0.8)
    box, hider = GROUND.boxes(x)[:2]
    part = (min(box[3], hider[3]) - max(box[1], hider[1])) / (box[3] - box[1])
    assert 0.3 < part < 1
    assert behind == pytest.approx(0.8 * max(1 - part**1.5, 0.2))


def test_on_the_ground_who_is_behind_the_camera_hides_nobody():
    np.testing.assert_allclose(GROUND.watching(standing([0, -12])).p_detect(standing([0, 16], [1, 12])), 0.8)


def test_the_loop_tells_the_sensor_who_was_seen_last():
    """A person who walks behind another, undetected for ten frames: with occlusion known he is still believed in."""

    def believed(occlusion: str) -> float:
        sets = ("filter.kind=gm-phd", f"sensor.occlusion={occlusion}", "sensor.detection_probability=0.9")
        stages = config.build(config.load(None, sets), SequenceInfo(640, 480, 25.0))
        rng = np.random.default_rng(0)
        state = pipeline.start(stages, rng)
        for k in range(30):
            boxes = [[300, 150, 380, 400.0]]
            if k < 20:
                boxes.append([250 + 3 * k, 200, 290 + 3 * k, 320.0])
            state, step = pipeline.advance(stages, state, Detections.of(boxes), k + 1, k / 25, rng)
        return step.info.mass

    assert believed("false") < 1.2
    assert believed("true") > 1.5
