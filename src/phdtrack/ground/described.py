"""Cameras described by keys and values, whatever the notation (TOML, JSON, OpenCV's YAML and XML).

Three kinds of camera, told apart by their keys:

    homography = [[...], [...], [...]]      with maps, vectors, pixel, unit (see `MatrixForm`) and inside = [u, v]
    camera_matrix, distortion_coefficients  with rvec or R, and tvec (in unit, default "m")
    file = "View_001.xml"                   another file, as seen from this one's folder, with the form of its matrix

and ``terrain = "hill.npz"``, an elevation map, beside the latter two.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.errors import InputError
from phdtrack.ground.calibrate import Calibration
from phdtrack.ground.homography import HomographyCamera
from phdtrack.ground.located import located
from phdtrack.ground.matrices import METRES, MatrixForm, homography
from phdtrack.ground.pinhole import OpenCVLens
from phdtrack.ground.posed import PosedCamera
from phdtrack.ground.terrain import Flat, Surface
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


def opencv_camera(path: Path, said: Description, surface: Surface | None) -> PosedCamera:
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
