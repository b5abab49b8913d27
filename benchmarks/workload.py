"""The workload: n boxes at constant density, and a detector that misses some and adds clutter.

10 targets and 10 clutter points per 720 × 480 area; the area grows with the targets. Boxes are 20 …
50 pixels wide and twice as high (uniform in the width), cross their own size in about 50 frames and
turn at the borders; detected with p_D = 0.95 and errors of 5 % of the size in position and in size.
Clutter is Poisson, uniform, of the same sizes. The number of targets is constant unless ``life`` is
given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from phdtrack import config
from phdtrack.kernels.gaussian import Births
from phdtrack.protocols import AnyStages, Birth, Sensor
from phdtrack.types import F8, Detections, DetectionTable, Particles, SequenceInfo, Truth

AREA = (720, 480)
PER_AREA = 10
RATE = 25.0


@dataclass(frozen=True, slots=True)
class Crowd:
    """A scene of boxes.

    Parameters
    ----------
    targets, frames : how many, how long.
    clutter : expected false alarms per frame; −1 for as many as targets.
    p_detect, jitter : detector; ``jitter`` is the deviation of centre and size in box sizes.
    noise : deviations of centre and of size in pixels, instead of ``jitter``.
    speed : deviation of the velocity, box sizes per frame.
    widths, aspect : range of widths in pixels, height over width.
    life : frames after which a target vanishes and another appears elsewhere; 0 for never.
    """

    targets: int
    frames: int
    clutter: float = -1.0
    p_detect: float = 0.95
    jitter: float = 0.05
    noise: tuple[float, float] | None = None
    speed: float = 0.02
    widths: tuple[float, float] = (20.0, 50.0)
    aspect: float = 2.0
    life: int = 0

    @property
    def info(self) -> SequenceInfo:
        """Size of the area, rate and number of frames."""
        grow = (self.targets / PER_AREA) ** 0.5
        return SequenceInfo(
            round(AREA[0] * grow), round(AREA[1] * grow), RATE, self.frames, "crowd"
        )

    @property
    def false_alarms(self) -> float:
        """Expected clutter per frame."""
        return float(self.targets) if self.clutter < 0 else self.clutter


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """A crowd as it was drawn: truth and detections."""

    info: SequenceInfo
    truth: Truth
    table: DetectionTable

    def detections(self) -> list[Detections]:
        """Yield the detections of the frames 1, 2, …"""
        return [self.table.at(number) for number in range(1, self.info.frames + 1)]

    def truth_at(self, number: int) -> F8:
        """(n, 4) the boxes of frame ``number``."""
        lo, hi = np.searchsorted(self.truth.frame, [number, number + 1])
        return self.truth.xyxy[lo:hi]


def draw(crowd: Crowd, seed: int) -> Stream:
    """The crowd's truth and detections."""
    walk_rng, see_rng, clutter_rng, order_rng = np.random.default_rng(seed).spawn(4)
    identity, centre, size = _walks(crowd, walk_rng)
    frames = np.broadcast_to(np.arange(1, crowd.frames + 1)[:, None], identity.shape)
    flat_centre = centre.reshape(-1, 2)
    flat_size = size.reshape(-1, 2)
    truth = Truth(
        frames.ravel(),
        identity.ravel(),
        _boxes(flat_centre, flat_size),
        np.zeros(identity.size, np.bool_),
    )
    seen = np.flatnonzero(see_rng.random(identity.size) < crowd.p_detect)
    errors = see_rng.standard_normal((4, len(seen))).T * _deviations(crowd, flat_size[seen])
    found = _boxes(
        flat_centre[seen] + errors[:, :2],
        np.maximum(flat_size[seen] + errors[:, 2:], 0.2 * flat_size[seen]),
    )
    counts = clutter_rng.poisson(crowd.false_alarms, crowd.frames)
    total = int(counts.sum())
    place = clutter_rng.random((total, 2)) * [crowd.info.width, crowd.info.height]
    false = _boxes(place, _sizes(crowd, total, clutter_rng))
    frame = np.concatenate([truth.frame[seen], np.repeat(np.arange(1, crowd.frames + 1), counts)])
    order = np.lexsort((order_rng.random(len(frame)), frame))
    return Stream(
        crowd.info,
        truth,
        DetectionTable(frame[order], Detections.of(np.concatenate([found, false])[order])),
    )


