"""`phdtrack doctor`: what it says where all is well, and where something is missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runner import phdtrack

from phdtrack import kernels
from phdtrack.cli import doctor


def test_all_is_well_here() -> None:
    said = phdtrack("doctor", "--json")
    assert said.status == 0
    found = said.object
    assert found["ok"] is True
    assert {"phdtrack", "python", "numpy", "av", "opencv-python-headless"} <= set(found["versions"])
    names = {check["name"] for check in found["checks"]}
    assert {"OpenCV", "detector face (cascades)", "detector person (HOG)", "video in", "video out (H.264)"} <= names
    assert all(check["cure"] for check in found["checks"] if not check["ok"])
    assert "Everything essential works here." in said.err
    assert "video out (H.264)" in said.err


def test_a_missing_cascade_is_told_with_its_cure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import cv2

    monkeypatch.setattr(cv2.data, "haarcascades", str(tmp_path))
    monkeypatch.delattr(cv2, "HOGDescriptor_getDefaultPeopleDetector")
    said = phdtrack("doctor", "--json")
    checks = {check["name"]: check for check in said.object["checks"]}
    for name in ("detector face (cascades)", "detector person (HOG)"):
        assert checks[name]["ok"] is False
        assert "opencv-python-headless" in checks[name]["cure"]
    # Two detectors less do not stop the main job.
    assert said.status == 0


def test_something_essential_missing_is_status_1(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> str:
        raise ImportError("libGL: cannot open shared object file")

    checks = [(name, broken if name == "OpenCV" else trial, *rest) for name, trial, *rest in doctor.CHECKS]
    monkeypatch.setattr(doctor, "CHECKS", checks)
    said = phdtrack("doctor")
    assert said.status == 1
    assert "MISSING  OpenCV: ImportError: libGL: cannot open shared object file" in said.out
    assert phdtrack("doctor", "--json").object["ok"] is False


def test_it_says_where_kernels_are_kept_and_whether_any_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def said(lasting: bool = True) -> doctor.Check:
        monkeypatch.setattr(kernels, "CACHE", kernels.Cache(tmp_path, lasting))
        return {check.name: check for check in doctor.examine()}["cache of compiled kernels"]

    assert said().ok
    assert f"{tmp_path} (cold" in said().detail
    (tmp_path / "gated-17.py311.nbi").touch()
    assert f"{tmp_path} (warm, 1 kernel" in said().detail
    nowhere = said(lasting=False)
    assert not nowhere.ok
    assert not nowhere.essential
    assert "NUMBA_CACHE_DIR" in nowhere.cure
