"""A network in an ONNX file that describes what boxes look like: one vector for each crop, as
networks for re-identification give it.

The size of a crop is that of the network's input. Mean and deviation of the colours are those of
the settings, of the file's metadata (``mean`` and ``std``), or those of ImageNet.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phdtrack.detect.embedding_settings import EmbeddingSettings
from phdtrack.detect.onnx import (
    IMAGENET_DEVIATION,
    IMAGENET_MEAN,
    INPUT_TYPES,
    export_cure,
    first_sentence,
    listed_inputs,
    literal,
    open_network,
)
from phdtrack.detect.onnx_layouts import Array
from phdtrack.errors import InputError
from phdtrack.opencv_package import cv2
from phdtrack.types import F4, F8, Image

# Width and height of a crop if the network takes any, as usual for people.
_USUAL_SIZE = (128, 256)
# Pixels that a box must show, as for colours.
_LEAST_PIXELS = 16
# More numbers are no embedding: the network does something else.
_MAX_LENGTH = 16384
_GREY = 114
_SUPPORTED = (
    "The network must take crops, (N, 3, height, width) or (N, height, width, 3), and give one"
    " vector for each, (N, length)."
)


class _Input(NamedTuple):
    """The crops that a network takes; ``batch`` is 0 if it takes any number at once."""

    name: str
    batch: int
    width: int
    height: int
    channels_last: bool
    dtype: Any


class EmbeddingNetwork:
    """Descriptors by the user's own network. It learns nothing from frames.

    Parameters
    ----------
    file : the network.
    settings : how crops are given to it.

    Attributes
    ----------
    length : numbers of a descriptor.
    guesses : sentences about what was guessed, which the caller shows.

    Raises
    ------
    InputError : the file is no network, or one of other inputs or outputs; onnxruntime is missing.
    """

    def __init__(self, file: str | Path, settings: EmbeddingSettings | None = None) -> None:
        self.file = Path(file)
        self.settings = settings or EmbeddingSettings()
        if export_cure(self.file):
            raise InputError(
                "expected an ONNX file, got weights",
                where=self.file,
                cure="Export them to ONNX once, and say --appearance onnx:FILE.",
            )
        self._session = open_network(self.file, self.settings.threads)
        metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        self._input = self._checked_input()
        self._mean = _colours(self.settings.mean, metadata.get("mean", ""), IMAGENET_MEAN)
        self._deviation = _colours(
            self.settings.deviation, metadata.get("std", ""), IMAGENET_DEVIATION
        )
        self.guesses = self._guesses(metadata)
        grey = np.full((1, self._input.height, self._input.width, 3), _GREY, np.uint8)
        self.length = int(self._run(grey).shape[1])

    def describe(self, image: Image, boxes: F8) -> F4:
        """(N, length) descriptors of boxes, unit vectors in steps of a 16-bit float; zeros for a
        box that shows fewer than 16 pixels.

        Parameters
        ----------
        image : (H, W, 3) BGR uint8.
        boxes : (N, 4) left, top, right, bottom in pixels of the image.

        Raises
        ------
        InputError : the network fails.
        """
        height, width = image.shape[:2]
        limits = [width, height, width, height]
        corners = np.clip(np.nan_to_num(boxes), 0, limits)
        corners[:, :2] = np.floor(corners[:, :2])
        corners[:, 2:] = np.ceil(corners[:, 2:])
        sides = corners[:, 2:] - corners[:, :2]
        seen = np.flatnonzero((sides.min(axis=1) > 0) & (sides.prod(axis=1) >= _LEAST_PIXELS))
        crops = np.empty((len(seen), self._input.height, self._input.width, 3), np.uint8)
        size = (self._input.width, self._input.height)
        for k, (left, top, right, bottom) in enumerate(corners[seen].astype(np.int64).tolist()):
            crops[k] = cv2.resize(image[top:bottom, left:right], size)
        out = np.zeros((len(boxes), self.length), np.float32)
        step = self._input.batch or self.settings.batch
        for first in range(0, len(seen), step):
            part = seen[first : first + step]
            out[part] = self._run(crops[first : first + step])
        norm = np.linalg.norm(out, axis=1, keepdims=True)
        usable = np.isfinite(norm) & (norm > 0)
        unit = np.divide(out, norm, out=np.zeros_like(out), where=usable)
        # What a file keeps for the next run is the same to the bit.
        return np.asarray(unit.astype(np.float16), np.float32)

    def _run(self, crops: Image) -> Array:
        """(n, length) the network's vectors of crops (n, height, width, 3) BGR."""
        n = len(crops)
        missing = max(self._input.batch - n, 0)
        if missing:
            crops = np.concatenate([crops, np.zeros((missing, *crops.shape[1:]), np.uint8)])
        values: Array = crops
        if not self.settings.bgr:
            values = values[..., ::-1]
        if self._input.dtype != np.uint8:
            order = -1 if self.settings.bgr else 1
            scaled = values.astype(np.float32) / 255
            values = (scaled - self._mean[::order]) / self._deviation[::order]
        if not self._input.channels_last:
            values = values.transpose(0, 3, 1, 2)
        feed = {self._input.name: np.ascontiguousarray(values, self._input.dtype)}
        try:
            output: Array = np.asarray(self._session.run(None, feed)[0])
        except Exception as error:
            problem = f"the network failed: {first_sentence(error)}"
            raise InputError(problem, where=self.file) from error
        vectors = output.reshape(len(output), -1) if output.ndim > 1 else output[:0, None]
        length = vectors.shape[1]
        if len(vectors) != len(crops) or not 1 < length <= _MAX_LENGTH:
            raise InputError(
                f"expected one vector for each of {len(crops)} crops, got an output {output.shape}",
                where=self.file,
                cure=_SUPPORTED,
            )
        return vectors[:n].astype(np.float32)

    def _checked_input(self) -> _Input:
        """The crops that the network takes. Raises `InputError` for other inputs."""
        inputs = [*self._session.get_inputs()]
        problem = f"the network's inputs are not supported: {listed_inputs(inputs)}"
        first = inputs[0]
        if len(inputs) != 1 or first.type not in INPUT_TYPES or len(first.shape) != 4:
            raise InputError(problem, where=self.file, cure=_SUPPORTED)
        sides = [side if isinstance(side, int) and side > 0 else 0 for side in first.shape]
        channels_last = sides[1] != 3 and sides[3] == 3
        if channels_last:
            batch, height, width, channels = sides
        else:
            batch, channels, height, width = sides
        if channels not in (0, 3):
            raise InputError(problem, where=self.file, cure=_SUPPORTED)
        wanted = self.settings.size
        if any(wanted) and width and height and wanted != (width, height):
            raise InputError(
                f"the network only takes crops of {width}x{height} pixels",
                where="embedding.size",
                cure="Leave it out.",
            )
        width = width or wanted[0] or _USUAL_SIZE[0]
        height = height or wanted[1] or _USUAL_SIZE[1]
        dtype = INPUT_TYPES[first.type]
        return _Input(first.name, batch, width, height, channels_last, dtype)

    def _guesses(self, metadata: Mapping[str, str]) -> tuple[str, ...]:
        """A sentence about what was guessed of the input; none if it is stated."""
        settings = self.settings
        stated = settings.mean or settings.deviation or metadata.get("mean") or settings.bgr
        if stated or self._input.dtype == np.uint8:
            return ()
        size = f"{self._input.width}x{self._input.height}"
        return (
            f"{self.file}: crops go in as {size} pixels, red first, with mean and deviation of"
            " ImageNet, as usual; embedding.mean, embedding.deviation, embedding.bgr and"
            " embedding.size change this.",
        )


def _colours(stated: tuple[float, ...], text: str, usual: Array) -> Array:
    """(3,) what the user states, or the metadata in ``text``, or as usual."""
    known = stated or literal(text) or ()
    if isinstance(known, list | tuple) and len(known) == 3:
        return np.array(known, np.float32)
    return usual
