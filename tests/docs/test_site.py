"""The site: every page is in it, its figures are those of the results, and the API reference has
what the pages use.
"""

import inspect
import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType

import pytest

from browsers import needs_browser
from phdtrack.config.registry import SECTIONS, settable

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
DIRECTIVE = re.compile(r"^::: (\S+)$", re.MULTILINE)
PROGRAM = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
# A comment may show what a program would import.
IMPORT = re.compile(
    r"^(?:# )?[ ]*from (phdtrack[\w.]*) import (?:\(([^)]*)\)|([^\n]*))", re.MULTILINE
)


def test_navigation_lists_every_page():
    listed = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    named = set(re.findall(r"^ *- (?:[^:\n]+: )?(\S+\.md)$", listed, re.MULTILINE))
    there = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    results = {name for name in there if name.startswith("results/")}
    assert named == there - results | {"index.md", "results/*.md"}


def names_in_reference() -> Iterator[str]:
    """The names on the pages of the API: of a module those in `__all__`, or the public ones that it
    defines.
    """
    for page in (DOCS / "api").glob("*.md"):
        for name in DIRECTIVE.findall(page.read_text(encoding="utf-8")):
            yield name
            part = resolve_name(name)
            if not isinstance(part, ModuleType):
                continue
            defined = [
                member
                for member, value in vars(part).items()
                if not member.startswith("_") and getattr(value, "__module__", "") == name
            ]
            yield from (f"{name}.{member}" for member in getattr(part, "__all__", defined))


def programs() -> Iterator[tuple[Path, str]]:
    """The programs on pages and in notebooks."""
    for page in [ROOT / "README.md", *DOCS.rglob("*.md")]:
        for program in PROGRAM.findall(page.read_text(encoding="utf-8")):
            yield page, program
    for notebook in DOCS.rglob("*.ipynb"):
        for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
            if cell["cell_type"] == "code":
                yield notebook, "".join(cell["source"])


def test_reference_has_every_name_that_the_pages_import():
    known = {id(resolve_name(name)) for name in names_in_reference()}
    imported = {
        (page.name, f"{match[1]}.{name.split(' as ')[0].strip()}")
        for page, program in programs()
        for match in IMPORT.finditer(program)
        for name in (match[2] or match[3]).split(",")
        if name.strip()
    }
    assert len(imported) > 40
    missing = [(page, name) for page, name in imported if id(resolve_name(name)) not in known]
    assert missing == []


def test_reference_has_every_public_name():
    """The names of the package, and of the packages that are on its pages."""
    known = set(names_in_reference())
    objects = {id(resolve_name(name)) for name in known}
    phdtrack = resolve_name("phdtrack")
    assert [name for name in phdtrack.__all__ if id(getattr(phdtrack, name)) not in objects] == []
    for path in (ROOT / "src" / "phdtrack").glob("*/__init__.py"):
        package = resolve_name(f"phdtrack.{path.parent.name}")
        # A list of names is an interface; saved states and checks are behind the tracker's.
        if "__all__" in vars(package) and path.parent.name not in ("state", "input_checks"):
            assert package.__name__ in known, package


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


# Rows of the README's table, and the groups that they are on the page of cameras.
GROUPS = {
    "pedestrians, still camera": "ped-static",
    "pedestrians, moving camera": "ped-moving",
    "dancers": "dance",
    "cars, from a car": "cars",
    "players": "players",
    "aerial views": "aerial",
    "cells": "cells",
}


def table_rows(text: str) -> list[list[str]]:
    """The cells of each row of a text's tables."""
    lines = re.findall(r"^\| (.*) \|$", text, re.MULTILINE)
    return [line.split(" | ") for line in lines]


def test_readme_has_the_figures_of_the_regimes():
    page = " ".join((DOCS / "results" / "regimes.md").read_text().split())
    readme = " ".join((DOCS.parent / "README.md").read_text().split())
    scenes = re.search(r"(\d+) scenes of a grid", page)
    grid = re.search(r"in (\d+) of them, and \*ahead\* by 0.02 or more in MOTA in (\d+)", page)
    assert scenes
    assert grid
    behind = "none" if grid[1] == "0" else grid[1]
    assert f"In {behind} of {scenes[1]} [simple simulated scenes]" in readme
    assert f"OC-SORT; in {grid[2]} MOTA is 0.02 or more ahead." in readme


def test_readme_has_the_figures_of_the_cameras():
    """Each cell of its table, and the numbers of comparisons."""
    page = (DOCS / "results" / "cameras.md").read_text()
    readme = (DOCS.parent / "README.md").read_text()
    measured = {
        group: [peer, *own]
        for group, peer, _, *own in (row[:6] for row in table_rows(page) if len(row) == 9)
    }
    shown = {row[0].partition(" (")[0]: row for row in table_rows(readme)}
    assert {name: shown[name][1:] for name in GROUPS} == {
        name: measured[group] for name, group in GROUPS.items()
    }
    won = dict(re.findall(r"^\| ((?:default|left out) \| \w+) \| (\d+ of \d+) \|", page, re.M))
    online, of = won["default | online"].split(" of ")
    left, delayed, corrected = (
        won[rows].removesuffix(f" of {of}")
        for rows in ("left out | online", "default | delayed", "default | corrected")
    )
    text = " ".join(readme.split())
    assert f"in {online} of {of} comparisons ({left} with settings chosen on the other" in text
    assert f" 0.3 s later in {delayed}, corrected in {corrected}." in text
    # Three scores of each case.
    cases = [int(shown[name][0].partition("(")[2].split(")")[0].split()[0]) for name in GROUPS]
    assert 3 * sum(cases) == int(of)
    peers = re.search(r"the best of (\d+) motion-only", page)
    assert peers
    assert f"the best of up to {peers[1]} motion-only trackers" in text


