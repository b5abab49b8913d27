import numpy as np
import pytest

from phdtrack.arrays import iou
from phdtrack.errors import InputError
from phdtrack.simulate import NAMED, DetectorModel, Entrance, Scenario, Walk, make_scene
from phdtrack.simulate.detector import covered
from phdtrack.simulate.scenes import truth_rows
from phdtrack.types import Truth

PEOPLE = [name for name in NAMED if name != "empty"]


def of(truth: Truth, identity: int) -> tuple[np.ndarray, np.ndarray]:
    mine = truth.identity == identity
    return truth.frame[mine], truth.xyxy[mine]


@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize("seed", [0, 1])
def test_scene_is_consistent(name: str, seed: int) -> None:
    scene = make_scene(name, seed)
    for table in (scene.truth, scene.figures):
        pairs = np.stack([table.frame, table.identity], axis=1)
        assert len(np.unique(pairs, axis=0)) == len(pairs)
        assert (np.lexsort((table.identity, table.frame)) == np.arange(len(table))).all()
        assert ((table.frame >= 1) & (table.frame <= scene.info.frames)).all()
        assert (table.xyxy[:, 2:] > table.xyxy[:, :2]).all()
        assert (table.identity >= 1).all()
        assert not table.distractor.any()
    assert (np.diff(scene.detections.frame) >= 0).all()
    assert scene.detections.last <= scene.info.frames
    assert len(scene.source) == len(scene.detections)
    assert set(scene.source[scene.source > 0]) <= set(scene.truth.identity)
    assert -scene.source.min() <= len(scene.places)
    edge = np.tile([scene.info.width, scene.info.height], 2)
    assert ((scene.truth.xyxy >= 0) & (scene.truth.xyxy <= edge)).all()


def test_seed_determines_the_scene() -> None:
    a, b, c = (make_scene("street", seed, frames=60) for seed in (5, 5, 6))
    assert (a.truth.xyxy == b.truth.xyxy).all()
    assert (a.detections.detections.xyxy == b.detections.detections.xyxy).all()
    assert not np.array_equal(a.detections.detections.xyxy, c.detections.detections.xyxy)
    assert (
        make_scene("street", 5, frames=60, detector=DetectorModel(p_detect=0.3)).truth.xyxy
        == a.truth.xyxy
    ).all()


@pytest.mark.parametrize("name", PEOPLE)
def test_people_lower_in_the_image_are_larger(name: str) -> None:
    world = NAMED[name]
    box = world.figures(np.random.default_rng(4)).xyxy
    tall = box[:, 3] - box[:, 1]
    foot = box[:, 3]
    expected = (foot - world.horizon * world.height) / world.camera_height
    assert (np.abs(tall / expected - 1) <= 0.3 + 1e-9).all()
    assert np.corrcoef(tall, foot)[0, 1] > 0.8


@pytest.mark.parametrize("name", ["street", "crowd", "corridor"])
def test_people_walk_at_the_set_speed(name: str) -> None:
    """On the ground nobody moves faster than his own speed, and the mean of the fastest steps is
    the scene's speed.
    """
    world = NAMED[name]
    figures = world.figures(np.random.default_rng(8))
    speeds = []
    for identity in np.unique(figures.identity):
        frame, box = of(figures, identity)
        foot = np.stack([(box[:, 0] + box[:, 2]) / 2, box[:, 3]], axis=1)
        step = (
            np.hypot(*np.diff(world.camera.to_ground(foot), axis=0).T) * world.fps / np.diff(frame)
        )
        if len(step) > 10:
            speeds.append(np.quantile(step, 0.9))
    bound = 4 * world.speed_spread / np.sqrt(len(speeds))
    assert abs(np.mean(speeds) - world.speed) < bound
    assert np.max(speeds) < world.speed + 5 * world.speed_spread


