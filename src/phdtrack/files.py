"""Files that a user names, with helpful errors; atomic writing; lazy modules; values for JSON."""

from __future__ import annotations

import codecs
import csv
import ctypes
import errno
import io
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from phdtrack.errors import InputError

AnyPath = str | os.PathLike[str]

# The usual files in the folder of a sequence of a benchmark.
_USUAL = ("gt/gt.txt", "det/det.txt", "gt.txt", "det.txt", "tracks.csv", "detections.csv")

# Suffix of a file that is not complete.
PART = ".part"

# Largest file that is read whole, in bytes, unless this variable of the environment sets it.
SIZE_LIMIT = "PHDTRACK_MAX_FILE_SIZE"
MAX_SIZE = 4_000_000_000
# A whole number with more digits than any float.
_LONG_NUMBER = re.compile(rb"\d[\d_]{299}|0x[\da-fA-F_]{250}")
# A name of a hundred parts in TOML, whose parser takes minutes for ten thousand.
_LONG_NAME = re.compile(rb"(?<![\w\"'-])(?:[\w\"'-]++\s*+\.\s*+){100}")
# Bytes that are no UTF-8, and a comment at the end of a line without quotes.
_NO_TEXT = re.compile(r"[\udc80-\udcff]")
_NO_BYTE = re.compile(r"[\ud800-\udc7f\udd00-\udfff]")
_COMMENT = re.compile(r"#[^\n\"']*$", re.MULTILINE)
# Depth of nested elements: each one knows those around it.
_DEEPEST = 100
# Parameters of mallopt: the number of heaps, and the size in bytes from which memory comes from the
# system and goes back to it. By default that size grows to the largest block that was freed, and
# then pictures lie between small blocks and are never returned.
_M_ARENA_MAX = -8
_M_MMAP_THRESHOLD = -3
_LARGE = 4_000_000


def readable_name(text: str) -> str:
    """The text with the bytes of names that Python could not decode, for output: as characters if
    they are UTF-8, as replacement characters otherwise.
    """
    bytes_ = _NO_BYTE.sub("\N{REPLACEMENT CHARACTER}", text).encode("utf-8", "surrogateescape")
    return bytes_.decode("utf-8", "replace")


def ffmpeg_name(path: AnyPath) -> str:
    """The name by which FFmpeg opens a file: without ``file:``, ``a:b.mp4`` would be an address."""
    return f"file:{os.fspath(path)}"


def part_of(path: Path) -> Path:
    """The name of the file while it grows: beside it, with the suffix ``.part``."""
    return path.with_name(path.name + PART)


def refuse_part(path: AnyPath) -> None:
    """Raise `InputError` if the name shows that the file is not complete."""
    if str(path).endswith(PART):
        cure = (
            "Wait until the run that writes it has ended; if it was killed, run it again with"
            " --resume."
        )
        raise InputError("this file is not complete", where=Path(path), cure=cure)


def publish(path: Path) -> None:
    """Flush a file that grew in `part_of` to disk and give it its name. Raises ``OSError`` if that
    fails.
    """
    with part_of(path).open("rb+") as file:
        os.fsync(file.fileno())
    part_of(path).replace(path)
    if os.name == "posix":
        # The new name must survive a power cut, too.
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def cannot_write(path: AnyPath, error: Any) -> InputError:
    """The error of a file that cannot be written; ``error`` is an ``OSError``, or FFmpeg's."""
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
    """A context that writes a file atomically: it gets its name when it is complete.

    Yields the path to write to, beside the file. When the block ends the file is flushed to disk
    and gets its name; after an error there is no new file, and an old one is unchanged. Raises
    `InputError` if it cannot be written, or is a device, a pipe or a folder, which are not
    replaced.
    """
    part = part_of(path)
    try:
        # Names under /dev and /proc are no files, such as /dev/stdout.
        folder = path.parent.resolve().parts
        special = folder == ("/", "dev") or folder[:2] == ("/", "proc")
        if special or (path.exists() and not path.is_file()):
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
    """Write UTF-8 atomically, and make the folder. Raises `InputError` if that fails."""
    with whole(path) as part:
        # File names may contain bytes that are no text; JSON escapes them in the same way.
        part.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Rows as CSV, the first of them the header."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def load(path: AnyPath) -> bytes:
    """The bytes of the file. Raises `InputError` if there is none, it is a folder, not complete,
    too large, or cannot be read.
    """
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
        raise InputError("expected a file, got a folder", where=path, cure=_inside(path)) from None
    except OSError as error:
        raise InputError(
            f"the file cannot be read: {error.strerror or error}", where=path
        ) from None


