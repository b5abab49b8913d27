"""Reports in a real browser: light and dark, on a desktop and on a phone, with many tracks and long
tables.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from report_runs import BACK, run_record, worth

from browsers import faults, needs_browser
from phdtrack.report import report_html
from phdtrack.report.pages import environment, render

pytestmark = needs_browser


def opened(browser, source: str, width: int, scheme: str):
    page = browser.new_context(
        viewport={"width": width, "height": 844}, color_scheme=scheme
    ).new_page()
    page.set_content(source)
    # Only what has a scroll bar of its own is wider than the window.
    assert page.evaluate("document.documentElement.scrollWidth") == width
    return page


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_charts_follow_light_and_dark_mode(browser, width: int, scheme: str) -> None:
    page = opened(browser, report_html(run_record(20, 3), {}), width, scheme)
    page.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
    for chart in page.locator(".chart").all():
        seen = cv2.imdecode(np.frombuffer(chart.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
        ground = int(seen[3, 3])
        assert (ground > 250) if scheme == "light" else (ground < 50)
        # Axes and text.
        assert np.abs(seen.astype(int) - ground).max() > 150
    assert faults(page) == []
    page.close()


@pytest.mark.parametrize("width", [1280, 360])
def test_charts_fit_the_window_with_text_that_can_be_read(browser, width: int) -> None:
    """Nothing scrolls sideways, and what is drawn has nearly its own size."""
    page = opened(browser, report_html(run_record(20, 3), {}), width, "light")
    charts = page.locator(".chart:visible")
    assert charts.count() >= 2
    for chart in charts.all():
        drawing = chart.locator("svg:visible")
        assert drawing.count() == 1
        shown, inside = drawing.evaluate(
            "e => [e.getBoundingClientRect().width, e.parentElement.parentElement.clientWidth]"
        )
        assert shown < inside + 1 <= width
        # Points of the figure, of which 72 are an inch.
        own = drawing.evaluate("e => e.viewBox.baseVal.width") * 96 / 72
        assert shown / own > 0.9
    page.close()


@pytest.mark.parametrize("width", [1280, 390])
def test_many_lifetimes_are_folded(browser, width: int) -> None:
    heights = []
    for objects, folded in ((5, False), (200, True)):
        page = opened(browser, report_html(run_record(20, objects), {}), width, "light")
        bars = page.locator('[aria-label^="Bar chart of the lifetime"]')
        assert bars.is_visible() != folded
        heights.append(page.evaluate("document.documentElement.scrollHeight"))
        if folded:
            page.get_by_text("200 tracks").click()
            assert bars.is_visible()
        page.close()
    # Forty times as many objects make it no more than a screen longer.
    assert heights[1] < heights[0] + 1000


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_appearance_is_folded_for_researchers(browser, width: int, scheme: str) -> None:
    """Who came back is in sight; the chart on a click."""
    one = worth(returns=(BACK,) * 12)
    source = report_html(replace(run_record(20, 3), appearance=one), {})
    page = opened(browser, source, width, scheme)
    assert page.get_by_text("1 object came back, 12 times in all, after the").is_visible()
    chart = page.locator('[aria-label^="Two histograms"]')
    assert not chart.is_visible()
    page.get_by_text("How alike objects look, for researchers").click()
    assert chart.is_visible()
    assert faults(page) == []
    page.close()


def test_long_table_unfolds_on_a_click(browser) -> None:
    rows = [(f"row {k}", "word " * 40) for k in range(40)]
    table = (
        "{% import 'macros.html' as m %}{% call m.section('Long') %}{{ m.table(('a', 'b'), rows)"
        " }}{% endcall %}"
    )
    base = str(render("base.html", title="t", source="", lead=""))
    source = base.replace("</main>", environment().from_string(table).render(rows=rows) + "</main>")
    page = opened(browser, source, 390, "dark")
    shown = page.locator("tbody tr:visible")
    assert shown.count() == 10
    page.get_by_text("30 more rows").click()
    assert shown.count() == 40
    page.get_by_text("30 more rows").click()
    page.emulate_media(media="print")
    assert shown.count() == 40
    page.close()
