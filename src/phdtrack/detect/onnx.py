"""A network in an ONNX file as a detector (``onnx:FILE``).

What its outputs mean is recognised by their shapes, by its metadata, and by what it gives for a
grey picture:

* (1, 4 + C, N) or (1, N, 5 + C), YOLO: centre, size, maybe objectness, scores of C classes.
  Overlapping boxes are removed.
* (1, N, 6), end to end: left, top, right, bottom, score, class.
* Boxes (N, 4) or (1, N, 4) beside scores and labels: corners as torchvision and RT-DETR have them,
  top before left as TensorFlow's ``detection_boxes``.
* Centred boxes beside scores (1, N, C) of all classes, as DETR, RT-DETR and RF-DETR: the largest
  after the sigmoid, or after the softmax where the last class is "no object".

Boxes are in pixels of the input, or shares of it: the latter where no number is above 2. The frame
is scaled into the input with its aspect kept and grey beside it; boxes come back in pixels of the
frame, cut at its border.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phdtrack.errors import (
    Count,
    InputError,
    PositiveCount,
    Probability,
    check,
    did_you_mean,
    needed,
)
from phdtrack.files import load
from phdtrack.types import F8, Detections, Frame, Image

Array = NDArray[Any]
# Boxes (N, 4), scores (N,) and classes (N,) by the outputs for one picture.
Decode = Callable[[Sequence[Array]], tuple[Array, Array, Array]]

_PROVIDERS = ("CUDAExecutionProvider", "DmlExecutionProvider", "CPUExecutionProvider")
_TYPES: Mapping[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
}
_CHOICES = {"layout": ("yolov5", "yolov8", "end2end"), "pixels": ("unit", "bytes", "imagenet")}
_GREY = 114
_SIZE = 640
_STRIDE = 32
_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)
# Shares of the input reach a little over 1. More rows than a network has that removes overlapping
# boxes itself; boxes of a frame among which they are looked for.
_SHARES = 2.0
_MOST_ROWS = 1000
_MOST = 3000
_PICTURE = (
    "One picture is understood: (1, 3, height, width) or (1, height, width, 3) of float32, float16"
    " or uint8."
)
_UNDERSTOOD = (
    "Understood are (1, 4 + classes, N), (1, N, 5 + classes) in pixels (YOLOX:"
    " decode_in_inference), (1, N, 6), and boxes (N, 4) beside scores and labels, or all scores."
    " Try detector.layout=yolov5, yolov8 or end2end, or --detections FILE."
)


class _Layout(NamedTuple):
    """What the outputs mean. ``classes``: how many, 0 where that is not known; ``overlapping``: an
    object has several boxes; ``batched``: outputs have an axis for pictures; ``pixels``: what was
    usual when such a network was trained."""

    decode: Decode
    classes: int
    overlapping: bool
    batched: bool = True
    pixels: str = "unit"


class _Input(NamedTuple):
    """The picture that the network takes. Lengths are 0 where they may be any; ``batch`` is -1
    without such an axis.
    """

    name: str
    batch: int
    height: int
    width: int
    channels_last: bool
    dtype: Any


class _Placed(NamedTuple):
    """A frame in a tensor: its pixel x is ``scale`` x + ``offset`` there. ``size`` is (width,
    height).
    """

    tensor: Array
    size: F8
    scale: F8
    offset: F8


@dataclass(eq=False)
class OnnxDetector:
    """Boxes that a network of the user's finds; it remembers nothing.

    Attributes
    ----------
    file : the network.
    confidence : least score.
    overlap : of two boxes of a class with a larger intersection over union only the one with the
        higher score is kept, where the network does not see to that; 1: both are.
    classes : names or numbers of the classes that are reported, with commas; empty: all.
    layout : of the outputs, yolov5, yolov8 or end2end, where it is not recognised.
    pixels : unit (0 to 1), bytes (0 to 255) or imagenet (mean 0, deviation 1); empty: unit, for
        DETR and RF-DETR imagenet.
    bgr : the network takes blue before red.
    stretch : the frame fills the input, and its aspect changes.
    size : longer side of the input in pixels, where it may be any; 0: what the metadata says, or
        640.
    batch : frames of a file that are looked at in one call, where there may be several.
    threads : of the network; 0: all cores.
    """

    file: str
    confidence: Probability = 0.25
    overlap: Probability = 0.7
    classes: str = ""
    layout: str = ""
    pixels: str = ""
    bgr: bool = False
    stretch: bool = False
    size: Count = 0
    batch: PositiveCount = 1
    threads: Count = 0

    def __post_init__(self) -> None:
        check(self)
        for name, known in _CHOICES.items():
            if (value := getattr(self, name)) and value not in known:
                raise InputError(
                    f"expected {', '.join(known)}, got {value!r}", where=f"detector.{name}"
                )
        self._session = _opened(Path(self.file), self.threads)
        said: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        named, sides, stride = (
            _literal(said.get(name, "")) for name in ("names", "imgsz", "stride")
        )
        if isinstance(named, list | tuple):
            named = dict(enumerate(named))
        else:
            named = named
        self.class_names: Mapping[int, str] = {}
        if isinstance(named, dict) and all(type(key) is int for key in named):
            self.class_names = {key: str(value) for key, value in named.items()}
        if isinstance(sides, list | tuple):
            sides = [side for side in sides if type(side) is int]
        else:
            sides = []
        self._longer = self.size or max(sides, default=_SIZE)
        if type(stride) is int and stride > 0:
            self._stride = stride
        else:
            self._stride = _STRIDE
        self._input, self._more = self._inputs()
        if self.size and self._input.width and self._input.height:
            problem = (
                f"the network takes pictures of {self._input.width}x{self._input.height} pixels"
                " only"
            )
            raise InputError(problem, where="detector.size", cure="Leave it out.")
        self._layout = self._recognised(said.get("task", ""))
        coco = Path(__file__).with_name("coco.txt").read_text(encoding="utf-8").splitlines()
        if not self.class_names and self._layout.classes == len(coco):
            self.class_names = dict(enumerate(coco))
        self._wanted = [
            self._code(word.strip()) for word in self.classes.split(",") if word.strip()
        ]

    @property
    def batch_size(self) -> int:
        """How many frames are looked at in one call."""
        if self._layout.batched and self._input.batch >= 0:
            return self._input.batch or self.batch
        return 1

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """What the network finds in ``frame``, the highest score first."""
        return self.detect_batch([frame])[0]

    def detect_batch(self, frames: Sequence[Frame]) -> list[Detections]:
        """What it finds in each of the frames."""
        placed = [self._place(frame.image) for frame in frames]
        if len({one.tensor.shape for one in placed}) == 1:
            step = self.batch_size
        else:
            step = 1
        outputs = [
            one
            for first in range(0, len(frames), step)
            for one in self._run(placed[first : first + step])
        ]
        return [
            self._detections(*one)
            for one in zip((frame.image for frame in frames), placed, outputs, strict=True)
        ]

    def _detections(self, image: Image, placed: _Placed, outputs: Sequence[Array]) -> Detections:
        """What the outputs say of a frame."""
        xyxy, score, label = self._layout.decode(outputs)
        good = (score >= self.confidence) & np.isfinite(xyxy).all(axis=1)
        rows = np.flatnonzero(good & np.isin(label, self._wanted) if self._wanted else good)
        rows = rows[np.argsort(-score[rows], kind="stable")]
        shares = bool(len(xyxy)) and float(np.abs(xyxy).max()) <= _SHARES
        boxes = xyxy[rows].astype(np.float64) * (np.tile(placed.size, 2) if shares else 1.0)
        found = Detections(boxes, score[rows].astype(np.float64), label[rows].astype(np.int64))
        if self._layout.overlapping and self.overlap < 1 and len(found) > 1:
            found = found.select(np.arange(min(len(found), _MOST)))
            ltwh = np.hstack([found.xyxy[:, :2], found.xyxy[:, 2:] - found.xyxy[:, :2]])
            scores = found.confidence.tolist()
            kinds = found.class_id.tolist()
            kept = cv2.dnn.NMSBoxesBatched(ltwh.tolist(), scores, kinds, 0.0, self.overlap)
            found = found.select(np.sort(np.array(kept, np.int64)))
        border = np.array([image.shape[1], image.shape[0]] * 2, np.float64)
        boxes = np.clip(
            (found.xyxy - np.tile(placed.offset, 2)) / np.tile(placed.scale, 2), 0.0, border
        )
        sized = np.flatnonzero((boxes[:, 2:] > boxes[:, :2]).all(axis=1))
        return Detections(boxes, found.confidence, found.class_id).select(sized)

    def _place(self, image: Image) -> _Placed:
        """The frame as the network takes it."""
        taken = self._input
        size = np.array([image.shape[1], image.shape[0]])
        fitting = np.array([taken.width or self._longer, taken.height or self._longer]) / size
        inner = np.maximum(np.rint(size * (fitting if self.stretch else fitting.min())), 1).astype(
            np.int64
        )
        # Where any size is taken there is no more grey than the stride asks for.
        needed = -(-inner // self._stride) * self._stride
        whole = np.array([taken.width or needed[0], taken.height or needed[1]])
        left, top = ((whole - inner) // 2).tolist()
        canvas = np.full((whole[1], whole[0], 3), _GREY, np.uint8)
        scaled = cv2.resize(image, inner.tolist(), interpolation=cv2.INTER_LINEAR)
        canvas[top : top + inner[1], left : left + inner[0]] = scaled
        whole_numbers = taken.dtype == np.uint8
        pixels = self.pixels or self._layout.pixels
        factor, depth = (
            (1.0, cv2.CV_8U)
            if whole_numbers
            else (1.0 if pixels == "bytes" else 1 / 255, cv2.CV_32F)
        )
        values: Array = cv2.dnn.blobFromImage(canvas, factor, swapRB=not self.bgr, ddepth=depth)[0]
        if pixels == "imagenet" and not whole_numbers:
            mean, deviation = (
                one[:: -1 if self.bgr else 1, None, None] for one in (_MEAN, _DEVIATION)
            )
            values = (values - mean) / deviation
        if taken.channels_last:
            values = values.transpose(1, 2, 0)
        else:
            values = values
        tensor = np.ascontiguousarray(values, taken.dtype)
        offset = np.array([left, top], np.float64)
        return _Placed(tensor, whole.astype(np.float64), inner / size, offset)

    def _run(self, placed: Sequence[_Placed]) -> list[list[Array]]:
        """Of each picture the outputs, without their axis for pictures if they have one."""
        batch, missing = (
            np.stack([one.tensor for one in placed]),
            max(self._input.batch - len(placed), 0),
        )
        if missing:
            batch = np.concatenate([batch, np.zeros((missing, *batch.shape[1:]), batch.dtype)])
        else:
            batch = batch
        feed: dict[str, Array] = {self._input.name: batch[0] if self._input.batch < 0 else batch}
        width, height = placed[0].size
        for name in self._more:
            # The size of the picture that boxes are wanted for; or which of its pixels are to be
            # looked at.
            if "size" in name:
                fill = np.array([width, height])
            else:
                fill = np.ones((int(height), int(width)))
            feed[name] = np.tile(fill.astype(np.int64), (len(batch), *[1] * fill.ndim))
        try:
            outputs: list[Array] = self._session.run(None, feed)
        except Exception as error:
            raise InputError(f"the network failed: {_said(error)}", where=self.file) from error
        return [
            [array[k] if self._layout.batched else array for array in outputs]
            for k in range(len(placed))
        ]

    def _inputs(self) -> tuple[_Input, list[str]]:
        """The picture, and the names of what else the network takes."""
        given = [*self._session.get_inputs()]
        pictures = [one for one in given if one.type in _TYPES and len(one.shape) in (3, 4)]
        more = [
            one.name
            for one in given
            if one.type == "tensor(int64)" and re.search("size|mask", one.name)
        ]
        if len(pictures) == 1 and len(more) == len(given) - 1:
            sides = [
                side if isinstance(side, int) and side > 0 else 0 for side in pictures[0].shape
            ]
            batch, sides = (sides[0], sides[1:]) if len(sides) == 4 else (-1, sides)
            last = sides[0] != 3 and sides[2] == 3
            channels, height, width = (sides[2], *sides[:2]) if last else sides
            if channels in (0, 3):
                return (
                    _Input(pictures[0].name, batch, height, width, last, _TYPES[pictures[0].type]),
                    more,
                )
        raise InputError(
            f"its inputs are not recognised: {_listed(given)}", where=self.file, cure=_PICTURE
        )

    def _recognised(self, task: str) -> _Layout:
        """What the outputs mean, by those for a grey picture. Raises `InputError` where that is not
        known.
        """
        self._layout = _Layout(partial(_end_to_end, 0), 0, False, False)
        grey = self._place(np.full((self._longer, self._longer, 3), _GREY, np.uint8))
        names = [one.name for one in self._session.get_outputs()]
        found = dict(zip(names, self._run([grey])[0], strict=True))
        layout = None
        if task not in ("obb", "classify"):
            layout = _of_one([*found.values()], self.layout, len(self.class_names), task)
            layout = layout or (
                None if self.layout else _of_several(found, self._input.channels_last)
            )
        if layout is None:
            got = ", ".join(f"{name} {one.dtype} {one.shape}" for name, one in found.items())
            got += f"; inputs: {_listed(self._session.get_inputs())}" + (
                f"; task: {task}" if task else ""
            )
            raise InputError(
                f"its outputs are not recognised: {got}", where=self.file, cure=_UNDERSTOOD
            )
        return layout

    def _code(self, word: str) -> int:
        """The number of a class. Raises `InputError` where there is none of this name."""
        codes = {name.lower(): code for code, name in self.class_names.items()}
        code = codes.get(word.lower(), int(word) if word.isdecimal() else -1)
        if code < 0 or (self.class_names and code not in self.class_names):
            if self.class_names:
                cure = did_you_mean(word, self.class_names.values())
            else:
                cure = "It does not name them: give numbers."
            raise InputError(
                f"the network has no class {word}", where="detector.classes", cure=cure
            )
        return code


def _opened(path: Path, threads: int) -> Any:
    """The network, ready to run. Raises `InputError` where the package is missing, or the file is
    none.
    """
    runtime = needed("onnxruntime")
    if not path.is_file():
        load(path)  # says what is there instead
    options = runtime.SessionOptions()
    there = runtime.get_available_providers()
    options.log_severity_level = 4
    options.intra_op_num_threads = threads
    try:
        return runtime.InferenceSession(
            str(path), options, providers=[one for one in _PROVIDERS if one in there]
        )
    except Exception as error:
        problem = (
            f"expected a network that onnxruntime {runtime.__version__} can run: {_said(error)}"
        )
        raise InputError(problem, where=path, cure="Is it an ONNX file, and complete?") from error


def _said(error: Exception) -> str:
    """The first sentence of an error of onnxruntime, without its code."""
    return (
        " ".join(str(error).split("\n")[0].rpartition(" : ")[2].split())[:200]
        or type(error).__name__
    )


def _literal(text: str) -> Any:
    """A list, dictionary or number in the metadata; None where it is none."""
    with suppress(ValueError, SyntaxError, RecursionError, MemoryError):
        if text:
            return ast.literal_eval(text)
        return None


def _listed(given: Sequence[Any]) -> str:
    """Names, types and shapes."""
    return ", ".join(f"{one.name} {one.type} ({', '.join(map(str, one.shape))})" for one in given)


def _of_one(outputs: Sequence[Array], layout: str, names: int, task: str) -> _Layout | None:
    """The layout of a network with everything in one output of three axes, by its outputs for a
    grey picture, what the user says, how many ``names`` the metadata has, and its task; None: it is
    none."""
    main = [k for k, one in enumerate(outputs) if one.ndim == 3]
    if len(main) != 1 or any(one.ndim < 3 for one in outputs):
        return None
    (place,) = main
    high, wide = outputs[main[0]].shape[1:]
    # Masks and points of the body stand behind the scores. The sixth number of a row is a class, or
    # the score of one.
    more = task in ("segment", "pose")
    ended = (
        (wide == 6 or (more and 6 < wide < high))
        and high <= _MOST_ROWS
        and not (outputs[place][..., 5] % 1).any()
    )
    if layout == "end2end" or (ended and not layout):
        if wide >= 6:
            return _Layout(partial(_end_to_end, place), names, False)
        return None
    if names and not layout and wide == 4 + names and high != 4 + names:
        # Queries of an RT-DETR, or the cells of a YOLO.
        return _Layout(partial(_grid, place, True, 0, names), names, high > _MOST_ROWS)
    if names and not more:
        flat = high == 4 + names or (high < wide and wide != 5 + names)
    else:
        flat = high < wide
    if layout == "yolov8" or (flat and not layout):
        if more and names:
            classes = names
        else:
            classes = high - 4
        if high > 4:
            return _Layout(partial(_grid, place, False, 0, classes), classes, True)
        return None
    # Sizes below 0 are logarithms.
    decoded = wide > 5 and not (outputs[place][..., 2:4] < 0).any()
    if decoded:
        return _Layout(partial(_grid, place, True, 1, wide - 5), wide - 5, True)
    return None


def _of_several(found: Mapping[str, Array], channels_last: bool) -> _Layout | None:
    """The layout of a network with boxes, scores and classes apart, by its outputs for a grey
    picture; None: it is none.
    """
    fours = [name for name, one in found.items() if one.ndim in (2, 3) and one.shape[-1] == 4]
    boxes = next((name for name in fours if len(fours) == 1 or _has(name, "box")), "")
    if not boxes:
        return None
    place = {name: k for k, name in enumerate(found)}
    shape = found[boxes].shape
    batched = found[boxes].ndim == 3
    lists = [
        name for name, one in found.items() if one.shape == shape[:-1] and not _has(name, "num")
    ]
    labels = [name for name in lists if found[name].dtype.kind in "iu" or _has(name, "label|class")]
    if len(lists) - len(labels) == 1 and len(labels) <= 1:
        if channels_last or _has(boxes, "detection_boxes"):
            order = [1, 0, 3, 2]
        else:
            order = [0, 1, 2, 3]
        scores = next(name for name in lists if name not in labels)
        places = place[boxes], place[scores], place[labels[0]] if labels else -1
        return _Layout(partial(_apart, places, order), 0, False, batched)
    tables = [
        name
        for name, one in found.items()
        if one.ndim == len(shape) and one.shape[:-1] == shape[:-1] and name != boxes
    ]
    if len(tables) == 1:
        tables = tables
    else:
        tables = [name for name in tables if _has(name, "logit|label|class|score|conf|prob")]
    if len(tables) != 1 or not found[boxes].size:
        return None
    table = found[tables[0]].astype(np.float64)
    corners = found[boxes].reshape(-1, 4)
    if not _has(boxes, "pred_boxes|dets") and (corners[:, 2:] >= corners[:, :2]).all():
        return None
    # A grey picture shows nothing. Where the last class is the largest all over, it says so.
    logits = bool(table.min() < 0 or table.max() > 1)
    last = table.shape[-1] - 1
    nothing = (
        logits and (table.argmax(axis=-1) == last).mean() > 0.9 and np.median(table[..., last]) > 0
    )
    decode = partial(_queries, (place[boxes], place[tables[0]]), logits, bool(nothing))
    return _Layout(
        decode,
        last + (not nothing),
        False,
        batched,
        "imagenet" if nothing or _has(boxes, "dets") else "unit",
    )


def _has(name: str, words: str) -> bool:
    """Whether one of the words is part of a name."""
    return re.search(words, name.lower()) is not None


def _end_to_end(place: int, outputs: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Of rows of left, top, right, bottom, score, class."""
    rows = outputs[place].astype(np.float32)
    return rows[:, :4], rows[:, 4], rows[:, 5]


