"""With known parameters the mass of the intensity is the number of targets: the experiment of
docs/results/count.md.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from experiments import count
from experiments.counting_scene import Counting
from phdtrack.arrays import to_cxcywh
from phdtrack.simulate import add_clutter
from phdtrack.types import Detections, DetectionTable

ASKED = 0.10


@pytest.mark.parametrize(
    ("p_detect", "clutter", "laws"), [(0.98, 0.0, "known"), (0.9, 5.0, "shipped")]
)
def test_the_count_is_the_truth(p_detect: float, clutter: float, laws: count.Laws):
    found = count.row(
        p_detect, clutter, seeds=range(3), frames=60, laws=laws, particles_per_target=600
    )
    assert 5 < found.truth < 15
    assert abs(found.bias) <= ASKED
    assert found.rms < 0.2 * found.truth


@pytest.mark.slow
@pytest.mark.parametrize("laws", ["known", "shipped"])
@pytest.mark.parametrize("p_detect", count.P_DETECT)
@pytest.mark.parametrize("clutter", count.CLUTTER)
def test_every_combination(p_detect: float, clutter: float, laws: count.Laws):
    assert abs(count.row(p_detect, clutter, laws=laws).bias) <= ASKED


def test_the_clutter_of_the_scene_is_what_the_simulator_draws(rng):
    """λ over expected values: E[1/κ] over drawn false alarms is the volume they occur in, over the
    rate.
    """
    scene = Counting(10, frames=4000)
    nothing = DetectionTable(np.zeros(0, np.int64), Detections.empty())
    z = to_cxcywh(add_clutter(nothing, scene.info, 5.0, rng, np.zeros((0, 2))).detections.xyxy)
    density = count.SceneClutter(scene, 5.0).intensity(z)
    assert np.all(density > 0)
    # ∫ h dh times the range of aspects, over the frame.
    low = 0.08 * 720
    high = 0.5 * 720
    volume = 1280 * 720 * quad(lambda h: h, low, high)[0] * (1 - 1 / 3)
    assert np.mean(5.0 / density) == pytest.approx(volume, rel=0.03)
    assert count.SceneClutter(scene, 5.0).intensity(np.array([[-1.0], [5], [50], [100]]))[0] == 0
