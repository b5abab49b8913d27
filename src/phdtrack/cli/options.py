"""Options that more than one command has, each described once. Nothing heavy is imported here, for
a quick start.

A command may have a record among its parameters, one of `REQUESTS` or one whose fields are
annotated with options: `app.with_options` makes an option of each of its fields.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from phdtrack.conventions import FORMATS
from phdtrack.files import SIZE_LIMIT
from phdtrack.run.requests import (
    DEFAULT_APPEARANCE,
    OutputRequest,
    ReadingRequest,
    RunRequest,
    SourceRequest,
    TrackingRequest,
)


def option(
    metavar: str,
    help: str,
    *name: str,
    min: float | None = None,
    max: float | None = None,
    **more: Any,
) -> Any:
    """An option with a value that its help calls ``metavar``; its name is that of the parameter
    unless a ``name`` is given. A value below ``min`` or above ``max`` is refused.
    """
    if min is not None or max is not None:
        words = _range(min, max)
        more["callback"] = lambda value: _within(value, min, max, words)
        # Nobody needs to be told that a number of frames is not negative.
        told = words if min else _range(None, max)
        before, default, after = help.partition(" Default:")
        help = f"{before.removesuffix('.')}{told and '; '}{told}.{default}{after}"
    return typer.Option(*name, metavar=metavar, help=help, **more)


def _range(least: float | None, most: float | None) -> str:
    """The numbers that are allowed, in words; empty for all."""
    if least is None and most is None:
        return ""
    if least is None:
        return f"at most {most:g}"
    if most is None:
        return f"at least {least:g}"
    return f"{least:g} to {most:g}"


def _within(value: Any, least: float | None, most: float | None, words: str) -> Any:
    """The value. Raises `typer.BadParameter` if it is not in the range."""
    outside = value is not None and (
        not value >= (-math.inf if least is None else least)
        or not value <= (math.inf if most is None else most)
    )
    if outside:
        raise typer.BadParameter(f"expected {words}, got {value:g}")
    return value


def one_of(value: str, *known: str) -> str:
    """The value. Raises `typer.BadParameter` if it is not one of those known."""
    if value not in known:
        raise typer.BadParameter(f"expected {' or '.join(filter(None, known))}, got {value!r}")
    return value


def listed(names: str) -> Callable[[str], list[str]]:
    """A completion of the words in lower case that a text lists after commas or a colon."""
    words = re.findall(r"(?:^|: |, (?:or )?)([a-z][\w-]{2,})", names)
    return lambda incomplete: [word for word in words if word.startswith(incomplete)]


Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout, and the rest on stderr.")
]
_QUIET = "Print only warnings and errors."
Quiet = Annotated[bool, typer.Option("--quiet", help=_QUIET)]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the files of an earlier run; other files stay.")
]
Seed = Annotated[int, option("N", "The same seed gives the same result, digit by digit.", min=0)]
Iou = Annotated[float, option("F", "Overlap (intersection over union) from which two boxes match.")]
_WIDTH = (
    "Shrink wider frames to N pixels for the detector; 0: never. Default: about 640; for face and"
    " person 0."
)
MaxWidth = Annotated[int | None, option("N", _WIDTH, min=0)]
Mask = Annotated[
    Path | None,
    option("FILE", "An image of the frame's size: boxes where it is black are left out."),
]
Video = Annotated[bool, typer.Option("--video/--no-video", help="Write videos, or not.")]
_VIDEO_SIZE = "Longer side of annotated.mp4 in pixels, at most; 0: as in the source."
VideoSize = Annotated[int, option("N", _VIDEO_SIZE, min=0)]
_FRAME_SIZE = (
    "Size of the frames in pixels, as 1920x1080. Default: from the video, or from seqinfo.ini"
    " beside the file."
)
FrameSize = Annotated[str, option("WxH", _FRAME_SIZE)]
_SEQUENCE = "Which video of a COCO file with several to read; all: read them as one."
Sequence = Annotated[str, option("NAME", _SEQUENCE)]
_FPS = "Frames per second. Default: from the video, or from seqinfo.ini beside the file."
Fps = Annotated[float, option("F", _FPS, min=0.0)]
_DETECTORS = (
    "change (default), mean-background, mog2, face, person (takes about thirty times as long as"
    " change), or onnx:FILE for a network."
)
Detector = Annotated[str, option("NAME", _DETECTORS, autocompletion=listed(_DETECTORS))]
SOURCE = (
    "A video, a folder of images, a pattern of them in quotes, an address, or the number of a"
    " camera."
)
Source = Annotated[str, typer.Argument(metavar="SOURCE", help=SOURCE)]
_FILTERS = "pmb (default), gm-phd, particle-phd, gm-cphd, particle-cphd, mht, pmbm, mcmc, or none."
Filter = Annotated[str, option("NAME", _FILTERS, "--filter", autocompletion=listed(_FILTERS))]
SceneFile = Annotated[Path | None, option("FILE", "What `phdtrack learn` wrote about this scene.")]
TruthFile = Annotated[
    Path | None, option("FILE", "Annotated objects: the tracks are scored against them.")
]
_LABELLED = (
    "The frames to score, if --truth annotates some only: their numbers, as 1,11,21-30, or a file"
    " with these; truth: those that have an object in --truth; all. Default: found from --truth."
)
Labelled = Annotated[
    str,
    option("LIST", _LABELLED),
]
_MARKED = "File of the marks of `phdtrack label`. Default: runs/NAME.labels.sqlite."
Labels = Annotated[Path | None, option("FILE", _MARKED)]
Config = Annotated[
    Path | None, option("FILE", "Settings in a TOML file, as phdtrack settings prints them.")
]
Sets = Annotated[
    list[str] | None,
    option("NAME=VALUE", "One setting, as sensor.box_noise=0.1. Repeatable.", "--set"),
]
_PRESETS = (
    "Settings to start from: default, background, ground, points, other-filters,"
    " background-other-filters, ground-other-filters, points-other-filters, mot15, m07,"
    " m07-extended, m09, m09-extended, m09-mht, e13, d14, or fv. `phdtrack settings --preset NAME`"
    " shows one."
)
Preset = Annotated[str, option("NAME", _PRESETS, autocompletion=listed(_PRESETS))]
Frames = Annotated[
    str,
    option(
        "A-B",
        "Only these frames, as 1500-3000 or 1500-. Numbers and times stay those of the whole.",
    ),
]
_LEARN = (
    "With a background detector, track the video twice: the first time teaches where the scene"
    " flickers."
)
Learn = Annotated[bool, typer.Option("--learn/--no-learn", help=_LEARN)]
DetectionsFile = Annotated[
    Path | None,
    option("FILE", "Boxes of your own detector; no other one runs. Write - for rows from a pipe."),
]
OnError = Annotated[
    str,
    option(
        "skip|stop",
        "Malformed rows of detections: skip and count them, or stop.",
        callback=lambda value: one_of(value, "skip", "stop"),
    ),
]


def seconds(text: str | float) -> float:
    """Seconds of a duration as 90, 90s, 10m or 1.5h. Raises `typer.BadParameter` for other text."""
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?) ?([smh]?)", str(text).strip().lower())
    if match is None:
        raise typer.BadParameter(f"expected a duration as 90s, 10m or 1h, got {text!r}")
    return float(match[1]) * 60.0 ** "smh".index(match[2] or "s")


def size(text: str) -> int:
    """Bytes of a size as 20GB, 500M or 1000; 0 for empty text. Raises `typer.BadParameter` for
    other text.
    """
    match = re.fullmatch(r"(\d{1,15}(?:\.\d{1,9})?) ?([KMGT]?)B?", text.strip().upper())
    if text and (match is None or float(match[1]) == 0):
        raise typer.BadParameter(f"expected a size as 500MB or 4GB, got {text!r}")
    if match is None:
        return 0
    return int(float(match[1]) * 1000 ** " KMGT".index(match[2] or " "))


def limit_files(text: str) -> str:
    """Set the largest size of files, for the processes that a command starts too."""
    if text:
        os.environ[SIZE_LIMIT] = str(size(text))
    return text


_SIZE = "Largest file that is read whole, as 500MB; videos have no limit. Default: 4GB."
MaxFileSize = Annotated[str, option("SIZE", _SIZE, callback=limit_files)]
Classes = Annotated[
    str, option("NAMES", "Track these classes alone, as person,car. Default: all, each on its own.")
]
Out = Annotated[
    Path | None, option("DIR", "Directory to write into. Default: runs/ and the source's name.")
]
_AGAIN = "Detect anew, even if an earlier run of this detector has kept its boxes."
DetectAgain = Annotated[bool, typer.Option("--detect-again", help=_AGAIN)]
Resume = Annotated[bool, typer.Option("--resume", help="Continue a run that was interrupted.")]
CheckpointEvery = Annotated[
    float, option("S", "Seconds between checkpoints, for --resume; 0: none are made.", min=0.0)
]
_BLUR = "Pixelate boxes, or faces (the upper third of boxes), in all pictures and videos."
Blur = Annotated[
    str, option("boxes|faces", _BLUR, callback=lambda value: one_of(value, "", "boxes", "faces"))
]
Display = Annotated[
    bool,
    typer.Option(
        "--display",
        help=(
            "Show the tracked frames in a window; Q in it ends, as Ctrl-C does. Needs OpenCV with"
            " windows (opencv-python); the headless package has none."
        ),
    ),
]
Dwell = Annotated[
    float, option("S", "Seconds in a zone before a dwell event is reported.", min=0.1)
]
LeaveAfter = Annotated[
    float, option("S", "Seconds without a detection before a track counts as gone.", min=0.1)
]
CameraMotion = Annotated[
    str,
    option(
        "HOW", "The camera's motion: flow measures it, FILE has it. Default: none, it stands still."
    ),
]
Threads = Annotated[
    int | None,
    option(
        "N", "Threads of particle filters; 0: all cores. The result is the same. Default: 1.", min=0
    ),
]
_MOST = (
    "Keep at most N detections per frame, highest scores first. Default: 1000, fewer with some"
    " filters."
)
MaxDetections = Annotated[int | None, option("N", _MOST, min=1)]
_LOOKS = (
    "Tell objects apart by how they look: by their colours, onnx:FILE (a network), FILE.npy (a row"
    " for each detection), or none. Default: what a run has kept beside --detections, or"
    f" {DEFAULT_APPEARANCE}."
)
Appearance = Annotated[str, option("NAME", _LOOKS, autocompletion=listed(": colours, none"))]
_RETURNS = (
    "With --appearance: seconds within which a lost object that looks the same gets its identity"
    " back. Default: no limit; it gets it if that is likelier than a new object."
)
ReidentifyWithin = Annotated[float | None, option("S", _RETURNS, min=0.0)]

_FORMAT = (
    f"Format of the file, if its content does not show it: {', '.join(FORMATS)}. With --truth and"
    " --detections it is that of the detections; write two for both, that of the truth first:"
    " kitti,mot17. The same holds for --first-frame, --units and --box."
)
_FIRST_FRAME = "Number of the first frame in the file. Default: as usual in its format."
_UNITS = "Unit of its boxes: pixels, or shares of the frame's size. Default: as the numbers show."
_BOX = (
    "Columns of its boxes: left, top, width, height; or left, top, right, bottom. Default: as usual"
    " in its format."
)

# How the fields of the requests of `phdtrack.run` are given on the command line.
REQUESTS: dict[type[Any], dict[str, Any]] = {
    SourceRequest: {
        "source": Source,
        "detections": DetectionsFile,
        "detector": Detector,
        "frame_size": FrameSize,
        "fps": Fps,
        "max_width": MaxWidth,
        "mask": Mask,
        "on_error": OnError,
        "detect_again": DetectAgain,
    },
    ReadingRequest: {
        "format": Annotated[
            str, option("NAME", _FORMAT, autocompletion=listed(", ".join(FORMATS)))
        ],
        "first_frame": Annotated[str, option("0|1", _FIRST_FRAME)],
        "units": Annotated[str, option("pixels|shares", _UNITS)],
        "box": Annotated[str, option("ltwh|ltrb", _BOX)],
        "sequence": Sequence,
    },
    TrackingRequest: {
        "filter_name": Filter,
        "preset": Preset,
        "config": Config,
        "sets": Sets,
        "seed": Seed,
        "truth": TruthFile,
        "labelled": Labelled,
        "threads": Threads,
        "classes": Classes,
        "max_detections": MaxDetections,
        "appearance": Appearance,
        "reidentify_within": ReidentifyWithin,
    },
    OutputRequest: {
        "out": Out,
        "overwrite": Overwrite,
        "resume": Resume,
        "blur": Blur,
        "scene": SceneFile,
        "learn": Learn,
    },
    RunRequest: {
        "video": Video,
        "video_size": VideoSize,
        "camera_motion": CameraMotion,
        "checkpoint_every": CheckpointEvery,
        "frames": Frames,
    },
}


@dataclass(frozen=True, slots=True)
class PageOptions:
    """Address of a page, and who may open it (docs/security.md)."""

    host: Annotated[
        str, option("NAME", "Address to listen on. Other machines need the token that is printed.")
    ] = "127.0.0.1"
    port: Annotated[
        int,
        option(
            "N",
            "Port of the page. Default: one that is free.",
            min=0,
            max=65535,
        ),
    ] = 0
    allow_host: Annotated[
        list[str] | None,
        option("NAME", "Name or address by which browsers ask for the page. Repeatable."),
    ] = None
    certificate: Annotated[
        Path | None, option("FILE", "Certificate in PEM form: the page is then served by https.")
    ] = None
    key: Annotated[Path | None, option("FILE", "Private key of the certificate, in PEM form.")] = (
        None
    )
