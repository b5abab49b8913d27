"""The camera's motion from the detections alone: what all targets do that no target did before.

A target's own motion is in its state. What is left over and common to all, a shift, a zoom and a
turn about the middle of the image (`kernels.common_motion`), is the camera's. Its velocity ω, of
these four components in pixels, follows

    ω_k = e^(−T/τ) ω_{k−1} + ε_k,    ε_k of Student's t with the scales √q

A camera that goes on as before is soon in the velocities of all targets, and ω is what is new.

Where the camera's motion is given, by a file or measured in pictures, it takes the place of the
first term, less what of it is in the velocities already, and its ε have scales of their own. Which
of the two holds is decided by the evidence for both so far, with hysteresis: motions that say
nothing of the detections, or say it wrongly, are not followed.

A still camera must lose nothing. So q is learned, from what the detections say without the prior
and how exactly: each frame says r² − C of it, r with variance C, and counts 1/(q + C)². Of the mean
one standard error is taken off, and a component without any q stands still. A camera that suddenly
moves is found by a vote on the differences of like boxes; its motion must explain the detections
better by a margin. How exact boxes are is learned, too, from all pairs: a factor for each
component.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from phdtrack.errors import Checked
from phdtrack.kernels.common_motion import LEAST, differences, frame_motion
from phdtrack.models import warp as warp_of
from phdtrack.models.gaussian import moved
from phdtrack.protocols import CameraEstimator, Model
from phdtrack.types import F8, STILL, Detections, Estimates

# Seconds after which the camera's velocity counts for 37 %: it is in the targets' own by then.
VELOCITY_MEMORY = 1.5
# Frames after which what was learned of the camera counts for 37 %.
MEMORY = 150.0
# Common motions below this share of a box are errors of the detector.
LEAST_SHARE = 0.02
# Log-odds against a sudden motion in a frame.
JUMP_PENALTY = 7.0
# Log-evidence by which a given motion must be worse than none to be ignored, and better to be used
# again.
SWITCH_EVIDENCE = 10.0
# Pairs that the beginning counts for in what is learned of boxes, and of how many it is remembered.
_PAIRS = 40.0
_PAIRS_KEPT = 500.0
# Log-evidence of one frame for or against the given motion, at most, and frames after which it
# counts for 37 %.
_MOST = 10.0
_EVIDENCE_FRAMES = 33.0
# No camera zooms by more from one frame to the next (logarithm).
_ZOOM = 4.6


@dataclass(frozen=True, slots=True, eq=False)
class CameraState:
    """What is carried from frame to frame.

    Attributes
    ----------
    mean, covariance : (n, d), (n, d, d) the targets of the last frame.
    velocity : (4,) ω, of shift, zoom and turn, pixels per time unit.
    excess, weight : (2, 4) sums of what frames said of q, weighed, and of the weights; without and
        with a given motion.
    scale, pairs : (4,) how many times the model's the variances of differences are, and pairs
        behind that.
    evidence : log-odds of the given motion against none; whether it is ``followed``.
    left : (4,) what of the given velocity was not followed, and so is in the targets' own.
    """

    mean: F8 = field(default_factory=lambda: np.zeros((0, 0)))
    covariance: F8 = field(default_factory=lambda: np.zeros((0, 0, 0)))
    velocity: F8 = field(default_factory=lambda: np.zeros(4))
    excess: F8 = field(default_factory=lambda: np.zeros((2, 4)))
    weight: F8 = field(default_factory=lambda: np.zeros((2, 4)))
    scale: F8 = field(default_factory=lambda: np.ones(4))
    pairs: F8 = field(default_factory=lambda: np.zeros(4))
    evidence: float = 0.0
    followed: bool = False
    left: F8 = field(default_factory=lambda: np.zeros(4))


def _after(step: F8, base: F8) -> F8:
    """The motion ``step`` after ``base``; `types.STILL` is none."""
    if not len(step):
        return base
    if len(base):
        return step @ base
    return step


class _Found(NamedTuple):
    """One alternative: the whole ``warp``, its evidence, new sums of q, and sums of squared errors
    and of pairs (2, 4).
    """

    warp: F8
    evidence: float
    excess: F8
    weight: F8
    squares: F8


@dataclass(frozen=True, slots=True)
class CommonMotion(Checked, CameraEstimator[CameraState]):
    """Settings of the camera's motion from the detections, of boxes.

    Parameters
    ----------
    frame_size : of the images, pixels.
    """

    frame_size: tuple[float, float] = (1.0, 1.0)

    def start(self) -> CameraState:
        """A camera that stands still."""
        return CameraState()

    def between(
        self, state: CameraState, detections: Detections, model: Model, dt: float, given: F8
    ) -> tuple[CameraState, F8]:
        """The camera's motion since the last frame, and the state with what was learned from it."""
        fading = math.exp(-dt / (model.rate * VELOCITY_MEMORY))
        bases = [similarity(self._of_note(fading * dt * state.velocity), self._frame)]
        if len(given):
            bases.append(
                _after(similarity(self._of_note(-fading * dt * state.left), self._frame), given)
            )
        z = model.sensor.measure(detections if detections.observed else Detections.empty())
        if not z.shape[1] or not len(state.mean):
            warp = bases[-1 if state.followed else 0]
            return self._moved(state, warp, given, dt, fading), warp
        alternatives = [
            self._found(
                state,
                z,
                replace(model, warp=base) if len(base) or len(model.warp) else model,
                dt,
                which,
            )
            for which, base in enumerate(bases)
        ]
        evidence = state.evidence
        followed = state.followed
        if len(alternatives) == 2:
            more = min(max(alternatives[1].evidence - alternatives[0].evidence, -_MOST), _MOST)
            evidence = math.exp(-1 / _EVIDENCE_FRAMES) * evidence + more
            followed = evidence > (-SWITCH_EVIDENCE if followed else SWITCH_EVIDENCE)
        chosen = alternatives[-1 if followed else 0]
        kept = math.exp(-chosen.squares[1, 0] / _PAIRS_KEPT) * state.pairs
        scale = (
            state.scale * (_PAIRS + kept + chosen.squares[0]) / (_PAIRS + kept + chosen.squares[1])
        )
        excess = state.excess.copy()
        weight = state.weight.copy()
        for which, one in enumerate(alternatives):
            excess[which] = one.excess
            weight[which] = one.weight
        scale = np.minimum(np.maximum(scale, 0.01), 10.0)
        pairs = kept + chosen.squares[1]
        after = CameraState(
            state.mean,
            state.covariance,
            state.velocity,
            excess,
            weight,
            scale,
            pairs,
            evidence,
            followed,
            state.left,
        )
        return self._moved(after, chosen.warp, given, dt, fading), chosen.warp

    def with_targets(self, state: CameraState, estimates: Estimates) -> CameraState:
        """The state with the targets of this frame."""
        s = state
        mean = np.ascontiguousarray(estimates.state.T)
        more = s.velocity, s.excess, s.weight, s.scale, s.pairs, s.evidence, s.followed, s.left
        return CameraState(mean, estimates.covariance, *more)

    def _found(self, state: CameraState, z: F8, model: Model, dt: float, which: int) -> _Found:
        """What the measurements (m, N) say after the camera's motion of the model; ``which`` is 1
        where that was given.
        """
        _, _, ahead = moved(model, state.mean, state.covariance, dt, "linear")
        columns = np.ascontiguousarray(ahead.mean.T)
        frame = self._frame
        noise = model.sensor.target_noise(columns)
        if len(noise):
            noise = noise
        else:
            noise = model.sensor.measurement_noise(z).mean(axis=0, keepdims=True)
        boxes = differences(
            ahead.mean, ahead.covariance, noise, np.ascontiguousarray(z[:4].T), state.scale
        )
        detected = np.minimum(model.sensor.p_detect(columns), 0.95)
        density = z.shape[1] / (4 * frame[0] * frame[1])
        kept = math.exp(-1 / MEMORY)
        rule = (detected, density, frame, dt, JUMP_PENALTY, LEAST_SHARE, kept)
        motion, *said = frame_motion(
            boxes, rule, which == 0, state.excess[which], state.weight[which]
        )
        return _Found(_after(similarity(motion, self._frame), model.warp), *said)

    def _moved(
        self, state: CameraState, warp: F8, given: F8, dt: float, fading: float
    ) -> CameraState:
        """The state after the camera moved by ``warp`` in the interval, and ``given`` was said of
        it.
        """
        velocity = motion_of(warp, self._frame) / dt
        if state.followed or not len(given):
            left = fading * state.left
        else:
            left = motion_of(given, self._frame) / dt - velocity
        s = state
        return CameraState(
            s.mean,
            s.covariance,
            velocity,
            s.excess,
            s.weight,
            s.scale,
            s.pairs,
            s.evidence,
            s.followed,
            left,
        )

    def _of_note(self, motion: F8) -> F8:
        """(4,) the motion without components that are next to nothing."""
        return np.where(np.abs(motion) < LEAST * self._frame[2], 0.0, motion)

    @property
    def _frame(self) -> F8:
        """(3,) the middle of the image and half of its width."""
        width, height = self.frame_size
        return np.array([width / 2, height / 2, width / 2])


