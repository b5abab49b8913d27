"""Cameras described by keys and values, whatever the notation (TOML, JSON, OpenCV's YAML and XML).

Three kinds of camera, told apart by their keys:

    homography = [[...], [...], [...]]      with maps, vectors, pixel, unit (see `MatrixForm`) and inside = [u, v]
    camera_matrix, distortion_coefficients  with rvec or R, and tvec (in unit, default "m")
    file = "View_001.xml"                   another file, as seen from this one's folder, with the form of its matrix

and ``terrain = "hill.npz"``, an elevation map, beside the latter two.

Any camera's file, told apart by its content.

XML with <Camera>              Tsai's parameters, as PETS has them
XML with <opencv_storage>      OpenCV's intrinsics and pose; also YAML as cv2.FileStorage writes it, JSON, TOML
MATLAB 5                       a homography or a transform, row vectors
three lines of three numbers   a homography, column vectors, metres (H.txt of ETH and UCY: row and column)
TOML or JSON                   everything that can be described (see `described`), also what another file means
"""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.ground.calibrate import Calibration
from phdtrack.ground.cameras import HomographyCamera, PosedCamera
from phdtrack.ground.lenses import OpenCVLens
from phdtrack.ground.matrices import (
    METRES,
    MatrixForm,
    elements,
    homography,
    located,
    matlab_matrix,
    text_matrix,
    tsai_camera,
    what_to_say,
)
from phdtrack.ground.terrain import Flat, Surface, read_terrain
from phdtrack.protocols import Camera
from phdtrack.types import F8

# The names that programs give the same thing; the first is ours.
_NAMES = {
    "camera_matrix": ("camera_matrix", "cameraMatrix", "K", "intrinsic_matrix", "mtx"),
    "distortion_coefficients": ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D", "dist"),
    "rvec": ("rvec", "rotation_vector"),
    "R": ("R", "rotation", "rotation_matrix"),
    "tvec": ("tvec", "T", "t", "translation", "translation_vector"),
}
_FORM = tuple(f.name for f in fields(MatrixForm))
_KEYS = ("homography", "inside", *_FORM, "file", "terrain", *(name for names in _NAMES.values() for name in names))

Description = Mapping[str, Any]


def describes_opencv(said: Description) -> bool:
    """Whether there is a camera matrix, by any of its names."""
    return any(name in said for name in _NAMES["camera_matrix"])


def check_keys(path: Path, said: Description) -> None:
    """Raise `InputError` for a key that means nothing, with the nearest that does."""
    for key in said:
        if key not in _KEYS:
            close = difflib.get_close_matches(key, _KEYS, 1)
            raise InputError(
                f"a camera has no setting {key}",
                where=path,
                cure=f"Did you mean {close[0]}?" if close else "There are homography, camera_matrix, file and theirs.",
            )


def form_of(path: Path, said: Description) -> MatrixForm:
    """What a description says of a matrix."""
    values = {name: said[name] for name in _FORM if name in said}
    for name, value in values.items():
        if not isinstance(value, str):
            raise InputError(f"expected a text for {name}, came {value!r}", where=path)
    return located(path, lambda: MatrixForm(**values))


def homography_camera(path: Path, said: Description) -> HomographyCamera:
    """The camera of a description with a homography.

    Raises
    ------
    InputError : something is missing, wrong, or does not go with a homography.
    """
    if "terrain" in said:
        raise no_terrain(path)
    matrix, form = _array(path, said, "homography", (3, 3)), form_of(path, said)
    inside = _array(path, said, "inside", (2,)) if "inside" in said else None
    pair = None if inside is None else (float(inside[0]), float(inside[1]))
    return located(path, lambda: HomographyCamera(homography(matrix, form), pair))


