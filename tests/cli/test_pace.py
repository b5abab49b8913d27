"""Frames in which a kernel is compiled or loaded are counted apart from the others."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from phdtrack.cli.job import paced


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_frame_that_compiles_is_left_out() -> None:
    double = numba.njit(lambda x: 2 * x)
    with paced() as pace:
        pace.frame()
        assert (pace.left_out, pace.seconds > 0) == (0, True)
        measured = pace.seconds
        double(1.0)
        pace.frame()
        assert (pace.left_out, pace.seconds) == (1, measured)
        # The same types again, then others.
        double(2.0)
        pace.frame()
        assert pace.left_out == 1
        double(np.ones(2))
        pace.frame()
        assert pace.left_out == 2
    assert pace.seconds > measured
