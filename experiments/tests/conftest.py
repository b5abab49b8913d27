"""The real sequences, for the tests of the experiments that need them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.common import need_data
from phdtrack.errors import InputError


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20090706)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real sequences."""
    try:
        return need_data()
    except InputError as error:
        pytest.skip(str(error))
