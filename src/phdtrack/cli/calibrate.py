"""``phdtrack calibrate``: a camera from points whose pixels and places on the ground are known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from phdtrack.cli.options import option
from phdtrack.cli.output import Output, counted
from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.formats.checks import Rule, enforce
from phdtrack.formats.text import read_columns
from phdtrack.ground import Calibration, fit_homography, footprint
from phdtrack.ground.calibration import calibration_text
from phdtrack.groups.contours import polygon_area
from phdtrack.run.requests import frame_size
from phdtrack.types import F8, Bool

# A point is a line of these, in this order where there is no header.
COLUMNS = ("u", "v", "x", "y", "z")
# Metres from the camera up to which the ground in the image is measured.
LIMIT = 100.0


def calibrate(
    points: Annotated[
        Path,
        typer.Argument(
            metavar="POINTS",
            help="A file with a line u v X Y for each point: its pixel, and metres.",
        ),
    ],
    output: Output,
    out: Annotated[Path, option("FILE", "Camera file to write.")] = Path("camera.toml"),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing camera file.")
    ] = False,
    image_size: Annotated[
        str,
        option(
            "WxH",
            "Size of the frames in pixels: no point may lie outside.",
            "--image-size",
            "--frame-size",
        ),
    ] = "",
) -> None:
    """Make a camera of four or more points of flat ground, and report how well it fits each.

    Other commands take the file as --camera.
    """
    size = frame_size(image_size) if image_size else None
    if out.exists() and not overwrite:
        raise InputError(
            "the file exists already",
            where=f"--out {out}",
            cure="Say --overwrite, or choose another --out.",
        )
    origin, table = read_columns(points, COLUMNS, (4, 5))
    pixel = np.ascontiguousarray(table[:, :2].T)
    world = np.ascontiguousarray(table[:, 2:4].T)
    unknown: Bool = np.logical_not(np.isfinite(table).all(axis=1))
    height = table[:, 4] if table.shape[1] == 5 else np.zeros(len(table))
    flat = (
        "A homography knows flat ground only: leave out points above it, or calibrate with OpenCV."
    )
    rules = [
        Rule(unknown, "expected finite numbers", height),
        Rule(height != 0, "expected points of the ground, Z = 0, got Z = {:g}", height, flat),
    ]
    if size is not None:
        outside: Bool = np.logical_not(((table[:, :2] >= 0) & (table[:, :2] <= size)).all(axis=1))
        problem = f"expected a pixel inside of {size[0]}x{size[1]}, got ({{:g}}, {{:g}})"
        cure = (
            "The first two numbers are the pixel, the others its place in metres; or is"
            " --image-size another?"
        )
        rules.append(Rule(outside, problem, table[:, :2], cure))
    enforce(origin, *rules)
    try:
        fitted = fit_homography(pixel, world)
    except InputError as error:
        raise InputError(error.problem, where=points, cure=error.cure) from None
    write_text(out, calibration_text(fitted, size))
    _report(output, fitted, table, out, size)


def _report(
    out: Output, fitted: Calibration, points: F8, file: Path, size: tuple[int, int] | None
) -> None:
    """The residuals of all points in pixels and metres, and what the camera can tell of the
    ground.
    """
    metres = np.linalg.norm(fitted.camera.jacobian(points[:, :2].T), ord=2, axis=(1, 2))
    table = np.column_stack(
        [points[:, :4], fitted.pixel_error, fitted.ground_error, metres]
    ).tolist()
    form = "{} {:g} {:g} {:g} {:g} {:.2f} {:.3f} {:.3f}"
    rows = [form.format(i, *row).split() for i, row in enumerate(table, start=1)]
    out.table(["point", "u", "v", "X", "Y", "off, px", "off, m", "m per px"], rows, words=())
    rms_px, rms_m = (
        float(np.sqrt((error**2).mean())) for error in (fitted.pixel_error, fitted.ground_error)
    )
    out.say(
        f"{counted(len(table), 'point')}: {rms_px:.2f} pixels and {rms_m:.3f} m off (root mean"
        " square)"
    )
    if len(table) == 4:
        out.warn(
            [
                "four points are always fitted exactly: how good the camera is, only more points"
                " can tell"
            ]
        )
    seen = None
    if size:
        corners = footprint(fitted.camera, size, LIMIT)
        seen = abs(polygon_area(np.hstack([corners, corners[:, :1]])))
        out.say(f"the image shows {seen:.0f} m² of ground within {LIMIT:g} m")
    out.say(str(file))
    keys = ("u", "v", "X", "Y", "pixels", "metres", "metres_per_pixel")
    points_said = [dict(zip(keys, row, strict=True)) for row in table]
    found = {
        "camera": str(file),
        "homography": fitted.camera.matrix.tolist(),
        "points": points_said,
    }
    out.document(found | {"rms_pixels": rms_px, "rms_metres": rms_m, "ground_area": seen})
