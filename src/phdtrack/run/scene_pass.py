"""The scene teaches: a file is tracked twice, and the second time the tracker knows where it
flickers.

The first pass detects and tracks as always, and keeps the detections. If they show places that
flicker (`scene.flicker`), the second one tracks the same detections again. If not, the first was
all.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any
from weakref import finalize

import numpy as np

from phdtrack.arrays import half_if_exact
from phdtrack.config import Settings
from phdtrack.detect import BACKGROUND
from phdtrack.models.flicker_odds import FlickerOdds
from phdtrack.models.live_flicker import LiveFlicker
from phdtrack.multiclass import ClassSettings
from phdtrack.report import charts
from phdtrack.report.pages import render
from phdtrack.run.loop import NO_PICTURE, DetectedFrame, TrackedFrame
from phdtrack.run.observers import Report
from phdtrack.run.running import Run
from phdtrack.scene.flicker import (
    NO_ARRIVALS,
    NOWHERE,
    Arrivals,
    FlickerMap,
    Sightings,
    arrivals,
    flicker_share,
    learn_flicker,
    sightings,
    travellers,
    without_flicker,
)
from phdtrack.types import F4, F8, I8, Detections, Frame, Image, Tracks

# Bytes of embeddings that are kept in memory.
IN_MEMORY = 64_000_000
# Rows of the map of where a scene flickers.
_ROWS = 72
# A place flickers, for the report, if it does in this share of the frames.
_SHOWN = 0.01


def can_flicker(settings: Settings) -> bool:
    """True if it may be learned where a scene flickers: boxes in the image of a camera that stands
    still, a filter that decides, and no learned scene.
    """
    still = settings.kind("camera_motion") == "none" and settings.kind("motion") == "box"
    return still and settings.kind("filter") != "none" and not settings.build("scene").file


def learning_flicker(classes: ClassSettings, size: tuple[float, float]) -> ClassSettings:
    """The stages that learn while tracking where a scene flickers.

    Parameters
    ----------
    classes : how each class is tracked.
    size : width and height of the picture, pixels.
    """
    usual = classes.usual
    learning = LiveFlicker(size, usual.detection_scores)
    return replace(classes, usual=replace(usual, detection_scores=learning))


def can_learn(run: Run) -> bool:
    """True if the first pass of a run can teach the second one.

    A background detector finds whatever moves; other detectors know what an object is. The frames
    must be those of a file, and what the user has said of the scene stands.
    """
    inputs = run.inputs
    background = inputs.described in BACKGROUND and inputs.pictures
    return run.options.learn and background and inputs.again


class _KeptEmbeddings:
    """The embeddings of frames, in a file without a name if they are many."""

    def __init__(self, folder: Path | None) -> None:
        place = str(folder) if folder else None
        # Open as long as this lives.
        self._file = SpooledTemporaryFile(IN_MEMORY, dir=place)  # noqa: SIM115
        finalize(self, self._file.close)
        self._end = 0
        # By place of the frame: where its embeddings begin, their shape, and their type.
        self._parts = dict[int, tuple[int, tuple[int, ...], np.dtype[Any]]]()

    def add(self, place: int, embeddings: F4 | None) -> None:
        """Keep the embeddings of the frame at a place; None if it has none."""
        if embeddings is None:
            return
        kept = half_if_exact(embeddings)
        self._parts[place] = (self._end, kept.shape, kept.dtype)
        self._file.seek(self._end)
        self._end += self._file.write(kept.tobytes())

    def at(self, place: int) -> F4 | None:
        """The embeddings of the frame at a place; None if it has none."""
        if place not in self._parts:
            return None
        begin, shape, dtype = self._parts[place]
        self._file.seek(begin)
        data = self._file.read(math.prod(shape) * dtype.itemsize)
        return np.frombuffer(data, dtype).reshape(shape).astype(np.float32)


class KeptFrames:
    """Detected frames without their pictures, kept for a second pass.

    A long file has a million of them: of frames with nothing but boxes only these are kept, in
    arrays. Embeddings, which are long, are kept on disk.

    Parameters
    ----------
    folder : for embeddings; None for the system's own folder of temporary files.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._number = array("q")
        self._time = array("d")
        self._seconds = array("d")
        self._count = array("q")
        self._boxes = array("d")
        self._embeddings = _KeptEmbeddings(folder)
        # Frames with more than boxes, by their place.
        self._whole = dict[int, DetectedFrame]()

    def __len__(self) -> int:
        return len(self._number)

    def append(self, detected: DetectedFrame) -> None:
        """Keep a frame."""
        frame = detected.frame
        found = detected.detections
        bare = DetectedFrame(
            Frame(frame.number, frame.time, NO_PICTURE),
            Detections.of(found.xyxy),
            seconds=detected.seconds,
        )
        self._embeddings.add(len(self), found.embeddings)
        plain = replace(found, embeddings=None)
        whole = detected._replace(frame=bare.frame, detections=plain)
        if not _alike(whole, bare):
            self._whole[len(self)] = whole
        self._number.append(frame.number)
        self._time.append(frame.time)
        self._seconds.append(detected.seconds)
        self._count.append(len(found))
        self._boxes.frombytes(np.ascontiguousarray(found.xyxy).tobytes())

    def __iter__(self) -> Iterator[DetectedFrame]:
        boxes = self.boxes
        first = 0
        for k, number in enumerate(self._number):
            last = first + self._count[k]
            kept = self._whole.get(k)
            if kept is None:
                kept = DetectedFrame(
                    Frame(number, self._time[k], NO_PICTURE),
                    Detections.of(boxes[first:last]),
                    seconds=self._seconds[k],
                )
            embeddings = self._embeddings.at(k)
            if embeddings is None:
                yield kept
            else:
                yield kept._replace(detections=replace(kept.detections, embeddings=embeddings))
            first = last

    @property
    def boxes(self) -> F8:
        """(N, 4) the boxes of all frames."""
        return np.array(self._boxes, np.float64).reshape(-1, 4)

    @property
    def columns(self) -> tuple[I8, F8, I8]:
        """(L,) number and time of each frame, and how many detections it has."""
        return (
            np.array(self._number, np.int64),
            np.array(self._time, np.float64),
            np.array(self._count, np.int64),
        )


