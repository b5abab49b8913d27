"""Descriptors that say nothing, or the wrong thing, do no harm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from appearance_cases import LOOKS, frame_of, tracker_of
from phdtrack import Tracker
from phdtrack.metrics import evaluate
from phdtrack.simulate import Scene, make_scene
from phdtrack.types import F4, F8, I8, Tracks
from tracker_cases import equal

SEEDS = (1, 2, 3, 4, 5, 6)
FEW = SEEDS[:2]
few_and_many = pytest.mark.parametrize(
    "seeds", [FEW, pytest.param(SEEDS, marks=pytest.mark.slow)], ids=["few", "many"]
)
FRAMES = 200
D = 16
# MOTA and IDF1, online and corrected.
Figures = tuple[float, float, float, float]
# The descriptors of a frame, of boxes (n, 4) and the objects (n,) that these are of.
Source = Callable[[np.random.Generator, F8, I8], np.ndarray]


@cache
def crowd(seed: int) -> Scene:
    """Twenty people, who cross each other at all times."""
    return make_scene("crowd", seed, frames=FRAMES)


def looks(rng: np.random.Generator, source: I8) -> F4:
    """Views of objects, each of which looks like itself."""
    own = np.random.default_rng(8).normal(0, 1, (200, D))
    return np.asarray(own[source % 200] + rng.normal(0, 0.4, (len(source), D)), np.float32)


def constant(rng: np.random.Generator, boxes: F8, source: I8) -> np.ndarray:
    return np.ones((len(boxes), D))


def random(rng: np.random.Generator, boxes: F8, source: I8) -> np.ndarray:
    return rng.normal(0, 1, (len(boxes), D))


def overlaps(boxes: F8) -> F8:
    """(n, n) the area that each two boxes have in common, 0 of a box with itself."""
    low = np.maximum(boxes[:, None, :2], boxes[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], boxes[None, :, 2:])
    common = np.maximum(high - low, 0).prod(axis=2)
    np.fill_diagonal(common, 0)
    return common


def of_neighbours(rng: np.random.Generator, boxes: F8, source: I8) -> np.ndarray:
    """Of the box that covers most of each, if any does: what stands in front."""
    common = overlaps(boxes)
    covered = common.any(axis=1)
    shown = np.where(covered, source[common.argmax(axis=1)], source)
    return looks(rng, shown)


def sometimes_of_neighbours(rng: np.random.Generator, boxes: F8, source: I8) -> np.ndarray:
    """At any time half of those that are covered have that one's."""
    shown = of_neighbours(rng, boxes, source)
    own = looks(rng, source)
    return np.where(rng.random((len(boxes), 1)) < 0.5, shown, own)


@dataclass
class Swapping:
    """Two objects that cover more than a third of each other swap what they look like, for good."""

    look: dict[int, int] = field(default_factory=dict)
    met: set[tuple[int, int]] = field(default_factory=set)

    def __call__(self, rng: np.random.Generator, boxes: F8, source: I8) -> np.ndarray:
        area = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
        near = overlaps(boxes) > np.minimum(area[:, None], area[None]) / 3
        for i, j in np.argwhere(np.triu(near)).tolist():
            pair = (int(source[i]), int(source[j]))
            if min(pair) > 0 and pair not in self.met:
                a, b = pair
                self.met |= {(a, b), (b, a)}
                kept = self.look.get(a, a)
                self.look[a] = self.look.get(b, b)
                self.look[b] = kept
        shown = [self.look.get(one, one) for one in source.tolist()]
        return looks(rng, np.array(shown, np.int64))


def of_each(rng: np.random.Generator, boxes: F8, source: I8) -> np.ndarray:
    return looks(rng, source)


SOURCES: dict[str, Callable[[], Source]] = {
    "constant": lambda: constant,
    "random": lambda: random,
    "of the box in front": lambda: of_neighbours,
    "sometimes of the box in front": lambda: sometimes_of_neighbours,
    "swapped at crossings": Swapping,
    "right": lambda: of_each,
}


@cache
def figures(seed: int, name: str) -> Figures:
    """Without descriptors, or with those of one of `SOURCES`."""
    source = SOURCES[name]() if name else None
    scene = crowd(seed)
    info = scene.info
    kind = "none" if source is None else "learned"
    tracker = Tracker((info.width, info.height), fps=info.fps, appearance={"kind": kind})
    rng = np.random.default_rng(seed)
    online = []
    for k in range(1, FRAMES + 1):
        found = scene.detections.at(k)
        if source is not None and len(found):
            shown = source(rng, found.xyxy, scene.source[scene.detections.places(k)])
            found = replace(found, embeddings=shown.astype(np.float32))
        online.append(tracker.update(found))
    rows = Tracks.concatenate(online)
    scores = [
        evaluate(scene.truth, tracks, frames=FRAMES)
        for tracks in (rows.select(rows.confirmed), tracker.tracks())
    ]
    return (scores[0].MOTA, scores[0].IDF1, scores[1].MOTA, scores[1].IDF1)


def gains(name: str, seeds: tuple[int, ...]) -> np.ndarray:
    """(seeds, 4) gains over those without descriptors."""
    return np.array([np.subtract(figures(k, name), figures(k, "")) for k in seeds])


def test_constant_descriptors_change_nothing():
    np.testing.assert_array_equal(gains("constant", FEW), 0)


@pytest.mark.parametrize("filter_", ["gm-phd", "none", "mht", "pmbm"])
def test_constant_looks_change_nothing_for_other_filters(filter_: str):
    plain = tracker_of(filter={"kind": filter_}, appearance={"kind": "none"})
    other = tracker_of(filter={"kind": filter_})
    for k in range(60):
        found = frame_of([0, 1, 2, 3] if k % 7 else [0, 2], k, LOOKS)
        alike = replace(found, embeddings=np.ones((len(found), D), np.float32))
        assert equal(plain.update(replace(found, embeddings=None)), other.update(alike))
    assert equal(plain.tracks(), other.tracks())


@few_and_many
@pytest.mark.parametrize("name", list(SOURCES)[1:-1])
def test_wrong_descriptors_do_no_harm(name: str, seeds: tuple[int, ...]):
    """Within 0.003 of none, or better, as far as so many seeds can tell."""
    each = gains(name, seeds)
    error = each.std(axis=0, ddof=1) / np.sqrt(len(each))
    assert (each.mean(axis=0) > -0.003 - 2 * error).all()
    # Not by a large error alone.
    assert (each.mean(axis=0) > -0.015).all()


@few_and_many
def test_right_descriptors_keep_identities(seeds: tuple[int, ...]):
    """In the same scenes, so that the tests above could see harm."""
    mota, idf1, corrected_mota, corrected_idf1 = gains("right", seeds).mean(axis=0)
    assert mota > 0.01
    assert idf1 > 0.02
    assert corrected_mota > 0.01
    assert corrected_idf1 > 0.05
