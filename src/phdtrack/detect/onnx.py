"""A network in an ONNX file as a detector (``onnx:FILE``); `onnx_recognition` finds out what its
outputs mean, `onnx_layouts` reads them.

Boxes are in pixels of the input, or in shares of it if no number is above 2. The frame is scaled
into the input with its aspect kept and grey around it, or stretched if such networks are trained
so; boxes are in pixels of the frame, cut at its border.
"""

from __future__ import annotations

import ast
import logging
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.detect.onnx_layouts import LAYOUTS, Array, Layout, of_picture, unbatched
from phdtrack.detect.onnx_recognition import (
    MAX_SHARE,
    SCORE_TOLERANCE,
    Probe,
    obstacle,
    recognise,
)
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
from phdtrack.opencv_package import cv2
from phdtrack.types import F8, Detections, Frame, Image

_LOG = logging.getLogger(__name__)
_PROVIDERS = ("CUDAExecutionProvider", "DmlExecutionProvider", "CPUExecutionProvider")
INPUT_TYPES: Mapping[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
}
_PIXELS = ("unit", "bytes", "imagenet", "signed")
# Further inputs of PaddleDetection: the size of the input, and the scale of the picture in it.
_PADDLE_INPUTS = ("im_shape", "scale_factor")
_GREY = 114
_DEFAULT_SIDE = 640
_DEFAULT_STRIDE = 32
# Mean and standard deviation of the colours of ImageNet.
IMAGENET_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
IMAGENET_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)
# Boxes per frame that non-maximum suppression considers.
_MAX_CANDIDATES = 3000
# Characters of an error message of onnxruntime that are repeated.
_MAX_MESSAGE = 200
_SUPPORTED_INPUTS = (
    "The network must take one picture, (1, 3, height, width) or (1, height, width, 3), of float32,"
    " float16 or uint8."
)
_SUPPORTED_OUTPUTS = (
    "Supported are (1, 4 + classes, N), (1, N, 5 + classes) in pixels, (1, N, 6), and boxes (N, 4)"
    " with labels and scores, or with scores of all classes. Scores must be between 0 and 1. Try"
    f" detector.layout={', '.join(LAYOUTS[:-1])} or {LAYOUTS[-1]}, or --detections FILE."
)
_OTHER_LAYOUT = (
    f"If the boxes are wrong, choose detector.layout ({', '.join(LAYOUTS[:-1])} or {LAYOUTS[-1]}),"
    " detector.pixels, detector.bgr or detector.stretch, or use --detections FILE."
)
_PIXEL_WORDS: Mapping[str, str] = {
    "unit": "from 0 to 1",
    "bytes": "from 0 to 255",
    "signed": "from -1 to 1",
    "imagenet": "with mean 0 and deviation 1",
}
# Confident boxes of one frame, of which most may not have right left of left.
_MIN_BOXES_TO_JUDGE = 3
# Endings of files with weights that need their own package.
_WEIGHTS = (".pt", ".pth", ".ckpt", ".safetensors")
# Numbers of COCO's categories that the 80 classes leave out, of networks that count to 90.
_COCO_GAPS = (0, 12, 26, 29, 30, 45, 66, 68, 69, 71, 83)


class _Input(NamedTuple):
    """The picture that a network takes. Sides are 0 if any length is accepted; ``batch`` is -1
    without such an axis.
    """

    name: str
    batch: int
    height: int
    width: int
    channels_last: bool
    dtype: Any


class _Letterbox(NamedTuple):
    """A frame in an input tensor: frame pixel x is input pixel ``scale`` x + ``offset``. ``size``
    is the (width, height) of the input.
    """

    tensor: Array
    size: F8
    scale: F8
    offset: F8


