"""Files that a user named, with errors that say what is wrong, and files that are whole or not
there; modules that are loaded when they are first used; values for JSON."""

from __future__ import annotations

import ctypes
import errno
import math
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from phdtrack.errors import InputError

AnyPath = str | os.PathLike[str]

# Where benchmarks put the file that is meant when the folder of a sequence is named.
_USUAL = ("gt/gt.txt", "det/det.txt", "gt.txt", "det.txt", "tracks.csv", "detections.csv")

# What the name of a file ends in as long as it is not complete.
PART = ".part"

# Bytes of a file that is read whole, where this variable of the environment does not say otherwise.
SIZE_LIMIT = "PHDTRACK_MAX_FILE_SIZE"
MAX_SIZE = 4_000_000_000
# Digits of a whole number: it is none that a float has.
_LONG_NUMBER = re.compile(rb"\d[\d_]{299}|0x[\da-fA-F_]{250}")
# A name of a hundred parts in TOML, whose parser takes minutes for ten thousand.
_LONG_NAME = re.compile(rb"(?<![\w\"'-])(?:[\w\"'-]++\s*+\.\s*+){100}")
# Elements within each other: each one knows those around it.
_DEEPEST = 100
# Parameters of mallopt: the number of heaps, and from how many bytes on memory comes from the
# system and goes back to it. Of itself that grows to the largest that was freed, and then pictures
# lie between small things and are never given back.
_M_ARENA_MAX = -8
_M_MMAP_THRESHOLD = -3
_LARGE = 4_000_000


def part_of(path: Path) -> Path:
    """Where the file is as long as it grows: beside it, under a name that ends in ``.part``."""
    return path.with_name(path.name + PART)


def refuse_part(path: AnyPath) -> None:
    """Raise `InputError` where the name says that the file is not complete."""
    if str(path).endswith(PART):
        cure = (
            "Wait until the run that writes it has ended; if it was killed, run it again with"
            " --resume."
        )
        raise InputError("this file is not complete", where=Path(path), cure=cure)


def publish(path: Path) -> None:
    """Give a file that grew in `part_of` its name, when it is on disk. Raises ``OSError`` where
    that fails.
    """
    with part_of(path).open("rb+") as file:
        os.fsync(file.fileno())
    part_of(path).replace(path)
    if os.name == "posix":
        # The new name, too, is to outlast a power cut.
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def cannot_write(path: AnyPath, error: Any) -> InputError:
    """The error of a file that cannot be written, in a sentence; ``error`` is an ``OSError``, or
    FFmpeg's.
    """
    cure = "Choose another place for the output."
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        cure = "Free some space; a run goes on with --resume."
    elif error.errno == errno.ENOENT:
        cure = "Was the folder removed meanwhile?"
    return InputError(
        f"the file cannot be written: {error.strerror or error}", where=Path(path), cure=cure
    )


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A file that has its name when it is complete, and not before.

    Gives the path to write to, which lies beside it. When the block is left the file is flushed to
    disk and gets its name; after an error there is no new file, and one that was there before is as
    it was. Raises `InputError` where it cannot be written, or is a device, a pipe or a folder,
    which are not replaced.
    """
    part = part_of(path)
    try:
        # Under /dev and /proc a name stands for something else, as /dev/stdout does.
        folder = path.parent.resolve().parts
        if (
            folder == ("/", "dev")
            or folder[:2] == ("/", "proc")
            or (path.exists() and not path.is_file())
        ):
            raise InputError(
                "expected the name of a file, and this is none", where=path, cure="Choose another."
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        publish(path)
    except BaseException as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise cannot_write(path, error) from error
        raise


def write_text(path: Path, text: str) -> None:
    """Write UTF-8, whole or not at all, and make the folder. Raises `InputError` where that cannot
    be done.
    """
    with whole(path) as part:
        # File names may hold bytes that are no text; their escape is also how JSON spells them.
        part.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def load(path: AnyPath) -> bytes:
    """The bytes of the file. Raises `InputError` where there is none, it is a folder, not complete,
    too large, or may not be read."""
    path = Path(path)
    refuse_part(path)
    if "\0" in str(path):
        raise InputError(
            "expected the name of a file, which has no NUL in it", where=repr(str(path))
        )
    try:
        with path.open("rb") as file:
            _check_size(path, os.fstat(file.fileno()).st_size)
            return file.read()
    except FileNotFoundError:
        raise InputError("there is no such file", where=path, cure=_nearest(path)) from None
    except IsADirectoryError:
        raise InputError("expected a file, came a folder", where=path, cure=_inside(path)) from None
    except OSError as error:
        raise InputError(
            f"the file cannot be read: {error.strerror or error}", where=path
        ) from None


def _check_size(path: AnyPath, size: int) -> None:
    """Raise `InputError` where a file is larger than is read whole."""
    given = os.environ.get(SIZE_LIMIT, str(MAX_SIZE))
    if not given.isdecimal() or len(given) > 18:
        raise InputError(f"expected a number of bytes, came {given[:40]!r}", where=SIZE_LIMIT)
    if size > int(given):
        problem = f"expected a file of at most {int(given):,} bytes, came {size:,}"
        raise InputError(
            problem, where=Path(path), cure="Is it the right file? If so, say --max-file-size SIZE."
        )


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; `InputError` where it cannot be read, or is none."""
    return parse_toml(path, load(path))