def _opencv_camera(path: Path, said: Description, surface: Surface | None) -> PosedCamera:
    """The camera of a description with a camera matrix.

    Raises
    ------
    InputError : something is missing or wrong.
    """
    named = {ours: next((name for name in names if name in said), None) for ours, names in _NAMES.items()}
    if named["distortion_coefficients"] is None:
        raise InputError(
            "expected distortion_coefficients, came none",
            where=path,
            cure="Write distortion_coefficients = [] for a lens without distortion.",
        )
    if named["tvec"] is None or (named["rvec"] is None) == (named["R"] is None):
        raise InputError(
            "expected the pose of the camera, tvec and either rvec or R",
            where=path,
            cure="cv2.solvePnP gives both from points; without a lens, `phdtrack calibrate` needs nothing but points.",
        )
    lens_matrix = _array(path, said, named["camera_matrix"] or "camera_matrix", (3, 3))
    distortion = _array(path, said, named["distortion_coefficients"])
    translation = _array(path, said, named["tvec"], (3,))
    unit = str(said.get("unit", "m"))
    if unit not in METRES:
        raise InputError(f"expected unit = {' or '.join(METRES)}, came {unit!r}", where=path)
    if named["R"] is not None:
        rotation = _array(path, said, named["R"], (3, 3))
    else:
        rotation = _rodrigues(_array(path, said, str(named["rvec"]), (3,)))
    if len(distortion) == 14 and not distortion[12:].any():
        distortion = distortion[:12]
    lens = located(path, lambda: OpenCVLens(lens_matrix, distortion))
    return located(path, lambda: PosedCamera(lens, rotation, METRES[unit] * translation, surface or Flat()))


def no_terrain(path: Path) -> InputError:
    """What there is to say about a homography over terrain."""
    return InputError(
        "expected a Tsai or OpenCV camera for an elevation map, came a homography",
        where=path,
        cure="A homography knows flat ground only.",
    )


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


