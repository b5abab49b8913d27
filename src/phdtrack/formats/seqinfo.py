"""seqinfo.ini: what MOTChallenge says about a sequence. It stands beside the folders ``gt`` and
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
    """What is known about the sequence of a file of detections or truth, or of a folder.

    The file ``seqinfo.ini`` is looked for beside it and one folder up (``seq/det/det.txt``); None
    where there is none. Raises `InputError` where there is one, and it is malformed.
    """
    path = Path(path).absolute()
    if path.is_dir():
        folder = path
    else:
        folder = path.parent
    found = next(
        (place / _NAME for place in (folder, folder.parent) if (place / _NAME).is_file()), None
    )
    if found is None:
        return None
    return read_seqinfo(found)


def read_seqinfo(path: AnyPath) -> SequenceInfo:
    """Size in pixels, frame rate in Hz, number of frames (0 where not given) and name, from the
    file or its folder.

    Raises `InputError` where there is no such file, it is malformed, or size or frame rate are
    missing or not above 0.
    """
    path = Path(path)
    if path.is_dir():
        path = path / _NAME
    else:
        path = path
    ini = configparser.ConfigParser(interpolation=None)
    try:
        text = load(path).decode("utf-8-sig")
        ini.read_string(text)
    except UnicodeDecodeError:
        raise InputError("expected UTF-8 text, came other bytes", where=path) from None
    except configparser.Error as error:
        line = re.search(r"line[: ]+(\d+)", str(error))
        if line:
            where = f"{path}, line {line[1]}"
        else:
            where = str(path)
        reason = str(error.message).splitlines()[0]
        raise InputError(
            f"expected lines such as frameRate=25 under [Sequence], came: {reason}", where=where
        ) from None
    if not ini.has_section("Sequence"):
        raise InputError(
            "expected a section [Sequence], came none",
            where=path,
            cure="Put [Sequence] in the first line.",
        )
    section = ini["Sequence"]

    def number(key: str, kind: str = "whole number") -> float:
        if key not in section:
            cure = f"Add a line {key}=… under [Sequence]."
            raise InputError(f"expected a value for {key}, came none", where=path, cure=cure)
        try:
            value = float(section[key])
        except ValueError:
            value = 0.0
        if 0 < value < 1e9 and (kind == "number" or value.is_integer()):
            return value
        starts = [re.split("[=:]", line)[0].strip().lower() for line in text.splitlines()]
        where = f"{path}, line {starts.index(key.lower()) + 1}"
        raise InputError(f"expected a {kind} above 0 for {key}, came '{section[key]}'", where=where)

    return SequenceInfo(
        width=int(number("imWidth")),
        height=int(number("imHeight")),
        fps=number("frameRate", "number"),
        frames=int(number("seqLength")) if "seqLength" in section else 0,
        name=section.get("name", "").strip() or path.absolute().parent.name,
    )
