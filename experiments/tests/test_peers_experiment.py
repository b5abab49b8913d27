"""Counts and sentences of the page of peers for made-up scores, and the calls of the peers'
harness.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import peers
from experiments.common import Options
from phdtrack.errors import InputError
from phdtrack.formats import read_detections
from phdtrack.metrics import evaluate
from phdtrack.types import Tracks, Truth

BOX = np.array([[10.0, 10, 20, 30]])
PEERS = {
    ("public", "ALL"): [
        {"name": "sort", "HOTA": "40.0", "MOTA": "50.0", "IDF1": "45.0"},
        {"name": "norfair", "HOTA": "42.0", "MOTA": "30.0", "IDF1": "60.0"},
        {"name": "oracle", "HOTA": "99.0", "MOTA": "99.0", "IDF1": "99.0"},
    ],
    ("public", "A"): [{"name": "sort", "HOTA": "50.0", "MOTA": "60.0", "IDF1": "70.0"}],
}


def truth(frames: int) -> Truth:
    number = np.arange(1, frames + 1)
    return Truth(
        number,
        np.ones(frames, np.int64),
        np.repeat(BOX, frames, axis=0),
        np.zeros(frames, np.bool_),
    )


def outcome(found: int, frames: int = 10) -> peers.PeerScores:
    """Corrected tracks that have the object in ``found`` of the frames, and online in half as
    many.
    """

    def scores(n: int):
        rows = truth(n)
        tracks = Tracks(
            rows.frame,
            rows.identity,
            rows.xyxy,
            np.ones(n),
            np.zeros(n, np.int64),
            np.ones(n, np.bool_),
        )
        return evaluate(truth(frames), tracks, frames=frames)

    return peers.PeerScores(scores(found // 2), scores(found))


@pytest.fixture
def found() -> peers.ComparedRuns:
    results = {}
    for method, count in (("pmb", 8), ("none", 6)):
        results[peers.PeerRun("public", "A", method)] = outcome(count)
        results[peers.PeerRun("public", "B", method)] = outcome(count)
    for k, sets in enumerate(peers.PARTS.values()):
        for sequence in "AB":
            results[peers.PeerRun("public", sequence, "pmb", 1, sets)] = outcome(8 - 2 * (k == 1))
    return peers.ComparedRuns(results, PEERS, {"public": ("A", "B")}, ("pmb", "none"), 1)


def test_best_peer_is_chosen_per_score_without_the_oracle(found: peers.ComparedRuns):
    assert found.best("public", "ALL", "MOTA") == (50.0, "sort")
    assert found.best("public", "ALL", "IDF1") == (60.0, "norfair")
    assert np.isnan(found.best("public", "B", "HOTA")[0])


def test_the_page_has_scores_distances_and_what_a_change_makes(found: peers.ComparedRuns):
    assert "| public | pmb |" in peers._pooled_table(found, ["public"])
    assert found.mean("public", "pmb", "offline", "MOTA") == pytest.approx(80)
    assert found.mean("public", "pmb", "online", "MOTA") == pytest.approx(40)
    assert "80.0 (+20.0)" in peers._sequence_table(found, ["public"])
    changed = next(
        line
        for line in peers._parts_table(found, peers.PARTS).splitlines()
        if "not smoothed" in line
    )
    assert changed.count("-20.0 ± 0.0") == 2, (
        "both sequences lose as much: the jackknife says that it is sure"
    )


def test_rows_that_do_not_count_are_left_out():
    rows = truth(4)
    marked = Truth(rows.frame, rows.identity, rows.xyxy, np.array([False, True, False, True]))
    assert peers.counted(marked).frame.tolist() == [1, 3]


@pytest.mark.data
@pytest.mark.slow
def test_the_short_form_runs(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """On one sequence, the clutter made by the harness's own script."""
    monkeypatch.setenv("PHDTRACK_DATA", str(data))
    if not (data.parent / "bench" / "peers.csv").is_file():
        pytest.skip("the scores of the other trackers are not next to the real sequences")
    text = peers.main(Options(quick=True, out=tmp_path)).read_text(encoding="utf-8")
    assert "| u0 | pmb |" in text
    assert "TUD-Campus" in text
    assert "| as shipped |" in (tmp_path / "defaults.md").read_text(encoding="utf-8")
    made = Path(peers.simulated_detections().name) / "u0-s1" / "TUD-Campus" / "det" / "det.txt"
    assert len(read_detections(made)) > 100


def test_a_missing_harness_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "data" / "mot15").mkdir(parents=True)
    monkeypatch.setenv("PHDTRACK_DATA", str(tmp_path / "data"))
    with pytest.raises(InputError, match=r"peers' scores are missing"):
        peers.bench()
