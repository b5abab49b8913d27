"""What the site needs beside the pages in docs/: the README as its first page, links to files that are no pages, the results.

A hook of MkDocs, used by `make site`. The README is read where it is, so that it stands once.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """A page of results is listed by being there."""
    for entry in config.nav or []:
        if isinstance(entry, dict) and entry.get("Results") == ["results/*.md"]:
            entry["Results"] = [f"results/{path.name}" for path in sorted((ROOT / "docs" / "results").glob("*.md"))]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The README is the first page; its links begin in the folder above docs/."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").replace("(docs/", "(")
    files.append(File.generated(config, "index.md", content=text))
    return files


def on_page_markdown(text: str, page: Page, config: MkDocsConfig, files: Files, **_: Any) -> str:
    """Links to what is no page of the site, as a module, are its name; MkDocs checks all others."""
    here = (ROOT / "docs" / page.file.src_uri).parent

    def kept(found: re.Match[str]) -> str:
        words, target, _ = found.groups()
        path = (here / target).resolve()
        outside = "://" not in target and not path.is_relative_to(ROOT / "docs")
        other = path.is_relative_to(ROOT / "docs") and path.exists() and path.suffix not in (".md", ".jpg", ".png")
        return words if outside or other or target == "CHANGELOG.md" else found[0]

    return LINK.sub(kept, text)
