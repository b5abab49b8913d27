"""Writing: what browsers need, odd sizes, rates, errors."""

import contextlib
import os
from pathlib import Path

import av
import numpy as np
import pytest
from video_clips import picture

from phdtrack.errors import InputError
from phdtrack.video import VideoWriter, open_source, writing
from phdtrack.video.writing import FAST, Coding


def test_written_video_plays_in_browsers(clip: Path) -> None:
    with av.open(str(clip)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
    data = clip.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="this system cannot confine a process to one core"
)
def test_output_does_not_depend_on_the_number_of_cores(tmp_path: Path) -> None:
    """A rendered scene is the same on every machine, and so is what is found in it."""
    cores = os.sched_getaffinity(0)
    seen = []
    for allowed in ({min(cores)}, cores):
        os.sched_setaffinity(0, allowed)
        try:
            with VideoWriter(tmp_path / "clip.mp4", 320, 240, 25.0) as out:
                for noise in np.random.default_rng(0).normal(0, 8, (60, 240, 320, 3)):
                    out.write((128 + noise).astype(np.uint8))
        finally:
            os.sched_setaffinity(0, cores)
        seen.append(np.array([frame.image for frame in open_source(tmp_path / "clip.mp4")]))
    # The encoder rounds a few pixels otherwise now and then.
    assert np.mean(seen[0] != seen[1]) < 0.02


@pytest.mark.parametrize("fps", [7.0, 29.97, 0.5, 12.5])
def test_odd_sizes_and_fractional_rates_are_written(tmp_path: Path, fps: float) -> None:
    path = tmp_path / "odd.mp4"
    with VideoWriter(path, 63, 47, fps) as out:
        for index in range(5):
            out.write(picture(index, 63, 47))
        assert out.frames == 5
    source = open_source(path)
    assert (source.info.width, source.info.height) == (64, 48)
    frames = list(source)
    assert source.info.fps == pytest.approx(fps)
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(5) / fps, atol=1e-3)
    assert np.abs(frames[2].image[:47, :63].astype(int) - picture(2, 63, 47)).mean() < 5


@pytest.mark.parametrize(("size", "threads"), [((64, 48), 1), ((2000, 1200), 2)])
def test_fast_settings_reach_the_encoder(
    tmp_path: Path, size: tuple[int, int], threads: int
) -> None:
    """It says of misspelled ones nothing; what it was told stands in the file."""
    with VideoWriter(tmp_path / "a.mp4", *size, 25, coding=FAST) as out:
        out.write(np.zeros((size[1], size[0], 3), np.uint8))
    told = (tmp_path / "a.mp4").read_bytes()
    words = (
        f" threads={threads} ",
        "sliced_threads=0",
        "bframes=0",
        "ref=1 ",
        "subme=0",
        "weightp=0",
        "mbtree=0",
    )
    assert [word for word in words if word.encode() not in told] == []


def test_planes_are_written_unchanged(tmp_path: Path) -> None:
    """What was decoded goes to the encoder without a way through BGR, twice in the same way."""
    with VideoWriter(tmp_path / "first.mp4", 64, 48, 25, coding=Coding(5)) as out:
        for index in range(20):
            out.write(picture(index))
    frames = [
        frame.picture.planes().reshape(72, 64) for frame in open_source(tmp_path / "first.mp4")
    ]
    for name in ("second", "third"):
        with VideoWriter(tmp_path / f"{name}.mp4", 64, 48, 25, coding=Coding(5, fast=True)) as out:
            for planes in frames:
                out.write(planes)
    assert (tmp_path / "second.mp4").read_bytes() == (tmp_path / "third.mp4").read_bytes()
    for frame, planes in zip(open_source(tmp_path / "second.mp4"), frames, strict=True):
        assert np.abs(frame.picture.planes().reshape(72, 64).astype(int) - planes).mean() < 2


def test_after_an_error_the_part_file_is_playable(tmp_path: Path) -> None:
    path = tmp_path / "half.mp4"
    with contextlib.suppress(RuntimeError), VideoWriter(path, 64, 48, 25) as out:
        for index in range(9):
            out.write(picture(index))
        raise RuntimeError
    assert not path.exists()
    part = tmp_path / "half.mp4.part"
    with pytest.raises(InputError, match="not complete"):
        open_source(part)
    assert len(list(open_source(part.rename(path)))) == 9


def test_images_of_another_size_are_rejected(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "x.mp4", 64, 48, 25) as out:
        for shape, kind in (
            ((48, 64), np.uint8),
            ((48, 66, 3), np.uint8),
            ((48, 64, 3), np.float32),
        ):
            with pytest.raises(InputError, match="frame 1: expected an image"):
                out.write(np.zeros(shape, kind))


def test_invalid_paths_sizes_and_rates_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        VideoWriter(tmp_path / "no" / "x.mp4", 64, 48, 25)
    for height, fps in ((0, 25), (48, 0)):
        with pytest.raises(InputError, match="above 0"):
            VideoWriter(tmp_path / "x.mp4", 64, height, fps)
    with VideoWriter(tmp_path / "x.mp4", 64, 48, 25) as out:
        pass  # nothing written is no error
    with pytest.raises(InputError, match="closed"):
        out.write(picture(1))


def test_missing_encoder_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "ENCODERS", ("no_such_encoder", "neither_this"))
    with pytest.raises(InputError, match=r"tried no_such_encoder, neither_this.*pip install"):
        VideoWriter(tmp_path / "x.mp4", 64, 48, 25)
