"""Live sources against a real server on loopback: time, drops, freezes, restarts, sizes, and that
nothing secret is said.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
from camera_server import CameraServer, Clock, HlsServer, RtspServer, until

from phdtrack.addresses import named, shown
from phdtrack.video import VideoWriter
from phdtrack.video import live_sources as sources
from phdtrack.video.live_sources import CATCH_UP, LONGEST_PAUSE, LiveFrame, LiveSource


@pytest.fixture
def server() -> Iterator[CameraServer]:
    server = CameraServer()
    yield server
    server.kill()


@pytest.fixture
def source(server: CameraServer) -> Iterator[LiveSource]:
    """With time-outs that no machine is too slow for."""
    source = LiveSource(server.url, connect=300.0, read=300.0)
    source.start()
    yield source
    source.stop()


def frames(source: LiveSource, count: int, patience: float = 600.0) -> list[LiveFrame]:
    """The next ``count`` frames."""
    found = list[LiveFrame]()
    end = time.monotonic() + patience
    while len(found) < count and time.monotonic() < end:
        frame = source.next(0.5)
        if frame is not None:
            found.append(frame)
    assert len(found) == count, source.status()
    return found


def waited(source: LiveSource, state: str) -> None:
    """Take pictures until the source is in a state."""

    def there() -> bool:
        source.next(0.05)
        return source.status().state == state

    until(there)


@pytest.mark.slow
def test_times_are_arrival_times_if_no_rate_is_stated(
    server: CameraServer, source: LiveSource
) -> None:
    """FFmpeg takes MJPEG for 25 pictures a second; here there are 10. No picture can be earlier
    than it was sent.
    """
    server.rate = 10.0
    (first,) = frames(source, 1)
    had = time.monotonic()
    for frame in frames(source, 15):
        assert server.sent[frame.number - 1] <= source.started + frame.time <= time.monotonic()
        assert frame.wall <= time.time()
    assert frame.image.shape == (120, 160, 3)
    assert frame.image.dtype == np.uint8
    server.kill()
    waited(source, "down")
    status = source.status()
    most = time.monotonic() - server.sent[0]
    least = server.sent[status.frames - 1] - had
    assert (status.frames - 1) / most <= status.fps <= (status.frames - 1) / least
    assert first.time < frame.time
    # So long no picture has come, however often it was tried again.
    down = time.monotonic()
    until(lambda: time.monotonic() > down + 3 * LONGEST_PAUSE)
    assert source.status().since >= 3 * LONGEST_PAUSE


@pytest.mark.slow
def test_who_is_slow_gets_the_newest_picture(source: LiveSource) -> None:
    (first,) = frames(source, 1)
    until(lambda: source.status().frames >= first.number + 10)
    (second,) = frames(source, 1)
    assert second.number >= first.number + 10
    # All those between the two, and none that was given.
    assert source.status().dropped >= second.number - first.number - 1
    # Brightness is the picture's number since the connection: it is the newest, not the next.
    assert int(second.image.mean()) == pytest.approx(second.number, abs=1)


@pytest.mark.slow
def test_a_camera_that_dies_is_found_again(server: CameraServer, source: LiveSource) -> None:
    last = frames(source, 2)[-1]
    for _ in range(3):
        server.kill()
        waited(source, "down")
        assert source.status().problem
        server.restart()
        waited(source, "live")
        now = frames(source, 2)[-1]
        assert now.number > last.number
        assert now.time > last.time
        last = now
    assert source.status().connects == 4


@pytest.mark.slow
def test_a_stream_of_which_no_picture_comes_is_tried_again(
    server: CameraServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its packets come in time, and nothing can be made of them."""
    monkeypatch.setattr(sources, "UNDECODED", 0.2)
    monkeypatch.setattr(sources, "GRACE", 0.1)
    server.broken = True
    source = LiveSource(server.url, connect=0.3, read=0.3)
    source.start()
    until(lambda: source.next(0.05) is None and len(server.asked) >= 3)
    assert source.status().undecodable > 0
    # Of a machine that is too slow for these time-outs nothing more can be asked.
    monkeypatch.setattr(sources, "GRACE", 300.0)
    server.broken = False
    frames(source, 1)
    source.stop()


