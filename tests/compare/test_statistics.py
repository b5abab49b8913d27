"""Intervals over seeds against numbers from a printed table of Student's t."""

from __future__ import annotations

import math

import pytest

from phdtrack.compare.statistics import interval


def test_two_values_have_the_widest_interval() -> None:
    found = interval([1.0, 3.0])
    # s = √2, s / √2 = 1, t(1 degree of freedom, 97.5 %) = 12.706.
    assert found.mean == 2
    assert found.half == pytest.approx(12.706, abs=1e-3)
    assert (found.low, found.high) == (pytest.approx(-10.706, abs=1e-3), pytest.approx(14.706, abs=1e-3))
    assert not found.clear


def test_one_value_has_no_interval_and_none_no_mean() -> None:
    assert (interval([0.7]).mean, interval([0.7]).low, interval([0.7]).high) == (0.7, 0.7, 0.7)
    assert math.isnan(interval([0.7]).half)
    assert not interval([0.7]).clear
    assert math.isnan(interval([]).mean)
