"""Tracks, and the measurements that they rest on, for the tests of smoothing."""

import numpy as np

from phdtrack.arrays import to_xyxy
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import MeasurementHistory, Tracks

WIDTH = 640.0
HEIGHT = 480.0


def model_of(**motion) -> Model:
    """Noises that no state changes, so that everything is linear and Gaussian, unless
    ``scaled_noise`` says otherwise.
    """
    size = (WIDTH, HEIGHT)
    plain = {
        "acceleration": 0.3,
        "size_noise": 0.6,
        "scaled_noise": False,
        "survival_probability": 0.997**25,
    }
    values = plain | {"frame_size": size} | motion
    sensor = (
        BoxSensor(detection_probability=0.8, box_noise=0.15, birth_speed=0.1, scaling="particle")
        if values["scaled_noise"]
        else BoxSensor(
            detection_probability=0.8,
            scaling="fixed",
            fixed_noise=(2.0, 3.0),
            birth_speed_pixels=4.0,
        )
    )
    return Model(
        BoxMotion(**values),
        sensor,
        MeasurementBirth(0.25, frame_size=size),
        UniformClutter(1.0, 1e10),
    )


def walk(
    rng: np.random.Generator, frames: int, begin, velocity, size=(40.0, 80.0), noise: float = 2.0
) -> np.ndarray:
    """(frames, 4) centres and sizes on a straight line, measured with this deviation."""
    place = np.asarray(begin) + np.arange(frames)[:, None] * np.asarray(velocity)
    return np.hstack([place, np.broadcast_to(size, (frames, 2))]) + rng.normal(
        0, noise, (frames, 4)
    )


def sequence(pieces, frames: int, model: Model) -> tuple[Tracks, MeasurementHistory]:
    """Tracks of ``pieces``, each {frame: (4,) measurement or None}, with boxes where they were
    measured.

    In each frame the measurements stand in the order of the pieces. A frame with None is a row that
    rests on nothing.
    """
    z = []
    rows = []
    count = np.zeros(frames, np.int64)
    for number in range(1, frames + 1):
        for identity, piece in enumerate(pieces, start=1):
            box = piece.get(number)
            if box is not None:
                rows.append((number, identity, box, count[number - 1]))
                z.append(box)
                count[number - 1] += 1
            elif number in piece:
                rows.append((number, identity, np.full(4, 7.0), -1))
    start = np.concatenate(([0], np.cumsum(count)))
    number, identity, where, detection = zip(*rows, strict=True)
    xyxy = to_xyxy(np.array(where).T)
    n = len(rows)
    tracks = Tracks(
        np.array(number),
        np.array(identity),
        xyxy,
        np.full(n, 0.9),
        np.array(detection),
        np.ones(n, np.bool_),
    )
    numbers = np.arange(1, frames + 1)
    return tracks, MeasurementHistory(
        numbers, numbers - 1.0, start, np.array(z).T, np.zeros((0, 3, 3))
    )


def piece(walked: np.ndarray, first: int, *shown: tuple[int, int]) -> dict:
    """The frames ``shown``, first and last of each stretch, of a walk that begins in frame
    ``first``.
    """
    frames = [n for low, high in shown for n in range(low, high + 1)]
    return {n: walked[n - first] for n in frames}
