"""Live cameras: the newest picture at its true time, despite time-outs, failures and reconnections.

A separate thread reads and decodes everything that a camera sends, and keeps only the newest
picture. Pictures that arrive while the tracker is busy are dropped and counted, so that nothing
lags. A picture's time is that of its arrival. Streams that arrive in pieces of some seconds (HLS),
and files, are played at the pace of their time stamps instead, which then are the times.

If a camera cannot be reached, ends, or is silent for longer than a time-out, the connection is
retried about twice a second. A read that hangs nevertheless is abandoned, and another thread starts
again.
"""

from __future__ import annotations

import math
import random
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from phdtrack.addresses import resolved, shown
from phdtrack.errors import InputError, needed
from phdtrack.files import ffmpeg_name
from phdtrack.opencv_package import cv2
from phdtrack.types import Image
from phdtrack.video.decoding import Decoded, video_stream

State = Literal["connecting", "live", "silent", "down"]
# Seconds between two attempts to connect: the first, and the longest.
FIRST_PAUSE = 0.1
LONGEST_PAUSE = 0.5
# Seconds beyond its time-out after which a hanging read is abandoned.
GRACE = 2.0
# Pictures from which the rate is measured.
RECENT = 64
# Seconds for which pictures buffered during connection are dropped.
CATCH_UP = 3.0
# Seconds for which packets may contain no picture.
UNDECODED = 60.0
_SECRETS = (
    "rtsp://{env:USER}:{file:PATH}@host takes them from a variable or a file, and escapes them;"
    " {env:NAME} alone is a whole address."
)


class LiveFrame(NamedTuple):
    """A picture (H, W, 3) BGR with its number, from 1, among all that arrived, including dropped
    ones; ``time`` in seconds since the source was started; ``wall`` in seconds since 1970 (UTC).
    """

    number: int
    time: float
    wall: float
    image: Image


