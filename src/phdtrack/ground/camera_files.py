"""Cameras from files, whose kind is recognised by their content, and a homography from clicked
points.

    XML with <Camera>              Tsai's parameters in millimetres and radians, as PETS has them
    [E13 §3.2] XML with <opencv_storage>      OpenCV's intrinsics and pose; also YAML as
    cv2.FileStorage writes it, JSON, TOML MATLAB 4 to 7                  a homography or a
    transform, row vectors; SciPy reads it, in a process of its own three lines of three numbers   a
    homography, column vectors, metres (H.txt of ETH and UCY: row and column) TOML or JSON
    a description by keys and values

A description is of one of three kinds, by its keys:

    homography = [[...], [...], [...]]      with maps, vectors, pixel, unit (see `MatrixForm`) and
    inside = [u, v] camera_matrix, distortion_coefficients  with rvec or R, and tvec (in unit,
    default "m") file = "View_001.xml"                   another file, as seen from this one's
    folder, with the form of its matrix

and ``terrain = "hill.asc"``, an elevation map, beside the latter two.

From clicked points, the direct linear transform in normalised coordinates gives a first matrix;
least squares on the distances in the image, where the clicks err, gives the final one. Layouts that
leave the matrix open are refused.
"""

from __future__ import annotations

import json
import os
import re
import reprlib
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

import cv2
import numpy as np

from phdtrack.devices import Camera
from phdtrack.errors import InputError, did_you_mean
from phdtrack.files import AnyPath, Element, load, parse_toml, read_json, read_xml
from phdtrack.ground.cameras import HomographyCamera, OpenCVLens, PosedCamera, TsaiLens
from phdtrack.ground.terrain import Line, read_terrain
from phdtrack.types import F8

