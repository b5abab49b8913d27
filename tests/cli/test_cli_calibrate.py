"""`phdtrack calibrate`: points in, a camera out, how well it fits; mistakes that are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_runner import phdtrack, refused

from camera_cases import PLANE
from phdtrack.ground import HomographyCamera, read_camera

WORLD = np.array([[0.0, 12, 10, -8, 3, -2], [-8, -3, 10, 12, 2, -9]])


def points(folder: Path, n: int = 6, *, noise: float = 0.3, header: str = "") -> Path:
    pixel = HomographyCamera(PLANE).pixels(WORLD) + np.random.default_rng(3).normal(
        0, noise, WORLD.shape
    )
    lines = [
        f"{u:.3f},{v:.3f},{x:g},{y:g}"
        for (u, v), (x, y) in zip(pixel.T[:n], WORLD.T[:n], strict=True)
    ]
    path = folder / "points.csv"
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n", encoding="utf-8")
    return path


def test_a_camera_and_how_well_it_fits(tmp_path: Path) -> None:
    out = tmp_path / "new" / "camera.toml"
    said = phdtrack(
        "calibrate", points(tmp_path), "--out", out, "--image-size", "768x576", "--json"
    )
    assert said.status == 0
    assert said.object["camera"] == str(out)
    table = said.object["points"]
    assert len(table) == 6
    camera = read_camera(out)
    pixel, world = (
        np.array([[row[key] for row in table] for key in keys]) for keys in (("u", "v"), ("X", "Y"))
    )
    np.testing.assert_array_equal(world, WORLD)
    missed = np.hypot(*(camera.pixels(world) - pixel))
    off = np.hypot(*(camera.ground(pixel) - world))
    np.testing.assert_allclose([row["pixels"] for row in table], missed)
    np.testing.assert_allclose([row["metres"] for row in table], off)
    assert said.object["rms_pixels"] == pytest.approx(np.sqrt((missed**2).mean()))
    assert 0 < said.object["rms_pixels"] < 2
    assert said.object["ground_area"] > 100
    assert "root mean square" in said.err
    np.testing.assert_allclose(
        camera.ground(pixel), HomographyCamera(PLANE).ground(pixel), atol=0.3
    )


def test_four_points_fit_exactly_and_tell_nothing(tmp_path: Path) -> None:
    said = phdtrack("calibrate", points(tmp_path, 4), "--out", tmp_path / "c.toml", "--json")
    assert said.object["rms_pixels"] < 1e-6
    assert "always fitted exactly" in said.err


def test_a_header_may_name_the_columns_in_any_order(tmp_path: Path) -> None:
    plain = phdtrack("calibrate", points(tmp_path), "--out", tmp_path / "a.toml", "--json").object
    text = points(tmp_path).read_text().split()
    turned = [",".join([row.split(",")[i] for i in (2, 3, 0, 1)] + ["0"]) for row in text]
    path = tmp_path / "turned.csv"
    path.write_text("X,Y,u,v,Z\n" + "\n".join(turned) + "\n")
    assert (
        phdtrack("calibrate", path, "--out", tmp_path / "b.toml", "--json").object["points"]
        == plain["points"]
    )


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("", [], "four points or more, got 0"),
        ("1 2 3 4\n5 6 7 8\n9 9 1 0\n", [], "four points or more, got 3"),
        ("1 2 3\n", [], "expected 4 or 5 columns, u, v, x, y, z; got 3 numbers a line"),
        ("1 2 3 4\n5 6 seven 8\n", [], "line 2: expected a number for the x"),
        ("1 2 3 4\n5 6 nan 8\n", [], "line 2: expected finite numbers"),
        (
            "1 2 3 4 0\n5 6 7 8 1.8\n",
            [],
            "line 2: expected points of the ground, Z = 0, got Z = 1.8",
        ),
        ("u v X\n1 2 3\n", [], "expected 4 or 5 columns, u, v, x, y, z; got u, v, x"),
        ("u v X Y x\n1 2 3 4 5\n", [], "got u, v, x, y, x"),
        ("0 0 0 0\n10 10 1 1\n20 20 2 2\n30 30 3 3\n", [], "one line in the image"),
        (
            "0 0 0 0\n900 10 1 1\n",
            ["--image-size", "768x576"],
            "line 2: expected a pixel inside of 768x576, got (900, 10)",
        ),
        ("0 0 0 0\n", ["--image-size", "wide"], "expected a size as 1920x1080"),
    ],
)
def test_mistakes(tmp_path: Path, text: str, options: list[str], words: str) -> None:
    path = tmp_path / "points.txt"
    path.write_text(text)
    sentence = refused("calibrate", path, "--out", tmp_path / "c.toml", *options)
    assert words in sentence
    assert not (tmp_path / "c.toml").exists()
