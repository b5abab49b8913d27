"""Cameras that never end: the newest picture, at its true time, over time-outs, failures and
reconnections.

A thread of its own reads and decodes everything that a camera sends and keeps the newest picture
only: what comes while the tracker is busy is dropped and counted, so that nothing lags. A picture's
time is that of its arrival. Streams that arrive in pieces of seconds (HLS), and files, are played
at the pace of their time stamps instead, and these are the times then.

A camera that cannot be reached, ends, or says nothing for longer than a time-out is tried again,
about twice a second. A read that hangs in spite of that is left behind, and another thread begins
anew.
"""

from __future__ import annotations

import math
import random
import re
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple
from urllib.parse import urlsplit, urlunsplit

import numpy as np

from phdtrack.errors import InputError, needed, shown
from phdtrack.types import Image
from phdtrack.video.decoding import bgr

State = Literal["connecting", "live", "silent", "down"]
# Seconds between two tries: the first, and the longest.
FIRST_PAUSE = 0.1
LONGEST_PAUSE = 0.5
# A read that takes so much longer than its time-out is left behind. Pictures of which the rate is
# measured. Seconds for which pictures may be left out that came while the connection was made; for
# which packets may bring none.
GRACE = 2.0
RECENT = 64
CATCH_UP = 3.0
UNDECODED = 60.0


class LiveFrame(NamedTuple):
    """A picture: its number from 1 among all that arrived, dropped ones too; seconds since the
    source was started, and since 1970 (UTC); (H, W, 3) BGR."""

    number: int
    time: float
    wall: float
    image: Image


@dataclass(frozen=True, slots=True)
class SourceStatus:
    """How a source is.

    Attributes
    ----------
    state : ``connecting``; ``live``; ``silent``, connected without pictures; ``down``, waiting for
        the next try.
    since : seconds that it has been live, or that no picture has come.
    connects, frames, dropped, undecodable : since the start. Dropped pictures were never given to
        anybody.
    fps : measured over the last pictures; 0 where unknown.
    width, height : of the pictures that are given, those of the first; ``sent`` is the size that
        the camera sends now.
    problem : what ended the last connection; empty where nothing did.
    """

    state: State = "connecting"
    since: float = 0.0
    connects: int = 0
    frames: int = 0
    dropped: int = 0
    undecodable: int = 0
    fps: float = 0.0
    width: int = 0
    height: int = 0
    sent: tuple[int, int] = (0, 0)
    problem: str = ""


