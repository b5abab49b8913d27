"""Learning while tracking on simulated scenes whose false alarms are known."""

import pickle

import numpy as np
import pytest
from learning_cases import DETECTOR, joined, scores, seen_again, street, tracked

from phdtrack import Tracker, config, pipeline
from phdtrack.errors import InputError
from phdtrack.scene.labelling import PendingFrames, label
from phdtrack.simulate import DetectorModel
from phdtrack.simulate.detector import detect
from phdtrack.types import Detections, SequenceInfo, Truth


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
    mean = {name: verdict.false[rows].mean() for name, rows in sources(source).items()}
    alone = {name: chance[rows].mean() for name, rows in sources(source).items()}
    assert mean["targets"] < 0.03
    assert mean["anywhere"] > 0.85
    # The filter believes the places, with uniform false alarms, more often than not.
    assert alone["places"] < 0.5
    assert mean["places"] > 0.75


def sources(source):
    return {"targets": source > 0, "anywhere": source == 0, "places": source < 0}


@pytest.mark.parametrize("seed", [1, 2])
def test_false_tracks_go_and_true_ones_stay(seed):
    scene = street(seed, 3000)
    uniform = scores(scene.truth, tracked(scene.info, scene.detections, kind="particle-phd").tracks, 1501, 3000)
    run = tracked(scene.info, scene.detections, "memory=2.0", kind="particle-phd")
    learned = scores(scene.truth, run.tracks, 1501, 3000)
    assert uniform.false_tracks >= 10
    assert learned.false_tracks <= 0.1 * uniform.false_tracks
    assert learned.false_positives <= 0.05 * uniform.false_positives
    assert learned.mota > uniform.mota + 0.3
    assert learned.mota > 0.88
    assert learned.objects_found >= uniform.objects_found
    # Five places that fire every second frame, and one anywhere.
    assert run.learned.clutter.clutter_per_frame == pytest.approx(3.5, rel=0.12)


def test_places_that_change_are_followed_within_the_memory():
    scene = street(1, 4500)
    table = joined([(scene.detections, 1, 2250), (seen_again(scene, 77), 2251, 4500)])
    uniform = tracked(scene.info, table).tracks
    run = tracked(scene.info, table, "memory=0.5")
    # A memory is 750 frames.
    after = scores(scene.truth, run.tracks, 3001, 4500)
    before = scores(scene.truth, uniform, 3001, 4500)
    assert after.false_positives <= 0.1 * before.false_positives
    assert after.mota > before.mota + 0.3
    assert after.objects_found >= before.objects_found


def test_the_guard_drops_what_has_become_wrong_and_takes_it_up_again():
    places = DetectorModel(occlusion=2.0, clutter_rate=0.0, places=5)
    flood = DetectorModel(occlusion=2.0, clutter_rate=10.0, clutter_sizes="log-uniform")
    scene = street(1, 3500, places)
    table = joined([(scene.detections, 1, 2250), (seen_again(scene, 5, flood), 2251, 3500)])
    run = tracked(scene.info, table, "memory=2.0")
    turns = [(one.time, one.clutter_used) for one in run.course if any("false alarms" in said for said in one.changes)]
    assert [used for _, used in turns] == [True, False, True]
    # 90 s is when they jump; they are judged two seconds later, and every four seconds is learned.
    assert 90 < turns[1][0] < 99
    assert turns[2][0] < 120
    uniform = scores(scene.truth, tracked(scene.info, table).tracks, 2251, 3500)
    learned = scores(scene.truth, run.tracks, 2251, 3500)
    assert learned.mota > uniform.mota - 0.02


def standing(chance):
    """Somebody walks in, stands for 2½ minutes and walks out; a false alarm a frame anywhere."""
    x = np.concatenate([np.linspace(20, 300, 200), np.full(3750, 300.0), np.linspace(300, 620, 200)])
    n = len(x)
    box = np.stack([x - 15, np.full(n, 110.0), x + 15, np.full(n, 190.0)], axis=1)
    truth = Truth(np.arange(n) + 50, np.ones(n, np.int64), box, np.zeros(n, bool))
    info = SequenceInfo(640, 360, 25.0, 4250, "standing")
    return info, truth, detect(truth, info, np.random.default_rng(1), DetectorModel(p_detect=chance)).table


