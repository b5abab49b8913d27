"""The changes of the detections, the peers' stored scores, and the page's means."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import degraded
from experiments.degraded_inputs import CHANGES, PEERS, CameraCase, changed, write_truth


@pytest.fixture
def case(tmp_path: Path) -> CameraCase:
    """30 frames with four detections each, and a truth with one ignored row."""
    folder = tmp_path / "scene"
    (folder / "det_a").mkdir(parents=True)
    (folder / "gt").mkdir()
    (folder / "seqinfo.ini").write_text(
        "[Sequence]\nname=scene\nseqLength=30\nimWidth=640\nimHeight=480\nframeRate=25\n",
        encoding="utf-8",
    )
    rows = [
        (k, -1, 100 * i, 50, 20, 40, 0.1 * i + 0.3, -1, -1, -1)
        for k in range(1, 31)
        for i in range(4)
    ]
    np.savetxt(folder / "det_a" / "det.txt", rows, delimiter=",", fmt="%g")
    truth = [(k, 1, 0, 50, 20, 40, 1) for k in range(1, 31)] + [(1, 2, 9, 9, 9, 9, 0)]
    np.savetxt(folder / "gt" / "gt.txt", truth, delimiter=",", fmt="%g")
    (folder / "gt" / "ignore.txt").write_text("", encoding="utf-8")
    return CameraCase("g", "scene", "a", folder)


def test_scores_that_are_taken_away_leave_the_boxes(case: CameraCase):
    given = changed(case, "no scores")
    assert len(given.frame) == 120
    assert set(given.score.tolist()) == {0.9}
    assert given.xyxy[1].tolist() == [100, 50, 120, 90]


def test_a_third_of_the_rate_renumbers_detections_and_truth(case: CameraCase):
    given = changed(case, "a third of the rate")
    assert given.frames == 10
    assert given.fps == pytest.approx(25 / 3)
    assert given.frame.tolist() == [k for k in range(1, 11) for _ in range(4)]
    assert given.truth[given.truth[:, 1] == 1, 0].tolist() == list(range(1, 11))


def test_half_of_the_detections_are_the_same_in_every_run(case: CameraCase):
    given = changed(case, "p_D halved")
    # Four standard errors of 120 fair coins.
    assert abs(len(given.frame) - 60) < 4 * np.sqrt(30)
    assert np.array_equal(given.xyxy, changed(case, "p_D halved").xyxy)


def test_rows_that_do_not_count_are_dropped_in_mot15_only(case: CameraCase):
    assert len(changed(case, "no scores").truth) == 31
    old = CameraCase("MOT15", "scene", "a", case.folder)
    assert len(changed(old, "no scores").truth) == 30


def test_truth_is_written_as_the_scorer_reads_it(case: CameraCase, tmp_path: Path):
    write_truth(case, changed(case, "a third of the rate"), tmp_path / "out")
    text = (tmp_path / "out" / "seqinfo.ini").read_text(encoding="utf-8")
    assert "seqLength = 10" in text
    assert not (tmp_path / "out" / "gt" / "ignore.txt").exists()


def test_stored_scores_have_every_peer_in_every_case():
    found = degraded.kept_peers()
    cases = {one.case for one in found}
    assert len(cases) == 46
    assert len(found) == len(cases) * len(CHANGES) * len(PEERS)


def test_best_peer_of_the_mean_is_best_by_its_own_mean():
    def one(tracker: str, group: str, case: str, value: float) -> degraded.DegradedScores:
        return degraded.DegradedScores("no scores", tracker, group, case, (value, value, value))

    found = [
        one("online", "g", "a", 50),
        one("online", "g", "b", 70),
        one("online", "h", "c", 80),
    ]
    for name in PEERS:
        found += [one(name, "g", "a", 40), one(name, "g", "b", 60), one(name, "h", "c", 10)]
    found += [one("sort", "h", "d", 30)]
    own = degraded.group_means(found, "no scores", "online")
    assert own == {"g": [60, 60, 60], "h": [80, 80, 80]}
    assert degraded.overall(own) == [70, 70, 70]
    best = degraded.best_peers(found, "no scores")
    assert best["h"] == [20, 20, 20]
    assert best["mean"] == [35, 35, 35]
    assert degraded.pairs_won(found, "no scores", "online") == (9, 9)