@dataclass(frozen=True, slots=True)
class SourceStatus:
    """The state of a source.

    Attributes
    ----------
    state : ``connecting``; ``live``; ``silent``, connected without pictures; ``down``, waiting for
        the next attempt.
    since : seconds for which it has been live, or without a picture.
    connects, frames, dropped, undecodable : numbers since the start. Dropped pictures were never
        returned.
    fps : measured over the last pictures; 0 if unknown.
    width, height : size of returned pictures, that of the first; ``sent`` is the size that the
        camera sends now.
    problem : what ended the last connection; empty if nothing did.
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
        in a loop. A password, or the whole, may be ``{env:NAME}`` or ``{file:PATH}``, which is
        looked up for each connection.
    connect, read : time-outs in seconds: up to the first picture of a connection, and between
        pictures.
    clock : seconds that only grow, by which pictures arrive and time-outs end.
    stopped : set when it is stopped; pauses are waits for it.

    Attributes
    ----------
    started : when it was started, on the clock.
    """

    address: str = field(repr=False)
    connect: float = 10.0
    read: float = 5.0
    clock: Callable[[], float] = field(default=time.monotonic, repr=False)
    stopped: threading.Event = field(default_factory=threading.Event, repr=False)
    started: float = field(default=0.0, init=False, repr=False)
    _change: threading.Condition = field(
        default_factory=threading.Condition, init=False, repr=False
    )
    _status: SourceStatus = field(default_factory=SourceStatus, init=False)
    # Number, arrival, UTC and the decoded picture.
    _newest: tuple[int, float, float, Any] | None = field(default=None, init=False, repr=False)
    _times: deque[float] = field(
        default_factory=lambda: deque(maxlen=RECENT), init=False, repr=False
    )
    # The number of the active reading thread, and the last time at which it did not hang.
    _generation: int = field(default=0, init=False, repr=False)
    _progress: float = field(default=0.0, init=False, repr=False)
    _since: float = field(default=0.0, init=False, repr=False)

    def start(self) -> None:
        """Start to read. Raises `InputError` if the packages for that are missing."""
        needed("av")
        needed("cv2")
        self.started = self._since = self.clock()
        self._begin()

    def stop(self) -> None:
        """Stop to read; a read that hangs is abandoned."""
        with self._change:
            self.stopped.set()
            self._change.notify_all()

    def next(self, timeout: float) -> LiveFrame | None:
        """The newest picture, unless it was returned before; None if none arrives within
        ``timeout`` seconds, or the source was stopped.
        """
        with self._change:
            allowed = (self.read if self._status.state == "live" else self.connect) + GRACE
            if not self.stopped.is_set() and self.clock() - self._progress > allowed:
                # The hanging thread is abandoned.
                self._set("down", "no data, although the connection is open")
                self._begin()
            self._change.wait_for(
                lambda: self._newest is not None or self.stopped.is_set(), timeout
            )
            if self._newest is None or self.stopped.is_set():
                return None
            number, at, wall, picture = self._newest
            self._newest = None
            width = self._status.width
            height = self._status.height
        if not isinstance(picture, np.ndarray):
            image = Decoded(picture).bgr((width, height))
        else:
            image = np.asarray(cv2.resize(picture, (width, height)), np.uint8)
        return LiveFrame(number, at - self.started, wall, np.ascontiguousarray(image))

    def status(self) -> SourceStatus:
        """The present state."""
        with self._change:
            now = self.clock()
            times = self._times
            fps = 0.0
            if len(times) > 1 and times[-1] > times[0]:
                fps = (len(times) - 1) / (times[-1] - times[0])
            quiet = now - (times[-1] if times else self._since)
            if self._status.state == "live" and quiet > max(1.0, 3 / fps if fps else 0.0):
                return replace(self._status, state="silent", since=quiet, fps=fps)
            return replace(self._status, since=now - self._since, fps=fps)

    def _begin(self) -> None:
        """Start a reading thread; earlier ones end at their next check."""
        self._generation += 1
        self._progress = self.clock()
        thread = threading.Thread(
            target=self._run,
            args=(self._generation,),
            name=f"read {shown(self.address)}",
            daemon=True,
        )
        thread.start()

    def _current(self, generation: int, *, moves: bool = True) -> bool:
        """Return True if a thread is the active one; ``moves``: note that it does not hang."""
        if self.stopped.is_set() or generation != self._generation:
            return False
        if moves:
            self._progress = self.clock()
        return True

    def _set(self, state: State, problem: str = "") -> None:
        """Set the state, and the problem if there is a new one."""
        if state != self._status.state and "live" in (state, self._status.state):
            # The time without pictures includes all attempts to reconnect.
            if state == "live":
                self._since = self.clock()
            else:
                self._since = self._times[-1]
        self._status = replace(
            self._status, state=state, problem=shown(problem) or self._status.problem
        )

    def _run(self, generation: int) -> None:
        """Connect and read, again and again."""
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
                        self._arrived(picture, at or self.clock())
                    pause = FIRST_PAUSE
                problem = "the stream ended"
            except Exception as error:
                problem = str(getattr(error, "strerror", None) or error) or type(error).__name__
                # FFmpeg reports a time-out as "Immediate exit requested".
                if isinstance(error, av.ExitError):
                    problem = "no answer in time"
            with self._change:
                if not self._current(generation):
                    return
                self._set("down", problem)
            # A random pause keeps many cameras from reconnecting at once.
            self.stopped.wait(pause * random.uniform(0.7, 1.0))
            pause = min(2 * pause, LONGEST_PAUSE)

    def _arrived(self, picture: Any, at: float) -> None:
        """Keep a picture, with its time on the clock, in place of the previous one."""
        status = self._status
        wall = time.time() - (self.clock() - at)
        if isinstance(picture, np.ndarray):
            sent = (picture.shape[1], picture.shape[0])
        else:
            sent = Decoded(picture).size
        width, height = (status.width, status.height) if status.width else sent
        self._status = replace(
            status,
            frames=status.frames + 1,
            dropped=status.dropped + (self._newest is not None),
            width=width,
            height=height,
            sent=sent,
        )
        self._times.append(at)
        self._newest = (self._status.frames, at, wall, picture)
        self._change.notify_all()

    def _pictures(self, generation: int) -> Iterator[tuple[Any, float]]:
        """The pictures of one connection, (H, W, 3) arrays or PyAV's, each with its time on the
        clock; 0 for that of its arrival.
        """
        address = resolved(self.address)
        if address.isdecimal():
            yield from ((picture, 0.0) for picture in self._camera(int(address)))
            return
        av = needed("av")
        remote = "://" in address
        options = dict[str, str]()
        if remote:
            # The packets read to detect the codec are kept: pictures up to the next key frame
            # depend on them.
            options = {"flags": "low_delay", "fpsprobesize": "0"}
        if urlsplit(address).scheme.startswith("rtsp"):
            options["rtsp_transport"] = "tcp"
        timeout = (self.connect, self.read) if remote else None
        name = address if remote else ffmpeg_name(address)
        with av.open(name, options=options, timeout=timeout) as container:
            stream = video_stream(container)
            if stream is None:
                raise OSError("there is no video in it")
            stream.thread_type = "SLICE"
            paced = not remote or "hls" in container.format.name
            pace = _Pace(self.read, self.clock, self.stopped)
            buffered = remote and not paced and container.format.name != "mpjpeg"
            backlog = _Backlog(self.clock, active=buffered)
            pictured = self.clock()
            for packet in container.demux(stream):
                with self._change:
                    # There are no pictures before the next key frame, which may take a camera half
                    # a minute.
                    if not self._current(generation, moves=self.clock() < pictured + UNDECODED):
                        return
                for picture in self._decoded(packet):
                    if picture.time is not None and backlog.holds(picture.time):
                        continue
                    at = 0.0
                    if paced and picture.time is not None:
                        at = pace.wait(picture.time)
                    yield picture, at
                    pictured = self.clock()

    def _decoded(self, packet: Any) -> list[Any]:
        """The pictures of a packet; one that cannot be decoded is counted, and has none."""
        try:
            return list(packet.decode())
        except needed("av").InvalidDataError:
            with self._change:
                self._status = replace(self._status, undecodable=self._status.undecodable + 1)
            return []

    def _camera(self, index: int) -> Iterator[Image]:
        """The pictures of a camera of this machine."""
        with _without_log():
            capture = cv2.VideoCapture(index)
        try:
            if not capture.isOpened():
                raise OSError(f"camera {index} cannot be opened")
            while True:
                success, image = capture.read()
                if not success:
                    return
                yield np.asarray(image, np.uint8)
        finally:
            capture.release()


