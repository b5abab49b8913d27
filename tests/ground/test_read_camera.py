"""Camera files: what they mean, and what is said of those that mean nothing."""

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from camera_cases import BARREL, MATRIX, PLANE, ROTATION, TRANSLATION, hills, posed, tsai
from phdtrack.devices import Camera
from phdtrack.errors import InputError
from phdtrack.ground import MatrixForm, OpenCVLens, fit_homography, read_camera
from phdtrack.ground.calibration import calibration_text

PIXEL = np.array([[100.0, 400, 700, 380], [350, 420, 560, -500]])
VECTOR = cv2.Rodrigues(ROTATION)[0].ravel()
TSAI = """<?xml version="1.0" encoding="UTF-8"?>
<Camera name="View">
  <Geometry width="768" height="576" ncx="795" nfx="750" dx="4.811320754716981e-3" dy="4.6e-3"\
 dpx="5.1e-3" dpy="4.6e-3"/>
  <Intrinsic focal="5.5" kappa1="5e-3" cx="370" cy="280" sx="1.08"/>
  <Extrinsic tx="828.7" ty="-3175.5" tz="35469.3" rx="2.04" ry="-0.893" rz="-0.43"/>
</Camera>
"""


def tsai_with(old: str, new: str) -> str:
    assert old in TSAI
    return TSAI.replace(old, new)


def put(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def same(one: Camera, other: Camera, pixel: np.ndarray = PIXEL) -> None:
    np.testing.assert_allclose(one.ground(pixel), other.ground(pixel), rtol=1e-7)
    assert np.isfinite(one.ground(pixel)[:, :3]).all()


def rows(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(f"{value:.17g}" for value in row) for row in matrix)


def test_tsai_file_in_millimetres(tmp_path: Path) -> None:
    camera = read_camera(put(tmp_path, "view.xml", TSAI))
    pixel = np.array([[100.0, 700], [300, 500]])
    np.testing.assert_allclose(camera.lens.rays(pixel), tsai(5e-3).rays(pixel), rtol=1e-12)
    np.testing.assert_allclose(camera.translation, [0.8287, -3.1755, 35.4693])
    turned = Rotation.from_euler("xyz", [2.04, -0.893, -0.43]).as_matrix()  # Rz·Ry·Rx
    np.testing.assert_allclose(camera.rotation, turned, atol=1e-14)
    without = TSAI.replace('dpx="5.1e-3" dpy="4.6e-3"', "")
    same(
        read_camera(put(tmp_path, "b.xml", without)),
        camera,
        np.array([[100.0, 400, 700], [350, 420, 560]]),
    )


def test_homography_text_in_every_convention(tmp_path: Path) -> None:
    """One camera in 24 notations."""
    swap = np.eye(3)[[1, 0, 2]]
    units = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
    for maps, vectors, pixel, unit in itertools.product(
        ("pixel-to-ground", "ground-to-pixel"), ("column", "row"), ("xy", "row-column"), units
    ):
        matrix = (
            np.diag([units[unit], units[unit], 1]) @ PLANE @ (np.eye(3) if pixel == "xy" else swap)
        )
        matrix = matrix if maps == "pixel-to-ground" else np.linalg.inv(matrix)
        matrix = matrix if vectors == "column" else matrix.T
        path = put(tmp_path, "h.txt", f"# a camera\n{rows(matrix)}\n")
        form = MatrixForm(maps, vectors, pixel, unit)  # type: ignore[arg-type]
        same(read_camera(path, form), posed(OpenCVLens(MATRIX)))
        said = (
            f'file = "h.txt"\nmaps = "{maps}"\nvectors = "{vectors}"\npixel = "{pixel}"\nunit ='
            f' "{unit}"\n'
        )
        same(read_camera(put(tmp_path, "camera.toml", said)), posed(OpenCVLens(MATRIX)))


def test_layout_of_eth_and_ucy_is_recognised(tmp_path: Path) -> None:
    path = put(tmp_path, "H.txt", rows(PLANE[:, [1, 0, 2]]).replace(" ", ",\t"))
    with pytest.raises(AssertionError):
        same(read_camera(path), posed(OpenCVLens(MATRIX)))
    put(tmp_path, "obsmat.txt", "1 1 0 0 0 0 0 0\n")
    same(read_camera(path), posed(OpenCVLens(MATRIX)))


def test_matlab_homography_is_read(tmp_path: Path) -> None:
    path = tmp_path / "h.mat"
    transform = {"tdata": {"T": 100 * PLANE.T @ np.diag([1, 1, 0.01]), "Tinv": np.eye(3)}}
    savemat(path, {"c2b": transform, "plain": np.eye(3), "other": np.zeros((2, 5))})
    with pytest.raises(InputError, match="got c2b, plain") as caught:
        read_camera(path)
    assert 'variable = "c2b"' in caught.value.cure
    with pytest.raises(InputError, match="by the name c3b, got none"):
        read_camera(path, MatrixForm(variable="c3b"))
    with pytest.raises(InputError, match="the unit of its lengths"):
        read_camera(path, MatrixForm(variable="c2b"))
    said = put(tmp_path, "camera.toml", 'file = "h.mat"\nvariable = "c2b"\nunit = "cm"\n')
    same(read_camera(said), posed(OpenCVLens(MATRIX)))
    savemat(path, {"plain": PLANE})
    same(read_camera(path, MatrixForm(unit="m", vectors="column")), posed(OpenCVLens(MATRIX)))
    path.write_bytes(path.read_bytes()[:150])
    with pytest.raises(InputError, match="SciPy cannot read"):
        read_camera(path)


@pytest.mark.parametrize("name", ["camera.yml", "camera.xml", "camera.json"])
def test_opencv_calibration_files_are_read(tmp_path: Path, name: str) -> None:
    if name.endswith("json"):
        keys = {"mtx": MATRIX, "dist": BARREL[None], "rvec": VECTOR, "tvec": TRANSLATION}
        path = put(
            tmp_path,
            name,
            json.dumps({key: value.tolist() for key, value in keys.items()} | {"error": 0.3}),
        )
    else:
        path = tmp_path / name
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 768)
        storage.write("camera_matrix", MATRIX)
        storage.write("distortion_coefficients", BARREL[:, None])
        storage.write("rvec", VECTOR[:, None])
        storage.write("tvec", TRANSLATION[:, None])
        storage.release()
    same(read_camera(path), posed(OpenCVLens(MATRIX, BARREL)))


