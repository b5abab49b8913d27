"""A source of frames with strictly increasing times."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from phdtrack.clock import Clock
from phdtrack.devices import Picture, size_of
from phdtrack.errors import InputError
from phdtrack.types import Frame, Image, SequenceInfo

Read = tuple[int, float | None, Image | Picture, str]
"""A frame's number, its time stamp in seconds (None if the stream has none), its picture, and its
place in words for messages.
"""


@dataclass(slots=True, eq=False)
class VideoSource:
    """Frames in order; their times are seconds since the first one, strictly increasing.

    A stamp that is missing, or not later than the one before, counts as one interval after it. If
    the stamps jump back (two recordings joined), time continues with the intervals between the
    later stamps.

    Attributes
    ----------
    info : displayed size in pixels, rate, name; ``frames`` is 0 if only decoding tells.
    read : yields the frames of this source, and sets its ``problem``.
    note : what was assumed because it is unknown (the rate of a folder of images), and after the
        iteration, which time stamps were not believed; empty if nothing was.
    problem : after the iteration: why the frames ended early, or which were lost; empty if all were
        read.
    share : how much of the file has been read, from 0 to 1; 0 if unknown.
    announced : number of frames in the header of the file, which may be wrong; 0 without one.
    sample : returns so many frames in order, spread over the whole file; fewer if it cannot seek to
        that many places.
    first, last : the frames that are yielded; 0: up to the end. Their numbers and times are those
        in the whole sequence.
    zero : the stamp whose time is 0; NaN: that of the first frame.
    times : returns the clock of the whole sequence; None for a constant rate.
    """

    info: SequenceInfo
    read: Callable[[VideoSource], Iterator[Read]]
    note: str = ""
    problem: str = ""
    share: float = 0.0
    announced: int = 0
    sample: Callable[[int], Iterator[Frame]] = lambda count: iter(())
    first: int = 1
    last: int = 0
    zero: float = math.nan
    times: Callable[[], Clock] | None = None

    def clock(self) -> Clock:
        """The times of all frames, of which a file's are read without decoding if possible."""
        if self.times is None:
            return Clock.constant(self.info.fps)
        return self.times()

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames. Raises `InputError` for a picture of another size than the first; empty
        pictures are yielded too.
        """
        self.problem = ""
        interval = 1 / self.info.fps
        number = 0
        time = -interval
        zero = self.zero
        for number, stamp, image, where in self.read(self):
            if self.last and number > self.last:
                return
            frame = Frame(number, math.nan, image)
            self._check_size(frame, where)
            if stamp is not None and stamp - zero > time:
                time = stamp - zero
            else:
                time = time + interval
            if stamp is not None:
                zero = stamp - time
            if number >= self.first:
                yield replace(frame, time=time)
        if number < self.first > 1:
            end = max(number, self.info.frames)
            self.problem = f"there is no frame {self.first}: the last one is {end}"

    def _check_size(self, frame: Frame, where: str) -> None:
        """Raise `InputError` if a frame that is not empty has another size than the first."""
        width, height = size_of(frame)
        if not width or (width, height) == (self.info.width, self.info.height):
            return
        raise InputError(
            f"this frame is {width}x{height} pixels, the first one"
            f" {self.info.width}x{self.info.height}",
            where=where,
            cure="All frames of a sequence need one size: split the input where it changes.",
        )
