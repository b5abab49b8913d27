"""Detection of change: against a reference that adapts [M07] [M09], and against a fixed mean background [D14 §II-B].

**change** is statistical colour change detection, after Cavallaro and Ebrahimi (2004). Without change, frame and reference
differ by noise. The difference of each pixel is taken in three channels c that keep brightness apart from colour (logarithm
of luma; the two chroma differences), divided by the deviation that noise explains there, and summed; the mean of that over a
small window W is the statistic, compared with a χ² quantile of 3 degrees:

    T(p) = (1/|W|) Σ_{q∈W} (1/s(q)) Σ_c d_c(q)² / σ_c²   >   χ²₃(1 − false alarm rate)

The noise has three parts: the camera's, σ_c; local light (shadows, reflections), which is relative, hence the logarithm,
and stronger towards dark; and the scene's, s(q) ≥ 1, learned for each pixel (leaves, edges that tremble). Global
illumination changes all pixels of a channel by about a gain and an offset, which are fitted to the background.

The reference is at first the median of samples of the first seconds. Then it adapts exponentially, on foreground with a much
longer time constant. A component whose outline is a stronger edge in the reference than in the frame is where an object
stood when the reference was learned and has left since; it is not reported, and when it lasts the reference takes it in.

**mean-background**: the fixed background is the mean of the first n grey frames, or of frames given beforehand. Its
difference to a frame is smoothed by a Gaussian low-pass and thresholded; connected components give the boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Annotated

import cv2
import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from phdtrack.detect.components import BlobSettings, Contour, check_same_size
from phdtrack.errors import InputError, NonNegative, Positive, PositiveCount, check
from phdtrack.types import F8, Bool, Detections, Frame, Image

F4 = NDArray[np.float32]
OpenShare = Annotated[float, Gt(0), Lt(1)]
Planes = tuple[Image, Image, Image]

_GRID_POINTS = 4000
_DARKEST, _BRIGHTEST = 8, 245
_FEWEST = 50
_NEAR = 2.5
_ROUNDS = 3
CHANNELS = 3
_LOG_KNEE = 16.0
_LOG_SCALE = 90.0
_LOG: Image = np.rint(_LOG_SCALE * np.log1p(np.arange(256) / _LOG_KNEE)).astype(np.uint8)
_QUARTILE_OF_NORMAL = 1.1503
_MEDIAN_OF_CHI2 = 0.789
_NOISE_MEMORY = 0.9
_LOUDEST = 20.0
_GHOST_EDGE = 0.8
# What flies past and hides an edge looks like a ghost for a frame or two: learned at once, it would be one ever after.
_GHOST_SECONDS = 0.2
_MARGIN = np.ones((5, 5), np.uint8)


@dataclass(eq=False)
class ChangeDetector:
    """Boxes around whatever differs from the learned scene; nothing on the first frame.

    Attributes
    ----------
    false_alarm : share of unchanged pixels that may pass the test before clean-up.
    window : side of the window W in pixels, odd.
    shadow, glare : usual relative change of brightness by local light, towards dark and towards bright (one deviation).
    chroma : usual change of colour by local light, grey levels (one deviation).
    learn : seconds over which the first reference is learned; detections come from the second frame on.
    samples : frames of which the first reference is the median; odd.
    adapt : time constant in seconds with which the reference follows the background.
    adapt_objects : the same under objects: how long what has stopped stays an object.
    blobs : how the mask becomes boxes.
    """

    false_alarm: OpenShare = 0.005
    window: PositiveCount = 5
    shadow: Positive = 0.11
    glare: Positive = 0.055
    chroma: Positive = 3.0
    learn: Positive = 4.0
    samples: PositiveCount = 15
    adapt: Positive = 10.0
    adapt_objects: Positive = 120.0
    blobs: BlobSettings = field(default_factory=BlobSettings)

    def __post_init__(self) -> None:
        check(self)
        for name, value in (("window", self.window), ("samples", self.samples)):
            if value % 2 != 1:
                raise InputError(f"expected an odd whole number, got {value!r}", where=f"ChangeDetector.{name}")
        # χ² quantile by the cube-root approximation of Wilson and Hilferty, within 1 % for 3 degrees.
        c = 2.0 / (9.0 * CHANNELS)
        z = NormalDist().inv_cdf(1.0 - self.false_alarm)
        self._threshold = CHANNELS * max(0.0, 1.0 - c + z * c**0.5) ** 3
        self.reset()

    def reset(self) -> None:
        """Forget the scene."""
        self._samples: list[Image] = []

    def __call__(self, frame: Frame) -> Detections:
        """The boxes of what changed in ``frame`` (H, W, 3) [M09]."""
        if not self._samples:
            self._begin(frame)
            return Detections.empty()
        check_same_size(frame, self._foreground.shape)
        planes = _planes(frame.image)
        self._learn_camera_noise(planes)
        self._sample(frame)
        expected = _relit(cv2.convertScaleAbs(self._reference), frame.image, self._foreground)
        energy = self._energy(planes, _planes(expected))
        mask = self.blobs.clean(self._changed(energy))
        found = self.blobs.components(mask)
        ghosts = [contour for contour in found if _is_ghost(contour, frame.image, expected)]
        self._adapt(frame, energy, mask, ghosts)
        real = [contour for contour in found if not any(contour is ghost for ghost in ghosts)]
        return Detections.of(self.blobs.boxes(real, mask.shape))

    def _begin(self, frame: Frame) -> None:
        """Take the first frame as the reference."""
        shape = frame.image.shape[:2]
        self._samples, self._due = [frame.image], frame.time + self.learn / self.samples
        self._learning = self.samples > 1
        self._reference: F4 = frame.image.astype(np.float32)
        self._foreground: Image = np.zeros(shape, np.uint8)
        self._scene: F4 = np.full(shape, float(CHANNELS), np.float32)
        self._haunted: F4 = np.zeros(shape, np.float32)
        self._camera: F8 = np.ones(CHANNELS)
        self._previous = _planes(frame.image)
        self._time = frame.time

    def _sample(self, frame: Frame) -> None:
        """Take the frame for the first reference if one is due; of every other one the median, and the scene's noise."""
        if not self._learning or frame.time < self._due:
            return
        self._due += self.learn / self.samples
        self._samples.append(frame.image)
        self._learning = len(self._samples) < self.samples
        if len(self._samples) % 2 == 0:
            return
        self._reference = _median(self._samples).astype(np.float32)
        if len(self._samples) >= 5:
            expected = _planes(cv2.convertScaleAbs(self._reference))
            energies = np.stack([self._energy(_planes(sample), expected) for sample in self._samples])
            # The median is not moved by objects that pass by.
            typical = np.median(energies, axis=0).astype(np.float32) / _MEDIAN_OF_CHI2
            spread = cv2.dilate(cv2.blur(typical, (5, 5)), np.ones((3, 3), np.uint8))
            self._scene = np.minimum(spread, np.float32(CHANNELS * _LOUDEST))
        if not self._learning:
            del self._samples[1:]

    def _learn_camera_noise(self, now: Planes) -> None:
        """σ_c from the third quartile of |difference of successive frames| on a sparse grid."""
        pairs = zip(now, self._previous, strict=True)
        quartile = [np.percentile(cv2.absdiff(a[::4, ::4], b[::4, ::4]), 75) for a, b in pairs]
        latest = np.array(quartile) / (_QUARTILE_OF_NORMAL * np.sqrt(2))
        self._camera = _NOISE_MEMORY * self._camera + (1 - _NOISE_MEMORY) * latest
        self._previous = now

    def _energy(self, image: Planes, expected: Planes) -> F4:
        """(H, W) Σ_c d_c² / σ_c², the variances of local light and camera added."""
        terms = (
            (cv2.subtract(expected[0], image[0]), _LOG_SCALE * self.shadow, 0),
            (cv2.subtract(image[0], expected[0]), _LOG_SCALE * self.glare, 0),
            (cv2.absdiff(image[1], expected[1]), self.chroma, 1),
            (cv2.absdiff(image[2], expected[2]), self.chroma, 2),
        )
        # A difference of 8-bit planes has 256 values: one look-up per term is all the arithmetic there is.
        total: F4 = np.zeros(image[0].shape, np.float32)
        for difference, deviation, channel in terms:
            variance = deviation**2 + float(self._camera[channel]) ** 2
            table = (np.arange(256, dtype=np.float64) ** 2 / variance).astype(np.float32)
            cv2.add(total, cv2.LUT(difference, table), dst=total)
        return total

    def _changed(self, energy: F4) -> Image:
        """The raw mask: the window's mean must pass, and half of it the pixel itself, which keeps outlines sharp."""
        normal = energy / np.maximum(self._scene * np.float32(1 / CHANNELS), np.float32(1))
        side = (self.window, self.window)
        window: Image = cv2.compare(cv2.blur(normal, side), self._threshold, cv2.CMP_GT)
        pixel: Image = cv2.compare(normal, self._threshold / 2, cv2.CMP_GT)
        return window & pixel

    def _adapt(self, frame: Frame, energy: F4, mask: Image, ghosts: list[Contour]) -> None:
        """Let reference and scene noise follow, by the time that has passed."""
        passed = max(0.0, frame.time - self._time)
        self._time = frame.time
        self._foreground = cv2.dilate(mask, _MARGIN)
        background = cv2.bitwise_not(self._foreground)
        cv2.accumulateWeighted(energy, self._scene, min(0.2, passed / self.adapt), background)
        np.minimum(self._scene, np.float32(CHANNELS * _LOUDEST), out=self._scene)
        if self._learning:
            return
        cv2.accumulateWeighted(frame.image, self._reference, min(1.0, passed / self.adapt), background)
        cv2.accumulateWeighted(frame.image, self._reference, min(1.0, passed / self.adapt_objects), self._foreground)
        left = np.zeros_like(mask)
        cv2.drawContours(left, ghosts, -1, 255, cv2.FILLED)
        # The time since its first frame: however few frames a second there are, one alone is not enough.
        lasted = np.where(self._haunted > 0, self._haunted + np.float32(passed), np.float32(1e-6))
        self._haunted = np.where(left > 0, lasted, np.float32(0))
        lasting = (self._haunted >= _GHOST_SECONDS).astype(np.uint8)
        if lasting.any():
            cv2.accumulateWeighted(frame.image, self._reference, 1.0, cv2.dilate(lasting, _MARGIN))


