"""Camera motion estimated from the detections alone: the innovation that all targets share.

A target's own motion is in its state. A remaining shift, zoom and turn about the middle of the
image that all targets share (`kernels.common_motion`) is the camera's. Its velocity ω, of these
four components in pixels, follows

    ω_k = e^(−T/τ) ω_{k−1} + ε_k,    ε_k of Student's t with the scales √q

The velocities of all targets soon include a constant motion of the camera; ω is the rest.

If the camera's motion is given, by a file or measured in pictures, it replaces the first term,
without the part that is in the velocities already, and its ε have scales of their own. The
accumulated evidence chooses between the two, with hysteresis: given motions that do not explain the
detections are not followed.

A fixed camera must lose nothing. So q is learned from the estimates r without the prior and their
variances C: each frame contributes r² − C with weight 1/(q + C)². The mean is reduced by one
standard error, and a component with q = 0 stands still. A sudden motion is found by a vote on the
differences of similar boxes; it must explain the detections better by a margin. The accuracy of
boxes is learned, too, from all pairs: a factor for each component.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from phdtrack.errors import Checked
from phdtrack.kernels.common_motion import (
    LEAST,
    MOST_DETECTED,
    differences,
    learned_motion,
    motion_of_boxes,
)
from phdtrack.models import warp as warp_of
from phdtrack.models.box import BoxMotion, BoxSensor
from phdtrack.models.gaussian import carried, moved
from phdtrack.protocols import CameraEstimator, Model
from phdtrack.types import F8, STILL, Estimates, state_record

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
# Pairs that the prior of the accuracy of boxes counts for, and the number of pairs in memory.
_PAIRS = 40.0
_PAIRS_KEPT = 500.0
# Limits of the ratio of the variances of boxes to the model's.
_SCALES = (0.01, 10.0)
# Log-evidence of one frame for or against the given motion, at most, and frames after which it
# counts for 37 %.
_MOST = 10.0
_EVIDENCE_FRAMES = 33.0
# No camera zooms by more from one frame to the next (logarithm).
_ZOOM = 4.6
NO_MOTION: F8 = np.zeros(4)


@state_record
class CameraState:
    """The state of the camera's motion between frames.

    Attributes
    ----------
    mean, covariance : (n, d), (n, d, d) the targets of the last frame.
    velocity : (4,) ω, of shift, zoom and turn, pixels per time unit.
    excess, weight : (2, 4) weighted sums of the frames' estimates of q, and of their weights;
        without and with a given motion.
    scale, pairs : (4,) ratios of the variances of differences to the model's, and the numbers of
        pairs behind them.
    evidence : log-odds of the given motion against none; ``followed``: true if it is used.
    left : (4,) the part of the given velocity that was not followed, and so is in the targets' own.
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