def _array(path: Path, said: Description, name: str | None, shape: tuple[int, ...] | None = None) -> F8:
    """The numbers of a key, in the given shape, or in one row where none is given."""
    wanted = " x ".join(map(str, shape)) + " numbers" if shape else "a list of numbers"
    where = f"{path}, {name}"
    if name is None or name not in said:
        raise InputError(f"expected {wanted}, came nothing", where=where)
    try:
        value = np.asarray(said[name], dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(f"expected {wanted}, came {str(said[name])[:60]}", where=where) from None
    if not np.isfinite(value).all():
        raise InputError(f"expected {wanted}, came some that are not finite", where=where)
    if shape is None:
        return value.ravel()
    # OpenCV writes vectors as columns or rows; a matrix in one row is refused, its order would be a guess.
    fits = value.shape == shape or (len(shape) == 1 and value.size == shape[0])
    if not fits:
        raise InputError(f"expected {wanted}, came {' x '.join(map(str, value.shape)) or 'one'}", where=where)
    return value.reshape(shape)


def _rodrigues(vector: F8) -> F8:
    """(3, 3) the rotation about the vector (3,), by its length in radians."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


def usual(form: MatrixForm, **values: str) -> MatrixForm:
    """The form with what is left open filled in."""
    return type(form)(**(asdict(form) | {name: value for name, value in values.items() if not getattr(form, name)}))


_EXPECTED = "expected a camera: Tsai XML, OpenCV YAML, XML or JSON, a homography in text or MATLAB 5, or camera.toml"


def read_camera(path: AnyPath, form: MatrixForm | None = None, surface: Surface | None = None) -> Camera:
    """The camera of a file.

    Parameters
    ----------
    path : a file of any of the kinds listed above.
    form : what a bare matrix means, where it is not what is usual.
    surface : terrain in place of flat ground, for Tsai and OpenCV cameras.

    Raises
    ------
    InputError : there is no such file, it is of no known kind, something in it is missing or wrong, or the surface does not
        go with the camera.
    """
    return _read(Path(path), form or MatrixForm(), surface, nested=False)


def _read(path: Path, form: MatrixForm, surface: Surface | None, *, nested: bool) -> Camera:
    content = load(path)
    if content.startswith((b"MATLAB 5.0", b"MATLAB 7.3")):
        return _bare(path, surface, _matlab(path, content, form))
    text = _text(path, content)
    start = text.lstrip()
    if start.startswith("<"):
        found = elements(path, content)
        kind = next(iter(found), "")
        if kind == "Camera":
            return tsai_camera(path, found, surface or Flat())
        if kind == "opencv_storage":
            return _described(path, _storage(path, text), surface, nested)
        raise InputError(f"{_EXPECTED}, came XML with <{kind}> outermost", where=path)
    if start.startswith("%YAML"):
        return _described(path, _storage(path, text), surface, nested)
    if start.startswith("{"):
        return _described(path, _json(path, text), surface, nested)
    if _starts_with_number(text):
        beside = (path.parent / "obsmat.txt").is_file()
        form = usual(form, pixel="row-column" if beside else "xy")
        matrix = text_matrix(path, text)
        return _bare(path, surface, located(path, lambda: HomographyCamera(homography(matrix, form))))
    said = _toml(path, text)
    check_keys(path, said)
    return _described(path, said, surface, nested)


def _bare(path: Path, surface: Surface | None, camera: HomographyCamera) -> HomographyCamera:
    if surface is not None:
        raise no_terrain(path)
    return camera


def _matlab(path: Path, content: bytes, form: MatrixForm) -> HomographyCamera:
    matrix = matlab_matrix(path, content, form.variable)
    if not form.unit:
        raise InputError(
            "expected the unit of its lengths, which a MATLAB file does not tell",
            where=path,
            cure=what_to_say(path, form.variable or "NAME"),
        )
    return located(path, lambda: HomographyCamera(homography(matrix, usual(form, vectors="row"))))


def _described(path: Path, said: Description, surface: Surface | None, nested: bool) -> Camera:
    kinds = [kind for kind in ("file", "homography") if kind in said]
    kinds += ["camera_matrix"] * describes_opencv(said)
    if len(kinds) != 1:
        came = " and ".join(kinds) or "none of them"
        raise InputError(f"expected one of file, homography and camera_matrix, came {came}", where=path)
    if kinds == ["file"] and nested:
        raise InputError("expected a camera, came a description of yet another file", where=path)
    if surface is None and "terrain" in said and kinds != ["homography"]:
        surface = read_terrain(path.parent / _name(path, said, "terrain"))
    if kinds == ["file"]:
        return _read(path.parent / _name(path, said, "file"), form_of(path, said), surface, nested=True)
    if kinds == ["homography"]:
        return _bare(path, surface, homography_camera(path, said))
    return _opencv_camera(path, said, surface)


def _name(path: Path, said: Description, key: str) -> str:
    value = said[key]
    if not isinstance(value, str):
        raise InputError(f"expected the name of a file, came {value!r}", where=f"{path}, {key}")
    return value


def _text(path: Path, content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(
            f"{_EXPECTED}, came bytes that are no UTF-8 text", where=path, cure="Is it the right file?"
        ) from None


def _starts_with_number(text: str) -> bool:
    words = next((words for line in text.splitlines() if (words := re.split(r"[\s,;#]+", line.strip())) and words[0]), [""])
    try:
        float(words[0])
    except ValueError:
        return False
    return True


def _toml(path: Path, text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"\(at line (\d+)", str(error))
        where = f"{path}, line {place[1]}" if place else path
        raise InputError(f"{_EXPECTED}; as TOML it breaks here: {str(error).partition(' (at')[0]}", where=where) from None


def _json(path: Path, text: str) -> dict[str, Any]:
    try:
        said = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"expected JSON, which breaks here: {error.msg}", where=f"{path}, line {error.lineno}") from None
    assert isinstance(said, dict)  # the text starts with a brace
    return said


def _storage(path: Path, text: str) -> dict[str, Any]:
    """The matrices and texts of a `cv2.FileStorage`."""
    import cv2  # takes long to import

    try:
        # An instruction such as %YAML 1.2 is written by other programs; OpenCV reads its own only.
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        # OpenCV's nodes are no mappings: they cannot be gone through themselves.
        names = root.keys()
        return {name: _value(root.getNode(name)) for name in names}
    except (cv2.error, SystemError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()[0]
        place = re.search(r"\((\d+)\): ", reason)
        where = f"{path}, line {place[1]}" if place and "persistence" not in reason.partition(place[0])[0][-20:] else path
        raise InputError("expected a file as cv2.FileStorage writes it, which OpenCV cannot read", where=where) from None


def _value(node: Any) -> Any:
    if node.isMap():
        return node.mat()
    if node.isSeq():
        return [_value(node.at(i)) for i in range(node.size())]
    return node.string() if node.isString() else node.real()
