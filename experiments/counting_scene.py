"""A scene whose model is known exactly, for experiments that count.

Targets move by the motion model with state-dependent variances, one step a frame [M09 (11)]; each
survives with p_S; in every frame Poisson(birth rate) new ones appear, uniform over the frame. With
the default birth rate n (1 − p_S) the expected number is n in every frame. This needs a world
without borders: after a hundred frames of this motion many targets are outside the frame. With
``leaving`` those are removed: the survival probability is p_S inside and 0 outside, and the number
falls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phdtrack.arrays import to_xyxy
from phdtrack.errors import InputError
from phdtrack.simulate.detector import DetectorModel
from phdtrack.simulate.scenes import truth_rows
from phdtrack.types import F8, SequenceInfo, Truth

PAPER_DETECTOR = DetectorModel(p_detect=0.95, jitter=0.075, jitter_size=0.15, clutter_rate=1.0)
"""p_M = 0.05, σ_size = 0.15 of the box, σ_position half of that, one clutter point a frame: the
sensor of M07 and M09.
"""


@dataclass(frozen=True, slots=True)
class Counting:
    """Settings of a scene with a known model. State: centre, velocity in pixels per frame, width
    and height in pixels.

    Attributes
    ----------
    n : number of targets in the first frame.
    frames, fps, width, height : of the sequence.
    p_survive : survival probability from one frame to the next.
    birth_rate : expected newborn targets per frame; negative: n (1 − p_survive).
    birth_speed : standard deviation of the amplitude of a newborn's velocity, in widths per frame;
        any direction.
    birth_height : newborn heights are log-uniform between these, pixels.
    aspect : width over height of a newborn.
    sd_velocity, sd_size : the standard deviations of n1, n2 and of nw, nh in M09 (11).
    leaving : remove a target once its centre is outside the frame. False: the world has no borders,
        and targets outside the frame are in the truth and are detected like others (clutter and
        births stay within the frame).
    """

    n: int = 10
    frames: int = 200
    fps: float = 25.0
    width: int = 1280
    height: int = 720
    p_survive: float = 0.99
    birth_rate: float = -1.0
    birth_speed: float = 0.05
    birth_height: tuple[float, float] = (40.0, 80.0)
    aspect: float = 0.4
    sd_velocity: float = 0.03
    sd_size: float = 0.1
    leaving: bool = False

    def __post_init__(self) -> None:
        expected = {
            f"n of 0 or more targets and 1 frame or more, got {self.n} and {self.frames}": self.n
            >= 0
            and self.frames >= 1,
            f"a probability p_survive, got {self.p_survive:g}": 0 <= self.p_survive <= 1,
            "standard deviations of 0 or more": min(self.sd_velocity, self.sd_size) >= 0,
            f"birth_height (low, high), got {self.birth_height}": 0
            < self.birth_height[0]
            <= self.birth_height[1],
        }
        for requirement, met in expected.items():
            if not met:
                raise InputError(
                    f"expected {requirement}",
                    where="counting scene",
                    cure="Change this setting of the scene",
                )

    @property
    def births(self) -> float:
        """Expected newborn targets per frame."""
        return self.birth_rate if self.birth_rate >= 0 else self.n * (1 - self.p_survive)

    @property
    def info(self) -> SequenceInfo:
        """Size, rate, number of frames and name of the sequence."""
        return SequenceInfo(self.width, self.height, self.fps, self.frames, "counting")

    def figures(self, rng: np.random.Generator) -> Truth:
        """All targets of all frames, numbered in the order of their births."""
        x = self.newborn(self.n, rng)
        identity = np.arange(1, self.n + 1)
        known = self.n
        parts = [(np.full(self.n, 1), identity, to_xyxy(x[[0, 1, 4, 5]]))]
        edge = np.array([[self.width], [self.height]])
        for frame in range(2, self.frames + 1):
            stay = rng.random(len(identity)) < self.p_survive
            x = self.step(x[:, stay], rng)
            identity = identity[stay]
            if self.leaving:
                inside = np.all((x[:2] >= 0) & (x[:2] < edge), axis=0)
                x = x[:, inside]
                identity = identity[inside]
            born = int(rng.poisson(self.births))
            x = np.concatenate([x, self.newborn(born, rng)], axis=1)
            identity = np.concatenate([identity, np.arange(known + 1, known + born + 1)])
            known += born
            parts.append((np.full(len(identity), frame), identity, to_xyxy(x[[0, 1, 4, 5]])))
        frames, identities, boxes = (np.concatenate(column) for column in zip(*parts, strict=True))
        return truth_rows(frames, identities, boxes)

    def step(self, x: F8, rng: np.random.Generator) -> F8:
        """(6, L) the states ``x`` (6, L) one frame later [M09 (11)]; sizes are reflected at 0."""
        size = x[4:]
        push = size * rng.normal(size=size.shape) * self.sd_velocity
        grow = size * rng.normal(size=size.shape) * self.sd_size
        return np.concatenate([x[:2] + x[2:4] + push / 2, x[2:4] + push, np.abs(size + grow)])

    def newborn(self, n: int, rng: np.random.Generator) -> F8:
        """(6, n) states of new targets."""
        centre = rng.random((2, n)) * np.array([[self.width], [self.height]])
        height = np.exp(rng.uniform(*np.log(self.birth_height), n))
        direction = rng.uniform(0, 2 * np.pi, n)
        speed = rng.normal(size=n) * self.birth_speed * self.aspect * height
        return np.stack(
            [
                *centre,
                speed * np.cos(direction),
                speed * np.sin(direction),
                self.aspect * height,
                height,
            ]
        )
