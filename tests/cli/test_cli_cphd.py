"""`phdtrack track --filter gm-cphd` and `particle-cphd`: from detections to tracks, a report with the band of the number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, walkers

from phdtrack import Tracker
from phdtrack.cli import run_directory as rundir


@pytest.mark.parametrize(("name", "extraction"), [("gm-cphd", "components"), ("particle-cphd", "mixture")])
def test_the_cardinalised_filters_by_name(name: str, extraction: str, tmp_path: Path) -> None:
    sequence, out = walkers(tmp_path / "walkers", clutter=1), tmp_path / "run"
    truth, found = sequence / "gt" / "gt.txt", sequence / "det" / "det.txt"
    said = phdtrack("track", "--detections", found, "--truth", truth, "--out", out, "--filter", name, "--json")
    assert said.status == 0, said.err
    assert said.object["scores"]["MOTA"] > 0.8
    assert said.object["configuration"]["extract"]["kind"] == extraction
    assert "Blue band" in (out / rundir.REPORT).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["gm-cphd", "particle-cphd"])
def test_a_checkpoint_keeps_the_number(name: str) -> None:
    """A run that goes on from its saved state is the same to the bit."""
    box = np.array([[100.0, 100, 140, 200], [300, 120, 350, 230]])
    whole, first, second = (Tracker((640, 480), filter=name, seed=3) for _ in range(3))
    for k in range(6):
        for tracker in (whole, first):
            tracker.update(box + 2 * k)
    second.load_state_dict(first.state_dict())
    for k in range(6, 10):
        a, b = whole.update(box + 2 * k), second.update(box + 2 * k)
        np.testing.assert_array_equal(a.xyxy, b.xyxy)
        np.testing.assert_array_equal(whole.step.info.cardinality, second.step.info.cardinality)
    assert int(whole.step.info.cardinality.argmax()) == 2
