"""M09's experiment: marks, learning, runs and scores on small scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments import m09, m09_claims, m09_lessons, m09_runs, m09_scenes, scenes
from experiments.common import Case, Options, uniform_density
from experiments.m09_runs import GM, UM, SceneRun
from phdtrack import config
from phdtrack.arrays import iou, to_cxcywh
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.filters import PrintedMixture
from phdtrack.label.samples import REACH, Marks
from phdtrack.models import BoxClutter, MeasurementBirth
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.protocols import Birth, Clutter
from phdtrack.scene import LearnedDensity, TrackedObjects, marginal
from phdtrack.simulate import DetectorModel, make_scene
from phdtrack.types import Detections, DetectionTable, SequenceInfo, Tracks, Truth


@pytest.fixture(scope="module")
def street() -> tuple[Case, np.ndarray, np.ndarray]:
    """A street with two places that fire always, where its detections came from, and the places."""
    model = DetectorModel(
        p_detect=1.0, clutter_rate=0.0, places=2, place_fire=1.0, jitter=0.02, jitter_size=0.02
    )
    scene = make_scene("street", 3, model, frames=600, arrivals=1.0)
    return Case("street", scene.info, scene.truth, scene.detections), scene.source, scene.places


def test_what_is_nobody_is_marked_as_false_and_nothing_else(street, tmp_path) -> None:
    case, source, places = street
    store = m09_lessons.marked_false(case, tmp_path / "false.sqlite", seed=1, count=30)
    assert store.progress().done == 30
    starts = np.searchsorted(case.table.frame, np.arange(1, case.info.frames + 2))
    marked = {(label.frame, label.box) for label in store.labels()}
    for number, _ in store.frames():
        people = case.truth.xyxy[case.truth.frame == number]
        for box, origin in enumerate(source[starts[number - 1] : starts[number]]):
            if origin > 0:
                assert (number, box) not in marked
            elif iou(places, people).max(initial=0) == 0:
                assert (number, box) in marked


def test_births_are_marked_where_somebody_is_first_detected(street, tmp_path) -> None:
    case, source, _ = street
    number, box = m09_lessons.first_boxes(case)
    starts = np.searchsorted(case.table.frame, np.arange(1, case.info.frames + 2))
    first = {
        int(one): int(case.table.frame[source == one].min())
        for one in np.unique(source[source > 0])
    }
    # Everybody is detected with p_D 1; who overlaps somebody else may have been seen under his
    # name.
    assert len(number) == len(first)
    right = [
        first[int(source[starts[n - 1] + b])] == n
        for n, b in zip(number, box, strict=True)
        if source[starts[n - 1] + b] > 0
    ]
    assert np.mean(right) > 0.9
    store = m09_lessons.marked_births(case, tmp_path / "births.sqlite")
    states = Marks(store, case.table, case.info).birth_states(25.0)
    # Every frame but the first of the first clip is searched.
    assert states.shape[1] == (number > 1).sum()
    assert {frame for frame, done in store.frames() if done} == set(
        range(1 + REACH, case.info.frames + REACH, 2 * REACH)
    )
    # Those who come in from a side walk into the frame.
    centre = states[0]
    velocity = states[2]
    left = np.isfinite(velocity) & (centre < 40)
    right_side = np.isfinite(velocity) & (centre > case.info.width - 40)
    assert left.sum() + right_side.sum() >= 5
    assert (velocity[left] > 0).mean() > 0.8
    assert (velocity[right_side] < 0).mean() > 0.8


def test_every_run_has_its_births_and_its_clutter(street) -> None:
    case = street[0]
    train = m09_scenes.stretch(case, 1, 300)
    scene = learned_scene(train)
    halved = m09_scenes.Halves("street", train, case, np.zeros((0, 4)))
    stages = {
        run: m09_runs.stages_of(SceneRun("street", 1, run), halved, scene) for run in scenes.RUNS
    }
    births = {run: rate_and_kind(one.model.birth) for run, one in stages.items()}
    # So many a frame as were learned, over the detections of a frame.
    each = train.info.frames / len(train.table.frame)
    shipped = (MeasurementBirth, 0.125, "local")
    estimated = (MeasurementBirth, 0.5 * each, "local")
    learned = (SceneBirth, 0.5, 0.125)
    by_hand = (SceneBirth, 1.25, 0.125)
    assert births == {
        UM: shipped,
        GM: learned,
        "A1": learned,
        "A2": shipped,
        "A3": estimated,
        "A4": learned,
        "A5": estimated,
        "A6": by_hand,
    }
    clutter = {run: rate_and_kind(one.model.clutter) for run, one in stages.items()}
    usual = (BoxClutter, 1.5, None)
    rated = (BoxClutter, 2.5 * each, None)
    false = (SceneClutter, 2.5, 1.5)
    assert clutter == {
        UM: usual,
        GM: false,
        "A1": usual,
        "A2": false,
        "A3": rated,
        "A4": rated,
        "A5": false,
        "A6": false,
    }
    # Tracks are held back where false alarms are known.
    assert {
        run for run, one in stages.items() if isinstance(one.associator, FalseTrackRejection)
    } == {GM, "A2", "A5", "A6"}


def paper_scene(train: Case, share: float) -> m09.PaperScene:
    one = learned_scene(train)
    assert one.births is not None
    alarms = {
        count: m09.Alarms(replace(one.clutter, rate=count / 10), count, 40, share)
        for count in (10, 25)
    }
    assert one.hand is not None
    after = replace(one.births, rate=0.03)
    printed = replace(one.births, rate=0.04), replace(one.clutter, rate=4.0)
    return m09.PaperScene(
        one.births, 30, one.hand, alarms, after, 20, 10, 19, printed, (0.003, 10.0)
    )


def test_the_papers_runs_have_densities_over_the_image(street) -> None:
    case = street[0]
    train = m09_scenes.stretch(case, 1, 300)
    halved = m09_scenes.Halves("street", train, case, np.zeros((0, 4)))
    z = np.array([[300.0], [200], [40], [90]])
    scene = paper_scene(train, 1.0)
    models = {
        run: m09.stages_of(SceneRun("street", 1, run), halved, scene).model
        for run in (*m09.RUNS, "GM 10")
    }
    births = {run: rate_and_kind(one.birth) for run, one in models.items()}
    usual = (MeasurementBirth, 0.25, "image")
    learned = (SceneBirth, 0.5, 0.0)
    flat = (SceneBirth, 0.5, 0.0)
    assert births == {
        UM: usual,
        GM: learned,
        m09.WHOLE: learned,
        m09_runs.AFTER: (SceneBirth, 0.75, 0.0),
        m09_runs.PRINTED: (SceneBirth, 1.0, 0.0),
        m09_runs.TUNED: (MeasurementBirth, 0.075, "image"),
        m09_runs.UM_PRINTED: usual,
        m09_runs.TUNED_PRINTED: (MeasurementBirth, 0.075, "image"),
        "A1": learned,
        "A2": usual,
        "A3": flat,
        "A4": learned,
        "A5": flat,
        "A6": (SceneBirth, 1.25, 0.0),
        "GM 10": learned,
    }
    clutter = {run: rate_and_kind(one.clutter)[:2] for run, one in models.items()}
    false = (SceneClutter, 2.5)
    assert clutter == dict.fromkeys(models, false) | {
        UM: (BoxClutter, 1.0), "A1": (BoxClutter, 1.0), "GM 10": (SceneClutter, 1.0),
        m09_runs.PRINTED: (SceneClutter, 4.0), m09_runs.TUNED: (BoxClutter, 10.0),
        m09_runs.UM_PRINTED: (BoxClutter, 1.0), m09_runs.TUNED_PRINTED: (BoxClutter, 10.0),
    }  # fmt: skip
    # Beside learned false alarms births have the volume of the sizes that are detected, and not
    # that of the frame.
    ratio = models["A2"].birth.density(z) / models[UM].birth.density(z)
    boxes = scene.alarms[25].clutter.density
    assert ratio[0] == pytest.approx((640 * 360) ** 2 / boxes.volume)
    unused = m09.stages_of(SceneRun("street", 1, GM), halved, paper_scene(train, 0.0))
    assert unused == m09.uniform(case.info)


def test_a_share_of_what_was_learned_leaves_the_rest_uniform(street) -> None:
    case = street[0]
    scene = paper_scene(case, 1.0)
    stages = m09.uniform(case.info)
    learned = scene.at(1800).clutter
    model = m09.mixed(stages, scene.births, learned, 0.1).model
    assert model.clutter.clutter_per_frame == pytest.approx(0.9 * 1.0 + 0.1 * 2.5)
    assert model.birth.births_per_second == pytest.approx(0.9 * 0.25 + 0.1 * 0.5)
    inside = (
        learned.density.low[:, None] + 0.5 * (learned.density.high - learned.density.low)[:, None]
    )
    want = 0.9 / learned.density.volume + 0.1 * 2.5 * learned.density(inside)
    np.testing.assert_allclose(model.clutter.intensity(inside), want, rtol=1e-12)
    assert m09.mixed(stages, scene.births, learned, 0.0) is stages


def test_fixed_variances_are_those_of_the_preset_fv(street) -> None:
    """Of PROP in Fig. 16, untrained and trained; those of its rival are printed, too."""
    case = street[0]
    halved = m09_scenes.Halves("street", m09_scenes.stretch(case, 1, 300), case, np.zeros((0, 4)))
    scene = paper_scene(halved.train, 1.0)
    of = {
        (filter_, run): m09.stages_of(SceneRun("street", 1, run, filter_), halved, scene)
        for filter_, run in m09.RIVALS
    }
    fixed = config.build(config.load(preset="fv"), case.info)
    assert of["fv", m09_runs.UM_PRINTED] == fixed
    assert of["fv", m09_runs.PRINTED].extractor == fixed.extractor == PrintedMixture()
    assert of["fv", m09_runs.AFTER].extractor == m09.uniform(case.info).extractor
    assert of["fv", m09_runs.AFTER].model.sensor == fixed.model.sensor
    assert isinstance(of["fv", m09_runs.AFTER].model.birth, SceneBirth)
    assert (
        of["m09-mht", UM].model.sensor.birth_speed_pixels == fixed.model.sensor.birth_speed_pixels
    )


def test_printed_densities_are_the_recursion_alone(street) -> None:
    """Over the whole image and all sizes, without a share for what was never seen."""
    case, source, _ = street
    false = case.table.detections.xyxy[source < 0][:200]
    births, clutter = m09.printed_densities(Tracks.empty(), 100, false, 50, case, 25.0)
    assert births is None, "no track, nothing to learn from"
    assert clutter is not None
    assert clutter.rate == pytest.approx(len(false) / 50)
    np.testing.assert_array_equal(clutter.density.low, 0)
    np.testing.assert_array_equal(clutter.density.high, [640, 360, 640, 360])
    # It has found the two places, by far denser than a uniform density.
    assert clutter.density.uniform < 0.02
    at = to_cxcywh(false)
    assert np.log(clutter.density(at) * clutter.density.volume).mean() > 5
    refitted = m09_lessons.false_alarms(at, 50, case).learned.density
    assert refitted.uniform > clutter.density.uniform


def test_tracks_that_begin_on_nobody_are_counted(street) -> None:
    case = street[0]
    person = int(case.truth.identity[0])
    rows = np.flatnonzero(case.truth.identity == person)[:5]
    n = 2 * len(rows)
    away = case.truth.xyxy[rows] + 1000.0
    tracks = Tracks(
        np.tile(case.truth.frame[rows], 2),
        np.repeat([1, 2], len(rows)),
        np.concatenate([case.truth.xyxy[rows], away]),
        np.ones(n),
        np.full(n, -1),
        np.ones(n, np.bool_),
    )
    assert m09.on_objects(tracks, case) == 1


@pytest.fixture(scope="module")
def garden() -> m09_scenes.Halves:
    return m09_scenes.halves(("garden", 700))


@pytest.mark.slow
def test_paper_learns_lasting_false_alarms_from_few_marks(garden, monkeypatch) -> None:
    """In the garden a few hundred marks are enough, and the learned filter is better."""
    monkeypatch.setattr(m09, "MARKS", (10, 300))
    monkeypatch.setattr(m09, "PAPER_MARKS", 300)
    monkeypatch.setattr(m09, "JUDGED", 10)
    halved = replace(garden, test=m09_scenes.stretch(garden.test, 1, 150))
    scene = m09.learn((halved, 1))
    assert scene.alarms[10].frames <= scene.alarms[300].frames
    assert scene.at(299) is scene.alarms[10]
    assert scene.alarms[300].share > 0
    uniform, learned = (
        m09.work((SceneRun("garden", 1, run), halved, scene)) for run in (UM, "GM 300")
    )
    assert learned.scores.MOTA > uniform.scores.MOTA + 0.5


def test_marks_that_forbid_people_are_not_used(street) -> None:
    """False alarms that are learned where everybody walks, a thousand a frame: with them nobody is
    found.
    """
    case = m09_scenes.stretch(street[0], 1, 150)
    false = m09.false_detections(case)
    judge = m09.Judge(case, m09.uniform(case.info), false, 1)
    scene = paper_scene(case, 1.0)
    looked = m09.frames_until(false, 30, 1)
    assert (
        sum(int(false[k - 1].sum()) for k in looked[:-1])
        < 30
        <= sum(int(false[k - 1].sum()) for k in looked)
    )
    flooded = replace(scene.alarms[25].clutter, rate=1e5)
    assert judge.followed(m09.mixed(judge.stages, scene.births, flooded, 1.0), looked).sum() <= 0
    usual = judge.followed(judge.stages, looked)
    assert judge.share(scene.births, flooded, looked, usual) < 1


def _rate(part: Birth | Clutter) -> float:
    """Births a second, or false alarms a frame: everywhere, or around each detection."""
    names = (
        "births_per_second",
        "births_per_detection",
        "clutter_per_frame",
        "clutter_per_detection",
    )
    return next(rate for rate in (getattr(part, name, 0.0) for name in names) if rate)


def rate_and_kind(part: Birth | Clutter) -> tuple[type, float, object]:
    """Kind, rate, and what it stands beside or is spread over."""
    if isinstance(part, SceneBirth | SceneClutter):
        return (
            type(part),
            _rate(part),
            (
                part.births_per_detection
                if isinstance(part, SceneBirth)
                else part.clutter_per_detection
            ),
        )
    around = (
        "local" if isinstance(part, MeasurementBirth) and part.births_per_detection else "image"
    )
    return type(part), _rate(part), around if isinstance(part, MeasurementBirth) else None


def learned_scene(train: Case) -> m09_lessons.LearnedScene:
    """A scene in which everything was learned, the rates unlike each other."""
    width = float(train.info.width)
    height = float(train.info.height)
    density = uniform_density(
        np.array([0.0, 0, -9, -9, 5, 5]), np.array([width, height, 9, 9, 90, 180])
    )
    boxes = marginal(density, (0, 1, 4, 5))
    seen = TrackedObjects(0.1, LearnedDensity(3.0, boxes, 50))
    parts = (
        LearnedDensity(2.5, boxes, 9),
        seen,
        LearnedDensity(0.02, density, 9),
        LearnedDensity(0.05, density, 9),
    )
    return m09_lessons.LearnedScene(*parts, (1.0, 2.0, 3.0), 9)


@pytest.mark.slow
def test_a_scene_is_learned_and_tracked_better(garden) -> None:
    """The whole way, on a rendered scene too short for births but not for false alarms."""
    scene = m09_lessons.learn((garden, 1))
    uniform, learned = (
        m09_runs.work((SceneRun("garden", 1, run), garden, scene)) for run in (UM, "A2")
    )
    assert learned.scores.MOTA > uniform.scores.MOTA + 0.5
    assert learned.scores.false_tracks < 0.7 * uniform.scores.false_tracks
    assert len(learned.blocks) == m09_runs.BLOCKS
    assert sum(one.truth_boxes for one in learned.blocks) == learned.scores.truth_boxes


def test_delays_are_parted_by_where_somebody_is_first_detected() -> None:
    boxes = np.array([[0.0, 0, 10, 20], [100, 0, 110, 20]])
    frame = np.repeat(np.arange(1, 11), 2)
    identity = np.tile([1, 2], 10)
    truth = Truth(frame, identity, np.tile(boxes, (10, 1)), np.zeros(20, np.bool_))
    case = Case(
        "two",
        SequenceInfo(640, 360, 25.0, 10, "two"),
        truth,
        DetectionTable(frame, Detections.of(truth.xyxy)),
    )
    rows = np.flatnonzero((identity == 1) & (frame >= 4) | (identity == 2) & (frame >= 2))
    n = len(rows)
    tracks = Tracks(
        frame[rows],
        identity[rows],
        truth.xyxy[rows],
        np.ones(n),
        np.full(n, -1),
        np.ones(n, np.bool_),
    )
    assert m09_runs.delays(case, tracks, np.array([[-np.inf, 0, 20, 360]])) == ({1: 3.0}, {2: 1.0})
    assert m09_runs.delays(case, tracks, np.zeros((0, 4))) == ({}, {1: 3.0, 2: 1.0})


def test_each_seed_has_its_own_share_of_the_second_half(garden) -> None:
    """Of a rendered scene; together they are all of it, and a real scene is tested whole."""
    parts = [garden.tested_on(seed, 3).test for seed in (1, 2, 3)]
    assert [part.info.frames for part in parts] == [116, 117, 117]
    assert sum(len(part.truth.frame) for part in parts) == len(garden.test.truth.frame)
    assert sum(len(part.table.frame) for part in parts) == len(garden.test.table.frame)
    assert garden.tested_on(1, 1) is garden
    real = replace(garden, name="KITTI-17 public")
    assert real.tested_on(2, 3) is real


def test_a_run_with_the_same_stages_is_run_once(street, monkeypatch) -> None:
    """With a share of 1 the full model is that of GM; the scores are those of both."""
    train = m09_scenes.stretch(street[0], 1, 40)
    halved = m09_scenes.Halves("street", train, m09_scenes.stretch(street[0], 41, 80), np.eye(4))
    learned = {("street", 1): paper_scene(train, 1.0)}
    done = []

    def work(job: tuple[SceneRun, m09_scenes.Halves, m09.PaperScene]) -> m09_runs.SceneScores:
        done.append(job[0].run)
        return m09.work(job)

    study = scenes.Study("m09", m09.learn, m09.runs_of, m09.stages_of, work)
    runs = [SceneRun("street", 1, run) for run in (UM, GM, m09.WHOLE)]
    runs.append(SceneRun("street", 1, GM, frames=20))
    found = study.scored(runs, {("street", 1): halved}, learned, Options(quick=True))
    assert sorted(done) == [GM, GM, UM]
    assert list(found) == runs
    assert found[runs[1]] is found[runs[2]]
    assert found[runs[1]] is not found[runs[3]]
    alone = m09.work((runs[2], halved, learned["street", 1]))
    assert alone.scores.MOTA == found[runs[2]].scores.MOTA


def test_a_claim_is_judged_by_differences_and_their_error() -> None:
    """In the yard all five seeds are above, in the garden they are on both sides, in the arcade all
    are below.
    """
    gaps = {
        "yard": [0.5, 0.5, 0.6, 0.4, 0.5],
        "garden": [1.0, -1.0, 0.9, -0.9, 0.3],
        "arcade": [-0.2, -0.2, -0.3, -0.1, -0.2],
        "never run": [],
    }
    claim = m09_claims.judged("GM above UM", "+9 %", "word by word", "MOTA", gaps)
    assert claim.where == {"yard": True, "garden": None, "arcade": False}
    assert claim.ours.startswith("MOTA +0.120 ± ")
    assert claim.ours.endswith("; by scene -0.200 to +0.500")
    assert claim.verdict == (
        "holds on 1 of 3 (yard), does not on 1 (arcade), within its error on 1 (garden)"
    )
    assert m09_claims.judged("GM above UM", "+9 %", "", "MOTA", {"yard": []}).where == {}
