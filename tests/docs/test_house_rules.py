"""The rules of the house that linters and the import contract cannot check: sizes, small files,
circles, docstrings.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "src" / "phdtrack"
MODULES = sorted(SOURCES.rglob("*.py"))
Function = ast.FunctionDef | ast.AsyncFunctionDef

MAX_LINES = 40_531
MAX_FILES = 189
MAX_TOP_LEVEL = 10
MAX_FILE = 500
MIN_FILE = 60
MAX_FUNCTION = 60
MAX_PARAMETERS = 8
MAX_KERNEL_PARAMETERS = 10
MAX_TEST_LINES = 35_199
MAX_LOADED_MODULES = 90
MAX_LOADED_LINES = 11_550


def check(rule: str, found: list[str]) -> None:
    """No offenders; each says where it is and by how much."""
    assert not found, f"{rule}: {len(found)} offenders\n  " + "\n  ".join(found)


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def short(path: Path) -> str:
    return str(path.relative_to(ROOT))


def dotted(path: Path) -> str:
    """``phdtrack.filters.pmb`` of its file; a package's name for its ``__init__``."""
    return ".".join(path.relative_to(SOURCES.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )


def imports(path: Path, *, types_too: bool) -> Iterator[str]:
    """Full names that a file imports, at any depth; ``types_too``: also those under ``if
    TYPE_CHECKING``.
    """
    for_types: set[ast.AST] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for_types.update(child for part in node.body for child in ast.walk(part))
    for node in ast.walk(tree(path)):
        if node in for_types and not types_too:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@cache
def importers() -> dict[str, set[str]]:
    """For every module of the package those that import it, by full name; importing a name of it
    counts.
    """
    known = {dotted(path) for path in MODULES}
    found: dict[str, set[str]] = {name: set() for name in known}
    for path in MODULES:
        for name in imports(path, types_too=True):
            module = name if name in known else name.rpartition(".")[0]
            if module in known and module != dotted(path):
                found[module].add(dotted(path))
    return found


class Part(NamedTuple):
    """A function or method that is not inside a function: its file, where it is, and whether it is
    public.
    """

    path: Path
    place: str
    node: Function
    public: bool


def functions() -> Iterator[Part]:
    for path in MODULES:
        for node in tree(path).body:
            inside = node.body if isinstance(node, ast.ClassDef) else [node]
            for part in inside:
                if isinstance(part, Function):
                    public = not part.name.startswith("_") and not getattr(
                        node, "name", ""
                    ).startswith("_")
                    yield Part(path, f"{short(path)}:{part.lineno} {part.name}", part, public)


def parameters(node: Function) -> list[ast.arg]:
    given = node.args
    each = [
        *given.posonlyargs,
        *given.args,
        *given.kwonlyargs,
        *filter(None, (given.vararg, given.kwarg)),
    ]
    return [one for one in each if one.arg not in ("self", "cls")]


def commands(path: Path, node: Function) -> bool:
    """A command of the command line: its parameters are options, its docstring is the help text."""
    return "cli" in path.parts and any(
        one.annotation is not None
        and re.search("Annotated|Json|Overwrite", ast.unparse(one.annotation))
        for one in parameters(node)
    )


TESTS = [*(ROOT / "tests").rglob("*.py"), *(ROOT / "experiments" / "tests").rglob("*.py")]


@pytest.mark.parametrize(
    ("paths", "limit"), [(MODULES, MAX_LINES), (TESTS, MAX_TEST_LINES)], ids=["src", "tests"]
)
def test_number_of_lines(paths: list[Path], limit: int) -> None:
    assert sum(map(lines, paths)) <= limit


def test_number_of_files() -> None:
    assert len(MODULES) <= MAX_FILES
    top = {path.name for path in SOURCES.glob("*.py")} - {"__init__.py", "__main__.py"}
    assert len(top) <= MAX_TOP_LEVEL, top


def test_kernels_import_numpy_and_numba_only() -> None:
    allowed = {"numpy", "numba", *sys.stdlib_module_names}
    for path in (SOURCES / "kernels").rglob("*.py"):
        for name in imports(path, types_too=True):
            assert name.split(".")[0] in allowed or name.startswith("phdtrack.kernels"), (
                f"{short(path)}: {name}"
            )


def test_no_file_is_very_long() -> None:
    check(
        "long files",
        [f"{short(path)}: {lines(path)}" for path in MODULES if lines(path) > MAX_FILE],
    )


def test_no_small_file_serves_one_neighbour_only() -> None:
    found = []
    for path in MODULES:
        users = [*importers()[dotted(path)]]
        neighbour = (
            len(users) == 1 and users[0].rpartition(".")[0] == dotted(path).rpartition(".")[0]
        )
        if neighbour and lines(path) < MIN_FILE and path.name not in ("__init__.py", "__main__.py"):
            found.append(f"{short(path)}: {users[0]}")
    check("small files", found)


def test_no_function_is_long() -> None:
    sizes = {part.place: (part.node.end_lineno or 0) - part.node.lineno + 1 for part in functions()}
    check(
        "long functions",
        [f"{place}: {size}" for place, size in sizes.items() if size > MAX_FUNCTION],
    )


def test_no_function_takes_many_parameters() -> None:
    found = []
    for part in functions():
        limit = MAX_KERNEL_PARAMETERS if "kernels" in part.path.parts else MAX_PARAMETERS
        if len(parameters(part.node)) > limit and not commands(part.path, part.node):
            found.append(f"{part.place}: {len(parameters(part.node))}")
    check("many parameters", found)


def test_public_functions_say_what_goes_in() -> None:
    """Kernels and the command line are no part of the public library: their records and options say
    what goes in.

    What comes back the first line of a docstring says; a section Returns is for what that line does
    not hold. Arguments of the methods of a protocol are described there, in theirs or in its
    docstring, for all that implement it.
    """
    protocols = [
        node for node in tree(SOURCES / "protocols.py").body if isinstance(node, ast.ClassDef)
    ]
    texts = {
        one: (ast.get_docstring(one) or "").partition("Parameters\n-----")[2] for one in protocols
    }
    shared = {
        part
        for one, text in texts.items()
        for part in one.body
        if isinstance(part, ast.FunctionDef)
        and all(
            re.search(rf"^(\w+, )*{each.arg}\b[^:]* : ", text, re.MULTILINE)
            for each in parameters(part)
        )
    }
    methods = (part for part in functions() if part.path.name == "protocols.py")
    described = {(part.node.name, *(one.arg for one in parameters(part.node))) for part in methods}
    found = []
    for part in functions():
        if (
            part.public
            and len(parameters(part.node)) >= 3
            and not {"kernels", "cli"} & set(part.path.parts)
        ):
            implements = (part.node.name, *(one.arg for one in parameters(part.node))) in described
            if part.node in shared or (implements and part.path.name != "protocols.py"):
                continue
            if "Parameters\n-----" not in (ast.get_docstring(part.node) or ""):
                found.append(part.place)
    check("no sections", found)


def test_no_import_goes_in_a_circle() -> None:
    """Every import counts, at any depth of the code, but those for types only."""
    known = {dotted(path): path for path in MODULES}
    uses: dict[str, set[str]] = {}
    for name, path in known.items():
        named = imports(path, types_too=False)
        uses[name] = {
            one if one in known else one.rpartition(".")[0] for one in named
        } & known.keys() - {name}
    reached = {name: _reached(name, uses) for name in uses}
    found = {frozenset(b for b in reached[a] if a in reached[b]) for a in uses if a in reached[a]}
    check("circles", [" ↔ ".join(sorted(circle)) for circle in found])


def _reached(start: str, uses: dict[str, set[str]]) -> set[str]:
    seen: set[str] = set()
    ahead = [start]
    while ahead:
        for name in uses.get(ahead.pop(), set()) - seen:
            seen.add(name)
            ahead.append(name)
    return seen


def test_nobody_asks_what_attributes_a_thing_has() -> None:
    found = [
        f"{short(path)}:{node.lineno}"
        for path in MODULES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Name) and node.id == "hasattr"
    ]
    check("hasattr", found)


