"""Cameras from files, whose kind is recognised by their content.

    XML with <Camera>              Tsai's parameters in millimetres and radians, as PETS has them [E13 §3.2]
    XML with <opencv_storage>      OpenCV's intrinsics and pose; also YAML as cv2.FileStorage writes it, JSON, TOML
    MATLAB 5                       a homography or a transform, row vectors
    three lines of three numbers   a homography, column vectors, metres (H.txt of ETH and UCY: row and column)
    TOML or JSON                   a description by keys and values

A description is of one of three kinds, by its keys:

    homography = [[...], [...], [...]]      with maps, vectors, pixel, unit (see `MatrixForm`) and inside = [u, v]
    camera_matrix, distortion_coefficients  with rvec or R, and tvec (in unit, default "m")
    file = "View_001.xml"                   another file, as seen from this one's folder, with the form of its matrix

and ``terrain = "hill.npz"``, an elevation map, beside the latter two.
"""

from __future__ import annotations

import difflib
import io
import json
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_type_hints
from xml.parsers import expat

import cv2
import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.ground.calibrate import Calibration
from phdtrack.ground.cameras import HomographyCamera, OpenCVLens, PosedCamera, TsaiLens
from phdtrack.ground.terrain import Flat, Surface, read_terrain
from phdtrack.protocols import Camera
from phdtrack.types import F8

T = TypeVar("T")
Description = Mapping[str, Any]
_METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# The names that programs give the same thing; the first is ours.
_NAMES = {
    "camera_matrix": ("camera_matrix", "cameraMatrix", "K", "intrinsic_matrix", "mtx"),
    "distortion_coefficients": ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D", "dist"),
    "rvec": ("rvec", "rotation_vector"),
    "R": ("R", "rotation", "rotation_matrix"),
    "tvec": ("tvec", "T", "t", "translation", "translation_vector"),
}
_EXPECTED = "expected a camera: Tsai XML, OpenCV YAML, XML or JSON, a homography in text or MATLAB 5, or camera.toml"


