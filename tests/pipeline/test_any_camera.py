"""The defaults need no tuning: from QCIF to 4K, from 7 to 60 frames per second."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phdtrack import config, pipeline
from phdtrack.metrics import evaluate
from phdtrack.simulate import DetectorModel, make_scene
from phdtrack.types import Tracks


def corrected(info, table, scale: float = 1.0) -> Tracks:
    """The tracks of the default filter, of detections ``scale`` times as large."""
    stages = config.build(config.load(), info)
    rng = np.random.default_rng(0)
    shown = (table.at(n) for n in range(1, info.frames + 1))
    frames = (
        (n, (n - 1) / info.fps, replace(d, xyxy=d.xyxy * scale))
        for n, d in enumerate(shown, start=1)
    )
    *_, (state, _) = pipeline.run(stages, frames, rng)
    return pipeline.finish(stages, state)


@pytest.mark.parametrize(("width", "share"), [(176, 0.15), (3840, 0.03)])
def test_the_size_of_the_picture_changes_nothing(width: int, share: float):
    """The same scene in other pixels: the same rows and identities, boxes in proportion.

    But for what a pixel is to the sensor, its least deviation: where boxes are a few pixels wide it
    takes part, and boxes differ by up to a pixel, or ``share`` of their smaller side.
    """
    scene = make_scene("street", 1, DetectorModel(clutter_rate=2.0), frames=200)
    scale = width / scene.info.width
    info = replace(scene.info, width=width, height=round(scene.info.height * scale))
    one = corrected(scene.info, scene.detections)
    other = corrected(info, scene.detections, scale)
    assert other.frame.tolist() == one.frame.tolist()
    assert other.identity.tolist() == one.identity.tolist()
    size = (one.xyxy[:, 2:] - one.xyxy[:, :2]).min(axis=1)
    assert (
        np.abs(other.xyxy / scale - one.xyxy).max(axis=1) < np.maximum(share * size, 1 / scale)
    ).all()


@pytest.mark.parametrize("fps", [7, 15, 30, 60])
@pytest.mark.parametrize("name", ["street", "crossing"])
def test_the_frame_rate_does_not_matter(name: str, fps: int):
    """Twenty seconds with two false boxes a frame."""
    scene = make_scene(name, 1, DetectorModel(clutter_rate=2.0), frames=20 * fps, fps=fps)
    scores = evaluate(
        scene.truth, corrected(scene.info, scene.detections), frames=scene.info.frames
    )
    assert scores.MOTA > 0.96
    assert scores.IDF1 > 0.97
