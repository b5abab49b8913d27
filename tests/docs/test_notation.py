"""docs/notation.md names only what the code has."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "phdtrack"
MODULES = [*SOURCE.rglob("*.py"), *(ROOT / "experiments").glob("*.py")]
PAGE = (ROOT / "docs" / "notation.md").read_text()
NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


def code_names() -> list[str]:
    """The names in backticks in the third column of the tables, and in the text of the others."""
    lines = [line for line in PAGE.splitlines() if line.startswith("| ")]
    cells = [re.split(r"(?<!\\)\|", line) for line in lines]
    quoted = [name for row in cells for cell in row[2:] for name in re.findall(r"`([^`]+)`", cell)]
    return sorted({name for name in quoted if NAME.fullmatch(name)})


def members(node: ast.ClassDef) -> set[str]:
    """Fields, properties and methods of a class, without those of its bases."""
    annotated = [one.target for one in node.body if isinstance(one, ast.AnnAssign)]
    fields = {target.id for target in annotated if isinstance(target, ast.Name)}
    return fields | {one.name for one in node.body if isinstance(one, ast.FunctionDef)}


@cache
def code() -> tuple[set[str], dict[str, set[str]], set[str]]:
    """Identifiers, the members of each class, and the dotted names of modules and their parts."""
    names = set[str]()
    classes = dict[str, set[str]]()
    bases = dict[str, list[str]]()
    dotted = set[str]()
    for path in MODULES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        module = ".".join(path.relative_to(SOURCE if SOURCE in path.parents else ROOT).parts)[:-3]
        module = module.removesuffix(".__init__")
        dotted.add(module)
        for node in ast.walk(tree):
            if isinstance(node, ast.arg):
                names.add(node.arg)
            elif isinstance(node, ast.Name):
                names.add(node.id)
            elif isinstance(node, ast.ClassDef | ast.FunctionDef):
                names.add(node.name)
                dotted.add(f"{module}.{node.name}")
            if isinstance(node, ast.ClassDef):
                classes.setdefault(node.name, set()).update(members(node))
                bases[node.name] = [base.id for base in node.bases if isinstance(base, ast.Name)]
                dotted |= {f"{module}.{node.name}.{one}" for one in members(node)}
    for name, parents in bases.items():
        for parent in parents:
            classes[name] |= classes.get(parent, set())
    return names, classes, dotted


@pytest.mark.parametrize("name", code_names())
def test_code_has_every_name(name: str) -> None:
    names, classes, dotted = code()
    first, _, rest = name.partition(".")
    known = name in names or name in dotted
    assert known or rest in classes.get(first, set()), f"the code has no {name}"


def test_notation_has_names() -> None:
    assert len(code_names()) > 60
