"""The legend of an annotated video."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.report import Annotator
from phdtrack.types import Detections, SequenceInfo, Tracks


def lower_left(annotate: Annotator, number: int, height: int = 360) -> np.ndarray:
    image = np.full((height, 640, 3), 90, np.uint8)
    drawn = annotate(image, number, Tracks.empty(), Detections.empty())
    return drawn[height // 2 :, :320]


@pytest.mark.parametrize("fps", [1.0, 10.0, 60.0])
def test_frames_of_the_first_second_have_a_legend(fps: float) -> None:
    annotate = Annotator(SequenceInfo(width=640, height=360, fps=fps), legend=True)
    shown = [bool((lower_left(annotate, k) != 90).any()) for k in range(1, int(fps) + 4)]
    assert shown == [True] * int(fps) + [False] * 3


def test_there_is_none_unless_asked_for_nor_in_small_frames() -> None:
    info = SequenceInfo(width=640, height=360, fps=10.0)
    assert (lower_left(Annotator(info), 1) == 90).all()
    small = SequenceInfo(width=640, height=120, fps=10.0)
    assert (lower_left(Annotator(small, legend=True), 1, 120) == 90).all()
