"""House rules that linters and the import contract do not check."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import NamedTuple, TypeGuard

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ROOT / "src" / "phdtrack"
MODULES = sorted(SOURCES.rglob("*.py"))
TESTS = [
    *sorted((ROOT / "tests").rglob("*.py")),
    *sorted((ROOT / "experiments" / "tests").rglob("*.py")),
]
Function = ast.FunctionDef | ast.AsyncFunctionDef
Documented = Function | ast.ClassDef | ast.Module

MAX_STATEMENTS = 40
MAX_PARAMETERS = 8
MAX_KERNEL_PARAMETERS = 10
MAX_TUPLE_SHARE = 0.015
MAX_CONDITIONALS = 10
MAX_WIDTH = 100
MAX_TEST_NAME = 60


def check(rule: str, offenders: list[str]) -> None:
    assert not offenders, f"{rule}: {len(offenders)} offenders\n  " + "\n  ".join(offenders)


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def all_nodes(path: Path) -> list[ast.AST]:
    return list(ast.walk(tree(path)))


def nodes(paths: Iterable[Path]) -> Iterator[tuple[Path, ast.AST]]:
    for path in paths:
        for node in all_nodes(path):
            yield path, node


def short(path: Path) -> str:
    return str(path.relative_to(ROOT))


def dotted(path: Path) -> str:
    """Return ``phdtrack.filters.pmb`` for its file, and a package's name for its ``__init__``."""
    name = ".".join(path.relative_to(SOURCES.parent).with_suffix("").parts)
    return name.removesuffix(".__init__")


def imports(path: Path, *, types_too: bool) -> Iterator[str]:
    """Full names that a file imports at any depth.

    ``types_too`` includes imports under ``if TYPE_CHECKING``.
    """
    for_types: set[ast.AST] = set()
    for node in all_nodes(path):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for_types.update(child for part in node.body for child in ast.walk(part))
    for node in all_nodes(path):
        if node in for_types and not types_too:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


class Part(NamedTuple):
    """A function or method that is not nested in a function."""

    path: Path
    place: str
    node: Function
    public: bool


def functions() -> Iterator[Part]:
    for path in MODULES:
        for node in tree(path).body:
            members = node.body if isinstance(node, ast.ClassDef) else [node]
            owner = getattr(node, "name", "")
            for member in members:
                if isinstance(member, Function):
                    public = not member.name.startswith("_") and not owner.startswith("_")
                    place = f"{short(path)}:{member.lineno} {member.name}"
                    yield Part(path, place, member, public)


def parameters(node: Function) -> list[ast.arg]:
    listed = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    listed += [each for each in (node.args.vararg, node.args.kwarg) if each is not None]
    return [each for each in listed if each.arg not in ("self", "cls")]


def is_command(part: Part) -> bool:
    """Tell a CLI command: its parameters are options, and its docstring is the help text."""
    if "cli" not in part.path.parts:
        return False
    annotations = [each.annotation for each in parameters(part.node) if each.annotation is not None]
    return any(re.search("Annotated|Json|Overwrite", ast.unparse(each)) for each in annotations)


def is_docstring(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def statements(node: Function) -> int:
    """Count the statements in a function, nested ones included, docstrings left out."""
    inside = (child for child in ast.walk(node) if child is not node)
    return sum(isinstance(child, ast.stmt) and not is_docstring(child) for child in inside)


def test_functions_are_short() -> None:
    found = [
        f"{part.place}: {statements(part.node)} statements"
        for part in functions()
        if statements(part.node) > MAX_STATEMENTS
    ]
    check("long functions", found)


def test_functions_have_few_parameters() -> None:
    found = []
    for part in functions():
        limit = MAX_KERNEL_PARAMETERS if "kernels" in part.path.parts else MAX_PARAMETERS
        count = len(parameters(part.node))
        if count > limit and not is_command(part):
            found.append(f"{part.place}: {count}")
    check("many parameters", found)


def test_assignments_set_one_value() -> None:
    """``a, b = x, y`` is for the rare swap."""
    assignments = [(path, node) for path, node in nodes(MODULES) if isinstance(node, ast.Assign)]
    pairs = [
        f"{short(path)}:{node.lineno}"
        for path, node in assignments
        if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)
    ]
    assert len(pairs) <= MAX_TUPLE_SHARE * len(assignments), pairs


