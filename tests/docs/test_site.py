"""The site: every page is in it, and its figures are those of the results."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def test_every_page_is_in_the_navigation_and_every_entry_is_a_page():
    listed = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    named = set(re.findall(r"^ *- (?:[^:\n]+: )?(\S+\.md)$", listed, re.MULTILINE))
    there = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    results = {name for name in there if name.startswith("results/")}
    assert named == there - results | {"index.md", "results/*.md"}


def test_the_table_of_filters_has_the_figures_of_the_results():
    found = re.findall(r"\| (frcnn|public) \| ([a-z-]+) \|([^\n]*)\|\n", (DOCS / "results" / "peers.md").read_text())
    scores = {(case, name): re.findall(r"\d+\.\d", row) for case, name, row in found}
    table = re.findall(r"^\| `([a-z-]+)` \|([ \d./|]+)\|$", (DOCS / "filters.md").read_text(), re.MULTILINE)
    assert len(table) == 5
    for name, row in table:
        assert re.findall(r"\d+\.\d", row)[:12] == scores["frcnn", name][:6] + scores["public", name][:6], name


@pytest.mark.slow
def test_the_site_builds_and_every_link_resolves(tmp_path: Path):
    done = subprocess.run(
        ["make", "site", f"SITE={tmp_path / 'site'}"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for page in ("index.html", "filters.html", "api/tracker.html", "how-to/README.html", "results/videos.html"):
        assert (tmp_path / "site" / page).exists(), page
    assert "frame_size" in (tmp_path / "site" / "api" / "tracker.html").read_text(encoding="utf-8")
