"""Options that more than one command has, each described once. Nothing heavy is imported here, for
a quick start.

A command may have one of the records below among its parameters: `app.command` makes an option of
each of its fields.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from phdtrack.files import SIZE_LIMIT


def option(metavar: str, help: str, *name: str, **more: Any) -> Any:
    """An option with a value, which its help calls ``metavar``; without a ``name`` it has that of
    the parameter.
    """
    return typer.Option(*name, metavar=metavar, help=help, **more)


def one_of(value: str, *known: str) -> str:
    """The value, where it is one of those known; `typer.BadParameter` otherwise."""
    if value not in known:
        raise typer.BadParameter(f"expected {' or '.join(filter(None, known))}, got {value!r}")
    return value


def listed(help: str) -> Callable[[str], list[str]]:
    """Completes the words in lower case that a help text lists after commas or a colon."""
    names = re.findall(r"(?:^|: |, (?:or )?)([a-z][\w-]{2,})", help)
    return lambda incomplete: [name for name in names if name.startswith(incomplete)]


Json = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object on stdout; everything else goes to stderr."),
]
_QUIET = "Say nothing but warnings and errors: neither how far it got nor what came of it."
Quiet = Annotated[bool, typer.Option("--quiet", help=_QUIET)]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the files of an earlier run; other files stay.")
]
Seed = Annotated[
    int, option("N", "Seed of everything random: the same seed gives the same result.", min=0)
]
Iou = Annotated[float, option("F", "Overlap (intersection over union) from which two boxes match.")]
_WIDTH = (
    "Wider frames are shrunk to N pixels for the detector; 0: not at all (default: about 640; face,"
    " person: 0)."
)
MaxWidth = Annotated[int | None, option("N", _WIDTH, min=0)]
Mask = Annotated[
    Path | None,
    option("FILE", "Image of the frame's size; only what lies where it is not black is reported."),
]
Video = Annotated[bool, typer.Option("--video/--no-video", help="Write videos to look at.")]
_VIDEO_SIZE = "Longer side of annotated.mp4 in pixels, at most; 0: that of the source."
VideoSize = Annotated[int, option("N", _VIDEO_SIZE, min=0)]
FrameSize = Annotated[str, option("WxH", "Size of the frames in pixels, as 1920x1080.")]
Fps = Annotated[
    float, option("F", "Frames per second; 0: what the video or seqinfo.ini says.", min=0.0)
]
_DETECTORS = "change (default), mean-background, mog2, knn, face, person, or onnx:FILE, a network."
Detector = Annotated[str, option("NAME", _DETECTORS, autocompletion=listed(_DETECTORS))]
Source = Annotated[
    str,
    typer.Argument(metavar="SOURCE", help="Video, folder or pattern of images, or camera number."),
]
_FILTERS = "pmb (default), gm-phd, particle-phd, gm-cphd, particle-cphd, mht, pmbm, mcmc, or none."
Filter = Annotated[str, option("NAME", _FILTERS, "--filter", autocompletion=listed(_FILTERS))]
SceneFile = Annotated[
    Path | None, option("FILE", "What `phdtrack learn` has learned of this scene.")
]
TruthFile = Annotated[Path | None, option("FILE", "Annotated objects to score against.")]
_MARKED = (
    "Where the marks of `phdtrack label` are kept; default: runs/NAME.labels.sqlite, or one next to"
    " the video."
)
Labels = Annotated[Path | None, option("FILE", _MARKED)]
Config = Annotated[
    Path | None, option("FILE", "Settings in a TOML file; an unknown name is an error.")
]
Sets = Annotated[
    list[str] | None,
    option("NAME=VALUE", "One setting, as sensor.box_noise=0.1; repeatable.", "--set"),
]
_PRESETS = "Settings to start from: default, background, mot15, m07, m09, m09-mht, e13, …"
Preset = Annotated[str, option("NAME", _PRESETS, autocompletion=listed(_PRESETS))]
Frames = Annotated[
    str,
    option(
        "A-B",
        "Only these frames, as 1500-3000 or 1500-; numbers and times stay those of the whole.",
    ),
]
DetectionsFile = Annotated[
    Path | None, option("FILE", "Detections instead of a detector's; -: rows from standard input.")
]
OnError = Annotated[
    str,
    option(
        "skip|stop",
        "Rows of a file of detections that are wrong: left out and counted, or the end.",
        callback=lambda value: one_of(value, "skip", "stop"),
    ),
]


def seconds(text: str | float) -> float:
    """Seconds of a duration as 90, 90s, 10m or 1.5h. `typer.BadParameter` where it is none."""
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?) ?([smh]?)", str(text).strip().lower())
    if match is None:
        raise typer.BadParameter(f"expected a duration as 90s, 10m or 1h, got {text!r}")
    return float(match[1]) * 60.0 ** "smh".index(match[2] or "s")


def size(text: str) -> int:
    """Bytes of a size as 20GB, 500M or 1000; 0 for nothing. `typer.BadParameter` where it is
    none.
    """
    match = re.fullmatch(r"(\d{1,15}(?:\.\d{1,9})?) ?([KMGT]?)B?", text.strip().upper())
    if text and (match is None or float(match[1]) == 0):
        raise typer.BadParameter(f"expected a size as 500MB or 4GB, got {text!r}")
    if match is None:
        return 0
    return int(float(match[1]) * 1000 ** " KMGT".index(match[2] or " "))


def limit_files(text: str) -> str:
    """Let files be as large as this; the processes that a command starts know it, too."""
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
_AGAIN = (
    "Detect anew, and do not use what an earlier run has detected in this video by the same"
    " detector."
)
DetectAgain = Annotated[bool, typer.Option("--detect-again", help=_AGAIN)]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on with a run that was stopped or killed.")
]
CheckpointEvery = Annotated[
    float, option("S", "Seconds between checkpoints, for --resume; 0: none.", min=0.0)
]
_BLUR = (
    "Make boxes, or faces (the upper third of boxes), unrecognisable in all pictures and videos."
)
Blur = Annotated[
    str, option("boxes|faces", _BLUR, callback=lambda value: one_of(value, "", "boxes", "faces"))
]
Dwell = Annotated[
    float, option("S", "Seconds in a zone after which a dwell event is said.", min=0.1)
]
LeaveAfter = Annotated[
    float, option("S", "Seconds without a sighting after which a track has left.", min=0.1)
]
Threads = Annotated[
    int | None,
    option("N", "Threads of particle filters; same result (default: 1; 0: all cores).", min=0),
]
_MOST = (
    "Most detections of a frame; of more the highest scores are taken (default: 1000; less with"
    " some filters)."
)
MaxDetections = Annotated[int | None, option("N", _MOST, min=1)]

DEFAULT_DETECTOR = "change"


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """What is read. Empty text, 0 and None stand for an option that was not given."""

    source: Source = ""
    detections: DetectionsFile = None
    detector: Detector = ""
    frame_size: FrameSize = ""
    fps: Fps = 0.0
    max_width: MaxWidth = None
    mask: Mask = None
    on_error: OnError = "stop"
    max_file_size: MaxFileSize = ""
    detect_again: DetectAgain = False

    @property
    def observed_by(self) -> str:
        """The name of the detector; empty where the detections are given."""
        if self.detections:
            return ""
        return self.detector or DEFAULT_DETECTOR


@dataclass(frozen=True, slots=True)
class TrackingOptions:
    """How it is tracked. Empty text and None stand for an option that was not given."""

    filter_name: Filter = ""
    preset: Preset = ""
    config: Config = None
    sets: Sets = None
    seed: Seed = 0
    truth: TruthFile = None
    threads: Threads = None
    classes: Classes = ""
    max_detections: MaxDetections = None


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Where a run is written, whether it goes on from an earlier one, what its pictures hide, and
    its scene.
    """

    out: Out = None
    overwrite: Overwrite = False
    resume: Resume = False
    blur: Blur = ""
    scene: SceneFile = None


@dataclass(frozen=True, slots=True)
class PageOptions:
    """Where a page is served, and to whom (docs/security.md)."""

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
