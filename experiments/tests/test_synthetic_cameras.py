"""Synthetic cameras: the same for a seed, within their ranges, with the laws that they claim, and
readable as files. Bounds are four standard errors; seeds are fixed.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm, rankdata

from experiments import synthetic_cameras as cameras
from experiments import synthetic_cases as cases
from experiments.common import ROOT, Options
from experiments.regimes_scenes import PEERS
from experiments.synthetic_cameras import KINDS, SyntheticCamera, camera, drawn, write_camera
from experiments.synthetic_detector import (
    ORIGINS,
    SCORE_LAWS,
    DetectorLaw,
    SimulatedDetections,
    detect,
    detected,
)
from experiments.synthetic_worlds import (
    Figures,
    World,
    annotated,
    figures,
    gliding,
    wandering,
)
from phdtrack.errors import InputError
from phdtrack.formats import read_detections, read_seqinfo, read_truth

WORLD = replace(drawn(1, "cell")[0], width=2000, height=2000, fps=1.0, camera="fixed", obstacles=0)
# Without errors, false alarms and suppression.
PERFECT = DetectorLaw(
    p_detect=1.0,
    occlusion=1.0,
    miss_memory=0.0,
    low_share=0.0,
    merging=0.0,
    scores="sharp",
    score_power=1.0,
    centre_noise=0.0,
    size_noise=0.0,
    noise_memory=0.0,
    parts=0.0,
    parts_hidden=0.0,
    doubles=0.0,
    overlap=1.0,
    clutter=0.0,
    low_clutter=0.0,
    places=0,
    place_on=1.0,
    place_off=1.0,
    place_fires=0.0,
)


def grid_of(frames: int, n: int, visible: float = 1.0) -> Figures:
    """Objects of 40 by 60 pixels that stand apart, all as visible."""
    place = np.stack(np.divmod(np.arange(n), 30), axis=-1)[None] * 64.0 + [40, 40]
    centre = np.broadcast_to(place, (frames, n, 2))
    half = np.array([20.0, 30.0])
    return Figures(
        np.concatenate([centre - half, centre + half], axis=-1),
        np.ones((frames, n)),
        np.broadcast_to(np.arange(1, n + 1), (frames, n)),
        np.ones((frames, n), bool),
        np.full((frames, n), visible),
        np.zeros((frames, 2)),
    )


def found(shown: Figures, law: DetectorLaw, seed: int = 1, **world: float) -> SimulatedDetections:
    """Detections of figures."""
    scene = replace(WORLD, frames=len(shown.depth), **world)
    return detect(scene, shown, law, np.random.default_rng(seed))


def count(one: SimulatedDetections, origin: str) -> int:
    """The number of detections of one origin."""
    return int((one.origin == ORIGINS.index(origin)).sum())


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_the_same_camera(kind: str) -> None:
    one, same, other = (camera(seed, 2.0, kind) for seed in (5, 5, 11))
    for field in ("frame", "xyxy", "score", "origin", "source"):
        a, b, c = (getattr(each.detections, field) for each in (one, same, other))
        assert np.array_equal(a, b)
        assert field == "frame" or not np.array_equal(a, c)
    for a, b in zip(one.truth(), same.truth(), strict=True):
        assert np.array_equal(a, b)


def test_what_is_drawn_is_within_its_ranges() -> None:
    for seed in range(300):
        world, law = drawn(seed)
        kind = KINDS[world.kind]
        assert kind.fps[0] - 0.5 <= world.fps <= kind.fps[1] + 0.5
        assert kind.count[0] - 0.5 <= world.count <= kind.count[1] + 0.5
        assert world.camera in kind.cameras
        assert 10 <= world.frames / world.fps <= 60.5
        assert world.frames >= 40
        for name in ("speed", "turn", "standing", "spread", "change"):
            low, high = getattr(kind, name)
            assert low <= getattr(world, name) <= high
        assert 0.7 <= law.p_detect <= 0.98
        assert (law.low_share > 0) == (law.scores in ("sharp", "weak"))


def test_six_seeds_have_all_kinds_of_objects() -> None:
    for first in (0, 6, 102):
        assert {drawn(seed)[0].kind for seed in range(first, first + 6)} == set(KINDS)
    assert len({tuple(drawn(6 * k + i)[0].kind for i in range(6)) for k in range(20)}) > 10


@pytest.mark.parametrize("visible", [1.0, 0.5, 0.2])
def test_objects_are_detected_by_their_visible_share(visible: float) -> None:
    law = replace(PERFECT, p_detect=0.9, occlusion=1.5)
    rate = detected(WORLD, grid_of(200, 50, visible), law, np.random.default_rng(2)).mean()
    p = 0.9 * visible**1.5
    assert abs(rate - p) < 4 * np.sqrt(p * (1 - p) / 10_000)


def test_misses_last_without_being_more() -> None:
    """With a memory of 4 frames the rate is the same; the error is that of objects."""
    law = replace(PERFECT, p_detect=0.8, miss_memory=4.0)
    hits = detected(WORLD, grid_of(400, 100), law, np.random.default_rng(3))
    rates = hits.mean(axis=0)
    assert abs(rates.mean() - 0.8) < 4 * rates.std() / 10
    after_a_miss = (~hits[1:])[~hits[:-1]].mean()
    assert after_a_miss > 0.5


def test_a_memory_is_a_time_constant() -> None:
    for memory, dt in ((2.0, 0.5), (0.5, 0.1)):
        x = wandering(300, 200, memory, dt, np.random.default_rng(4))
        each = (x[1:] * x[:-1]).mean(axis=0)
        assert abs(each.mean() - np.exp(-dt / memory)) < 4 * each.std() / np.sqrt(200)
        assert abs((x**2).mean() - 1) < 4 * (x**2).mean(axis=0).std() / np.sqrt(200)


def test_cameras_and_arms_do_not_jump() -> None:
    """The variance is 1; a step is a fraction of that of a process without velocity."""
    for memory, dt in ((2.0, 0.1), (0.3, 0.2)):
        x = gliding(200, 200, memory, dt, np.random.default_rng(4))
        each = (x**2).mean(axis=0)
        assert abs(each.mean() - 1) < 4 * each.std() / np.sqrt(200)
        jumps = wandering(200, 200, memory, dt, np.random.default_rng(4))
        assert np.diff(x, axis=0).std() < 0.8 * np.diff(jumps, axis=0).std()
    assert np.diff(gliding(200, 200, 2.0, 0.1, np.random.default_rng(4)), axis=0).std() < 0.1


def test_clutter_has_its_rate() -> None:
    law = replace(PERFECT, clutter=2.0, low_clutter=5.0)
    one = found(grid_of(1000, 1), law)
    # Boxes that the border cuts to less than three pixels are lost: less than one in a hundred.
    for origin, rate in (("clutter", 2.0), ("low clutter", 5.0)):
        error = 4 * np.sqrt(rate / 1000)
        assert 0.99 * rate - error < count(one, origin) / 1000 < rate + error
    true = one.score[one.origin == 0].mean()
    clutter = one.score[one.origin == ORIGINS.index("clutter")].mean()
    assert one.score[one.origin == ORIGINS.index("low clutter")].mean() < clutter < true


def test_lasting_places_flicker_as_claimed() -> None:
    """They are on for 4 of 12 seconds, and then fire in 0.6 of the frames, two of three times again
    in the next one.
    """
    law = replace(PERFECT, places=200, place_on=4.0, place_off=8.0, place_fires=0.6)
    one = found(grid_of(400, 1), law, seed=5)
    fired = np.zeros((400, 200), bool)
    places = one.source < 0
    fired[one.frame[places] - 1, -one.source[places] - 1] = True
    each = fired.mean(axis=0)
    assert abs(each.mean() - 0.2) < 4 * each.std() / np.sqrt(200)
    again = fired[1:][fired[:-1]].mean()
    assert again == pytest.approx(0.6 * (1 / 3 + 2 / 3 * np.exp(-12 / 32)), abs=0.05)


@pytest.mark.parametrize("scores", SCORE_LAWS)
def test_scores_tell_objects_as_claimed(scores: str) -> None:
    """The area under the curve; at one frame a second successive scores are independent."""
    law = replace(PERFECT, scores=scores, clutter=20.0, score_power=1.7)
    one = found(grid_of(100, 20), law, seed=6)
    true = one.source > 0
    if scores == "none":
        assert set(one.score.tolist()) == {1.0}
        return
    (high, a), (low, b) = SCORE_LAWS[scores]
    expected = norm.cdf((high - low) / np.hypot(a, b))
    rank = rankdata(one.score)
    n, m = true.sum(), (~true).sum()
    area = (rank[true].sum() - n * (n + 1) / 2) / (n * m)
    assert abs(area - expected) < 4 * np.sqrt(expected * (1 - expected) / min(n, m))
    assert expected == pytest.approx({"sharp": 0.999, "weak": 0.806}.get(scores, 0.5), abs=1e-3)


def test_boxes_err_by_the_claimed_share_of_their_size() -> None:
    law = replace(PERFECT, centre_noise=0.05, size_noise=0.03, noise_memory=2.0)
    shown = grid_of(300, 100)
    one = found(shown, law, seed=7)
    order = np.lexsort((one.source, one.frame))
    error = one.xyxy[order].reshape(300, 100, 4) - shown.xyxy
    centre = (error[..., :2] + error[..., 2:]) / 2 / [40, 60]
    size = (error[..., 2:] - error[..., :2]) / [40, 60]
    for values, deviation in ((centre, 0.05), (size, 0.03)):
        squares = (values**2).mean(axis=(0, 2))
        assert abs(squares.mean() - deviation**2) < 4 * squares.std() / 10
    again = (centre[1:] * centre[:-1]).mean() / (centre**2).mean()
    assert again == pytest.approx(np.exp(-1 / 2), abs=0.03)


def test_low_detections_replace_misses() -> None:
    law = replace(PERFECT, p_detect=0.5, low_share=0.6)
    one = found(grid_of(100, 50), law, seed=8)
    low = one.origin == ORIGINS.index("low")
    assert abs(low.sum() / 5000 - 0.3) < 4 * np.sqrt(0.3 * 0.7 / 5000)
    assert one.score[low].mean() < 0.3 < 0.8 < one.score[one.origin == 0].mean()


def test_parts_and_doubles_have_their_shares() -> None:
    law = replace(PERFECT, parts=0.1, doubles=0.2)
    one = found(grid_of(100, 60), law, seed=9)
    for origin, share in (("part", 0.1), ("double", 0.2)):
        # Their episodes last half a second, less than a frame here.
        number = count(one, origin)
        assert abs(number / 6000 - share) < 5 * np.sqrt(share * (1 - share) / 6000)
    high = one.xyxy[:, 3] - one.xyxy[:, 1]
    part = one.origin == ORIGINS.index("part")
    assert (high[part] < 0.76 * 60).all()
    assert high[one.origin == 0] == pytest.approx(60)


def two_that_overlap() -> Figures:
    """In one frame an object that hides two thirds of another."""
    xyxy = np.array([[[100.0, 100, 160, 200], [115, 90, 175, 190]]])
    return Figures(
        xyxy,
        np.array([[5.0, 9.0]]),
        np.array([[1, 2]]),
        np.ones((1, 2), bool),
        np.array([[1.0, 1.0]]),
        np.zeros((1, 2)),
    )


def test_an_object_that_merges_gets_one_box_with_the_hidden_one() -> None:
    one = found(two_that_overlap(), replace(PERFECT, merging=1.0))
    assert one.xyxy.tolist() == [[100, 90, 175, 200]]
    assert one.source.tolist() == [1]
    assert len(found(two_that_overlap(), PERFECT).frame) == 2


def test_the_lower_of_two_overlapping_boxes_is_left_out() -> None:
    one = found(two_that_overlap(), replace(PERFECT, overlap=0.4))
    both = found(two_that_overlap(), PERFECT)
    assert one.source.tolist() == [both.source[both.score.argmax()]]


def walking(**changed: object) -> World:
    """Twelve small cells in a large frame, which rarely meet."""
    cells = replace(WORLD, count=12, size=20.0, speed=0.4, turn=0.0, standing=0.0, spread=0.0)
    return replace(cells, fps=5.0, frames=100, change=0.0, dwell=2.0, **changed)


def centres(world: World, seed: int) -> np.ndarray:
    """(T, N, 2) the centres, NaN where another object follows in the next frame."""
    shown = figures(world, np.random.default_rng(seed))
    middle = (shown.xyxy[..., :2] + shown.xyxy[..., 2:]) / 2
    middle[:-1][shown.identity[1:] != shown.identity[:-1]] = np.nan
    return middle


def test_objects_have_the_claimed_speed() -> None:
    speeds = [
        np.nanmedian(np.linalg.norm(np.diff(centres(walking(), seed), axis=0), axis=-1), axis=0)
        for seed in range(6)
    ]
    each = np.concatenate(speeds) * 5
    assert abs(each.mean() - 0.4 * 20) < 4 * each.std() / np.sqrt(len(each))


def test_objects_stand_for_the_claimed_share() -> None:
    world = walking(standing=0.4)
    shares = []
    for seed in range(10):
        steps = np.linalg.norm(np.diff(centres(world, seed), axis=0), axis=-1)
        # They slow down and start within less than a second.
        shares.append(np.nanmean(steps < 0.5 * 0.4 * 20 / 5, axis=0))
    each = np.concatenate(shares)
    assert abs(each.mean() - 0.4) < 4 * each.std() / np.sqrt(len(each))


def test_near_objects_hide_far_ones() -> None:
    """The visible share is that of a finer grid, in which a figure fills four fifths of its box."""
    world = replace(drawn(0, "pedestrian")[0], frames=5, fps=5.0, count=30, camera="fixed")
    world = replace(world, obstacles=0, width=640, height=480, size=100.0)
    shown = figures(world, np.random.default_rng(1))
    steps = (np.arange(60) + 0.5) / 60
    differences = []
    for k, i in zip(*np.nonzero(shown.shown), strict=True):
        low, high = np.split(np.clip(shown.xyxy[k, i], 0, [640, 480] * 2), 2)
        x, y = np.meshgrid(*(low[d] + steps * (high - low)[d] for d in (0, 1)))
        hidden = np.zeros(x.shape, bool)
        for j in np.flatnonzero(shown.depth[k] < shown.depth[k, i]):
            box = shown.xyxy[k, j]
            middle, half = box[[0, 2]].mean(), 0.4 * (box[2] - box[0])
            hidden |= (np.abs(x - middle) < half) & (y > box[1]) & (y < box[3])
        differences.append(1 - hidden.mean() - shown.visible[k, i])
    # An edge is missed by up to half a step of the grid of seven, to both sides alike.
    assert np.abs(differences).mean() < 1 / 28
    assert abs(np.mean(differences)) < 4 * np.std(differences) / np.sqrt(len(differences))
    assert (shown.visible[shown.shown] < 0.5).mean() > 0.05


def test_annotators_interpolate_over_short_gaps_only() -> None:
    visible = np.array([[1, 0, 0, 1, 0, 0, 0, 0, 1.0], [0, 0, 0, 0, 1, 1, 1, 1, 1.0]]).T
    identity = np.array([[1] * 9, [2, 2, 3, 3, 3, 3, 3, 3, 3]]).T
    kept = annotated(visible, identity, 3)
    assert kept[:, 0].tolist() == [True] * 4 + [False] * 4 + [True]
    # Two frames of one object and two of the next one.
    assert kept[:, 1].all()


def readable(one: SyntheticCamera, folder: Path) -> None:
    """The files hold what the case has."""
    write_camera(one, folder)
    case = cases.case_of(one)
    assert read_seqinfo(folder) == case.info
    notices: list[str] = []
    truth = read_truth(folder / "gt" / "gt.txt", notices=notices)
    table = read_detections(folder / "det_synthetic" / "det.txt")
    assert notices == []
    order = np.lexsort((case.truth.identity, case.truth.frame))
    again = np.lexsort((truth.identity, truth.frame))
    assert np.array_equal(truth.frame[again], case.truth.frame[order])
    assert np.array_equal(truth.identity[again], case.truth.identity[order])
    assert truth.xyxy[again] == pytest.approx(case.truth.xyxy[order], abs=0.011)
    assert np.array_equal(table.frame, case.table.frame)
    assert table.detections.xyxy == pytest.approx(case.table.detections.xyxy, abs=0.011)
    assert table.detections.confidence == pytest.approx(case.table.detections.confidence)
    assert case.truth.xyxy.min() >= 0
    assert (case.truth.xyxy[:, 2:] <= [case.info.width, case.info.height]).all()
    # An identity is in a frame at most once.
    assert len(np.unique(np.stack([truth.frame, truth.identity]), axis=1).T) == len(truth)


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_a_camera_are_read_by_the_package(kind: str, tmp_path: Path) -> None:
    one = camera(14, 4.0, kind)
    assert len(one.truth()[0]) > 20
    readable(one, tmp_path)


def test_peers_scores_are_kept_for_the_cameras_of_both_sets() -> None:
    rows = cases.kept_peers()
    seeds = (*cameras.DEVELOPMENT, *cameras.FINAL)
    assert [(row["sequence"], row["name"]) for row in rows] == [
        (cameras.name_of(seed), peer) for seed in seeds for peer in PEERS
    ]
    assert all(-1000 < float(row[name]) <= 100 for row in rows for name in cases.SCORES)


def test_kept_scores_of_another_camera_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = [row for row in cases.kept_peers() if row["sequence"] == "camera-19"]
    monkeypatch.setattr(cases, "CSV", tmp_path / "peers.csv")
    cases.keep_peers(kept)
    assert cases.peers_of_cameras([19], Options()) == kept
    cases.keep_peers([{**row, "detections": "7"} for row in kept])
    with pytest.raises(InputError, match=r"detections of camera-19, got those on 7.*Delete"):
        cases.peers_of_cameras([19], Options())


def test_missing_scores_need_the_environment_of_the_peers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cases, "CSV", tmp_path / "peers.csv")
    monkeypatch.setattr("experiments.common.PEERS_PYTHON", tmp_path / "python")
    with pytest.raises(InputError, match=r"environment is missing.*make peers"):
        cases.peers_of_cameras([1], Options())


def test_the_peers_environment_needs_nothing_of_the_package() -> None:
    code = "import sys, experiments.synthetic_peers\n"
    code += "print([name for name in sys.modules if name.startswith('phdtrack')])"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
