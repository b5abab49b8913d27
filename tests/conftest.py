"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real sequences: ../shared/data beside the project, or $PHDTRACK_DATA."""
    folder = Path(os.environ.get("PHDTRACK_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "mot15").is_dir():
        pytest.skip(f"the real sequences are not at {folder}; set PHDTRACK_DATA to the folder that holds mot15/")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20090706)
