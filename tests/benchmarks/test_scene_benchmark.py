"""The scene's benchmark: a scene is laid over the shipped model, and what it compares is finite."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import scene
from benchmarks.parts import SMOKE
from benchmarks.workload import Crowd, draw
from phdtrack import config
from phdtrack.associate.rejection import FalseTrackRejection


def test_the_densities_have_as_many_places_as_said() -> None:
    stream = draw(Crowd(4, 3), 1)
    plain = config.build(config.load(), stream.info)
    for places in scene.CASES:
        stages = scene._learned(plain, (float(stream.info.width), float(stream.info.height)), places)
        model = stages.model
        assert len(model.birth.density) == (places.births or 120)
        assert len(model.clutter.density) == (places.alarms or 224)
        assert (model.birth.around_detections, model.clutter.around_detections) == (
            plain.model.birth.births_per_second,
            plain.model.clutter.clutter_per_frame,
        )
        assert isinstance(stages.associator, FalseTrackRejection)


def test_ratios_of_a_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "FILTERS", ("gm-phd",))
    outcome = scene.run(SMOKE, lambda _: None)
    assert len(outcome.rows) == len(scene.CASES)
    assert all(0 < row.value < np.inf for row in outcome.rows)
    assert set(outcome.entries) == set(scene.KEYS)
