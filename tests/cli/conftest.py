"""Runs of commands leave out the drawings of their reports."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def reports_without_drawings(undrawn: None) -> None:
    """Most tests of commands do not look at charts; those that do ask for ``drawn``."""
