"""seqinfo.ini: MOTChallenge's description of a sequence, stored beside the folders ``gt`` and
``det``.
"""

from __future__ import annotations

import configparser
import re
from pathlib import Path

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.types import SequenceInfo

_NAME = "seqinfo.ini"


def find_seqinfo(path: AnyPath) -> SequenceInfo | None:
    """The description of the sequence that a file of detections or truth, or a folder, belongs to.

    Searches for ``seqinfo.ini`` beside the file and one folder up (``seq/det/det.txt``); None if
    there is none. Raises `InputError` if the file found is malformed.

    Parameters
    ----------
    path : a file of detections or truth, or a folder.

    Returns
    -------
    Size in pixels, rate in Hz, number of frames and name.
    """
    path = Path(path).absolute()
    folder = path if path.is_dir() else path.parent
    for candidate in (folder / _NAME, folder.parent / _NAME):
        if candidate.is_file():
            return read_seqinfo(candidate)
    return None


def read_seqinfo(path: AnyPath) -> SequenceInfo:
    """Image size in pixels, frame rate in Hz, number of frames (0 if not given) and name, from
    ``seqinfo.ini`` or the folder that holds it.

    Raises `InputError` if there is no such file, it is malformed, or size or frame rate are missing
    or not above 0.

    Parameters
    ----------
    path : ``seqinfo.ini``, or the folder that holds it.

    Returns
    -------
    The description.
    """
    path = Path(path)
    if path.is_dir():
        path = path / _NAME
    ini = configparser.ConfigParser(interpolation=None)
    try:
        text = load(path).decode("utf-8-sig")
        ini.read_string(text)
    except UnicodeDecodeError:
        raise InputError("expected UTF-8 text, got other bytes", where=path) from None
    except configparser.Error as error:
        line = re.search(r"line[: ]+(\d+)", str(error))
        where = f"{path}, line {line[1]}" if line else path
        reason = str(error.message).splitlines()[0]
        raise InputError(
            f"expected lines such as frameRate=25 under [Sequence], got: {reason}", where=where
        ) from None
    if not ini.has_section("Sequence"):
        raise InputError(
            "expected a section [Sequence], got none",
            where=path,
            cure="Put [Sequence] in the first line.",
        )
    section = ini["Sequence"]
    return SequenceInfo(
        width=int(_number(path, text, section, "imWidth")),
        height=int(_number(path, text, section, "imHeight")),
        fps=_number(path, text, section, "frameRate", "number"),
        frames=int(_number(path, text, section, "seqLength")) if "seqLength" in section else 0,
        name=section.get("name", "").strip() or path.absolute().parent.name,
    )


def _number(
    path: Path,
    text: str,
    section: configparser.SectionProxy,
    key: str,
    kind: str = "whole number",
) -> float:
    """The value of ``key``, which must be above 0 and of this ``kind``."""
    if key not in section:
        raise InputError(
            f"expected a value for {key}, got none",
            where=path,
            cure=f"Add a line {key}=… under [Sequence].",
        )
    try:
        value = float(section[key])
    except ValueError:
        value = 0.0
    if 0 < value < 1e9 and (kind == "number" or value.is_integer()):
        return value
    keys = [re.split("[=:]", line)[0].strip().lower() for line in text.splitlines()]
    raise InputError(
        f"expected a {kind} above 0 for {key}, got '{section[key]}'",
        where=f"{path}, line {keys.index(key.lower()) + 1}",
    )
