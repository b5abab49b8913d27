"""`phdtrack compare` as a stranger uses it: files, JSON, what is taken up again, and what is
refused.
"""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused, walkers

from experiments.common import uniform_density
from phdtrack.compare import runs
from phdtrack.metrics.causes import SUMS
from phdtrack.scene import LearnedDensity, Scene, write_scene

FILES = {"report.html", "compare.csv", "runs.csv", "compare.json"}
QUICK = ("--filters", "gm-phd,none", "--seeds", 2, "--jobs", 1)


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as text:
        return list(csv.DictReader(text))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return walkers(tmp_path / "yard", clutter=1)


def test_a_comparison_leaves_tables_report_and_every_run(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    said = phdtrack("compare", folder, *QUICK, "--clutter", "0,4", "--out", out)
    assert said.status == 0
    assert {path.name for path in out.iterdir() if path.is_file()} == FILES
    assert said.out.splitlines()[0].split()[:6] == [
        "sequence",
        "detections",
        "clutter",
        "filter",
        "MODA",
        "MOTA",
    ]
    assert "6 runs" in said.out
    assert "* The best on the same input" in said.out
    assert "one run represents all seeds" in said.out
    cells = rows(out / "compare.csv")
    runs = rows(out / "runs.csv")
    assert [(row["clutter"], row["filter"], row["seeds"]) for row in cells] == [
        ("0", "gm-phd", "1"),
        ("0", "none", "1"),
        ("4", "gm-phd", "2"),
        ("4", "none", "2"),
    ]
    assert len(runs) == 6
    for row in runs:
        kept = json.loads((out / row["folder"] / "run.json").read_text())
        assert float(row["MOTA"]) == pytest.approx(kept["scores"]["MOTA"], rel=1e-6)
        assert (out / row["folder"] / "tracks.csv").is_file()
    for row in runs:
        causes = [
            sum(float(row[name]) for name in SUMS if name.startswith(start))
            for start in ("miss_", "false_")
        ]
        # Once by cause, once by place.
        assert causes == [2 * float(row["misses"]), float(row["false_positives"])]
        assert (row["log_evidence"] != "") == (row["filter"] == "gm-phd")
    assert "Errors by cause:" in said.out
    pair = [float(row["MOTA"]) for row in runs if row["clutter"] == "4" and row["filter"] == "none"]
    assert float(cells[3]["MOTA"]) == pytest.approx(sum(pair) / 2, rel=1e-6)
    assert cells[0]["MOTA_half"] == cells[0]["MOTA_ahead"] == ""
    assert float(cells[3]["MOTA_ahead"]) == pytest.approx(
        float(cells[3]["MOTA"]) - float(cells[2]["MOTA"]), rel=1e-6
    )
    page = (out / "report.html").read_text()
    assert "<td><b>" in page
    assert "Errors by cause" in page
    assert "No interval over sequences: each set of detections has one sequence." in said.out
    assert "No interval over sequences" in page
    assert "http" not in page.split("</head>")[1]


def test_again_and_with_another_setting(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = phdtrack("compare", folder, *QUICK, "--out", out, "--json")
    assert (first.status, first.object["runs"], first.object["reused"]) == (0, 2, 0)
    again = phdtrack("compare", folder, *QUICK, "--out", out, "--json")
    assert again.object["reused"] == 2
    assert again.object["rows"] == first.object["rows"]
    other = phdtrack(
        "compare", folder, *QUICK, "--out", out, "--json", "--set", "filter.max_components=9"
    )
    assert (other.object["runs"], other.object["reused"], other.object["outdated"]) == (
        2,
        1,
        ["settings"],
    )
    assert "1 of them reused, others repeated because of changed settings" in other.err
    anew = phdtrack("compare", folder, *QUICK, "--out", out, "--json", "--overwrite")
    assert anew.object["reused"] == 0


def test_a_detector_looks_once_and_its_runs_are_what_track_does(tmp_path: Path) -> None:
    scene = tmp_path / "street"
    assert (
        phdtrack(
            "simulate", "street", "--seed", 1, "--frames", 25, "--set", "lead_in=-6", "--out", scene
        ).status
        == 0
    )
    out = tmp_path / "out"
    said = phdtrack(
        "compare",
        scene,
        "--detectors",
        "change",
        *QUICK,
        "--max-width",
        320,
        "--out",
        out,
        "--json",
    )
    assert said.status == 0
    (looked,) = (out / "detections").rglob("detections.csv")
    before = looked.stat().st_mtime_ns
    video = ("track", scene / "scene.mp4", "--max-width", 320, "--filter", "gm-phd", "--no-video")
    assert phdtrack(*video, "--out", tmp_path / "track").status == 0
    kept = out / "runs" / "street" / "change" / "clutter-0" / "gm-phd" / "seed-1" / "tracks.csv"
    assert kept.read_text() == (tmp_path / "track" / "tracks.csv").read_text()
    again = ("compare", scene, "--detectors", "change", *QUICK, "--out", out, "--max-width")
    phdtrack(*again, 320, "--set", "sensor.detection_probability=0.8")
    assert looked.stat().st_mtime_ns == before
    phdtrack(*again, 160)
    assert looked.stat().st_mtime_ns != before


def test_a_run_that_fails_is_told_and_the_others_go_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracked = runs.tracked

    def broken(run: object, given: runs.RunInput) -> object:
        if "none" in str(run):
            raise RuntimeError("out of luck")
        return tracked(run, given)  # type: ignore[arg-type]

    monkeypatch.setattr(runs, "tracked", broken)
    said = phdtrack("compare", folder, *QUICK, "--out", tmp_path / "out")
    assert said.status == 1
    assert "none on yard det, seed 1 failed: RuntimeError: out of luck" in said.err
    assert "failed" in next(line for line in said.out.splitlines() if "none" in line)
    failed = [row["failed"] for row in rows(tmp_path / "out" / "runs.csv")]
    assert failed == ["", "RuntimeError: out of luck", "RuntimeError: out of luck"]
    assert "out of luck" in (tmp_path / "out" / "report.html").read_text()


def stopped(out: Path, runs: int, *words: object) -> tuple[int, str, str]:
    """Ctrl-C when so many runs are kept in ``out``; the comparison's status and what it said and
    printed.
    """
    command = [sys.executable, "-m", "phdtrack", "compare", *map(str, words), "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 240
    while (
        len(list(out.rglob("seed-*/run.json"))) < runs
        and process.poll() is None
        and time.monotonic() < end
    ):
        time.sleep(0.1)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    printed, said = process.communicate(timeout=120)
    return process.returncode, said, printed


@pytest.mark.slow
def test_ctrl_c_keeps_what_is_done(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = (folder, "--filters", "gm-phd,none", "--clutter", 2)
    assert stopped(out, 3, *words, "--seeds", 500, "--jobs", 2) == (130, "phdtrack: stopped\n", "")
    kept = len(list(out.rglob("tracks.csv")))
    assert kept >= 3
    assert list(out.rglob(".*")) == []
    again = phdtrack("compare", *words, "--seeds", 1, "--jobs", 1, "--out", out, "--json")
    assert again.object["reused"] >= 1


def test_mistakes_are_one_sentence_and_leave_nothing(folder: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    assert "nowhere" in refused("compare", tmp_path / "nowhere", *out)
    assert "--clutter" in refused("compare", folder, "--clutter", "a", *out)
    assert "Did you mean MOTA" in refused("compare", folder, "--scores", "MOTTA", *out)
    assert "iou" in refused("compare", folder, "--iou", 2, *out)
    assert "--filters" in refused("compare", folder, "--filters", "gm", *out)
    (folder / "det" / "det.txt").write_text("1,1,x\n")
    assert "det.txt, line 1" in refused("compare", folder, *out)
    assert not (tmp_path / "out").exists()


def test_a_learned_scene_is_every_methods(folder: Path, tmp_path: Path) -> None:
    scene = tmp_path / "my scene.json"
    low = np.zeros(4)
    high = np.array([320.0, 240, 320, 240])
    learned = LearnedDensity(3.0, uniform_density(low, high), 20)
    write_scene(scene, Scene(320, 240, 25.0, "yard", clutter=learned))
    out = tmp_path / "out"
    said = phdtrack("compare", folder, *QUICK, "--clutter", "4", "--scene", scene, "--out", out)
    assert said.status == 0, said.err
    for row in rows(out / "runs.csv"):
        configuration = json.loads((out / row["folder"] / "run.json").read_text())["configuration"]
        assert configuration["scene"]["file"] == str(scene)
    # What is learned anew makes runs anew.
    write_scene(scene, Scene(320, 240, 25.0, "yard", clutter=replace(learned, rate=4.0)))
    again = phdtrack("compare", folder, *QUICK, "--clutter", "4", "--scene", scene, "--out", out)
    assert "reused" not in again.out
