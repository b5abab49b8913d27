"""Calibration files of PETS: Tsai's parameters in XML, in millimetres and radians.

<Camera name=".."> <Geometry dx=".." dy=".." ncx=".." nfx=".." dpx=".." dpy=".."/>
                   <Intrinsic focal=".." kappa1=".." cx=".." cy=".." sx=".."/>
                   <Extrinsic tx=".." ty=".." tz=".." rx=".." ry=".." rz=".."/>
"""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

import numpy as np

from phdtrack.errors import InputError
from phdtrack.ground.located import located
from phdtrack.ground.posed import PosedCamera
from phdtrack.ground.terrain import Surface
from phdtrack.ground.tsai import TsaiLens, rotation_zyx

Elements = dict[str, tuple[int, dict[str, str]]]


def elements(path: Path, content: bytes) -> Elements:
    """For each name of an element in an XML document the line and the attributes of the first such; the outermost is first.

    Raises
    ------
    InputError : the document is not well-formed, or declares a document type.
    """
    parser, found = expat.ParserCreate(), Elements()

    def start(name: str, attributes: dict[str, str]) -> None:
        found.setdefault(name, (parser.CurrentLineNumber, attributes))

    def refuse(*_: object) -> None:
        raise InputError(
            "expected XML without a document type and entities, came a declaration of one",
            where=f"{path}, line {parser.CurrentLineNumber}",
            cure="Remove the <!DOCTYPE …> from the file.",
        )

    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        where = f"{path}, line {error.lineno}"
        raise InputError(f"expected XML, which breaks here: {reason}", where=where, cure="Is it complete?") from None
    except LookupError as error:
        raise InputError(f"expected XML in UTF-8, came {error}", where=f"{path}, line 1") from None
    return found


def tsai_camera(path: Path, found: Elements, surface: Surface) -> PosedCamera:
    """The camera of the elements of a calibration file [E13 §2].

    Raises
    ------
    InputError : an element or a number is missing or wrong.
    """

    def number(element: str, *names: str) -> float:
        line, attributes = found.get(element, (1, {}))
        if element not in found:
            raise InputError(f"expected an element <{element}>, came none", where=path, cure="Is it a Tsai calibration?")
        name = next((name for name in names if name in attributes), None)
        where = f"{path}, line {line}"
        if name is None:
            raise InputError(f"expected <{element}> with a value for {' or '.join(names)}, came one without", where=where)
        try:
            value = float(attributes[name])
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(f"expected a finite number for {name} of <{element}>, came '{attributes[name]}'", where=where)
        return value

    geometry = found.get("Geometry", (1, dict[str, str]()))[1]
    if "dpx" in geometry:
        dx = number("Geometry", "dpx")
    elif "ncx" in geometry and "nfx" in geometry:
        dx = number("Geometry", "dx") * number("Geometry", "ncx") / (number("Geometry", "nfx") or np.inf)
    else:
        dx = number("Geometry", "dx")
    values = {
        "focal": 1e-3 * number("Intrinsic", "focal"),
        "dx": 1e-3 * dx,
        "dy": 1e-3 * number("Geometry", "dpy", "dy"),
        "kappa": 1e6 * number("Intrinsic", "kappa1"),
        "cx": number("Intrinsic", "cx"),
        "cy": number("Intrinsic", "cy"),
        "sx": number("Intrinsic", "sx"),
    }
    lens = located(path, lambda: TsaiLens(**values))
    rotation = rotation_zyx(*(number("Extrinsic", name) for name in ("rx", "ry", "rz")))
    translation = 1e-3 * np.array([number("Extrinsic", name) for name in ("tx", "ty", "tz")])
    return PosedCamera(lens, rotation, translation, surface)
