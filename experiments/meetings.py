"""Two people who meet, share a blob for a while and part, and the identities with which they
leave.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from experiments.common import Case, detections_in
from phdtrack.arrays import iou
from phdtrack.simulate import DetectorModel, Look, Rendered, Scene, detect
from phdtrack.simulate.scenes import truth_rows
from phdtrack.types import F8, I8, Detections, DetectionTable, SequenceInfo, Tracks, Truth

Parting = Literal["crossing", "turning back"]
PARTINGS: tuple[Parting, ...] = ("crossing", "turning back")
WIDTH = 384
HEIGHT = 288
FPS = 25.0
# Body heights (pixels), width over height, body heights per second.
TALL = 84.0
ASPECT = 0.38
SPEED = 0.75
# Seconds for which they walk together; their distance meanwhile, in widths.
TOGETHER = (1.0, 3.0)
APART = (0.25, 0.8)
# The share of a figure that must be inside the frame for it to be in the truth.
_VISIBLE = 0.3
Leave = Literal["right", "swapped", "new", "lost"]
# Distance of their axes, in widths, at which their blobs begin to touch.
_TOUCH = 1.3
# Frames before and after in which identities are read; how many around the touch itself are left
# out.
_BEFORE = 10
_AFTER = 17
_AROUND = 3
_MATCH = 0.4


@dataclass(frozen=True, slots=True)
class Meeting:
    """Two people who come from both sides, walk together, and then go on or turn back.

    Attributes
    ----------
    parting : ``crossing``, each passes the other slowly and goes on, or ``turning back``, each
        stays on its side.
    together : seconds for which they walk together.
    apart : distance of their axes meanwhile (if they cross: when they meet and when they part), in
        widths.
    drift : common horizontal velocity meanwhile, pixels per second.
    behind : pixels by which the second person's foot is higher in the image.
    """

    parting: Parting
    together: float
    apart: float
    drift: float
    behind: float

    @property
    def info(self) -> SequenceInfo:
        """Size, rate and number of frames."""
        return SequenceInfo(
            WIDTH, HEIGHT, FPS, int(self._times[1] * FPS + 2.2 * FPS), f"meeting-{self.parting}"
        )

    @property
    def _times(self) -> tuple[float, float]:
        """Seconds at which they meet and part. Before, each walks in from outside the frame and
        enters after a second.
        """
        way = WIDTH / 2 + ASPECT * TALL
        meets = 1.0 + way / (SPEED * TALL)
        return meets, meets + self.together

    def figures(self, rng: np.random.Generator) -> Truth:
        """The figures of both people; nothing is random."""
        time = np.arange(self.info.frames) / FPS
        meets, parts = self._times
        pace = SPEED * TALL
        wide = ASPECT * TALL
        walked = self.drift * (np.clip(time, meets, parts) - meets)
        onward = 1.0 if self.parting == "crossing" else -1.0
        far = self.apart * wide / 2
        passed = np.interp(time, [meets, parts], [far, -onward * far])
        half = passed - pace * (
            np.minimum(time - meets, 0.0) + onward * np.maximum(time - parts, 0.0)
        )
        boxes = []
        for side, foot in ((-1.0, 0.82 * HEIGHT), (1.0, 0.82 * HEIGHT - self.behind)):
            centre = WIDTH / 2 + _smooth(walked + side * half)
            feet = np.full(len(time), foot)
            boxes.append(
                np.stack([centre - wide / 2, feet - TALL, centre + wide / 2, feet], axis=1)
            )
        frame = np.tile(np.arange(1, len(time) + 1), 2)
        xyxy = np.concatenate(boxes)
        inside = _visible(xyxy, self.info) > 0
        return truth_rows(frame[inside], np.repeat([1, 2], len(time))[inside], xyxy[inside])

    def truth(self, figures: Truth) -> Truth:
        """The figures of which enough is inside the frame."""
        kept = np.flatnonzero(_visible(figures.xyxy, self.info) >= _VISIBLE)
        inside = _clip(figures.xyxy[kept], self.info)
        return truth_rows(figures.frame[kept], figures.identity[kept], inside)


def _smooth(way: F8) -> F8:
    """Smooth a path: speeds change over half a second."""
    span = round(FPS / 2) | 1
    padded = np.pad(way, span // 2, mode="reflect", reflect_type="odd")
    out: F8 = np.convolve(padded, np.full(span, 1 / span), mode="valid")
    return out


def meeting(parting: Parting, seed: int) -> Meeting:
    """A random meeting."""
    rng = np.random.default_rng([seed, PARTINGS.index(parting)])
    together = rng.uniform(*TOGETHER)
    apart = rng.uniform(*APART)
    return Meeting(
        parting,
        float(together),
        float(apart),
        float(rng.uniform(-15, 15)),
        float(rng.uniform(-6, 6)),
    )


def met(parting: Parting, seed: int) -> Scene:
    """The scene of a meeting."""
    world = meeting(parting, seed)
    figures = world.figures(np.random.default_rng(seed))
    truth = world.truth(figures)
    none = np.zeros((0, 4))
    found = detect(truth, world.info, np.random.default_rng(seed), DetectorModel())
    return Scene(world.info, truth, figures, found.table, found.source, none, none, none)


def filmed(job: tuple[Parting, int], *, detector: bool = True) -> Case:
    """A rendered meeting with the detections of the change detector with defaults; none without
    it.
    """
    parting, seed = job
    scene = met(parting, seed)
    table = DetectionTable(np.zeros(0, np.int64), Detections.empty())
    if detector:
        table = detections_in(Rendered(scene, np.random.default_rng(seed), Look(plants=0, lamps=0)))
    return Case(f"{parting} {seed}", scene.info, scene.truth, table)


def leaving(case: Case, tracks: Tracks) -> Leave:
    """The outcome for the two identities: ``right``, ``swapped``, ``new`` for one or both,
    ``lost``: one not tracked.
    """
    first, last = touching(case.truth)
    before = [
        _identity(case, tracks, one, np.arange(first - _AROUND - _BEFORE, first - _AROUND))
        for one in (1, 2)
    ]
    after = [
        _identity(case, tracks, one, np.arange(last + _AROUND, last + _AROUND + _AFTER))
        for one in (1, 2)
    ]
    if 0 in before + after or before[0] == before[1] or after[0] == after[1]:
        return "lost"
    if before == after:
        return "right"
    return "swapped" if before == after[::-1] else "new"


def touching(truth: Truth) -> tuple[int, int]:
    """The first and the last frame in which the two touch."""
    boxes = {one: truth.xyxy[truth.identity == one] for one in (1, 2)}
    frames = {one: truth.frame[truth.identity == one] for one in (1, 2)}
    both, one, two = np.intersect1d(frames[1], frames[2], return_indices=True)
    a = boxes[1][one]
    b = boxes[2][two]
    near = np.abs(a[:, [0, 2]].mean(axis=1) - b[:, [0, 2]].mean(axis=1)) < _TOUCH * (
        a[:, 2] - a[:, 0]
    )
    return int(both[near][0]), int(both[near][-1])


def _identity(case: Case, tracks: Tracks, who: int, frames: I8) -> int:
    """The most frequent identity of this person in these frames, 0 for none."""
    votes = [0]
    for number in frames.tolist():
        true = case.truth.xyxy[(case.truth.frame == number) & (case.truth.identity == who)]
        rows = np.flatnonzero(tracks.frame == number)
        if not len(true) or not len(rows):
            continue
        overlap = iou(true[:1], tracks.xyxy[rows])[0]
        if overlap.max() >= _MATCH:
            votes.append(int(tracks.identity[rows[overlap.argmax()]]))
    counts = np.bincount(votes)
    counts[0] = 0
    return int(counts.argmax()) if counts.any() else 0


def _clip(xyxy: F8, info: SequenceInfo) -> F8:
    """(n, 4) the boxes cut at the frame's borders."""
    inside: F8 = np.clip(xyxy, 0, np.tile([info.width, info.height], 2).astype(np.float64))
    return inside


def _visible(xyxy: F8, info: SequenceInfo) -> F8:
    """(n,) share of each box's area inside the frame."""
    size = xyxy[:, 2:] - xyxy[:, :2]
    inside = _clip(xyxy, info)
    part: F8 = (inside[:, 2:] - inside[:, :2]).prod(axis=1) / size.prod(axis=1)
    return part
