"""Requests for runs as plain values: a command line or a program fills them in, and other processes
can receive them.

Empty text, 0 and None stand for what was not given.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast

from phdtrack.conventions import Conventions
from phdtrack.errors import InputError

DEFAULT_DETECTOR = "change"
DEFAULT_APPEARANCE = "none"
"""The source of embeddings if the user names none and no run has kept them."""
CHECKPOINT_EVERY = 10.0
"""Seconds between checkpoints by default."""
VIDEO_SIZE = 1920
"""Longer side of annotated.mp4 by default, pixels."""
FrameRange = tuple[int, int]
"""The first and the last frame to track; 0 for the end."""
WHOLE: FrameRange = (1, 0)
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ReadingRequest:
    """How a file of boxes is to be read; empty for what its content decides.

    A file of truth may be read beside it: then each word except ``sequence`` may be two,
    ``TRUTH,FILE``, of which one may be empty.

    Attributes
    ----------
    format, units, box, sequence : as the fields of `formats.Conventions`.
    first_frame : ``0`` or ``1``, the number that the file gives the first frame.
    """

    format: str = ""
    first_frame: str = ""
    units: str = ""
    box: str = ""
    sequence: str = ""

    def conventions(self, size: tuple[int, int] = (0, 0)) -> Conventions:
        """The same as `Conventions`, for frames of this width and height in pixels, (0, 0) if it is
        unknown. Raises `InputError` for unknown words.
        """
        if self.first_frame not in ("", "0", "1"):
            raise InputError(f"expected 0 or 1, got {self.first_frame!r}", where="--first-frame")
        first = int(self.first_frame) if self.first_frame else None
        return Conventions(self.format, first, self.units, self.box, self.sequence, size)

    def pair(
        self, *, truth: bool = True, file: bool = True
    ) -> tuple[ReadingRequest, ReadingRequest]:
        """How the truth is to be read, and the file beside it. Raises `InputError` for more than
        two words.

        Parameters
        ----------
        truth, file : whether a word that stands alone is that of the truth, and that of the file.
        """
        words = asdict(self)
        del words["sequence"]
        both = {name: _halves(value, name, truth, file) for name, value in words.items()}
        first = {name: word for name, (word, _) in both.items()}
        second = {name: word for name, (_, word) in both.items()}
        return replace(self, **first), replace(self, **second)

    def options(self) -> dict[str, str]:
        """The values by the names of their options."""
        return {f"--{name.replace('_', '-')}": value for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True)
class SourceRequest:
    """The inputs of a run.

    Attributes
    ----------
    source : video, folder or pattern of images, camera number or address.
    detections : file of detections, ``-`` for standard input; None for a detector.
    detector : name of the detector.
    frame_size : ``WxH`` in pixels, for detections without a video.
    fps : frames per second, in place of the video's own.
    max_width : frames are shrunk to this many pixels for the detector; None for its default.
    mask : image of the region of interest.
    on_error : ``stop`` or ``skip`` malformed rows of a file of detections.
    detect_again : do not reuse detections of an earlier run.
    reading : how the file of detections, or of tracks, is to be read, and that of truth.
    """

    source: str = ""
    detections: Path | None = None
    detector: str = ""
    frame_size: str = ""
    fps: float = 0.0
    max_width: int | None = None
    mask: Path | None = None
    on_error: str = "stop"
    detect_again: bool = False
    reading: ReadingRequest = field(default_factory=ReadingRequest)

    @property
    def detector_name(self) -> str:
        """The detector that runs; empty if the detections come from a file."""
        if self.detections:
            return ""
        return self.detector or DEFAULT_DETECTOR


@dataclass(frozen=True, slots=True)
class TrackingRequest:
    """Settings and options of tracking.

    Attributes
    ----------
    filter_name, preset : names of the filter and of the preset.
    config, sets : TOML file of settings; single settings as ``section.name=value``.
    seed : seed of everything random.
    truth : file of annotated objects to score against.
    labelled : frames that are scored, as `run.scored_files.ScoringRequest.labelled`.
    threads : threads of particle filters; None for the settings' value.
    classes : classes to track, separated by commas.
    max_detections : detections per frame; None for the settings' value.
    appearance : ``colours``, ``onnx:FILE``, a ``.npy`` file with a row for each detection, or
        ``none``; empty for what a run has kept beside the detections, or the default.
    reidentify_within : seconds within which a target takes its identity again; 0 for as long as the
        odds allow, None for the settings' value.
    """

    filter_name: str = ""
    preset: str = ""
    config: Path | None = None
    sets: list[str] | None = None
    seed: int = 0
    truth: Path | None = None
    labelled: str = ""
    threads: int | None = None
    classes: str = ""
    max_detections: int | None = None
    appearance: str = ""
    reidentify_within: float | None = None


@dataclass(frozen=True, slots=True)
class OutputRequest:
    """The outputs of a run.

    Attributes
    ----------
    out : directory; None for ``runs/`` and the source's name.
    overwrite, resume : replace an earlier run; continue one that was interrupted.
    blur : ``boxes`` or ``faces`` to pixelate them in all pictures.
    scene : file that `phdtrack learn` wrote.
    learn : whether a file with a background detector is tracked twice, the second time with what
        the first has taught of the scene.
    """

    out: Path | None = None
    overwrite: bool = False
    resume: bool = False
    blur: str = ""
    scene: Path | None = None
    learn: bool = True


@dataclass(frozen=True, slots=True)
class RunRequest:
    """One run.

    Attributes
    ----------
    source, tracking, output : what to read, how to track, where to write.
    video, video_size : whether to draw annotated.mp4, and its longer side in pixels; 0 for that of
        the source.
    camera_motion : ``flow``, ``none`` or a file of homographies.
    checkpoint_every : seconds between checkpoints; 0 for none.
    frames : ``A-B``; empty for all.
    """

    source: SourceRequest = field(default_factory=SourceRequest)
    tracking: TrackingRequest = field(default_factory=TrackingRequest)
    output: OutputRequest = field(default_factory=OutputRequest)
    video: bool = True
    video_size: int = VIDEO_SIZE
    camera_motion: str = ""
    checkpoint_every: float = CHECKPOINT_EVERY
    frames: str = ""


def _halves(text: str, name: str, truth: bool, file: bool) -> tuple[str, str]:
    """The words for the truth and for the file beside it, from TRUTH,FILE or a word that is that of
    the ``truth``, of the ``file``, or both.
    """
    first, comma, second = text.partition(",")
    if "," in second:
        where = f"--{name.replace('_', '-')}"
        raise InputError(f"expected one word, or TRUTH,FILE, got {text!r}", where=where)
    if comma:
        return first, second
    return first * truth, first * file


def for_name(request: T, name: str) -> T:
    """The request with ``{}`` replaced by ``name`` in every text and path."""
    if isinstance(request, str):
        return cast(T, request.replace("{}", name))
    if isinstance(request, Path):
        return cast(T, Path(str(request).replace("{}", name)))
    if isinstance(request, list):
        return cast(T, [for_name(each, name) for each in request])
    if is_dataclass(request) and not isinstance(request, type):
        values = {
            each.name: for_name(getattr(request, each.name), name) for each in fields(request)
        }
        return replace(request, **values)
    return request


def refuse(unused: Mapping[str, Any], problem: str, instead: str) -> None:
    """Raise `InputError` for the first option that has a value without an effect.

    Parameters
    ----------
    unused : values by option.
    problem : why they have no effect.
    instead : the option because of which.
    """
    for option, value in unused.items():
        if value:
            raise InputError(problem, where=option, cure=f"Leave out {option} or {instead}.")


def frame_size(text: str) -> tuple[int, int]:
    """Width and height in pixels from ``WxH``. Raises `InputError` if the text is not a size."""
    match = re.fullmatch(r"\s*(\d+)\s*[x×X*]\s*(\d+)\s*", text)
    if not match or not int(match[1]) or not int(match[2]):
        raise InputError(f"expected a size as 1920x1080, got {text!r}", where="--frame-size")
    return int(match[1]), int(match[2])


def frame_range(text: str) -> FrameRange:
    """First and last frame from ``A-B``, ``A-`` or ``-B``. Raises `InputError` for other text."""
    match = re.fullmatch(r"\s*(\d{0,9})\s*-\s*(\d{0,9})\s*", text or "-")
    if match:
        first = int(match[1] or 1)
        last = int(match[2] or 0)
        if first >= 1 and (not match[2] or last >= first):
            return first, last
    raise InputError(f"expected frames as 1500-3000, from 1, got {text!r}", where="--frames")
