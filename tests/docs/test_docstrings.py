"""Docstrings of the public names say what goes in, what comes out and what is raised."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol

SOURCES = Path(__file__).resolve().parents[2] / "src" / "phdtrack"
# Their names are listed for the rest of the package; a user never calls them.
INTERNAL = {"state", "input_checks"}
# Their protocols describe the parameters of the methods that implement them.
PROTOCOLS = ("protocols", "devices", "detect.base")
ENTRY = re.compile(r"^ *(\*{0,2}\w[\w, *]*?) : (.*(?:\n +\S.*)*)", re.MULTILINE)
# The names of array types in annotations, and a shape: (N, 4), (d, L), (3,).
ARRAYS = re.compile(r"\b(F8|F4|I8|Real|Bool|Image|Matrix|Vector|SupportsArray)\b")
SHAPE = re.compile(r"\([\w+ /]+,[^)]*\)")


def document(part: Any) -> str:
    return inspect.cleandoc(part.__doc__ or "")


def has_section(text: str, title: str) -> bool:
    return f"{title}\n{'-' * len(title)}\n" in f"{text}\n"


def entries(text: str) -> dict[str, str]:
    """What each name of the sections means."""
    # Two short entries may share a line.
    text = re.sub(r"\.      (?=\w+ : )", ".\n", text)
    return {
        name.strip(" *"): meaning
        for names, meaning in ENTRY.findall(text)
        for name in names.split(",")
    }


@cache
def public() -> dict[str, Any]:
    """Classes and functions in the lists `__all__`, and the protocols, each by one name."""
    found: dict[int, tuple[str, Any]] = {}
    packages = [path.parent.name for path in sorted(SOURCES.glob("*/__init__.py"))]
    for module in ["phdtrack", *(f"phdtrack.{one}" for one in packages if one not in INTERNAL)]:
        for name in getattr(resolve_name(module), "__all__", ()):
            part = getattr(resolve_name(module), name)
            found.setdefault(id(part), (f"{module}.{name}", part))
    for protocol in protocols():
        found.setdefault(id(protocol), (f"{protocol.__module__}.{protocol.__name__}", protocol))
    return {
        name: part
        for name, part in found.values()
        if inspect.isfunction(part) or inspect.isclass(part)
    }


def is_protocol(part: Any) -> bool:
    return inspect.isclass(part) and Protocol in part.__bases__


@cache
def protocols() -> list[type]:
    modules = [resolve_name(f"phdtrack.{name}") for name in PROTOCOLS]
    return [
        one
        for module in modules
        for one in vars(module).values()
        if is_protocol(one) and one.__module__ == module.__name__
    ]


def functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    yield from ((name, part) for name, part in public().items() if inspect.isfunction(part))


def classes() -> Iterator[tuple[str, type]]:
    yield from ((name, part) for name, part in public().items() if inspect.isclass(part))


def methods(owner: type) -> Iterator[tuple[str, Callable[..., Any]]]:
    for name, member in vars(owner).items():
        method = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if inspect.isfunction(method) and (name == "__call__" or not name.startswith("_")):
            yield name, method


def parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    listed = inspect.signature(function).parameters.values()
    return [each for each in listed if each.name not in ("self", "cls")]


def of_classes(owner: type) -> dict[str, str]:
    """The entries of a class and of those that it extends."""
    found: dict[str, str] = {}
    for one in reversed(owner.__mro__[:-1]):
        found |= entries(document(one))
    return found


def of_protocols(method: str) -> dict[str, str]:
    """The entries of protocols that have a method of this name, and its own there."""
    found: dict[str, str] = {}
    for protocol in protocols():
        if method in vars(protocol):
            found |= entries(document(protocol)) | entries(document(vars(protocol)[method]))
    return found


def is_named(name: str, text: str) -> bool:
    return re.search(rf"``[^`]*\b{name}\b[^`]*``", text) is not None


def raises(function: Callable[..., Any]) -> bool:
    """Tell whether a function itself raises an error, not one that it passes on."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    return any(isinstance(node, ast.Raise) and node.exc for node in ast.walk(tree))


def test_public_names_are_found() -> None:
    assert len(list(functions())) > 50
    assert {"phdtrack.Tracker", "phdtrack.filters.PMBM"} <= {name for name, _ in classes()}


def test_functions_describe_every_parameter() -> None:
    missing = {}
    for name, function in functions():
        known = set()
        if has_section(document(function), "Parameters"):
            known = set(entries(document(function)))
        missing[name] = [each.name for each in parameters(function) if each.name not in known]
    assert {name: which for name, which in missing.items() if which} == {}


def test_functions_say_what_they_return() -> None:
    nothing = (None, "None")
    assert [
        name
        for name, function in functions()
        if inspect.signature(function).return_annotation not in nothing
        and not has_section(document(function), "Returns")
    ] == []


def test_functions_and_methods_say_what_they_raise() -> None:
    every = [*functions()]
    every += [(f"{name}.{one}", part) for name, owner in classes() for one, part in methods(owner)]
    assert [
        name
        for name, function in every
        if raises(function) and not re.search("Raises|`InputError`", document(function))
    ] == []


def test_classes_describe_their_fields() -> None:
    """Those of a record, or the parameters of the constructor."""
    missing = {}
    for name, owner in classes():
        if is_dataclass(owner):
            names = [field.name for field in fields(owner) if not field.name.startswith("_")]
        elif issubclass(owner, tuple):
            names = list(owner._fields)
        elif "__init__" in vars(owner) and not is_protocol(owner):
            names = [each.name for each in parameters(owner.__init__)]
        else:
            names = []
        text = "\n".join(document(one) for one in owner.__mro__[:-1])
        known = of_classes(owner)
        missing[name] = [one for one in names if one not in known and not is_named(one, text)]
    assert {name: which for name, which in missing.items() if which} == {}


def test_methods_describe_their_parameters() -> None:
    """In their own docstring, in that of the class, or in that of a protocol."""
    missing = {}
    for name, owner in classes():
        for one, method in methods(owner):
            text = document(method)
            known = {**of_protocols(one), **of_classes(owner), **entries(text)}
            names = [each.name for each in parameters(method)]
            missing[f"{name}.{one}"] = [
                each for each in names if each not in known and not is_named(each, text)
            ]
    assert {name: which for name, which in missing.items() if which} == {}


def test_parameters_that_are_arrays_have_a_shape() -> None:
    missing = []
    for name, function in functions():
        known = entries(document(function))
        missing += [
            f"{name}, {each.name}"
            for each in parameters(function)
            if ARRAYS.search(str(each.annotation)) and not SHAPE.search(known[each.name])
        ]
    for name, owner in classes():
        for one, method in methods(owner):
            known = {**of_protocols(one), **of_classes(owner), **entries(document(method))}
            missing += [
                f"{name}.{one}, {each.name}"
                for each in parameters(method)
                if ARRAYS.search(str(each.annotation))
                and not SHAPE.search(known.get(each.name, document(method)))
            ]
    assert missing == []
