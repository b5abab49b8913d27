"""People on the ground: motion and sensor.

**Motion.** State x = (px, py, vx, vy): metres and metres per second in the world's axes; the time
unit is the second. Constant velocity, pushed by a white-noise acceleration (`models.positions`).

**Sensor.** The foot of a person's box, projected to the ground by the camera [E13 §3]: z = (X, Y,
c_xx, c_xy, c_yy), the ground point of the middle of the box's lower edge, metres, and its own
covariance, m². g(z|x) = N((X, Y); (px, py), R):

``given``: R is the covariance of each detection, P_W = J C Jᵀ: C of the foot point in pixels, J the
camera's metres per pixel there. Far away a pixel is metres, and R says so. ``fixed``: the same for
all; E13's R = 0.5 I m².

The detection probability is constant, or falls with the visible part of the person's box of nominal
size:

    p_D(x) = p_D · visible(x) · max(1 − c(x)^1.5, least)

``visible`` is the part of the box inside the image (``view``), c the largest part that the box of
one single nearer target covers (``occlusion``): a detector finds a person by the visible part,
which E13's filter ignores [E13 §6]. The exponent was measured: of boxes that are covered to 5, 22,
45, 65 and 87 %, detectors find .98, .86, .72, .50 and .18 of what they find of free ones.

The targets that hide others are those of the last frame at their predicted positions, not the boxes
of this frame: a box does not say which target it shows. And if p_D fell for people whom this frame
shows, the remaining weight of the undetected part would count them twice. A target does not hide
itself: a state belongs to the nearest hider, if that is within the 99 % region of the sensor's
noise, and all others may hide it. In a crowd many hiders are within that region: if all of them
counted as the state's own, hardly anybody would be hidden.

Without a camera the image is a plan in metres: the middle of a box is the position, and no target
hides another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from phdtrack.arrays import GATE, share_inside, to_cxcywh
from phdtrack.devices import Camera
from phdtrack.errors import InputError, NonNegative, Positive, Probability, Share, check
from phdtrack.ground import ground_covariance
from phdtrack.kernels.grid import make_grid, overlapping_pairs
from phdtrack.models.positions import Form, PositionMotion, PositionSensor
from phdtrack.models.volumes import EVERYWHERE, Region, check_region, inside
from phdtrack.types import F8, Detections


@dataclass(frozen=True, slots=True)
class PlaneMotion(PositionMotion):
    """f and p_S on the ground plane [E13 §4].

    Parameters
    ----------
    acceleration : a; ``continuous``: standard deviation of the velocity's change over one second,
        m/s; ``piecewise``: of the acceleration, m/s², E13's is 1.
    survival_probability : probability p_S that a target is still there after one second.
    form : ``continuous`` or ``piecewise``, see `models.positions`.
    borders : left, low, right and high border in metres; a target that has left it does not
        survive. All 0: no border.
    """

    acceleration: NonNegative = 7**-0.5
    survival_probability: Probability = 0.99**7
    form: Form = "continuous"
    borders: Region = EVERYWHERE


Scatter = Literal["given", "fixed"]
# Squared Mahalanobis radius of the 99 % region in two dimensions.
OWN = 9.21
# Box of a state that no pixel shows: of one pixel, far outside of any image.
OUTSIDE = np.array([-1e4, -1e4, -1e4 + 1, -1e4 + 1])
# Maps centre and size of a box to the middle of its lower edge.
_FOOT = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0.5]])
# Exponent that maps the covered part to the part of p_D that is lost.
SHAPE = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Hiders:
    """The K targets of a frame that may hide others.

    Attributes
    ----------
    xyxy : (K, 4) boxes, pixels.
    depth : (K,) how far away each stands, in any unit that grows with distance.
    position : (r, K) their observed components.
    noise : (r, K) deviations by which these are resolved there.
    region : squared distance in deviations within which a state is that of the nearest hider.
    least : share of p_D that is left for a fully covered target.
    """

    xyxy: F8
    depth: F8
    position: F8
    noise: F8
    region: float
    least: float

    def visible_part(self, position: F8, xyxy: F8, depth: F8) -> F8:
        """(L,) share of p_D that is left, max(1 − c^1.5, least).

        Parameters
        ----------
        position : array (r, L), observed components of the targets.
        xyxy : array (L, 4), their boxes.
        depth : array (L,), how far away they stand.
        """
        low = np.ascontiguousarray(xyxy[:, :2].T)
        high = np.ascontiguousarray(xyxy[:, 2:].T)
        lower = np.ascontiguousarray(self.xyxy[:, :2].T)
        upper = np.ascontiguousarray(self.xyxy[:, 2:].T)
        i, j = overlapping_pairs(low, high, make_grid(lower, upper))
        apart = (((position[:, i] - self.position[:, j]) / self.noise[:, j]) ** 2).sum(axis=0)
        own = np.full(len(depth), self.region)
        np.minimum.at(own, i, apart)
        others = (self.depth[j] < depth[i]) & (apart > own[i])
        i = i[others]
        j = j[others]
        width, height = np.maximum(
            np.minimum(high[:, i], upper[:, j]) - np.maximum(low[:, i], lower[:, j]), 0.0
        )
        covered = np.zeros(len(depth))
        np.maximum.at(
            covered, i, width / (high[0, i] - low[0, i]) * (height / (high[1, i] - low[1, i]))
        )
        return np.maximum(1 - covered**SHAPE, self.least)


@dataclass(frozen=True, slots=True)
class PlaneSensor(PositionSensor):
    """g and p_D on the ground plane [E13 §4].

    Parameters
    ----------
    detection_probability : probability p_D that a fully visible target is detected in a frame;
        E13's is 0.7.
    scaling : source of R, ``given`` or ``fixed``, see above.
    fixed_noise : standard deviation of each coordinate in metres, for ``fixed``, and if nothing
        better is known; E13's is √0.5.
    box_noise : deviations of the foot point, as fractions of the box's width and height, of
        detections without a covariance.
    min_noise : the smallest of them, pixels.
    birth_speed : standard deviation of an unknown velocity's amplitude, m/s; E13's variance of 1 on
        each axis is √2.
    size : width and height of a person, metres, for the boxes of states.
    gate_probability : part of the detections of a target that its gate holds; detections touch no
        particles beyond. 1: no gate.
    view : let p_D fall with the part of the person's box that is outside of the image, or be 0
        outside of ``borders`` without a camera.
    occlusion : let p_D fall for people who are covered by nearer ones.
    min_detection_probability : share of p_D that is left for a fully covered person.
    borders : the observed region, left, low, right and high border in metres, without a camera. All
        0: everything.
    frame_size : width and height of the image, pixels; (0, 0): no border.
    camera : between pixels and ground; None for detections in metres.
    hiders : the targets predicted for the present frame, from `watching`.
    """

    detection_probability: Probability = 0.9
    scaling: Scatter = "given"
    fixed_noise: Positive = 0.5**0.5
    box_noise: tuple[Positive, Positive] = (0.1, 0.05)
    min_noise: Positive = 1.0
    birth_speed: Positive = 2**0.5
    size: tuple[Positive, Positive] = (0.6, 1.75)
    gate_probability: Share = GATE
    view: bool = True
    occlusion: bool = True
    min_detection_probability: Probability = 0.1
    borders: Region = EVERYWHERE
    frame_size: tuple[float, float] = (0.0, 0.0)
    camera: Camera | None = None
    hiders: Hiders | None = None
    constant_noise: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check(self)
        check_region(self.borders, "PlaneSensor.borders")

    def measure(self, detections: Detections) -> F8:
        """(5, N) ground points and their covariances; columns of NaN for feet that are not on the
        ground.

        Raises `InputError` if the scaling is ``given`` and there is neither a camera nor a
        covariance.
        """
        if len(detections) == 0:
            return np.zeros((5, 0))
        box = to_cxcywh(detections.xyxy)
        foot = _FOOT @ box
        cov = detections.covariance
        if self.scaling == "fixed":
            noise = np.tile(self.fixed_noise**2 * np.eye(2), (len(detections), 1, 1))
        elif self.camera is not None:
            if cov is None:
                pixel = self._pixel_covariance(box[2:])
            else:
                pixel = _FOOT @ cov @ _FOOT.T
            noise = ground_covariance(self.camera, foot, pixel)
        elif cov is not None:
            noise = cov[:, :2, :2]
        else:
            raise InputError(
                "the sensor's scaling is 'given' and it has no camera, but the detections bring no"
                " covariance",
                cure="Use sensor.scaling=fixed, or give a camera",
            )
        if self.camera is None:
            point = box[:2]
        else:
            point = self.camera.ground(foot)
        z = np.stack([*point, noise[:, 0, 0], noise[:, 0, 1], noise[:, 1, 1]])
        usable = np.isfinite(z).all(axis=0) & (z[2] * z[4] > z[3] ** 2)
        return np.where(usable, z, np.nan)

    def _pixel_covariance(self, size: F8) -> F8:
        """(N, 2, 2) covariances of the foot points of boxes of ``size`` (2, N), pixels²."""
        variance = np.maximum(np.array(self.box_noise)[:, None] * size, self.min_noise) ** 2
        return variance.T[:, :, None] * np.eye(2)

    def p_detect(self, x: F8) -> F8:
        """p_D · visible · max(1 − c^1.5, least)."""
        if self.camera is None:
            if self.view:
                watched = inside(x, self.borders)
            else:
                watched = np.ones(x.shape[1], np.bool_)
            return np.where(watched, self.detection_probability, 0.0)
        out = np.full(x.shape[1], self.detection_probability)
        width, height = self.frame_size
        framed = self.view and width > 0 and height > 0
        if not framed and self.hiders is None:
            return out
        boxes = self.boxes(x)
        if framed:
            out *= share_inside(boxes, width, height)
        if self.hiders is not None:
            out *= self.hiders.visible_part(
                x[:2], boxes, self.camera.depth(np.ascontiguousarray(x[:2]))
            )
        return out

    def watching(self, targets: F8) -> PlaneSensor:
        """The sensor with people predicted at these states; itself without people or without
        occlusion.
        """
        if not self.occlusion or self.camera is None or targets.shape[1] == 0:
            return self
        position = np.ascontiguousarray(targets[:2])
        hiders = Hiders(
            self.boxes(targets),
            self.camera.depth(position),
            position,
            self.noise(targets)[:2],
            OWN,
            self.min_detection_probability,
        )
        return replace(self, hiders=hiders)

    def noise(self, x: F8) -> F8:
        """(4, n) deviations by which components at ``x`` are resolved: of a person's foot there,
        and of an unknown velocity.
        """
        out = np.empty((4, x.shape[1]))
        out[:2] = self.fixed_noise
        out[2:] = self.birth_speed / math.sqrt(2)
        if self.camera is None or self.scaling == "fixed":
            return out
        foot = self.camera.pixels(np.ascontiguousarray(x[:2]))
        box = to_cxcywh(self.boxes(x))
        variance = np.diagonal(
            ground_covariance(self.camera, foot, self._pixel_covariance(box[2:])), axis1=1, axis2=2
        ).T
        known = np.isfinite(variance).all(axis=0)
        out[:2, known] = np.sqrt(variance[:, known])
        return out

    def boxes(self, x: F8) -> F8:
        """(n, 4) boxes of people of the nominal size standing there; the width is by the camera's
        pixels per metre across at the foot.

        A camera that knows no heights (a homography) uses the same scale for the height. A person
        outside of the image has a box of one pixel far outside of the image.
        """
        wide, tall = self.size
        position = np.ascontiguousarray(x[:2])
        if self.camera is None:
            return np.concatenate([position - wide / 2, position + wide / 2]).T.copy()
        foot = self.camera.pixels(position)
        head = self.camera.pixels(np.vstack([position, np.full(x.shape[1], tall)]))
        scale = 1 / np.hypot(*self.camera.jacobian(foot)[:, :, 0].T)
        height = foot[1] - head[1]
        height = np.maximum(np.where(np.isfinite(height), height, tall * scale), 1.0)
        half = np.maximum(wide * scale, 1.0) / 2
        out = np.stack([foot[0] - half, foot[1] - height, foot[0] + half, foot[1]], axis=1)
        return np.where(np.isfinite(out).all(axis=1)[:, None], out, OUTSIDE)
