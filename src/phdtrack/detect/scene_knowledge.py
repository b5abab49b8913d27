"""Knowledge that a detector has of the scene: learned from a file, saved, and restored."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np

from phdtrack.detect.base import (
    Detector,
    KeepsKnowledge,
    StudiesScene,
    WrapsDetector,
    unwrapped,
)
from phdtrack.devices import Planar, planes_of, size_of
from phdtrack.errors import InputError
from phdtrack.files import return_memory
from phdtrack.types import Frame

# Frames from which the scene of a file is learned, and the fewest that suffice.
_SAMPLES = 51
_MIN_SAMPLES = 7
# Pixels that are decoded in a few seconds.
_MAX_PIXELS = 2e9
# Learned numbers are smaller than this, so that they can be squared.
_LARGEST = 1e30


def study(
    detector: Detector,
    frames: Iterable[Frame],
    sample: Callable[[int], Iterable[Frame]] = lambda count: (),
) -> None:
    """Let a detector that studies the scene see about 50 frames of a file before its first one.

    The samples are spread over the whole file if it allows seeking to that many places, or to half
    as many. Otherwise they are spread over a short file, or over as much of the beginning of a long
    one as is decoded in a few seconds. With fewer than 7 nothing is learned.

    Parameters
    ----------
    detector : is changed if it studies the scene; for others no frame is read.
    frames : the frames of the file.
    sample : returns so many frames of the file, as `video.VideoSource.sample` does.
    """
    inner = unwrapped(detector)
    if not isinstance(inner, StudiesScene):
        return

    def planar(frame: Frame) -> Frame:
        frame = _input_frame(detector, frame)
        picture = Planar(size_of(frame), planes_of(frame.picture))
        return Frame(frame.number, frame.time, picture)

    for count in (_SAMPLES, _SAMPLES // 2):
        kept = list[Frame]()
        # The run itself reports a frame that cannot be read.
        with suppress(InputError, OSError):
            kept.extend(map(planar, sample(count)))
        if len(kept) == count:
            break
    else:
        kept = _thinned(frames, planar)
    number = min(_SAMPLES, len(kept) - 1 + len(kept) % 2)
    if number < _MIN_SAMPLES:
        return
    kept = [kept[k] for k in np.linspace(0, len(kept) - 1, number).round().astype(int)]
    kept.reverse()
    # Popping frees the memory of each sample as soon as the detector has used it.
    inner.study(kept.pop() for _ in range(number))


def _input_frame(detector: Detector, frame: Frame) -> Frame:
    """The frame that the innermost detector gets."""
    while isinstance(detector, WrapsDetector):
        frame = detector.input_frame(frame)
        detector = detector.detector
    return frame


def _thinned(frames: Iterable[Frame], planar: Callable[[Frame], Frame]) -> list[Frame]:
    """Evenly spaced ``planar`` frames of a file or its beginning; between 51 and 102 of many."""
    kept = list[Frame]()
    step = 1
    pixels = 0
    with suppress(InputError, OSError):
        for count, frame in enumerate(frames):
            width, height = size_of(frame)
            pixels += width * height
            if count % step == 0:
                kept.append(planar(frame))
            if len(kept) > 2 * _SAMPLES:
                kept = kept[::2]
                step = 2 * step
            if pixels > _MAX_PIXELS:
                break
    return kept


def knowledge(detector: Detector) -> dict[str, Any] | None:
    """Everything a detector has learned from frames, as `state.to_bytes` takes it, for `restore`.

    Empty for detectors that learn nothing; None if the knowledge is inaccessible.

    Parameters
    ----------
    detector : one that has seen frames.

    Returns
    -------
    Values by name; empty or None as above.
    """
    inner = unwrapped(detector)
    if isinstance(inner, KeepsKnowledge):
        return inner.knowledge()
    return {}


def restore(detector: Detector, known: dict[str, Any], frame: Frame) -> None:
    """Give a detector the `knowledge` of another one with the same settings.

    Parameters
    ----------
    detector : is changed.
    known : from `knowledge`.
    frame : any frame of the sequence: it determines the shapes and types that arrays must have.

    Raises
    ------
    InputError : the knowledge is of another kind of detector, or of frames of another size.
    """
    inner = unwrapped(detector)
    if not (isinstance(inner, StudiesScene) and inner.studied):
        detector.reset()
        detector(frame)
    usual = knowledge(inner)
    if (
        usual is None
        or usual.keys() != known.keys()
        or not all(_alike(known[name], usual[name]) for name in usual)
    ):
        raise InputError("the stored state is of another detector, or of frames of another size")
    if isinstance(inner, KeepsKnowledge):
        inner.restore(known)


def _alike(value: Any, usual: Any) -> bool:
    """Return True if a value has the type and shape of the ``usual`` one and can be squared."""
    if isinstance(usual, np.ndarray):
        if not isinstance(value, np.ndarray):
            return False
        if value.dtype != usual.dtype or value.shape != usual.shape:
            return False
        return value.dtype.kind != "f" or bool((np.abs(value) < _LARGEST).all())
    if type(value) is not type(usual):
        return False
    if isinstance(usual, tuple) and len(value) != len(usual):
        return False
    if isinstance(usual, list | tuple):
        return len(value) > 0 and all(_alike(item, usual[0]) for item in value)
    return bool(-_LARGEST < value < _LARGEST)


def scene_warnings(detector: Detector) -> tuple[str, ...]:
    """Sentences about properties of a studied scene that make a detector's boxes unreliable."""
    inner = unwrapped(detector)
    if isinstance(inner, StudiesScene):
        return inner.scene_warnings()
    return ()


def forget_scene(detector: Detector) -> None:
    """Let a detector forget the scene that it has studied, and give the memory back."""
    inner = unwrapped(detector)
    if isinstance(inner, StudiesScene) and inner.studied:
        inner.reset()
        return_memory()
