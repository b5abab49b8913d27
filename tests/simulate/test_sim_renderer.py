from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from phdtrack.errors import InputError
from phdtrack.simulate import (
    NAMED,
    DetectorModel,
    Look,
    Rendered,
    Scenario,
    Scene,
    Walk,
    make_scene,
)

STILL = Look(noise=0.0, flicker=0.0, plants=0, wave=0.0, lamps=0)
NOTHING = DetectorModel(clutter_rate=0.0)


def video(scene: Scene, look: Look | None = None, seed: int = 7):
    return Rendered(scene, np.random.default_rng(seed), look)


def difference(scene: Scene, look: Look, number: int) -> np.ndarray:
    """(H, W) what the figures change in a frame, in grey levels."""
    full = video(scene, look)
    bare = video(scene, look)
    none = np.zeros(0, np.int64)
    empty = replace(
        scene.figures,
        frame=none,
        identity=none,
        xyxy=np.zeros((0, 4)),
        distractor=none.astype(bool),
    )
    bare.scene = replace(scene, figures=empty)
    return np.abs(full.paint(number).astype(int) - bare.paint(number)).max(axis=2)


@pytest.mark.parametrize("name", NAMED)
def test_frames_have_the_stated_size(name: str) -> None:
    scene = make_scene(name, 0, frames=4)
    frames = list(video(scene))
    assert [f.number for f in frames] == [1, 2, 3, 4]
    assert [f.time for f in frames] == pytest.approx([0, 0.04, 0.08, 0.12])
    for frame in frames:
        assert frame.image.shape == (scene.info.height, scene.info.width, 3)
        assert frame.image.dtype == np.uint8
        assert frame.image.flags.c_contiguous
        assert 40 < frame.image.mean() < 200


def test_same_seed_gives_the_same_video() -> None:
    scene = make_scene("street", 1, frames=60)
    source = video(scene)
    first, again, same, other = (
        list(islice(v, 50, 53)) for v in (source, source, video(scene), video(scene, seed=8))
    )
    for a, b, c, d in zip(first, again, same, other, strict=True):
        assert (a.image == b.image).all()
        assert (a.image == c.image).all()
        assert (a.image != d.image).any()


def test_figures_are_drawn_at_the_truth() -> None:
    """Inside its box a figure changes the image a lot; away from all figures and their shadows
    nothing changes.
    """
    scene = make_scene("street", 2, lead_in=-10.0, frames=80, detector=NOTHING)
    seen = 0
    for number in (5, 40, 80):
        changed = difference(scene, STILL, number)
        for left, top, right, bottom in np.round(
            scene.truth.xyxy[scene.truth.frame == number]
        ).astype(int):
            inside = changed[max(top, 0) : bottom, max(left, 0) : right]
            assert inside.mean() > 12
            assert (inside > 15).mean() > 0.2
            seen += 1
        for left, top, right, bottom in scene.figures.xyxy[scene.figures.frame == number]:
            wide = 0.3 * (right - left)
            changed[
                max(int(top - 2), 0) : int(bottom + wide),
                max(int(left - 2), 0) : int(right + wide + 2),
            ] = 0
        assert (changed == 0).all()
    assert seen >= 6


def test_figure_fills_its_box() -> None:
    """Head at the top, a foot at the bottom, limbs near both sides at some time of the step."""
    world = Scenario("one", frames=200, arrivals=0.0, walks=(Walk(((0.1, 0.8), (0.9, 0.8))),))
    scene = make_scene(world, 0, NOTHING)
    extents = []
    for number in range(20, 60, 2):
        box = scene.figures.xyxy[scene.figures.frame == number][0]
        y, x = np.nonzero(difference(scene, replace(STILL, shadow=0.0), number) > 12)
        size = np.tile(box[2:] - box[:2], 2)
        extents.append((np.array([x.min(), y.min(), x.max() + 1, y.max() + 1]) - box) / size)
    extent = np.array(extents)
    assert np.abs(extent[:, [1, 3]]).max() < 0.06
    assert (extent[:, 0] > -0.06).all()
    assert (extent[:, 2] < 0.06).all()
    width = 1 + extent[:, 2] - extent[:, 0]
    assert width.max() > 0.75