def test_conditional_expressions_are_rare() -> None:
    conditionals = sum(isinstance(node, ast.IfExp) for _, node in nodes(MODULES))
    thousands = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES) / 1000
    assert conditionals / thousands <= MAX_CONDITIONALS


def test_module_names_are_unique() -> None:
    """A kernel module may have the name of the module that it serves."""
    places: dict[str, list[Path]] = {}
    for path in MODULES:
        if path.parent.name != "kernels" and not path.stem.startswith("__"):
            places.setdefault(path.stem, []).append(path)
    twice = [" ".join(map(short, paths)) for paths in places.values() if len(paths) > 1]
    check("module names used twice", twice)


def test_docstrings_begin_with_verb_or_noun() -> None:
    found = []
    for path, node in nodes(MODULES):
        text = ast.get_docstring(node) if isinstance(node, Documented) else None
        if text and re.match(r"(Of|What|Whether|Those|These|As|Where)\b", text):
            found.append(f"{short(path)}:{getattr(node, 'lineno', 1)} {text.split(chr(10))[0]}")
    check("docstrings", found)


def too_wide(path: Path, *, prose_only: bool) -> Iterator[str]:
    """Lines above the limit; ``prose_only`` skips code blocks and tables of Markdown."""
    in_code = False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if line.startswith("```"):
            in_code = not in_code
        elif len(line) > MAX_WIDTH and not (prose_only and (in_code or line.startswith("|"))):
            yield f"{short(path)}:{number} {len(line)}"


def test_lines_are_at_most_100_characters() -> None:
    sources = [*MODULES, *SOURCES.rglob("*.toml")]
    check("wide lines", [place for path in sources for place in too_wide(path, prose_only=False)])


def test_prose_is_at_most_100_characters_wide() -> None:
    """Pages that a program writes are exempt."""
    pages = [*ROOT.glob("*.md"), *(ROOT / ".github").rglob("*.md"), *(ROOT / "docs").rglob("*.md")]
    generated = {ROOT / "docs" / "equations.md", *(ROOT / "docs" / "results").glob("*.md")}
    written = sorted(set(pages) - generated)
    check("wide lines", [place for path in written for place in too_wide(path, prose_only=True)])


def test_names_of_tests_are_short() -> None:
    found = [
        f"{short(path)}:{node.lineno} {node.name}: {len(node.name)}"
        for path, node in nodes(TESTS)
        if isinstance(node, Function)
        and node.name.startswith("test_")
        and len(node.name) > MAX_TEST_NAME
    ]
    check("long test names", found)


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__") and name != "_"


def is_own_attribute(node: ast.AST) -> TypeGuard[ast.Attribute]:
    """Return true if a method sets this attribute of its object or class."""
    return (
        isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and isinstance(node.value, ast.Name)
        and node.value.id in ("self", "cls")
    )


def private_names(paths: Iterable[Path]) -> set[str]:
    """Names with a leading underscore that the files define: functions, classes, attributes."""
    defined: set[str] = set()
    for _, node in nodes(paths):
        if isinstance(node, Function | ast.ClassDef):
            defined.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            defined.add(node.id)
        elif is_own_attribute(node):
            defined.add(node.attr)
    return {name for name in defined if is_private(name)}


