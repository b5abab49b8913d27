"""The benchmark of the extraction: what it times on two threads gives the states of one."""

from __future__ import annotations

import pytest

from benchmarks.extraction import on_threads


def test_filter_and_extraction_on_threads() -> None:
    found = on_threads(3, frames=2, repeats=2)
    assert found["identical"]
    assert min(found["one_ms"], found["two_ms"]) > 0.0
    assert found["ratio"] == pytest.approx(found["one_ms"] / found["two_ms"])