def test_obstacles_hide_only_people_behind_them() -> None:
    for row, hidden in ((0.70, True), (0.95, False)):
        walks = (Walk(((0.5, row), (0.51, row)), speed=1e-6),)
        obstacles = ((0.4, 0.2, 0.6, 0.85),)
        scene = make_scene(
            Scenario("one", frames=1, arrivals=0.0, walks=walks, obstacles=obstacles), 0, NOTHING
        )
        assert (difference(scene, replace(STILL, shadow=0.0), 1) == 0).all() == hidden


def changing(scene: Scene, look: Look, frames: int) -> np.ndarray:
    """(frames - 1, H, W) bool: where neighbouring frames differ by more than 20 grey levels."""
    grey = np.array(
        [f.image.astype(np.int16).mean(axis=2) for f in islice(video(scene, look), frames)]
    )
    return np.abs(np.diff(grey, axis=0)) > 20


def test_plants_change_often_but_not_always() -> None:
    scene = make_scene("empty", 0, frames=80, detector=NOTHING)
    look = replace(STILL, plants=5, wave=0.09)
    moving = changing(scene, look, 80)
    boxes = video(scene, look).plant_boxes
    assert boxes.shape == (5, 4)
    near = np.zeros(moving.shape[1:], bool)
    fires = []
    for left, top, right, bottom in np.round(boxes).astype(int):
        fires.append(moving[:, max(top, 0) : bottom, max(left, 0) : right].sum(axis=(1, 2)) > 40)
        reach = 0.35 * (bottom - top)
        near[
            max(int(top - reach), 0) : int(bottom) + 1,
            max(int(left - reach), 0) : int(right + reach),
        ] = True
    assert (np.mean(fires, axis=1) > 0.1).sum() >= 4
    assert 0.1 < np.mean(fires) < 0.95
    assert not moving[:, ~near].any()
    assert not changing(scene, replace(look, wave=0.0), 10).any()


def test_leaves_move_in_every_frame() -> None:
    scene = make_scene("empty", 1, frames=30)
    calm, windy = (
        list(Rendered(scene, np.random.default_rng(2), look))
        for look in (STILL, replace(STILL, blown=3.0))
    )
    changed = [np.any(a.image != b.image, axis=2) for a, b in zip(calm, windy, strict=True)]
    assert sum(mask.any() for mask in changed) > 20
    share = np.mean(changed, axis=0)
    # Three leaves of a few per cent of the height cover little, and never the same place for long.
    assert 0.002 < share.mean() < 0.05
    assert share.max() < 0.3


def test_lamps_flicker_and_noise_have_their_strength() -> None:
    scene = make_scene("empty", 0, frames=150, detector=NOTHING)
    moving = changing(scene, replace(STILL, lamps=4), 75)
    assert 0 < moving.any(axis=(1, 2)).mean() < 1
    assert moving.any(axis=0).mean() < 0.03
    mean = np.array([f.image.mean() for f in video(scene, replace(STILL, flicker=0.03))])
    relative = mean / mean.mean()
    assert 0.015 < relative.std() < 0.05
    assert np.abs(np.diff(relative)).mean() > 0.005
    clean, *later = (f.image.astype(float) for f in islice(video(scene, STILL), 20))
    assert np.std([image.mean() for image in later]) < 0.1
    noisy = [
        f.image.astype(float) - clean for f in islice(video(scene, replace(STILL, noise=3.0)), 2)
    ]
    assert abs(np.std(noisy[0]) - 3.0) < 0.1
    assert abs(np.mean(noisy[0])) < 0.1
    assert abs(np.corrcoef(noisy[0].ravel(), noisy[1].ravel())[0, 1]) < 0.02
    with pytest.raises(InputError, match="Look"):
        Look(noise=-1.0)
