"""The regimes drawn at random, the counts of the page for made-up scores, and missing files."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import pytest

from experiments import regimes
from experiments.common import Options
from experiments.regimes_scenes import CSV, PEERS, REGIMES, SEED, described, random_regimes
from phdtrack.errors import InputError


def scores(mota: float, idf1: float, name: str = "a") -> regimes.RegimeScores:
    """Online rows with these scores, corrected tracks without error, a peer with 0.8 in both."""
    return regimes.RegimeScores(name, (mota, idf1), (1.0, 1.0), (0.8, 0.8))


def test_a_seed_gives_the_same_regimes_for_every_number():
    assert random_regimes(7, 30)[:10] == random_regimes(7, 10)
    assert random_regimes(7, 10) != random_regimes(8, 10)


def test_random_regimes_are_within_their_ranges():
    for regime in random_regimes(3, 500):
        changed = set(regime) - {"score", "frames", "width", "height"}
        assert len(changed) in (2, 3)
        assert 1 <= regime.get("fps", 1) <= 60
        assert 2 <= regime.get("every", 2) <= 30
        assert 10 <= regime.get("speed", 10) <= 2500
        assert ("width" in regime) == (regime.get("speed", 0) > 250)
        assert 0 <= regime.get("parked", 0) <= regime.get("n", 6) <= 100
        assert 2 <= min(regime.get("size", (4, 4))) <= max(regime.get("size", (4, 4))) <= 600
        assert 60 <= regime["frames"] <= 400


def test_stored_scores_of_peers_are_for_the_usual_seed():
    stored = regimes.best_peers(CSV)
    assert [name for name, _ in stored] == [described(x) for x in random_regimes(SEED, REGIMES)]
    assert all(idf1 <= 1 and mota <= 1 for _, (mota, idf1) in stored)


def test_description_has_the_drawn_quantities_only():
    regime = {"score": "low", "fps": 5, "size": (10, 20), "frames": 100}
    assert described(regime) == "scores low; 5 fps; boxes 10x20"


def test_regime_is_behind_by_the_worse_of_two_scores():
    one = scores(0.83, 0.75)
    assert math.isclose(one.gap, 0.05)
    assert math.isclose(one.lead, 0.03)
    assert math.isclose(one.corrected_gap, -0.2)
    assert one.verdict(0.02) == "behind"
    assert one.verdict(0.06) == ""
    assert scores(0.83, 0.8).verdict(0.02) == "ahead"


def test_tables_count_and_list_the_worst_first():
    found = [scores(0.9, 0.9, "a"), scores(0.5, 0.9, "b"), scores(0.7, 0.7, "c")]
    assert regimes.behind(found, 0.02) == 2
    assert regimes.ahead(found, 0.02) == 1
    assert [one.name for one in regimes.worst(found, 2)] == ["b", "c"]
    assert "| b | 0.500 / 0.900 | 1.000 / 1.000 |" in regimes.scores_table(found, 0.02)
    assert "| none | 2 | b (0.50 / 0.90, best peer 0.80 / 0.80); c" in regimes.others_table(
        {"none": found}
    )
    assert "behind in 2 and as far ahead in 1." in " ".join(regimes.summary(found, found).split())


def test_quantities_are_counted_where_they_were_drawn():
    cases = [
        regimes.Regime("a", {"score": "low", "fps": 5, "n": 3}, (0.8, 0.8)),
        regimes.Regime("b", {"score": "none", "n": 3, "turn": 1.0}, (0.8, 0.8)),
    ]
    text = regimes.quantities_table([scores(0.5, 0.5), scores(0.9, 0.9)], cases)
    for line in ("| scores low | 1 | 1 | 0 |", "| n | 2 | 1 | 1 |", "| turn | 1 | 0 | 1 |"):
        assert line in text
    assert "clutter" not in text


def test_frames_without_detector_do_not_count(monkeypatch: pytest.MonkeyPatch):
    """The harness's functions get the truth and the rows of the other frames."""
    seen = []

    def scored(truth: list[str], rows: list[list[str]]) -> tuple[float, float]:
        seen.append((truth, rows))
        return 0.5, 0.6

    fake = SimpleNamespace(
        scene=lambda seed, **_: (["boxes", None, "boxes"], ["t0", "t1", "t2"]),
        phdtrack=lambda found, parameters, kind: ({0: ["r0"], 1: ["r1"]}, {2: ["r2"]}),
        scores=scored,
    )
    monkeypatch.setattr(regimes, "harness", lambda: fake)
    assert regimes.scored(regimes.SceneRun({"score": "none"}, 0)) == (0.5, 0.6, 0.5, 0.6)
    assert seen == [(["t0", "t2"], [["r0"], []]), (["t0", "t2"], [[], ["r2"]])]


def test_another_seed_needs_the_environment_of_the_peers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("experiments.common.PEERS_PYTHON", tmp_path / "python")
    monkeypatch.setattr(regimes, "bench", lambda: tmp_path)
    with pytest.raises(InputError, match=r"environment is missing.*make peers"):
        regimes.regimes_at_random(SEED + 1, 2, 1)


def test_stored_scores_of_other_regimes_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    columns = ",".join(f"{name}_{score}" for name in PEERS for score in ("mota", "idf1"))
    stored = tmp_path / "peers.csv"
    stored.write_text(f"regime,{columns}\nscores none,1,1,1,1,1,1\n", encoding="utf-8")
    monkeypatch.setattr(regimes, "CSV", stored)
    monkeypatch.setattr(regimes, "bench", lambda: tmp_path)
    with pytest.raises(InputError, match="other regimes than are drawn now"):
        regimes.regimes_at_random(SEED, 1, 1)


def test_a_missing_harness_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "data" / "mot15").mkdir(parents=True)
    monkeypatch.setenv("PHDTRACK_DATA", str(tmp_path / "data"))
    with pytest.raises(InputError, match=r"scenes of the regimes .* are missing"):
        regimes.bench()


@pytest.mark.data
@pytest.mark.slow
def test_the_short_form_runs(
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setenv("PHDTRACK_DATA", str(data))
    if not (data.parent / "bench" / "regimes.py").is_file():
        pytest.skip("the scenes of the regimes are not next to the real sequences")
    text = regimes.main(Options(quick=True, out=tmp_path)).read_text(encoding="utf-8")
    assert "| 1 fps, no scores |" in text
    assert "| mcmc |" in text
    assert "drawn at random" in " ".join(capsys.readouterr().out.split())
