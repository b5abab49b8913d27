"""Milliseconds per frame of the detectors, on rendered frames of three sizes.

    python -m benchmarks.detectors

The street scene with its usual look is rendered before the clock starts. The frames are gone
through forwards and backwards, so that detectors which learn the scene have learned it before they
are measured, and motion stays continuous.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.timing import Spread, seconds
from phdtrack.detect import make_detector
from phdtrack.simulate import Rendered, make_scene
from phdtrack.types import Frame, Image

SIZES = {"QCIF": (176, 144), "768x576": (768, 576), "1080p": (1920, 1080)}
DETECTORS = ("change", "mean-background", "mog2", "face", "person")
FPS = 25.0
RENDERED = 40
# The default detector learns for four seconds; one that looks at each frame alone needs only its
# first call.
LEARNING = {"face": 1, "person": 1}
LEARNED = 125


@lru_cache(maxsize=1)
def rendered(size: tuple[int, int], seed: int) -> tuple[Image, ...]:
    """`RENDERED` frames of the street, (H, W, 3) BGR."""
    width, height = size
    scene = make_scene("street", seed, frames=RENDERED, width=width, height=height, fps=FPS)
    return tuple(frame.image for frame in Rendered(scene, np.random.default_rng(seed)))


def endless(images: tuple[Image, ...]) -> Iterator[Frame]:
    """The images there and back, again and again, as frames of one sequence."""
    order = (*range(len(images)), *range(len(images) - 2, 0, -1))
    number = 0
    while True:
        for i in order:
            number += 1
            yield Frame(number, (number - 1) / FPS, images[i])


def measure(
    size: tuple[int, int], detector: str, frames: int = 60, seed: int = 1
) -> dict[str, Any]:
    """Time per frame of the detector of that name, with its defaults, on ``frames`` frames of
    ``size`` (width, height).

    ``ms`` is the median, ``spread`` has the quartiles, ``detections`` is the mean number of boxes.
    """
    look = make_detector(detector)
    source = endless(rendered(size, seed))
    boxes: list[int] = []
    spent = seconds(
        lambda: boxes.append(len(look(next(source)))), frames, LEARNING.get(detector, LEARNED)
    )
    spread = Spread.of(spent, 1e3)
    mean = float(np.mean(boxes[-frames:]))
    return {
        "size": list(size),
        "detector": detector,
        "ms": spread.median,
        "spread": spread.as_dict(),
        "detections": mean,
    }


def main() -> None:
    """Print one line for each size and detector."""
    for name, size in SIZES.items():
        for detector in DETECTORS:
            found = measure(size, detector, frames=10 if detector in LEARNING else 60)
            spread = found["spread"]
            middle = (
                f"{found['ms']:9.2f} ms  [{spread['low']:.2f}, {spread['high']:.2f}], least"
                f" {spread['least']:.2f}"
            )
            print(f"{name:8} {detector:16}{middle}  {found['detections']:.1f} boxes", flush=True)


if __name__ == "__main__":
    main()
