"""seqinfo.ini: what MOTChallenge says about a sequence. It stands beside the folders ``gt`` and ``det``."""

from __future__ import annotations

import configparser
import re
from pathlib import Path

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.types import SequenceInfo

_NAME = "seqinfo.ini"


def find_seqinfo(path: AnyPath) -> SequenceInfo | None:
    """What is known about the sequence of a file of detections or truth, or of a folder.

    The file ``seqinfo.ini`` is looked for beside it and one folder up (``seq/det/det.txt``); None where there is none.

    Raises
    ------
    InputError : there is one, and it is malformed.
    """
    path = Path(path).absolute()
    folder = path if path.is_dir() else path.parent
    found = next((place / _NAME for place in (folder, folder.parent) if (place / _NAME).is_file()), None)
    return None if found is None else read_seqinfo(found)


def read_seqinfo(path: AnyPath) -> SequenceInfo:
    """Size in pixels, frame rate in Hz, number of frames (0 where not told) and name, from the file or the folder it is in.

    Raises
    ------
    InputError : there is no such file, it is malformed, or size or frame rate are missing or not above 0.
    """
    path = Path(path)
    path = path / _NAME if path.is_dir() else path
    text = _decode(path)
    ini = configparser.ConfigParser(interpolation=None)
    try:
        ini.read_string(text)
    except configparser.Error as error:
        line = _line_of(error)
        where = f"{path}, line {line}" if line else path
        reason = str(error.message).splitlines()[0]
        raise InputError(f"expected lines such as frameRate=25 under [Sequence], came: {reason}", where=where) from None
    if not ini.has_section("Sequence"):
        raise InputError("expected a section [Sequence], came none", where=path, cure="Put [Sequence] in the first line.")
    section = ini["Sequence"]
    frames = int(_number(path, text, section, "seqLength", whole=True)) if "seqLength" in section else 0
    return SequenceInfo(
        width=int(_number(path, text, section, "imWidth", whole=True)),
        height=int(_number(path, text, section, "imHeight", whole=True)),
        fps=_number(path, text, section, "frameRate", whole=False),
        frames=frames,
        name=section.get("name", "").strip() or path.absolute().parent.name,
    )


def _decode(path: Path) -> str:
    try:
        return load(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError("expected UTF-8 text, came other bytes", where=path) from None


def _line_of(error: configparser.Error) -> int:
    """The 1-based line of a syntax error; 0 where it is not told."""
    if isinstance(error, configparser.MissingSectionHeaderError):
        return int(error.lineno)
    if isinstance(error, configparser.ParsingError) and error.errors:
        return int(error.errors[0][0])
    if isinstance(error, configparser.DuplicateOptionError | configparser.DuplicateSectionError):
        return int(error.lineno or 0)
    return 0


def _number(path: Path, text: str, section: configparser.SectionProxy, key: str, *, whole: bool) -> float:
    if key not in section:
        raise InputError(f"expected a value for {key}, came none", where=path, cure=f"Add a line {key}=… under [Sequence].")
    wanted = "a whole number above 0" if whole else "a number above 0"
    try:
        value = float(section[key])
    except ValueError:
        value = float("nan")
    if not 0 < value < 1e9 or (whole and value != int(value)):
        lines = text.splitlines()
        line = next((i for i, t in enumerate(lines, 1) if re.match(rf"\s*{key}\s*[=:]", t, re.IGNORECASE)), 1)
        raise InputError(f"expected {wanted} for {key}, came '{section[key]}'", where=f"{path}, line {line}")
    return value
