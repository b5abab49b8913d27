"""Any camera's file, told apart by its content.

XML with <Camera>              Tsai's parameters, as PETS has them
XML with <opencv_storage>      OpenCV's intrinsics and pose; also YAML as cv2.FileStorage writes it, JSON, TOML
MATLAB 5                       a homography or a transform, row vectors
three lines of three numbers   a homography, column vectors, metres (H.txt of ETH and UCY: row and column)
TOML or JSON                   everything that can be described (see `described`), also what another file means
"""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from phdtrack.errors import InputError
from phdtrack.files import AnyPath, load
from phdtrack.ground.described import (
    Description,
    check_keys,
    describes_opencv,
    form_of,
    homography_camera,
    no_terrain,
    opencv_camera,
    usual,
)
from phdtrack.ground.homography import HomographyCamera
from phdtrack.ground.located import located
from phdtrack.ground.matrices import MatrixForm, homography, matlab_matrix, text_matrix, what_to_say
from phdtrack.ground.terrain import Flat, Surface
from phdtrack.ground.terrain_files import read_terrain
from phdtrack.ground.tsai_files import elements, tsai_camera
from phdtrack.protocols import Camera

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
    return opencv_camera(path, said, surface)


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
