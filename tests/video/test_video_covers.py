"""Covers and thumbnails are not the video."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from video_clips import picture

from phdtrack.errors import InputError
from phdtrack.video import open_source
from phdtrack.video.live_sources import LiveSource


def box(kind: bytes, content: bytes) -> bytes:
    """A box of an mp4 file."""
    return struct.pack(">I4s", len(content) + 8, kind) + content


def with_cover(path: Path) -> Path:
    """Put a cover of 300x300 pixels before the tracks of an mp4 file, as taggers do."""
    image = np.full((300, 300, 3), (40, 160, 220), np.uint8)
    picture_box = box(b"data", struct.pack(">II", 13, 0) + cv2.imencode(".jpg", image)[1].tobytes())
    handler = box(b"hdlr", bytes(8) + b"mdirappl" + bytes(9))
    metadata = bytes(4) + handler + box(b"ilst", box(b"covr", picture_box))
    data = path.read_bytes()
    start = data.find(b"moov") - 4
    (size,) = struct.unpack(">I", data[start : start + 4])
    assert start > data.find(b"mdat"), "the offsets of the pictures stay"
    cover = box(b"udta", box(b"meta", metadata))
    head = struct.pack(">I4s", size + len(cover), b"moov")
    out = path.with_name(f"cover-{path.name}")
    out.write_bytes(data[:start] + head + cover + data[start + 8 :])
    return out


def encoded(
    path: Path, *, audio: bool = False, video: bool = True, thumbnail: bool = False
) -> Path:
    """A file of ten pictures of 64x48, a sound, or a thumbnail of 300x300 in front of both."""
    with av.open(str(path), "w") as container:
        streams = list[tuple[av.VideoStream, int, tuple[int, int]]]()
        if thumbnail:
            streams.append((container.add_stream("mjpeg", rate=10), 1, (300, 300)))
        if video:
            streams.append((container.add_stream("mpeg4", rate=10), 10, (64, 48)))
        for stream, _, (width, height) in streams:
            stream.width, stream.height = width, height
            stream.pix_fmt = "yuvj420p" if stream.codec_context.name == "mjpeg" else "yuv420p"
        if audio:
            sound = container.add_stream("aac", rate=8000)
            silence = av.AudioFrame.from_ndarray(np.zeros((1, 2048), np.float32), "fltp", "mono")
            silence.sample_rate = 8000
            container.mux(sound.encode(silence))
            container.mux(sound.encode(None))
        for stream, count, (width, height) in streams:
            for k in range(count):
                frame = av.VideoFrame.from_ndarray(picture(k, width, height), format="bgr24")
                frame.pts = k
                frame.time_base = Fraction(1, 10)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize("kind", ["mp4", "m4v", "mov"])
def test_a_cover_is_not_the_video(tmp_path: Path, kind: str) -> None:
    source = open_source(with_cover(encoded(tmp_path / f"clip.{kind}")))
    assert (source.info.width, source.info.height, source.info.fps) == (64, 48, 10)
    assert [frame.number for frame in source] == list(range(1, 11))


@pytest.mark.parametrize("kind", ["mp4", "mov"])
def test_a_thumbnail_without_a_mark_is_not_the_video(tmp_path: Path, kind: str) -> None:
    source = open_source(encoded(tmp_path / f"clip.{kind}", thumbnail=True))
    assert (source.info.width, source.info.height) == (64, 48)
    assert len(list(source)) == 10


def test_a_single_picture_alone_is_read(tmp_path: Path) -> None:
    source = open_source(encoded(tmp_path / "one.mov", video=False, thumbnail=True))
    assert (source.info.width, len(list(source))) == (300, 1)


def test_a_song_is_no_video(tmp_path: Path) -> None:
    song = encoded(tmp_path / "song.m4a", audio=True, video=False)
    with pytest.raises(InputError, match="there is no video in this file"):
        open_source(song)
    with pytest.raises(InputError, match="only a picture such as a cover"):
        open_source(with_cover(song))


@pytest.mark.slow
def test_a_cover_is_not_the_live_picture(tmp_path: Path) -> None:
    source = LiveSource(str(with_cover(encoded(tmp_path / "clip.mp4"))))
    source.start()
    frame = source.next(10.0)
    source.stop()
    assert frame is not None
    assert frame.image.shape == (48, 64, 3)
