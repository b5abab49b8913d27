"""Cameras for tests: MJPEG over HTTP on loopback that can be frozen, killed, restarted, slowed down and resized; and a
source without a network, whose pictures and times are given, for what must not depend on how fast the machine is."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections.abc import Callable

import cv2
import numpy as np

from phdtrack.live.sources import LiveFrame, SourceStatus

HEAD = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"


class CameraServer:
    """Serves until `kill`; the pictures show their number as brightness.

    ``rate`` pictures a second of ``size`` (width, height). While ``frozen`` nothing is sent on any connection; while
    ``mute`` connections are accepted and nothing is said on them. ``broken`` pictures are cut in half. ``draw`` makes
    another picture (H, W, 3) of the seconds since 1970. ``sent``: when each picture began to be sent, on any connection
    (monotonic).
    """

    def __init__(self) -> None:
        self.rate, self.size = 20.0, (160, 120)
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


class Scripted:
    """In place of `LiveSource`: ``rate`` pictures a second by their own times, each taken however long that takes.

    It is silent while it is ``frozen``, and after picture ``last``. Times since 1970 begin at ``wall``. ``through``: the
    last picture that is done with, since another one was asked for.
    """

    def __init__(self, last: float = math.inf, wall: float = WALL, rate: float = 20.0) -> None:
        self.last, self.wall, self.rate, self.number, self.frozen = last, wall, rate, 0, False
        self.through, self.dropped, self.connect = 0, 0, 10.0
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
            "live", frames=self.number, dropped=self.dropped, fps=self.rate, width=160, height=120, sent=(160, 120)
        )


def until(ready: Callable[[], object], patience: float = 600.0) -> None:
    """Wait: kernels may have to be compiled first, and others may need the machine."""
    end = time.monotonic() + patience
    while not ready():
        assert time.monotonic() < end
        time.sleep(0.02)