def test_a_stream_faster_than_the_clock_is_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All its pictures look as if they had come while the connection was made."""
    clock = Clock()
    source = LiveSource("http://camera.example/stream", clock=clock)
    arrived = list[int]()

    def packets(stream: object) -> Iterator[SimpleNamespace]:
        for k in range(100):
            clock.advance(0.125)
            before = source.status().frames
            picture = SimpleNamespace(time=10.0 * k, width=64, height=48, rotation=0)
            yield SimpleNamespace(decode=lambda picture=picture: [picture])
            arrived.extend([k] * (source.status().frames - before))
        source.stop()

    stream = SimpleNamespace(thread_type="", frames=0, disposition=SimpleNamespace(value=0))
    container = SimpleNamespace(
        format=SimpleNamespace(name="mpegts"),
        streams=SimpleNamespace(video=[stream]),
        demux=packets,
    )
    opened = SimpleNamespace(
        open=lambda *_, **__: nullcontext(container), InvalidDataError=ValueError
    )
    monkeypatch.setattr(sources, "needed", lambda module: opened)
    source.start()
    until(source.stopped.is_set)
    # Eight a second; those of the first seconds are held back.
    assert arrived == list(range(round(8 * CATCH_UP) - 1, 100))


def place(frame: LiveFrame) -> int:
    """The left edge of the square of `square`."""
    return int(np.argmax(frame.image[frame.image.shape[0] // 2 + 20, :, 0] > 128))


@pytest.fixture
def gstreamer() -> Iterator[RtspServer]:
    try:
        server = RtspServer()
    except LookupError as error:
        pytest.skip(f"no RTSP server: {error}")
    yield server
    server.kill()


@pytest.mark.slow
def test_an_rtsp_camera_that_dies_freezes_and_changes_its_size(gstreamer: RtspServer) -> None:
    """On GStreamer's server, which is not ours."""
    server = gstreamer
    source = LiveSource(server.url, connect=300.0, read=300.0)
    source.start()
    first, *_, last = frames(source, 25)
    assert first.image.shape == (480, 640, 3)
    assert last.image[10, 10, 0] < 60 < 200 < last.image[290, place(last) + 40, 0]
    server.say("size 320 240")
    until(lambda: frames(source, 1) and source.status().sent == (320, 240))
    assert frames(source, 1)[0].image.shape == (480, 640, 3)
    server.say("freeze")
    waited(source, "silent")
    server.say("thaw")
    waited(source, "live")
    server.kill()
    waited(source, "down")
    server.restart()
    returned = time.monotonic()
    waited(source, "live")
    (after,) = frames(source, 1)
    assert after.time > returned - source.started > last.time
    assert source.status().connects == 2
    source.stop()


@pytest.mark.slow
def test_hls_is_played_at_the_pace_of_its_stamps_and_found_again(tmp_path: Path) -> None:
    server = HlsServer(tmp_path)
    until(lambda: (tmp_path / "live2.ts").exists())
    source = LiveSource(server.url, connect=300.0, read=300.0)
    source.start()
    found = frames(source, 40)
    assert all(a.time < b.time for a, b in pairwise(found))
    # The square's speed is right, however late the pieces were: 70 pixels a second; it turns at
    # most once.
    speeds = [
        abs(place(b) - place(a)) / (b.time - a.time)
        for a, b in zip(found[:-10], found[10:], strict=True)
    ]
    assert np.median(speeds) == pytest.approx(70, rel=0.05)
    server.kill()
    waited(source, "down")
    server.restart()
    waited(source, "live")
    assert frames(source, 1)[0].time > found[-1].time
    source.stop()
    server.kill()
    server.end()


