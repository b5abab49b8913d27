"""The protocol of detectors, and protocols of their optional capabilities.

Every detector turns frames into detections. What else a detector can do follows from the protocols
of this module that it implements, and is found out with ``isinstance``. The functions below also
work for wrapped detectors (`wrappers`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from phdtrack.devices import size_of
from phdtrack.types import F4, F8, STILL, Detections, Frame, Image


class Detector(Protocol):
    """Turns a frame into detections. A detector that learns the scene keeps it inside.

    Parameters
    ----------
    frame : a picture of the sequence, with its number and time in seconds.
    """

    def __call__(self, frame: Frame) -> Detections:
        """The boxes found in the frame, in its own pixel coordinates."""

    def reset(self) -> None:
        """Forget everything learned from earlier frames."""


class Describer(Protocol):
    """Describes the appearance of boxes in a picture."""

    @property
    def length(self) -> int:
        """Numbers of a descriptor."""

    def describe(self, image: Image, boxes: F8) -> F4:
        """(N, length) descriptors of boxes, in steps of a 16-bit float; zeros for a box that the
        picture does not show.

        Parameters
        ----------
        image : (H, W, 3) BGR uint8.
        boxes : (N, 4) left, top, right, bottom in pixels of the image.
        """


@runtime_checkable
class WrapsDetector(Protocol):
    """A detector that changes the frames or the boxes of another one.

    Parameters
    ----------
    frame : what this detector gets.
    """

    @property
    def detector(self) -> Detector:
        """The wrapped detector."""

    def input_size(self, frame: Frame) -> tuple[int, int]:
        """Width and height in pixels at which the wrapped detector gets this frame."""

    def input_frame(self, frame: Frame) -> Frame:
        """The frame that the wrapped detector gets."""


@runtime_checkable
class StudiesScene(Protocol):
    """Can learn the scene from samples of a whole file before its first frame."""

    @property
    def studied(self) -> bool:
        """True if the scene was learned from samples of a file."""

    def study(self, samples: Iterable[Frame]) -> None:
        """Learn the scene from an odd number of at least 7 frames, in order.

        Parameters
        ----------
        samples : the frames, as they are decoded.
        """

    def scene_warnings(self) -> tuple[str, ...]:
        """Sentences about properties of the scene that make the boxes unreliable."""


@runtime_checkable
class ReportsPose(Protocol):
    """Measures how a shaking camera moved."""

    @property
    def pose(self) -> F8:
        """(3, 3) map from scene pixels to pixels of the last frame, or `types.STILL`."""


@runtime_checkable
class KeepsKnowledge(Protocol):
    """Learns from frames; a later run may continue with what was learned."""

    def knowledge(self) -> dict[str, Any] | None:
        """Everything learned from frames, as `state.to_bytes` takes it; None if inaccessible."""

    def restore(self, knowledge: dict[str, Any]) -> None:
        """Continue with the knowledge of a detector with the same settings.

        Parameters
        ----------
        knowledge : what `knowledge` gave.
        """


@runtime_checkable
class NamesClasses(Protocol):
    """Reports several classes and can name them."""

    @property
    def class_names(self) -> Mapping[int, str]:
        """The name of each class; empty if unknown."""


@runtime_checkable
class ReportsGuesses(Protocol):
    """Had to guess what its file means."""

    def guesses(self) -> tuple[str, ...]:
        """Sentences about what was guessed, which the caller shows."""


@runtime_checkable
class DetectsBatches(Protocol):
    """Is faster on several frames at once."""

    @property
    def batch_size(self) -> int:
        """Frames per call."""

    def detect_batch(self, frames: Sequence[Frame]) -> list[Detections]:
        """The detections of each frame.

        Parameters
        ----------
        frames : at most `batch_size` frames, in order.
        """


@runtime_checkable
class ReadsPlanes(Protocol):
    """Reads the YUV planes of a decoded picture instead of its BGR image."""

    def prepare(self, frame: Frame, size: tuple[int, int]) -> None:
        """Convert the picture to planes of this width and height now.

        Parameters
        ----------
        frame : whose picture is a `devices.Picture`.
        size : width and height in pixels.
        """


def unwrapped(detector: Detector) -> Detector:
    """The innermost detector."""
    while isinstance(detector, WrapsDetector):
        detector = detector.detector
    return detector


def innermost_size(detector: Detector, frame: Frame) -> tuple[int, int]:
    """Width and height in pixels at which the innermost detector gets this frame."""
    size = size_of(frame)
    while isinstance(detector, WrapsDetector):
        size = detector.input_size(frame)
        detector = detector.detector
    return size


def class_names(detector: Detector) -> Mapping[int, str] | None:
    """The names of a detector's classes; None if it knows a single class."""
    inner = unwrapped(detector)
    if isinstance(inner, NamesClasses):
        return inner.class_names
    return None


def described(detections: Detections, frame: Frame, describer: Describer | None) -> Detections:
    """The detections of a frame with embeddings.

    Parameters
    ----------
    detections, frame : of the frame, and its picture.
    describer : makes the embeddings; None: the detections stay as they are.
    """
    if describer is None:
        return detections
    if len(detections):
        embeddings = describer.describe(frame.image, detections.xyxy)
    else:
        embeddings = np.zeros((0, describer.length), np.float32)
    return replace(detections, embeddings=embeddings)


def guesses(detector: Detector) -> tuple[str, ...]:
    """Sentences about what a detector had to guess, which the caller shows."""
    inner = unwrapped(detector)
    if isinstance(inner, ReportsGuesses):
        return inner.guesses()
    return ()


def detect_all(
    detector: Detector, frames: Iterable[Frame]
) -> Iterator[tuple[Frame, Detections, float]]:
    """Detect objects in a stream of frames, in batches if the detector can.

    If reading a frame fails, the frames before it are yielded first.

    Yields
    ------
    Each frame, its detections, and the seconds that detection took.
    """
    iterator = iter(frames)
    stop = None
    batch_size = 1
    if isinstance(detector, DetectsBatches):
        batch_size = detector.batch_size
    while stop is None:
        batch = list[Frame]()
        try:
            while len(batch) < batch_size:
                batch.append(next(iterator))
        except Exception as error:
            stop = error
        clock = time.perf_counter()
        if isinstance(detector, DetectsBatches):
            detections = detector.detect_batch(batch)
        else:
            detections = [detector(frame) for frame in batch]
        seconds = (time.perf_counter() - clock) / max(len(batch), 1)
        for frame, found in zip(batch, detections, strict=True):
            yield frame, found, seconds
    if not isinstance(stop, StopIteration):
        raise stop


def prepared(detector: Detector, frames: Iterable[Frame]) -> Iterator[Frame]:
    """The frames, with the planes already converted if the detector reads planes.

    Call this in the thread that decodes, so that the detector's thread is relieved of the work.
    """
    inner = unwrapped(detector)
    for frame in frames:
        if isinstance(inner, ReadsPlanes):
            inner.prepare(frame, innermost_size(detector, frame))
        yield frame


def pose_of(detector: Detector, frame: Frame) -> F8:
    """(3, 3) map from scene pixels to pixels of a detector's last frame, or `types.STILL` if the
    camera does not shake.
    """
    inner = unwrapped(detector)
    if not isinstance(inner, ReportsPose) or not len(inner.pose):
        return STILL
    size = size_of(frame)
    small = innermost_size(detector, frame)
    if size == small:
        return inner.pose
    scale = np.diag([*np.divide(size, small), 1.0])
    return np.asarray(scale @ inner.pose @ np.linalg.inv(scale))
