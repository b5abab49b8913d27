"""Video files: numbers, times, orientation, damage."""

import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from video_clips import encode, picture

from phdtrack.devices import Planar, planes_of
from phdtrack.errors import InputError
from phdtrack.types import Image
from phdtrack.video import VideoWriter, open_source
from phdtrack.video.decoding import Decoded


def test_written_clip_reads_back(clip: Path) -> None:
    source = open_source(clip)
    frames = list(source)
    assert (source.info.width, source.info.height, source.info.fps) == (64, 48, 25.0)
    assert [frame.number for frame in frames] == list(range(1, 31))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(30) / 25, atol=1e-9)
    assert (source.problem, source.note) == ("", "")
    assert np.abs(frames[7].image.astype(int) - picture(7)).mean() < 4
    assert all(np.array_equal(a.image, b.image) for a, b in zip(frames, source, strict=True))


def test_variable_rate_gives_true_times_unless_fps_is_given(tmp_path: Path) -> None:
    stamps = [500, 540, 600, 1000, 1040, 3000]
    encode(tmp_path / "vfr.mkv", [picture(i) for i in range(6)], stamps)
    times = [frame.time for frame in open_source(tmp_path / "vfr.mkv")]
    np.testing.assert_allclose(times, (np.array(stamps) - 500) / 1000, atol=1e-9)
    given = open_source(tmp_path / "vfr.mkv", fps=10)
    assert given.info.fps == 10
    np.testing.assert_allclose([frame.time for frame in given], np.arange(6) / 10)


def noise(count: int) -> list[Image]:
    rng = np.random.default_rng(1)
    return [np.repeat(rng.integers(0, 255, (48, 64, 1), np.uint8), 3, axis=2) for _ in range(count)]


