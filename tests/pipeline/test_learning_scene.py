"""Learning while tracking on simulated scenes whose false alarms are known. What takes minutes is marked slow."""

import numpy as np
import pytest
from learning_cases import joined, scores, seen_again, street, tracked

from phdtrack import Tracker, config, pipeline
from phdtrack.errors import InputError
from phdtrack.scene.labelling import PendingFrames, label
from phdtrack.simulate import DetectorModel
from phdtrack.simulate.detector import detect
from phdtrack.types import Detections, SequenceInfo, Truth

slow = pytest.mark.slow


def both(scene, table, first, *sets, kind="gm-phd"):
    """Scores from frame ``first`` on without and with learning, and the run that learned."""
    last = int(table.frame.max())
    run = tracked(scene.info, table, *sets, kind=kind)
    plain = tracked(scene.info, table, kind=kind)
    return scores(scene.truth, plain.tracks, first, last), scores(scene.truth, run.tracks, first, last), run


@slow
def test_the_signal_is_right_where_the_filter_alone_is_not():
    scene = street(1, 1500)
    stages, rng = config.build(config.load(), scene.info, "particle-phd"), np.random.default_rng(0)
    state, pending, chance = pipeline.start(stages, rng), PendingFrames(), []
    for k in range(1, 1501):
        state, step = pipeline.advance(stages, state, scene.detections.at(k), k, (k - 1) / 25, rng)
        pending = pending.joined(step)
        chance.append(step.info.clutter_probability)
    _, verdict = label(pending, 58.0, 0.9, 25.0)
    source, chance = scene.source[: len(verdict.false)], np.concatenate(chance)[: len(verdict.false)]
    assert verdict.false[source > 0].mean() < 0.03
    assert verdict.false[source == 0].mean() > 0.85
    # The filter takes the places, with uniform false alarms, for targets more often than not.
    assert chance[source < 0].mean() < 0.5
    assert verdict.false[source < 0].mean() > 0.75


@pytest.mark.parametrize(
    ("kind", "seeds", "frames"),
    [("gm-phd", (1,), 2000), pytest.param("particle-phd", (1, 2), 3000, marks=slow)],
    ids=["gm-phd", "particle-phd"],
)
def test_false_tracks_go_and_true_ones_stay(kind: str, seeds: tuple[int, ...], frames: int):
    """After half of the frames.

    MOTA with particles is 0.920 on six seeds, of standard error 0.008 and deviation 0.019: one run is two deviations below.
    """
    for seed in seeds:
        scene = street(seed, frames)
        plain, learned, run = both(scene, scene.detections, frames // 2 + 1, "memory=2.0", kind=kind)
        assert plain.false_tracks >= frames // 300
        assert learned.false_tracks <= 0.1 * plain.false_tracks
        assert learned.false_positives <= 0.05 * plain.false_positives
        assert learned.mota > plain.mota + 0.3
        assert learned.mota > 0.88
        assert learned.objects_found >= plain.objects_found
        # Five places that fire every second frame, and one anywhere.
        assert run.learned.clutter.clutter_per_frame == pytest.approx(3.5, rel=0.12)


@slow
def test_places_that_change_are_followed_within_the_memory():
    """A memory is 750 frames."""
    scene = street(1, 4500)
    table = joined([(scene.detections, 1, 2250), (seen_again(scene, 77), 2251, 4500)])
    before, after, _ = both(scene, table, 3001, "memory=0.5")
    assert after.false_positives <= 0.1 * before.false_positives
    assert after.mota > before.mota + 0.3
    assert after.objects_found >= before.objects_found


@slow
def test_the_guard_drops_what_has_become_wrong_and_takes_it_up_again():
    places = DetectorModel(occlusion=2.0, clutter_rate=0.0, places=5)
    flood = DetectorModel(occlusion=2.0, clutter_rate=10.0, clutter_of_all_sizes=True)
    scene = street(1, 3500, places)
    table = joined([(scene.detections, 1, 2250), (seen_again(scene, 5, flood), 2251, 3500)])
    plain, learned, run = both(scene, table, 2251, "memory=2.0")
    turns = [(one.time, one.clutter_used) for one in run.course if any("false alarms" in said for said in one.changes)]
    assert [used for _, used in turns] == [True, False, True]
    # 90 s is when they jump; they are judged two seconds later, and every four seconds is learned.
    assert 90 < turns[1][0] < 99
    assert turns[2][0] < 120
    assert learned.mota > plain.mota - 0.02


@pytest.mark.parametrize("chance", [pytest.param(0.9, marks=slow), 0.7])
def test_somebody_who_stands_still_is_not_learned_away(chance):
    """He walks in, stands for 2½ minutes and walks out; a false alarm a frame anywhere."""
    x = np.concatenate([np.linspace(20, 300, 200), np.full(3750, 300.0), np.linspace(300, 620, 200)])
    n = len(x)
    box = np.stack([x - 15, np.full(n, 110.0), x + 15, np.full(n, 190.0)], axis=1)
    truth = Truth(np.arange(n) + 50, np.ones(n, np.int64), box, np.zeros(n, bool))
    info = SequenceInfo(640, 360, 25.0, 4250, "standing")
    table = detect(truth, info, np.random.default_rng(1), DetectorModel(p_detect=chance)).table
    learned = scores(truth, tracked(info, table, "memory=0.5").tracks, 1, info.frames)
    plain = scores(truth, tracked(info, table).tracks, 1, info.frames)
    assert learned.misses <= plain.misses + 10
    assert learned.mota > 0.98


def test_frames_that_nobody_saw_teach_nothing():
    tracker = Tracker((640, 360), learn={"kind": "online", "memory": 0.2})
    for _ in range(200):
        tracker.update(Detections.empty(observed=False))
    known = tracker.scene.known
    assert known.last is None
    assert known.pending.frames == ()


# What is tracked when learning begins goes on for a while. The PMB filter knows sources of its own: little is left to learn.
@pytest.mark.parametrize(
    ("kind", "left"), [("pmb", 1.1), pytest.param("particle-phd", 0.35, marks=slow), pytest.param("mht", 0.35, marks=slow)]
)
def test_other_filters_learn_too(kind: str, left: float):
    scene = street(3, 1000)
    plain, learned, _ = both(scene, scene.detections, 501, "memory=1.0", kind=kind)
    assert learned.false_positives <= left * plain.false_positives
    assert learned.objects_found >= plain.objects_found


def test_modes_by_a_call_from_outside():
    scene = street(1, 1200)
    night = seen_again(scene, 5)
    tracker = Tracker((640, 360), learn={"kind": "online", "memory": 1.0})
    known = {}
    for first, name, table in ((1, "day", scene.detections), (401, "night", night), (801, "day", scene.detections)):
        tracker.mode(name)
        before = tracker.scene
        for k in range(first, first + 400):
            tracker.update(table.at(k))
        known.setdefault(name, []).append((before.clutter, tracker.scene.clutter))
    # A new mode knows nothing; one that was there before knows what it knew.
    assert known["night"][0][0] is None
    assert known["day"][1][0].clutter_per_frame == known["day"][0][1].clutter_per_frame
    np.testing.assert_array_equal(known["day"][1][0].density.mean, known["day"][0][1].density.mean)
    assert [mode.name for mode in tracker.scene.known.regimes] == ["first", "day", "night"]
    with pytest.raises(InputError, match="learned while tracking"):
        Tracker((640, 360)).mode("day")