@pytest.mark.slow
def test_whatever_a_source_raises_it_is_tried_again(
    server: CameraServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as broken:
        # A stream without pictures.
        container = SimpleNamespace(streams=SimpleNamespace(video=[]))
        broken.setattr(av, "open", lambda *_, **__: nullcontext(container))
        source = LiveSource(server.url)
        source.start()
        until(lambda: source.status().problem == "there is no video in it")
    waited(source, "live")
    source.stop()


@pytest.mark.slow
def test_it_is_tried_again_twice_a_second(server: CameraServer) -> None:
    """However long the camera is away, it is found within two seconds of its return."""
    server.kill()
    pauses = list[float]()

    class Hurried(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            pauses.append(timeout or 0.0)
            return super().wait(0.001)

    source = LiveSource(server.url, stopped=Hurried())
    source.start()
    until(lambda: len(pauses) > 30)
    source.stop()
    assert max(pauses) <= 0.5
    # And not without a pause.
    assert min(pauses) > 0.05
    assert min(pauses[10:]) > 0.3


@pytest.mark.slow
def test_a_camera_that_freezes_goes_on_where_time_is(
    server: CameraServer, source: LiveSource
) -> None:
    (before,) = frames(source, 1)
    server.frozen = True
    waited(source, "silent")
    thawed = time.monotonic()
    server.frozen = False
    after = before
    while server.sent[after.number - 1] < thawed:
        (after,) = frames(source, 1)
    assert after.time >= thawed - source.started > before.time + 1.0
    assert after.wall - before.wall > 0.9
    assert source.status().connects == 1


def test_a_camera_that_is_not_there_is_reported_once(capfd: pytest.CaptureFixture[str]) -> None:
    """OpenCV prints nothing beside it."""
    source = LiveSource("97", connect=0.5)
    source.start()
    waited(source, "down")
    assert source.status().problem == "camera 97 cannot be opened"
    source.stop()
    assert "VIDEOIO" not in capfd.readouterr().err


@pytest.mark.slow
def test_a_silent_server_is_left_and_tried_again(
    server: CameraServer,
) -> None:
    server.mute = True
    source = LiveSource(server.url, connect=0.7, read=0.7)
    source.start()
    waited(source, "down")
    assert source.status().problem == "no answer in time"
    server.mute = False
    source.connect = 300.0
    source.read = 300.0
    waited(source, "live")
    source.stop()


@pytest.mark.slow
def test_another_size_is_scaled_to_the_first(server: CameraServer, source: LiveSource) -> None:
    frames(source, 2)
    server.size = (320, 200)
    until(
        lambda: (
            frames(source, 1)[0].image.shape == (120, 160, 3) and source.status().sent == (320, 200)
        )
    )
    assert frames(source, 1)[0].image.shape == (120, 160, 3)


@pytest.mark.slow
def test_stopping_is_quick_whatever_the_camera_does(
    server: CameraServer, source: LiveSource
) -> None:
    frames(source, 1)
    server.frozen = True
    begun = time.monotonic()
    source.stop()
    # The time-outs of the source are five minutes; two seconds are asked for.
    assert source.next(300.0) is None
    assert time.monotonic() - begun < 20


@pytest.mark.slow
def test_a_file_is_played_at_its_own_pace_again_and_again(tmp_path: Path) -> None:
    path = tmp_path / "short.mp4"
    with VideoWriter(path, 64, 48, 10) as video:
        for k in range(8):
            video.write(np.full((48, 64, 3), 20 * k, np.uint8))
    source = LiveSource(str(path))
    source.start()
    found = list[LiveFrame]()
    while not found or found[-1].number < 12:
        found += frames(source, 1)
    source.stop()
    for frame in found:
        # Eight pictures are 0.7 s from the first to the last; a busy machine only makes them later.
        passes, place = divmod(frame.number - 1, 8)
        assert frame.time >= 0.7 * passes + 0.1 * place - 0.01
    assert source.status().connects >= 2


@pytest.mark.parametrize(
    ("text", "secret"),
    [
        ("rtsp://admin:hunter2@10.0.0.7:554/stream", "hunter2"),
        ("rtsp://admin:hun@ter2@10.0.0.7/stream", "ter2"),
        ("http://cam/video?token=hunter2&x=1", "hunter2"),
        ("http://cam/video?x=1&Password=hunter2", "hunter2"),
        ("cannot open http://u:hunter2@cam/: refused", "hunter2"),
        ("http://cam/?api_key=hunter2", "hunter2"),
    ],
)
def test_secrets_are_not_shown(text: str, secret: str) -> None:
    assert secret not in shown(text)
    assert "cam" in shown(text) or "10.0.0.7" in shown(text)
    assert secret not in named(text)


@pytest.mark.slow
def test_what_a_source_says_has_no_secrets(server: CameraServer) -> None:
    server.kill()
    source = LiveSource(server.url.replace("http://", "http://admin:hunter2@"), connect=0.5)
    source.start()
    waited(source, "down")
    assert "hunter2" not in repr(source.status())
    source.stop()


@pytest.mark.parametrize(
    ("address", "name"),
    [
        ("rtsp://u:p@10.0.0.7:554/cam/1", "10.0.0.7-554-cam-1"),
        ("0", "0"),
        ("street.mp4", "street.mp4"),
        ("///", "camera"),
    ],
)
def test_names_are_plain(address: str, name: str) -> None:
    assert named(address) == name