def _grid(
    place: int, upright: bool, more: int, classes: int, outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Of rows, or columns where not ``upright``, of centre, size, objectness if there is one
    ``more``, and scores.
    """
    rows = (outputs[place] if upright else outputs[place].T).astype(np.float32, copy=False)
    table = rows[:, 4 + more : 4 + more + classes]
    label = table.argmax(axis=1)
    return (
        _corners(rows[:, :4]),
        table[np.arange(len(rows)), label] * (rows[:, 4] if more else 1),
        label,
    )


def _apart(
    places: tuple[int, int, int], order: list[int], outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Of boxes with their numbers in this order, scores, and labels, if any."""
    boxes, score = (outputs[place].astype(np.float32) for place in places[:2])
    return (
        boxes[:, order],
        score,
        outputs[places[2]] if places[2] >= 0 else np.zeros(len(score), np.int64),
    )


def _queries(
    places: tuple[int, int], logits: bool, nothing: bool, outputs: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Of centred boxes and scores of all classes, the last of which may be "no object"."""
    boxes, table = (outputs[place].astype(np.float64) for place in places)
    if logits:
        from scipy.special import expit, softmax  # takes long to import

        if nothing:
            table = softmax(table, axis=1)[:, :-1]
        else:
            table = expit(table)
    return _corners(boxes), table.max(axis=1), table.argmax(axis=1)


def _corners(centred: Array) -> Array:
    """Left, top, right, bottom of centres and sizes (N, 4)."""
    half = centred[:, 2:] / 2
    return np.hstack([centred[:, :2] - half, centred[:, :2] + half])