# Points whose spread across is this small beside that along lie on a line, as far as clicks can
# tell.
_LINE = 0.01
# The second smallest singular value beside the largest, below which more than one homography fits.
_OPEN = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A fitted camera and how well it fits.

    ``pixel_error`` (N,) distances in the image, pixels; ``ground_error`` (N,) distances on the
    ground, metres.
    """

    camera: HomographyCamera
    pixel_error: F8
    ground_error: F8


def fit_homography(pixel: F8, world: F8) -> Calibration:
    """The homography with the least sum of squared distances in the image from four or more pairs,
    and how well it fits.

    ``pixel`` (2, N) are clicked pixels, ``world`` (2, N) their places on the ground, metres. Raises
    `InputError` for fewer than four pairs, a layout that leaves the matrix open, or pairs that no
    camera in front of a plane can show.
    """
    pixel = np.asarray(pixel, dtype=np.float64)
    world = np.asarray(world, dtype=np.float64)
    _check(pixel, world)
    to_image = _normaliser(pixel)
    to_ground = _normaliser(world)
    forward = _homography(_through(to_ground, world), _through(to_image, pixel))
    matrix = np.linalg.inv(to_ground) @ np.linalg.inv(forward) @ to_image
    matrix /= np.abs(matrix).max()
    camera = HomographyCamera(matrix, inside=(float(pixel[0].mean()), float(pixel[1].mean())))
    missed = camera.pixels(world) - pixel
    off = camera.ground(pixel) - world
    return Calibration(camera, np.hypot(*missed), np.hypot(*off))


def _check(pixel: F8, world: F8) -> None:
    """Raise `InputError` where the points cannot be those of a plane seen by a camera."""
    if pixel.ndim != 2 or len(pixel) != 2 or pixel.shape != world.shape:
        raise InputError(
            f"expected two arrays (2, N), came {pixel.shape} and {world.shape}", where="points"
        )
    if not (np.isfinite(pixel).all() and np.isfinite(world).all()):
        raise InputError("expected finite numbers", where="points")
    if pixel.shape[1] < 4:
        problem = f"expected four points or more, came {pixel.shape[1]}"
        raise InputError(problem, where="points", cure="Click more points of the ground.")
    for name, points in (("in the image", pixel), ("on the ground", world)):
        spread = np.linalg.svd(points - points.mean(axis=1, keepdims=True), compute_uv=False)
        if spread[1] <= _LINE * spread[0]:
            problem = f"expected points that spread over an area, came points on one line {name}"
            raise InputError(
                problem, where="points", cure="Add points to both sides of the line, far from it."
            )


def _normaliser(points: F8) -> F8:
    """(3, 3) the shift and scale that bring the points (2, N) about 0, at a mean distance of √2."""
    middle = points.mean(axis=1)
    scale = np.sqrt(2) / np.hypot(*(points - middle[:, None])).mean()
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])


def _through(h: F8, point: F8) -> F8:
    """(2, N) the points (2, N) through the homography."""
    x = h @ np.vstack([point, np.ones(point.shape[1])])
    return np.asarray(x[:2] / x[2])


def _homography(source: F8, target: F8) -> F8:
    """(3, 3) the homography of the points (2, N), about 0, with the least squared distances to the
    target points.
    """
    from scipy.optimize import least_squares  # takes long to import

    x = np.vstack([source, np.ones(source.shape[1])]).T
    none = np.zeros_like(x)
    rows = np.vstack(
        [
            np.hstack([x, none, -target[0][:, None] * x]),
            np.hstack([none, x, -target[1][:, None] * x]),
        ]
    )
    _, values, axes = np.linalg.svd(rows)
    h = axes[-1].reshape(3, 3)
    if values[7] <= _OPEN * values[0] or np.linalg.cond(h) > 1 / _OPEN:
        raise InputError(
            "expected four points of which no three lie on a line, came a layout that leaves the"
            " camera open",
            where="points",
            cure="Add points away from the line that most of them lie on.",
        )
    w = h[2] @ x.T
    if (w > 0).any() and (w <= 0).any():
        raise InputError(
            "expected points that one camera sees in front of it, came points on both sides of the"
            " horizon",
            where="points",
            cure="Are two pairs mixed up, or x and y, or the signs of X and Y?",
        )

    def distance(free: F8) -> F8:
        return np.asarray((_through(np.append(free, 1.0).reshape(3, 3), source) - target).ravel())

    # The last entry is w at the middle of the points, which the camera sees: not 0.
    start = h.ravel()[:8] / h[2, 2]
    found = least_squares(distance, start, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return np.append(found.x, 1.0).reshape(3, 3)


Description = Mapping[str, Any]
_METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# The names that programs give the same thing; the first is ours.
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
# Prints the 3 x 3 matrices and transforms (`maketform`) of a MATLAB file by name. A damaged file
# can make SciPy's reader crash, or take all memory: so it runs in a process of its own, with a
# bound.
_MATLAB = """
import io, json, sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (1 << 32, 1 << 32))
except ImportError:
    pass
from scipy.io import loadmat

def matrix(value):
    if isinstance(value, dict):
        inner = value.get("tdata", value)
        return matrix(inner.get("T")) if isinstance(inner, dict) else None
    good = getattr(value, "shape", None) == (3, 3) and value.dtype.kind in "fiu"
    return value.astype(float).tolist() if good else None

