"""Detectors by name; detections from a table; detectors of a smaller picture, or of a region of
interest only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from phdtrack.detect.change import ChangeDetector, MeanBackgroundDetector
from phdtrack.detect.components import BlobSettings
from phdtrack.detect.onnx import OnnxDetector
from phdtrack.detect.opencv import FaceDetector, PersonDetector, SubtractorDetector
from phdtrack.devices import Detector, Planar, bgr_of, planes_of, size_of
from phdtrack.errors import InputError, did_you_mean
from phdtrack.files import load
from phdtrack.types import F8, STILL, Bool, Detections, DetectionTable, Frame, Image, SequenceInfo

_WORDS = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
_INSIDE = 0.5
# Seconds without a detection after which empty frames are passed over, and the least and largest
# number of these frames.
_EMPTY = 60.0
_FEWEST_EMPTY = 250
_MOST_EMPTY = 100_000
# Pixels on a side below which no detector sees anything, and the clean-up's windows are larger than
# the picture.
_SMALLEST = 16
_BUILD: dict[str, Any] = {
    "change": ChangeDetector,
    "mean-background": MeanBackgroundDetector,
    "mog2": SubtractorDetector,
    "knn": SubtractorDetector,
    "face": FaceDetector,
    "person": PersonDetector,
}
DETECTORS = tuple(_BUILD)
# What the name of a network begins with; its file follows.
_NETWORK = "onnx:"
# Those whose detections are blobs of what differs from the background, one or several objects, or a
# piece of one.
BACKGROUND = ("change", "mean-background", "mog2", "knn")
# Pixels of the longer side that are enough for these.
_WORKING = 640
# No number that a detector has learned is larger.
_LARGEST = 1e30
# What a detector knows by its settings, or by `study`, which can be done again.
_NEVER_KEPT = ("_rule", "_past", "_usual", "_anchor", "_pose", "_shaky")
# Frames of a file that its scene is learned from, the fewest, and pixels that are decoded for them
# in some seconds.
_SAMPLES = 51
_FEWEST_SAMPLES = 7
_QUICKLY = 2e9


@dataclass(frozen=True)
class TableDetector:
    """The rows of ``table`` by frame number; frames without rows are empty. The picture is not
    looked at.
    """

    table: DetectionTable

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The detections of frame ``frame.number``."""
        return self.table.at(frame.number)


def frames_walked(table: DetectionTable, last: int, fps: float) -> Iterator[int]:
    """The numbers of the frames 1 … ``last`` that a tracker goes through where there are detections
    and no video.

    After a minute without a detection (and 250 frames) no target is left that one more empty frame
    could change: of each it would be known that it was missed so often. The frames up to the next
    detection are passed over, as one interval without frames, so that a gap takes no time however
    long it is. The last frame counts as one with detections.

    Parameters
    ----------
    table : the detections.
    last : the last frame.
    fps : frames per second.

    Yields
    ------
    The numbers, ascending.
    """
    before = 0
    for number in chain(np.unique(table.frame[table.frame <= last]).tolist(), [last]):
        yield from frames_up_to(number, before, fps)
        before = number


def frames_up_to(number: int, before: int, fps: float) -> Iterator[int]:
    """The frames after ``before`` up to ``number`` that `frames_walked` gives, where none in
    between has detections.

    Parameters
    ----------
    number, before : two frames with detections, or 0 before the first.
    fps : frames per second.

    Yields
    ------
    The numbers, ascending.
    """
    longest = max(_FEWEST_EMPTY, int(min(_EMPTY * fps, _MOST_EMPTY)))
    yield from range(before + 1, min(before + longest, number - 1) + 1)
    if number > before:
        yield number