def parse_toml(path: Path, content: bytes) -> dict[str, Any]:
    """The tables in TOML; `InputError` names the line where it is none."""
    import tomllib

    _refuse_long_numbers(path, content)
    if found := _LONG_NAME.search(content):
        line = content.count(b"\n", 0, found.start()) + 1
        raise InputError(
            "expected a name, came one of a hundred parts", where=f"{path}, line {line}"
        )
    try:
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise InputError("expected a TOML file, got bytes that are no text", where=path) from None
    except RecursionError:
        raise InputError("expected TOML, came brackets nested without end", where=path) from None
    except ValueError as error:
        # Its own words end in the place.
        reason, _, place = str(error).partition(" (at ")
        number = re.match(r"line (\d+)", place)
        if number:
            line = int(number[1])
        else:
            line = content.rstrip().count(b"\n") + 1
        raise InputError(f"not TOML: {reason}", where=f"{path}, line {line}") from None


def _refuse_long_numbers(path: Path, content: bytes) -> None:
    """Raise `InputError` for a whole number of hundreds of digits, which has its place nowhere, and
    breaks what reads it.
    """
    if found := _LONG_NUMBER.search(content):
        line = content.count(b"\n", 0, found.start()) + 1
        raise InputError(
            "expected numbers, came one of hundreds of digits", where=f"{path}, line {line}"
        )