def test_a_tracker_and_one_update_load_little() -> None:
    """In a fresh interpreter: how many modules of the package are loaded, and how many lines they
    have.
    """
    program = (
        "import sys, numpy as np, phdtrack\ntracker = phdtrack.Tracker((640, 480),"
        " fps=25)\ntracker.update(np.array([[10.0, 10, 40, 90]]))\nprint(*(m.__file__ for n, m in"
        " sys.modules.items() if n.split('.')[0] == 'phdtrack'), sep='\\n')\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    paths = [Path(line) for line in run.stdout.split("\n") if line]
    assert len(paths) <= MAX_LOADED_MODULES
    assert sum(lines(path) for path in paths) <= MAX_LOADED_LINES


MORE_CONSTRAINTS = (
    "benchmarks/peers-constraints.txt",
    "scripts/site-constraints.txt",
    "tests/cluster-constraints.txt",
)
CONSTRAINTS = [ROOT / "constraints.txt", *(ROOT / name for name in MORE_CONSTRAINTS)]


@pytest.mark.parametrize("path", CONSTRAINTS, ids=lambda path: path.name)
def test_constraints_pin_versions_and_hashes_without_addresses(path: Path) -> None:
    """One package a line, each with a hash at least; `scripts/hashes.py` fills them in."""
    pinned = path.read_text(encoding="utf-8").splitlines()
    assert pinned
    good = re.compile(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.]+( --hash=sha256:[0-9a-f]{64})+")
    assert [line[:60] for line in pinned if not good.fullmatch(line)] == []


def test_constraints_hold_everything_that_is_needed() -> None:
    """They are installed without following dependencies: what the packages of this machine ask for
    must be among them.

    TrackEval comes without its own, which would put OpenCV 5 over OpenCV 4.
    """

    def asked(requirements: Iterable[str], extras: Iterable[str] = ("",)) -> set[str]:
        found = map(Requirement, requirements)
        kept = [
            one
            for one in found
            if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in extras)
        ]
        return {canonicalize_name(one.name) for one in kept}

    pinned = {
        canonicalize_name(line.partition("==")[0])
        for line in CONSTRAINTS[0].read_text(encoding="utf-8").splitlines()
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = asked(project["project"]["dependencies"]) | asked(project["build-system"]["requires"])
    # Of the extras paho-mqtt, Ray and Rerun are not here: one has a stand-in, the others have
    # constraints of their own.
    for extra in project["project"]["optional-dependencies"].values():
        wanted |= asked(extra) - {"phdtrack", "paho-mqtt", "ray", "rerun-sdk"}
    for name in pinned - {"trackeval", "colorama"}:
        wanted |= asked(metadata.requires(name) or ())
    assert wanted - pinned == set()
