"""Which tracks of moving regions are doubtful, judged without truth.

A background detector reports what differs from the background: an object, a part of one, several
together, or something that only moves in place. Tracks of the last three show one of these signs:

* **size jumps**: the height of the detections changes by half from one to the next, more often than
  once in twenty. A region splits or merges, or takes in a shadow. The height is judged because the
  width of somebody who walks changes with each step, at low frame rates as much.
* **no motion**: no side of the box ever moves by the object's own size. (The centre of somebody who
  comes towards the camera hardly moves, the lower side does.) A track that the first or last frame
  cuts short may not have had the time. It moves if its sides go on steadily, so far that it is
  clear from the noise of its boxes, and fast enough to move by its size within seconds. What sways
  in place, or stands, does not, however short the file.
* **inside ends**: the track begins and ends inside the picture. Objects come and go at its border,
  or are there in the first or last frame.

The measure is the share of boxes that belong to tracks with at least one of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phdtrack.types import F8, I8, Bool, SequenceInfo, Tracks

# A jump changes the height by this factor; the share of steps from which on jumps are a sign.
_JUMP = 1.5
_MAX_JUMPS = 0.05
# Sizes of the object that a side of its box must move by at least.
_MIN_TRAVEL = 1.0
# What had no time for that moves if the way it went at a steady pace is so many times the deviation
# from that pace, and if it would move by its size within so many seconds.
_STEADY = 8.0
_MAX_SECONDS = 10.0
# A box is at the border within this share of the longer side of the picture. Tracks that begin or
# end within these seconds of the first or last frame may have been there before or after; at least
# so many frames.
_BORDER = 0.02
_CUT = 0.2
_MIN_CUT = 3
# Share of boxes in doubtful tracks from which on a run as a whole is doubtful, and the number of
# boxes that this needs.
DOUBTFUL = 0.25
_MIN_BOXES = 5


class Sign(NamedTuple):
    """A sign of doubtful tracks: its name in run.json, and the share of boxes in such tracks."""

    name: str
    share: float


@dataclass(frozen=True, slots=True)
class DoubtfulTracks:
    """The share of boxes, 0 to 1, that belong to doubtful tracks.

    Attributes
    ----------
    boxes, tracks : number of boxes and of tracks that were judged.
    share : boxes in tracks with any sign.
    size_jumps, no_motion, inside_ends : boxes in tracks with this sign; a track may have several.
    """

    boxes: int = 0
    tracks: int = 0
    share: float = 0.0
    size_jumps: float = 0.0
    no_motion: float = 0.0
    inside_ends: float = 0.0

    @classmethod
    def pooled(cls, parts: Sequence[DoubtfulTracks]) -> DoubtfulTracks:
        """The shares over several parts of a video, each weighted by its boxes."""
        boxes = np.array([part.boxes for part in parts], np.int64)
        shares = np.array(
            [(part.share, part.size_jumps, part.no_motion, part.inside_ends) for part in parts]
        ).reshape(-1, 4)
        means = boxes @ shares / max(1, boxes.sum())
        return cls(int(boxes.sum()), sum(part.tracks for part in parts), *means.tolist())

    @property
    def warn(self) -> bool:
        """True if so many boxes are doubtful that the tracks as a whole are."""
        return self.boxes >= _MIN_BOXES and self.share >= DOUBTFUL

    @property
    def signs(self) -> tuple[Sign, ...]:
        """The signs that occur, the most frequent first."""
        names = ("inside_ends", "size_jumps", "no_motion")
        found = [Sign(name, getattr(self, name)) for name in names if getattr(self, name) > 0]
        return tuple(sorted(found, key=lambda sign: -sign.share))


@dataclass(slots=True)
class _Track:
    """Figures of a track so far.

    Attributes
    ----------
    boxes : number of rows.
    first, last : their frames.
    begins_inside, ends_inside : whether the first and the last box are away from the border.
    low, high : (4,) extremes of the boxes' sides, pixels.
    log_size : sum of the logarithms of the boxes' mean side.
    steps, jumps : pairs of successive detections, and those whose height jumps.
    log_height : logarithm of the height of the last detection; NaN before the first.
    mean : (5,) means of the frame's number and of the boxes' sides.
    scatter : (5, 5) sums of the products of their deviations from the means.
    """

    boxes: int
    first: int
    last: int
    begins_inside: bool
    ends_inside: bool
    low: F8
    high: F8
    log_size: float
    mean: F8
    scatter: F8
    steps: int = 0
    jumps: int = 0
    log_height: float = math.nan

    @classmethod
    def of(cls, frame: I8, inside: Bool, boxes: F8, log_size: F8) -> _Track:
        """The track of some rows (n,) in the order of their frames."""
        values = np.column_stack([frame, boxes])
        mean = values.mean(axis=0)
        return cls(
            boxes=len(frame),
            first=int(frame[0]),
            last=int(frame[-1]),
            begins_inside=bool(inside[0]),
            ends_inside=bool(inside[-1]),
            low=boxes.min(axis=0),
            high=boxes.max(axis=0),
            log_size=float(log_size.sum()),
            mean=mean,
            scatter=(values - mean).T @ (values - mean),
        )

    def extend(self, later: _Track) -> None:
        """Append rows of the same track."""
        boxes = self.boxes + later.boxes
        apart = later.mean - self.mean
        share = later.boxes / boxes
        self.scatter = self.scatter + later.scatter + self.boxes * share * np.outer(apart, apart)
        self.mean = self.mean + share * apart
        self.boxes = boxes
        self.last = later.last
        self.ends_inside = later.ends_inside
        self.low = np.minimum(self.low, later.low)
        self.high = np.maximum(self.high, later.high)
        self.log_size += later.log_size

    def count_jumps(self, log_height: F8) -> None:
        """Take in the heights (n,) of further detections, as logarithms."""
        if not len(log_height):
            return
        steps = np.abs(np.diff(log_height, prepend=self.log_height))
        self.steps += int(np.isfinite(steps).sum())
        self.jumps += int((steps > math.log(_JUMP)).sum())
        self.log_height = float(log_height[-1])

    def signs(self, first: float, last: float, fps: float) -> Bool:
        """(3,) which signs the track shows: size jumps, no motion, inside ends.

        ``first``, ``last``: frames before and after which an end says nothing; ``fps``: frames a
        second.
        """
        travel = float((self.high - self.low).max())
        size = math.exp(self.log_size / self.boxes)
        begins = self.begins_inside and self.first > first
        ends = self.ends_inside and self.last < last
        moves = travel >= _MIN_TRAVEL * size
        if self.first <= first or self.last >= last:
            moves = moves or self._goes_on(_MIN_TRAVEL * size / (_MAX_SECONDS * fps))
        return np.array([self.jumps > _MAX_JUMPS * self.steps, not moves, begins and ends])

    def _goes_on(self, least: float) -> bool:
        """True if a side moves steadily, by ``least`` pixels a frame or more."""
        variance = float(self.scatter[0, 0])
        # Two boxes are always on a line.
        if self.boxes < 3 or not variance > 0:
            return False
        pace = self.scatter[0, 1:] / variance
        squares = np.diagonal(self.scatter)[1:] - pace**2 * variance
        deviation = np.sqrt(np.maximum(squares, 0.0) / (self.boxes - 2))
        way = np.abs(pace) * (self.last - self.first)
        return bool(((np.abs(pace) >= least) & (way > _STEADY * deviation)).any())


class TrackSigns:
    """Judges tracks while their corrected rows arrive, or all at once.

    Memory does not grow with tracks that have ended.

    Parameters
    ----------
    info : size and rate of the video.
    region : (H, W) True where objects are reported at all; None for everywhere.
    """

    def __init__(self, info: SequenceInfo, region: Bool | None = None) -> None:
        self._border = _BORDER * max(info.width, info.height)
        self._fps = info.fps
        self._cut = max(_MIN_CUT, _CUT * info.fps)
        if region is None:
            region = np.ones((info.height, info.width), np.bool_)
        # All around it nothing is reported.
        self._region = np.pad(region, 1)
        self._first = 0
        self._last = 0
        self._tracks = dict[int, _Track]()
        self._before = set[int]()
        # Number of boxes in tracks that have ended: all, with any sign, and with each of the signs.
        self._ended = np.zeros(5, np.int64)
        self._ended_tracks = 0

    @property
    def active(self) -> int:
        """Number of tracks that have not ended yet."""
        return len(self._tracks)

    def see(self, number: int) -> None:
        """Note that the frame with this number was tracked."""
        self._first = self._first or number
        self._last = number

    def add(self, rows: Tracks, used: F8) -> None:
        """Take in corrected rows.

        A track without rows in two calls in a row has ended.

        Parameters
        ----------
        rows : M rows, of each track in the order of their frames over all calls.
        used : (M, 4) the boxes of the detections that they rest on; NaN for predicted rows.
        """
        order = np.lexsort((rows.frame, rows.identity))
        identities, starts = np.unique(rows.identity[order], return_index=True)
        boxes = rows.xyxy[order]
        frame = rows.frame[order]
        inside = self._inside(boxes)
        sides = np.maximum(boxes[:, 2:] - boxes[:, :2], 1e-9)
        log_size = np.log(sides).mean(axis=1)
        log_height = np.log(np.maximum(used[order, 3] - used[order, 1], 1e-9))
        ends = np.append(starts, len(order))[1:]
        for identity, start, end in zip(identities.tolist(), starts, ends, strict=True):
            part = slice(start, end)
            found = _Track.of(frame[part], inside[part], boxes[part], log_size[part])
            if identity in self._tracks:
                self._tracks[identity].extend(found)
            else:
                self._tracks[identity] = found
            heights = log_height[part]
            self._tracks[identity].count_jumps(heights[np.isfinite(heights)])
        now = set(identities.tolist())
        for identity in self._tracks.keys() - now - self._before:
            # What ended so long ago did not end because the source did.
            self._ended += self._counts([self._tracks.pop(identity)], math.inf)
            self._ended_tracks += 1
        self._before = now

    def result(self) -> DoubtfulTracks:
        """The shares so far."""
        counts = self._ended + self._counts([*self._tracks.values()], self._last - self._cut)
        boxes = int(counts[0])
        share, jumps, still, inside = (counts[1:] / max(boxes, 1)).tolist()
        tracks = self._ended_tracks + len(self._tracks)
        return DoubtfulTracks(boxes, tracks, share, jumps, still, inside)

    def _counts(self, tracks: list[_Track], last: float) -> I8:
        """(5,) boxes of the tracks: all, with any sign, with each of the signs."""
        counts = np.zeros(5, np.int64)
        for track in tracks:
            signs = track.signs(self._first + self._cut, last, self._fps)
            counts += track.boxes * np.array([True, signs.any(), *signs])
        return counts

    def _inside(self, boxes: F8) -> Bool:
        """(M,) True for boxes (M, 4) that are away from the border of the picture and region."""
        grown = boxes + self._border * np.array([-1, -1, 1, 1])
        height, width = self._region.shape
        middle = (grown[:, :2] + grown[:, 2:]) / 2
        columns = np.stack([grown[:, 0], middle[:, 0], grown[:, 2]], axis=1)
        rows = np.stack([grown[:, 1], middle[:, 1], grown[:, 3]], axis=1)
        # The region has a margin of one pixel.
        x = np.clip(np.floor(columns) + 1, 0, width - 1).astype(np.int64)
        y = np.clip(np.floor(rows) + 1, 0, height - 1).astype(np.int64)
        inside: Bool = self._region[y[:, :, None], x[:, None, :]].all(axis=(1, 2))
        return inside
