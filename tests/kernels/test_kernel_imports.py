"""Imports of kernels, by which those that are kept on disk are recognised as outdated."""

from __future__ import annotations

import ast
import re

from phdtrack.kernels import cache


def test_imports_of_kernels_are_found_by_their_lines() -> None:
    """A kernel that imported another one in any other way would not be compiled again with it."""
    files = {file.stem: file for file in cache.SOURCES.glob("*.py")}
    plain = re.compile(r"from phdtrack\.kernels(\.\w+)? import .+")
    for file in files.values():
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module or "."] if isinstance(node, ast.ImportFrom) else []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            if any(name.startswith(("phdtrack", ".")) for name in names):
                line = ast.unparse(node)
                assert plain.fullmatch(line), (file.name, line)
                assert node.col_offset == 0, (file.name, line)
                assert "kernels." in line or not {a.name for a in node.names} & files.keys(), line
