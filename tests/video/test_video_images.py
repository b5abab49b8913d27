"""Folders and patterns of images."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from video_clips import picture

from phdtrack.errors import InputError
from phdtrack.video import open_source
from phdtrack.video.file_names import numbering


def save(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for index, name in enumerate(names):
        cv2.imwrite(str(folder / name), picture(index))


def test_folder_is_read_in_natural_order(tmp_path: Path) -> None:
    save(tmp_path / "walk", ["i1.png", "i2.png", "i10.png"])
    (tmp_path / "walk" / "notes.txt").write_text("not an image")
    source = open_source(tmp_path / "walk", fps=5)
    frames = list(source)
    assert [frame.number for frame in frames] == [1, 2, 10]
    np.testing.assert_allclose([frame.time for frame in frames], [0, 0.2, 1.8])
    assert all(np.array_equal(frame.image, picture(i)) for i, frame in enumerate(frames))
    assert (source.info.width, source.info.height, source.info.fps, source.info.frames) == (
        64,
        48,
        5,
        3,
    )
    assert (source.info.name, source.note, source.problem) == ("walk", "", "")


def test_image_samples_are_spread_over_the_sequence(tmp_path: Path) -> None:
    for k in range(1, 12):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((8, 8, 3), 20 * k, np.uint8))
    source = open_source(tmp_path)
    assert [(sample.number, int(sample.image[0, 0, 0])) for sample in source.sample(3)] == [
        (1, 20),
        (6, 120),
        (11, 220),
    ]
    assert len(list(source.sample(51))) == 11


def test_pattern_selects_files_and_assumed_rate_is_noted(tmp_path: Path) -> None:
    save(tmp_path / "SEQ-1" / "img1", ["a1.png", "a2.png", "b1.png"])
    source = open_source(tmp_path / "SEQ-1" / "img1")
    assert (source.info.name, source.info.fps) == ("SEQ-1", 25)
    assert "25 frames/s assumed" in source.note
    assert [frame.number for frame in open_source(str(tmp_path / "SEQ-1" / "img1" / "a*.png"))] == [
        1,
        2,
    ]
    with pytest.raises(InputError, match="no file matches"):
        open_source(str(tmp_path / "c*.png"))


@pytest.mark.parametrize(
    ("stems", "numbers"),
    [
        (["000001", "000002", "000004"], [1, 2, 4]),
        (["f000", "f010", "f020", "f040"], [1, 2, 3, 5]),
        (["cam2_7", "cam2_8"], [1, 2]),
        (["a", "b"], [1, 2]),
        (["1583929349000", "1583929349040", "1583929349079"], [1, 2, 3]),
    ],
)
def test_frame_numbers_come_from_file_names(stems: list[str], numbers: list[int]) -> None:
    assert numbering(stems).numbers == numbers


def test_unreadable_images_are_named(tmp_path: Path) -> None:
    save(tmp_path / "s", ["1.png", "2.png", "3.png"])
    (tmp_path / "s" / "2.png").write_text("no picture")
    with pytest.raises(InputError, match=r"2\.png: this is not a readable image"):
        list(open_source(tmp_path / "s"))
    cv2.imwrite(str(tmp_path / "s" / "2.png"), picture(0, 80, 48))
    with pytest.raises(
        InputError, match=r"2\.png, frame 2: this frame is 80x48 pixels, the first one 64x48"
    ):
        list(open_source(tmp_path / "s"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no image"):
        open_source(tmp_path / "empty")


def test_image_frames_are_chosen_by_number(tmp_path: Path) -> None:
    for k in (1, 2, 4, 5, 7):
        cv2.imwrite(str(tmp_path / f"{k:03d}.png"), np.full((8, 8, 3), k, np.uint8))
    found = list(open_source(tmp_path, fps=10, first=3, last=5))
    assert [(frame.number, frame.time, int(frame.image[0, 0, 0])) for frame in found] == [
        (4, 0.3, 4),
        (5, 0.4, 5),
    ]
