"""Files with several video streams: every command reads the same one, and reports which."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from cli_runner import phdtrack

from phdtrack.cli.output import Output
from phdtrack.label.sequences import open_sequence
from phdtrack.run.requests import SourceRequest
from phdtrack.video import open_source

FRAMES = 12
WORDS = "has 2 video streams (64x48, 96x80), and the first of them is read"


def two_streams(path: Path) -> Path:
    """A grey video of 64x48 pixels at 10 frames a second, and a white one of 96x80."""
    with av.open(str(path), "w") as container:
        streams = []
        for width, height in ((64, 48), (96, 80)):
            stream = container.add_stream("mpeg4", rate=10)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            streams.append(stream)
        for k in range(FRAMES):
            for shade, stream in zip((90, 255), streams, strict=True):
                image = np.full((stream.height, stream.width, 3), shade, np.uint8)
                frame = av.VideoFrame.from_ndarray(image, format="bgr24")
                frame.pts = k
                frame.time_base = Fraction(1, 10)
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize("kind", ["mkv", "mp4", "ts"])
def test_which_of_several_streams_is_read_is_told(tmp_path: Path, kind: str) -> None:
    source = open_source(two_streams(tmp_path / f"two.{kind}"))
    assert WORDS in source.note
    images = [frame.image for frame in source]
    assert {image.shape for image in images} == {(48, 64, 3)}
    assert len(images) == FRAMES
    assert max(image.max() for image in images) < 120
    assert WORDS in source.note


@pytest.mark.usefixtures("batch_here")
def test_every_command_tells_which_stream_it_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    video = two_streams(tmp_path / "two.mkv")
    boxes = tmp_path / "det.txt"
    rows = [f"{k},-1,{5 + k},10,12,20,0.9,-1,-1,-1" for k in range(1, FRAMES + 1)]
    boxes.write_text("\n".join(rows))
    line = ("--line", "gate=20,0,20,47")
    run = ("--out", "run", "--no-video")
    for words in (
        ("track", video, "--detections", boxes, *run),
        ("detect", video, "--out", "boxes.csv"),
        ("count", video, "--detections", boxes, *line, "--out", "counted"),
        ("count", "run", *line),
        ("batch", video, "--out", "many"),
    ):
        said = phdtrack(*words)
        assert said.status == 0, said
        assert said.err.count(WORDS) == 1, said
    found = json.loads(Path("run/run.json").read_text())["source"]
    assert (found["width"], found["height"]) == (64, 48)
    capsys.readouterr()
    source = SourceRequest(str(video), detections=boxes)
    sequence = open_sequence(source, {}, tmp_path / "labels.sqlite", Output())
    assert WORDS in capsys.readouterr().err
    assert (sequence.info.width, sequence.info.height) == (64, 48)