def private_uses(path: Path, names: set[str]) -> Iterator[str]:
    """Places in a test file that reach a private name of the package.

    ``names`` are the package's private names. A name that the test file defines itself, as for the
    attributes of its own classes, does not count. Names inside strings count: they are patched
    (``monkeypatch.setattr``) or run in another process.
    """
    foreign = names - private_names([path])
    in_text = re.compile(r"\w\.(_[a-z]\w*)")
    for node in all_nodes(path):
        used: list[str] = []
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("phdtrack"):
            used = [each.name for each in node.names if is_private(each.name)]
        elif isinstance(node, ast.Attribute) and node.attr in foreign:
            used = [node.attr]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            used = [name for name in in_text.findall(node.value) if name in foreign]
            used += [node.value] * (node.value in foreign)
        yield from (f"{short(path)}:{node.lineno} {name}" for name in used)


def test_tests_use_public_names_only() -> None:
    names = private_names(MODULES)
    others = [path for path in TESTS if path != Path(__file__)]
    check("private names", [use for path in others for use in private_uses(path, names)])


def test_private_uses_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    path = tmp_path / "test_part.py"
    path.write_text(
        "from phdtrack.part import _step\n"
        "thing._clock = 3\n"
        "monkeypatch.setattr('phdtrack.part._clock', 3)\n"
        "monkeypatch.setattr(part, '_read', 3)\n"
        "class Own:\n"
        "    def __init__(self): self._own = 1\n"
        "    def value(self): return self._own + self.other._foreign\n"
    )
    found = list(private_uses(path, {"_step", "_clock", "_read", "_own"}))
    assert sorted(found) == [
        "test_part.py:1 _step",
        "test_part.py:2 _clock",
        "test_part.py:3 _clock",
        "test_part.py:4 _read",
    ]


def test_kernels_import_numpy_and_numba_only() -> None:
    allowed = {"numpy", "numba", *sys.stdlib_module_names}
    for path in (SOURCES / "kernels").rglob("*.py"):
        for name in imports(path, types_too=True):
            assert name.split(".")[0] in allowed or name.startswith("phdtrack.kernels"), (
                f"{short(path)}: {name}"
            )


def protocol_methods() -> tuple[set[Function], set[tuple[str, ...]]]:
    """Methods that their protocol's docstring describes, and the signatures of all protocols."""
    described: set[Function] = set()
    signatures: set[tuple[str, ...]] = set()
    for protocol in tree(SOURCES / "protocols.py").body:
        if not isinstance(protocol, ast.ClassDef):
            continue
        text = (ast.get_docstring(protocol) or "").partition("Parameters\n-----")[2]
        for method in protocol.body:
            if not isinstance(method, Function):
                continue
            names = [each.arg for each in parameters(method)]
            signatures.add((method.name, *names))
            entries = [rf"^(\w+, )*{name}\b[^:]* : " for name in names]
            if all(re.search(entry, text, re.MULTILINE) for entry in entries):
                described.add(method)
    return described, signatures


def test_public_functions_describe_their_arguments() -> None:
    """A docstring of a public function with three or more parameters has a section Parameters.

    Kernels and CLI commands are not part of the public library. An implementation of a protocol
    is described by the protocol, in the method's or in the class's docstring.
    """
    described, signatures = protocol_methods()
    found = []
    for part in functions():
        names = [each.arg for each in parameters(part.node)]
        exempt = not part.public or len(names) < 3 or {"kernels", "cli"} & set(part.path.parts)
        implements = (part.node.name, *names) in signatures and part.path.name != "protocols.py"
        if exempt or implements or part.node in described:
            continue
        if "Parameters\n-----" not in (ast.get_docstring(part.node) or ""):
            found.append(part.place)
    check("no section Parameters", found)


def test_imports_make_no_circle() -> None:
    """Imports count at any depth of the code, except those for types only."""
    known = {dotted(path): path for path in MODULES}
    uses: dict[str, set[str]] = {}
    for name, path in known.items():
        named = imports(path, types_too=False)
        modules = {each if each in known else each.rpartition(".")[0] for each in named}
        uses[name] = modules & known.keys() - {name}
    reached = {name: reachable(name, uses) for name in uses}
    circles = {frozenset(b for b in reached[a] if a in reached[b]) for a in uses if a in reached[a]}
    check("circles", [" ↔ ".join(sorted(circle)) for circle in circles])