def test_readme_says_where_online_rows_are_behind():
    page = (DOCS / "results" / "cameras.md").read_text()
    text = " ".join((DOCS.parent / "README.md").read_text().split())
    behind = {}
    for row in table_rows(page):
        if len(row) == 9 and row[0] in GROUPS.values():
            peer, own = ([float(value) for value in row[k].split("/")] for k in (1, 3))
            scores = zip(("HOTA", "MOTA", "IDF1"), own, peer, strict=True)
            behind[row[0]] = [name for name, ours, best in scores if ours < best]
    assert {group: scores for group, scores in behind.items() if scores} == {
        "cells": ["HOTA", "MOTA", "IDF1"],
        "ped-moving": ["MOTA"],
    }
    assert "behind on cells (all three), on pedestrians from a moving camera (MOTA)" in text
    (dance,) = [row for row in table_rows(page) if row[:2] == ["online", "dance"] and "HOTA" in row]
    assert f"one of five dances (by {float(dance[5]) - float(dance[4]):.0f} HOTA)" in text


def test_means_on_worse_detections_are_above_the_best_peer():
    """In every score, after every change, online and corrected."""
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
def test_reference_and_search_have_names_and_settings(site: Path):
    pages = [page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html")]
    anchors = {name for page in pages for name in re.findall(r'id="(phdtrack[\w.]*)"', page)}
    hidden = {
        name
        for name in names_in_reference()
        if inspect.isclass(resolve_name(name)) or inspect.isfunction(resolve_name(name))
    }
    assert hidden - anchors == set()
    index = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    entries = json.loads(index[index.index("{") : index.rindex("}") + 1])["docs"]
    found = " ".join(one["text"] for one in entries if one["location"].startswith("api/settings"))
    names = {
        name
        for section in SECTIONS
        for kind in SECTIONS[section]
        for name in settable(section, kind)
    }
    assert {name for name in names if f">{name}<" not in found} == set()


# What users look for, and the page that has it.
LOOKED_FOR = {
    "webcam": "track-a-video",
    "rtsp": "live",
    "mqtt": "live",
    "docker compose": "live",
    "home assistant": "live",
    "privacy": "live",
    "ultralytics": "own-detector",
    "supervision": "from-other-trackers",
    "ByteTrack": "from-other-trackers",
    "onnx": "own-detector",
    "count people": "counting",
    "heatmap": "track-a-video",
    "dwell": "zones-and-lines",
    "moving camera": "moving-camera",
    "homography": "cameras",
    "label": "learn-a-scene",
    "false alarms": "learn-a-scene",
    "re-identification": "appearance",
    "tune": "compare",
    "resume": "track-a-video",
    "KITTI": "formats",
    "groups": "groups",
}


@pytest.mark.slow
@needs_browser
def test_words_of_users_find_the_page_of_their_task(browser, site: Path) -> None:
    """Among the first four pages."""
    page = browser.new_page()
    page.goto((site / "index.html").as_uri())
    box = page.locator(".md-search__input")
    box.click()
    page.get_by_text("Type to start searching").wait_for()
    pages = page.locator(".md-search-result__item > a")
    missed = {}
    for words, wanted in LOOKED_FOR.items():
        box.fill("")
        page.get_by_text("Type to start searching").wait_for()
        box.press_sequentially(words)
        pages.first.wait_for()
        # The last letter may still be searched for.
        page.wait_for_timeout(300)
        found = pages.evaluate_all("all => all.map(a => a.href)")[:4]
        if not any(f"/how-to/{wanted}.html" in link for link in found):
            missed[words] = [link.rpartition("site/")[2] for link in found]
    page.close()
    assert missed == {}


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize(
    ("words", "expected"), [("homography", "cameras"), ("output_delay", "output_delay")]
)
def test_search_works_in_files(browser, site: Path, words: str, expected: str):
    page = browser.new_page()
    page.goto((site / "how-to" / "live.html").as_uri())
    page.locator(".md-search__input").click()
    page.get_by_text("Type to start searching").wait_for()
    page.locator(".md-search__input").press_sequentially(words)
    page.locator(".md-search-result__item").first.wait_for()
    results = page.locator(".md-search-result__item").all_inner_texts()
    assert expected in results[0].lower()
    if words == "output_delay":
        links = page.locator(".md-search-result__link").evaluate_all("all => all.map(a => a.href)")
        assert any("/api/setting" in link for link in links), links
    page.close()


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("width", [390, 1280])
def test_code_is_not_wider_than_its_box(browser, site: Path, width: int) -> None:
    """On a telephone and on a desk: no line of code has to be scrolled sideways."""
    page = browser.new_page(viewport={"width": width, "height": 800})
    blocks = 0
    wide = {}
    for path in sorted(site.rglob("*.html")):
        page.goto(path.as_uri())
        boxes = page.locator("pre").evaluate_all(
            "all => all.flatMap(pre => [pre, ...pre.querySelectorAll('code')])"
            ".filter(box => box.clientWidth)"
            ".map(box => [box.scrollWidth - box.clientWidth, box.textContent.slice(0, 60)])"
        )
        blocks += len(boxes)
        if found := [text for excess, text in boxes if excess > 0]:
            wide[path.relative_to(site).as_posix()] = found
    page.close()
    assert blocks > 100
    assert wide == {}