@dataclass(eq=False)
class OnnxDetector:
    """Boxes found by the user's own network. It learns nothing from frames.

    Attributes
    ----------
    file : the network.
    confidence : least score.
    overlap : of two boxes of one class with a larger intersection over union only the one with the
        higher score is kept, unless the network does so itself; 1: both are kept.
    classes : names or numbers of the classes to report, separated by commas; empty: all.
    layout : of the outputs, one of `onnx_layouts.LAYOUTS`, if the recognised one is wrong.
    pixels : unit (0 to 1), bytes (0 to 255), signed (-1 to 1) or imagenet (mean 0, deviation 1);
        empty: unit, for DETR and RF-DETR imagenet, for YOLOX bytes with blue before red.
    bgr : the network takes blue before red; None: as usual for such networks.
    stretch : stretch the frame to fill the input, without keeping its aspect; None: as usual for
        such networks.
    size : longer side of the input in pixels, if any is accepted; 0: as the metadata states, or
        640.
    batch : frames of a file per call, if the network accepts several.
    threads : of the network; 0: all cores.
    """

    file: str
    confidence: Probability = 0.25
    overlap: Probability = 0.7
    classes: str = ""
    layout: str = ""
    pixels: str = ""
    bgr: bool | None = None
    stretch: bool | None = None
    size: Count = 0
    batch: PositiveCount = 1
    threads: Count = 0

    def __post_init__(self) -> None:
        check(self)
        for name, value, known in (
            ("layout", self.layout, LAYOUTS),
            ("pixels", self.pixels, _PIXELS),
        ):
            if value and value not in known:
                raise InputError(
                    f"expected {', '.join(known)}, got {value!r}", where=f"detector.{name}"
                )
        self._session = open_network(Path(self.file), self.threads)
        metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        self.class_names: Mapping[int, str] = _class_names(literal(metadata.get("names", "")))
        sides = literal(metadata.get("imgsz", ""))
        if not isinstance(sides, list | tuple):
            sides = []
        known_sides = [side for side in sides if type(side) is int]
        self._longer_side = self.size or max(known_sides, default=_DEFAULT_SIDE)
        self._stride = _DEFAULT_STRIDE
        stride = literal(metadata.get("stride", ""))
        if type(stride) is int and stride > 0:
            self._stride = stride
        self._input, self._other_inputs = self._inputs()
        if self.size and self._input.width and self._input.height:
            raise InputError(
                f"the network only takes pictures of {self._input.width}x{self._input.height}"
                " pixels",
                where="detector.size",
                cure="Leave it out.",
            )
        self.output_layout = unbatched()
        self.output_layout = self._recognised(metadata)
        named = bool(self.class_names)
        if not named:
            self.class_names = _coco_names(self.output_layout.classes)
        self._sentences = tuple(self._guesses(named=named))
        self._untold = list(self._sentences)
        words = [word.strip() for word in self.classes.split(",")]
        self._wanted = [self._class_id(word) for word in words if word]
        _LOG.info(self._description())

    @property
    def batch_size(self) -> int:
        """Frames per call."""
        if self.output_layout.batched and self._input.batch >= 0:
            return self._input.batch or self.batch
        return 1

    def guesses(self) -> tuple[str, ...]:
        """Sentences about what was guessed. The caller shows them; otherwise they are logged with
        the first frame.
        """
        self._untold.clear()
        return self._sentences

    def reset(self) -> None:
        """Do nothing: there is nothing to forget."""

    def __call__(self, frame: Frame) -> Detections:
        """The boxes that the network finds in ``frame``, highest score first."""
        return self.detect_batch([frame])[0]

    def detect_batch(self, frames: Sequence[Frame]) -> list[Detections]:
        """The boxes that the network finds in each of the frames."""
        while self._untold:
            _LOG.warning(self._untold.pop(0))
        inputs = [self.letterbox(frame.image) for frame in frames]
        step = 1
        if len({one.tensor.shape for one in inputs}) == 1:
            step = self.batch_size
        outputs = list[list[Array]]()
        for first in range(0, len(frames), step):
            outputs += self._run(inputs[first : first + step])
        return [
            self._detections(frame, one, arrays)
            for frame, one, arrays in zip(frames, inputs, outputs, strict=True)
        ]

    def _detections(
        self, frame: Frame, letterbox: _Letterbox, outputs: Sequence[Array]
    ) -> Detections:
        """The detections in a frame, given the network's outputs. Raises `InputError` if these
        cannot have the meaning that they are read with.
        """
        xyxy, score, label = self.output_layout.decode(outputs)
        # Rows without a meaning have a class below 0.
        good = (score >= self.confidence) & (label >= 0) & np.isfinite(xyxy).all(axis=1)
        self._check(frame, xyxy[good], score)
        if self._wanted:
            good &= np.isin(label, self._wanted)
        rows = np.flatnonzero(good)
        rows = rows[np.argsort(-score[rows], kind="stable")]
        boxes = xyxy[rows].astype(np.float64)
        shares = self.output_layout.shares
        if shares is None:
            shares = len(xyxy) > 0 and float(np.abs(xyxy).max()) <= MAX_SHARE
        if shares:
            boxes = boxes * np.tile(letterbox.size, 2)
        found = Detections(boxes, score[rows].astype(np.float64), label[rows].astype(np.int64))
        if self.output_layout.overlapping and self.overlap < 1 and len(found) > 1:
            found = _suppressed(found, self.overlap)
        border = np.array([frame.image.shape[1], frame.image.shape[0]] * 2, np.float64)
        boxes = (found.xyxy - np.tile(letterbox.offset, 2)) / np.tile(letterbox.scale, 2)
        boxes = np.clip(boxes, 0.0, border)
        nonempty = np.flatnonzero((boxes[:, 2:] > boxes[:, :2]).all(axis=1))
        return Detections(boxes, found.confidence, found.class_id).select(nonempty)

    def _check(self, frame: Frame, confident: Array, score: Array) -> None:
        """Raise `InputError` if scores are no probabilities, or most of the confident boxes are
        inside out.
        """
        problem = ""
        cure = _OTHER_LAYOUT
        highest = float(score.max(initial=0.0))
        inverted = (confident[:, 2:] < confident[:, :2]).any(axis=1)
        if highest > 1 + SCORE_TOLERANCE:
            problem = f"expected scores from 0 to 1, got {highest:.4g}"
        elif len(score) and np.isnan(score).all():
            problem = "no score is a number"
            cure = "Numbers may be too large for float16: export the network with float32."
        elif len(confident) >= _MIN_BOXES_TO_JUDGE and inverted.mean() > 0.5:
            problem = "most boxes have right left of left, or bottom above top"
        if problem:
            raise InputError(
                f"{problem}, with outputs read as {self.output_layout.name}",
                where=f"{self.file}, frame {frame.number}",
                cure=cure,
            )

    def letterbox(self, image: Image) -> _Letterbox:
        """The frame as an input of the network."""
        shape = self._input
        size = np.array([image.shape[1], image.shape[0]])
        available = np.array([shape.width or self._longer_side, shape.height or self._longer_side])
        scale = available / size
        if not self._stretched:
            scale = scale.min()
        inner = np.maximum(np.rint(size * scale), 1).astype(np.int64)
        # If any size is accepted there is no more grey than the stride requires.
        padded = -(-inner // self._stride) * self._stride
        whole = np.array([shape.width or padded[0], shape.height or padded[1]])
        left, top = ((whole - inner) // 2).tolist()
        canvas = np.full((whole[1], whole[0], 3), _GREY, np.uint8)
        scaled = cv2.resize(image, inner.tolist(), interpolation=cv2.INTER_LINEAR)
        canvas[top : top + inner[1], left : left + inner[0]] = scaled
        values = self._normalised(canvas)
        if shape.channels_last:
            values = values.transpose(1, 2, 0)
        return _Letterbox(
            np.ascontiguousarray(values, shape.dtype),
            whole.astype(np.float64),
            inner / size,
            np.array([left, top], np.float64),
        )

    @property
    def _blue_first(self) -> bool:
        """True if the network takes blue before red. A scale that the user chose means that the
        usual order of such networks is not meant either.
        """
        if self.bgr is not None:
            return self.bgr
        return not self.pixels and self.output_layout.bgr

    @property
    def _stretched(self) -> bool:
        """True if frames fill the input without their aspect."""
        if self.stretch is not None:
            return self.stretch
        return self.output_layout.stretch

    def _normalised(self, canvas: Image) -> Array:
        """(3, H, W) the colours of a picture as the network takes them."""
        if self._input.dtype == np.uint8:
            return np.asarray(
                cv2.dnn.blobFromImage(canvas, swapRB=not self._blue_first, ddepth=cv2.CV_8U)[0]
            )
        pixels = self.pixels or self.output_layout.pixels
        factor = 1.0 if pixels == "bytes" else 1 / 255
        values: Array = cv2.dnn.blobFromImage(
            canvas, factor, swapRB=not self._blue_first, ddepth=cv2.CV_32F
        )[0]
        if pixels == "signed":
            values = values * 2 - 1
        if pixels == "imagenet":
            order = -1 if self._blue_first else 1
            mean = IMAGENET_MEAN[::order, None, None]
            values = (values - mean) / IMAGENET_DEVIATION[::order, None, None]
        return values

    def _run(self, inputs: Sequence[_Letterbox]) -> list[list[Array]]:
        """The outputs for each picture, without their axis for pictures if they have one."""
        batch = np.stack([one.tensor for one in inputs])
        missing = max(self._input.batch - len(inputs), 0)
        if missing:
            batch = np.concatenate([batch, np.zeros((missing, *batch.shape[1:]), batch.dtype)])
        feed: dict[str, Array] = {self._input.name: batch[0] if self._input.batch < 0 else batch}
        width, height = inputs[0].size
        for name in self._other_inputs:
            fill = _other_input(name, int(width), int(height))
            feed[name] = np.tile(fill, (len(batch), *[1] * fill.ndim))
        try:
            outputs: list[Array] = self._session.run(None, feed)
        except Exception as error:
            raise InputError(
                f"the network failed: {first_sentence(error)}", where=self.file
            ) from error
        if not self.output_layout.batched:
            return [outputs for _ in inputs]
        return [of_picture(outputs, k) for k in range(len(inputs))]

    def _inputs(self) -> tuple[_Input, list[str]]:
        """The picture, and the names of the network's other inputs."""
        inputs = [*self._session.get_inputs()]
        pictures = [one for one in inputs if one.type in INPUT_TYPES and len(one.shape) in (3, 4)]
        others = [
            one.name
            for one in inputs
            if (one.type == "tensor(int64)" and re.search("size|mask", one.name))
            or (one.type == "tensor(float)" and one.name in _PADDLE_INPUTS)
        ]
        if len(pictures) == 1 and len(others) == len(inputs) - 1:
            picture = pictures[0]
            sides = [side if isinstance(side, int) and side > 0 else 0 for side in picture.shape]
            batch = sides.pop(0) if len(sides) == 4 else -1
            channels_last = sides[0] != 3 and sides[2] == 3
            if channels_last:
                height, width, channels = sides
            else:
                channels, height, width = sides
            if channels in (0, 3):
                dtype = INPUT_TYPES[picture.type]
                return _Input(picture.name, batch, height, width, channels_last, dtype), others
        raise InputError(
            f"the network's inputs are not supported: {listed_inputs(inputs)}",
            where=self.file,
            cure=_SUPPORTED_INPUTS,
        )

    def _recognised(self, metadata: Mapping[str, str]) -> Layout:
        """The meaning of the outputs, by those for a grey picture. Raises `InputError` if it is not
        recognised.
        """
        side = self._longer_side
        grey = self.letterbox(np.full((side, side, 3), _GREY, np.uint8))
        names = [one.name for one in self._session.get_outputs()]
        outputs = dict(zip(names, self._run([grey])[0], strict=True))
        task = metadata.get("task", "")
        probe = Probe(
            outputs,
            int(grey.size[0]),
            int(grey.size[1]),
            bool(self._input.width and self._input.height),
            self.layout,
            len(self.class_names),
            task,
            metadata.get("head", "") or metadata.get("description", ""),
            self._input.channels_last,
            any("size" in name for name in self._other_inputs),
        )
        layout = recognise(probe)
        if layout is not None:
            return layout._replace(shares=_in_shares(layout, [*outputs.values()]))
        got = ", ".join(_described(name, one) for name, one in outputs.items())
        got += f"; inputs: {listed_inputs(self._session.get_inputs())}"
        if task:
            got += f"; task: {task}"
        raise InputError(
            f"the network's outputs are not recognised: {got}",
            where=self.file,
            cure=f"{obstacle(probe)} {_SUPPORTED_OUTPUTS}".strip(),
        )

    def _description(self) -> str:
        """A sentence about the layout that was recognised, and why."""
        layout = self.output_layout
        pixels = _PIXEL_WORDS[self.pixels or layout.pixels]
        if self._input.dtype == np.uint8:
            pixels = "as bytes"
        order = "blue" if self._blue_first else "red"
        shape = "stretched" if self._stretched else "with their aspect kept"
        return (
            f"{self.file}: the outputs are read as {layout.name}, by {layout.evidence}. Frames go"
            f" in {shape}, {order} first, {pixels}."
        )

    def _guesses(self, *, named: bool) -> Iterator[str]:
        """Sentences about what was guessed; ``named``: whether the metadata name the classes."""
        names = len(self.class_names)
        scored = self.output_layout.classes
        if named and scored and names != scored:
            yield (
                f"{self.file}: the metadata name {names} classes, but boxes have scores of"
                f" {scored}, so that the names may be wrong. Give them by classes.names."
            )
        if names and not named:
            yield (
                f"{self.file}: the file names no classes; its {scored} classes are called as in"
                " COCO (person, bicycle, car, …) unless classes.names gives other names."
            )
        if self.output_layout.guessed:
            yield f"{self._description()} This is a guess. {_OTHER_LAYOUT}"
        elif self.output_layout.input_doubt and not self.pixels and self._input.dtype != np.uint8:
            yield f"{self._description()} {self.output_layout.input_doubt}"

    def _class_id(self, word: str) -> int:
        """The number of a class. Raises `InputError` if there is none of this name."""
        ids = {name.lower(): number for number, name in self.class_names.items()}
        found = ids.get(word.lower(), int(word) if word.isdecimal() else -1)
        if found >= 0 and (not self.class_names or found in self.class_names):
            return found
        cure = "The network does not name its classes: give their numbers."
        if self.class_names:
            cure = did_you_mean(word, self.class_names.values())
        raise InputError(f"the network has no class {word}", where="detector.classes", cure=cure)


def _suppressed(found: Detections, overlap: float) -> Detections:
    """The detections that remain after non-maximum suppression within each class."""
    found = found.select(np.arange(min(len(found), _MAX_CANDIDATES)))
    ltwh = np.hstack([found.xyxy[:, :2], found.xyxy[:, 2:] - found.xyxy[:, :2]])
    scores = found.confidence.tolist()
    labels = found.class_id.tolist()
    kept = cv2.dnn.NMSBoxesBatched(ltwh.tolist(), scores, labels, 0.0, overlap)
    return found.select(np.sort(np.array(kept, np.int64)))


def _class_names(names: Any) -> Mapping[int, str]:
    """The class names in the metadata, a list or a dictionary; empty for anything else."""
    if isinstance(names, list | tuple):
        names = dict(enumerate(names))
    if isinstance(names, dict) and all(str(key).isdecimal() for key in names):
        return {int(key): str(value) for key, value in names.items()}
    return {}


def _other_input(name: str, width: int, height: int) -> Array:
    """The value of an input that is no picture, for an input of this size in pixels."""
    if name == "im_shape":
        return np.array([height, width], np.float32)
    if name == "scale_factor":
        return np.ones(2, np.float32)
    if "size" in name:
        # The size of the picture that boxes refer to.
        return np.array([width, height], np.int64)
    # A mask of the valid pixels.
    return np.ones((height, width), np.int64)


def _in_shares(layout: Layout, outputs: list[Array]) -> bool | None:
    """Return True if most boxes are in shares of the input; None if there are no boxes."""
    if layout.batched:
        outputs = of_picture(outputs, 0)
    boxes = layout.decode(outputs)[0]
    boxes = boxes[boxes.any(axis=1) & np.isfinite(boxes).all(axis=1)]
    if not len(boxes):
        return None
    return float(np.median(np.abs(boxes).max(axis=1))) <= MAX_SHARE


def _coco_names(classes: int) -> Mapping[int, str]:
    """The names of COCO for a network with 80 classes, or with 91, which has numbers that are not
    used; empty for others.
    """
    names = Path(__file__).with_name("coco.txt").read_text(encoding="utf-8").splitlines()
    numbers = [*range(classes)]
    if classes == len(names) + len(_COCO_GAPS):
        numbers = [number for number in numbers if number not in _COCO_GAPS]
    if len(numbers) != len(names):
        return {}
    return dict(zip(numbers, names, strict=True))


def open_network(path: Path, threads: int) -> Any:
    """The network, ready to run. Raises `InputError` if the package is missing, or the file is not
    a network.
    """
    runtime = needed("onnxruntime")
    if not path.is_file():
        # Raises an error that names what is there instead.
        load(path)
    options = runtime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = threads
    available = runtime.get_available_providers()
    try:
        return runtime.InferenceSession(
            str(path), options, providers=[one for one in _PROVIDERS if one in available]
        )
    except Exception as error:
        raise InputError(
            f"onnxruntime {runtime.__version__} cannot run this network: {first_sentence(error)}",
            where=path,
            cure=export_cure(path) or "Is it an ONNX file, and complete?",
        ) from error


def export_cure(path: Path) -> str:
    """How to export the weights in a file to ONNX; empty if its name is not one of weights."""
    if path.suffix.lower() not in _WEIGHTS:
        return ""
    made = path.with_suffix(".onnx")
    return (
        f"These are weights: export them to ONNX once (Ultralytics: yolo export model={path}"
        f" format=onnx; RF-DETR: model.export()), then --detector onnx:{made}"
    )


def first_sentence(error: Exception) -> str:
    """The first sentence of an error of onnxruntime, without its code."""
    sentence = str(error).split("\n")[0].rpartition(" : ")[2]
    return " ".join(sentence.split())[:_MAX_MESSAGE] or type(error).__name__


def literal(text: str) -> Any:
    """A list, dictionary or number in the metadata; None for anything else."""
    with suppress(ValueError, SyntaxError, RecursionError, MemoryError):
        if text:
            return ast.literal_eval(text)
    return None


def _described(name: str, output: Array) -> str:
    """Name, type, shape and range of an output."""
    text = f"{name} {output.dtype} {output.shape}"
    if output.size and output.dtype.kind in "fiu":
        text += f" from {float(output.min()):.3g} to {float(output.max()):.3g}"
    return text


def listed_inputs(inputs: Sequence[Any]) -> str:
    """Names, types and shapes of a network's inputs."""
    return ", ".join(f"{one.name} {one.type} ({', '.join(map(str, one.shape))})" for one in inputs)
