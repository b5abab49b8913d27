"""One frame of groups: who is in which, that no head is lost, and which Gaussians carry which
tracks.
"""

from dataclasses import replace

import numpy as np
import pytest
from group_cases import people

from phdtrack import pipeline
from phdtrack.config import build, build_groups, load, overlay
from phdtrack.groups.clusters import Grouping
from phdtrack.groups.group_stages import REACH, GroupStages, carriers, mixture_of
from phdtrack.groups.life_cycle import GroupLifeCycle, LifeCycleState
from phdtrack.groups.pairs import Pairs
from phdtrack.types import Detections, SequenceInfo

STAGES = GroupStages(Grouping(), life_cycle=GroupLifeCycle(hold_time=0.0))
EVERYBODY = np.arange(5)
# Two who walk together, one apart, and two together, of whom nobody has an identity.
FIVE = people(
    [(0, 0, 1, 0), (1, 0, 1, 0), (10, 0, 0, 0), (0, 20, 0, 1), (1, 20, 0, 1)],
    [1.0, 0.9, 0.8, 0.6, 0.3],
)


def test_tracked_people_lead_their_cluster() -> None:
    _, frame = STAGES.advance(LifeCycleState(), FIVE, np.array([7, 9]), np.array([1, 2]), 1, 0.0)
    assert frame.identity.tolist() == [0, 1, 2]
    assert frame.groups.label.tolist() == [1, 1, 2, 0, 0]
    assert frame.groups.count == pytest.approx([0.9, 1.9, 0.8])
    assert frame.member.tolist() == [7, 9]
    assert frame.membership.tolist() == [1, 2]


def test_every_person_is_counted_once() -> None:
    state = LifeCycleState()
    for number, carried in enumerate(([0, 3], [1], [], [0, 1, 2, 3, 4]), start=1):
        carrier = np.array(carried, np.int64)
        state, frame = STAGES.advance(state, FIVE, carrier + 1, carrier, number, number / 10)
        assert frame.people == pytest.approx(FIVE.weight.sum())
        assert frame.deviation == pytest.approx(np.sqrt((FIVE.weight * (1 - FIVE.weight)).sum()))


def test_track_without_a_component_is_in_no_group() -> None:
    light = replace(FIVE, weight=np.array([1.0, 0.1, 0.8, 0.6, 0.3]))
    _, frame = STAGES.advance(
        LifeCycleState(), light, EVERYBODY[:3] + 1, np.array([0, 1, -1]), 1, 0.0
    )
    assert frame.member.tolist() == [1]
    assert frame.groups.label[1] == -1


def test_contours_and_warnings_belong_to_the_groups() -> None:
    towards = people([(0, 0, 1, 0), (6, 0, -1, 0)])
    _, frame = STAGES.advance(LifeCycleState(), towards, np.array([1, 2]), np.array([0, 1]), 1, 0.0)
    assert [len(rings) for rings in frame.contours] == [1, 1]
    for centre, rings in zip(frame.groups.mean[:2].T, frame.contours, strict=True):
        assert np.abs(rings[0].mean(axis=1) - centre).max() < 0.1
    assert [(w.first, w.second) for w in frame.warnings] == [(1, 2)]
    _, unnamed = STAGES.advance(LifeCycleState(), towards, np.array([1]), np.array([0]), 1, 0.0)
    assert unnamed.warnings == ()
    _, empty = STAGES.advance(
        LifeCycleState(), people([]), np.zeros(0, np.int64), np.zeros(0, np.int64), 1, 0.0
    )
    assert (len(empty), empty.people, empty.warnings) == (0, 0, ())


def test_track_is_assigned_to_the_nearest_heavy_gaussian() -> None:
    sd = 0.3
    edge = sd * np.sqrt(REACH)
    place = np.array([[0.0, 0.6, 10 + 0.99 * edge, 10 + 1.01 * edge, np.nan], [0, 0, 0, 0, 0]])
    assert carriers(FIVE, place, 0.25).tolist() == [0, 1, 2, -1, -1]
    assert carriers(FIVE, place, 0.95).tolist() == [0, 0, -1, -1, -1]
    assert carriers(FIVE, np.zeros((2, 0)), 0.25).tolist() == []
    assert carriers(people([]), place, 0.25).tolist() == [-1] * 5


@pytest.mark.parametrize("name", ["gm-phd", "gm-cphd", "particle-phd", "particle-cphd"])
def test_one_missed_detection_changes_no_group(name: str) -> None:
    info = SequenceInfo(60, 60, 5.0)
    sets = [
        "groups.kind=intensity",
        "motion.kind=plane",
        "sensor.scaling=fixed",
        "sensor.fixed_noise=0.3",
        "camera.region=[-30, -30, 30, 30]",
    ]
    settings = overlay(load(sets=sets), {"filter": {"kind": name}})
    stages = build(settings, info)
    lightest = build_groups(settings, stages).grouping.min_weight
    assert lightest < 0.1 * 0.99
    # Two people walk, seen in metres; in the last frame the second is missed.
    centre = [
        np.array([[0.3 * k, 0.0], [0.3 * k, 8.0]])[: 1 if k == 12 else 2] for k in range(1, 13)
    ]
    seen = [Detections.of(np.hstack([place - 0.3, place + 0.3])) for place in centre]
    frames = ((k, k / info.fps, found) for k, found in enumerate(seen, start=1))
    *_, (state, step) = pipeline.run(stages, frames, np.random.default_rng(0))
    mixture = mixture_of(
        state.intensity, step, stages.model.sensor.measure(seen[-1]), stages, lightest
    )
    heavy = mixture.mean[:2, mixture.weight >= lightest]
    assert np.hypot(*(heavy - np.array([[0.3 * 12], [8.0]]))).min() < 1.0


def test_settings_of_the_user_are_kept() -> None:
    settings = load(
        sets=[
            "groups.kind=intensity",
            "motion.kind=plane",
            "filter.kind=gm-phd",
            "groups.min_weight=0.4",
            "contours.level=0.2",
        ]
    )
    stages = build(settings, SequenceInfo(60, 60, 5.0))
    found = build_groups(settings, stages)
    assert (found.grouping.min_weight, found.contours.level) == (0.4, 0.2)
    # E13's values give the usual number, and so does a run without a filter.
    e13 = load(preset="e13")
    assert build_groups(
        e13, build(e13, SequenceInfo(60, 60, 7.0))
    ).grouping.min_weight == pytest.approx(0.25, abs=0.001)
    assert build_groups(load(sets=["groups.kind=intensity"])).grouping.min_weight == 0.25
    assert build_groups(load()).grouping == Pairs()
