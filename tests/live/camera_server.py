"""Cameras for tests: MJPEG over HTTP on loopback that can be frozen, killed, restarted, slowed down
and resized; and a source without a network, whose pictures and times are given, for what must not
depend on how fast the machine is."""

from __future__ import annotations

import contextlib
import functools
import math
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from fractions import Fraction
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import av
import cv2
import numpy as np

from phdtrack.video.live_sources import LiveFrame, SourceStatus

HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"


class CameraServer:
    """Serves until `kill`; the pictures show their number as brightness.

    ``rate`` pictures a second of ``size`` (width, height). While ``frozen`` nothing is sent on any
    connection; while ``mute`` connections are accepted and nothing is said on them. ``broken``
    pictures are cut in half. ``draw`` makes another picture (H, W, 3) of the seconds since 1970.
    ``sent``: when each picture began to be sent, on any connection (monotonic).
    """

    def __init__(self) -> None:
        self.rate = 20.0
        self.size = (160, 120)
        self.frozen = self.mute = self.broken = False
        self.draw: Callable[[float], np.ndarray] | None = None
        self.asked: list[str] = []
        self.sent: list[float] = []
        self._open: list[socket.socket] = []
        self._listening: socket.socket | None = None
        self.port = 0
        self.restart()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/stream"

    def restart(self) -> None:
        """Listen on the same port as before."""
        self._listening = socket.create_server(("127.0.0.1", self.port))
        self.port = self._listening.getsockname()[1]
        threading.Thread(target=self._accept, args=(self._listening,), daemon=True).start()

    def kill(self) -> None:
        """End all connections and listen no more."""
        for one in (self._listening, *self._open):
            if one is not None:
                # A thread that waits in accept or send is woken by this.
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
                one.close()
        self._open.clear()

    def _accept(self, listening: socket.socket) -> None:
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            self._open.append(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        number = 0
        try:
            self.asked.append(connection.recv(4096).decode("latin-1"))
            while self.mute:
                time.sleep(0.02)
            connection.sendall(HEAD)
            while True:
                while self.frozen:
                    time.sleep(0.02)
                number += 1
                image = np.full((self.size[1], self.size[0], 3), number % 256, np.uint8)
                image = image if self.draw is None else self.draw(time.time())
                data = cv2.imencode(".jpg", image)[1].tobytes()
                data = data[: len(data) // 2] if self.broken else data
                self.sent.append(time.monotonic())
                connection.sendall(b"--frame\r\nContent-Type: image/jpeg\r\n\r\n" + data + b"\r\n")
                time.sleep(1 / self.rate)
        except OSError:
            return


SIDE = 24
# Of scripted pictures; the walker is at the right then.
WALL = 1_795_500_000.0


def walker(wall: float) -> np.ndarray:
    """A picture of 160 × 120: a white square that goes to the right in 2 s, and then back."""
    image = np.full((120, 160, 3), 30, np.uint8)
    left = round(8 + abs((wall % 4) - 2) / 2 * (160 - SIDE - 16))
    image[50 : 50 + SIDE, left : left + SIDE] = 255
    return image


def square(wall: float, width: int = 640, height: int = 480) -> np.ndarray:
    """A grey picture with a white square that goes over its width in 8 s by the clock, and back."""
    image = np.full((height, width, 3), 30, np.uint8)
    side = height // 6
    left = round(abs(wall % 16 - 8) / 8 * (width - side))
    image[height // 2 : height // 2 + side, left : left + side] = 255
    return image


class RtspServer:
    """`rtsp_server.py` in a process of its own: `square` as H.264.

    Raises `LookupError` where Debian's packages for it are missing.
    """

    def __init__(self, size: tuple[int, int] = (640, 480), rate: float = 25.0) -> None:
        with socket.create_server(("127.0.0.1", 0)) as one:
            self.port = one.getsockname()[1]
        self._words = [
            "/usr/bin/python3",
            str(Path(__file__).with_name("rtsp_server.py")),
            str(self.port),
        ]
        self._words += [str(size[0]), str(size[1]), str(rate)]
        self.url = f"rtsp://127.0.0.1:{self.port}/stream"
        self.restart()

    def restart(self) -> None:
        try:
            self._child = subprocess.Popen(
                self._words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        except FileNotFoundError as error:
            raise LookupError("there is no /usr/bin/python3") from error
        assert self._child.stdout is not None
        if self._child.stdout.readline() != "READY\n":
            self.kill()
            raise LookupError(
                "needs gir1.2-gst-rtsp-server-1.0, python3-gi,"
                " gstreamer1.0-plugins-{base,good,ugly}"
            )

    def say(self, command: str) -> None:
        """``rate 5``, ``size 320 240``, ``freeze`` or ``thaw``."""
        assert self._child.stdin is not None
        self._child.stdin.write(command + "\n")
        self._child.stdin.flush()

    def kill(self) -> None:
        self._child.kill()
        with self._child:
            pass


class HlsServer:
    """`square` in pieces of a second, made and served while it is not killed."""

    def __init__(
        self, folder: Path, size: tuple[int, int] = (640, 480), rate: float = 25.0
    ) -> None:
        self.size = size
        self.rate = rate
        self.frozen = False
        self._ended = False
        self._folder = folder
        self.port = 0
        self.restart()
        self._thread = threading.Thread(target=self._make, daemon=True)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self.port}/live.m3u8"

    def restart(self) -> None:
        handler = functools.partial(_Quiet, directory=str(self._folder))
        self._server = ThreadingHTTPServer(("127.0.0.1", self.port), handler)
        self.port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def kill(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def end(self) -> None:
        """Make no more pieces."""
        self._ended = True
        self._thread.join()

    def _make(self) -> None:
        options = {"hls_time": "1", "hls_list_size": "4", "hls_flags": "delete_segments"}
        with av.open(
            str(self._folder / "live.m3u8"), "w", format="hls", options=options
        ) as container:
            quick = {"preset": "ultrafast", "tune": "zerolatency", "g": "250"}
            stream = container.add_stream("libx264", rate=25, options=quick)
            stream.width, stream.height, stream.pix_fmt = *self.size, "yuv420p"
            stream.codec_context.time_base = Fraction(1, 1000)
            begun = time.time()
            key = 0.0
            while not self._ended:
                time.sleep(1 / self.rate)
                if not self.frozen:
                    frame = av.VideoFrame.from_ndarray(
                        square(time.time(), *self.size), format="bgr24"
                    )
                    frame.pts = round((time.time() - begun) * 1000)
                    frame.time_base = Fraction(1, 1000)
                    if time.time() - key >= 1:
                        # A piece begins.
                        key = time.time()
                        frame.pict_type = av.video.frame.PictureType.I
                    container.mux(stream.encode(frame))


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None: ...


class Scripted:
    """In place of `LiveSource`: ``rate`` pictures a second by their own times, each taken however
    long that takes.

    It is silent while it is ``frozen``, and after picture ``last``. Times since 1970 begin at
    ``wall``. ``through``: the last picture that is done with, since another one was asked for.
    """

    def __init__(self, last: float = math.inf, wall: float = WALL, rate: float = 20.0) -> None:
        self.last = last
        self.wall = wall
        self.rate = rate
        self.number = 0
        self.frozen = False
        self.through = 0
        self.dropped = 0
        self.connect = 10.0
        self._stopped = threading.Event()

    def start(self) -> None: ...

    def stop(self) -> None:
        self._stopped.set()

    def next(self, timeout: float) -> LiveFrame | None:
        self.through = self.number
        if self.frozen or self.number >= self.last:
            self._stopped.wait(timeout)
        if self._stopped.is_set() or self.frozen or self.number >= self.last:
            return None
        self.number += 1
        at = self.number / self.rate
        return LiveFrame(self.number, at, self.wall + at, walker(self.wall + at))

    def status(self) -> SourceStatus:
        return SourceStatus(
            "live",
            frames=self.number,
            dropped=self.dropped,
            fps=self.rate,
            width=160,
            height=120,
            sent=(160, 120),
        )


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def advance(self, seconds: float) -> None:
        self.now += seconds


def until(ready: Callable[[], object], patience: float = 600.0) -> None:
    """Wait: kernels may have to be compiled first, and others may need the machine."""
    end = time.monotonic() + patience
    while not ready():
        assert time.monotonic() < end
        time.sleep(0.02)
