"""The site: every page is in it, and its figures are those of the results."""

import re
import subprocess
from pathlib import Path

import pytest

from browsers import needs_browser

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def test_navigation_lists_every_page():
    listed = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    named = set(re.findall(r"^ *- (?:[^:\n]+: )?(\S+\.md)$", listed, re.MULTILINE))
    there = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    results = {name for name in there if name.startswith("results/")}
    assert named == there - results | {"index.md", "results/*.md"}


def test_methods_show_implemented_equations():
    """Tags are written as in docstrings; `docs/equations.md` lists those."""
    listed = {
        (paper, place.strip())
        for part in (DOCS / "equations.md").read_text(encoding="utf-8").split("\n## ")[1:]
        for paper, rows in [part.split("\n", 1)]
        for place in re.findall(r"^\|([^|]+)\|", rows, re.MULTILINE)
    }
    shown = re.findall(
        r"\[([A-Z]\d\d|PMB|APP)(?: ([^\]]+))?\]", (DOCS / "methods.md").read_text(encoding="utf-8")
    )
    assert len(shown) > 30
    assert [tag for tag in shown if (tag[0], " ".join(tag[1].split()) or "–") not in listed] == []


def test_table_of_filters_has_the_figures_of_the_results():
    found = re.findall(
        r"\| (frcnn|public) \| ([a-z-]+) \|([^\n]*)\|\n",
        (DOCS / "results" / "peers.md").read_text(),
    )
    scores = {(case, name): re.findall(r"\d+\.\d", row) for case, name, row in found}
    table = re.findall(
        r"^\| `([a-z-]+)` \|([ \d.|]*/[ \d./|]+)\|$",
        (DOCS / "filters.md").read_text(),
        re.MULTILINE,
    )
    assert len(table) == 5
    for name, row in table:
        assert (
            re.findall(r"\d+\.\d", row)[:12]
            == scores["frcnn", name][:6] + scores["public", name][:6]
        ), name


def test_readme_has_the_figures_of_the_regimes():
    page = " ".join((DOCS / "results" / "regimes.md").read_text().split())
    readme = " ".join((DOCS.parent / "README.md").read_text().split())
    grid = re.search(r"in (\d+) of them, and \*ahead\* by 0.02 or more in MOTA in (\d+)", page)
    drawn = re.search(r"behind by more than 0.03 in (\d+) of them and ahead .*? in (\d+);", page)
    assert grid
    assert drawn
    for behind, ahead in (
        (f"OC-SORT in {grid[1]},", f"0.02 or more ahead in {grid[2]}."),
        (f"0.03 behind in {drawn[1]}", f"as far ahead in {drawn[2]}:"),
    ):
        assert behind in readme
        assert ahead in readme


def test_means_on_worse_detections_are_above_the_best_peer():
    """As README says: in every score, after every change, online and corrected."""
    page = (DOCS / "results" / "degraded.md").read_text()
    rows = re.findall(r"^\| mean \| (.*?) \| (.*?) \| (.*?) \|$", page, re.MULTILINE)
    assert len(rows) == 4
    for row in rows:
        peer, *own = ([float(value) for value in cell.split("/")] for cell in row)
        assert all(a > b for one in own for a, b in zip(one, peer, strict=True))


def test_filters_are_behind_where_the_results_say():
    """In as many scenes as on the page of regimes, the default in those of its first table."""
    page = (DOCS / "results" / "regimes.md").read_text()
    found = dict(re.findall(r"^\| ([a-z-]+) \| (\d+) \|", page, re.MULTILINE))
    (found["pmb"],) = re.findall(r"behind\* the best peer .*? in\s(\d+) of them", page, re.DOTALL)
    text = (DOCS / "filters.md").read_text().split("and why.")[1]
    table = re.findall(r"^\| (`[a-z`, -]+`) \| (\d+) \|", text, re.MULTILINE)
    named = {name: count for cell, count in table for name in re.findall(r"`([a-z-]+)`", cell)}
    assert len(named) == 8
    assert named == {name: found[name] for name in named}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site; a link that leads nowhere ends the build."""
    out = tmp_path_factory.mktemp("built") / "site"
    done = subprocess.run(
        ["make", "site", f"SITE={out}"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.mark.slow
def test_site_builds_without_a_network(site: Path):
    for page in ("index.html", "filters.html", "how-to/index.html", "results/videos.html"):
        assert (site / page).exists(), page
    text = (site / "api" / "tracker.html").read_text(encoding="utf-8")
    assert "frame_size" in text
    methods = (site / "methods.html").read_text(encoding="utf-8")
    assert (
        methods.count("<math ")
        == (DOCS / "methods.md").read_text(encoding="utf-8").count("```math")
        > 10
    )
    assert not re.findall(r'<(?:script|link)[^>]*(?:src|href)="(?:https?:)?//', text)


@pytest.mark.slow
@needs_browser
def test_search_works_in_files(browser, site: Path):
    page = browser.new_page()
    page.goto((site / "how-to" / "live.html").as_uri())
    page.locator(".md-search__input").click()
    page.get_by_text("Type to start searching").wait_for()
    page.locator(".md-search__input").press_sequentially("homography")
    page.locator(".md-search-result__item").first.wait_for()
    assert "cameras" in page.locator(".md-search-result__item").first.inner_text()
    page.close()