def _alike(one: DetectedFrame, other: DetectedFrame) -> bool:
    """True if two frames have the same detections and motion of the camera."""
    found = one.detections
    same = found.observed == other.detections.observed and found.covariance is None
    columns = ("confidence", "class_id", "row")
    return (
        same
        and all(
            np.array_equal(getattr(found, name), getattr(other.detections, name))
            for name in columns
        )
        and np.array_equal(one.warp, other.warp)
        and np.array_equal(one.pose, other.pose)
    )


@dataclass(eq=False)
class SceneLesson:
    """The detections of the first pass, and what they teach.

    Attributes
    ----------
    size : width and height of the pictures.
    frames : without their pictures.
    learned : where the scene flickers.
    removed : tracks of the second pass that were flicker.
    """

    size: tuple[int, int]
    frames: KeptFrames = field(default_factory=KeptFrames)
    learned: FlickerMap = NOWHERE
    removed: int = 0
    _came: Arrivals = NO_ARRIVALS
    _shares: F8 = field(default_factory=lambda: np.zeros((0, 0)))

    def take(self, tracked: TrackedFrame) -> None:
        """Keep the detections of a frame."""
        self.frames.append(tracked.detected)

    def learn(self, tracks: Tracks) -> None:
        """Learn from the corrected tracks of the first pass."""
        seen = self._sightings(tracks)
        self.learned = learn_flicker(seen, self.size)
        if self.learned is not NOWHERE:
            self._came = arrivals(seen, self.size, travellers(seen))
            self._shares = flicker_share(seen, self.learned, self.size, len(self.frames), _ROWS)

    def taught(self, classes: ClassSettings) -> ClassSettings:
        """The stages that know where the scene flickers; the same if it does nowhere."""
        if self.learned is NOWHERE:
            return classes
        usual = classes.usual
        odds = FlickerOdds(self.learned, usual.detection_scores)
        return replace(classes, usual=replace(usual, detection_scores=odds))

    def without_flicker(self, tracks: Tracks) -> Tracks:
        """The corrected tracks of the second pass without those that are flicker; identities from
        1, in order.
        """
        if self.learned is NOWHERE:
            return tracks
        seen = self._sightings(tracks)
        flicker = without_flicker(seen, self.learned, self._came, self.size)
        self.removed = len(flicker)
        left = tracks.select(~np.isin(tracks.identity, flicker))
        _, name = np.unique(left.identity, return_inverse=True)
        return replace(left, identity=name.astype(np.int64) + 1)

    @property
    def sentence(self) -> str:
        """A sentence about what was learned; empty for nothing."""
        if self.learned is NOWHERE:
            return ""
        share = 100 * float((self._shares >= _SHOWN).mean())
        where = f"in {share:.0f} % of the picture"
        if share < 1:
            where = "in a few small places"
        return (
            f"The scene flickers {where}: things come and go there all the time and never go"
            " anywhere. What stays there is not tracked (--no-learn: track it)."
        )

    def report(self, background: Image) -> Report:
        """Figures, a sentence and a map of what was learned; empty for nothing.

        ``background`` is a picture of the scene, (0, 0, 3) without one.
        """
        if self.learned is NOWHERE:
            return Report({})
        shares = self._shares
        document: dict[str, object] = {
            "flicker": {
                "share_of_picture": float((shares >= _SHOWN).mean()),
                "tracks_left_out": self.removed,
            }
        }
        picture = charts.share_picture(shares, self.size, background)
        section = render(
            "flicker.html", sentence=self.sentence, removed=self.removed, picture=picture
        )
        return Report(document, (self.sentence,), section)

    def _sightings(self, tracks: Tracks) -> Sightings:
        """All detections, with the tracks that they belong to."""
        return sightings_of(self.frames, tracks)


def sightings_of(frames: KeptFrames, tracks: Tracks) -> Sightings:
    """The detections of frames, with the tracks that they belong to.

    Parameters
    ----------
    frames : in their order.
    tracks : whose ``detection`` counts in the detections of their frames.
    """
    number, time, count = frames.columns
    first = np.cumsum(count) - count
    identity = np.full(int(count.sum()), -1)
    rows = tracks.detection >= 0
    at = np.searchsorted(number, tracks.frame[rows])
    identity[first[at] + tracks.detection[rows]] = tracks.identity[rows]
    return sightings(frames.boxes, np.repeat(time, count), identity)
