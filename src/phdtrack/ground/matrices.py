"""Errors of a camera that came from a file say the file.

Homographies in files: nine numbers whose meaning has to be said.

Four things differ between files: the direction (pixels to ground, or back), the side that the vectors stand on (H·[u v 1]ᵀ,
or [u v 1]·T as MATLAB writes), the order of a pixel's coordinates (x y, or row column as ETH and UCY do), and the unit of
length.

Calibration files of PETS: Tsai's parameters in XML, in millimetres and radians.

<Camera name=".."> <Geometry dx=".." dy=".." ncx=".." nfx=".." dpx=".." dpy=".."/>
                   <Intrinsic focal=".." kappa1=".." cx=".." cy=".." sx=".."/>
                   <Extrinsic tx=".." ty=".." tz=".." rx=".." ry=".." rz=".."/>
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar
from xml.parsers import expat

import numpy as np

from phdtrack.errors import InputError
from phdtrack.ground.cameras import PosedCamera
from phdtrack.ground.lenses import TsaiLens, rotation_zyx
from phdtrack.ground.terrain import Surface
from phdtrack.types import F8

T = TypeVar("T")


def located(path: Path, make: Callable[[], T]) -> T:
    """What ``make`` gives; an `InputError` of it names ``path`` too."""
    try:
        return make()
    except InputError as error:
        raise InputError(error.problem, where=f"{path}, {error.where}", cure=error.cure) from None


METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}


@dataclass(frozen=True, slots=True)
class MatrixForm:
    """What the nine numbers mean; "" stands for what is usual in the kind of file.

    Attributes
    ----------
    maps : ``pixel-to-ground`` (usual) or ``ground-to-pixel``.
    vectors : ``column``, H·[u v 1]ᵀ (usual in text), or ``row``, [u v 1]·T (usual in MATLAB's files).
    pixel : ``xy`` (usual) or ``row-column`` (usual for an H.txt that lies beside an obsmat.txt, the layout of ETH and UCY).
    unit : of lengths on the ground: ``m`` (usual in text), ``cm`` or ``mm``; must be said for MATLAB's files.
    variable : name of the variable in a MATLAB file; must be said where there are several.

    Raises
    ------
    InputError : a value that is none of these.
    """

    maps: Literal["", "pixel-to-ground", "ground-to-pixel"] = ""
    vectors: Literal["", "column", "row"] = ""
    pixel: Literal["", "xy", "row-column"] = ""
    unit: Literal["", "m", "cm", "mm"] = ""
    variable: str = ""

    def __post_init__(self) -> None:
        for name, known in (
            ("maps", ("pixel-to-ground", "ground-to-pixel")),
            ("vectors", ("column", "row")),
            ("pixel", ("xy", "row-column")),
            ("unit", tuple(METRES)),
        ):
            value = getattr(self, name)
            if value not in ("", *known):
                raise InputError(f"expected {name} = {' or '.join(known)}, came {value!r}", where="form of the homography")


def homography(matrix: F8, form: MatrixForm) -> F8:
    """(3, 3) from pixel columns [u, v, 1]ᵀ to metres, of a matrix in the given form; "" stands for the first of the values.

    Raises
    ------
    InputError : a matrix to be inverted has no inverse.
    """
    h: F8 = matrix.T if form.vectors == "row" else matrix
    if form.maps == "ground-to-pixel":
        try:
            h = np.asarray(np.linalg.inv(h), dtype=np.float64)
        except np.linalg.LinAlgError:
            raise InputError("expected a matrix that can be inverted, came one that cannot", where="homography") from None
    if form.pixel == "row-column":
        h = h[:, [1, 0, 2]]
    metres = METRES[form.unit or "m"]
    return np.asarray(np.diag([metres, metres, 1.0]) @ h)


def text_matrix(path: Path, text: str) -> F8:
    """(3, 3) the numbers of a text: three lines of three, separated by blanks, commas, semicolons or tabs.

    Raises
    ------
    InputError : other lines than three of three numbers.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        where = f"{path}, line {number}"
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise InputError(f"expected three numbers of a homography, came '{line.strip()[:60]}'", where=where) from None
        if len(words) != 3 or len(rows) > 3:
            came = f"{len(words)} numbers" if len(words) != 3 else "a fourth line"
            raise InputError(f"expected three lines of three numbers, came {came}", where=where)
    if len(rows) != 3:
        raise InputError(
            f"expected three lines of three numbers, came {len(rows)}", where=path, cure="Is the file complete?"
        )
    return np.array(rows)


def matlab_matrix(path: Path, content: bytes, variable: str) -> F8:
    """(3, 3) the matrix ``variable`` of a MATLAB file, or of a transform (`maketform`) by that name.

    Parameters
    ----------
    path : the file, for messages.
    content : its bytes.
    variable : name of the matrix; "" where there is only one.

    Raises
    ------
    InputError : the file cannot be read, or does not say which matrix is meant.
    """
    from scipy.io import loadmat  # takes long to import

    source: Any = io.BytesIO(content)  # SciPy takes an open file, its types know of names only
    try:
        held = loadmat(source, simplify_cells=True)
    except Exception as error:  # a file cut short makes SciPy fail in a dozen ways
        raise InputError(f"the MATLAB file cannot be read: {error}", where=path, cure="Save it with -v7.") from None
    found = {name: matrix for name, value in held.items() if (matrix := _transform(value)) is not None}
    if variable and variable not in found:
        raise InputError(
            f"expected a 3 x 3 matrix or a transform by the name {variable}, came none",
            where=path,
            cure=f"There are {', '.join(found) or 'none at all'}.",
        )
    if not variable and len(found) != 1:
        raise InputError(
            f"expected one homography, came {', '.join(found) or 'none'}",
            where=path,
            cure=what_to_say(path, next(iter(found), "NAME")),
        )
    return found[variable or next(iter(found))]


def what_to_say(path: Path, variable: str) -> str:
    """How to say what a MATLAB file means, in a sentence."""
    return (
        f"Say what is meant in a file camera.toml, in three lines, and name that one: "
        f'file = "{path.name}", variable = "{variable}", unit = "cm" (or "m", "mm").'
    )


def _transform(value: Any) -> F8 | None:
    """The 3 x 3 matrix that a variable is, or holds as a transform; None for other things."""
    if isinstance(value, np.ndarray) and value.shape == (3, 3) and value.dtype.kind in "fiu":
        return value.astype(np.float64)
    if isinstance(value, dict):
        inner = value.get("tdata", value)
        return _transform(inner.get("T")) if isinstance(inner, dict) else None
    return None


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
    """The camera of the elements of a calibration file [E13 §3.2].

    Parameters
    ----------
    path : the file, for messages.
    found : its elements, see `elements`.
    surface : the ground.

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
