"""A recording that is to be shown turned is turned in every command."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from video_clips import picture

from phdtrack.video import VideoWriter, open_source
from phdtrack.video.live_sources import LiveSource
from phdtrack.video.writing import Coding

ONE = 0x10000
TURNS = {90: (0, ONE, -ONE, 0), 180: (-ONE, 0, 0, -ONE), 270: (0, -ONE, ONE, 0)}


def turned(path: Path, angle: int) -> Path:
    """An mp4 file with this angle in the header of its track, as phones write it."""
    with VideoWriter(path, 64, 48, 10, coding=Coding(5)) as video:
        for k in range(4):
            video.write(picture(k))
    data = bytearray(path.read_bytes())
    a, b, c, d = TURNS[angle]
    matrix = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 0x40000000)
    start = data.find(b"tkhd") + 44
    data[start : start + 36] = matrix
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("angle", TURNS)
def test_live_turns_a_picture_as_track_does(tmp_path: Path, angle: int) -> None:
    path = turned(tmp_path / "phone.mp4", angle)
    source = open_source(path)
    (first, *_) = list(source)
    upright = np.rot90(picture(0), -angle // 90)
    assert (source.info.height, source.info.width) == upright.shape[:2]
    assert np.abs(first.image.astype(int) - upright).mean() < 8
    live = LiveSource(str(path))
    live.start()
    frame = live.next(10.0)
    live.stop()
    assert frame is not None
    assert frame.image.shape == upright.shape
    assert live.status().sent == upright.shape[1::-1]
    at = (frame.number - 1) % 4
    expected = np.rot90(picture(at), -angle // 90)
    assert np.abs(frame.image.astype(int) - expected).mean() < 8