held = loadmat(io.BytesIO(sys.stdin.buffer.read()), simplify_cells=True)
print(json.dumps({name: matrix(value) for name, value in held.items() if matrix(value) is not None}))
"""
_SECONDS = 60.0


@dataclass(frozen=True, slots=True)
class MatrixForm:
    """What the nine numbers of a homography mean; "" stands for what is usual in the kind of file.

    Attributes
    ----------
    maps : ``pixel-to-ground`` (usual) or ``ground-to-pixel``.
    vectors : ``column``, H·[u v 1]ᵀ (usual in text), or ``row``, [u v 1]·T (usual in MATLAB's
        files).
    pixel : ``xy`` (usual) or ``row-column`` (usual for an H.txt that lies beside an obsmat.txt, the
        layout of ETH and UCY).
    unit : of lengths on the ground: ``m`` (usual in text), ``cm`` or ``mm``; must be said for
        MATLAB's files.
    variable : name of the variable in a MATLAB file; must be said where there are several.
    """

    maps: Literal["", "pixel-to-ground", "ground-to-pixel"] = ""
    vectors: Literal["", "column", "row"] = ""
    pixel: Literal["", "xy", "row-column"] = ""
    unit: Literal["", "m", "cm", "mm"] = ""
    variable: str = ""

    def __post_init__(self) -> None:
        for name, kind in _types(MatrixForm).items():
            value = getattr(self, name)
            known = get_args(kind)
            if not isinstance(value, str) or (known and value not in known):
                expected = (
                    f"expected {name} = {' or '.join(known[1:]) or 'a name'}, came"
                    f" {reprlib.repr(value)}"
                )
                raise InputError(expected, where="form of the homography")


def read_camera(path: AnyPath, form: MatrixForm | None = None) -> Camera:
    """The camera of a file; ``form`` is what a bare matrix means, where it is not what is usual.

    A file that says nothing of the ground has it flat, at height 0. Raises `InputError` where there
    is no such file, it is of no known kind, or something in it is missing or wrong.
    """
    path = Path(path)
    try:
        return _read(path, form or MatrixForm())
    except InputError as error:
        if error.where.startswith(str(path)):
            raise
        # What is wrong with a part of the file: its name is said here, once for all.
        if error.where:
            where = f"{path}, {error.where}"
        else:
            where = str(path)
        raise InputError(error.problem, where=where, cure=error.cure) from None


def calibration_text(fitted: Calibration, frame_size: tuple[int, int] | None = None) -> str:
    """A description, in TOML, of a calibrated camera; `read_camera` gives it back to the last
    bit.
    """
    rows = ",\n".join(
        f"  [{', '.join(repr(float(value)) for value in row)}]" for row in fitted.camera.matrix
    )
    off = np.max(fitted.ground_error)
    missed = np.max(fitted.pixel_error)
    if frame_size:
        of = f" of a frame of {frame_size[0]}x{frame_size[1]}"
    else:
        of = ""
    return (
        f"# Fitted to {len(fitted.pixel_error)} points{of}; the worst is {missed:.2f} pixels and"
        f' {off:.3f} m off.\nhomography = [\n{rows},\n]\nmaps = "pixel-to-ground"\nvectors ='
        ' "column"\npixel = "xy"\nunit = "m"\ninside ='
        f" [{', '.join(map(repr, fitted.camera.inside or ()))}]  # a pixel that shows ground\n"
    )


def _read(path: Path, form: MatrixForm, *, nested: bool = False) -> Camera:
    """The camera of a file; ``nested``: a description has named it, so that it must not name
    another one.
    """
    content = load(path)
    if content.startswith((b"MATLAB", b"\x89HDF")) or path.suffix.lower() == ".mat":
        return _homography_camera(
            _matlab_matrix(path, content, form), replace(form, vectors=form.vectors or "row")
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(
            f"{_EXPECTED}, came bytes that are no UTF-8 text", cure="Is it the right file?"
        ) from None
    start = text.lstrip()
    if start.startswith("<"):
        elements = read_xml(path, content)
        if elements[0].name == "Camera":
            return _tsai_camera({element.name: element for element in reversed(elements)})
        if elements[0].name != "opencv_storage":
            raise InputError(f"{_EXPECTED}, came XML with <{elements[0].name}> outermost")
    if start.startswith(("<", "%YAML")):
        return _described(path, _storage(text), nested)
    if start.startswith("{"):
        return _described(path, read_json(path, content), nested)
    if re.match(r"(\s*(#.*)?\n)*\s*[-+]?(\d|\.\d|nan\b|inf\b)", text, re.IGNORECASE):
        usual: Literal["xy", "row-column"] = (
            "row-column" if (path.parent / "obsmat.txt").is_file() else "xy"
        )
        return _homography_camera(_text_matrix(text), replace(form, pixel=form.pixel or usual))
    return _described(path, _toml(path, content), nested)


def _described(path: Path, values: Description, nested: bool) -> Camera:
    """The camera of a description."""
    kinds = [kind for kind in ("file", "homography") if kind in values]
    kinds += ["camera_matrix"] * any(name in values for name in _NAMES["camera_matrix"])
    if len(kinds) != 1:
        raise InputError(
            "expected one of file, homography and camera_matrix, came"
            f" {' and '.join(kinds) or 'none of them'}"
        )
    if kinds == ["file"] and nested:
        raise InputError("expected a camera, came a description of yet another file")
    for key in ("file", "terrain"):
        if not isinstance(values.get(key, ""), str):
            raise InputError(
                f"expected the name of a file, came {reprlib.repr(values[key])}", where=key
            )
    form = {field.name: values[field.name] for field in fields(MatrixForm) if field.name in values}
    if kinds == ["camera_matrix"]:
        camera: Camera = _opencv_camera(values)
    elif kinds == ["file"]:
        camera = _read(path.parent / values["file"], MatrixForm(**form), nested=True)
    else:
        if "inside" in values:
            inside = tuple(_array(values, "inside", (2,)).tolist())
        else:
            inside = None
        camera = _homography_camera(
            _array(values, "homography", (3, 3)), MatrixForm(**form), inside
        )
    if "terrain" not in values:
        return camera
    if not isinstance(camera, PosedCamera):
        problem = "expected a Tsai or OpenCV camera for an elevation map, came a homography"
        raise InputError(problem, cure="A homography knows flat ground only.")
    return replace(camera, surface=read_terrain(path.parent / values["terrain"]))


def _homography_camera(
    matrix: F8, form: MatrixForm, inside: tuple[float, float] | None = None
) -> HomographyCamera:
    """The camera of a matrix in the given form, which refuses one that cannot be inverted."""
    if form.vectors == "row":
        h = matrix.T
    else:
        h = matrix
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
        cure = "Write distortion_coefficients = [] for a lens without distortion."
        raise InputError("expected distortion_coefficients, came none", cure=cure)
    if not named["tvec"] or bool(named["rvec"]) == bool(named["R"]):
        cure = (
            "cv2.solvePnP gives both from points; without a lens, `phdtrack calibrate` needs"
            " nothing but points."
        )
        raise InputError("expected the pose of the camera, tvec and either rvec or R", cure=cure)
    matrix = _array(values, named["camera_matrix"], (3, 3))
    distortion = _array(values, named["distortion_coefficients"])
    translation = _array(values, named["tvec"], (3,))
    unit = str(values.get("unit", "m"))
    if unit not in _METRES:
        raise InputError(f"expected unit = {' or '.join(_METRES)}, came {unit!r}")
    if named["R"]:
        rotation = _array(values, named["R"], (3, 3))
    else:
        rotation = np.asarray(cv2.Rodrigues(_array(values, named["rvec"], (3,)))[0], np.float64)
    if len(distortion) == 14 and not distortion[12:].any():
        distortion = distortion[:12]
    return PosedCamera(OpenCVLens(matrix, distortion), rotation, _METRES[unit] * translation)


def _array(values: Description, name: str, shape: tuple[int, ...] | None = None) -> F8:
    """The numbers of a key, in the given shape, or in one row where none is given."""
    if shape:
        wanted = " x ".join(map(str, shape)) + " numbers"
    else:
        wanted = "a list of numbers"
    try:
        value = np.asarray(values[name], dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        raise InputError(
            f"expected {wanted}, came {reprlib.repr(values[name])[:60]}", where=name
        ) from None
    if not np.isfinite(value).all():
        raise InputError(f"expected {wanted}, came some that are not finite", where=name)
    if shape is None:
        return value.ravel()
    # OpenCV writes vectors as columns or rows; a matrix in one row is refused, its order would be a
    # guess.
    if value.shape != shape and not (len(shape) == 1 and value.size == shape[0]):
        raise InputError(
            f"expected {wanted}, came {' x '.join(map(str, value.shape)) or 'one'}", where=name
        )
    return value.reshape(shape)


def _toml(path: Path, content: bytes) -> Description:
    """The keys and values of a TOML file, all of them known."""
    try:
        values = parse_toml(path, content)
    except InputError as error:
        problem = f"{_EXPECTED}; as TOML it breaks here: {error.problem.removeprefix('not TOML: ')}"
        raise InputError(problem, where=error.where) from None
    names = [name for group in _NAMES.values() for name in group]
    known = [
        "homography",
        "inside",
        *(field.name for field in fields(MatrixForm)),
        "file",
        "terrain",
        *names,
    ]
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
        # An instruction such as %YAML 1.2 is written by other programs; OpenCV reads its own only.
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        # OpenCV's nodes are no mappings: they cannot be gone through themselves.
        names = root.keys()
        return {name: value(root.getNode(name)) for name in names}
    except (cv2.error, SystemError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        place = re.search(r"\((\d+)\): ", reason)
        if place and "persistence" not in reason.partition(place[0])[0][-20:]:
            where = f"line {place[1]}"
        else:
            where = ""
        raise InputError(
            "expected a file as cv2.FileStorage writes it, which OpenCV cannot read", where=where
        ) from None


def _text_matrix(text: str) -> F8:
    """(3, 3) the numbers of a text: three lines of three, separated by blanks, commas, semicolons
    or tabs.
    """
    lines = [re.sub("[,;]|#.*", " ", line).split() for line in text.splitlines()]
    rows = [
        Line(f"line {number}", words).numbers(3) for number, words in enumerate(lines, 1) if words
    ]
    if len(rows) != 3:
        problem = (
            f"expected the three lines of three numbers of a homography, came {len(rows)} lines"
        )
        raise InputError(problem, cure="Is the file complete?")
    return np.array(rows)


def _matlab_matrix(path: Path, content: bytes, form: MatrixForm) -> F8:
    """(3, 3) the matrix of a MATLAB file, or of a transform (`maketform`); the form must say which,
    and its unit.
    """
    if content.startswith((b"MATLAB 7.3", b"\x89HDF")):
        raise InputError(
            "expected a file of MATLAB 4 to 7, came one of version 7.3 (HDF5)",
            cure="Save it with -v7.",
        )
    # -P: nothing is imported from the folder that the user is in.
    command = [sys.executable, "-P", "-c", _MATLAB]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command,
            input=content,
            capture_output=True,
            env=environment,
            timeout=_SECONDS,
            check=True,
        )
    except subprocess.SubprocessError as error:
        said = (
            (getattr(error, "stderr", None) or b"")
            .decode(errors="replace")
            .strip()
            .rpartition("\n")[2]
        )
        problem = (
            f"expected a file of MATLAB 4 to 7, which SciPy cannot read ({said or 'it crashed'})"
        )
        raise InputError(problem, cure="Is it complete? Save it again, with -v7.") from None
    found = {name: np.array(rows, np.float64) for name, rows in json.loads(done.stdout).items()}
    name = form.variable or next(iter(found), "NAME")
    others = ", ".join(found)
    if form.variable and name not in found:
        problem = f"expected a 3 x 3 matrix or a transform by the name {name}, came none"
        raise InputError(problem, cure=f"There are {others or 'none at all'}.")
    if form.unit and (form.variable or len(found) == 1):
        return found[name]
    problem = "expected the unit of its lengths, which a MATLAB file does not tell"
    if not form.variable and len(found) != 1:
        problem = f"expected one homography, came {others or 'none'}"
    cure = "Say what is meant in a file camera.toml, in three lines, and name that one: "
    raise InputError(
        problem,
        cure=f'{cure}file = "{path.name}", variable = "{name}", unit = "cm" (or "m", "mm").',
    )


def _tsai_camera(found: Mapping[str, Element]) -> PosedCamera:
    """The camera of the elements of a calibration file, in millimetres and radians [E13 §3.2]."""
    for name in ("Geometry", "Intrinsic", "Extrinsic"):
        if name not in found:
            raise InputError(
                f"expected an element <{name}>, came none", cure="Is it a Tsai calibration?"
            )
    geometry = found["Geometry"]
    intrinsic = found["Intrinsic"]
    extrinsic = found["Extrinsic"]
    # dpx is the width of a pixel of the frame: that of the sensor's elements, dx, by their number
    # over that of the pixels.
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