@dataclass(frozen=True)
class Rescaled:
    """``detector`` on frames shrunk to ``max_width`` pixels; boxes come back in the coordinates of
    the original.

    Narrower frames are left as they are.
    """

    detector: Detector
    max_width: int

    def __post_init__(self) -> None:
        if self.max_width < 1:
            raise InputError(
                f"the width must be at least one pixel, not {self.max_width}", where="max_width"
            )

    def reset(self) -> None:
        """Reset the detector inside."""
        self.detector.reset()

    def size(self, frame: Frame) -> tuple[int, int]:
        """Width and height of the frame as the detector sees it."""
        width, height = size_of(frame)
        small = (self.max_width, round(height * self.max_width / width))
        if width > self.max_width:
            return small
        return (width, height)

    def shrunk(self, frame: Frame) -> Frame:
        """The frame as the detector sees it."""
        width, height = size_of(frame)
        if width <= self.max_width:
            return frame
        small = self.size(frame)
        if min(small) < _SMALLEST:
            problem = f"frames of {width}x{height} pixels would be shrunk to {small[0]}x{small[1]}"
            cure = f"At least {_SMALLEST} pixels must be left on either side; 320 is a usual width."
            raise InputError(problem, where="max_width", cure=cure)
        planar = isinstance(self.detector, ChangeDetector) and not isinstance(
            frame.picture, np.ndarray
        )
        picture = (
            Planar(small, planes_of(frame.picture, small))
            if planar
            else bgr_of(frame.picture, small)
        )
        return Frame(frame.number, frame.time, picture)

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the smaller picture, (N, 4) in pixels of ``frame``."""
        width, height = size_of(frame)
        if width <= self.max_width:
            return self.detector(frame)
        smaller = self.shrunk(frame)
        found = self.detector(smaller)
        small = size_of(smaller)
        factor = np.tile([width / small[0], height / small[1]], 2)
        if found.covariance is None:
            covariance = None
        else:
            covariance = found.covariance * np.outer(factor, factor)
        return replace(found, xyxy=found.xyxy * factor, covariance=covariance)


def working_width(name: str, given: int | None, info: SequenceInfo) -> int:
    """The width to which a detector's frames are shrunk, 0 for not at all.

    Parameters
    ----------
    name : of the detector.
    given : what was asked for; None leaves it to the video: for detectors of `BACKGROUND` it is
        shrunk by the largest whole factor that leaves 640 pixels on the longer side.
    info : the video.

    Returns
    -------
    width : as `make_detector` takes it.
    """
    if given is not None:
        return given
    factor = max(info.width, info.height) // _WORKING
    if factor > 1 and name in BACKGROUND:
        return round(info.width / factor)
    return 0


class Masked:
    """``detector``, which sees the whole picture; boxes at least half inside a region of interest
    are kept.

    ``mask``, an (H, W) array or image file of the frame's size, is not 0 in the region.
    """

    def __init__(self, detector: Detector, mask: Image | Bool | str | Path) -> None:
        self._detector = detector
        if isinstance(mask, str | Path):
            self._where = str(mask)
        else:
            self._where = "mask"
        if isinstance(mask, str | Path):
            region = _read_mask(Path(mask))
        else:
            region = np.asarray(mask)
        if region.ndim != 2:
            raise InputError(
                f"a mask has the shape (height, width), this one {region.shape}", where=self._where
            )
        if not region.any():
            cure = "White is where to look, black is left out."
            raise InputError(
                "the mask is black all over: nothing could be reported",
                where=self._where,
                cure=cure,
            )
        self._region = region != 0

    def reset(self) -> None:
        """Reset the detector inside."""
        self._detector.reset()

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the region."""
        rows, columns = self._region.shape
        if size_of(frame) != (columns, rows):
            width, height = size_of(frame)
            problem = (
                f"the mask is {columns}x{rows} pixels, frame {frame.number} is {width}x{height}"
            )
            raise InputError(
                problem,
                where=self._where,
                cure="Draw the mask on a frame of this video, at its full size.",
            )
        found = self._detector(frame)
        corners = (
            np.clip(np.rint(found.xyxy), 0, [columns, rows, columns, rows])
            .astype(np.int64)
            .tolist()
        )
        parts = [self._region[top:bottom, left:right] for left, top, right, bottom in corners]
        return found.select(
            np.array([part.sum() >= _INSIDE * max(part.size, 1) for part in parts], np.bool_)
        )


def _read_mask(path: Path) -> Image:
    """The picture in a file, grey."""
    data = np.frombuffer(load(path), np.uint8)
    if data.size:
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    else:
        image = None
    if image is None:
        raise InputError(
            "this is not an image that can be read", where=path, cure="A mask is a PNG file, say."
        )
    return np.asarray(image, np.uint8)


def detector_parameters(name: str) -> dict[str, Any]:
    """The parameters of detector ``name`` and their defaults, those of the clean-up included."""
    if name.startswith(_NETWORK):
        return {field.name: field.default for field in fields(OnnxDetector) if field.name != "file"}
    if name not in DETECTORS:
        cure = (
            f"{did_you_mean(name, DETECTORS)} A network of your own: onnx:FILE; its boxes:"
            " --detections FILE."
        )
        if name.endswith(".onnx"):
            cure = f"Say {_NETWORK}{name}"
        else:
            cure = cure
        raise InputError(f"there is no detector {name!r}", cure=cure)
    known = {field.name: field.default for field in fields(_BUILD[name]) if field.name != "method"}
    return known | (
        {field.name: field.default for field in fields(BlobSettings)}
        if known.pop("blobs", None)
        else {}
    )


