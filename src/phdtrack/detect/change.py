"""Detection of change: against a reference that adapts [M07] [M09], and against a fixed mean
background [D14 §II-B].

**change** is statistical colour change detection, after Cavallaro and Ebrahimi (2004). Without
change, frame and reference differ by noise. The difference of each pixel is taken in three channels
c that keep brightness apart from colour (logarithm of brightness; the two colour differences, which
four pixels share as in what decoders give, smoothed), divided by the deviation that noise explains
there, and summed; the mean of that over a small window W is the statistic, compared with a χ²
quantile of 3 degrees:

    T(p) = (1/|W|) Σ_{q∈W} (1/s(q)) Σ_c d_c(q)² / σ_c²   >   χ²₃(1 − false alarm rate)

The noise has three parts: the camera's, σ_c; local light (shadows, reflections), which is relative,
hence the logarithm, and stronger towards dark; and the scene's, s(q) ≥ 1, learned for each pixel
(leaves, edges that tremble). Global illumination changes all pixels of a channel by about a gain
and an offset, which are fitted to the background.

Of a file the reference and s(q) are learned from some 50 samples (`reference.background`,
`registry.study`); where objects hid the scene most of the time they say nothing of its noise, which
is then that of the rest. A pixel that differs from the reference is not changed where those samples
often showed the same there, or, where much changes, some pixels away (`kernels.change`): leaves,
flags, lamps. Where the samples show that the camera shakes, each picture is laid onto the scene
first (`reference.Anchor`). The samples also teach how high objects are at each place
(`components.Heights`), so that two of them one above the other are not joined.

Of a live source the reference is at first the median of samples of the first seconds. Then it
adapts exponentially, on foreground with a much longer time constant. A component whose outline is a
stronger edge in the reference than in the frame is where an object stood when the reference was
learned and has left since; it is not reported, and when it lasts the reference takes it in.

**mean-background**: the fixed background is the mean of the first n grey frames, or of frames given
beforehand. Its difference to a frame is smoothed by a Gaussian low-pass and thresholded; connected
components give the boxes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import Annotated, Any

import cv2
import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from phdtrack.detect.components import BlobSettings, Component, Contour, Heights, check_same_size
from phdtrack.detect.reference import Anchor, background, median, middle_of, of_objects, stabilised
from phdtrack.devices import planes_of, size_of
from phdtrack.errors import InputError, NonNegative, Positive, PositiveCount, check
from phdtrack.kernels.blobs import edges
from phdtrack.kernels.change import (
    CHANNELS,
    MARGIN,
    OFTEN,
    REACH,
    Past,
    Statistic,
    changed,
    compare,
    follow,
    often_near,
)
from phdtrack.kernels.planes import BLACK, COLOURS, GREYS, LOG, LOG_SCALE, colours, luma, smooth
from phdtrack.types import F8, STILL, Bool, Detections, Frame, Image

F4 = NDArray[np.float32]
OpenShare = Annotated[float, Gt(0), Lt(1)]

_GRID_POINTS = 2000
_SPARSE = 4
_SAME_LIGHT: F4 = np.eye(3, 4, dtype=np.float32)
# The side of a square that fits into an object, in its heights; that in heights of the picture,
# where it is not known.
_SIDE = 0.3
_USUAL = 0.1
# The median of a third of χ²₃.
_MEDIAN_OF_CHI2 = 0.789
_LOUDEST = 20.0
_BAND_ROWS = 64
_GHOST_EDGE = 0.8
# What flies past and hides an edge looks like a ghost for a frame or two: learned at once, it would
# be one ever after.
_GHOST_SECONDS = 0.2
# Seconds between samples that count as seen at different times, and the share of the threshold
# below which they are alike.
_APART = 0.5
_RESEMBLING = 0.45
# The mean share of pixels that differ from the scene in a sample, and the mean grey level, at which
# boxes become doubtful.
_RESTLESS = 0.2
_DARK = 40.0
# Pixels by which pictures usually move where the camera shakes, the share of the width from which
# on it does not shake but move, and the share of samples of which it has to be known; seconds for
# which nothing is said where it is not found.
_SHAKES = 0.5
_MOVES = 0.05
_KNOWN = 0.5
_LOST = 2.0
# Attributes that follow from the settings or from `study`, and are not saved.
_NOT_SAVED = ("_rule", "_past", "_usual", "_anchor", "_pose", "_shaky")
_TRAINED = "Boxes of a trained detector help: --detections FILE or --detector onnx:FILE"
# How far an outline reaches on both sides of the border of a component.
_OUTLINE = 3
_NEAR = np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)
# Where pixels `REACH` away lie, and where their colours may, which have half the resolution.
_NEIGHBOURS = np.zeros((2 * REACH + 1, 2 * REACH + 1), np.uint8)
_NEIGHBOURS[::REACH, ::REACH] = 1
_COLOURS_NEAR = np.ones((2 * ((REACH + 1) // 2) + 1,) * 2, np.uint8)


@dataclass(eq=False)
class ChangeDetector:
    """Boxes around whatever differs from the learned scene; nothing on the first frame.

    Attributes
    ----------
    false_alarm : share of unchanged pixels that may pass the test before clean-up.
    window : side of the window W in pixels, odd.
    shadow, glare : usual relative change of brightness by local light, towards dark and towards
        bright (one deviation).
    chroma : usual change of colour by local light, grey levels (one deviation).
    learn : seconds over which the first reference is learned; detections come from the second frame
        on.
    samples : frames of which the first reference is the median; odd.
    adapt : time constant in seconds with which the reference follows the background.
    adapt_objects : the same under objects: how long what has stopped stays an object.
    blobs : how the mask becomes boxes.
    """

    false_alarm: OpenShare = 0.0055
    window: PositiveCount = 5
    shadow: Positive = 0.11
    glare: Positive = 0.055
    chroma: Positive = 2.9
    learn: Positive = 4.0
    samples: PositiveCount = 15
    adapt: Positive = 10.0
    adapt_objects: Positive = 120.0
    blobs: BlobSettings = field(default_factory=BlobSettings)

    def __post_init__(self) -> None:
        check(self)
        for name, value in (("window", self.window), ("samples", self.samples)):
            if value % 2 != 1:
                raise InputError(
                    f"expected an odd whole number, got {value!r}", where=f"ChangeDetector.{name}"
                )
        # χ² quantile by the cube-root approximation of Wilson and Hilferty, within 1 % for 3
        # degrees.
        c = 2.0 / (9.0 * CHANNELS)
        z = NormalDist().inv_cdf(1.0 - self.false_alarm)
        threshold = CHANNELS * max(0.0, 1.0 - c + z * c**0.5) ** 3
        chroma = self.chroma / COLOURS
        local = np.square([LOG_SCALE * self.shadow, LOG_SCALE * self.glare, chroma, chroma])
        self._rule = Statistic(local, self.window, threshold, _RESEMBLING * threshold)
        self.reset()

    def reset(self) -> None:
        """Forget the scene."""
        self._samples: list[Image] = []

    @property
    def _shape(self) -> tuple[int, int]:
        """Height and width of the frames."""
        height, width = self._foreground.shape
        return height, width

    @property
    def studied(self) -> bool:
        """Whether it has learned the scene from samples of a file."""
        return bool(self._samples) and self._past.samples.shape[1] > 0

    @property
    def shaky(self) -> bool:
        """Whether the camera shakes, as samples of a file show."""
        return self.studied and self._shaky

    @property
    def pose(self) -> F8:
        """(3, 3) from pixels of the scene to those of the last frame of a camera that shakes, or
        `types.STILL`.
        """
        if self._samples:
            return self._pose
        return STILL

    def prepare(self, frame: Frame, size: tuple[int, int]) -> None:
        """Convert the picture to planes of this width and height now."""
        if not isinstance(frame.picture, np.ndarray):
            frame.picture.prepare(size)

    def knowledge(self) -> dict[str, Any]:
        """Everything learned from frames, except what `study` learns again."""
        return {
            name: value
            for name, value in vars(self).items()
            if name.startswith("_") and name not in _NOT_SAVED
        }

    def restore(self, knowledge: dict[str, Any]) -> None:
        """Continue with the knowledge of a detector with the same settings."""
        vars(self).update(knowledge)

    def scene_warnings(self) -> tuple[str, ...]:
        """Sentences about properties of the scene that make the boxes unreliable, with the cure."""
        if not self.studied:
            return ()
        share = self._past.differing.mean() / self._past.samples.shape[1]
        light = GREYS * (luma(self._reference, self._shape).mean() - BLACK)
        out = []
        if share > _RESTLESS:
            what = (
                f"on average {100 * share:.0f} % of the picture changes, as where the camera moves"
            )
            out.append(
                f"{what}: this detector is for a still one. {_TRAINED}, with --camera-motion flow"
            )
        if light < _DARK:
            out.append(
                f"the pictures are dark (mean grey level {light:.0f} of 255): much is not seen in"
                f" them. {_TRAINED}"
            )
        return tuple(out)

    def study(self, samples: Iterable[Frame]) -> None:
        """Learn the scene from frames of a file, before its first one.

        Parameters
        ----------
        samples : an odd number of frames in order, at least 7; none is kept.
        """
        pictures = list[Image]()
        times = list[float]()
        for frame in samples:
            if not pictures:
                self._begin(frame)
            pictures.append(_smooth(frame))
            times.append(frame.time)
        self._learning = False
        shape = self._shape
        pictures = self._steadied(pictures)
        reference, hidden = background(pictures, shape)
        self._reference = reference.astype(np.float32)
        if self._shaky:
            self._anchor = Anchor(luma(reference, shape))
        # What two samples show of the same moment is not seen twice.
        duration = max(times[-1] - times[0], 1e-9)
        apart = pictures[:: max(1, math.ceil(_APART * (len(times) - 1) / duration))]
        # The samples of a number side by side: it is compared with all of them.
        seen: Image = np.empty((len(reference), len(apart)), np.uint8)
        extremes = (
            _Extremes(OFTEN, len(reference)),
            _Extremes(often_near(len(apart)), len(reference)),
        )
        for k, one in enumerate(apart):
            seen[:, k] = planes = _logarithmic(one, shape)
            extremes[0].add(planes, planes)
            parts = [
                (luma(planes, shape), _NEIGHBOURS),
                *((each, _COLOURS_NEAR) for each in colours(planes, shape)),
            ]
            near = [
                np.concatenate([of(*part).ravel() for part in parts])
                for of in (cv2.erode, cv2.dilate)
            ]
            extremes[1].add(*near)
        nowhere: Image = np.zeros(shape, np.uint8)
        self._past = Past(seen, nowhere, *(each.found() for each in extremes))
        height = len(hidden)
        margin = max(3, round(_SIDE * _USUAL * height) | 1)
        least = np.full(height, _SIDE * _USUAL * height)
        places = of_objects(hidden, least, margin)
        self._learn_usual(pictures, apart, places)
        if self._usual is not None:
            # Once more, where what hid something is as large as objects are at its place.
            again = of_objects(
                hidden,
                np.array([max(3.0, _SIDE * self._usual.at(row)) for row in range(height)]),
                margin,
            )
            if (again != places).any():
                self._learn_usual(pictures, apart, again)

    def _steadied(self, pictures: list[Image]) -> list[Image]:
        """Pictures of the scene (n,), laid onto each other where the camera shakes."""
        grey = [luma(one, self._shape) for one in pictures]
        # Whatever hides one of three does not hide all.
        known = -1.0
        usual = np.zeros(2)
        moves = 0.0
        poses = list[F8]()
        for k in (2, 1, 3):
            anchor = Anchor(grey[k * len(grey) // 4])
            found = [anchor.pose(one) for one in grey]
            share = float(np.mean([len(pose) > 0 for pose in found]))
            if share > known:
                steps = np.array([anchor.moved(pose) for pose in found])
                known = share
                usual = np.median(steps, axis=0)
                poses = found
                moves = float(np.median(np.abs(steps - usual).max(axis=1)))
            if known > _KNOWN and moves <= _SHAKES:
                break  # it stands
        self._shaky = bool(_SHAKES < moves < _MOVES * self._shape[1] and known > _KNOWN)
        # The scene lies where it does in most pictures, not where it does in the anchor's.
        back = np.array([[1, 0, -usual[0]], [0, 1, -usual[1]], [0, 0, 1]])
        for k, pose in enumerate(poses if self._shaky else ()):
            pictures[k] = (
                stabilised(pictures[k], self._shape, pose @ back) if len(pose) else pictures[k]
            )
        return pictures

    def _learn_usual(self, pictures: Sequence[Image], apart: Sequence[Image], hidden: Bool) -> None:
        """The scene's noise, how often each pixel differs in the samples that are ``apart``, and
        how high objects are.
        """
        self._learn_scene_noise(pictures, hidden)
        differing = sum(
            (self._compared(one)[1] > self._rule.threshold).astype(np.uint8) for one in apart
        )
        self._past = self._past._replace(differing=np.asarray(differing, np.uint8))
        masks = [self.blobs.clean(self._compared(one, recall=True)[0]) for one in apart]
        alone = replace(self.blobs, join=0.0)
        boxes = [alone.boxes(alone.components(mask), hidden.shape) for mask in masks]
        self._usual: Heights | None = Heights.learned(boxes, hidden.shape)

    def __call__(self, frame: Frame) -> Detections:
        """The boxes of what changed in ``frame`` [M09]."""
        if not self._samples:
            self._begin(frame)
            return Detections.empty()
        check_same_size(frame, self._shape)
        steps = _SPARSE, max(1, round((self._foreground.size / _GRID_POINTS) ** 0.5))
        picture = planes_of(frame.picture)
        known = (self._reference, self._scene, self._foreground)
        if self._shaky:
            self._pose = self._anchor.pose(luma(picture, self._shape))
            if len(self._pose):
                self._steady = frame.time
                picture = stabilised(picture, self._shape, self._pose)
            elif frame.time - self._steady < _LOST:
                return Detections.empty(observed=False)
        how = self.blobs.cleaning(self._shape[0]), self._beyond()
        mask, energy, lit = changed(
            picture, self._previous, self._camera, known, self._rule, self._past, steps, *how
        )
        found = self.blobs.components(mask)
        gone = self._gone(found, mask, picture, lit)
        self._adapt(
            frame,
            picture,
            energy,
            [contour for (_, contour), ghost in zip(found, gone, strict=True) if ghost],
        )
        self._sample(frame, picture)
        real = [one for one, ghost in zip(found, gone, strict=True) if not ghost]
        boxes = self.blobs.boxes(real, mask.shape, self._usual)
        if len(self._pose):
            corners = boxes.reshape(-1, 2) @ self._pose[:2, :2].T + self._pose[:2, 2]
            boxes = np.clip(corners.reshape(-1, 4), 0, np.tile(self._shape[::-1], 2))
        return Detections.of(boxes)

    def _beyond(self) -> tuple[int, int]:
        """So many columns on both sides, and rows above and below, show nothing of the scene in a
        picture moved back.
        """
        if not len(self._pose):
            return 0, 0
        height, width = self._shape
        corners = np.array([[0, width, 0, width], [0, 0, height, height]])
        across, down = np.ceil(
            np.abs(self._pose[:2, :2] @ corners + self._pose[:2, 2:] - corners).max(axis=1)
        ).astype(int)
        return int(across), int(down)

    def _begin(self, frame: Frame) -> None:
        """Take the first frame as the reference."""
        shape = size_of(frame)[::-1]
        picture = _smooth(frame)
        n = picture.size
        self._foreground: Image = np.zeros(shape, np.uint8)
        self._past = Past(*(np.zeros(size, np.uint8) for size in ((n, 0), shape, (n, 2), (n, 2))))
        self._usual = None
        self._samples = [picture]
        self._due = frame.time + self.learn / self.samples
        self._learning = self.samples > 1
        self._reference = picture.astype(np.float32)
        self._scene: F4 = np.full(shape, float(CHANNELS), np.float32)
        self._blocked_by_ghost: F4 = np.zeros(shape, np.float32)
        self._ghostly = self._shaky = False
        self._pose = STILL
        self._steady = frame.time
        self._camera: F8 = np.ones(CHANNELS)
        planes = _logarithmic(picture, shape)
        step = slice(None, None, _SPARSE // 2)
        self._previous = np.stack(
            [luma(planes, shape)[::_SPARSE, ::_SPARSE], *colours(planes, shape)[:, step, step]]
        )
        self._time = frame.time

    def _sample(self, frame: Frame, picture: Image) -> None:
        """Take the frame for the first reference if one is due; of every other one the median, and
        the scene's noise.
        """
        if not self._learning or frame.time < self._due:
            return
        self._due += self.learn / self.samples
        self._samples.append(picture)
        self._learning = len(self._samples) < self.samples
        if len(self._samples) % 2 == 0:
            return
        self._reference = median(self._samples).astype(np.float32)
        if len(self._samples) >= 5:
            self._learn_scene_noise(self._samples)
        if not self._learning:
            del self._samples[1:]

    def _learn_scene_noise(self, samples: Sequence[Image], hidden: Bool | None = None) -> None:
        """s(q) from the samples of the first reference; where it was ``hidden`` (H, W) in most of
        them, as it usually is.
        """
        typical = np.empty(self._shape, np.float32)
        for first in range(0, len(typical), _BAND_ROWS):
            # In bands: all energies at once would be the largest piece of memory of a run.
            rows = slice(first, first + _BAND_ROWS)
            energies = np.stack([self._compared(sample, rows)[1] for sample in samples])
            # Numbers that are not negative are in the order of their bits.
            typical[rows] = middle_of(energies.view(np.int32)).view(np.float32) / _MEDIAN_OF_CHI2
        if hidden is not None and hidden.any() and not hidden.all():
            typical[hidden] = np.minimum(typical[hidden], np.median(typical[~hidden]))
        spread = cv2.dilate(cv2.blur(typical, (5, 5)), np.ones((3, 3), np.uint8))
        self._scene = np.minimum(spread, np.float32(CHANNELS * _LOUDEST))

    def _compared(
        self, picture: Image, rows: slice = slice(None), *, recall: bool = False
    ) -> tuple[Image, F4]:
        """(h, W) the raw mask of ``rows`` of a picture against the reference, the first an even
        one, and their energy; with what is recalled of other samples, of all rows."""
        now, then = (_rows(each, self._shape, rows) for each in (picture, self._reference))
        # To recall takes most of the time, and changes no energy.
        if recall:
            past = self._past
        else:
            past = self._past._replace(samples=np.zeros((now.size, 0), np.uint8))
        mask, energy = compare(
            now, then, _SAME_LIGHT, self._scene[rows], self._rule, self._camera, past
        )
        return mask, energy

    def _gone(
        self, components: Sequence[Component], mask: Image, picture: Image, light: F4
    ) -> list[bool]:
        """Whether outlines in each component's box are more of an edge in the reference than in the
        picture: it is gone.
        """
        size = np.array(self._shape)[[1, 0, 1, 0]]
        boxes = np.array([box for box, _ in components], np.int64).reshape(-1, 4)
        wide = np.clip(boxes + np.array([-_OUTLINE, -_OUTLINE, _OUTLINE, _OUTLINE]), 0, size)
        now, then = (luma(each, self._shape) for each in (picture, self._reference))
        found = edges(now, then, mask, _OUTLINE, wide)
        return [bool(one < _GHOST_EDGE * light[0, 0] * other) for one, other in found]

    def _adapt(self, frame: Frame, picture: Image, energy: F4, ghosts: list[Contour]) -> None:
        """Let reference and scene noise follow, by the time that has passed; ghosts that last are
        taken in.
        """
        passed = max(0.0, frame.time - self._time)
        self._time = frame.time
        rates = [
            0.0 if self._learning else min(1.0, passed / each)
            for each in (self.adapt, self.adapt_objects)
        ]
        rates += [min(0.2, passed / self.adapt), CHANNELS * _LOUDEST]
        follow(
            picture,
            energy,
            self._reference,
            self._scene,
            self._foreground,
            np.array(rates, np.float32),
        )
        if self._learning or not (ghosts or self._ghostly):
            return
        left: Image = np.zeros(self._shape, np.uint8)
        cv2.drawContours(left, ghosts, -1, 255, cv2.FILLED)
        # The time since its first frame: however few frames a second there are, one alone is not
        # enough.
        lasted = np.where(
            self._blocked_by_ghost > 0,
            self._blocked_by_ghost + np.float32(passed),
            np.float32(1e-6),
        )
        self._blocked_by_ghost = np.where(left > 0, lasted, np.float32(0))
        self._ghostly = bool(ghosts)
        lasting = (self._blocked_by_ghost >= _GHOST_SECONDS).astype(np.uint8)
        if lasting.any():
            where = cv2.dilate(lasting, _NEAR) > 0
            for plane, seen in ((luma, where), (colours, where[::2, ::2])):
                now = plane(picture, self._shape)
                then = plane(self._reference, self._shape)
                then[..., seen] = now[..., seen]


def _smooth(frame: Frame) -> Image:
    """The planes (n,) of a frame, its colours smoothed."""
    width, height = size_of(frame)
    planes = planes_of(frame.picture)
    smooth(planes, (height, width))
    return planes


def _rows(picture: NDArray[Any], shape: tuple[int, int], rows: slice) -> NDArray[Any]:
    """The planes (n,) of ``rows`` of a picture, of which the first is an even one."""
    first, last, _ = rows.indices(shape[0])
    parts = luma(picture, shape)[rows], colours(picture, shape)[:, first // 2 : (last + 1) // 2]
    return np.concatenate([part.ravel() for part in parts])


def _logarithmic(picture: Image, shape: tuple[int, int]) -> Image:
    """The planes (n,) of a picture with the logarithm of brightness."""
    out = picture.copy()
    luma(out, shape)[:] = LOG[luma(picture, shape)]
    return out


class _Extremes:
    """The ``rank``-th smallest and largest of each number of pictures (n,)."""

    def __init__(self, rank: int, n: int) -> None:
        self._low: Image = np.full((rank, n), 255, np.uint8)
        self._high: Image = np.zeros((rank, n), np.uint8)

    def add(self, low: Image, high: Image) -> None:
        """A picture for each of them."""
        for j in range(len(self._low)):
            self._low[j], low = np.minimum(self._low[j], low), np.maximum(self._low[j], low)
            self._high[j], high = np.maximum(self._high[j], high), np.minimum(self._high[j], high)

    def found(self) -> Image:
        """(n, 2) of those that were added."""
        return np.stack([self._low[-1], self._high[-1]], axis=1)


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

    def knowledge(self) -> dict[str, Any]:
        """Everything learned from frames."""
        return {name: value for name, value in vars(self).items() if name.startswith("_")}

    def restore(self, knowledge: dict[str, Any]) -> None:
        """Continue with the knowledge of a detector with the same settings."""
        vars(self).update(knowledge)

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