def similarity(motion: F8, frame: F8) -> F8:
    """(3, 3) the similarity with this shift, zoom and turn (4,) about the middle of the image.

    `types.STILL` for no motion.

    Parameters
    ----------
    motion : (4,) pixels.
    frame : (3,) the middle of the image and half of its width, pixels.
    """
    if not motion.any():
        return STILL
    x, y, half = frame
    zoom = math.exp(min(max(motion[2] / half, -_ZOOM), _ZOOM))
    turn = motion[3] / half
    c = zoom * math.cos(turn)
    s = zoom * math.sin(turn)
    return np.array(
        [
            [c, -s, x + motion[0] - c * x + s * y],
            [s, c, y + motion[1] - s * x - c * y],
            [0.0, 0.0, 1.0],
        ]
    )


def motion_of(warp: F8, frame: F8) -> F8:
    """(4,) shift, zoom and turn of what is in the middle of the image, pixels; see `similarity`."""
    if not len(warp):
        return np.zeros(4)
    x, y, half = frame
    there, down, right, sideways, size = warp_of.warp_states(
        np.array([[x, y, 1.0, 0.0, 1.0]]).T, warp
    )[:, 0]
    return np.array(
        [there - x, down - y, half * math.log(size), half * math.atan2(sideways, right)]
    )
