"""A hook of MkDocs and an extension of Griffe for `make site`.

They add the README as the first page, list the pages of results, convert equations to MathML and
docstrings to NumPy's style, and replace links to files that are not pages by their text.
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
# How often a page counts in the search, by its folder: a page for a task is what a user looks for.
BOOSTS = {"how-to": 4.0, "results": 0.5}
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """List every page in docs/results."""
    for entry in config.nav or []:
        if isinstance(entry, dict) and entry.get("Results") == ["results/*.md"]:
            entry["Results"] = [
                f"results/{path.name}" for path in sorted((ROOT / "docs" / "results").glob("*.md"))
            ]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the README as the first page, with its links relative to docs/."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").replace("(docs/", "(")
    files.append(File.generated(config, "index.md", content=text))
    return files


def on_page_markdown(text: str, page: Page, config: MkDocsConfig, files: Files, **_: Any) -> str:
    """Replace links to files that are not pages by their text, and equations by MathML; rank the
    page in the search.

    MkDocs checks the remaining links.
    """
    here = (ROOT / "docs" / page.file.src_uri).parent
    page.meta["search"] = {"boost": BOOSTS.get(page.file.src_uri.partition("/")[0], 1.0)}

    def kept(found: re.Match[str]) -> str:
        words, target, _ = found.groups()
        path = (here / target).resolve()
        beside_readme = page.file.src_uri == "index.md" and (ROOT / target).exists()
        outside = "://" not in target and not path.is_relative_to(ROOT / "docs")
        other = (
            path.is_relative_to(ROOT / "docs")
            and path.exists()
            and path.suffix not in (".md", ".jpg", ".png", ".ipynb")
        )
        return words if outside or other or beside_readme else found[0]

    def typeset(found: re.Match[str]) -> str:
        # Browsers know no columnalign.
        mathml = convert(found[1], display="block")
        mathml = re.sub(r'columnalign="(\w+)"', r'style="text-align: \1; padding: 0.3em 0"', mathml)
        return f'\n<div style="overflow-x: auto; overflow-y: hidden">{mathml}</div>\n'

    return EQUATION.sub(typeset, LINK.sub(kept, text))


class Docstrings(griffe.Extension):
    """Convert entries ``name : description`` to NumPy's style.

    NumPy's style has the type after the colon and the description in an indented line below. Our
    types are in the signature.
    """

    SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises")
    ENTRY = re.compile(r"^(\*{0,2}\w[\w, *`]*?) : (.*)$")

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if obj.docstring is None:
            return
        if obj.is_class and "__init__" not in obj.all_members:
            # A protocol describes the arguments of its methods.
            obj.docstring.parser_options = {"warnings": False}
        lines = obj.docstring.value.replace("``", "`").split("\n")
        out = list[str]()
        section = ""
        in_prose = False
        for k, line in enumerate(lines):
            if k + 1 < len(lines) and set(lines[k + 1].strip()) == {"-"}:
                section = line.strip()
            entry = self.ENTRY.match(line) if section in self.SECTIONS else None
            type_ = ""
            if section in ("Returns", "Yields"):
                type_ = str(getattr(obj, "returns", None) or "")
            begins = type_ and k and set(lines[k - 1].strip()) == {"-"}
            in_prose = bool(line) and not entry and bool(begins or in_prose)
            if entry:
                out += [f"{entry[1]} : {type_}" if type_ else entry[1], f"    {entry[2]}"]
            elif in_prose:
                # A sentence without a name: the type is that of the signature.
                out += [*([type_] if begins else []), f"    {line}"]
            else:
                out.append(line)
        obj.docstring.value = "\n".join(out)