def lazy(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package whose names are loaded when they are first used.

    Parameters
    ----------
    package : its ``__name__``.
    homes : the module that defines each public name.
    """

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes[name]), name)

    return load, lambda: sorted(homes)


def _nearest(path: Path) -> str:
    """The deepest folder of ``path`` that does exist: it shows which part of the name is wrong."""
    folder = next((p for p in path.absolute().parents if p.is_dir()), Path("/"))
    if folder == path.absolute().parent:
        return ""
    return f"The last folder on the way that exists is {folder}."


def _inside(path: Path) -> str:
    found = [str(path / name) for name in _USUAL if (path / name).is_file()]
    if found:
        return f"Perhaps {' or '.join(found)} is meant."
    return "Name the file in it."


def json_value(value: object) -> Any:
    """``value`` in the types that JSON knows: NaN is None, what is unknown its text; ``repr=False``
    leaves fields out.
    """
    match value:
        case None | bool() | str() | int():
            return value
        case float():
            if math.isfinite(value):
                return float(value)
            return None
        case Mapping():
            return {str(k): json_value(v) for k, v in value.items()}
        case list() | tuple() | set() | frozenset():
            return [json_value(v) for v in value]
        case _ if is_dataclass(value) and not isinstance(value, type):
            return {f.name: json_value(getattr(value, f.name)) for f in fields(value) if f.repr}
        case _:
            import numpy as np

            if isinstance(value, np.generic | np.ndarray):
                return json_value(value.tolist())
            return str(value)


def read_json(path: Path, content: bytes) -> Any:
    """What a JSON file holds; `InputError` names the line where it is none."""
    import json

    _refuse_long_numbers(path, content)
    try:
        return json.loads(content)
    except UnicodeDecodeError:
        raise InputError("expected JSON, came bytes that are no UTF-8 text", where=path) from None
    except json.JSONDecodeError as error:
        where = f"{path}, line {error.lineno}"
        raise InputError(
            f"expected JSON, which breaks here: {error.msg}", where=where, cure="Is it complete?"
        ) from None
    except RecursionError:
        raise InputError("expected JSON, came brackets nested without end", where=path) from None


@dataclass(frozen=True, slots=True)
class Element:
    """An element of an XML file: its name, its attributes, where it stands, and the elements around
    it, outermost first; the parts of the text that it holds itself."""

    name: str
    attributes: Mapping[str, str]
    path: Path
    line: int
    around: tuple[Element, ...]
    text: list[str] = field(default_factory=list)

    @property
    def where(self) -> str:
        """Its place in words."""
        return f"{self.path}, line {self.line}"

    def number(self, *names: str) -> float:
        """The value of the first of these attributes that there is; `InputError` where there is
        none, or it is no number.
        """
        name = next((name for name in names if name in self.attributes), "")
        problem = f"expected <{self.name}> with a value for {' or '.join(names)}, came one without"
        if name:
            problem = (
                f"expected a finite number for {name} of <{self.name}>, came"
                f" '{self.attributes[name]}'"
            )
            with suppress(ValueError):
                value = float(self.attributes[name])
                if math.isfinite(value):
                    return value
        raise InputError(problem, where=self.where)


def read_xml(path: Path, content: bytes) -> list[Element]:
    """The elements of an XML file in the order in which they begin.

    A document type or an entity is refused, because that is how a small file is made to expand
    without bound. `InputError` names the line, also where the file is not well-formed.
    """
    from xml.parsers import expat

    parser = expat.ParserCreate()
    found = list[Element]()
    open_ = list[Element]()

    def start(name: str, attributes: dict[str, str]) -> None:
        if len(open_) >= _DEEPEST:
            where = f"{path}, line {parser.CurrentLineNumber}"
            raise InputError(
                f"expected XML of at most {_DEEPEST} elements within each other", where=where
            )
        found.append(Element(name, attributes, path, parser.CurrentLineNumber, tuple(open_)))
        open_.append(found[-1])

    def refuse(*_: object) -> None:
        problem = "expected XML without a document type and entities, came a declaration of one"
        cure = "Remove the <!DOCTYPE …> from the file."
        raise InputError(problem, where=f"{path}, line {parser.CurrentLineNumber}", cure=cure)

    def read(text: str) -> None:
        if not text.isspace():
            open_[-1].text.append(text)

    parser.StartElementHandler = start
    parser.CharacterDataHandler = read
    parser.EndElementHandler = lambda name: open_.pop()
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        where = f"{path}, line {error.lineno}"
        raise InputError(
            f"expected XML, which breaks here: {reason}", where=where, cure="Is it complete?"
        ) from None
    except (LookupError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"expected XML in UTF-8, came {error}", where=f"{path}, line 1") from None
    return found


def return_memory() -> None:
    """Give memory that was freed back to the system, and let threads share two heaps: glibc has up
    to eight for each core, and keeps in each the pictures that were freed there."""
    if sys.platform == "linux":
        library = ctypes.CDLL(None)
    else:
        library = None
    if library is not None and getattr(library, "malloc_trim", None) is not None:
        library.mallopt(_M_ARENA_MAX, 2)
        library.mallopt(_M_MMAP_THRESHOLD, _LARGE)
        library.malloc_trim(0)