DESCRIBED = f"""
camera_matrix = {MATRIX.tolist()}
distortion_coefficients = {BARREL.tolist()}
R = {ROTATION.tolist()}
tvec = {(1000 * TRANSLATION).tolist()}
unit = "mm"
"""


def test_toml_camera_with_terrain(tmp_path: Path) -> None:
    same(read_camera(put(tmp_path, "camera.toml", DESCRIBED)), posed(OpenCVLens(MATRIX, BARREL)))
    ground = hills()
    x, y = ground.origin
    rows = "\n".join(" ".join(map(repr, row)) for row in ground.heights[::-1].tolist())
    head = (
        f"ncols {ground.heights.shape[1]}\nnrows {ground.heights.shape[0]}\nxllcenter"
        f" {x}\nyllcenter {y}\n"
    )
    put(tmp_path, "hills.asc", f"{head}cellsize {ground.step[0]}\n{rows}\n")
    path = put(tmp_path, "camera.toml", DESCRIBED + 'terrain = "hills.asc"\n')
    same(read_camera(path), posed(OpenCVLens(MATRIX, BARREL), ground))
    put(tmp_path, "view.xml", TSAI)
    camera = read_camera(put(tmp_path, "other.toml", 'file = "view.xml"\nterrain = "hills.asc"\n'))
    np.testing.assert_array_equal(camera.surface.heights, ground.heights)


def test_calibration_file_is_read_back_exactly(tmp_path: Path, rng: np.random.Generator) -> None:
    world = np.array([[0.0, 12, 10, -8, 3], [-8, -3, 10, 12, 2]])
    fitted = fit_homography(
        posed(OpenCVLens(MATRIX)).pixels(world) + rng.normal(0, 1, world.shape), world
    )
    for size in (None, (768, 576)):
        camera = read_camera(put(tmp_path, "camera.toml", calibration_text(fitted, size)))
        np.testing.assert_array_equal(camera.ground(PIXEL), fitted.camera.ground(PIXEL))
        np.testing.assert_array_equal(camera.pixels(world), fitted.camera.pixels(world))


