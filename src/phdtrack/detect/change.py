"""Change detection against a reference picture of the scene that adapts [M07] [M09].

**change** is statistical colour change detection, after Cavallaro and Ebrahimi (2004). Without
change, frame and reference differ by noise. The difference of each pixel is taken in three channels
c that separate brightness from colour (logarithm of brightness; the two colour differences, shared
by four pixels as decoders give them, and smoothed), divided by the deviation that noise explains
there, and summed. Its mean over a small window W is the statistic, which is compared with a χ²
quantile of 3 degrees of freedom:

    T(p) = (1/|W|) Σ_{q∈W} (1/s(q)) Σ_c d_c(q)² / σ_c²   >   χ²₃(1 − false alarm rate)

The noise has three parts: the camera's, σ_c; local light (shadows, reflections), which is relative,
hence the logarithm, and stronger towards dark; and the scene's, s(q) ≥ 1, learned for each pixel
(leaves, trembling edges). A change of global illumination scales all pixels of a channel by about a
gain and adds an offset; both are fitted to the background.

For a file, the reference and s(q) are learned from about 50 samples (`reference.background`,
`scene_knowledge.study`), which are brought into one light (`scene_light`). Pixels that objects hid
most of the time show nothing of the scene's noise; they take that of the others. A pixel that
differs from the reference is not changed if the samples often showed the same value there, or, if
much changes there, a few pixels away, and if it came and went (`kernels.change`): leaves, flags,
lamps, but not a person who stands. If the samples show that the camera shakes, each picture is
first registered to the scene (`reference.Anchor`). The samples also teach how high objects are at
each place (`components.Heights`), so that two objects one above the other are not joined.

For a live source, the reference is at first the median of samples of the first seconds. Then it
adapts exponentially, except within the boxes of objects: a person who stands is not absorbed bit by
bit. An object that does not move at all for minutes is absorbed as a whole. A component whose
outline is a stronger edge in the reference than in the frame is a ghost: an object stood there when
the reference was learned, and has left. A ghost is not reported, and one that lasts is absorbed by
the reference.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import Annotated, Any

import numpy as np
from annotated_types import Gt, Lt
from numpy.typing import NDArray

from phdtrack.detect.components import (
    Component,
    ConnectedComponents,
    Contour,
    Heights,
    check_same_size,
)
from phdtrack.detect.reference import Anchor, background, median, of_objects, stabilised
from phdtrack.detect.scene_light import SceneLight
from phdtrack.detect.scene_samples import MAX_NOISE, logarithmic, sample_history, scene_noise
from phdtrack.devices import planes_of, size_of
from phdtrack.errors import InputError, Positive, PositiveCount, check
from phdtrack.kernels.blobs import edges
from phdtrack.kernels.change import CHANNELS, MARGIN, Past, Statistic, changed, compare, follow
from phdtrack.kernels.planes import BLACK, COLOURS, GREYS, LOG_SCALE, colours, luma, smooth
from phdtrack.opencv_package import cv2
from phdtrack.types import F4, F8, STILL, Bool, Detections, Frame, Image

OpenShare = Annotated[float, Gt(0), Lt(1)]

# Pixels at which the light is fitted; every how many pixels the camera's noise is measured.
_GRID_POINTS = 2000
_SPARSE = 4
_SAME_LIGHT: F4 = np.eye(3, 4, dtype=np.float32)
# Side of a square that fits into an object, as a share of the object's height; the height as a
# share of the picture's, if it is not known.
_SQUARE_SHARE = 0.3
_USUAL_HEIGHT = 0.1
# An outline in the reference that is stronger by this factor makes a component a ghost.
_GHOST_EDGE = 0.8
# An object that flies past and hides an edge looks like a ghost for a frame or two. A ghost must
# last this long, in seconds, before the reference absorbs it.
_GHOST_SECONDS = 0.2
# Pictures are compared at this distance in seconds to see whether an object stands still: if so
# many grey levels at most differ in so large a share of its pixels.
_COMPARE_SECONDS = 1.0
_SAME_GREY = 12
_STILL_SHARE = 0.9
# Seconds between samples that are independent, and the share of the threshold below which a sample
# resembles a pixel.
_SAMPLE_INTERVAL = 0.5
_RESEMBLING = 0.45
# Boxes are unreliable if a larger share of the pixels differs in a sample, or if the mean grey
# level is lower.
_MAX_DIFFERING = 0.2
_MIN_GREY = 40.0
# A camera shakes if pictures usually shift by this many pixels, and moves if they shift by this
# share of the width. The pose must be known in a minimum share of the samples. A pose that is lost
# suppresses detection for some seconds.
_MIN_SHIFT = 0.5
_MAX_SHIFT = 0.05
_MIN_KNOWN_POSES = 0.5
_MAX_LOST_TIME = 2.0
# Shares of the samples at which pictures are tried as the anchor: if an object hides one of them,
# the others still show the background.
_ANCHOR_CANDIDATES = (2, 1, 3)
# Attributes that follow from the settings or from `study`, and are not saved.
_NOT_SAVED = ("_rule", "_past", "_heights", "_anchor", "_pose", "_shaky", "_light")
_TRAINED = "Boxes of a trained detector help: --detections FILE or --detector onnx:FILE"
# Pixels by which an outline extends on both sides of a component's border.
_OUTLINE = 3
_NEAR = np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8)


@dataclass(eq=False)
class ChangeDetector:
    """Boxes around whatever differs from the learned scene; none in the first frame.

    Attributes
    ----------
    false_alarm : share of unchanged pixels that may pass the test before clean-up.
    window : side of the window W in pixels, odd.
    shadow, glare : usual relative change of brightness by local light, towards dark and towards
        bright (one standard deviation).
    chroma : usual change of colour by local light, grey levels (one standard deviation).
    learn : seconds over which the first reference is learned; detections start with the second
        frame.
    samples : frames of which the first reference is the median; odd.
    adapt : time constant in seconds with which the reference follows the background.
    adapt_objects : seconds after which an object that does not move at all is a part of the scene.
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
    blobs: ConnectedComponents = field(default_factory=ConnectedComponents)

    def __post_init__(self) -> None:
        check(self)
        for name, value in (("window", self.window), ("samples", self.samples)):
            if value % 2 != 1:
                raise InputError(
                    f"expected an odd whole number, got {value!r}", where=f"ChangeDetector.{name}"
                )
        # The χ² quantile by the cube-root approximation of Wilson and Hilferty, within 1 % for 3
        # degrees of freedom.
        c = 2.0 / (9.0 * CHANNELS)
        z = NormalDist().inv_cdf(1.0 - self.false_alarm)
        threshold = CHANNELS * max(0.0, 1.0 - c + z * c**0.5) ** 3
        chroma = self.chroma / COLOURS
        local = np.square([LOG_SCALE * self.shadow, LOG_SCALE * self.glare, chroma, chroma])
        self._rule = Statistic(local, self.window, threshold, _RESEMBLING * threshold)
        self.reset()

    def reset(self) -> None:
        """Forget the scene, which takes tens of MB of memory."""
        for name in [name for name in vars(self) if name.startswith("_") and name != "_rule"]:
            delattr(self, name)
        self._samples: list[Image] = []

    @property
    def _shape(self) -> tuple[int, int]:
        """Height and width of the frames."""
        height, width = self._foreground.shape
        return height, width

    @property
    def studied(self) -> bool:
        """True if the scene was learned from samples of a file."""
        return bool(self._samples) and self._past.samples.shape[1] > 0

    @property
    def pose(self) -> F8:
        """(3, 3) map from scene pixels to pixels of the last frame, or `types.STILL` if the camera
        does not shake.
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
            name.removeprefix("_"): value
            for name, value in vars(self).items()
            if name.startswith("_") and name not in _NOT_SAVED
        }

    def restore(self, knowledge: dict[str, Any]) -> None:
        """Continue with the knowledge of a detector with the same settings."""
        vars(self).update({f"_{name}": value for name, value in knowledge.items()})

    def scene_warnings(self) -> tuple[str, ...]:
        """Sentences about properties of the scene that make the boxes unreliable, with the cure."""
        if not self.studied:
            return ()
        share = self._past.differing.mean() / self._past.samples.shape[1]
        grey = GREYS * (luma(self._reference, self._shape).mean() - BLACK)
        warnings = list[str]()
        changes = f"on average {100 * share:.0f} % of the picture changes"
        if share > _MAX_DIFFERING and self.stands_still:
            warnings.append(
                f"{changes} although the camera stands still, typical of clouds, trees in wind or"
                f" water; this detector is unreliable there. {_TRAINED}"
            )
        elif share > _MAX_DIFFERING:
            warnings.append(
                f"{changes}, and its corners do not stay in place, which suggests that the camera"
                f" moves; this detector needs a still camera. {_TRAINED}, with --camera-motion flow"
            )
        if grey < _MIN_GREY:
            warnings.append(
                f"the pictures are dark (mean grey level {grey:.0f} of 255), so many objects stay"
                f" undetected. {_TRAINED}"
            )
        return tuple(warnings)

    def study(self, samples: Iterable[Frame]) -> None:
        """Learn the scene from samples of a file, before its first frame.

        Parameters
        ----------
        samples : an odd number of at least 7 frames, in order; none is kept.
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
        pictures = self._light.levelled(self._stabilise(pictures))
        reference, hidden = background(pictures, shape)
        self._reference = reference.astype(np.float32)
        if self._shaky:
            self._anchor = Anchor(luma(reference, shape))
        # Two samples of the same moment would count as one observation twice.
        duration = max(times[-1] - times[0], 1e-9)
        step = max(1, math.ceil(_SAMPLE_INTERVAL * (len(times) - 1) / duration))
        independent = pictures[::step]
        self._past = sample_history(independent, shape)
        height = len(hidden)
        margin = max(3, round(_SQUARE_SHARE * _USUAL_HEIGHT * height) | 1)
        min_side = np.full(height, _SQUARE_SHARE * _USUAL_HEIGHT * height)
        hidden_by_objects = of_objects(hidden, min_side, margin)
        self._learn_usual(pictures, independent, hidden_by_objects)
        if self._heights is None:
            return
        # With the heights of objects known, decide anew which hidden regions are large enough.
        min_side = np.array(
            [max(3.0, _SQUARE_SHARE * self._heights.at(row)) for row in range(height)]
        )
        refined = of_objects(hidden, min_side, margin)
        if (refined != hidden_by_objects).any():
            self._learn_usual(pictures, independent, refined)

    def _stabilise(self, pictures: list[Image]) -> list[Image]:
        """Decide if the camera shakes, and register the pictures (n,) to each other if it does."""
        grey = [luma(one, self._shape) for one in pictures]
        best_share = -1.0
        usual = np.zeros(2)
        shift = 0.0
        poses = list[F8]()
        for k in _ANCHOR_CANDIDATES:
            anchor = Anchor(grey[k * len(grey) // 4])
            found = [anchor.pose(one) for one in grey]
            share = float(np.mean([len(pose) > 0 for pose in found]))
            if share > best_share:
                shifts = np.array([anchor.moved(pose) for pose in found])
                best_share = share
                usual = np.median(shifts, axis=0)
                poses = found
                shift = float(np.median(np.abs(shifts - usual).max(axis=1)))
            if best_share > _MIN_KNOWN_POSES and shift <= _MIN_SHIFT:
                break  # The camera stands still.
        known = best_share > _MIN_KNOWN_POSES
        self.stands_still = known and shift < _MAX_SHIFT * self._shape[1]
        self._shaky = self.stands_still and shift > _MIN_SHIFT
        if not self._shaky:
            return pictures
        # The scene lies where most pictures show it, not where the anchor does.
        back = np.array([[1, 0, -usual[0]], [0, 1, -usual[1]], [0, 0, 1]])
        for k, pose in enumerate(poses):
            if len(pose):
                pictures[k] = stabilised(pictures[k], self._shape, pose @ back)
        return pictures

    def _steps(self) -> tuple[int, int]:
        """Distances both ways of the pixels from which noise and light are measured."""
        return _SPARSE, max(1, round((self._foreground.size / _GRID_POINTS) ** 0.5))

    def _learn_usual(
        self, pictures: Sequence[Image], independent: Sequence[Image], hidden: Bool
    ) -> None:
        """Learn the scene's noise, how often each pixel differs in ``independent`` samples, and how
        high objects are.
        """
        self._learn_scene_noise(pictures, hidden)
        differing = sum(
            (self.compared(one)[1] > self._rule.threshold).astype(np.uint8) for one in independent
        )
        self._past = self._past._replace(differing=np.asarray(differing, np.uint8))
        masks = [self.blobs.clean(self.compared(one, recall=True)[0]) for one in independent]
        unjoined = replace(self.blobs, join=0.0)
        boxes = [unjoined.boxes(unjoined.components(mask), hidden.shape) for mask in masks]
        self._heights: Heights | None = Heights.learned(boxes, hidden.shape)

    def __call__(self, frame: Frame) -> Detections:
        """The boxes of whatever changed in ``frame`` [M09]."""
        if not self._samples:
            self._begin(frame)
            return Detections.empty()
        check_same_size(frame, self._shape)
        picture = planes_of(frame.picture)
        if self._shaky:
            self._pose = self._anchor.pose(luma(picture, self._shape))
            if len(self._pose):
                self._last_pose_time = frame.time
                picture = stabilised(picture, self._shape, self._pose)
            elif frame.time - self._last_pose_time < _MAX_LOST_TIME:
                return Detections.empty(observed=False)
        picture = self._light.even(picture, self._reference, self._foreground)
        mask, energy, light, level = changed(
            picture,
            self._previous,
            self._camera,
            (self._reference, self._scene, self._foreground),
            self._rule,
            self._past,
            self._steps(),
            self.blobs.cleaning(self._shape[0]),
            self._unseen_border(),
        )
        components = self.blobs.components(mask)
        is_ghost = self._ghosts(components, mask, picture, light)
        ghosts = list[Contour]()
        objects = list[Component]()
        for component, ghost in zip(components, is_ghost, strict=True):
            if ghost:
                ghosts.append(component[1])
            else:
                objects.append(component)
        boxes = self.blobs.boxes(objects, mask.shape, self._heights)
        # What looks like the scene inside of an object is part of it.
        for left, top, right, bottom in boxes.astype(int):
            self._foreground[top:bottom, left:right] = 255
        self._adapt(frame, level, energy)
        self._absorb(frame, level, ghosts, self._still(frame, level, objects))
        self._sample(frame, picture)
        if len(self._pose):
            corners = boxes.reshape(-1, 2) @ self._pose[:2, :2].T + self._pose[:2, 2]
            boxes = np.clip(corners.reshape(-1, 4), 0, np.tile(self._shape[::-1], 2))
        return Detections.of(boxes)

    def _unseen_border(self) -> tuple[int, int]:
        """Columns at both sides, and rows at top and bottom, of a registered picture that show
        nothing of the scene.
        """
        if not len(self._pose):
            return 0, 0
        height, width = self._shape
        corners = np.array([[0, width, 0, width], [0, 0, height, height]])
        moved = self._pose[:2, :2] @ corners + self._pose[:2, 2:]
        across, down = np.ceil(np.abs(moved - corners).max(axis=1)).astype(int)
        return int(across), int(down)

    def _begin(self, frame: Frame) -> None:
        """Take the first frame as the reference."""
        shape = size_of(frame)[::-1]
        picture = _smooth(frame)
        n = picture.size
        self._foreground: Image = np.zeros(shape, np.uint8)
        self._past = Past(*(np.zeros(size, np.uint8) for size in ((n, 0), shape, (n, 2), (n, 2))))
        self._heights = None
        self._light: SceneLight = SceneLight(shape, self._steps()[1])
        self._samples = [picture]
        self._due = frame.time + self.learn / self.samples
        self._learning = self.samples > 1
        self._reference = picture.astype(np.float32)
        self._scene: F4 = np.full(shape, float(CHANNELS), np.float32)
        self._ghost_time: F4 = np.zeros(shape, np.float32)
        self._had_ghosts = False
        self._still_time: F4 = np.zeros(shape, np.float32)
        self._compared = luma(picture, shape).copy()
        self._compared_time = frame.time
        self._shaky = False
        self.stands_still = False
        self._pose = STILL
        self._last_pose_time = frame.time
        self._camera: F8 = np.ones(CHANNELS)
        planes = logarithmic(picture, shape)
        step = slice(None, None, _SPARSE // 2)
        self._previous: Image = np.stack(
            [luma(planes, shape)[::_SPARSE, ::_SPARSE], *colours(planes, shape)[:, step, step]]
        )
        self._time = frame.time

    def _sample(self, frame: Frame, picture: Image) -> None:
        """Add the frame to the samples of the first reference if one is due; after every second one
        update the median and the scene's noise.
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
        """Learn s(q) from samples; pixels (H, W) ``hidden`` in most of them take the usual
        noise.
        """
        self._scene = scene_noise(
            lambda rows: np.stack([self.compared(sample, rows)[1] for sample in samples]),
            self._shape,
            hidden,
        )

    def compared(
        self, picture: Image, rows: slice = slice(None), *, recall: bool = False
    ) -> tuple[Image, F4]:
        """Compare rows of a picture (n,) with the reference.

        Parameters
        ----------
        picture : its planes (n,), colours smoothed.
        rows : the first of them is even.
        recall : leave out what other samples showed; for all rows only. It takes most of the time,
            and changes no energy.

        Returns
        -------
        mask : (h, W) uint8, 255 for changed pixels, before clean-up.
        energy : (h, W) Σ_c d_c² / σ_c².
        """
        current = _rows(picture, self._shape, rows)
        reference = _rows(self._reference, self._shape, rows)
        past = self._past
        if not recall:
            past = past._replace(samples=np.zeros((current.size, 0), np.uint8))
        mask, energy, _ = compare(
            current, reference, _SAME_LIGHT, self._scene[rows], self._rule, self._camera, past
        )
        return mask, energy

    def _ghosts(
        self, components: Sequence[Component], mask: Image, picture: Image, light: F4
    ) -> list[bool]:
        """For each component, True if its outline is more of an edge in the reference than in the
        picture.
        """
        size = np.array(self._shape)[[1, 0, 1, 0]]
        boxes = np.array([box for box, _ in components], np.int64).reshape(-1, 4)
        wide = np.clip(boxes + np.array([-_OUTLINE, -_OUTLINE, _OUTLINE, _OUTLINE]), 0, size)
        current = luma(picture, self._shape)
        reference = luma(self._reference, self._shape)
        strengths = edges(current, reference, mask, _OUTLINE, wide)
        return [bool(now < _GHOST_EDGE * light[0, 0] * before) for now, before in strengths]

    def _still(self, frame: Frame, picture: Image, objects: Sequence[Component]) -> list[Contour]:
        """The outlines of objects that have not moved for a long time: they are part of the scene
        now. A person who stands always sways.
        """
        passed = frame.time - self._compared_time
        if passed < _COMPARE_SECONDS:
            return []
        self._compared_time = frame.time
        now = luma(picture, self._shape)
        same = cv2.absdiff(now, self._compared) <= _SAME_GREY
        self._compared = now.copy()
        self._still_time = np.where(
            same & (self._foreground > 0), self._still_time + np.float32(passed), np.float32(0)
        )
        still = self._still_time >= self.adapt_objects
        if not still.any():
            return []
        found = list[Contour]()
        for (left, top, right, bottom), contour in objects:
            inside = np.zeros((bottom - top, right - left), np.uint8)
            cv2.drawContours(inside, [contour], -1, 1, cv2.FILLED, offset=(-left, -top))
            if still[top:bottom, left:right][inside > 0].mean() >= _STILL_SHARE:
                found.append(contour)
        return found

    def _adapt(self, frame: Frame, picture: Image, energy: F4) -> None:
        """Let reference and scene noise follow by the time that has passed, except under
        objects.
        """
        passed = max(0.0, frame.time - self._time)
        rate = 0.0 if self._learning else min(1.0, passed / self.adapt)
        follow(
            picture,
            energy,
            self._reference,
            self._scene,
            self._foreground,
            np.array([rate, 0.0, min(0.2, passed / self.adapt), MAX_NOISE], np.float32),
        )

    def _absorb(
        self, frame: Frame, picture: Image, ghosts: list[Contour], still: list[Contour]
    ) -> None:
        """Make lasting ghosts, and objects that stand ``still``, a part of the reference."""
        passed = max(0.0, frame.time - self._time)
        self._time = frame.time
        if self._learning or not (ghosts or still or self._had_ghosts):
            return
        filled: Image = np.zeros(self._shape, np.uint8)
        cv2.drawContours(filled, ghosts, -1, 255, cv2.FILLED)
        # The time counts from a ghost's first frame, so that one frame alone is never enough,
        # however low the frame rate.
        lasted = np.where(
            self._ghost_time > 0, self._ghost_time + np.float32(passed), np.float32(1e-6)
        )
        self._ghost_time = np.where(filled > 0, lasted, np.float32(0))
        self._had_ghosts = bool(ghosts)
        lasting = (self._ghost_time >= _GHOST_SECONDS).astype(np.uint8)
        cv2.drawContours(lasting, still, -1, 1, cv2.FILLED)
        if not lasting.any():
            return
        absorbed = cv2.dilate(lasting, _NEAR) > 0
        for plane, pixels in ((luma, absorbed), (colours, absorbed[::2, ::2])):
            current = plane(picture, self._shape)
            reference = plane(self._reference, self._shape)
            reference[..., pixels] = current[..., pixels]


def _smooth(frame: Frame) -> Image:
    """The planes (n,) of a frame, colours smoothed."""
    width, height = size_of(frame)
    planes = planes_of(frame.picture)
    smooth(planes, (height, width))
    return planes


def _rows(picture: NDArray[Any], shape: tuple[int, int], rows: slice) -> NDArray[Any]:
    """The planes (n,) of ``rows`` of a picture; the first row is even."""
    first, last, _ = rows.indices(shape[0])
    parts = luma(picture, shape)[rows], colours(picture, shape)[:, first // 2 : (last + 1) // 2]
    return np.concatenate([part.ravel() for part in parts])