def make_detector(
    name: str,
    *,
    max_width: int = 0,
    mask: Image | Bool | str | Path | None = None,
    **parameters: Any,
) -> Detector:
    """The detector called ``name``.

    Parameters
    ----------
    name : one of `DETECTORS`, or ``onnx:`` and the file of a network.
    max_width : above 0, wider frames are shrunk to this many pixels for the search; boxes stay in
        original coordinates.
    mask : (H, W) array or image file; only boxes at least half inside its region are reported.
    parameters : fields of the detector, and of `BlobSettings` for those that clean a mask.

    Returns
    -------
    The detector.

    Raises
    ------
    InputError : an unknown name or parameter (the nearest one is suggested), or a value of another
        type or out of range.
    """
    known = detector_parameters(name)
    own = dict[str, Any]()
    blobs = dict[str, Any]()
    for key, value in parameters.items():
        if key not in known:
            raise InputError(
                f"detector {name!r} has no parameter {key!r}", cure=did_you_mean(key, known)
            )
        kind = type(known[key])
        if kind is float and type(value) is int:
            value = float(value)
        else:
            value = value
        if not isinstance(value, kind) or isinstance(value, bool) > (kind is bool):
            raise InputError(f"expected {_WORDS[kind]}, got {value!r}", where=f"detector.{key}")
        (blobs if key in BlobSettings.__dataclass_fields__ else own)[key] = value
    if blobs:
        own["blobs"] = BlobSettings(**blobs)
    if _BUILD.get(name) is SubtractorDetector:
        own["method"] = name
    if name.startswith(_NETWORK):
        own["file"] = name.removeprefix(_NETWORK)
    detector: Detector = _BUILD.get(name, OnnxDetector)(**own)
    if max_width:
        detector = Rescaled(detector, max_width)
    if mask is None:
        return detector
    return Masked(detector, mask)


def class_names(detector: Detector) -> Mapping[int, str] | None:
    """What a detector calls the classes that it tells apart, as far as it says; None for those that
    know one only.
    """
    inner, _ = _inner(detector)
    if isinstance(inner, OnnxDetector):
        return inner.names
    return None


def unsuited(detector: Detector) -> tuple[str, ...]:
    """What of a file's scene makes a detector's boxes doubtful, in sentences, as far as it has
    learned it.
    """
    inner, _ = _inner(detector)
    if isinstance(inner, ChangeDetector):
        return inner.unsuited()
    return ()


def _inner(detector: Detector) -> tuple[Detector, Rescaled | None]:
    """The detector that looks at pictures, and what shrinks them for it."""
    small = None
    while isinstance(detector, Rescaled | Masked):
        if isinstance(detector, Rescaled):
            small = detector
        else:
            small = small
        if isinstance(detector, Rescaled):
            detector = detector.detector
        else:
            detector = detector._detector
    return detector, small


def looked_at(
    detector: Detector, frames: Iterable[Frame]
) -> Iterator[tuple[Frame, Detections, float]]:
    """Each frame with what ``detector`` sees in it, and in how many seconds; a network may look at
    several in one call.

    Where the frames end in an error, those before it come first.
    """
    if isinstance(detector, OnnxDetector):
        network = detector
    else:
        network = None
    iterator = iter(frames)
    stop = None
    most = network.together if network else 1
    while stop is None:
        batch = list[Frame]()
        try:
            while len(batch) < most:
                batch.append(next(iterator))
        except Exception as error:
            stop = error
        clock = time.perf_counter()
        if network:
            found = network.many(batch)
        else:
            found = [detector(frame) for frame in batch]
        seconds = (time.perf_counter() - clock) / max(len(batch), 1)
        yield from ((frame, one, seconds) for frame, one in zip(batch, found, strict=True))
    if not isinstance(stop, StopIteration):
        raise stop


def prepared(detector: Detector, frames: Iterable[Frame]) -> Iterator[Frame]:
    """The frames, with the planes that the detector will ask for, where it is one that looks at
    planes.

    To be used in the thread that decodes: the detector's has enough to do.
    """
    inner, small = _inner(detector)
    for frame in frames:
        if isinstance(inner, ChangeDetector) and not isinstance(frame.picture, np.ndarray):
            frame.picture.prepare(size_of(frame) if small is None else small.size(frame))
        yield frame


def pose_of(detector: Detector, frame: Frame) -> F8:
    """(3, 3) from pixels of the scene to those of a detector's last frame, `types.STILL` where the
    camera does not shake.
    """
    inner, small = _inner(detector)
    if isinstance(inner, ChangeDetector):
        pose = inner.pose
    else:
        pose = STILL
    if small is None or not len(pose):
        return pose
    scale = np.diag([*np.divide(size_of(frame), small.size(frame)), 1.0])
    return np.asarray(scale @ pose @ np.linalg.inv(scale))