def _relit(reference: Image, frame: Image, foreground: Image) -> Image:
    """(H, W, 3) the picture ``reference`` of the scene in the light of ``frame``; pixels of the foreground are left out."""
    table, level = np.empty((1, 256, 3), np.uint8), np.arange(256, dtype=np.float64)
    step = max(1, round((foreground.size / _GRID_POINTS) ** 0.5))
    grid = slice(step // 2, None, step)
    background = foreground[grid, grid].ravel() == 0
    for channel in range(3):
        x, y = (image[grid, grid, channel].ravel().astype(np.float64) for image in (reference, frame))
        gain, offset = _line(x, y, background)
        table[0, :, channel] = np.rint(np.clip(gain * level + offset, 0, 255))
    return np.asarray(cv2.LUT(reference, table), np.uint8)


def _line(x: F8, y: F8, background: Bool) -> tuple[float, float]:
    """Gain and offset of y ≈ gain·x + offset over unsaturated background; 1 and 0 where there is too little of it."""
    exposed = background & (x > _DARKEST) & (y > _DARKEST) & (x < _BRIGHTEST) & (y < _BRIGHTEST)
    if exposed.sum() < _FEWEST:
        return 1.0, 0.0
    x, y = x[exposed], y[exposed]
    gain, offset = float(np.median(y / x)), 0.0
    for _ in range(_ROUNDS):
        residual = y - gain * x - offset
        scale = 1.4826 * float(np.median(np.abs(residual))) + 0.5
        near = np.abs(residual) < _NEAR * scale
        spread = float(x[near].var()) if near.any() else 0.0
        # A scene of one brightness does not tell gain from offset: keep the gain and move the offset alone.
        if spread > 100.0:
            gain = float(((x[near] - x[near].mean()) * (y[near] - y[near].mean())).mean() / spread)
        offset = float(np.median(y[near] - gain * x[near])) if near.any() else 0.0
    return gain, offset


def _median(images: Sequence[Image]) -> Image:
    """Per-pixel median of an odd number of uint8 images, by exchanges: several times faster than sorting each pixel."""
    ranked = list(images)
    middle = len(ranked) // 2
    for last in range(len(ranked) - 1, middle - 1, -1):
        for i in range(last):
            ranked[i], ranked[i + 1] = cv2.min(ranked[i], ranked[i + 1]), cv2.max(ranked[i], ranked[i + 1])
    return ranked[middle]


def _planes(image: Image) -> Planes:
    """A picture as (H, W) uint8 planes: logarithm of luma, and the two chroma differences."""
    luma, red, blue = cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb))
    return cv2.LUT(luma, _LOG), red, blue


