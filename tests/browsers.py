"""The system's Chromium for tests of pages, and what axe-core finds wrong on a page."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Page

# Debian's and others' names of the same browser.
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
needs_browser = pytest.mark.skipif(
    not CHROMIUM, reason="needs Chromium (Debian: apt-get install chromium)"
)
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def faults(page: Page, impacts: tuple[str, ...] = ("serious", "critical")) -> list[str]:
    """What axe-core finds wrong on a page as it is now, of these impacts: a rule, what it says, and
    where, in each line.

    Neither the page's policy nor a page that was opened as a file hinders it: the script comes by
    the browser's debugger.
    """
    import axe_playwright_python

    page.evaluate(
        (Path(axe_playwright_python.__file__).parent / "axe.min.js").read_text(encoding="utf-8")
    )
    found = page.evaluate("axe.run()")
    assert found["passes"], "axe-core found nothing to look at"
    return [
        f"{one['id']} ({one['impact']}): {one['help']}: {node['html'][:120]}"
        f" {node['failureSummary']}"
        for one in found["violations"]
        if one["impact"] in impacts
        for node in one["nodes"]
    ]
