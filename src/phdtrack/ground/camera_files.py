"""Cameras from files, whose kind is recognised by their content.

    XML with <Camera>              Tsai's parameters in millimetres and radians, as in PETS
                                   [E13 §3.2]
    XML with <opencv_storage>      OpenCV's intrinsics and pose; also YAML of cv2.FileStorage, JSON,
                                   TOML
    MATLAB 4 to 7                  a homography or a transform, row vectors
    three lines of three numbers   a homography, column vectors, metres (H.txt of ETH and UCY: row
                                   and column)
    TOML or JSON                   a description by keys and values

A description is of one of three kinds, by its keys:

    homography = [[...], [...], [...]]      with maps, vectors, pixel, unit (see `MatrixForm`) and
                                            inside = [u, v]
    camera_matrix, distortion_coefficients  with rvec or R, and tvec (in unit, default "m")
    file = "View_001.xml"                   another file, relative to the folder of this one, with
                                            the form of its matrix

and ``terrain = "hill.asc"``, an elevation map, beside the latter two.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

import numpy as np

from phdtrack.devices import Camera
from phdtrack.errors import InputError, did_you_mean
from phdtrack.files import AnyPath, Element, load, parse_toml, read_json, read_xml
from phdtrack.ground.cameras import PosedCamera
from phdtrack.ground.homography import HomographyCamera
from phdtrack.ground.lenses import OpenCVLens, TsaiLens
from phdtrack.ground.matlab import is_matlab, read_matrices
from phdtrack.ground.terrain import Line, read_terrain
from phdtrack.opencv_package import cv2
from phdtrack.types import F8

Description = Mapping[str, Any]
_METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# The names that programs use; the first is ours.
_NAMES = {
    "camera_matrix": ("camera_matrix", "cameraMatrix", "K", "intrinsic_matrix", "mtx"),
    "distortion_coefficients": (
        "distortion_coefficients",
        "distCoeffs",
        "dist_coeffs",
        "D",
        "dist",
    ),
    "rvec": ("rvec", "rotation_vector"),
    "R": ("R", "rotation", "rotation_matrix"),
    "tvec": ("tvec", "T", "t", "translation", "translation_vector"),
}
_types = cache(get_type_hints)
_EXPECTED = (
    "expected a camera: Tsai XML, OpenCV YAML, XML or JSON, a homography in text or MATLAB 4 to 7,"
    " or camera.toml"
)
_NUMBER_FIRST = re.compile(r"(\s*(#.*)?\n)*\s*[-+]?(\d|\.\d|nan\b|inf\b)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class MatrixForm:
    """The meaning of the nine numbers of a homography; "" stands for the default of the kind of
    file.

    Attributes
    ----------
    maps : ``pixel-to-ground`` (default) or ``ground-to-pixel``.
    vectors : ``column``, H·[u v 1]ᵀ (default in text), or ``row``, [u v 1]·T (default in MATLAB
        files).
    pixel : ``xy`` (default) or ``row-column`` (default for an H.txt beside an obsmat.txt, the
        layout of ETH and UCY).
    unit : of lengths on the ground: ``m`` (default in text), ``cm`` or ``mm``; required for MATLAB
        files.
    variable : name of the variable in a MATLAB file; required if there are several.
    """

    maps: Literal["", "pixel-to-ground", "ground-to-pixel"] = ""
    vectors: Literal["", "column", "row"] = ""
    pixel: Literal["", "xy", "row-column"] = ""
    unit: Literal["", "m", "cm", "mm"] = ""
    variable: str = ""

    def __post_init__(self) -> None:
        for name, kind in _types(MatrixForm).items():
            value = getattr(self, name)
            allowed = get_args(kind)
            if not isinstance(value, str) or (allowed and value not in allowed):
                choices = " or ".join(allowed[1:]) or "a name"
                raise InputError(
                    f"expected {name} = {choices}, got {reprlib.repr(value)}",
                    where="form of the homography",
                )


def read_camera(path: AnyPath, form: MatrixForm | None = None) -> Camera:
    """Read the camera in a file; ``form`` is the meaning of a bare matrix, if it is not the
    default.

    The ground is flat at height 0 unless the file describes it. Raises `InputError` if there is no
    such file, its kind is unknown, or something in it is missing or wrong.

    Parameters
    ----------
    path : the camera file.
    form : the meaning of a bare matrix; None: the default.

    Returns
    -------
    The camera, between pixels and metres.
    """
    path = Path(path)
    try:
        return _read(path, form or MatrixForm())
    except InputError as error:
        if error.where.startswith(str(path)):
            raise
        # Errors about a part of the file do not name the file.
        where = f"{path}, {error.where}" if error.where else str(path)
        raise InputError(error.problem, where=where, cure=error.cure) from None


def _read(path: Path, form: MatrixForm, *, nested: bool = False) -> Camera:
    """The camera in a file; a ``nested`` one is named by a description and must not name another
    file.
    """
    content = load(path)
    if is_matlab(content) or path.suffix.lower() == ".mat":
        form = replace(form, vectors=form.vectors or "row")
        return _homography_camera(_matlab_matrix(path, content, form), form)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(
            f"{_EXPECTED}, got bytes that are not UTF-8 text", cure="Is it the right file?"
        ) from None
    start = text.lstrip()
    if start.startswith("<"):
        elements = read_xml(path, content)
        if elements[0].name == "Camera":
            return _tsai_camera({element.name: element for element in reversed(elements)})
        if elements[0].name != "opencv_storage":
            raise InputError(f"{_EXPECTED}, got XML with <{elements[0].name}> outermost")
    if start.startswith(("<", "%YAML")):
        return _described(path, _storage(text), nested)
    if start.startswith("{"):
        return _described(path, read_json(path, content), nested)
    if _NUMBER_FIRST.match(text):
        if not form.pixel and (path.parent / "obsmat.txt").is_file():
            form = replace(form, pixel="row-column")
        return _homography_camera(_text_matrix(text), form)
    return _described(path, _toml(path, content), nested)


def _described(path: Path, values: Description, nested: bool) -> Camera:
    """The camera of a description."""
    kinds = [kind for kind in ("file", "homography") if kind in values]
    if any(name in values for name in _NAMES["camera_matrix"]):
        kinds.append("camera_matrix")
    if len(kinds) != 1:
        got = " and ".join(kinds) or "none of them"
        raise InputError(f"expected one of file, homography and camera_matrix, got {got}")
    if kinds == ["file"] and nested:
        raise InputError("expected a camera, got a description that names another file")
    for key in ("file", "terrain"):
        if not isinstance(values.get(key, ""), str):
            raise InputError(
                f"expected the name of a file, got {reprlib.repr(values[key])}", where=key
            )
    form = MatrixForm(
        **{field.name: values[field.name] for field in fields(MatrixForm) if field.name in values}
    )
    if kinds == ["camera_matrix"]:
        camera: Camera = _opencv_camera(values)
    elif kinds == ["file"]:
        camera = _read(path.parent / values["file"], form, nested=True)
    else:
        inside = None
        if "inside" in values:
            inside = tuple(_array(values, "inside", (2,)).tolist())
        camera = _homography_camera(_array(values, "homography", (3, 3)), form, inside)
    if "terrain" not in values:
        return camera
    if not isinstance(camera, PosedCamera):
        raise InputError(
            "expected a Tsai or OpenCV camera for an elevation map, got a homography",
            cure="A homography describes flat ground only.",
        )
    return replace(camera, surface=read_terrain(path.parent / values["terrain"]))


def _homography_camera(
    matrix: F8, form: MatrixForm, inside: tuple[float, float] | None = None
) -> HomographyCamera:
    """The camera of a matrix in this form. `HomographyCamera` refuses singular matrices."""
    h = matrix.T if form.vectors == "row" else matrix
    if form.maps == "ground-to-pixel":
        with suppress(np.linalg.LinAlgError):
            h = np.linalg.inv(h).astype(np.float64)
    if form.pixel == "row-column":
        h = h[:, [1, 0, 2]]
    metres = _METRES[form.unit or "m"]
    return HomographyCamera(np.array([[metres], [metres], [1.0]]) * h, inside)


def _opencv_camera(values: Description) -> PosedCamera:
    """The camera of a description with a camera matrix."""
    named = {
        ours: next((name for name in names if name in values), "") for ours, names in _NAMES.items()
    }
    if not named["distortion_coefficients"]:
        raise InputError(
            "expected distortion_coefficients, got none",
            cure="Write distortion_coefficients = [] for a lens without distortion.",
        )
    if not named["tvec"] or bool(named["rvec"]) == bool(named["R"]):
        raise InputError(
            "expected the pose of the camera, tvec and either rvec or R",
            cure=(
                "cv2.solvePnP computes both from points; without a lens, `phdtrack calibrate` needs"
                " only points."
            ),
        )
    matrix = _array(values, named["camera_matrix"], (3, 3))
    distortion = _array(values, named["distortion_coefficients"])
    translation = _array(values, named["tvec"], (3,))
    unit = str(values.get("unit", "m"))
    if unit not in _METRES:
        raise InputError(f"expected unit = {' or '.join(_METRES)}, got {unit!r}")
    if named["R"]:
        rotation = _array(values, named["R"], (3, 3))
    else:
        rotation = np.asarray(cv2.Rodrigues(_array(values, named["rvec"], (3,)))[0], np.float64)
    if len(distortion) == 14 and not distortion[12:].any():
        distortion = distortion[:12]
    return PosedCamera(OpenCVLens(matrix, distortion), rotation, _METRES[unit] * translation)


def _array(values: Description, name: str, shape: tuple[int, ...] | None = None) -> F8:
    """The numbers under a key, in this shape, or as one row without a shape."""
    if shape:
        expected = f"expected {' x '.join(map(str, shape))} numbers"
    else:
        expected = "expected a list of numbers"
    try:
        value = np.asarray(values[name], dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        got = reprlib.repr(values[name])[:60]
        raise InputError(f"{expected}, got {got}", where=name) from None
    if not np.isfinite(value).all():
        raise InputError(f"{expected}, got some that are not finite", where=name)
    if shape is None:
        return value.ravel()
    # OpenCV writes vectors as columns or rows. A matrix in one row is refused: its order would be a
    # guess.
    if value.shape != shape and not (len(shape) == 1 and value.size == shape[0]):
        got = " x ".join(map(str, value.shape)) or "one"
        raise InputError(f"{expected}, got {got}", where=name)
    return value.reshape(shape)


def _toml(path: Path, content: bytes) -> Description:
    """The keys and values of a TOML file; refuses unknown keys."""
    try:
        values = parse_toml(path, content)
    except InputError as error:
        raise InputError(
            f"{_EXPECTED}; as TOML it breaks here: {error.problem.removeprefix('not TOML: ')}",
            where=error.where,
        ) from None
    known = ["homography", "inside", *(field.name for field in fields(MatrixForm))]
    known += ["file", "terrain", *(name for group in _NAMES.values() for name in group)]
    for key in values:
        if key not in known:
            raise InputError(f"a camera has no setting {key}", cure=did_you_mean(key, known))
    return values


def _storage(text: str) -> Description:
    """The matrices and texts of a `cv2.FileStorage`."""

    def value(node: Any) -> Any:
        if node.isMap():
            return node.mat()
        if node.isSeq():
            return [value(node.at(i)) for i in range(node.size())]
        if node.isString():
            return node.string()
        return node.real()

    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        return {name: value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118
    except (cv2.error, SystemError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        place = re.search(r"\((\d+)\): ", reason)
        where = ""
        if place and "persistence" not in reason.partition(place[0])[0][-20:]:
            where = f"line {place[1]}"
        raise InputError(
            "expected a file of cv2.FileStorage, which OpenCV cannot read", where=where
        ) from None


def _text_matrix(text: str) -> F8:
    """(3, 3) the numbers in a text of three lines of three, separated by blanks, commas, semicolons
    or tabs.
    """
    lines = [re.sub("[,;]|#.*", " ", line).split() for line in text.splitlines()]
    rows = [
        Line(f"line {number}", words).numbers(3) for number, words in enumerate(lines, 1) if words
    ]
    if len(rows) != 3:
        raise InputError(
            f"expected the three lines of three numbers of a homography, got {len(rows)} lines",
            cure="Is the file complete?",
        )
    return np.array(rows)


def _matlab_matrix(path: Path, content: bytes, form: MatrixForm) -> F8:
    """(3, 3) the matrix or transform (`maketform`) in a MATLAB file; the form must name it if there
    are several, and the unit.
    """
    matrices = read_matrices(content)
    name = form.variable or next(iter(matrices), "NAME")
    names = ", ".join(matrices)
    if form.variable and name not in matrices:
        raise InputError(
            f"expected a 3 x 3 matrix or a transform by the name {name}, got none",
            cure=f"There are {names or 'none at all'}.",
        )
    if form.unit and (form.variable or len(matrices) == 1):
        return matrices[name]
    problem = "expected the unit of its lengths, which a MATLAB file does not contain"
    if not form.variable and len(matrices) != 1:
        problem = f"expected one homography, got {names or 'none'}"
    raise InputError(
        problem,
        cure="Describe it in a file camera.toml of three lines, and use that file:"
        f' file = "{path.name}", variable = "{name}", unit = "cm" (or "m", "mm").',
    )


def _tsai_camera(elements: Mapping[str, Element]) -> PosedCamera:
    """The camera of the elements of a calibration file, in millimetres and radians [E13 §3.2]."""
    for name in ("Geometry", "Intrinsic", "Extrinsic"):
        if name not in elements:
            raise InputError(
                f"expected an element <{name}>, got none", cure="Is it a Tsai calibration?"
            )
    geometry = elements["Geometry"]
    intrinsic = elements["Intrinsic"]
    extrinsic = elements["Extrinsic"]
    # dpx is the width of a pixel of the frame: the width dx of a sensor element, times the number
    # of elements over the number of pixels.
    dx = geometry.number("dpx", "dx")
    dy = geometry.number("dpy", "dy")
    if "dpx" not in geometry.attributes and {"ncx", "nfx"} <= geometry.attributes.keys():
        dx *= geometry.number("ncx") / (geometry.number("nfx") or np.inf)
    focal, kappa, cx, cy, sx = (
        intrinsic.number(name) for name in ("focal", "kappa1", "cx", "cy", "sx")
    )
    lens = TsaiLens(1e-3 * focal, 1e-3 * dx, 1e-3 * dy, 1e6 * kappa, cx, cy, sx)
    rotation = np.eye(3)
    for axis, name in zip(np.eye(3), ("rx", "ry", "rz"), strict=True):
        rotation = cv2.Rodrigues(axis * extrinsic.number(name))[0] @ rotation
    translation = 1e-3 * np.array([extrinsic.number(name) for name in ("tx", "ty", "tz")])
    return PosedCamera(lens, rotation, translation)