@dataclass(slots=True, eq=False)
class LiveSource:
    """One camera.

    Parameters
    ----------
    address : ``rtsp://…``, ``http://…`` (MJPEG, HLS), a camera's number, or a file, which is played
        again and again.
    connect, read : time-outs in seconds: up to the first picture of a connection, and between two
        pictures.
    """

    address: str = field(repr=False)
    connect: float = 10.0
    read: float = 5.0
    _change: threading.Condition = field(
        default_factory=threading.Condition, init=False, repr=False
    )
    _status: SourceStatus = field(default_factory=SourceStatus, init=False)
    # Number, arrival, UTC and the decoded picture.
    _newest: tuple[int, float, float, Any] | None = field(default=None, init=False, repr=False)
    _times: deque[float] = field(
        default_factory=lambda: deque(maxlen=RECENT), init=False, repr=False
    )
    # Which reading thread counts; when it last showed that it does not hang.
    _generation: int = field(default=0, init=False, repr=False)
    _progress: float = field(default=0.0, init=False, repr=False)
    _stopped: bool = field(default=False, init=False, repr=False)
    _start: float = field(default=0.0, init=False, repr=False)
    _since: float = field(default=0.0, init=False, repr=False)

    def start(self) -> None:
        """Begin to read. Raises `InputError` where the package av is missing."""
        needed("av")
        self._start = self._since = time.monotonic()
        self._begin()

    def stop(self) -> None:
        """Read no more; a read that hangs is left behind."""
        with self._change:
            self._stopped = True
            self._change.notify_all()

    def next(self, timeout: float) -> LiveFrame | None:
        """The newest picture that was not given yet; None where none comes within ``timeout``
        seconds, or it was stopped.
        """
        with self._change:
            allowed = (self.read if self._status.state == "live" else self.connect) + GRACE
            if not self._stopped and time.monotonic() - self._progress > allowed:
                # A thread that hangs is left behind.
                self._set("down", "nothing came, and the connection did not end")
                self._begin()
            self._change.wait_for(lambda: self._newest is not None or self._stopped, timeout)
            if self._newest is None or self._stopped:
                return None
            number, at, wall, picture = self._newest
            self._newest = None
            width = self._status.width
            height = self._status.height
        if isinstance(picture, np.ndarray):
            import cv2

            if picture.shape[1::-1] == (width, height):
                image = picture
            else:
                image = cv2.resize(picture, (width, height))
        else:
            image = bgr(picture, width, height)
        return LiveFrame(number, at - self._start, wall, np.ascontiguousarray(image))

    def status(self) -> SourceStatus:
        """How it is now."""
        with self._change:
            now = time.monotonic()
            times = self._times
            if len(times) > 1 and times[-1] > times[0]:
                fps = (len(times) - 1) / (times[-1] - times[0])
            else:
                fps = 0.0
            state = self._status.state
            if times:
                quiet = now - times[-1]
            else:
                quiet = now - self._since
            if state == "live" and quiet > max(1.0, 3 / fps if fps else 0.0):
                return replace(self._status, state="silent", since=quiet, fps=fps)
            return replace(self._status, since=now - self._since, fps=fps)

    def _begin(self) -> None:
        """A reading thread; those before it end when they next look."""
        self._generation += 1
        self._progress = time.monotonic()
        thread = threading.Thread(
            target=self._run,
            args=(self._generation,),
            name=f"read {shown(self.address)}",
            daemon=True,
        )
        thread.start()

    def _current(self, generation: int, *, moves: bool = True) -> bool:
        """Whether a thread is the one that counts; where it ``moves`` it has just shown that it
        does not hang.
        """
        if self._stopped or generation != self._generation:
            return False
        if moves:
            self._progress = time.monotonic()
        return True

    def _set(self, state: State, problem: str | None = None) -> None:
        if state != self._status.state and "live" in (state, self._status.state):
            # Without pictures since the last one, however often it is tried again.
            if state == "live":
                self._since = time.monotonic()
            else:
                self._since = self._times[-1]
        if problem is None:
            said = self._status.problem
        else:
            said = shown(problem)
        self._status = replace(self._status, state=state, problem=said)

    def _run(self, generation: int) -> None:
        """Connect, read, and again."""
        av = needed("av")

        pause = FIRST_PAUSE
        while True:
            with self._change:
                if not self._current(generation):
                    return
                self._set("connecting")
            try:
                for picture, at in self._pictures(generation):
                    with self._change:
                        if not self._current(generation):
                            return
                        if self._status.state != "live":
                            self._status = replace(self._status, connects=self._status.connects + 1)
                            self._set("live")
                            self._times.clear()
                        self._arrived(picture, at or time.monotonic())
                    pause = FIRST_PAUSE
                problem = "the stream ended"
            except Exception as error:
                # FFmpeg's own words for a time-out are "Immediate exit requested".
                late = isinstance(error, av.ExitError)
                said = str(getattr(error, "strerror", None) or error) or type(error).__name__
                if late:
                    problem = "no answer in time"
                else:
                    problem = said
            with self._change:
                if not self._current(generation):
                    return
                self._set("down", problem)
                # Not all cameras of a building at once.
                self._change.wait_for(lambda: self._stopped, pause * random.uniform(0.7, 1.0))
            pause = min(2 * pause, LONGEST_PAUSE)

    def _arrived(self, picture: Any, at: float) -> None:
        """Keep a picture, of a time on the monotonic clock, in place of the one before."""
        status = self._status
        wall = time.time() - (time.monotonic() - at)
        if isinstance(picture, np.ndarray):
            size = picture.shape[1::-1]
        else:
            size = (picture.width, picture.height)
        width, height = (status.width, status.height) if status.width else size
        dropped = status.dropped + (self._newest is not None)
        self._status = replace(
            status,
            frames=status.frames + 1,
            dropped=dropped,
            width=width,
            height=height,
            sent=(int(size[0]), int(size[1])),
        )
        self._times.append(at)
        self._newest = (self._status.frames, at, wall, picture)
        self._change.notify_all()

    def _pictures(self, generation: int) -> Iterator[tuple[Any, float]]:
        """The pictures of one connection: (H, W, 3) arrays, or PyAV's, each with its time, 0 for
        that of its arrival.
        """
        if self.address.isdecimal():
            yield from ((picture, 0.0) for picture in self._camera(int(self.address)))
            return
        av = needed("av")

        remote = "://" in self.address
        # What is read to find out the codec is kept: all until the next key frame depends on it.
        if remote:
            options = {"flags": "low_delay", "fpsprobesize": "0"}
        else:
            options = {}
        if urlsplit(self.address).scheme.startswith("rtsp"):
            options["rtsp_transport"] = "tcp"
        with av.open(
            self.address, options=options, timeout=(self.connect, self.read) if remote else None
        ) as container:
            stream = container.streams.video[0]
            stream.thread_type = "SLICE"
            paced = not remote or "hls" in container.format.name
            begun = 0.0
            first = 0.0
            last = -math.inf
            behind = remote and not paced and container.format.name != "mpjpeg"
            before = 0.0
            stamp = 0.0
            pictured = time.monotonic()
            caught_up = pictured + CATCH_UP
            for packet in container.demux(stream):
                with self._change:
                    # Until the next key frame no picture comes, which cameras may take half a
                    # minute for.
                    if not self._current(generation, moves=time.monotonic() < pictured + UNDECODED):
                        return
                try:
                    pictures: list[Any] = list(packet.decode())
                except av.InvalidDataError:
                    with self._change:
                        self._status = replace(
                            self._status, undecodable=self._status.undecodable + 1
                        )
                    continue
                for picture in pictures:
                    if behind and picture.time is not None:
                        # What came while the connection was made is older than its arrival, and
                        # comes all at once.
                        now = time.monotonic()
                        behind = now < caught_up and (
                            not before or now - before < (picture.time - stamp) / 2
                        )
                        before = now
                        stamp = picture.time
                        if behind:
                            continue
                    at = 0.0
                    if paced and picture.time is not None:
                        at = begun + (picture.time - first)
                        late = time.monotonic() - at
                        if abs(late) > self.read or at <= last:
                            # The first one; or the time stamps jumped, or the stream was held up:
                            # from here on anew.
                            begun = time.monotonic()
                            first = picture.time
                            at = begun
                        elif late < 0:
                            time.sleep(-late)
                        last = at
                    yield picture, at
                    pictured = time.monotonic()

    def _camera(self, index: int) -> Iterator[Image]:
        """The pictures of a camera of this machine."""
        import cv2

        capture = cv2.VideoCapture(index)
        try:
            if not capture.isOpened():
                raise OSError(f"camera {index} cannot be opened")
            while True:
                there, image = capture.read()
                if not there:
                    return
                yield np.asarray(image, np.uint8)
        finally:
            capture.release()


def check_address(address: str) -> None:
    """Raise `InputError` where it is no address, or has a password with a / that is not written as
    %2F.
    """
    try:
        urlsplit(address)
    except ValueError:
        # Its own words may hold a part of a password.
        raise InputError("expected an address, and this is none", where="SOURCE") from None
    # What stands before the first / is no host with a port.
    before = re.match(r"[A-Za-z0-9+.-]+://([^/@?]*):([^/@?]*)/[^?]*@", address)
    if before and not (before[2].isdecimal() and re.search(r"[.\]]", before[1])):
        problem = "expected user:password@host in the address, got an @ behind the first /"
        cure = "Write / in a password as %2F, and @ behind the host as %40."
        raise InputError(problem, where="SOURCE", cure=cure)


def named(address: str) -> str:
    """A short name for a source, for folders and pages: letters, digits, points and hyphens
    only.
    """
    parts = urlsplit(shown(address))
    if parts.netloc:
        plain = urlunsplit(("", parts.netloc.rpartition("@")[2], parts.path, "", ""))
    else:
        plain = shown(address)
    return re.sub(r"[^A-Za-z0-9.-]+", "-", plain).strip("-.") or "camera"
