"""Labelling and learning where the rate varies: 30 pictures a second, then 5."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from phdtrack import config
from phdtrack.arrays import to_cxcywh
from phdtrack.clock import Clock
from phdtrack.label import Label, LabelStore
from phdtrack.label.samples import Marks
from phdtrack.label.sequences import open_sequence
from phdtrack.label.suggestions import Evidence, suggest
from phdtrack.run.requests import SourceRequest
from phdtrack.scene.training import births_in
from phdtrack.types import Detections, DetectionTable, SequenceInfo, Tracks

TIMES = np.r_[np.arange(90) / 30, 3 + np.arange(100) / 5]
FRAMES = np.arange(1, 191)
CLOCK = Clock.of(FRAMES, TIMES, 190 / 23)
INFO = SequenceInfo(640, 480, 190 / 23, 190, "varied")


def boxes(start: float, speed: float, frames: np.ndarray) -> np.ndarray:
    """(n, 4) boxes that go right at this speed in pixels a second."""
    left = start + speed * (TIMES[frames - 1] - TIMES[frames[0] - 1])
    return np.stack([left, 0 * left + 200, left + 30, 0 * left + 280], axis=1)


@pytest.mark.parametrize("first", [20, 120])
def test_marked_births_have_true_velocities(tmp_path: Path, first: int) -> None:
    frames = np.arange(first, first + 6)
    table = DetectionTable(frames, Detections.of(boxes(100, 60, frames)))
    store = LabelStore.open(tmp_path / "labels", "varied", "digest", (first,))
    store.mark(first, [Label(first, 0, "birth")])
    store.finish(first)
    marks = Marks(store, table, INFO, None, CLOCK)
    state = marks.birth_states(10)[:, 0]
    np.testing.assert_allclose(state, [115, 240, 6, 0, 30, 80], atol=1e-6)
    watched = marks.watched
    seconds = TIMES[watched - 1].max() - TIMES[watched - 2].min()
    assert marks.time_watched(10) == pytest.approx(10 * seconds)


def test_births_of_tracks_have_true_velocities() -> None:
    """One of a second in the slow part, which has five frames, is long enough; in the fast part a
    third of a second is not.
    """
    rows = []
    for identity, first, count in ((1, 1, 60), (2, 10, 60), (3, 120, 8), (4, 20, 10)):
        frames = np.arange(first, first + count)
        found = boxes(100, 300, frames)
        rows.append(Tracks.of(frames, identity, found, 1.0, 0))
    states = births_in(Tracks.concatenate(rows), CLOCK, 30)
    np.testing.assert_allclose(states[2], [10, 10], atol=1e-6)


def test_an_object_that_stays_is_no_false_alarm() -> None:
    """It stays for eight seconds; in the first there are 30 pictures a second."""
    frames = FRAMES[60:125]
    table = DetectionTable(frames, Detections.of(boxes(100, 0, frames)))
    evidence = Evidence(table, CLOCK, range(1, 191), np.zeros(len(frames)), Tracks.empty())
    assert max((one.score for one in suggest(evidence, frames.tolist())), default=0) <= 0.4


def test_tracks_of_evidence_take_the_times_of_the_video(tmp_path: Path) -> None:
    path = tmp_path / "v.mp4"
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4")
        video.width = 640
        video.height = 480
        video.pix_fmt = "yuv420p"
        video.codec_context.time_base = Fraction(1, 1000)
        for time in TIMES:
            frame = av.VideoFrame.from_ndarray(np.zeros((480, 640, 3), np.uint8), format="bgr24")
            frame.pts = round(1000 * time)
            frame.time_base = Fraction(1, 1000)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    xyxy = boxes(20, 20, FRAMES)
    ltwh = np.hstack([xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2]])
    lines = [
        f"{number},-1,{','.join(f'{side:.3f}' for side in box)},0.9\n"
        for number, box in zip(FRAMES.tolist(), ltwh, strict=True)
    ]
    (tmp_path / "det.txt").write_text("".join(lines))
    source = SourceRequest(str(path), tmp_path / "det.txt")
    sequence = open_sequence(source, {}, tmp_path / "labels")
    assert sequence.clock is not None
    np.testing.assert_allclose(sequence.clock.times(FRAMES), TIMES, atol=1e-3)
    stages = config.build(config.load(), sequence.info)
    evidence = Evidence.of(sequence.table, sequence.clock, range(1, 191), stages)
    tracks = evidence.tracks
    assert len(np.unique(tracks.identity)) == 1
    error = to_cxcywh(tracks.xyxy)[0] - to_cxcywh(xyxy)[0][tracks.frame - 1]
    assert np.abs(error).max() < 3