def test_crossing_pairs_meet() -> None:
    truth = make_scene("crossing", 0).truth
    for a, b in ((1, 2), (3, 4), (5, 6)):
        frame_a, box_a = of(truth, a)
        frame_b, box_b = of(truth, b)
        _, i, j = np.intersect1d(frame_a, frame_b, return_indices=True)
        overlap = np.array([iou(box_a[[p]], box_b[[q]])[0, 0] for p, q in zip(i, j, strict=True)])
        side = np.sign(box_a[i, 0] - box_b[j, 0])
        assert (overlap > 0.2).any()
        assert side[0] != side[-1]


def test_occluded_people_stay_in_the_truth() -> None:
    scene = make_scene("occlusion", 0)
    hidden = covered(scene.truth, scene.obstacles)
    gone = np.unique(scene.truth.identity[hidden > 0.99])
    assert len(gone) >= 4
    for identity in gone:
        frame, _ = of(scene.truth, int(identity))
        assert (np.diff(frame) == 1).all()
    open_view = make_scene(
        "occlusion", 0, detector=DetectorModel(p_detect=1.0, occlusion=2.0, clutter_rate=0)
    )
    seen = np.isin(
        scene.truth.frame * 1000 + scene.truth.identity,
        open_view.detections.frame * 1000 + open_view.source,
    )
    assert not seen[hidden > 0.999].any()
    assert seen[hidden == 0].all()


def test_doors_are_where_people_appear() -> None:
    world = Scenario(
        "doors",
        entrances=(Entrance("door", (0.3, 0.6)), Entrance("right")),
        arrivals=1.0,
        pause_rate=0.0,
    )
    figures = world.figures(np.random.default_rng(0))
    at_door = 0
    for identity in np.unique(figures.identity):
        frame, box = of(figures, identity)
        ends = box[[0, -1]] if frame[-1] < world.frames else box[:1]
        door = np.abs(ends[:, [0, 2]].mean(axis=1) / 640 - 0.3) < 0.03
        at_door += (door & (np.abs(ends[:, 3] / 360 - 0.6) < 0.03)).any()
        assert (door | (ends[:, 2] > 640)).any()
    assert at_door >= 5
    assert world.doors_px.shape == (1, 4)


def test_unknown_names_suggest_the_nearest() -> None:
    with pytest.raises(InputError, match="Did you mean street"):
        make_scene("stret", 0)
    with pytest.raises(InputError, match="Did you mean arrivals"):
        make_scene("street", 0, arivals=2.0)


@pytest.mark.parametrize(
    "bad",
    [
        {"frames": 0},
        {"rows": (0.05, 0.9)},
        {"camera_height": 1.0},
        {"walks": (Walk(((0.1, 0.0), (0.9, 0.5))),)},
    ],
)
def test_impossible_settings_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(InputError, match="cenario"):
        make_scene("street", 0, **bad)


@pytest.mark.parametrize(
    ("frames", "boxes", "expected"),
    [
        ([1, 1], [[0, 0, 10, 20], [0, 0, 10, 30]], [1.0, 0.0]),
        ([1, 2], [[0, 0, 10, 20], [0, 0, 10, 30]], [0.0, 0.0]),
        ([1, 1], [[0, 0, 10, 20], [5, 0, 15, 30]], [5 / 9, 0.0]),
        ([1, 1], [[0, 0, 10, 20], [50, 0, 60, 30]], [0.0, 0.0]),
        ([1, 1, 1], [[0, 0, 10, 20], [0, 0, 5, 30], [0, 0, 5, 31]], [4 / 9, 1.0, 0.0]),
    ],
)
def test_covered_share_of_a_box(
    frames: list[int], boxes: list[list[float]], expected: list[float]
) -> None:
    truth = truth_rows(np.array(frames), np.arange(1, len(boxes) + 1), np.array(boxes, float))
    assert np.abs(covered(truth, np.zeros((0, 4))) - expected).max() <= 1 / 9 + 1e-9
    assert (covered(truth, np.array([[0.0, 0, 60, 40]])) == 1).all()
