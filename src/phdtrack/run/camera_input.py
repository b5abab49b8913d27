"""The pictures of a camera as a video source without an end."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import chain

from phdtrack.addresses import named, shown
from phdtrack.errors import InputError
from phdtrack.report.pages import counted
from phdtrack.run.pipeline_threads import ahead
from phdtrack.types import Image, SequenceInfo
from phdtrack.video import VideoSource, open_source
from phdtrack.video.decoding import endless
from phdtrack.video.live_sources import LiveSource, check_address

# Seconds without a picture after which a run that reads a camera ends.
GIVE_UP = 60.0
Picture = tuple[int, float, Image, str]
"""Number, time, picture, and the frame's name for error messages."""


def open_camera(address: str) -> VideoSource:
    """The newest pictures of a camera, at their true times; those that arrive while the tracker is
    busy are dropped.

    A file on a server has an end and is read in order, with time-outs. Raises `InputError` if no
    picture arrives.
    """
    check_address(address)
    if "://" in address and not address.startswith("rtsp"):
        # In a thread: an address that does not answer must not keep Ctrl-C waiting.
        with ahead(map(_finite_source, [address])) as sources:
            source = next(sources)[0]
        if source is not None:
            return source
    live = LiveSource(address)
    first = list[Picture]()
    live.start()
    for picture in _pictures(live, live.connect):
        # The rate is measured in the first second.
        first.append(picture)
        if picture[1] - first[0][1] >= 1.0:
            break
    if not first:
        live.stop()
        problem = live.status().problem or "nothing arrived"
        if address.isdecimal():
            cure = "Check that it is connected, and that no other program uses it; 0 is the first."
        else:
            cure = "Check the address, and that the camera is on."
        raise InputError(
            f"no picture arrived in {live.connect:g} s: {problem}", where=address, cure=cure
        )
    status = live.status()
    rate = max(1.0, round(status.fps, 1))
    info = SequenceInfo(status.width, status.height, rate, 0, named(address))
    note = (
        f"{shown(address)}: about {info.fps:g} pictures a second, each at the time at which it"
        " arrived"
    )
    return VideoSource(info, lambda source: _endless(source, live, first, address), note)


def _endless(
    source: VideoSource, live: LiveSource, first: list[Picture], address: str
) -> Iterator[Picture]:
    """The first pictures and all that follow, with times from 0; dropped ones are counted in
    ``source.problem`` at the end.
    """
    zero = first[0][1]
    try:
        for number, at, image, where in chain(first, _pictures(live, GIVE_UP)):
            yield number, at - zero, image, where
        problem = live.status().problem or "it is silent"
        raise ConnectionError(f"{shown(address)}: no picture in {GIVE_UP:g} s ({problem})")
    finally:
        live.stop()
        if dropped := live.status().dropped:
            source.problem = (
                f"{shown(address)}: {counted(dropped, 'picture')} dropped that arrived while"
                " earlier ones were processed"
            )


def _finite_source(address: str) -> tuple[VideoSource | None]:
    """The frames of a file on a server; None for a stream that never ends."""
    return (None if endless(address) else open_source(address),)


def _pictures(live: LiveSource, patience: float) -> Iterator[Picture]:
    """Pictures until none has arrived for so many seconds."""
    last = time.monotonic()
    while time.monotonic() - last < patience:
        frame = live.next(0.2)
        if frame is not None:
            yield frame.number, frame.time, frame.image, f"frame {frame.number}"
            last = time.monotonic()
