"""Small clips, written by the tests themselves."""

from pathlib import Path

import pytest
from video_clips import picture

from phdtrack.video import VideoWriter


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """30 frames of 64x48 at 25 per second."""
    path = tmp_path / "clip.mp4"
    with VideoWriter(path, 64, 48, 25) as writer:
        for index in range(30):
            writer.write(picture(index))
    return path
