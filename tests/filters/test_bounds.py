"""Settings out of bounds are refused by name, whatever the filter, extractor or sensor."""

from __future__ import annotations

import pytest

from phdtrack.errors import InputError
from phdtrack.filters import GMCPHD, GMPHD, PMB, ParticleCPHD, ParticlePHD
from phdtrack.filters.extract import Components, KMeans, Mixture
from phdtrack.models import PlaneSensor
from phdtrack.models.detection_scores import DetectionScores
from phdtrack.smooth.smoothing import Smoothing

WRONG = {
    GMPHD: {"weight_threshold": -1.0, "merge_distance": -1.0, "max_components": -1,
    "gate_probability": 0.0},
    GMCPHD: {"gate_probability": -1.0},
    ParticlePHD: {"particles_per_target": 0, "max_particles": -1},
    ParticleCPHD: {"particles_per_target": 0},
    PMB: {
        "static_clutter_prior": 1.5, "mean_occluded_time": 0.0, "max_hypotheses": 0,
        "mean_visible_time": -1.0,
        "existence_threshold": 0.0, "noise_freedom": -1.0, "noise_memory": 0.0,
        "acceleration_factors": (1.0, 0.0),
    },
    KMeans: {"min_weight": 0.0, "split_weight": -1.0, "iterations": 0, "merge_iou": 0.0},
    Mixture: {"min_weight": 0.0, "split_weight": -1.0, "iterations": 0, "merge_iou": 0.0},
    Components: {"min_weight": 0.0, "merge_iou": 0.0},
    DetectionScores: {"slope": 0.0, "even_score": 1.0, "max_odds": 0.5},
    PlaneSensor: {"size": (0.0, 1.0), "box_noise": (0.1, -1.0), "borders": (0.0, 0, 0, 1)},
    Smoothing: {"reentry_probability": 1.0, "mean_occluded_time": 0.0},
}  # fmt: skip


@pytest.mark.parametrize(("kind", "wrong"), WRONG.items())
def test_settings_out_of_bounds(kind: type, wrong: dict[str, object]):
    for name, value in wrong.items():
        with pytest.raises(InputError, match=name):
            kind(**{name: value})