def _deviations(crowd: Crowd, size: F8) -> F8:
    """(n, 4) deviations of centre and size for boxes of these sizes (n, 2)."""
    if crowd.noise is None:
        return crowd.jitter * np.concatenate([size, size], axis=1)
    return np.broadcast_to(np.repeat(crowd.noise, 2), (len(size), 4))


def _walks(crowd: Crowd, rng: np.random.Generator) -> tuple[Any, F8, F8]:
    """Identities (T, n), centres (T, n, 2) and sizes (T, n, 2)."""
    span = crowd.life or crowd.frames
    clock = np.arange(crowd.frames)[:, None] + (
        rng.integers(0, span, crowd.targets) if crowd.life else 0
    )
    turn = clock // span
    age = clock % span
    lives = int(turn.max()) + 1
    who = turn * crowd.targets + np.arange(crowd.targets)
    size = _sizes(crowd, lives * crowd.targets, rng)
    room = np.array([crowd.info.width, crowd.info.height]) - size
    velocity = crowd.speed * size * rng.standard_normal(size.shape)
    way = rng.random(size.shape) * room
    # Reflection at the borders is a triangular wave.
    moved = (way[who] + age[:, :, None] * velocity[who]) % (2 * room[who])
    return who + 1, size[who] / 2 + np.minimum(moved, 2 * room[who] - moved), size[who]


def _sizes(crowd: Crowd, n: int, rng: np.random.Generator) -> F8:
    """(n, 2) widths and heights."""
    width = rng.uniform(*crowd.widths, n)
    return np.stack([width, crowd.aspect * width], axis=1)


def _boxes(centre: F8, size: F8) -> F8:
    """(n, 4) xyxy."""
    return np.concatenate([centre - size / 2, centre + size / 2], axis=1)


def stages(
    crowd: Crowd, *, worst: bool = False, sets: tuple[str, ...] = (), preset: str = "m09"
) -> AnyStages:
    """M09's tracker with K-means for the crowd's density: ρ = 1500, Jmax = 1000, p_M = 0.05.

    With ``worst`` no predicted mass explains a detection, so that each gets all its Jmax newborn.
    """
    density = crowd.targets / PER_AREA
    values = [
        f"sensor.detection_probability={crowd.p_detect}",
        f"clutter.clutter_per_frame={max(crowd.false_alarms, 1e-3)}",
        # 0.01 births per frame in an area of 720 × 480.
        f"birth.births_per_second={0.25 * density}",
        "extract.kind=kmeans",
        "extract.min_weight=0.6",
        "extract.merge_iou=1.0",
    ]
    built = config.build(config.load(preset=preset, sets=(*values, *sets)), crowd.info)
    if not worst:
        return built
    return replace(built, model=replace(built.model, birth=Uncovered(built.model.birth)))


@dataclass(frozen=True, slots=True)
class Uncovered:
    """Births as if nothing predicted explained any detection: Jmax newborn particles at each."""

    birth: Birth

    def sample(
        self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator
    ) -> Particles:
        """The newborn of the wrapped birth model where no mass is covered."""
        return self.birth.sample(z, np.zeros_like(covered), sensor, seconds, rng)

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """Return the Gaussians of the wrapped birth model."""
        return self.birth.gaussians(z, sensor, seconds)

    def expected_count(self, z: F8, seconds: float) -> float:
        """That of the wrapped birth model."""
        return self.birth.expected_count(z, seconds)