@pytest.mark.parametrize("chance", [0.9, 0.7])
def test_somebody_who_stands_still_is_not_learned_away(chance):
    info, truth, table = standing(chance)
    learned = scores(truth, tracked(info, table, "memory=0.5").tracks, 1, info.frames)
    uniform = scores(truth, tracked(info, table).tracks, 1, info.frames)
    assert learned.misses <= uniform.misses + 10
    assert learned.mota > 0.98


def test_a_run_is_the_same_again_and_goes_on_from_a_saved_state():
    scene = street(2, 400)
    runs = [tracked(scene.info, scene.detections, "memory=0.2") for _ in range(2)]
    np.testing.assert_array_equal(runs[0].tracks.xyxy, runs[1].tracks.xyxy)
    assert runs[0].course == runs[1].course
    assert len(runs[0].course) > 8
    whole, first, rest = (Tracker((640, 360), learn={"kind": "online", "memory": 0.2}) for _ in range(3))
    for k in range(1, 401):
        whole.update(scene.detections.at(k))
        first.update(scene.detections.at(k)) if k <= 250 else rest.update(scene.detections.at(k))
        if k == 250:
            rest.load_state_dict(pickle.loads(pickle.dumps(first.state_dict())))
    assert first.state.learned.clutter is not None
    np.testing.assert_array_equal(rest.tracks().xyxy, whole.tracks().xyxy)
    assert rest.state.learned.known.last == whole.state.learned.known.last


def test_frames_that_nobody_saw_teach_nothing():
    tracker = Tracker((640, 360), learn={"kind": "online", "memory": 0.2})
    for _ in range(200):
        tracker.update(Detections.empty(observed=False))
    known = tracker.state.learned.known
    assert known.last is None
    assert known.pending.frames == ()


# What is tracked when learning begins goes on for a while. The PMB filter knows sources of its own: little is left to learn.
@pytest.mark.parametrize(("kind", "left"), [("pmb", 1.05), ("particle-phd", 0.35), ("mht", 0.35)])
def test_other_filters_learn_too(kind: str, left: float):
    scene = street(3, 1000)
    found = {}
    for learn in ({}, {"kind": "online", "memory": 1.0}):
        sections = {"learn": learn} if learn else {}
        tracker = Tracker((640, 360), fps=25, filter=kind, **sections)
        for k in range(1, 1001):
            tracker.update(scene.detections.at(k))
        found[bool(learn)] = scores(scene.truth, tracker.tracks(), 501, 1000)
    assert found[True].false_positives <= left * found[False].false_positives
    assert found[True].objects_found >= found[False].objects_found


def test_modes_by_a_call_from_outside():
    scene, night = street(1, 1200), seen_again(street(1, 1200), 5)
    tracker = Tracker((640, 360), learn={"kind": "online", "memory": 1.0})
    rates = {}
    for first, name, table in ((1, "day", scene.detections), (401, "night", night), (801, "day", scene.detections)):
        tracker.mode(name)
        before = tracker.state.learned
        for k in range(first, first + 400):
            tracker.update(table.at(k))
        rates.setdefault(name, []).append((before.clutter, tracker.state.learned.clutter))
    # A new mode knows nothing; one that was there before knows what it knew.
    assert rates["night"][0][0] is None
    assert rates["day"][1][0].clutter_per_frame == rates["day"][0][1].clutter_per_frame
    np.testing.assert_array_equal(rates["day"][1][0].density.mean, rates["day"][0][1].density.mean)
    assert [mode.name for mode in tracker.state.learned.known.regimes] == ["first", "day", "night"]
    with pytest.raises(InputError, match="learned while tracking"):
        Tracker((640, 360)).mode("day")


def test_the_default_detector_has_places():
    # The cases above rest on it.
    assert DETECTOR.places == 5
    assert DETECTOR.place_fire == 0.5
