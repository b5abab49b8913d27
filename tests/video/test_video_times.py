"""The times of videos: what files state, what their stamps say, and what is written."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from video_clips import encode, picture

from phdtrack.video import VideoWriter, open_source
from phdtrack.video.writing import FAST

VARIABLE = [*(33 * k for k in range(30)), *(1000 + 200 * k for k in range(20))]
PAUSE = [*(40 * k for k in range(30)), *(21_160 + 40 * k for k in range(30))]
WRONG = [40 * k for k in range(60)]
WRONG[25] = 3_000_000
WRONG[40] = 5_000_000


def stream(path: Path, stamps: list[int], *, codec: str = "mpeg4", unit: int = 1000) -> Path:
    """A file of the kind of its name with a picture at each of these stamps in 1/``unit`` s."""
    with av.open(str(path), "w") as container:
        video = container.add_stream(codec)
        video.width = 64
        video.height = 48
        video.pix_fmt = "yuv420p"
        video.codec_context.time_base = Fraction(1, unit)
        for k, stamp in enumerate(stamps):
            frame = av.VideoFrame.from_ndarray(picture(k), format="bgr24")
            frame.pts = stamp
            frame.time_base = Fraction(1, unit)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    return path


def of_browser(path: Path, stamps: list[int]) -> Path:
    """WebM as browsers record it: neither a duration nor one of a frame; stamps in ms."""
    with av.open(str(path), "w", format="webm", options={"live": "1"}) as container:
        options = {"deadline": "realtime", "cpu-used": "8"}
        video = container.add_stream("libvpx", options=options)
        video.width = 64
        video.height = 48
        video.pix_fmt = "yuv420p"
        video.codec_context.time_base = Fraction(1, 1000)
        for k, stamp in enumerate(stamps):
            frame = av.VideoFrame.from_ndarray(picture(k), format="bgr24")
            frame.pts = stamp
            frame.time_base = Fraction(1, 1000)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    data = bytearray(path.read_bytes())
    # Its DefaultDuration becomes a void of the same length.
    at = data.find(b"\x23\xe3\x83")
    if at >= 0:
        size = 4 + (data[at + 3] & 0x7F)
        data[at : at + size] = bytes([0xEC, 0x80 | (size - 2), *[0] * (size - 2)])
        path.write_bytes(data)
    return path


@pytest.mark.parametrize("each", [33, 100, 8])
def test_rate_of_a_webm_without_durations(tmp_path: Path, each: int) -> None:
    jitter = np.random.default_rng(1).integers(-1, 2, 150)
    stamps = (each * np.arange(150) + jitter - jitter[0]).tolist()
    source = open_source(of_browser(tmp_path / "rec.webm", stamps))
    assert source.info.fps == pytest.approx(1000 / each, rel=0.03)
    np.testing.assert_allclose([one.time for one in source], np.array(stamps) / 1000, atol=1e-9)


def test_stated_rates_that_fit_are_kept(tmp_path: Path) -> None:
    encode(tmp_path / "a.mkv", [picture(k) for k in range(50)], [40 * k for k in range(50)])
    assert open_source(tmp_path / "a.mkv").info.fps == 25
    varied = open_source(stream(tmp_path / "v.mp4", VARIABLE))
    assert varied.note == ""
    assert 50 / 5 < varied.info.fps < 50 / 4


@pytest.mark.parametrize("name", ["a.ts", "a.mkv", "a.mp4"])
@pytest.mark.parametrize("begin", [1.4, 3600.0])
def test_time_is_zero_at_the_first_frame(tmp_path: Path, name: str, begin: float) -> None:
    stamps = [round(90_000 * (begin + 0.05 * k)) for k in range(40)]
    source = open_source(stream(tmp_path / name, stamps, codec="libx264", unit=90_000))
    np.testing.assert_allclose([one.time for one in source], 0.05 * np.arange(40), atol=2e-3)
    assert max((one.time for one in source.sample(3)), default=0) < 2


@pytest.mark.parametrize("stamps", [VARIABLE, PAUSE], ids=["variable", "pause"])
@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_variable_times_and_their_clock(tmp_path: Path, name: str, stamps: list[int]) -> None:
    source = open_source(stream(tmp_path / name, stamps))
    found = [one.time for one in source]
    np.testing.assert_allclose(found, np.array(stamps) / 1000, atol=1e-3)
    np.testing.assert_array_equal(source.clock().times(range(1, len(stamps) + 1)), found)
    assert source.problem == ""


@pytest.mark.parametrize("name", ["a.mkv", "a.mp4"])
def test_stamps_far_ahead_are_told_and_not_used(tmp_path: Path, name: str) -> None:
    """Two single stamps, 50 and 83 minutes ahead of those around them."""
    path = tmp_path / name
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", rate=25)
        video.width = 64
        video.height = 48
        video.pix_fmt = "yuv420p"
        video.codec_context.time_base = Fraction(1, 1000)
        unordered = dict[int, int]()
        for k, stamp in enumerate(WRONG):
            frame = av.VideoFrame.from_ndarray(picture(k), format="bgr24")
            frame.pts = 40 * k
            frame.time_base = Fraction(1, 1000)
            unordered[40 * k] = stamp
            for packet in video.encode(frame):
                # Decoding times stay in order, as files need it.
                assert packet.pts is not None
                packet.pts = unordered[packet.pts]
                container.mux(packet)
    source = open_source(path)
    frames = list(source)
    np.testing.assert_allclose([one.time for one in frames], 0.04 * np.arange(60), atol=1e-3)
    assert source.info.fps == pytest.approx(25, rel=0.03)
    assert "2 frames have time stamps that cannot be right" in source.note
    assert "frame 26: 3000.000 s" in source.note
    assert source.problem == ""
    np.testing.assert_array_equal(source.clock().times(range(1, 61)), [one.time for one in frames])
    part = list(replace(source, first=20, last=45))
    assert [one.number for one in part] == list(range(20, 46))
    np.testing.assert_allclose([one.time for one in part], [one.time for one in frames[19:45]])


@pytest.mark.parametrize("codec", ["mpeg4", "libx264"])
def test_avi_knows_the_order_of_decoding_only(tmp_path: Path, codec: str) -> None:
    """With pictures that are predicted from later ones, also if it begins at a later frame."""
    path = tmp_path / "a.avi"
    with av.open(str(path), "w") as container:
        video = container.add_stream(codec, rate=25, options={"bf": "2", "g": "12"})
        video.width = 64
        video.height = 48
        video.pix_fmt = "yuv420p"
        for k in range(60):
            frame = av.VideoFrame.from_ndarray(picture(k), format="bgr24")
            frame.pts = k
            frame.time_base = Fraction(1, 25)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    source = open_source(path)
    whole = list(source)
    np.testing.assert_allclose([one.time for one in whole], 0.04 * np.arange(60), atol=1e-9)
    np.testing.assert_allclose(source.clock().times(range(1, 61)), 0.04 * np.arange(60), atol=1e-9)
    assert (source.note, source.problem) == ("", "")
    for first in (2, 15, 38):
        part = next(iter(replace(source, first=first)))
        assert part.time == pytest.approx(whole[first - 1].time)
        np.testing.assert_array_equal(part.image, whole[first - 1].image)


@pytest.mark.parametrize("stamps", [VARIABLE, PAUSE], ids=["variable", "pause"])
def test_written_times_are_those_of_the_source(tmp_path: Path, stamps: list[int]) -> None:
    seconds = 7.0 + np.array(stamps) / 1000
    with VideoWriter(tmp_path / "out.mp4", 64, 48, 8.4412, coding=FAST) as out:
        for k, at in enumerate(seconds.tolist()):
            out.write(picture(k), at)
    times = [one.time for one in open_source(tmp_path / "out.mp4")]
    np.testing.assert_allclose(times, seconds - 7.0, atol=5e-5)


def test_pauses_of_days_can_be_written(tmp_path: Path) -> None:
    times = [0.0, 0.04, 200_000.0, 200_000.04, 200_000.08]
    with VideoWriter(tmp_path / "out.mp4", 64, 48, 25) as out:
        for k, at in enumerate(times):
            out.write(picture(k), at)
    found = [one.time for one in open_source(tmp_path / "out.mp4")]
    np.testing.assert_allclose(np.diff(found)[[0, 2, 3]], 0.04, atol=1e-4)
    assert 10_000 < found[2] < 200_000


@pytest.mark.parametrize("fps", [25.0, 29.97, 24000 / 1001, 12.5, 0.1, 1 / 3600])
def test_constant_rates_stay_exact(tmp_path: Path, fps: float) -> None:
    for name, own in (("rate", False), ("times", True)):
        with VideoWriter(tmp_path / f"{name}.mp4", 64, 48, fps, coding=FAST) as out:
            for k in range(12):
                out.write(picture(k), *([k / fps] if own else []))
        source = open_source(tmp_path / f"{name}.mp4")
        assert source.info.fps == pytest.approx(fps, rel=1e-4)
        times = [one.time for one in source]
        np.testing.assert_allclose(times, np.arange(12) / fps, rtol=1e-4, atol=1e-4)
        assert source.announced == 12


def test_pixels_that_are_not_square_are_kept(tmp_path: Path) -> None:
    for aspect in (Fraction(16, 11), Fraction(10, 11), Fraction(1)):
        path = tmp_path / "wide.mp4"
        with VideoWriter(path, 64, 48, 25, pixel_aspect=float(aspect)) as out:
            for k in range(5):
                out.write(picture(k))
        assert open_source(path).info.pixel_aspect == pytest.approx(float(aspect))
        with av.open(str(path)) as container:
            assert (container.streams.video[0].sample_aspect_ratio or 1) == aspect