def _is_ghost(contour: Contour, image: Image, expected: Image) -> bool:
    """Whether the outline of a component is more of an edge in the reference than in the frame: its object has left."""
    x, y, width, height = cv2.boundingRect(contour)
    left, top = max(0, x - 4), max(0, y - 4)
    window = (slice(top, y + height + 4), slice(left, x + width + 4))
    filled = np.zeros(image[window].shape[:2], np.uint8)
    cv2.drawContours(filled, [contour], -1, 255, cv2.FILLED, offset=(-left, -top))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    outline = cv2.morphologyEx(filled, cv2.MORPH_GRADIENT, disc) > 0
    return _edge(image[window], outline) < _GHOST_EDGE * _edge(expected[window], outline)


def _edge(image: Image, where: Bool) -> float:
    """Mean gradient of the grey values of ``image`` over the mask ``where``."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    gradient = cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    return float(gradient[where].mean()) if where.any() else 0.0


@dataclass(eq=False)
class MeanBackgroundDetector:
    """Boxes around what differs from the mean of the first frames.

    Attributes
    ----------
    frames : number of frames whose mean is the background; nothing is detected in them.
    signed : True sees only what is darker than the background.
    smooth : standard deviation of the Gaussian low-pass in pixels; 0: none.
    threshold : least difference in grey levels.
    blobs : how the mask becomes boxes.
    """

    frames: PositiveCount = 50
    signed: bool = False
    smooth: NonNegative = 1.5
    threshold: Positive = 20.0
    blobs: BlobSettings = field(default_factory=BlobSettings)

    def __post_init__(self) -> None:
        check(self)
        self.reset()

    def reset(self) -> None:
        """Forget the background."""
        self._seen = 0

    def __call__(self, frame: Frame) -> Detections:
        """[D14 §II-B] The boxes of what differs from the background; none while it is learned."""
        grey = cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY).astype(np.float32)
        if not self._seen:
            self._sum: F4 = np.zeros(grey.shape, np.float32)
        check_same_size(frame, self._sum.shape)
        if self._seen < self.frames:
            self._sum += grey
            self._seen += 1
            return Detections.empty()
        difference = self._sum / np.float32(self._seen) - grey
        if not self.signed:
            difference = np.abs(difference)
        if self.smooth > 0:
            difference = cv2.GaussianBlur(difference, (0, 0), self.smooth)
        mask = cv2.compare(difference, self.threshold, cv2.CMP_GT)
        return self.blobs.detections(np.asarray(mask, np.uint8))
