"""What a user loads: little at import, and only the parts that are used."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import pytest

import phdtrack

COUNT = """
import json, pathlib, sys
import phdtrack
before = [name for name in sys.modules if name.startswith("phdtrack.")]
phdtrack.Tracker((640, 480)).update([[10, 10, 40, 80, 0.9]])
loaded = [m for name, m in sys.modules.items() if name.split(".")[0] == "phdtrack"]
lines = sum(len(pathlib.Path(m.__file__).read_text(encoding="utf-8").splitlines()) for m in loaded)
print(json.dumps({"before": before, "modules": len(loaded), "lines": lines}))
"""


@pytest.fixture(scope="module")
def loaded() -> dict:
    done = subprocess.run([sys.executable, "-c", COUNT], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_importing_the_package_loads_next_to_nothing(loaded):
    assert loaded["before"] == ["phdtrack.errors", "phdtrack.files"]


def test_one_update_loads_what_the_defaults_use(loaded):
    assert loaded["modules"] <= 90
    assert loaded["lines"] <= 11_550


def test_public_names_are_there_and_told():
    assert {"Tracker", "Detections", "Tracks", "InputError", "CameraMotion", "evaluate"} <= set(
        dir(phdtrack)
    )
    with pytest.raises(AttributeError, match="no attribute 'Tracer'"):
        phdtrack.Tracer  # noqa: B018


@pytest.mark.parametrize(
    "package", ["phdtrack", "phdtrack.filters", "phdtrack.models", "phdtrack.detect"]
)
def test_every_public_name_can_be_loaded(package: str):
    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is not None
