"""What nearer people hide lowers p_D, on the ground; nothing else does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phdtrack import config, pipeline
from phdtrack.models import BoxSensor, PlaneSensor
from phdtrack.models.plane import Hiders
from phdtrack.types import Detections, SequenceInfo
from plane_cases import FRAME, LevelCamera

ROWS = [0, 1, 4, 5]
GROUND = PlaneSensor(
    detection_probability=0.8,
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
    return np.stack(
        [(left + right) / 2, (top + bottom) / 2, nothing, nothing, right - left, bottom - top]
    )


def seen(x: np.ndarray, hiders: np.ndarray) -> np.ndarray:
    """The share of p_D that is left of boxes behind others; the lower a box's lower edge, the
    nearer.
    """
    sensor = BoxSensor()
    boxes, others = sensor.boxes(x), sensor.boxes(hiders)
    those = Hiders(others, -others[:, 3], hiders[ROWS], sensor.noise(hiders)[ROWS], 13.28, 0.2)
    return those.visible_part(x[ROWS], boxes, -boxes[:, 3])


def standing(*places) -> np.ndarray:
    """(4, n) people at rest."""
    x, y = np.array(places, float).T
    return np.stack([x, y, 0 * x, 0 * x])


def test_hidden_share_leaves_the_least_detection_probability():
    """A target of 40 by 100 behind others that cover a quarter, half and all of it, and one that
    reaches above it.
    """
    x = of_boxes([100, 200, 140, 300])
    for hider, part in (
        ([130, 100, 190, 400], 0.25),
        ([60, 250, 240, 400], 0.5),
        ([50, 100, 300, 420], 1.0),
        ([50, 100, 300, 299], 0.0),
    ):
        np.testing.assert_allclose(seen(x, of_boxes(hider)), max(1 - part**1.5, 0.2))
    several = of_boxes([130, 100, 190, 400], [60, 250, 240, 400], *CLEAR)
    np.testing.assert_allclose(seen(x, several), 1 - 0.5**1.5)


def test_a_target_does_not_hide_itself():
    itself = of_boxes([100, 200, 140, 302.0])
    another = of_boxes([115, 220, 155, 320.0])
    np.testing.assert_array_equal(seen(of_boxes([100, 200, 140, 300]), itself), 1.0)
    assert seen(of_boxes([100, 200, 140, 300]), another)[0] < 0.7


def test_particles_are_hidden_by_others_not_by_their_own_peak(rng):
    """Ninety-nine of a hundred particles spread by the noise about their target are within its
    region.
    """
    near = of_boxes([105, 180, 165, 330])
    far = of_boxes([100, 200, 140, 300])
    spread = BoxSensor().noise(far)
    cloud = far + spread * rng.standard_normal((6, 20000)) * np.array([1, 1, 0, 0, 1, 1])[:, None]
    alone, both = (seen(cloud, targets) for targets in (far, np.hstack([far, near])))
    # Half of the one in a hundred stand higher than their peak and could be hidden by it.
    assert (alone < 1.0).mean() == pytest.approx(0.005, abs=0.005)
    assert (both < 0.5).mean() > 0.9


def test_in_a_crowd_a_state_is_that_of_the_nearest_hider_alone():
    """Two people within the noise of each other, 1 m apart one behind the other: the farther one is
    hidden all the same.
    """
    sensor = PlaneSensor(
        detection_probability=0.8,
        scaling="fixed",
        fixed_noise=0.7,
        occlusion=True,
        camera=LevelCamera(),
        frame_size=FRAME,
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
    np.testing.assert_array_equal(seen(x, behind), 1.0)
    np.testing.assert_array_equal(seen(x, of_boxes([100, 310, 140, 420])), 1.0)
    assert GROUND.watching(standing((0, 16))[:, :0]) is GROUND


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
    np.testing.assert_allclose(
        GROUND.watching(standing([0, -12])).p_detect(standing([0, 16], [1, 12])), 0.8
    )


def test_the_loop_tells_the_sensor_who_was_seen_last():
    """A person who walks behind another, undetected for ten frames: with occlusion known he is
    still believed in.
    """

    def believed(occlusion: bool) -> float:
        sets = ("filter.kind=gm-phd", "motion.kind=plane", "extract.merge_iou=1.0")
        stages = config.build(config.load(None, sets), SequenceInfo(640, 480, 25.0))
        # As high as the heads: he is hidden altogether.
        low = LevelCamera(height=1.75)
        sensor = replace(
            GROUND,
            camera=low,
            detection_probability=0.9,
            min_detection_probability=0.1,
            occlusion=occlusion,
        )
        stages = replace(stages, model=replace(stages.model, sensor=sensor))
        rng = np.random.default_rng(0)
        state = pipeline.start(stages, rng)
        for k in range(30):
            places = [(0, 12), (0.02 * k - 0.45, 16)] if k < 20 else [(0, 12)]
            found = Detections.of(sensor.boxes(standing(*places)))
            state, step = pipeline.advance(stages, state, found, k + 1, k / 25, rng)
        return step.info.mass

    assert believed(False) < 1.2
    assert believed(True) > 1.5
