"""`--display` of track and live shows frames in a window, and says why if there can be none."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import phdtrack, refused

from phdtrack.opencv_package import cv2
from phdtrack.video import VideoWriter


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A video of 30 frames in which a dark box crosses a grey."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    with VideoWriter(path, 320, 240, 25.0) as writer:
        for k in range(1, 31):
            image = np.full((240, 320, 3), 128, np.uint8)
            image[60:120, 20 + 5 * k : 44 + 5 * k] = 30
            writer.write(image)
    return path


class Desktop:
    """Stands for the windows of OpenCV: what they show, and what the user presses."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, gui: str = "GTK3") -> None:
        self.shown = list[tuple[str, np.ndarray]]()
        self.key_at = (0, -1)
        self.closed_at = 0
        self.destroyed = list[str]()
        stand_ins: dict[str, Any] = {
            "getBuildInformation": lambda: f"General\n  GUI:                {gui}\n",
            "namedWindow": lambda title, flags: None,
            "resizeWindow": lambda title, width, height: None,
            "imshow": lambda title, image: self.shown.append((title, image.copy())),
            "waitKey": self.key,
            "getWindowProperty": lambda title, which: float(len(self.shown) != self.closed_at),
            "destroyWindow": self.destroyed.append,
        }
        for name, stand_in in stand_ins.items():
            getattr(cv2, name)
            monkeypatch.setattr(cv2, name, stand_in)
        monkeypatch.setenv("DISPLAY", ":7")

    def key(self, milliseconds: int) -> int:
        number, key = self.key_at
        return key if len(self.shown) == number else -1


@pytest.fixture
def desktop(monkeypatch: pytest.MonkeyPatch) -> Desktop:
    return Desktop(monkeypatch)


@pytest.mark.parametrize("more", [(), ("--set", "associate.output_delay=3")])
def test_track_shows_each_frame_once(
    clip: Path, tmp_path: Path, desktop: Desktop, more: tuple[str, ...]
) -> None:
    given = (clip, "--out", tmp_path / "run", *more)
    said = phdtrack("track", *given, "--display")
    assert said.status == 0, said.err
    assert len(desktop.shown) == (27 if more else 30)
    assert {title for title, _ in desktop.shown} == {"phdtrack"}
    last = desktop.shown[-1][1].astype(int)
    assert last.shape == (240, 320, 3)
    # The box in the colour of its identity, at the frame that it belongs to.
    coloured = np.ptp(last, axis=2) > 60
    x = np.nonzero(coloured[60:125])[1]
    assert abs(x.max() - (44 + 5 * (27 if more else 30))) < 8
    # Kept detections have no pictures.
    again = phdtrack("track", *given, "--overwrite", "--display")
    assert again.status == 0, again.err
    assert len(desktop.shown) == 2 * (27 if more else 30)


def test_q_ends_the_run_as_ctrl_c_does(clip: Path, tmp_path: Path, desktop: Desktop) -> None:
    desktop.key_at = (10, ord("q"))
    said = phdtrack("track", clip, "--out", tmp_path / "run", "--display")
    assert said.status == 130
    assert len(desktop.shown) == 10
    assert desktop.destroyed == ["phdtrack"]
    assert (tmp_path / "run" / "report.html").exists()


def test_a_closed_window_stays_closed(clip: Path, tmp_path: Path, desktop: Desktop) -> None:
    desktop.closed_at = 10
    said = phdtrack("track", clip, "--out", tmp_path / "run", "--display")
    assert said.status == 0, said.err
    assert len(desktop.shown) == 10


def test_count_shows_what_it_tracks(clip: Path, tmp_path: Path, desktop: Desktop) -> None:
    words = ("--line", "door=160,0,160,240", "--out", tmp_path / "run", "--display")
    said = phdtrack("count", clip, *words)
    assert said.status == 0, said.err
    assert len(desktop.shown) == 30
    sentence = refused("count", tmp_path / "run", *words[:2], "--display")
    assert "--display: the tracks come from" in sentence


def test_live_shows_a_window_for_each_camera(clip: Path, tmp_path: Path, desktop: Desktop) -> None:
    desktop.key_at = (5, 27)
    words = (f"gate={clip}", "--out", tmp_path / "live", "--no-page", "--duration", 60)
    said = phdtrack("live", *words, "--display")
    assert said.status == 0, said.err
    assert [title for title, _ in desktop.shown] == ["phdtrack gate"] * 5
    assert desktop.shown[0][1].shape == (240, 320, 3)


@pytest.mark.parametrize("command", ["track", "live"])
def test_an_opencv_without_windows_is_named(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    Desktop(monkeypatch, gui="NONE")
    sentence = refused(command, clip, "--out", tmp_path / "run", "--display")
    assert "this OpenCV has no windows: it is a headless package" in sentence
    assert "python -m pip install --force-reinstall opencv-python" in sentence
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have a desktop")
def test_a_machine_without_a_desktop_is_named(
    clip: Path, tmp_path: Path, desktop: Desktop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    sentence = refused("track", clip, "--out", tmp_path / "run", "--display")
    assert "there is no desktop" in sentence
    assert "phdtrack live, whose page shows the picture in a browser" in sentence


def test_detections_alone_have_nothing_to_show(tmp_path: Path, desktop: Desktop) -> None:
    file = tmp_path / "det.txt"
    file.write_text("1,-1,10,10,20,40,0.9\n2,-1,12,10,20,40,0.9\n")
    words = ("--detections", file, "--frame-size", "320x240", "--fps", 25)
    sentence = refused("track", *words, "--display")
    assert "there are no pictures to show" in sentence