@dataclass(frozen=True, slots=True)
class MatrixForm:
    """What the nine numbers of a homography mean; "" stands for what is usual in the kind of file.

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
        for name, kind in get_type_hints(MatrixForm).items():
            value, known = getattr(self, name), get_args(kind)
            if known and value not in known:
                expected = f"expected {name} = {' or '.join(known[1:])}, came {value!r}"
                raise InputError(expected, where="form of the homography")


def read_camera(path: AnyPath, form: MatrixForm | None = None, surface: Surface | None = None) -> Camera:
    """The camera of a file.

    Parameters
    ----------
    path : a file of any of the kinds listed above.
    form : what a bare matrix means, where it is not what is usual.
    surface : terrain in place of flat ground, for Tsai and OpenCV cameras.

    Returns
    -------
    The camera; a file that says nothing of the ground has it flat, at height 0.

    Raises
    ------
    InputError : there is no such file, it is of no known kind, something in it is missing or wrong, or the surface does not
        go with the camera.
    """
    return _read(Path(path), form or MatrixForm(), surface, nested=False)


def calibration_text(fitted: Calibration, frame_size: tuple[int, int] | None = None) -> str:
    """A description, in TOML, of a calibrated camera; `read_camera` gives it back to the last bit."""
    rows = ",\n".join(f"  [{', '.join(repr(float(value)) for value in row)}]" for row in fitted.matrix)
    off, missed = np.max(fitted.ground_error), np.max(fitted.pixel_error)
    of = f" of a frame of {frame_size[0]}x{frame_size[1]}" if frame_size else ""
    return (
        f"# Fitted to {len(fitted.pixel_error)} points{of}; the worst is {missed:.2f} pixels and {off:.3f} m off.\n"
        f"homography = [\n{rows},\n]\n"
        'maps = "pixel-to-ground"\nvectors = "column"\npixel = "xy"\nunit = "m"\n'
        f"inside = [{fitted.inside[0]!r}, {fitted.inside[1]!r}]  # a pixel that shows ground\n"
    )


def _read(path: Path, form: MatrixForm, surface: Surface | None, *, nested: bool) -> Camera:
    """The camera of a file; ``nested``: a description has named it, so that it must not name another one."""
    content = load(path)
    if content.startswith((b"MATLAB 5.0", b"MATLAB 7.3")):
        matrix = _matlab_matrix(path, content, form)
        return _homography_camera(path, matrix, replace(form, vectors=form.vectors or "row"), surface)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        problem = f"{_EXPECTED}, came bytes that are no UTF-8 text"
        raise InputError(problem, where=path, cure="Is it the right file?") from None
    start = text.lstrip()
    if start.startswith("<"):
        found = _elements(path, content)
        kind = next(iter(found), "")
        if kind == "Camera":
            return _tsai_camera(path, found, surface or Flat())
        if kind != "opencv_storage":
            raise InputError(f"{_EXPECTED}, came XML with <{kind}> outermost", where=path)
        return _described(path, _storage(path, text), surface, nested)
    if start.startswith("%YAML"):
        return _described(path, _storage(path, text), surface, nested)
    if start.startswith("{"):
        return _described(path, _json(path, text), surface, nested)
    if re.match(r"(\s*(#.*)?\n)*\s*[-+]?(\d|\.\d|nan\b|inf\b)", text, re.IGNORECASE):
        usual: Literal["xy", "row-column"] = "row-column" if (path.parent / "obsmat.txt").is_file() else "xy"
        return _homography_camera(path, _text_matrix(path, text), replace(form, pixel=form.pixel or usual), surface)
    return _described(path, _toml(path, text), surface, nested)


def _located(path: Path, make: Callable[[], T]) -> T:
    """What ``make`` gives; an `InputError` of it names ``path`` too."""
    try:
        return make()
    except InputError as error:
        raise InputError(error.problem, where=f"{path}, {error.where}", cure=error.cure) from None


def _described(path: Path, values: Description, surface: Surface | None, nested: bool) -> Camera:
    """The camera of a description."""
    kinds = [kind for kind in ("file", "homography") if kind in values]
    kinds += ["camera_matrix"] * any(name in values for name in _NAMES["camera_matrix"])
    if len(kinds) != 1:
        came = " and ".join(kinds) or "none of them"
        raise InputError(f"expected one of file, homography and camera_matrix, came {came}", where=path)
    if kinds == ["file"] and nested:
        raise InputError("expected a camera, came a description of yet another file", where=path)
    if kinds == ["homography"]:
        inside = tuple(_array(path, values, "inside", (2,)).tolist()) if "inside" in values else None
        matrix, form = _array(path, values, "homography", (3, 3)), _form(path, values)
        return _homography_camera(path, matrix, form, surface, inside, terrain="terrain" in values)
    if surface is None and "terrain" in values:
        surface = read_terrain(path.parent / _file_name(path, values, "terrain"))
    if kinds == ["file"]:
        return _read(path.parent / _file_name(path, values, "file"), _form(path, values), surface, nested=True)
    return _opencv_camera(path, values, surface or Flat())


def _file_name(path: Path, values: Description, key: str) -> str:
    if not isinstance(values[key], str):
        raise InputError(f"expected the name of a file, came {values[key]!r}", where=f"{path}, {key}")
    return str(values[key])


def _form(path: Path, values: Description) -> MatrixForm:
    """What a description says of a matrix."""
    given = {field.name: values[field.name] for field in fields(MatrixForm) if field.name in values}
    for name, value in given.items():
        if not isinstance(value, str):
            raise InputError(f"expected a text for {name}, came {value!r}", where=path)
    return _located(path, lambda: MatrixForm(**given))


def _homography_camera(
    path: Path,
    matrix: F8,
    form: MatrixForm,
    surface: Surface | None,
    inside: tuple[float, float] | None = None,
    terrain: bool = False,
) -> HomographyCamera:
    """The camera of a matrix in the given form."""
    if surface is not None or terrain:
        raise InputError(
            "expected a Tsai or OpenCV camera for an elevation map, came a homography",
            where=path,
            cure="A homography knows flat ground only.",
        )
    h = matrix.T if form.vectors == "row" else matrix
    if form.maps == "ground-to-pixel":
        try:
            h = np.asarray(np.linalg.inv(h), dtype=np.float64)
        except np.linalg.LinAlgError:
            problem = "expected a matrix that can be inverted, came one that cannot"
            raise InputError(problem, where=f"{path}, homography") from None
    if form.pixel == "row-column":
        h = h[:, [1, 0, 2]]
    metres = _METRES[form.unit or "m"]
    return _located(path, lambda: HomographyCamera(np.diag([metres, metres, 1.0]) @ h, inside))


def _opencv_camera(path: Path, values: Description, surface: Surface) -> PosedCamera:
    """The camera of a description with a camera matrix."""
    named = {ours: next((name for name in names if name in values), "") for ours, names in _NAMES.items()}
    if not named["distortion_coefficients"]:
        raise InputError(
            "expected distortion_coefficients, came none",
            where=path,
            cure="Write distortion_coefficients = [] for a lens without distortion.",
        )
    if not named["tvec"] or bool(named["rvec"]) == bool(named["R"]):
        raise InputError(
            "expected the pose of the camera, tvec and either rvec or R",
            where=path,
            cure="cv2.solvePnP gives both from points; without a lens, `phdtrack calibrate` needs nothing but points.",
        )
    matrix = _array(path, values, named["camera_matrix"], (3, 3))
    distortion = _array(path, values, named["distortion_coefficients"])
    translation = _array(path, values, named["tvec"], (3,))
    unit = str(values.get("unit", "m"))
    if unit not in _METRES:
        raise InputError(f"expected unit = {' or '.join(_METRES)}, came {unit!r}", where=path)
    if named["R"]:
        rotation = _array(path, values, named["R"], (3, 3))
    else:
        rotation = np.asarray(cv2.Rodrigues(_array(path, values, named["rvec"], (3,)))[0], np.float64)
    if len(distortion) == 14 and not distortion[12:].any():
        distortion = distortion[:12]
    lens = _located(path, lambda: OpenCVLens(matrix, distortion))
    return _located(path, lambda: PosedCamera(lens, rotation, _METRES[unit] * translation, surface))


def _array(path: Path, values: Description, name: str, shape: tuple[int, ...] | None = None) -> F8:
    """The numbers of a key, in the given shape, or in one row where none is given."""
    wanted = " x ".join(map(str, shape)) + " numbers" if shape else "a list of numbers"
    where = f"{path}, {name}"
    try:
        value = np.asarray(values[name], dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(f"expected {wanted}, came {str(values[name])[:60]}", where=where) from None
    if not np.isfinite(value).all():
        raise InputError(f"expected {wanted}, came some that are not finite", where=where)
    if shape is None:
        return value.ravel()
    # OpenCV writes vectors as columns or rows; a matrix in one row is refused, its order would be a guess.
    if value.shape != shape and not (len(shape) == 1 and value.size == shape[0]):
        raise InputError(f"expected {wanted}, came {' x '.join(map(str, value.shape)) or 'one'}", where=where)
    return value.reshape(shape)


def _toml(path: Path, text: str) -> Description:
    """The keys and values of a TOML file, all of them known."""
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"\(at line (\d+)", str(error))
        where = f"{path}, line {place[1]}" if place else path
        raise InputError(f"{_EXPECTED}; as TOML it breaks here: {str(error).partition(' (at')[0]}", where=where) from None
    names = [name for group in _NAMES.values() for name in group]
    known = ["homography", "inside", *(field.name for field in fields(MatrixForm)), "file", "terrain", *names]
    for key in values:
        if key not in known:
            close = difflib.get_close_matches(key, known, 1)
            cure = f"Did you mean {close[0]}?" if close else "There are homography, camera_matrix, file and theirs."
            raise InputError(f"a camera has no setting {key}", where=path, cure=cure)
    return values


def _json(path: Path, text: str) -> Description:
    """The keys and values of a JSON text that starts with a brace."""
    try:
        return dict(json.loads(text))
    except json.JSONDecodeError as error:
        raise InputError(f"expected JSON, which breaks here: {error.msg}", where=f"{path}, line {error.lineno}") from None


def _storage(path: Path, text: str) -> Description:
    """The matrices and texts of a `cv2.FileStorage`."""

    def value(node: Any) -> Any:
        if node.isMap():
            return node.mat()
        if node.isSeq():
            return [value(node.at(i)) for i in range(node.size())]
        return node.string() if node.isString() else node.real()

    try:
        # An instruction such as %YAML 1.2 is written by other programs; OpenCV reads its own only.
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        # OpenCV's nodes are no mappings: they cannot be gone through themselves.
        names = root.keys()
        return {name: value(root.getNode(name)) for name in names}
    except (cv2.error, SystemError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        place = re.search(r"\((\d+)\): ", reason)
        where = f"{path}, line {place[1]}" if place and "persistence" not in reason.partition(place[0])[0][-20:] else path
        raise InputError("expected a file as cv2.FileStorage writes it, which OpenCV cannot read", where=where) from None


def _text_matrix(path: Path, text: str) -> F8:
    """(3, 3) the numbers of a text: three lines of three, separated by blanks, commas, semicolons or tabs."""
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = re.split(r"[\s,;]+", line.partition("#")[0].strip(" \t,;"))
        if words == [""]:
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
        problem = f"expected three lines of three numbers, came {len(rows)}"
        raise InputError(problem, where=path, cure="Is the file complete?")
    return np.array(rows)


def _matlab_matrix(path: Path, content: bytes, form: MatrixForm) -> F8:
    """(3, 3) the matrix of a MATLAB file, or of a transform (`maketform`); the form must say which, and its unit."""
    from scipy.io import loadmat  # takes long to import

    def matrix_of(value: Any) -> F8 | None:
        if isinstance(value, np.ndarray) and value.shape == (3, 3) and value.dtype.kind in "fiu":
            return value.astype(np.float64)
        inner = value.get("tdata", value) if isinstance(value, dict) else None
        return matrix_of(inner.get("T")) if isinstance(inner, dict) else None

    source: Any = io.BytesIO(content)  # SciPy takes an open file, its types know of names only
    try:
        held = loadmat(source, simplify_cells=True)
    except Exception as error:  # a file cut short makes SciPy fail in a dozen ways
        raise InputError(f"the MATLAB file cannot be read: {error}", where=path, cure="Save it with -v7.") from None
    found = {name: matrix for name, value in held.items() if (matrix := matrix_of(value)) is not None}
    name, others = form.variable or next(iter(found), "NAME"), ", ".join(found)
    if form.variable and name not in found:
        problem = f"expected a 3 x 3 matrix or a transform by the name {name}, came none"
        raise InputError(problem, where=path, cure=f"There are {others or 'none at all'}.")
    if form.unit and (form.variable or len(found) == 1):
        return found[name]
    problem = "expected the unit of its lengths, which a MATLAB file does not tell"
    if not form.variable and len(found) != 1:
        problem = f"expected one homography, came {others or 'none'}"
    raise InputError(
        problem,
        where=path,
        cure="Say what is meant in a file camera.toml, in three lines, and name that one: "
        f'file = "{path.name}", variable = "{name}", unit = "cm" (or "m", "mm").',
    )


Elements = dict[str, tuple[int, dict[str, str]]]


def _elements(path: Path, content: bytes) -> Elements:
    """Of each name of an XML element the line and the attributes of its first occurrence; the outermost element is first."""
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
        reason, where = expat.ErrorString(error.code), f"{path}, line {error.lineno}"
        raise InputError(f"expected XML, which breaks here: {reason}", where=where, cure="Is it complete?") from None
    except LookupError as error:
        raise InputError(f"expected XML in UTF-8, came {error}", where=f"{path}, line 1") from None
    return found


def _tsai_camera(path: Path, found: Elements, surface: Surface) -> PosedCamera:
    """The camera of the elements of a calibration file, in millimetres and radians [E13 §3.2]."""

    def number(element: str, *names: str) -> float:
        if element not in found:
            raise InputError(f"expected an element <{element}>, came none", where=path, cure="Is it a Tsai calibration?")
        line, attributes = found[element]
        name, where = next((name for name in names if name in attributes), ""), f"{path}, line {line}"
        if not name:
            raise InputError(f"expected <{element}> with a value for {' or '.join(names)}, came one without", where=where)
        try:
            value = float(attributes[name])
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(f"expected a finite number for {name} of <{element}>, came '{attributes[name]}'", where=where)
        return value

    # dpx is the width of a pixel of the frame: that of the sensor's elements, dx, by their number over that of the pixels.
    geometry = found.get("Geometry", (1, dict[str, str]()))[1]
    dx = number("Geometry", "dpx", "dx")
    if "dpx" not in geometry and "ncx" in geometry and "nfx" in geometry:
        dx *= number("Geometry", "ncx") / (number("Geometry", "nfx") or np.inf)
    focal, kappa, cx, cy, sx = (number("Intrinsic", name) for name in ("focal", "kappa1", "cx", "cy", "sx"))
    dy = number("Geometry", "dpy", "dy")
    lens = _located(path, lambda: TsaiLens(1e-3 * focal, 1e-3 * dx, 1e-3 * dy, 1e6 * kappa, cx, cy, sx))
    rotation = np.eye(3)
    for axis, name in zip(np.eye(3), ("rx", "ry", "rz"), strict=True):
        rotation = cv2.Rodrigues(axis * number("Extrinsic", name))[0] @ rotation
    translation = 1e-3 * np.array([number("Extrinsic", name) for name in ("tx", "ty", "tz")])
    return PosedCamera(lens, rotation, translation, surface)
