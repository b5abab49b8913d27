"""``phdtrack calibrate``: a camera from points whose pixels and places on the ground are known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from phdtrack.cli.inputs import frame_size
from phdtrack.cli.options import option
from phdtrack.cli.output import Output, counted
from phdtrack.errors import InputError
from phdtrack.files import load
from phdtrack.formats.checks import Origin
from phdtrack.formats.text import numbers, scan
from phdtrack.ground import Calibration, fit_homography, footprint
from phdtrack.ground.read import calibration_text
from phdtrack.groups import polygon_area
from phdtrack.types import F8

# A point is a line of these, in this order where there is no header.
COLUMNS = ("u", "v", "x", "y", "z")
# Metres from the camera up to which the ground in the image is measured.
LIMIT = 100.0


def calibrate(
    points: Annotated[
        Path, typer.Argument(metavar="POINTS", help="Text or CSV, a line a point: u v X Y (pixels, metres on the ground).")
    ],
    output: Output,
    out: Annotated[Path, option("--out", "FILE", "Where to write the camera.")] = Path("camera.toml"),
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a camera that is there already.")] = False,
    image_size: Annotated[
        str,
        typer.Option("--image-size", "--frame-size", metavar="WxH", help="Size of the frames: no point may lie outside."),
    ] = "",
) -> None:
    """Make a camera of four or more points of flat ground, and say how well it fits each of them.

    The file that it writes is what --camera of other commands takes.
    """
    size = frame_size(image_size) if image_size else None
    if out.exists() and not overwrite:
        raise InputError("the file is there already", where=f"--out {out}", cure="Say --overwrite, or choose another --out.")
    pixel, world, origin = read_points(points)
    for row, (u, v) in enumerate(pixel.T):
        if size and not (0 <= u <= size[0] and 0 <= v <= size[1]):
            problem = f"expected a pixel inside of {size[0]}x{size[1]}, got ({u:g}, {v:g})"
            cure = "The first two numbers are the pixel, the others its place in metres; or is --image-size another?"
            raise InputError(problem, where=origin.at(row), cure=cure)
    try:
        fitted = fit_homography(pixel, world)
    except InputError as error:
        raise InputError(error.problem, where=points, cure=error.cure) from None
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(calibration_text(fitted, size), encoding="utf-8")
    report(output, fitted, pixel, world, out, size)


def read_points(path: Path) -> tuple[F8, F8, Origin]:
    """(2, N) pixels, (2, N) places on the ground in metres, and where each stands in the file.

    Raises `InputError` where a column is missing, a number is none, or a point is not at height 0.
    """
    text = scan(path, load(path))
    columns = list(range(text.width))
    if text.header:
        columns = [i for name in COLUMNS for i, found in enumerate(text.header) if found == name]
        for name in COLUMNS[:4]:
            if (count := text.header.count(name)) != 1:
                cure = "The header names u and v, pixels, and X and Y, metres."
                raise InputError(f"expected one column {name}, got {count or 'none'}", where=path, cure=cure)
    if len(columns) not in (4, 5) and len(text):
        problem = f"expected 4 or 5 numbers a line, u v X Y and maybe Z, got {len(columns)}"
        raise InputError(problem, where=text.origin.at(0))
    table = numbers(text, columns, ["u", "v", "X", "Y", "Z"][: len(columns)]) if len(text) else np.zeros((0, 4))
    for row, values in enumerate(table):
        if not np.isfinite(values).all():
            raise InputError("expected finite numbers", where=text.origin.at(row))
        if values[4:].any():
            problem = f"expected points of the ground, Z = 0, got Z = {values[4]:g}"
            cure = "A homography knows flat ground only: leave out points above it, or calibrate with OpenCV."
            raise InputError(problem, where=text.origin.at(row), cure=cure)
    return np.ascontiguousarray(table[:, :2].T), np.ascontiguousarray(table[:, 2:4].T), text.origin


def report(out: Output, fitted: Calibration, pixel: F8, world: F8, file: Path, size: tuple[int, int] | None) -> None:
    """The residuals of all points in pixels and metres, and what the camera can tell of the ground."""
    count, metres = pixel.shape[1], np.linalg.norm(fitted.camera.jacobian(pixel), ord=2, axis=(1, 2))
    table = np.vstack([pixel, world, fitted.pixel_error, fitted.ground_error, metres]).T.tolist()
    form = "{} {:g} {:g} {:g} {:g} {:.2f} {:.3f} {:.3f}"
    rows = [form.format(i, *row).split() for i, row in enumerate(table, start=1)]
    out.table(["point", "u", "v", "X", "Y", "off, px", "off, m", "m per px"], rows, words=())
    rms_px, rms_m = (float(np.sqrt((error**2).mean())) for error in (fitted.pixel_error, fitted.ground_error))
    out.say(f"{counted(count, 'point')}: {rms_px:.2f} pixels and {rms_m:.3f} m off (root mean square)")
    if count == 4:
        out.warn(["four points are always fitted exactly: how good the camera is, only more points can tell"])
    seen = None
    if size:
        corners = footprint(fitted.camera, size, LIMIT)
        seen = abs(polygon_area(np.hstack([corners, corners[:, :1]])))
        out.say(f"the image shows {seen:.0f} m² of ground within {LIMIT:g} m")
    out.say(str(file))
    keys = ("u", "v", "X", "Y", "pixels", "metres", "metres_per_pixel")
    out.document(
        {
            "camera": str(file),
            "homography": fitted.camera.matrix.tolist(),
            "points": [dict(zip(keys, row, strict=True)) for row in table],
            "rms_pixels": rms_px,
            "rms_metres": rms_m,
            "ground_area": seen,
        }
    )
