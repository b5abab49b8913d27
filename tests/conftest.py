"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings
from markupsafe import Markup

from browsers import CHROMIUM, FLAGS

if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from playwright.sync_api import Browser

ROOT = Path(__file__).resolve().parent.parent
# What fills the pages of runs.
PAGES = (
    "phdtrack.run.run_report.report_html",
    "phdtrack.run.grouping.render",
    "phdtrack.live.counting.render",
    "phdtrack.cli.count.render",
)

# On a busy machine a call may take long: no test fails because of the time it takes.
settings.register_profile("phdtrack", deadline=None)
settings.load_profile("phdtrack")

# A shell starts background jobs with Ctrl-C ignored, and the processes that tests interrupt would
# inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# The same holds for SIGHUP under nohup.
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


# Thousands of tests and their modules stay: the search for garbage looks through them less often,
# and not at all once they are collected. It took a third of the time of tests that parse the code.
gc.set_threshold(20_000)


def pytest_collection_finish() -> None:
    """Take what was imported and collected from what is searched for garbage."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests of the real sequences ``data``, and those that start a browser ``slow``."""
    for item in items:
        fixtures = getattr(item, "fixturenames", ())
        if "data" in fixtures:
            item.add_marker("data")
        if "browser" in fixtures:
            item.add_marker("slow")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real sequences: ../shared/data beside the project, or $PHDTRACK_DATA."""
    folder = Path(os.environ.get("PHDTRACK_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "mot15").is_dir():
        pytest.skip(
            f"the real sequences are not at {folder}; set PHDTRACK_DATA to the folder that holds"
            " mot15/"
        )
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium, for tests of pages."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        started = play.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield started
        started.close()


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.default_rng(20090706)


@pytest.fixture(scope="module")
def drawn() -> None:
    """Reports with their drawings, for a module in a folder of which ``undrawn`` holds."""


@pytest.fixture(scope="module")
def paged() -> None:
    """Complete pages of reports, for a module in a folder of which ``blank`` holds."""


@pytest.fixture(scope="module")
def undrawn() -> Iterator[None]:
    """Reports without what matplotlib draws, which takes two thirds of the time of a short run.

    Figures are made, filled and laid into the page as ever; `tests/report` has them drawn.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save_empty)
        patch.setattr(FigureCanvasAgg, "draw", draw_nothing)
        yield


@pytest.fixture(scope="module")
def blank(request: pytest.FixtureRequest) -> Iterator[None]:
    """Reports whose pages are blank, which would take a third of the time of a short run.

    Everything that they rest on is computed. Modules that look at pages have them ``paged``,
    without drawings, or ``drawn``.
    """
    names = [name for mark in request.node.iter_markers("usefixtures") for name in mark.args]
    if "drawn" in names:
        yield
        return
    if "paged" in names:
        request.getfixturevalue("undrawn")
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        for function in PAGES:
            patch.setattr(function, blank_page)
        yield


def blank_page(*_: object, **context: object) -> Markup:
    """A page without content."""
    return Markup("<html></html>")


def save_empty(figure: Figure, file: IO[bytes], **_: object) -> None:
    """Write an SVG without content."""
    assert figure.axes
    file.write(b'<svg xmlns="http://www.w3.org/2000/svg"/>')


def draw_nothing(canvas: FigureCanvasAgg) -> None:
    """Leave the pixels transparent."""
    canvas.renderer = canvas.get_renderer()
