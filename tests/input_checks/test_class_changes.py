"""Warnings of objects whose class changes from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from input_checks.streams import scored, walkers, warnings
from phdtrack.types import F8

RATES = [(1.0, 80), (25.0, 120), (60.0, 120)]


def changing(
    frames: int, count: int, fps: float, share: float = 0.4, rare: int = 1
) -> Iterator[F8]:
    """Boxes of class 2, the first ``rare`` of which are of class 7 in this share of the frames."""
    rng = np.random.default_rng(2)
    for boxes in scored(walkers(frames, count, fps), label=2):
        wrong = boxes[:rare, 5]
        wrong[rng.random(len(wrong)) < share] = 7
        yield boxes


@pytest.mark.parametrize(("fps", "frames"), RATES)
@pytest.mark.parametrize(("count", "rare"), [(1, 1), (30, 1), (30, 30)])
def test_changing_classes_are_reported_once(fps: float, frames: int, count: int, rare: int) -> None:
    (said,) = warnings(changing(frames, count, fps, rare=rare), fps, filter="none")
    assert "objects changed between the classes 2 and 7 from one frame to the next" in said
    assert said.endswith('track these classes together, classes={"together": [[2, 7]]}')


@pytest.mark.parametrize(("fps", "frames"), RATES)
@pytest.mark.parametrize("count", [1, 30])
def test_the_cure_silences_it(fps: float, frames: int, count: int) -> None:
    for cure in ({"together": [[2, 7]]}, {"together": [[7, 3, 2]]}):
        assert warnings(changing(frames, count, fps), fps, filter="none", classes=cure) == []


def test_classes_that_are_together_are_named_too() -> None:
    said = warnings(changing(200, 3, 25.0), filter="none", classes={"together": [[5, 7]]})
    assert said[0].endswith('classes={"together": [[2, 5, 7]]}')


def test_steady_classes_are_no_warning() -> None:
    both = zip(
        scored(walkers(200, 12), label=2), scored(walkers(200, 24, seed=4), label=7), strict=True
    )
    frames = [np.vstack([cars, lorries[12:]]) for cars, lorries in both]
    assert warnings(frames, filter="none") == []


def test_two_objects_in_one_place_are_no_change() -> None:
    """A rider and the bicycle, each of which is missed now and then."""
    rng = np.random.default_rng(5)
    frames = []
    for boxes in scored(walkers(400), label=0):
        bicycle = boxes + np.array([5.0, 30, 5, 10, 0, 1])
        both = np.vstack([boxes, bicycle])
        frames.append(both[rng.random(len(both)) < 0.7])
    assert warnings(frames, filter="none") == []


def test_rare_mistakes_are_no_warning() -> None:
    assert warnings(changing(400, 1, 25.0, share=0.01), filter="none") == []
