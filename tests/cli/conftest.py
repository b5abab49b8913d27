"""Runs of commands leave out the drawings of their reports."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def reports_without_drawings(undrawn: None) -> None:
    """Most tests of commands do not look at charts; modules that do use ``drawn``."""
