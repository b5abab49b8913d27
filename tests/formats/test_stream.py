"""Detections from a pipe: the same as from a file, each frame when it is complete, errors with the
line.
"""

import json
import os
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from phdtrack.cli.app import application
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_tracks
from phdtrack.formats.stream import stream_detections


def streamed(content: bytes, pieces: int = 1):
    """The tables read from a pipe into which the content is written in so many pieces."""
    out, into = os.pipe()
    cuts = np.linspace(0, len(content), pieces + 1).astype(int)

    def write() -> None:
        with os.fdopen(into, "wb", buffering=0) as file:
            for first, last in pairwise(cuts):
                file.write(content[first:last])

    writer = threading.Thread(target=write)
    writer.start()
    try:
        with os.fdopen(out, "rb", buffering=0) as file:
            return list(stream_detections(file, "standard input"))
    finally:
        writer.join()


ROWS = "".join(
    f"{k},-1,{10 * k + j},{20 + j},30,60,0.{j + 1}\n"
    for k in (1, 2, 5, 6, 9)
    for j in range(k % 3 + 1)
)
HEADER = "frame,left,top,width,height,confidence\n"


@pytest.mark.parametrize(
    "content", [ROWS, ROWS[:-1], "# note\n\n" + ROWS, HEADER + ROWS.replace(",-1,", ",")]
)
@pytest.mark.parametrize("pieces", [1, 7, 100])
def test_stream_gives_the_rows_of_the_file(content: str, pieces: int, tmp_path: Path) -> None:
    path = tmp_path / "det.txt"
    path.write_text(content)
    whole = read_detections(path)
    parts = streamed(content.encode(), pieces)
    np.testing.assert_array_equal(np.concatenate([part.frame for part in parts]), whole.frame)
    np.testing.assert_array_equal(
        np.concatenate([part.detections.xyxy for part in parts]), whole.detections.xyxy
    )
    numbers = [set(part.frame.tolist()) for part in parts]
    assert sum(map(len, numbers)) == len(set().union(*numbers))


def test_frame_is_yielded_when_the_next_begins(tmp_path: Path) -> None:
    out, into = os.pipe()
    with os.fdopen(out, "rb", buffering=0) as file, os.fdopen(into, "wb", buffering=0) as pipe:
        tables = stream_detections(file, "standard input")
        pipe.write(b"1,-1,10,10,30,60,1\n1,-1,80,10,30,60,1\n2,-1,1")
        pipe.write(b"0,10,30,60,1\n")
        first = next(tables)
        assert first.frame.tolist() == [1, 1]


@pytest.mark.parametrize("pieces", [1, 40])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            "1,-1,1,1,9,9,1\n3,-1,1,1,9,9,1\n2,-1,1,1,9,9,1\n",
            (
                "line 3: expected the rows of a stream in the order of their frames, got frame 2"
                " after frame 3"
            ),
        ),
        ("1,-1,1,1,9,9,1\n2,-1,1,1,9,x,1\n", "line 2"),
        (HEADER + "1,1,1,9,9,1\n\n2,1,1,9,9\n", "line 4"),
        ("1,-1,1,1,9,9,1\n2,-1,1,1,9,nan,1\n", "line 2"),
    ],
)
def test_malformed_stream_line_is_named(content: str, words: str, pieces: int) -> None:
    with pytest.raises(InputError) as error:
        streamed(content.encode(), pieces)
    assert words in str(error.value)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_tracking_a_pipe_equals_tracking_the_file(tmp_path: Path) -> None:
    """Frames without rows are frames in which nothing was detected."""
    frames = [*range(3, 40), *range(45, 80), *range(100_000, 100_030)]
    rows = "".join(
        f"{k},-1,{100 * j + 3 * (k % 100)},{20 + 90 * j},30,60,0.9\n"
        for k in frames
        for j in range(3)
    )
    (tmp_path / "det.txt").write_text(rows)
    words = ["track", "--fps", "25", "--frame-size", "640x480", "--detections"]
    from_file = [*words, str(tmp_path / "det.txt"), "--out", str(tmp_path / "file")]
    said = CliRunner().invoke(application("track"), from_file)
    assert said.exit_code == 0, said.stderr
    done = subprocess.run(
        [sys.executable, "-m", "phdtrack", *words, "-", "--out", tmp_path / "pipe"],
        input=rows,
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    online = [(tmp_path / name / "tracks_online.csv").read_text() for name in ("file", "pipe")]
    assert online[0] == online[1]
    assert online[0].count("\n") > 150
    # The past of a pipe is forgotten; figures are of all.
    for name in ("file", "pipe"):
        run = json.loads((tmp_path / name / "run.json").read_text())
        rows = read_tracks(tmp_path / name / "tracks.csv")
        assert (run["frames"], run["detections"]) == (1609, 3 * len(frames))
        assert (run["tracks"], run["track_rows"]) == (len(np.unique(rows.identity)), len(rows))
        assert 0 < run["predicted_rows"] == rows.predicted.sum()
        assert "1 h 6 min of video" in run["summary"][0]
        assert ("The source had no end" in (tmp_path / name / "report.html").read_text()) == (
            name == "pipe"
        )