def reachable(start: str, uses: dict[str, set[str]]) -> set[str]:
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        for name in uses.get(waiting.pop(), set()) - seen:
            seen.add(name)
            waiting.append(name)
    return seen


def test_capabilities_are_protocols_not_attributes() -> None:
    found = [
        f"{short(path)}:{node.lineno}"
        for path, node in nodes(MODULES)
        if isinstance(node, ast.Name) and node.id == "hasattr"
    ]
    check("hasattr", found)


@cache
def classes() -> dict[str, list[ast.ClassDef]]:
    """Classes of the package by name."""
    found: dict[str, list[ast.ClassDef]] = {}
    for _, node in nodes(MODULES):
        if isinstance(node, ast.ClassDef):
            found.setdefault(node.name, []).append(node)
    return found


MORE_CONSTRAINTS = (
    "benchmarks/peers-constraints.txt",
    "scripts/site-constraints.txt",
    "tests/cluster-constraints.txt",
    "tests/dev-constraints.txt",
)
CONSTRAINTS = [ROOT / "constraints.txt", *(ROOT / name for name in MORE_CONSTRAINTS)]


@pytest.mark.parametrize("path", CONSTRAINTS, ids=lambda path: path.name)
def test_constraints_pin_versions_and_hashes_without_addresses(path: Path) -> None:
    """One package a line, each with a hash at least; `scripts/hashes.py` fills them in."""
    pinned = path.read_text(encoding="utf-8").splitlines()
    assert pinned
    good = re.compile(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.]+( --hash=sha256:[0-9a-f]{64})+")
    assert [line[:60] for line in pinned if not good.fullmatch(line)] == []


def required(requirements: Iterable[str], extras: Iterable[str] = ("",)) -> set[str]:
    """The packages that are required on this machine, with these extras."""
    found = map(Requirement, requirements)
    kept = [
        one
        for one in found
        if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in extras)
    ]
    return {canonicalize_name(one.name) for one in kept}


def pinned_in(*files: str) -> set[str]:
    """The packages that these files of constraints pin."""
    lines = [line for file in files for line in (ROOT / file).read_text("utf-8").splitlines()]
    return {canonicalize_name(line.partition("==")[0]) for line in lines}


def test_constraints_hold_everything_that_is_needed() -> None:
    """They are installed without following dependencies: what the packages of this machine ask for
    must be among them.

    TrackEval comes without its own, which would put OpenCV 5 over OpenCV 4.
    """
    pinned = pinned_in("constraints.txt", "tests/dev-constraints.txt")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = required(project["project"]["dependencies"])
    wanted |= required(project["build-system"]["requires"])
    # Of the extras paho-mqtt and Ray are not here: one has a stand-in, the other has constraints of
    # its own.
    for extra in project["project"]["optional-dependencies"].values():
        wanted |= required(extra) - {"phdtrack", "paho-mqtt", "ray"}
    for name in pinned - {"trackeval", "colorama"}:
        wanted |= required(metadata.requires(name) or ())
    assert wanted - pinned == set()


def test_demo_waits_for_what_it_needs_and_no_more() -> None:
    """`make demo` installs constraints.txt alone: tracking, report, pages, and the build backend.

    Colorama is for Windows, and editables for an installation that follows the sources.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"]
    wanted = required(project["project"]["dependencies"]) | {"colorama", "editables"}
    wanted |= required(project["build-system"]["requires"])
    for name in ("opencv", "video", "report", "web"):
        wanted |= required(extras[name])
    waiting = wanted - {"colorama"}
    while waiting:
        more = required(metadata.requires(waiting.pop()) or ()) - wanted
        wanted |= more
        waiting |= more
    assert pinned_in("constraints.txt") == wanted