def test_truncated_file_yields_its_frames(tmp_path: Path) -> None:
    whole = tmp_path / "whole.mp4"
    short = tmp_path / "short.mp4"
    with VideoWriter(whole, 64, 48, 25) as out:
        for image in noise(30):
            out.write(image)
    data = whole.read_bytes()
    short.write_bytes(data[: len(data) * 4 // 5])
    source = open_source(short)
    frames = list(source)
    assert 10 < len(frames) < 30
    assert re.search(rf"short\.mp4.*{len(frames)}", source.problem)


def test_damage_in_the_middle_loses_few_frames(tmp_path: Path) -> None:
    path = tmp_path / "noise.mkv"
    encode(path, noise(60), [40 * i for i in range(60)])
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 3000] = bytes(3000)
    path.write_bytes(bytes(data))
    source = open_source(path)
    numbers = [frame.number for frame in source]
    assert 20 < len(numbers) <= 60
    assert numbers == list(range(1, len(numbers) + 1))
    assert "noise.mkv: damaged after frame" in source.problem
    assert f"{len(numbers)} frames could be decoded" in source.problem


def test_missing_and_invalid_videos_are_named(clip: Path) -> None:
    with pytest.raises(InputError, match=r"no such file.*Did you mean .*clip\.mp4"):
        open_source(clip.with_name("clap.mp4"))
    with pytest.raises(InputError, match="in place of the number"):
        open_source(clip.with_name("%04d.png"))
    for fps in (-1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="rate"):
            open_source(clip, fps=fps)
    for content in (b"this is a text, not a film\n" * 20, b""):
        clip.write_bytes(content)
        with pytest.raises(InputError, match=r"clip\.mp4: .*cannot be read"):
            open_source(clip)


def test_unknown_codec_is_rejected(clip: Path) -> None:
    clip.write_bytes(clip.read_bytes().replace(b"avc1", b"zzzz"))
    with pytest.raises(InputError, match=r"no decoder .*convert it"):
        open_source(clip)


def test_video_samples_are_spread_over_the_file(tmp_path: Path) -> None:
    # This encoder makes a picture that can be decoded alone every twelve frames.
    encode(tmp_path / "long.mkv", [picture(i) for i in range(120)], [40 * i for i in range(120)])
    source = open_source(tmp_path / "long.mkv")
    frames = {frame.time: frame.image for frame in source}
    samples = list(source.sample(5))
    times = [sample.time for sample in samples]
    np.testing.assert_allclose(times, np.array([12, 36, 60, 84, 108]) * 0.04, atol=0.5)
    for sample in samples:
        np.testing.assert_array_equal(sample.image, frames[sample.time])
    # There are not so many places to jump to: the caller is told by their number.
    assert len(list(source.sample(50))) < 50


def portrait(clip: Path, path: Path) -> Path:
    """The same clip as a telephone that is held upright marks it."""
    plain = b"".join(n.to_bytes(4, "big") for n in (0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000))
    turned = b"".join(
        n.to_bytes(4, "big") for n in (0, 0x10000, 0, 0xFFFF0000, 0, 0, 0, 0, 0x40000000)
    )
    data = clip.read_bytes()
    track = data.index(b"tkhd")
    at = data.index(plain, track)
    path.write_bytes(data[:at] + turned + data[at + len(plain) :])
    return path


def test_portrait_recordings_are_rotated(clip: Path, tmp_path: Path) -> None:
    source = open_source(portrait(clip, tmp_path / "portrait.mp4"))
    assert (source.info.width, source.info.height) == (48, 64)
    upright = next(iter(source)).image
    flat = next(iter(open_source(clip))).image
    # The matrix turns the picture clockwise by a quarter: its left edge comes up.
    np.testing.assert_array_equal(upright, np.rot90(flat, -1))


@pytest.mark.data
def test_caviar_is_counted_by_decoding(data: Path) -> None:
    source = open_source(data / "caviar" / "OneLeaveShop1cor.mpg")
    times = [frame.time for frame in source]
    assert len(times) == 295
    assert min(np.diff(times)) > 0
    assert source.problem == ""
    assert source.info.fps == 25


@pytest.mark.parametrize("turned", [False, True])
def test_small_pictures_are_converted_from_decoded_ones(
    clip: Path, tmp_path: Path, turned: bool
) -> None:
    """In the size asked for, the mean of what each pixel covers, also as planes, turned as the
    picture is.
    """
    source = open_source(portrait(clip, tmp_path / "turned.mp4") if turned else clip)
    frame = next(iter(source))
    wide, high = frame.picture.size
    assert frame.image.shape == (high, wide, 3)
    for size in ((wide, high), (wide // 2, high // 2), (wide // 2 - 1, high // 2 - 1)):
        expected = cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA)
        for planes in (frame.picture.planes(size), planes_of(frame.image, size)):
            assert len(planes) == size[0] * size[1] + 2 * ((size[0] + 1) // 2) * (
                (size[1] + 1) // 2
            )
            found = Planar(size, planes).bgr()
            assert found.shape == expected.shape
            assert np.abs(found.astype(int) - expected).mean() < 4
    assert len(list(source)) == 30
    assert 0.5 < source.share <= 1


@pytest.mark.parametrize(
    "kind", ["yuv420p", "yuvj420p", "yuv420p10le", "yuv422p", "yuv444p", "nv12", "gray", "full"]
)
def test_planes_are_the_same_for_all_pictures(kind: str) -> None:
    # Red grows to the right and downwards, green less, blue not.
    ramp = np.add.outer(np.arange(33), np.arange(21))[..., None] * (
        (1, 1, 1) if kind == "gray" else (0, 0.5, 1)
    )
    image = (3 * ramp + 40).astype(np.uint8)
    whole = av.VideoFrame.from_ndarray(image, format="bgr24")
    full = kind == "full"
    made = whole.reformat(
        format="yuv420p" if full else kind, dst_color_range="JPEG" if full else None
    )
    made.color_range = 2 if full or kind == "yuvj420p" else 1
    for size in (None, (10, 16)):
        found = Decoded(made).planes(size).astype(int)
        expected = planes_of(image, size).astype(int)
        assert found.shape == expected.shape
        assert np.abs(found - expected).mean() < 1.5
        assert abs((found - expected).mean()) < 1


@pytest.mark.parametrize("asked", [(20, 12), (40, 24), None])
def test_prepared_planes_equal_requested_ones(
    asked: tuple[int, int] | None,
) -> None:
    image = np.random.default_rng(0).integers(0, 256, (24, 40, 3), dtype=np.uint8)
    frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format="yuv420p")
    picture = Decoded(frame)
    other = Decoded(frame)
    for size in ((20, 12), (40, 24)):
        picture.prepare(size)
        first = picture.planes(asked)
        np.testing.assert_array_equal(first, other.planes(asked))
        # They may be written into: who asks again gets others.
        first[:] = 0
        np.testing.assert_array_equal(picture.planes(asked), other.planes(asked))


def coded(path: Path, count: int = 90, *, jump: bool = False) -> Path:
    """H.264 with pictures between others that they are decoded from, a key every 12, and intervals
    that vary; with a ``jump`` its stamps begin anew in the middle, as where recordings are
    joined."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            "libx264",
            rate=25,
            options={"g": "12", "bf": "3", "x264-params": "keyint=12:open-gop=1"},
        )
        stream.width = 64
        stream.height = 48
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        moment = 400
        for k in range(count):
            frame = av.VideoFrame.from_ndarray(picture(k), format="bgr24")
            moment += (40, 40, 80)[k % 3]
            frame.pts = moment
            frame.time_base = Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    if jump:
        path.write_bytes(path.read_bytes() * 2)
    return path


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "a.h264", "jump.ts"])
@pytest.mark.parametrize("given", [0.0, 10.0])
def test_chosen_frames_equal_those_of_the_whole_file(
    name: str, given: float, tmp_path: Path
) -> None:
    """Whether it can jump to them (mp4, mkv), or not (a stream without stamps, or with stamps that
    begin anew).
    """
    path = coded(tmp_path / name, jump=name == "jump.ts")
    whole = list(open_source(path, fps=given))
    for first, last in ((1, 5), (2, 2), (12, 14), (47, 60), (len(whole) - 1, 0)):
        found = list(open_source(path, fps=given, first=first, last=last))
        wanted = whole[first - 1 : last or None]
        assert [frame.number for frame in found] == [frame.number for frame in wanted]
        np.testing.assert_allclose(
            [frame.time for frame in found], [frame.time for frame in wanted], atol=1e-9
        )
        assert all(np.array_equal(a.image, b.image) for a, b in zip(found, wanted, strict=True))
    late = open_source(path, fps=given, first=len(whole) + 5)
    assert not list(late)
    assert late.problem == f"there is no frame {len(whole) + 5}: the last one is {len(whole)}"
    # The scene is learned from the whole file, whatever is tracked.
    assert next(iter(replace(open_source(path, first=40), first=1))).number == 1


def test_first_frame_is_reached_by_seeking(tmp_path: Path) -> None:
    source = open_source(coded(tmp_path / "a.mkv", 400), first=350, last=360)
    read = source.read
    numbers = [number for number, *_ in read(source)]
    assert numbers[0] == 350
    assert len(list(source)) == 11
