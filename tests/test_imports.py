"""Importing the package loads little, and every public name can be loaded."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import phdtrack

LOADED = """
import sys
import phdtrack
print(*(name for name in sys.modules if name.startswith("phdtrack.")))
"""


def test_importing_the_package_loads_next_to_nothing():
    command = [sys.executable, "-c", LOADED]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["phdtrack.addresses", "phdtrack.errors", "phdtrack.files"]


def test_public_names_are_listed():
    names = {"Tracker", "Detections", "Tracks", "InputError", "CameraMotion", "evaluate"}
    assert names | {"export_tracks", "read_tracks"} <= set(dir(phdtrack))
    with pytest.raises(AttributeError, match="no attribute 'Tracer'"):
        phdtrack.Tracer  # noqa: B018


@pytest.mark.parametrize(
    "package", ["phdtrack", "phdtrack.filters", "phdtrack.models", "phdtrack.detect"]
)
def test_every_public_name_can_be_loaded(package: str):
    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is not None
