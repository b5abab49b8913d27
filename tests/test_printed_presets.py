"""Each preset that is named after a paper has the values that the paper prints.

The tables are those of the papers, in their units; a value per frame is read at the paper's frame
rate. What a paper does not print is not in its table.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phdtrack import config
from phdtrack.arrays import chi2_quantile
from phdtrack.config import build_groups
from phdtrack.protocols import AnyStages
from phdtrack.types import SequenceInfo

PAPERS = {
    # M07 §2, §3 and §5; per frame at 25 Hz.
    "m07": {
        ("time", "units_per_second"): 25.0,
        ("motion", "acceleration"): 0.03,
        ("motion", "size_noise"): 0.1,
        ("motion", "scaled_noise"): True,
        ("motion", "survival_probability"): 0.99**25,
        ("sensor", "detection_probability"): 1 - 0.05,
        ("sensor", "box_noise"): 0.15,
        ("sensor", "min_noise"): 1.0,
        ("sensor", "scaling"): "detection",
        ("birth", "births_per_detection"): 0.01 * 25,
        ("birth", "births_per_second"): 0.0,
        ("birth", "particles"): 1000,
        ("clutter", "clutter_per_detection"): 1.0,
        ("clutter", "clutter_per_frame"): 0.0,
        ("filter", "kind"): "particle-phd",
        ("filter", "particles_per_target"): 1500,
        ("filter", "max_particles"): 0,
        ("filter", "skip_empty_frames"): False,
        ("extract", "kind"): "kmeans-printed",
        ("extract", "min_weight"): 0.6,
        ("extract", "split_weight"): 1.0,
        ("associate", "min_track_length"): 5,
        ("associate", "gap_cost"): 0.0,
        ("associate", "min_link_gain"): 0.0,
    },
    # M09 §III: M07's numbers with σ from the particle, and a mixture at 0.5.
    "m09": {
        ("motion", "acceleration"): 0.03,
        ("motion", "size_noise"): 0.1,
        ("motion", "survival_probability"): 0.99**25,
        ("sensor", "scaling"): "particle",
        ("sensor", "box_noise"): 0.15,
        ("sensor", "min_noise"): 0.0,
        ("birth", "births_per_second"): 0.01 * 25,
        ("clutter", "clutter_per_frame"): 1.0,
        ("filter", "particles_per_target"): 1500,
        ("extract", "kind"): "mixture-printed",
        ("extract", "min_weight"): 0.5,
        ("birth", "particles"): 1000,
    },
    # M09 §V, for the comparison with multiple hypotheses.
    "fv": {
        ("motion", "scaled_noise"): False,
        ("motion", "acceleration"): 1.5**0.5,
        ("motion", "size_noise"): 4**0.5,
        ("sensor", "scaling"): "fixed",
        ("sensor", "fixed_noise"): (3**0.5, 6**0.5),
        ("filter", "kind"): "particle-phd",
        ("extract", "kind"): "mixture-printed",
        ("extract", "min_weight"): 0.5,
    },
    "m09-mht": {
        ("motion", "scaled_noise"): False,
        ("motion", "acceleration"): 1.5**0.5,
        ("motion", "size_noise"): 4**0.5,
        ("sensor", "fixed_noise"): (3**0.5, 6**0.5),
        ("sensor", "detection_probability"): 0.97,
        ("filter", "kind"): "mht",
        ("filter", "termination_frames"): 150,
        ("filter", "new_target_density"): 0.0025,
        ("filter", "false_alarm_density"): 0.00007,
        ("filter", "history"): 10,
        ("filter", "hypothesis_threshold"): 0.001,
        ("filter", "max_hypotheses"): 300,
    },
    # E13 §4; per frame at 7 Hz.
    "e13": {
        ("motion", "acceleration"): 1.0,
        ("motion", "form"): "piecewise",
        ("motion", "survival_probability"): 0.99**7,
        ("sensor", "detection_probability"): 0.7,
        ("sensor", "fixed_noise"): 0.5**0.5,
        ("sensor", "occlusion"): False,
        ("clutter", "density"): 1e-8,
        ("filter", "kind"): "gm-phd",
        ("filter", "max_components"): 100,
        ("extract", "min_weight"): 0.5,
        # x, y, weight per second, variances of position and velocity; the paper's are 0.01, 0.001
        # and 0.0001 per frame, with unit covariances.
        ("birth", "kind"): "places",
        ("birth", "places"): [
            (-8.0, 6.0, 0.01 * 7, 1.0, 1.0),
            (-10.0, -15.0, 0.001 * 7, 1.0, 1.0),
            (15.0, -8.0, 0.0001 * 7, 1.0, 1.0),
        ],
        # x, y, weight, deviations of position and velocity: diag(0.1, 0.1, 1, 1).
        ("filter", "initial"): [
            (-11.2197, -13.1848, 1.0, 0.1**0.5, 1.0),
            (-11.1650, -14.1883, 1.0, 0.1**0.5, 1.0),
            (-9.2323, -13.8840, 1.0, 0.1**0.5, 1.0),
            (-7.9414, 4.3781, 1.0, 0.1**0.5, 1.0),
        ],
        ("groups", "kind"): "intensity",
        ("groups", "max_distance"): 2.0,
    },
    # D14 §III; N is for each estimated target.
    "d14": {
        ("time", "units_per_second"): 25.0,
        ("motion", "noise_variance"): 2.0,
        ("motion", "survival_probability"): 1.0,
        ("birth", "kind"): "uniform",
        ("birth", "births_per_second"): 2.5,
        ("sensor", "detection_probability"): 1.0,
        ("birth", "particles"): 10,
        ("clutter", "clutter_per_frame"): 0.0,
        ("filter", "particles_per_target"): 4000,
        ("filter", "max_particles"): 0,
        ("filter", "skip_empty_frames"): True,
    },
}
# What the papers do not do.
NOT_THEIRS = {
    ("detection_scores", "kind"): "none",
    ("merged_measurements", "kind"): "none",
    ("common_motion", "kind"): "none",
    ("smooth", "stitching"): False,
    ("smooth", "smoothing"): False,
    ("smooth", "detection_share"): False,
}
# The association of M07 and M09 has neither prices of gaps nor predicted rows.
PRINTED_GRAPH = {
    ("associate", "kind"): "graph",
    ("associate", "gap_cost"): 0.0,
    ("associate", "min_link_gain"): 0.0,
    ("associate", "bridge_gaps"): False,
    ("associate", "back_dating"): 0,
    ("associate", "max_coast"): 0.0,
}


def value_of(values: dict[str, Any], section: str, name: str) -> Any:
    """A setting of a loaded preset, by section and name."""
    return values[section][name]


@pytest.mark.parametrize("paper", PAPERS)
def test_a_preset_equals_its_printed_table(paper: str):
    values = config.load(preset=paper).as_dict()
    for (section, name), printed in (PAPERS[paper] | NOT_THEIRS).items():
        found = value_of(values, section, name)
        if isinstance(printed, list):
            np.testing.assert_allclose(found, printed, rtol=1e-12, err_msg=name)
        elif isinstance(printed, float | tuple):
            assert found == pytest.approx(printed, rel=1e-12), (section, name)
        else:
            assert found == printed, (section, name)
    # States are never joined: the printed extractions have no setting for it.
    assert values["extract"].get("merge_iou", 1.0) == 1.0
    if value_of(values, "extract", "kind").endswith("printed"):
        assert "merge_iou" not in values["extract"]


@pytest.mark.parametrize("paper", ["m07", "m09", "fv"])
def test_the_association_of_the_papers_has_nothing_of_ours(paper: str):
    values = config.load(preset=paper).as_dict()
    for (section, name), printed in PRINTED_GRAPH.items():
        assert value_of(values, section, name) == printed, (section, name)


@pytest.mark.parametrize("preset", ["fv", "m09-mht"])
def test_fixed_variances_are_the_printed_ones(preset: str):
    """Of measurements 3 and 6, of an unknown velocity 200 along each axis."""
    model = config.build(config.load(preset=preset), SequenceInfo(360, 288, 25.0)).model
    z = np.array([[100.0], [80], [20], [40]])
    state, covariance = model.sensor.states(z)
    np.testing.assert_allclose(np.diag(model.sensor.covariance(z, state)[0]), [3, 3, 6, 6])
    np.testing.assert_allclose(np.diag(covariance[0])[2:4], [200, 200])
    _, _, noise = model.motion.transition(state, 1.0)
    # One acceleration drives position and velocity of an axis.
    np.testing.assert_allclose(np.diag(noise[0]), [1.5 / 4, 1.5 / 4, 1.5, 1.5, 4, 4])


def test_e13_has_its_printed_thresholds_of_groups():
    stages = build_groups(config.load(preset="e13"))
    assert stages.grouping.max_distance == 2.0
    assert stages.grouping.max_speed_difference == 1.0


def built(preset: str, **sections: Any) -> AnyStages:
    """The stages of a preset for a video at its paper's frame rate."""
    return config.build(config.load(preset=preset, **sections), SequenceInfo(360, 288, 25.0))


@pytest.mark.parametrize("paper", ["m07", "m09", "fv"])
def test_the_window_of_the_association_has_50_frames(paper: str):
    assert built(paper).associator.window * 25 == 50


def test_the_gate_of_m09s_rival_is_20():
    """A squared distance in the four dimensions of a box."""
    gate = built("m09-mht").filter.gate_probability
    assert chi2_quantile(4, gate) == pytest.approx(20, abs=0.01)


def test_e13_prunes_and_merges_as_printed():
    values = config.load(preset="e13", sets=["camera.region=[-20, -20, 20, 20]"])
    filter_ = config.build(values, SequenceInfo(768, 576, 7.0)).filter
    assert filter_.weight_threshold == 1e-5
    assert filter_.merge_distance == 2.0
