"""Detections that tell nothing of any state, as feet above the horizon, are left out and counted;
nothing else changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from phdtrack import pipeline
from phdtrack.associate.graph import GraphMatching
from phdtrack.associate.labels import Labelled
from phdtrack.filters import (
    GMPHD,
    MHT,
    PMB,
    BestBernoullis,
    BestHypothesis,
    Components,
    KMeans,
    NoFilter,
    ParticlePHD,
    Raw,
)
from phdtrack.models import PlaneBirth, PlaneMotion, PlaneSensor, UniformClutter
from phdtrack.protocols import Model, Stages
from phdtrack.types import Detections
from plane_cases import FRAME, LevelCamera, people

ABOVE = np.array([[100.0, 2, 120, 35], [300, 0, 310, 20]])


def stages(filter_, extractor) -> Stages:
    sensor = PlaneSensor(camera=LevelCamera(), frame_size=FRAME)
    model = Model(
        PlaneMotion(), sensor, PlaneBirth(), UniformClutter(0.1, 500.0), rate=1.0, first=0.1
    )
    return Stages(
        model,
        filter_,
        extractor,
        Labelled() if isinstance(filter_, MHT | PMB) else GraphMatching(gap_cost=30.1),
    )


def run(world: Stages, frames: list[np.ndarray]):
    rng = np.random.default_rng(2)
    out = []
    state = pipeline.start(world, rng)
    for number, xyxy in enumerate(frames, start=1):
        state, step = pipeline.advance(world, state, Detections.of(xyxy), number, number / 10, rng)
        out.append(step)
    return out, pipeline.finish(world, state)


@pytest.mark.parametrize(
    ("filter_", "extractor"),
    [
        (GMPHD(), Components()),
        (ParticlePHD(200), KMeans()),
        (MHT(), BestHypothesis()),
        (PMB(), BestBernoullis()),
        (NoFilter(), Raw()),
    ],
    ids=["gm-phd", "particle-phd", "mht", "pmb", "none"],
)
def test_they_change_nothing_but_the_numbers_of_the_detections(filter_, extractor):
    world = stages(filter_, extractor)
    boxes = world.model.sensor.boxes(people(np.random.default_rng(5), 3))
    clean, tracks = run(world, [boxes] * 12)
    # The first and the last but one of five.
    mixed, mixed_tracks = run(world, [np.vstack([ABOVE[:1], boxes[:2], ABOVE[1:], boxes[2:]])] * 12)
    number = np.array([1, 2, 4, -1])
    for a, b in zip(clean, mixed, strict=True):
        assert (a.unusable, b.unusable) == (0, 2)
        np.testing.assert_array_equal(a.estimates.state, b.estimates.state)
        np.testing.assert_array_equal(number[a.estimates.detection], b.estimates.detection)
        np.testing.assert_allclose(
            a.info.clutter_probability, b.info.clutter_probability[[1, 2, 4]], rtol=1e-12
        )
        np.testing.assert_array_equal(b.info.clutter_probability[[0, 3]], 1)
    assert len(tracks) >= 20
    np.testing.assert_array_equal(tracks.xyxy, mixed_tracks.xyxy)
    np.testing.assert_array_equal(number[tracks.detection], mixed_tracks.detection)
    assert len(run(world, [ABOVE] * 3)[1]) == 0


def test_the_first_interval_is_the_model_s_own():
    """γ is per second: half a second before the first frame brings five times as much as a
    tenth.
    """
    world = stages(GMPHD(), Components())
    boxes = world.model.sensor.boxes(people(np.random.default_rng(5), 1))
    longer = replace(world, model=replace(world.model, first=0.5))
    short, *_ = run(world, [boxes])[0]
    long, *_ = run(longer, [boxes])[0]
    assert long.info.mass_born == pytest.approx(5 * short.info.mass_born)
    assert short.info.mass_born > 0
