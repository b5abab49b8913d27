"""The annotated videos of a run: drawn from the source when it has ended, or frame by frame if its
pictures come only once.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import repeat
from typing import Any, Self

import numpy as np

from phdtrack.devices import bgr_of, planes_of, size_of
from phdtrack.errors import InputError, interrupted
from phdtrack.report import Annotator
from phdtrack.run import directory as rundir
from phdtrack.run.loop import NO_PICTURE, TrackedFrame
from phdtrack.run.observers import Draw
from phdtrack.run.pipeline_threads import ahead
from phdtrack.run.reporter import Advance
from phdtrack.run.running import FrameSummary, Progress, Run, Stop
from phdtrack.types import Frame, Image, Tracks
from phdtrack.video import VideoWriter
from phdtrack.video.writing import FAST

# The shorter side of an annotated video at the least, in pixels.
_LEAST = 16
DRAWN_AFTER_SIGNAL = 0.5
"""Seconds for which videos are drawn after a signal."""


class _Drawing:
    """Draws frames for the annotated video, whose longer side is at most ``size`` pixels; 0: that
    of the source.
    """

    def __init__(self, run: Run, size: int, *, planes: bool = False) -> None:
        info = run.inputs.info
        sides = (info.width, info.height)
        # Encoders take no sides of a few pixels, and even ones only.
        share = max(size / max(sides), _LEAST / min(sides))
        self.size = sides
        if size and share < 1:
            self.size = (
                2 * int(share * info.width / 2 + 1e-9),
                2 * int(share * info.height / 2 + 1e-9),
            )
        self._factor = np.tile(np.divide(self.size, sides), 2)
        blur = run.options.blur
        small = replace(info, width=self.size[0], height=self.size[1])
        self._annotate = Annotator(small, names=run.names, blur=blur, legend=True)
        # The decoder's planes go to the encoder as they are; blurring, and odd sizes, need BGR.
        self._planes = planes and not (blur or self.size[0] % 2 or self.size[1] % 2)

    def __call__(self, frame: Frame, summary: FrameSummary, rows: Tracks) -> Image:
        """The picture with rows of tracks and detections: BGR or, if allowed, its
        `Picture.planes`.
        """
        # A picture keeps BGR of its own size only.
        size = None if self.size == size_of(frame) else self.size
        if self._planes and not isinstance(frame.picture, np.ndarray):
            image = planes_of(frame.picture, size).reshape(-1, self.size[0])
        else:
            image = bgr_of(frame.picture, size)
        rows = replace(rows, xyxy=rows.xyxy * self._factor)
        detections = summary.detections
        return self._annotate(
            image,
            summary.number,
            rows,
            replace(detections, xyxy=detections.xyxy * self._factor),
            mass=summary.mass,
            time=summary.time,
            clutter_probability=summary.clutter_probability,
        )


class LiveVideo:
    """The video of pictures that come only once: online rows are drawn when they are final, and no
    picture is kept.
    """

    def __init__(self, run: Run) -> None:
        self._draw = _Drawing(run, run.options.video_size)
        self._delay = run.options.delay
        self._waiting = deque[tuple[Frame, FrameSummary]]()
        self._video = VideoWriter(
            *(run.directory.file(rundir.VIDEO), *self._draw.size, run.inputs.info.fps),
            coding=FAST,
            pixel_aspect=run.inputs.info.pixel_aspect,
        )

    def take(self, tracked: TrackedFrame) -> None:
        """Draw the frame that the rows are of, which the output delay holds back."""
        self._waiting.append((tracked.detected.frame, FrameSummary.of(tracked)))
        if len(self._waiting) > self._delay:
            self._write(tracked.rows)

    def flush(self, rows: Tracks) -> None:
        """Draw the frames that still wait."""
        while self._waiting:
            self._write(rows)

    def _write(self, rows: Tracks) -> None:
        frame, summary = self._waiting.popleft()
        picture = self._draw(frame, summary, rows.select(rows.frame == frame.number))
        self._video.write(picture, frame.time)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self._video.__exit__(*error)


def draw_videos(run: Run, progress: Progress, tracks: Tracks, advance: Advance) -> None:
    """Draw the videos of the frames that were tracked, except of pictures that come only once.

    Parameters
    ----------
    run, progress : what was run, and how far it got; errors are noted there.
    tracks : corrected tracks.
    advance : is called with the number of frames drawn.
    """
    try:
        with ExitStack() as files:
            pictures = run.inputs.pictures and run.inputs.again
            offers = [
                observer.drawing(run.directory, files, pictures=pictures)
                for observer in run.observers
            ]
            draw = [offer for offer in offers if offer is not None]
            images: Iterable[Image] = repeat(NO_PICTURE)
            if pictures:
                images, write = _annotated_video(run, progress, tracks, files, alone=not draw)
                draw.insert(0, write)
            if draw:
                _draw_all(run, progress, images, draw, advance)
    except Exception as error:
        if isinstance(error, InputError | OSError):
            progress.unwritten.append(error)
        else:
            progress.cut = as_interrupt(error)


def _annotated_video(
    run: Run, progress: Progress, tracks: Tracks, files: ExitStack, *, alone: bool
) -> tuple[Iterator[Image], Draw]:
    """The annotated pictures, and a function that writes them.

    Observers draw on the same pictures, and in their coordinates: only a video that is drawn
    ``alone`` is shrunk.
    """
    drawing = _Drawing(run, run.options.video_size if alone else 0, planes=alone)
    path = run.directory.file(rundir.VIDEO)
    fps = run.inputs.info.fps
    aspect = run.inputs.info.pixel_aspect
    video = files.enter_context(
        VideoWriter(path, *drawing.size, fps, coding=FAST, pixel_aspect=aspect)
    )
    frames = files.enter_context(ahead(run.inputs.source, 1))
    images = files.enter_context(ahead(_annotated(drawing, progress.summaries, frames, tracks), 1))

    def write(number: int, time: float, picture: Image) -> None:
        video.write(picture, time)

    return images, write


def _annotated(
    draw: _Drawing, summaries: Iterable[FrameSummary], frames: Iterable[Frame], tracks: Tracks
) -> Iterator[Image]:
    """The frames that were tracked, annotated."""
    for summary, frame in zip(summaries, frames, strict=False):
        begin, end = np.searchsorted(tracks.frame, [summary.number, summary.number + 1])
        yield draw(frame, summary, tracks.select(np.arange(begin, end)))


def _draw_all(
    run: Run, progress: Progress, images: Iterable[Image], draw: list[Draw], advance: Advance
) -> None:
    """Draw frame by frame; after a signal only for a short time."""
    end = math.inf
    patience = math.inf
    if isinstance(progress.stop, KeyboardInterrupt):
        patience = DRAWN_AFTER_SIGNAL
    number = 0
    try:
        for count, (summary, image) in enumerate(
            zip(progress.summaries, images, strict=False), start=1
        ):
            number = summary.number
            for one in draw:
                one(number, summary.time, image)
            advance(count, total=progress.frames, description="drawing")
            # Without the first one, for which kernels are loaded.
            if count == 1:
                end = time.monotonic() + patience
            if time.monotonic() >= end and count < progress.frames:
                progress.drawn = number
                break
    except KeyboardInterrupt as stop:
        # The videos end here, and can be played.
        progress.cut = stop
        run.reporter.stopping(f"stopped while frame {number} was drawn")


def as_interrupt(stop: Stop) -> Stop:
    """Ctrl-C, in whatever form compiled code raises it, or the error itself."""
    if interrupted(stop) and not isinstance(stop, KeyboardInterrupt):
        return KeyboardInterrupt()
    return stop