@contextmanager
def _without_log() -> Iterator[None]:
    """Keep OpenCV from printing lines about a camera that is not there: the status says so."""
    log = getattr(cv2.utils, "logging", None)
    if log is None:
        yield
        return
    before = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(before)


class _Backlog:
    """Finds pictures that were buffered during connection: they are older than their arrival, and
    arrive all at once.
    """

    def __init__(self, clock: Callable[[], float], *, active: bool) -> None:
        self._clock = clock
        self._active = active
        self._deadline = clock() + CATCH_UP
        self._arrival = 0.0
        self._stamp = 0.0

    def holds(self, stamp: float) -> bool:
        """Return True if the next picture, with this time stamp, belongs to the backlog."""
        if not self._active:
            return False
        now = self._clock()
        faster = not self._arrival or now - self._arrival < (stamp - self._stamp) / 2
        self._active = now < self._deadline and faster
        self._arrival = now
        self._stamp = stamp
        return self._active


class _Pace:
    """Plays pictures at the pace of their time stamps.

    Parameters
    ----------
    tolerance : seconds by which a picture may be early or late before the pace starts anew.
    clock : seconds that only grow.
    stopped : ends a wait.
    """

    def __init__(
        self, tolerance: float, clock: Callable[[], float], stopped: threading.Event
    ) -> None:
        self._tolerance = tolerance
        self._clock = clock
        self._stopped = stopped
        self._start = 0.0
        self._first = 0.0
        self._last = -math.inf

    def wait(self, stamp: float) -> float:
        """Wait until the picture with this time stamp is due; return this time."""
        at = self._start + (stamp - self._first)
        late = self._clock() - at
        if abs(late) > self._tolerance or at <= self._last:
            # The first picture; or the stamps jumped, or the stream was held up.
            self._start = self._clock()
            self._first = stamp
            at = self._start
        elif late < 0:
            self._stopped.wait(-late)
        self._last = at
        return at


def check_address(address: str) -> None:
    """Raise `InputError` if it is no address, if a password contains characters that end the host
    of an address and are not escaped, or if a variable or file that it names is missing.
    """
    try:
        plain = resolved(address)
        if "://" not in plain:
            return
        urlsplit(plain)
    except LookupError as error:
        raise InputError(str(error), where="SOURCE", cure=_SECRETS) from None
    except ValueError:
        # The original message may contain a part of a password.
        raise InputError("this is not an address", where="SOURCE") from None
    # The part before the first / is no host with a port.
    before = re.match(r"[A-Za-z0-9+.-]+://([^/@?#]*):([^/@?#]*)[/?#].*@", plain, re.DOTALL)
    slash = before and not (before[2].isdecimal() and re.search(r"[.\]]", before[1]))
    if slash or re.match(r"[A-Za-z0-9+.-]+://[^/]*([?#].*@|\s.*@)", plain, re.DOTALL):
        raise InputError(
            "expected user:password@host in the address, got an @ after the first /, ?, # or blank",
            where="SOURCE",
            cure="Write / in a password as %2F, ? as %3F, # as %23, a blank as %20, and @ after the"
            f" host as %40. {_SECRETS}",
        )
