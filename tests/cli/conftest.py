"""Runs of commands leave the pages of their reports blank."""

from __future__ import annotations

import pytest

from phdtrack.parallel import outcomes


@pytest.fixture(scope="module", autouse=True)
def reports_without_pages(blank: None) -> None:
    """Most tests of commands do not look at pages; modules that do use ``paged`` or ``drawn``."""


@pytest.fixture
def batch_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ``batch`` work in this process: each of its own loads everything anew, for seconds."""

    def here(work, jobs: int, apart: bool):
        assert apart
        return outcomes(work, 1)

    monkeypatch.setattr("phdtrack.cli.batch.outcomes", here)
