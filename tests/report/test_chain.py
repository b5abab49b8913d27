"""What is told of an MCMC filter's chain, against the numbers of its frames."""

from __future__ import annotations

import math

import numpy as np
import pytest

from phdtrack.report.record import LOW_EFFECTIVE, chain_summary
from phdtrack.types import ChainInfo


def frame(proposed: list[int], accepted: list[int], effective: float) -> ChainInfo:
    return ChainInfo(("step", "switch"), np.array(proposed), np.array(accepted), effective)


def test_means_over_the_frames_that_have_something_to_tell() -> None:
    frames = [frame([100, 50], [30, 5], 40.0), frame([200, 0], [20, 0], math.nan), frame([10, 10], [5, 3], 10.0)]
    found = chain_summary(frames)
    assert found is not None
    assert found.acceptance == pytest.approx({"step": (0.3 + 0.1 + 0.5) / 3, "switch": (0.1 + 0.3) / 2})
    assert found.effective == pytest.approx(25.0)
    assert found.low == pytest.approx(0.5)
    assert found.warning == ""
    assert "step 30 %, switch 20 %" in found.sentence
    assert "25 independent" in found.sentence


def test_a_chain_that_hardly_moves_is_a_warning() -> None:
    found = chain_summary([frame([9, 9], [1, 0], LOW_EFFECTIVE / 2)] * 2 + [frame([9, 9], [1, 0], 2 * LOW_EFFECTIVE)])
    assert found is not None
    assert "in 67 % of the frames" in found.warning
    assert "fewer than 20 " in found.warning


def test_where_nobody_was_and_where_no_chain_is() -> None:
    nobody = chain_summary([frame([0, 0], [0, 0], math.nan)])
    assert nobody is not None
    assert nobody.warning == ""
    assert "none" in nobody.sentence
    assert "independent" not in nobody.sentence
    assert chain_summary([]) is None