def knowledge(detector: Detector) -> dict[str, Any] | None:
    """What a detector has learned of the scene, as `state.to_bytes` takes it, for `restore`.

    Empty for those that learn nothing, None for those of which it cannot be had.
    """
    match detector:
        case Rescaled():
            return knowledge(detector.detector)
        case Masked():
            return knowledge(detector._detector)
        case SubtractorDetector():
            return None
        case ChangeDetector() | MeanBackgroundDetector():
            known = {name: value for name, value in vars(detector).items() if name.startswith("_")}
            return {name: value for name, value in known.items() if name not in _NEVER_KEPT}
    return {}


def study(
    detector: Detector,
    frames: Iterable[Frame],
    sample: Callable[[int], Iterable[Frame]] = lambda count: (),
) -> None:
    """Let a detector that learns the scene see some 50 frames of a file before its first one.

    They are spread over all of it where it can jump to as many places, or to half as many. Else
    they are spread over a short file, or over as much of the beginning of a long one as is decoded
    in some seconds. Fewer than 7 are not enough.

    Parameters
    ----------
    detector : is changed where it learns the scene; for others no frame is read.
    frames : those of the file.
    sample : so many of them, as `video.VideoSource.sample` gives them.
    """
    detector, small = _inner(detector)
    if not isinstance(detector, ChangeDetector):
        return

    def seen(frame: Frame) -> Frame:
        if small is None:
            frame = frame
        else:
            frame = small.shrunk(frame)
        return Frame(frame.number, frame.time, Planar(size_of(frame), planes_of(frame.picture)))

    for count in (_SAMPLES, _SAMPLES // 2):
        kept = list[Frame]()
        # What is wrong with a frame is said when it is its turn.
        with suppress(InputError, OSError):
            kept.extend(map(seen, sample(count)))
        if len(kept) == count:
            break
    else:
        kept = _thinned(frames, seen)
    number = min(_SAMPLES, len(kept) - 1 + len(kept) % 2)
    if number >= _FEWEST_SAMPLES:
        # The others are not kept while it learns.
        kept = [kept[k] for k in np.linspace(0, len(kept) - 1, number).round().astype(int)]
        kept.reverse()
        # Each is forgotten when the detector has what it needs of it.
        detector.study(kept.pop() for _ in range(number))


def _thinned(frames: Iterable[Frame], seen: Callable[[Frame], Frame]) -> list[Frame]:
    """Frames as far as they are decoded quickly, evenly spaced, as they are ``seen``; between 51
    and 102 of many.
    """
    kept = list[Frame]()
    every = 1
    pixels = 0
    with suppress(InputError, OSError):
        for count, frame in enumerate(frames):
            width, height = size_of(frame)
            pixels += width * height
            if count % every == 0:
                kept.append(seen(frame))
            if len(kept) > 2 * _SAMPLES:
                kept = kept[::2]
                every = 2 * every
            if pixels > _QUICKLY:
                break
    return kept


def restore(detector: Detector, known: dict[str, Any], frame: Frame) -> None:
    """Give a detector the `knowledge` that one like it had.

    Parameters
    ----------
    detector : is changed.
    known : from `knowledge`.
    frame : any frame of the sequence: arrays have to be of the shapes and types that it brings.

    Raises
    ------
    InputError : it is not the knowledge of such a detector, or of frames of another size.
    """
    inner, _ = _inner(detector)
    if not (isinstance(inner, ChangeDetector) and inner.studied):
        detector.reset()
        detector(frame)
    usual = knowledge(inner)
    if (
        usual is None
        or usual.keys() != known.keys()
        or not all(_alike(known[name], usual[name]) for name in usual)
    ):
        raise InputError(
            "what the detector knew is not that of this detector, or of frames of another size"
        )
    vars(inner).update(known)


def _alike(value: Any, usual: Any) -> bool:
    """Whether a value is of the type and shape of another one, and such that it can be squared."""
    if isinstance(usual, np.ndarray):
        same = (
            isinstance(value, np.ndarray)
            and value.dtype == usual.dtype
            and value.shape == usual.shape
        )
        return same and (value.dtype.kind != "f" or bool((np.abs(value) < _LARGEST).all()))
    if isinstance(usual, list | tuple):
        same = type(value) is type(usual) and (isinstance(usual, list) or len(value) == len(usual))
        return same and len(value) > 0 and all(_alike(one, usual[0]) for one in value)
    return type(value) is type(usual) and -_LARGEST < value < _LARGEST