class _Alternative(NamedTuple):
    """One alternative: the whole ``warp``, its evidence, new sums of q, and the accuracy of boxes
    with the pairs behind it.
    """

    warp: F8
    evidence: float
    excess: F8
    weight: F8
    scale: F8
    pairs: F8


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
        self, state: CameraState, z: F8, model: Model, dt: float, given: F8
    ) -> tuple[CameraState, F8]:
        """The camera's motion since the last frame, and the state with what was learned from it."""
        fading = math.exp(-dt / (model.rate * VELOCITY_MEMORY))
        frame = _frame_of(self.frame_size)
        bases = [STILL]
        if state.velocity is not NO_MOTION and np.count_nonzero(state.velocity):
            bases = [similarity(_of_note(fading * dt * state.velocity, frame), frame)]
        if len(given):
            left = similarity(_of_note(-fading * dt * state.left, frame), frame)
            bases.append(_after(left, given))
        if not z.shape[1] or not len(state.mean):
            warp = bases[-1 if state.followed else 0]
            velocity, left = self._moved((state.left, state.followed), warp, given, dt, fading)
            return replace(state, velocity=velocity, left=left), warp
        excess = state.excess.copy()
        weight = state.weight.copy()
        alternatives = list[_Alternative]()
        for which, base in enumerate(bases):
            one = self._alternative(state, z, model, base, dt, which)
            excess[which] = one.excess
            weight[which] = one.weight
            alternatives.append(one)
        evidence = state.evidence
        followed = state.followed
        if len(alternatives) == 2:
            more = min(max(alternatives[1].evidence - alternatives[0].evidence, -_MOST), _MOST)
            evidence = math.exp(-1 / _EVIDENCE_FRAMES) * evidence + more
            followed = evidence > (-SWITCH_EVIDENCE if followed else SWITCH_EVIDENCE)
        chosen = alternatives[-1 if followed else 0]
        velocity, left = self._moved((state.left, followed), chosen.warp, given, dt, fading)
        after = CameraState(
            state.mean,
            state.covariance,
            velocity,
            excess,
            weight,
            chosen.scale,
            chosen.pairs,
            evidence,
            followed,
            left,
        )
        return after, chosen.warp

    def with_targets(self, state: CameraState, estimates: Estimates) -> CameraState:
        """The state with the targets of this frame."""
        # `dataclasses.replace` takes several times as long.
        return CameraState(
            np.ascontiguousarray(estimates.state.T),
            estimates.covariance,
            state.velocity,
            state.excess,
            state.weight,
            state.scale,
            state.pairs,
            state.evidence,
            state.followed,
            state.left,
        )

    def _alternative(
        self, state: CameraState, z: F8, model: Model, base: F8, dt: float, which: int
    ) -> _Alternative:
        """The alternative after the camera's motion ``base``, with the measurements (m, N);
        ``which`` is 1 if that motion was given.
        """
        if len(base) or len(model.warp):
            model = model.with_warp(base)
        frame = _frame_of(self.frame_size)
        # Of detections, per pixel²
        density = z.shape[1] / (4 * frame[0] * frame[1])
        rule = (density, frame, dt, JUMP_PENALTY, LEAST_SHARE, math.exp(-1 / MEMORY))
        known = (
            which == 0,
            (state.excess[which], state.weight[which]),
            (state.scale, state.pairs),
            (_PAIRS, _PAIRS_KEPT, *_SCALES),
        )
        motion = model.motion
        sensor = model.sensor
        if type(motion) is BoxMotion and type(sensor) is BoxSensor and sensor.noise_of_target:
            found = motion_of_boxes(
                carried(model, state.mean, state.covariance),
                z,
                tuple(motion.dynamics(dt, dt / model.rate)),
                (sensor.numbers[0], sensor.detection_probability),
                rule,
                *known,
            )
        else:
            found = self._found(state, z, model, rule, known)
        return _Alternative(_after(similarity(found[0], frame), model.warp), *found[1:])

    def _found(
        self, state: CameraState, z: F8, model: Model, rule: tuple[Any, ...], known: tuple[Any, ...]
    ) -> tuple[Any, ...]:
        """The finding of `learned_motion` for any motion and sensor of boxes.

        Parameters
        ----------
        state, z, model : as in `_alternative`; the model has the motion that the camera made.
        rule, known : of `learned_motion`, without p_D; the rest of its arguments.
        """
        _, _, ahead = moved(model, state.mean, state.covariance, rule[2], "linear")
        columns = np.ascontiguousarray(ahead.mean.T)
        noise = model.sensor.target_noise(columns)
        if not len(noise):
            noise = model.sensor.measurement_noise(z).mean(axis=0, keepdims=True)
        boxes = differences(
            ahead.mean, ahead.covariance, noise, np.ascontiguousarray(z[:4].T), state.scale
        )
        detected = np.minimum(model.sensor.p_detect(columns), MOST_DETECTED)
        found: tuple[Any, ...] = learned_motion(boxes, (detected, *rule), *known)
        return found

    def _moved(
        self, known: tuple[F8, bool], warp: F8, given: F8, dt: float, fading: float
    ) -> tuple[F8, F8]:
        """`CameraState.velocity` and ``left`` after the camera moved by ``warp`` in the interval.

        ``known``: ``left`` before, and whether the ``given`` motion is followed.
        """
        frame = _frame_of(self.frame_size)
        velocity = motion_of(warp, frame) / dt if len(warp) else NO_MOTION
        left, followed = known
        if followed or not len(given):
            return velocity, fading * left
        return velocity, motion_of(given, frame) / dt - velocity


@lru_cache(maxsize=8)
def _frame_of(size: tuple[float, float]) -> F8:
    """(3,) the middle of an image of this size and half of its width."""
    width, height = size
    return np.array([width / 2, height / 2, width / 2])


def _of_note(motion: F8, frame: F8) -> F8:
    """(4,) the motion with negligible components set to 0; ``frame`` as of `similarity`."""
    return np.where(np.abs(motion) < LEAST * frame[2], 0.0, motion)


def similarity(motion: F8, frame: F8) -> F8:
    """(3, 3) the similarity with this shift, zoom and turn (4,) about the middle of the image.

    `types.STILL` for no motion.

    Parameters
    ----------
    motion : (4,) pixels.
    frame : (3,) the middle of the image and half of its width, pixels.
    """
    if not np.count_nonzero(motion):
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
    """(4,) shift, zoom and turn at the middle of the image, pixels; the inverse of `similarity`."""
    if not len(warp):
        return np.zeros(4)
    x, y, half = frame
    there, down, right, sideways, size = warp_of.warp_states(
        np.array([[x, y, 1.0, 0.0, 1.0]]).T, warp
    )[:, 0]
    return np.array(
        [there - x, down - y, half * math.log(size), half * math.atan2(sideways, right)]
    )
