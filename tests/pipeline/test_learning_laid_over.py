"""What is learned while tracking lies over what is shipped, and rests on a run that knows nothing of it."""

from dataclasses import replace

import numpy as np
import pytest
from learning_cases import scores, street

from phdtrack import config, pipeline
from phdtrack.arrays import to_cxcywh
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.formats import read_detections, read_truth
from phdtrack.models.clutter import BoxClutter
from phdtrack.scene import read_scene, write_scene
from phdtrack.types import SequenceInfo


def stages(info, *sets, preset="mot15"):
    """By default without scores, which tell most false alarms: here places do."""
    return config.build(config.load(sets=sets, preset=preset), info)


def steps(built, table, frames, fps=25.0):
    """The state and the step of each frame."""
    numbered = ((k, (k - 1) / fps, table.at(k)) for k in range(1, frames + 1))
    return list(pipeline.run(built, numbered, np.random.default_rng(0)))


@pytest.mark.parametrize("kind", ["pmb", "particle-phd"])
def test_as_long_as_nothing_is_in_use_tracks_are_the_same(kind):
    scene, filter_kind = street(1, 250), f"filter.kind={kind}"
    runs = [
        steps(stages(scene.info, filter_kind, *more), scene.detections, 250)
        for more in ((), ("learn.kind=online", "learn.verdict_delay=60.0"))
    ]
    assert runs[1][-1][0].learned.known.last is None
    for (_, plain), (_, learning) in zip(*runs, strict=True):
        np.testing.assert_array_equal(learning.tracks.xyxy, plain.tracks.xyxy)
        np.testing.assert_array_equal(learning.tracks.identity, plain.tracks.identity)
        np.testing.assert_array_equal(learning.info.clutter, plain.info.clutter)
    assert sum(len(step.tracks) for _, step in runs[0]) > 300


@pytest.fixture(scope="module")
def followed():
    """A street after a minute, and where the model is that was learned."""
    scene = street(1, 1500)
    built = stages(scene.info, "learn.kind=online", "learn.memory=2.0")
    return scene, built, steps(built, scene.detections, 1500)


def test_false_alarms_come_to_those_that_are_shipped(followed):
    scene, built, found = followed
    learned = found[-1][0].learned
    model = built.learning.model(learned, built.model)
    assert isinstance(built.model.clutter, BoxClutter)
    assert model.clutter.clutter_per_detection == built.model.clutter.clutter_per_detection
    z = built.model.sensor.measure(scene.detections.at(1500))
    alone, shipped = model.clutter.clutter_per_frame * model.clutter.density(z[:4]), built.model.clutter.intensity(z)
    np.testing.assert_allclose(model.clutter.intensity(z), shipped + alone, rtol=1e-9)


def test_births_go_from_where_objects_are_to_where_they_enter(followed):
    scene, built, found = followed
    learned = found[-1][0].learned
    birth = built.learning.model(learned, built.model).birth
    assert birth.births_per_detection == built.model.birth.births_per_detection
    truth = scene.truth
    first = np.unique(truth.identity, return_index=True)[1]
    enter = to_cxcywh(truth.xyxy[first[truth.frame[first] > 1]])
    there = to_cxcywh(truth.xyxy[:: len(truth.xyxy) // 300])

    def more(z):
        z = np.vstack([z, np.ones((len(built.model.sensor.measure(scene.detections.at(1))) - 4, z.shape[1]))])
        seen = built.model.sensor.states(z)
        return birth.around(seen, 1.0)[0] / built.model.birth.density(z)

    assert more(enter).mean() > 3
    # About as many births of objects' detections, all in all, as without learning, but of most far fewer.
    assert 0.25 < more(there).mean() < 2
    assert np.median(more(there)) < 0.25


def test_the_shadow_tracker_knows_nothing_of_what_was_learned(followed):
    scene, _, found = followed
    assert found[-1][0].learned.clutter is not None
    plain = steps(stages(scene.info), scene.detections, 1500)
    shadow = found[-1][0].learned.shadow.intensity.present
    np.testing.assert_array_equal(shadow.targets["r"], plain[-1][0].intensity.present.targets["r"])
    np.testing.assert_array_equal(shadow.mean, plain[-1][0].intensity.present.mean)
    assert not np.array_equal(found[-1][1].info.clutter, plain[-1][1].info.clutter)


def test_what_is_in_use_is_written_with_where_objects_are(followed, tmp_path):
    scene, built, found = followed
    mode = found[-1][0].learned.known.regime
    write_scene(tmp_path / "scene.json", built.learning.rule.scene(mode, "street"))
    back = read_scene(tmp_path / "scene.json")
    assert back.births is not None
    assert back.clutter.rate == mode.clutter.rate
    objects = scores(scene.truth, pipeline.finish(built, found[-1][0]), 1, 1500).truth_boxes / 1500
    assert back.followed.objects.rate == pytest.approx(0.9 * objects, rel=0.1)
    # Which false alarms are followed nobody has seen, so that nobody is held back.
    given = [f"{name}.kind=scene" for name in ("birth", "clutter")]
    files = [f"{name}.file={str(tmp_path / 'scene.json')!r}" for name in ("birth", "clutter")]
    fixed = stages(scene.info, *given, *files)
    assert fixed.model.birth.among is not None
    assert not isinstance(fixed.associator, FalseTrackRejection)
    # What is out of use is left out, and any size may come when it is learned on.
    unused = built.learning.rule.scene(replace(mode, births=replace(mode.births, trusted=False)), "street")
    assert unused.births is None
    again = stages(scene.info, "learn.kind=online", f"learn.file={str(tmp_path / 'scene.json')!r}")
    begun = again.learning.start()
    assert begun.known.regime.clutter.density.high.tolist() == [640, 360, 640, 360]
    assert begun.birth.births_per_detection == built.model.birth.births_per_detection
    assert begun.clutter.density.high[2] < 640


# Where the detector doubles people and misses them, who stands there was once learned away within seconds.
@pytest.mark.parametrize(
    ("name", "kind", "size", "fps", "gain"),
    [
        ("PETS09-S2L1", "public", (768, 576), 7.0, -0.01),
        ("PETS09-S2L1", "frcnn", (768, 576), 7.0, -0.01),
        ("ADL-Rundle-6", "frcnn", (1920, 1080), 30.0, -0.01),
    ],
)
def test_on_real_streets_learning_is_not_worse(data, name, kind, size, fps, gain):
    folder = data / "mot15" / name
    truth, table = read_truth(folder / "gt" / "gt.txt"), read_detections(folder / f"det_{kind}" / "det.txt")
    frames = int(truth.frame.max())
    info, mota = SequenceInfo(*size, fps, frames, name), []
    for sets in ((), ("learn.kind=online",)):
        built = stages(info, *sets, preset="default")
        state, _ = steps(built, table, frames, fps)[-1]
        mota.append(scores(truth, pipeline.finish(built, state), 1, frames).mota)
    assert mota[1] > mota[0] + gain
