"""Numbers in names of image files: frames, times, or only an order."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from video_clips import picture

from experiments.fuzz_names import make_names
from phdtrack.errors import InputError
from phdtrack.video import VideoWriter, open_source
from phdtrack.video.file_names import numbering


@pytest.mark.parametrize(
    ("stems", "times"),
    [
        (["20241128111015", "20241128111016", "20241128111019"], [0, 1, 4]),
        (["20241128_235959", "20241129_000001"], [0, 2]),
        (["cam1_2024-11-28T11-10-15.040_x", "cam1_2024-11-28T11-10-15.080_x"], [0, 0.04]),
        (
            ["10.0.0.7_01_20241128111015123_MOTION", "10.0.0.7_01_20241128111015623_MOTION"],
            [0, 0.5],
        ),
        (["1305031102.175304", "1305031102.211214"], [0, 0.03591]),
        (["1583929349000", "1583929349040", "1583929349079"], [0, 0.04, 0.079]),
        (["1403636579763555584", "1403636579813555456"], [0, 0.049999872]),
        (["1732792215", "1732792216", "1732792218"], [0, 1, 3]),
    ],
)
def test_clocks_are_times(stems: list[str], times: list[float]) -> None:
    found = numbering(stems)
    np.testing.assert_allclose(found.times, times, atol=1e-12)
    assert found.numbers == list(range(1, len(stems) + 1))
    assert "are times" in found.note


@pytest.mark.parametrize(
    "stems",
    [
        # Constant clocks, clocks that cannot be, counters of ten digits.
        ["20241128_111015_0001", "20241128_111015_0002", "20241128_111015_0003"],
        ["20241128111015_1", "20241128111015_2", "20241128111016_3"],
        ["20249928111015", "20249928111016", "20249928111017"],
        ["0000000001", "0000000002", "0000000003"],
        ["20241128_0001", "20241128_0002", "20241128_0003"],
        ["frame1_640x480", "frame2_640x480", "frame3_640x480"],
    ],
)
def test_consecutive_numbers_are_frames(stems: list[str]) -> None:
    found = numbering(stems)
    assert (found.numbers, found.times, found.note) == ([1, 2, 3], [], "")


@pytest.mark.parametrize(
    ("stems", "numbers", "words"),
    [
        (["a", "b"], [1, 2], "have no numbers"),
        (["1", "b"], [1, 2], "have no numbers"),
        (["a1", "a2", "b1"], [1, 2, 3], "do not increase"),
        (["1_left", "1_right"], [1, 2], "do not increase"),
        (["7", "812", "99999"], [1, 2, 3], "far from each other"),
        (["1", "2", "4", "5001", "5002"], [1, 2, 4, 5, 6], "jump from 4 to 5001"),
        (["0", "10", "20", "70003", "70013", "90000", "90010"], [1, 2, 3, 4, 5, 6, 7], "1 more"),
    ],
)
def test_other_names_are_an_order(stems: list[str], numbers: list[int], words: str) -> None:
    found = numbering(stems)
    assert (found.numbers, found.times) == (numbers, [])
    assert words in found.note


def save(folder: Path, *names: str) -> Path:
    """Small pictures of these names."""
    folder.mkdir(exist_ok=True)
    for index, name in enumerate(names):
        cv2.imwrite(str(folder / name), picture(index))
    return folder


def test_a_sequence_has_the_times_of_its_names(tmp_path: Path) -> None:
    folder = save(tmp_path / "s", *(f"202411281110{k:02d}.png" for k in (15, 17, 19, 29)))
    source = open_source(folder)
    assert source.info.fps == 0.5
    assert [frame.time for frame in source] == [0, 2, 4, 14]
    assert "are times" in source.note
    assert "assumed" not in source.note
    given = open_source(folder, fps=10)
    assert (given.info.fps, given.note) == (10, "")
    np.testing.assert_allclose([frame.time for frame in given], [0, 0.1, 0.2, 0.3])


def test_hidden_files_are_no_pictures(tmp_path: Path) -> None:
    folder = save(tmp_path / "s", "1.png", "2.png")
    for name in ("._1.png", ".3.png", "Thumbs.db"):
        (folder / name).write_bytes(b"not a picture")
    (folder / "4.png").mkdir()
    assert len(list(open_source(folder))) == 2


def test_a_thumbnail_makes_no_sequence_of_videos(tmp_path: Path) -> None:
    folder = save(tmp_path / "s", "thumb.png")
    for name in ("a.mp4", "b.mp4"):
        with VideoWriter(folder / name, 64, 48, 10) as video:
            video.write(picture(1))
    with pytest.raises(InputError, match=r"folder of images, got one with videos .*batch"):
        open_source(folder)
    save(folder, *(f"{k:04d}.png" for k in range(12)))
    assert open_source(folder).info.frames == 13


def test_animated_webp_is_named(tmp_path: Path) -> None:
    head = b"WEBPVP8X" + struct.pack("<I", 10) + bytes([2]) + bytes(9)
    path = tmp_path / "a.webp"
    path.write_bytes(b"RIFF" + struct.pack("<I", len(head)) + head)
    with pytest.raises(InputError, match="this is an animated WebP, which FFmpeg cannot decode"):
        open_source(path)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("b.webp",), "b.webp is animated: of such files only the first picture is read"),
        (("b.webp", "d.webp", "e.webp"), "b.webp and 2 more are animated"),
    ],
)
def test_animated_webp_among_images_is_told(
    tmp_path: Path, names: tuple[str, ...], words: str
) -> None:
    still = cv2.imencode(".webp", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    head = b"WEBPVP8X" + struct.pack("<I", 10) + bytes([2]) + bytes(9)
    for name in ("a.webp", "c.webp", "f.webp"):
        (tmp_path / name).write_bytes(still)
    assert "animated" not in open_source(tmp_path).note
    for name in names:
        (tmp_path / name).write_bytes(b"RIFF" + struct.pack("<I", len(head)) + head)
    assert words in open_source(tmp_path).note


def test_any_names_have_increasing_numbers() -> None:
    rng = random.Random(5)
    for _ in range(2000):
        found = numbering(make_names(rng))
        steps = np.diff(found.times or found.numbers)
        assert found.numbers[0] == 1
        assert np.all(steps > 0)
        assert np.all(np.diff(found.numbers) > 0)
        assert np.isfinite(found.rate)