def _check_size(path: AnyPath, size: int) -> None:
    """Raise `InputError` if a file is too large to be read whole."""
    limit = os.environ.get(SIZE_LIMIT, str(MAX_SIZE))
    if not limit.isdecimal() or len(limit) > 18:
        raise InputError(f"expected a number of bytes, got {limit[:40]!r}", where=SIZE_LIMIT)
    if size > int(limit):
        problem = f"expected a file of at most {int(limit):,} bytes, got {size:,}"
        raise InputError(
            problem, where=Path(path), cure="Is it the right file? If so, say --max-file-size SIZE."
        )


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; `InputError` if it cannot be read or is no TOML."""
    return parse_toml(path, load(path))


def parse_toml(path: Path, content: bytes) -> dict[str, Any]:
    """The tables in TOML; `InputError` names the line of the first error."""
    import tomllib

    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        # Written by the redirection of PowerShell.
        content = content.decode("utf-16", "replace").encode()
    _refuse_long_numbers(path, content)
    if match := _LONG_NAME.search(content):
        raise InputError(
            "expected a name, got one of a hundred parts", where=_line_of(path, content, match)
        )
    try:
        return tomllib.loads(_toml_text(content))
    except UnicodeDecodeError:
        raise InputError("expected a TOML file, got bytes that are no text", where=path) from None
    except RecursionError:
        raise InputError("expected TOML, got brackets nested without end", where=path) from None
    except ValueError as error:
        # The message of tomllib ends with the position.
        reason, _, position = str(error).partition(" (at ")
        line = content.rstrip().count(b"\n") + 1
        if number := re.match(r"line (\d+)", position):
            line = int(number[1])
        raise InputError(f"not TOML: {reason}", where=f"{path}, line {line}") from None


def _toml_text(content: bytes) -> str:
    """The text of a TOML file. Comments may be in any encoding, as those that `phdtrack settings`
    prints on a terminal that is not UTF-8. Raises ``UnicodeDecodeError`` for other bytes.
    """
    text = content.decode("utf-8-sig", "surrogateescape")
    if _NO_TEXT.search(_COMMENT.sub("", text)):
        return content.decode("utf-8-sig")
    return text


def _refuse_long_numbers(path: Path, content: bytes) -> None:
    """Raise `InputError` for a whole number of hundreds of digits, which is never valid and breaks
    parsers.
    """
    if match := _LONG_NUMBER.search(content):
        raise InputError(
            "expected numbers, got one of hundreds of digits", where=_line_of(path, content, match)
        )


def _line_of(path: Path, content: bytes, match: re.Match[bytes]) -> str:
    """The location of a match in a file, for error messages."""
    line = content.count(b"\n", 0, match.start()) + 1
    return f"{path}, line {line}"


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
    """A hint that names the deepest existing folder of ``path``, which shows the wrong part of the
    name.
    """
    folder = next((p for p in path.absolute().parents if p.is_dir()), Path("/"))
    if folder == path.absolute().parent:
        return ""
    return f"The last folder on the way that exists is {folder}."


def _inside(path: Path) -> str:
    """A hint that names the usual files in a folder."""
    usual = [str(path / name) for name in _USUAL if (path / name).is_file()]
    if usual:
        return f"Perhaps {' or '.join(usual)} is meant."
    return "Name the file in it."


def json_value(value: object) -> Any:
    """``value`` in the types of JSON: NaN becomes None, other types their text; fields with
    ``repr=False`` are left out.
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
    """The content of a JSON file; `InputError` names the line of the first error."""
    import json

    _refuse_long_numbers(path, content)
    try:
        return json.loads(content)
    except UnicodeDecodeError:
        raise InputError("expected JSON, got bytes that are no UTF-8 text", where=path) from None
    except json.JSONDecodeError as error:
        where = f"{path}, line {error.lineno}"
        raise InputError(
            f"expected JSON, which breaks here: {error.msg}", where=where, cure="Is it complete?"
        ) from None
    except RecursionError:
        raise InputError("expected JSON, got brackets nested without end", where=path) from None


@dataclass(frozen=True, slots=True)
class Element:
    """An element of an XML file: its name, its attributes, its line, the elements around it,
    outermost first, and the parts of its own text."""

    name: str
    attributes: Mapping[str, str]
    path: Path
    line: int
    around: tuple[Element, ...]
    text: list[str] = field(default_factory=list)

    @property
    def where(self) -> str:
        """Its location for error messages."""
        return f"{self.path}, line {self.line}"

    def number(self, *names: str) -> float:
        """The value of the first of these attributes that exists; `InputError` if there is none,
        or it is no number.
        """
        name = next((name for name in names if name in self.attributes), "")
        problem = f"expected <{self.name}> with a value for {' or '.join(names)}, got one without"
        if name:
            problem = (
                f"expected a finite number for {name} of <{self.name}>, got"
                f" '{self.attributes[name]}'"
            )
            with suppress(ValueError):
                value = float(self.attributes[name])
                if math.isfinite(value):
                    return value
        raise InputError(problem, where=self.where)


def read_xml(path: Path, content: bytes) -> list[Element]:
    """The elements of an XML file in the order in which they begin.

    Document types and entities are refused, because they let a small file expand without bound.
    `InputError` names the line, also if the file is not well-formed.
    """
    from xml.parsers import expat

    parser = expat.ParserCreate()
    elements = list[Element]()
    open_ = list[Element]()

    def start(name: str, attributes: dict[str, str]) -> None:
        if len(open_) >= _DEEPEST:
            where = f"{path}, line {parser.CurrentLineNumber}"
            raise InputError(
                f"expected XML of at most {_DEEPEST} elements within each other", where=where
            )
        elements.append(Element(name, attributes, path, parser.CurrentLineNumber, tuple(open_)))
        open_.append(elements[-1])

    def refuse(*_: object) -> None:
        problem = "expected XML without a document type and entities, got a declaration of one"
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
        raise InputError(f"expected XML in UTF-8, got {error}", where=f"{path}, line 1") from None
    return elements


def return_memory() -> None:
    """Return freed memory to the system, and let threads share two heaps: glibc has up to eight for
    each core, and keeps the pictures that were freed in each.
    """
    if sys.platform != "linux":
        return
    library = ctypes.CDLL(None)
    if getattr(library, "malloc_trim", None) is not None:
        library.mallopt(_M_ARENA_MAX, 2)
        library.mallopt(_M_MMAP_THRESHOLD, _LARGE)
        library.malloc_trim(0)