HOMOGRAPHY = f"homography = {PLANE.tolist()}\n"


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        (tsai_with('focal="5.5" ', ""), ", line 4", "<Intrinsic> with a value for focal"),
        (
            tsai_with('kappa1="5e-3"', 'kappa1="five"'),
            ", line 4",
            "number for kappa1 of <Intrinsic>, got 'five'",
        ),
        (tsai_with('rx="2.04"', 'rx="nan"'), ", line 5", "finite number for rx"),
        (tsai_with("  <Extrinsic", "  <Outside"), "", "an element <Extrinsic>"),
        (tsai_with("</Camera>", ""), ", line ", "XML, which breaks here"),
        (tsai_with('focal="5.5"', 'focal="-5.5"'), "", "TsaiLens.focal: expected a value above 0"),
        (tsai_with('encoding="UTF-8"', 'encoding="UTF-88"'), ", line 1", "XML in UTF-8"),
        (tsai_with("<Camera", "<dataset"), ", line ", "XML with <dataset>|breaks"),
        (
            tsai_with("<Camera name", '<!DOCTYPE Camera [<!ENTITY a "b">]><Camera name'),
            ", line 2",
            "document type",
        ),
        ("homografy = 3\n", "", "no setting homografy. Did you mean homography"),
        ("homography = [[1, 2], [3, 4]]\n", ", homography", "3 x 3 numbers, got 2 x 2"),
        (HOMOGRAPHY + 'maps = "sideways"\n', "", "maps = pixel-to-ground or ground-to-pixel"),
        (HOMOGRAPHY + "inside = [3]\n", ", inside", "2 numbers, got 1"),
        (HOMOGRAPHY + 'terrain = "x.asc"\n', "", "flat ground only"),
        (HOMOGRAPHY + 'file = "x.txt"\n', "", "got file and homography"),
        (
            'homography = [[1, 2, 3], [2, 4, 6], [7, 8, 9]]\nmaps = "ground-to-pixel"\n',
            "",
            "can be inverted",
        ),
        ('file = "gone.xml"\n', "", "there is no such file"),
        ('file = "camera.toml"\n', "", "names another file"),
        ("file = 3\n", ", file", "name of a file"),
        ("", "", "one of file, homography and camera_matrix, got none"),
        ("homography = 3 4\n", ", line 1", "as TOML it breaks here"),
        (DESCRIBED.replace("distortion_coefficients", "dist_coeff"), "", "no setting dist_coeff"),
        (DESCRIBED.replace('"mm"', '"inch"'), "", "unit = m or cm or mm"),
        (
            "\n".join(x for x in DESCRIBED.splitlines() if not x.startswith("R ")),
            "",
            "the pose of the camera",
        ),
        (
            "\n".join(x for x in DESCRIBED.splitlines() if not x.startswith("dist")),
            "",
            "distortion_coefficients = \\[\\]",
        ),
        ("1 2 3\n4 5 6\n", "", "three lines of three numbers of a homography, got 2"),
        ("1 2 3\n4 5 6\n7 8 x\n", ", line 3", "3 numbers, got '7 8 x'"),
        (
            "1 2 3\n4 5 6\n7 8 9\n1 2 3\n",
            "",
            "three lines of three numbers of a homography, got 4",
        ),
        ("1 2 3\n2 4 6\n7 8 9\n", "", "can be inverted"),
        ('{"camera_matrix": \n [}', ", line 2", "JSON, which breaks here"),
        ("%YAML:1.0\n---\ncamera_matrix: [1,\n  }", "", "cv2.FileStorage"),
        ("%YAML:1.0\n---\na: 1\n", "", "got none of them"),
    ],
)
def test_malformed_cameras_are_refused(tmp_path: Path, text: str, where: str, words: str) -> None:
    path = put(tmp_path, "camera.toml", text)
    with pytest.raises(InputError, match=words) as caught:
        read_camera(path)
    if where:
        assert caught.value.where.startswith(f"{path}{where}")
    assert str(tmp_path) in str(caught.value)


def test_files_that_are_not_cameras_are_refused(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"\xff\xfe\x00\x81 no text")
    with pytest.raises(InputError, match="not UTF-8 text"):
        read_camera(tmp_path / "x")
