"""What the import contract cannot say: what kernels may import, how small files stay, where addresses may not stand."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "src" / "phdtrack"
MODULES = sorted(SOURCES.rglob("*.py"))
KERNELS = sorted((SOURCES / "kernels").rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """Full names of the modules that a file imports, at any depth of its code."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""


def named(paths: list[Path]) -> list[str]:
    return [str(path.relative_to(SOURCES)) for path in paths]


def test_kernels_import_numpy_and_numba_only() -> None:
    allowed = {"numpy", "numba", *sys.stdlib_module_names}
    foreign = [
        (path.name, name)
        for path in KERNELS
        for name in imported(path)
        if name.split(".")[0] not in allowed and not name.startswith("phdtrack.kernels")
    ]
    assert foreign == []


def test_no_file_is_longer_than_400_lines() -> None:
    assert named([path for path in MODULES if len(path.read_text(encoding="utf-8").splitlines()) > 400]) == []


def test_every_module_says_what_it_is() -> None:
    texts = {path: ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "" for path in MODULES}
    assert named([path for path, text in texts.items() if len(text) < 20]) == []


def test_global_randomness_is_nowhere() -> None:
    drawing = re.compile(r"np\.random\.(?!Generator|SeedSequence|default_rng|PCG64|Philox|BitGenerator)\w+")
    assert named([path for path in MODULES if drawing.search(path.read_text(encoding="utf-8"))]) == []


def test_constraints_pin_versions_without_addresses() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").split()
    assert lines
    assert [line for line in lines if not re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.]+", line)] == []
