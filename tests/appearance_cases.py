"""People whose boxes have descriptors, for the tests of appearance."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from phdtrack import Tracker
from phdtrack.types import F4, F8, Detections, Tracks

SIZE = (1280, 720)
FPS = 10.0
D = 16
# Frames in which the two who walk towards each other hide one another, in which then nothing is
# known of their looks, so that motion has decided before, and of the whole.
HIDDEN = range(96, 105)
DARK = range(105, 113)
# The frame in which those of `turning` meet.
TURN = 120
FRAMES = 150
WAY = 4.0


def prototypes(count: int, seed: int = 0) -> F8:
    """(count, D) what people look like: with a part that all share, as networks give it."""
    own = np.linalg.qr(np.random.default_rng(seed).normal(0, 1, (D, D)))[0][:count]
    return own + 0.5 / np.sqrt(D)


def look_of(prototype: F8, seed: int, noise: float = 0.15) -> F4:
    """One noisy view."""
    rng = np.random.default_rng(seed)
    return np.asarray(prototype + rng.normal(0, noise, D), np.float32)


def pacing(person: int, k: int) -> F8:
    """(4,) the box of a person who walks to and fro in a lane of their own, at frame k."""
    swing = 260 + 200 * np.sin(0.05 * k + 2 * person)
    left = swing + 400 * (person // 3)
    top = 20.0 + 200 * (person % 3)
    return np.array([left, top, left + 50, top + 120])


def frame_of(
    people: Iterable[int],
    k: int,
    looks: F8,
    place: Callable[[int, int], F8] = pacing,
) -> Detections:
    """Detections of these people, in their order, with errors of a pixel."""
    named = list(people)
    boxes = [
        place(person, k) + np.random.default_rng([person, k]).normal(0, 1.0, 4) for person in named
    ]
    views = [look_of(looks[person], 1000 * k + person) for person in named]
    return Detections.of(
        np.reshape(boxes, (-1, 4)), embeddings=np.reshape(views, (-1, D)) if named else None
    )


def tracker_of(**sections) -> Tracker:
    return Tracker(SIZE, fps=FPS, **sections)


def followed(tracker: Tracker, frames: Iterable[Detections]) -> list[Tracks]:
    """The online rows of each frame."""
    return [tracker.update(found) for found in frames]


def identity_of(tracks: Tracks, detection: int) -> int:
    """The identity that a detection has in the rows of a frame; 0: none."""
    at = np.flatnonzero(tracks.detection == detection)
    return int(tracks.identity[at[0]]) if len(at) else 0


LOOKS = prototypes(8)


def meeting(turn: bool, looks: np.ndarray = LOOKS) -> list[Detections]:
    """Two people walk towards each other, are one box where they meet, and go on or ``turn`` back;
    three more walk in lanes of their own. Detections 0 and 1 are the two, while both are seen.
    """
    out = []
    middle = 0.5 * (HIDDEN[0] + HIDDEN[-1])
    for k in range(FRAMES):
        away = abs(k - middle) if turn else middle - k
        places = [(600 - WAY * away, 300.0), (600 + WAY * away, 300.0)]
        places += [(200 + 3 * k, 20.0), (1000 - 3 * k, 160.0), (300 + 2 * k, 500.0)]
        people = [0, 2, 3, 4] if k in HIDDEN else [0, 1, 2, 3, 4]
        boxes = []
        for p in people:
            x, y = (600.0, 300.0) if k in HIDDEN and p == 0 else places[p]
            box = np.array([x, y, x + 50, y + 120])
            boxes.append(box + np.random.default_rng([p, k]).normal(0, 1, 4))
        views = np.array([look_of(looks[p], 1000 * k + p) for p in people])
        if k in HIDDEN:
            views[0] = 0.5 * (views[0] + look_of(looks[1], 1000 * k + 1))
        if k in DARK:
            views[:2] = 0
        out.append(Detections.of(np.array(boxes), embeddings=views))
    return out


def turning(swapped: bool, away: int = 0, step: float = 30.0) -> Callable[[int, int], F8]:
    """Places by person and frame: two walk to one place, where they are for ``away`` frames; then
    they turn by 90°, one up and one down, and are ``step`` pixels apart from it. Their motion
    before says nothing of who goes where. Others pace elsewhere.
    """

    def place(person: int, k: int) -> F8:
        if person > 1:
            return pacing(person, k)
        side = (-1) ** person
        if k < TURN:
            x = side * min(4.0 * (TURN - k), 200.0)
            y = 0.0
        else:
            x = 0.0
            y = side * (-1) ** swapped * (step + 2.0 * (k - TURN - away)) * (k >= TURN + away)
        corner = np.array([900 + x, 330 + y])
        return np.append(corner, corner + 40)

    return place


def measured(place: Callable[[int, int], F8], seed: int) -> Callable[[int, int], F8]:
    """These places with errors of 1.5 pixels."""
    return lambda person, k: (
        place(person, k) + np.random.default_rng([seed, person, k]).normal(0, 1.5, 4)
    )


def turned_rightly(hidden: range, step: float, scenes: int, **sections) -> int:
    """In how many scenes two who turn have the identities that they had before.

    In the frames ``hidden`` they are not detected. Who goes where alternates, so that half of the
    scenes are right by chance.
    """
    begun = tracker_of(**sections)
    rows = Tracks.empty()
    for k in range(hidden.start):
        found = frame_of([0, 1, 2], k, LOOKS, measured(turning(False, step=step), 0))
        rows = begun.update(found)
    before = [identity_of(rows, 0), identity_of(rows, 1)]
    assert 0 not in before
    saved = begun.state_dict()
    right = 0
    for seed in range(scenes):
        tracker = tracker_of(**sections)
        tracker.load_state_dict(saved)
        place = measured(turning(seed % 2 == 0, step=step), seed)
        for k in range(hidden.start, TURN + 25):
            people = [2] if k in hidden else [0, 1, 2]
            rows = tracker.update(frame_of(people, k, LOOKS, place))
        right += [identity_of(rows, 0), identity_of(rows, 1)] == before
    return right
