"""Four people who enter, cross and leave a corridor, with their centroids as point measurements
[D14].

D14 tracks people in a CAVIAR sequence of a shopping centre's corridor: four targets over 475 frames
of 384 × 288 pixels, three of them at a time at most. `PATHS` is such a corridor, seen by a camera
like that one's: one walks up it, one comes out of a shop's door, stops and leaves to the right, one
comes from the far end and crosses both paths, one comes from the right and enters the shop. Its
truth does not depend on the random stream.

People walk more evenly than in D14's model, in which the velocity changes by √2 pixels a frame on
each axis in every frame. `wandering` points live as long and follow the model, so they show a
filter's error if its model is true.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from phdtrack.arrays import to_cxcywh, to_xyxy
from phdtrack.errors import InputError
from phdtrack.protocols import Motion
from phdtrack.simulate.scenes import CORRIDOR, Walk, truth_rows
from phdtrack.types import F8, Truth

SIZE = (20.0, 50.0)
"""Of wandering points' boxes, which say where they are and nothing else."""
_DOOR = (0.17, 0.52)
_FAR = (0.55, 0.32)
PATHS = replace(
    CORRIDOR,
    name="paths",
    frames=475,
    arrivals=0.0,
    walks=(
        Walk(((0.36, 1.30), (0.42, 0.75), _FAR), at=0.0, speed=0.85),
        Walk(
            (_DOOR, (0.45, 0.62), (1.08, 0.72)),
            at=2.0,
            speed=0.55,
            stature=0.95,
            pauses=((3.0, 1.5),),
        ),
        Walk((_FAR, (0.62, 0.55), (0.70, 0.80), (0.80, 1.35)), at=4.5, speed=0.60, stature=1.05),
        Walk(((1.08, 0.62), (0.60, 0.66), _DOOR), at=9.5, speed=0.60, pauses=((4.0, 1.0),)),
    ),
)
"""Four people who enter, exit and cross each other's paths, three of them at a time at most."""


def paths() -> Truth:
    """The truth of `PATHS`: boxes clipped to the frame; the middle of such a box is the
    centroid.
    """
    # Nothing in it is random, but a scene needs a generator.
    return PATHS.truth(PATHS.figures(np.random.default_rng(0)))


def wandering(motion: Motion, speed: float, rng: np.random.Generator) -> Truth:
    """Four points with the lifetimes and starting positions of the people of `PATHS`, moved by
    draws from ``motion``.

    ``motion`` has states (px, py, vx, vy); ``speed`` is the standard deviation of each component of
    the first velocity, pixels a frame. Points wander out of the frame.
    """
    truth = paths()
    place = centroids(truth)
    found = []
    for one in np.unique(truth.identity):
        mine = np.flatnonzero(truth.identity == one)
        state = np.concatenate([place[:, mine[0]], speed * rng.standard_normal(2)])[:, None]
        way = [state]
        for _ in mine[1:]:
            way.append(state := _drawn(motion, state, rng))
        found.append(np.hstack(way)[:2])
    who = np.concatenate(
        [np.flatnonzero(truth.identity == one) for one in np.unique(truth.identity)]
    )
    everybody = np.hstack(found)
    boxes = to_xyxy(np.vstack([everybody, np.tile(np.array(SIZE)[:, None], len(who))]))
    return truth_rows(truth.frame[who], truth.identity[who], boxes)


def _drawn(motion: Motion, state: F8, rng: np.random.Generator) -> F8:
    """The state (4, 1) a frame later; ``motion`` disturbs position and velocity of each axis
    independently.
    """
    moved, _, noise = motion.transition(state, 1.0)
    push = rng.standard_normal((2, 1))
    place, speed = np.sqrt(np.diag(noise[0])[[0, 2]])
    return moved + np.concatenate([place * rng.standard_normal((2, 1)), speed * push])


def centroids(truth: Truth) -> F8:
    """(2, M) the middles of the annotated boxes, pixels."""
    return np.ascontiguousarray(to_cxcywh(truth.xyxy)[:2])


def measured(
    truth: Truth, frames: int, variance: float, rng: np.random.Generator
) -> tuple[F8, ...]:
    """For each of the frames 1 … ``frames`` the measurements (3, n): centroids with Gaussian noise,
    and their identities.

    There are no misses and no false alarms; the third row is the identity. ``variance`` is that of
    each coordinate in pixels², 0 for clean centroids. Raises `InputError` for a negative one.
    """
    if not 0 <= variance < np.inf:
        raise InputError(f"expected a variance of 0 or more, got {variance:g}", where="measured")
    noisy = centroids(truth) + np.sqrt(variance) * rng.standard_normal((2, len(truth)))
    labelled = np.vstack([noisy, truth.identity])
    return tuple(
        np.ascontiguousarray(labelled[:, truth.frame == number]) for number in range(1, frames + 1)
    )
