"""The scene's benchmark: a scene is laid over the shipped model, and what it compares is finite."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import scene
from benchmarks.parts import SMOKE


def test_ratios_of_a_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "FILTERS", ("gm-phd",))
    outcome = scene.run(SMOKE, lambda _: None)
    assert len(outcome.rows) == len(scene.CASES)
    assert all(0 < row.value < np.inf for row in outcome.rows)
    assert set(outcome.entries) == set(scene.KEYS)
