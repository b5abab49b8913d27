"""Colours as a cue: what a box looks like, what is learned of a stream, and who is who by it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from smoothing_cases import model_of, piece, sequence, walk

from phdtrack.smooth import Smoothing
from phdtrack.smooth.appearance import Distances, histograms, log_likelihood_ratio
from phdtrack.smooth.paths import paths_of

MODEL = model_of(scaled_noise=True, acceleration=0.005, size_noise=0.05)
SHIRTS = {1: (200, 40, 40), 2: (40, 40, 200), 3: (60, 180, 60)}


def painted(boxes: dict[int, np.ndarray], rng: np.random.Generator, size=(480, 640)) -> np.ndarray:
    """A grey picture with noise, and in it people in their shirts, above dark trousers."""
    image = np.full((*size, 3), 120.0)
    for who, (x, y, w, h) in boxes.items():
        left, right, top, bottom = (int(v) for v in (x - w / 2, x + w / 2, y - h / 2, y + h / 2))
        image[top : int(y), left:right] = SHIRTS[who]
        image[int(y) : bottom, left:right] = (50, 50, 50)
    return np.clip(image + rng.normal(0, 12, image.shape), 0, 255).astype(np.uint8)


def around(box: np.ndarray) -> np.ndarray:
    """(1, 4) left, top, right, bottom of centre and size (4,)."""
    return np.concatenate([box[:2] - box[2:] / 2, box[:2] + box[2:] / 2])[None]


def test_a_box_is_two_histograms_of_its_inside(rng):
    image = painted({1: np.array([100.0, 100, 40, 80])}, rng)
    whole, shifted, other = histograms(image, np.array([[80.0, 60, 120, 140], [82, 62, 122, 142], [300, 60, 340, 140]]))
    assert whole.shape == (256,)
    np.testing.assert_allclose(np.linalg.norm(whole.reshape(2, -1), axis=1), 1, rtol=1e-5)
    # The upper half against OpenCV on those very pixels: 80 % to 20 % of the width, 10 % to 50 % of the height.
    inside = cv2.cvtColor(np.ascontiguousarray(image[68:100, 88:112]), cv2.COLOR_BGR2HSV).reshape(-1, 3)
    counted, _ = np.histogramdd(inside, bins=(8, 4, 4), range=((0, 180), (0, 256), (0, 256)))
    np.testing.assert_allclose(whole[:128], np.sqrt(counted.ravel() / len(inside)), atol=1e-6)
    assert whole[:128] @ shifted[:128] > 0.9
    assert whole[:128] @ other[:128] < 0.2


def test_nothing_is_seen_outside_the_picture_or_in_a_speck(rng):
    looks = histograms(painted({}, rng), np.array([[-90.0, -90, -10, -10], [10, 10, 13, 14], [700, 10, 800, 200]]))
    assert np.isnan(looks).all()
    assert histograms(painted({}, rng), np.zeros((0, 4))).shape == (0, 256)


def test_the_ratio_is_that_of_two_gaussians_and_falls_with_the_distance():
    alike = Distances((0.3, 0.1), (0.7, 0.2))
    d = np.linspace(0, 1, 101)
    ratio = alike.log_ratio(d)
    assert (np.diff(ratio) <= 1e-12).all()
    assert ratio[50] == pytest.approx(-0.5 * 4 + 0.5 * 1 + np.log(2))
    np.testing.assert_array_equal(ratio[d < 0.3], ratio[30])
    np.testing.assert_array_equal(ratio[d > 0.7], ratio[70])
    assert Distances((0.7, 0.1), (0.3, 0.1)).log_ratio(d).tolist() == [0] * 101
    assert alike.log_ratio(np.array([np.nan])).tolist() == [0]


@pytest.fixture
def swapped(rng):
    """Red and blue stop in one place, go out of sight there, and come out again to both sides; green walks elsewhere."""
    n = 220
    still = [walk(rng, n, (300 + 12 * k, 200), (0, 0), noise=1.0) for k in range(2)]
    green = walk(rng, n, (60, 400), (2, 0), noise=1.0)
    before = [piece(w, 1, (1, 80)) for w in still]
    after = [piece(w, 1, (111, n)) for w in still]
    pieces, who = [*before, *after[::-1], piece(green, 1, (1, n))], {1: 1, 2: 2, 3: 1, 4: 2, 5: 3}
    tracks, measured = sequence(pieces, n, MODEL)
    looks = {}
    for number in range(1, n + 1):
        rows = [(i, p[number]) for i, p in enumerate(pieces, start=1) if number in p]
        # Each is painted alone, in a picture of his own: what is asked is who wears what, not who hides whom.
        own = [np.array([40, 60, *box[2:]]) for _, box in rows]
        seen = [painted({who[i]: box}, rng, (120, 80)) for (i, _), box in zip(rows, own, strict=True)]
        looks[number] = np.concatenate([histograms(a, around(box)) for a, box in zip(seen, own, strict=True)])
    return tracks, measured, measured.with_appearance(looks)


def test_colours_tell_who_is_who_where_places_mislead(swapped):
    tracks, blind, seeing = swapped
    for measured, wanted in ((blind, {0: 3, 1: 2}), (seeing, {0: 2, 1: 3})):
        found = Smoothing(appearance=True).smooth(tracks, measured, MODEL)
        paths = paths_of(found, measured)
        assert len(paths) == 3
        # Old rows keep their detections: the one of frame 220 says which piece went on.
        names = {}
        for k, old in enumerate((1, 2)):
            mine = tracks.detection[(tracks.frame == 80) & (tracks.identity == old)]
            row = (found.frame == 80) & (found.detection == mine)
            name = found.identity[row].item()
            late = found.detection[(found.frame == 220) & (found.identity == name)].item()
            names[k] = 2 + late
        assert names == wanted


def test_what_is_not_known_says_nothing(swapped):
    tracks, measured, seeing = swapped
    paths = paths_of(tracks, measured)
    pair = np.array([0, 1]), np.array([2, 3])
    nothing = np.full_like(seeing.appearance, np.nan)
    assert log_likelihood_ratio(paths, nothing, *pair).tolist() == [0, 0]
    assert (log_likelihood_ratio(paths, seeing.appearance, *pair) > 2).all()
    assert (log_likelihood_ratio(paths, seeing.appearance, np.array([0, 1]), np.array([3, 2])) < -2).all()


def test_frames_that_nobody_looked_at_are_unknown(swapped):
    _, measured, seeing = swapped
    some = measured.with_appearance({5: seeing.appearance[measured.start[4] : measured.start[5]]})
    assert np.isfinite(some.appearance[measured.start[4] : measured.start[5]]).all()
    assert np.isnan(np.delete(some.appearance, np.arange(*measured.start[4:6]), axis=0)).all()
    assert measured.with_appearance({}) is measured
    assert replace(measured).appearance.shape[1] == 0


def test_only_who_asks_looks(rng):
    image, box = painted({}, rng), np.array([[10.0, 10, 60, 90]])
    assert Smoothing().describe(image, box).shape == (1, 0)
    assert Smoothing(appearance=True, stitching=False).describe(image, box).shape == (1, 0)
    assert Smoothing(appearance=True).describe(image, box).shape == (1, 256)
