"""What the site needs beside the pages in docs/: the README as its first page, the pages of
results, docstrings as its generator expects them, equations as MathML; and links to files that are
no pages are their names.

A hook of MkDocs and an extension of Griffe, used by `make site`. The README is read where it is, so
that it stands once.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import griffe
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
EQUATION = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """A page of results is listed by being there."""
    for entry in config.nav or []:
        if isinstance(entry, dict) and entry.get("Results") == ["results/*.md"]:
            entry["Results"] = [
                f"results/{path.name}" for path in sorted((ROOT / "docs" / "results").glob("*.md"))
            ]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The README is the first page; its links begin in the folder above docs/."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").replace("(docs/", "(")
    files.append(File.generated(config, "index.md", content=text))
    return files


def on_page_markdown(text: str, page: Page, config: MkDocsConfig, files: Files, **_: Any) -> str:
    """Links to what is no page of the site, as a module, are its name; MkDocs checks all others.
    Browsers typeset MathML.
    """
    here = (ROOT / "docs" / page.file.src_uri).parent

    def kept(found: re.Match[str]) -> str:
        words, target, _ = found.groups()
        path = (here / target).resolve()
        outside = "://" not in target and not path.is_relative_to(ROOT / "docs")
        other = (
            path.is_relative_to(ROOT / "docs")
            and path.exists()
            and path.suffix not in (".md", ".jpg", ".png", ".ipynb")
        )
        return words if outside or other or target == "CHANGELOG.md" else found[0]

    def typeset(found: re.Match[str]) -> str:
        # Browsers know no columnalign.
        mathml = convert(found[1], display="block")
        mathml = re.sub(r'columnalign="(\w+)"', r'style="text-align: \1; padding: 0.3em 0"', mathml)
        return f'\n<div style="overflow-x: auto; overflow-y: hidden">{mathml}</div>\n'

    return EQUATION.sub(typeset, LINK.sub(kept, text))


class Docstrings(griffe.Extension):
    """Our docstrings say ``name : what it is``, as types are in the signature. NumPy's style has
    the type there, and what it is in an indented line below."""

    # Sections with such entries, and an entry.
    SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises")
    ENTRY = re.compile(r"^(\*{0,2}\w[\w, *`]*?) : (.*)$")

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite its docstring."""
        if obj.docstring is None:
            return
        if obj.is_class and "__init__" not in obj.all_members:
            # A protocol says what the arguments of its methods are.
            obj.docstring.parser_options = {"warnings": False}
        lines = obj.docstring.value.replace("``", "`").split("\n")
        out = list[str]()
        section = ""
        for k, line in enumerate(lines):
            if k + 1 < len(lines) and set(lines[k + 1].strip()) == {"-"}:
                section = line.strip()
            entry = self.ENTRY.match(line) if section in self.SECTIONS else None
            if entry:
                given = (
                    str(getattr(obj, "returns", None) or "")
                    if section in ("Returns", "Yields")
                    else ""
                )
                out += [f"{entry[1]} : {given}" if given else entry[1], f"    {entry[2]}"]
            else:
                out.append(line)
        obj.docstring.value = "\n".join(out)
