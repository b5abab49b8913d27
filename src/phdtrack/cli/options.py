"""Options that more than one command has, each described once. Nothing heavy is imported here, for
a quick start.

A command may have a record among its parameters, one of `REQUESTS` or one whose fields are
annotated with options: `app.with_options` makes an option of each of its fields.
"""

from __future__ import annotations

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


def option(metavar: str, help: str, *name: str, **more: Any) -> Any:
    """An option with a value that its help calls ``metavar``; its name is that of the parameter
    unless a ``name`` is given.
    """
    return typer.Option(*name, metavar=metavar, help=help, **more)


def one_of(value: str, *known: str) -> str:
    """The value. Raises `typer.BadParameter` if it is not one of those known."""
    if value not in known:
        raise typer.BadParameter(f"expected {' or '.join(filter(None, known))}, got {value!r}")
    return value


def listed(help: str) -> Callable[[str], list[str]]:
    """A completion of the words in lower case that a help text lists after commas or a colon."""
    names = re.findall(r"(?:^|: |, (?:or )?)([a-z][\w-]{2,})", help)
    return lambda incomplete: [name for name in names if name.startswith(incomplete)]


Json = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object on stdout; everything else goes to stderr."),
]
_QUIET = "Print only warnings and errors."
Quiet = Annotated[bool, typer.Option("--quiet", help=_QUIET)]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the files of an earlier run; other files stay.")
]
Seed = Annotated[
    int, option("N", "Seed of everything random: the same seed gives the same result.", min=0)
]
Iou = Annotated[float, option("F", "Overlap (intersection over union) from which two boxes match.")]
_WIDTH = (
    "Shrink wider frames to N pixels for the detector; 0: do not shrink (default: about 640; face,"
    " person: 0)."
)
MaxWidth = Annotated[int | None, option("N", _WIDTH, min=0)]
Mask = Annotated[
    Path | None,
    option("FILE", "Image of the frame's size; only boxes where it is not black are reported."),
]
Video = Annotated[bool, typer.Option("--video/--no-video", help="Write videos to look at.")]
_VIDEO_SIZE = "Longer side of annotated.mp4 in pixels at most; 0: that of the source."
VideoSize = Annotated[int, option("N", _VIDEO_SIZE, min=0)]
FrameSize = Annotated[str, option("WxH", "Size of the frames in pixels, as 1920x1080.")]
Sequence = Annotated[
    str, option("NAME", "The video to read of a COCO file with several; all: as one.")
]
Fps = Annotated[
    float, option("F", "Frames per second; 0: those of the video or of seqinfo.ini.", min=0.0)
]
_DETECTORS = "change (default), mean-background, mog2, face, person, or onnx:FILE, a network."
Detector = Annotated[str, option("NAME", _DETECTORS, autocompletion=listed(_DETECTORS))]
Source = Annotated[
    str,
    typer.Argument(metavar="SOURCE", help="Video, folder or pattern of images, or camera number."),
]
_FILTERS = "pmb (default), gm-phd, particle-phd, gm-cphd, particle-cphd, mht, pmbm, mcmc, or none."
Filter = Annotated[str, option("NAME", _FILTERS, "--filter", autocompletion=listed(_FILTERS))]
SceneFile = Annotated[Path | None, option("FILE", "Scene file that `phdtrack learn` wrote.")]
TruthFile = Annotated[Path | None, option("FILE", "Annotated objects to score against.")]
Labelled = Annotated[
    str, option("LIST", "Score these frames alone: 1,11,21-30, a file, truth, or all.")
]
_MARKED = "File of the marks of `phdtrack label`; default: runs/NAME.labels.sqlite."
Labels = Annotated[Path | None, option("FILE", _MARKED)]
Config = Annotated[
    Path | None, option("FILE", "Settings in a TOML file; an unknown name is an error.")
]
Sets = Annotated[
    list[str] | None,
    option("NAME=VALUE", "One setting, as sensor.box_noise=0.1; repeatable.", "--set"),
]
_PRESETS = (
    "Settings to start from: default, background, ground, points, other-filters,"
    " background-other-filters, ground-other-filters, points-other-filters, mot15, m07,"
    " m07-extended, m09, m09-mht, e13, d14, or fv."
)
Preset = Annotated[str, option("NAME", _PRESETS, autocompletion=listed(_PRESETS))]
Frames = Annotated[
    str,
    option(
        "A-B",
        "Only these frames, as 1500-3000 or 1500-; numbers and times stay those of the whole.",
    ),
]
_LEARN = (
    "Learn where the scene flickers, with a background detector: a file is tracked a second time,"
    " `live` learns as it goes."
)
Learn = Annotated[bool, typer.Option("--learn/--no-learn", help=_LEARN)]
DetectionsFile = Annotated[
    Path | None, option("FILE", "Detections in place of a detector's; -: rows from standard input.")
]
OnError = Annotated[
    str,
    option(
        "skip|stop",
        "Malformed detection rows: skip and count them, or stop.",
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


_SIZE = "Largest file that is read whole, as 500MB; videos have no limit (default: 4GB)."
MaxFileSize = Annotated[str, option("SIZE", _SIZE, callback=limit_files)]
Classes = Annotated[
    str, option("NAME,...", "Classes of the detections to track; default: all, each on its own.")
]
Out = Annotated[
    Path | None, option("DIR", "Directory to write into; default: runs/ and the source's name.")
]
_AGAIN = "Detect anew; do not reuse the detections of an earlier run with the same detector."
DetectAgain = Annotated[bool, typer.Option("--detect-again", help=_AGAIN)]
Resume = Annotated[bool, typer.Option("--resume", help="Continue a run that was interrupted.")]
CheckpointEvery = Annotated[
    float, option("S", "Seconds between checkpoints, for --resume; 0: none.", min=0.0)
]
_BLUR = "Pixelate boxes, or faces (the upper third of boxes), in all pictures and videos."
Blur = Annotated[
    str, option("boxes|faces", _BLUR, callback=lambda value: one_of(value, "", "boxes", "faces"))
]
Dwell = Annotated[
    float, option("S", "Seconds in a zone before a dwell event is reported.", min=0.1)
]
LeaveAfter = Annotated[
    float, option("S", "Seconds without a detection before a track counts as gone.", min=0.1)
]
CameraMotion = Annotated[
    str, option("flow|FILE|none", "A camera that moves: measured, or from a file.")
]
Threads = Annotated[
    int | None,
    option("N", "Threads of particle filters; same result (default: 1; 0: all cores).", min=0),
]
_MOST = (
    "Keep at most N detections per frame, highest scores first (default: 1000; fewer with some"
    " filters)."
)
MaxDetections = Annotated[int | None, option("N", _MOST, min=1)]
_LOOKS = (
    "What the boxes look like, as evidence of who is who: colours, none, onnx:FILE, or FILE.npy, a"
    " row for each detection. Default: what a run has kept beside --detections, or"
    f" {DEFAULT_APPEARANCE}."
)
Appearance = Annotated[str, option("NAME", _LOOKS, autocompletion=listed(_LOOKS))]
_RETURNS = (
    "Seconds within which somebody who was lost and looks the same takes the old identity again; 0:"
    " as long as the odds allow (default)."
)
ReidentifyWithin = Annotated[float | None, option("S", _RETURNS, min=0.0)]

_FORMAT = f"Format of the file of boxes: {', '.join(FORMATS)}; of two files TRUTH,FILE."
_BOX = "Left, top, then width, height or right, bottom; of two files TRUTH,FILE."

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
        "format": Annotated[str, option("NAME", _FORMAT, autocompletion=listed(_FORMAT))],
        "first_frame": Annotated[
            str, option("0|1", "Number of its first frame; of two files TRUTH,FILE.")
        ],
        "units": Annotated[
            str, option("pixels|shares", "Units of its boxes; of two files TRUTH,FILE.")
        ],
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
        str, option("NAME", "Address to listen on; other machines need the printed token.")
    ] = "127.0.0.1"
    port: Annotated[
        int,
        option(
            "N",
            "Port of the page; 0: one that is free (`label`: each time the same).",
            min=0,
            max=65535,
        ),
    ] = 0
    allow_host: Annotated[
        list[str] | None,
        option("NAME", "Name or address by which browsers ask for the page; repeatable."),
    ] = None
    certificate: Annotated[
        Path | None, option("FILE", "Certificate (PEM): the page is served by https.")
    ] = None
    key: Annotated[Path | None, option("FILE", "Private key (PEM) of the certificate.")] = None
