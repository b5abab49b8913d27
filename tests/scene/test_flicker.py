"""Where a scene flickers, by made detections of what comes again and never goes anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack.scene.flicker import (
    NOWHERE,
    FlickerMap,
    Sightings,
    arrivals,
    distance_travelled,
    learn_flicker,
    travellers,
    without_flicker,
)

FPS = 25.0
SIZE = (640.0, 360.0)
# A minute.
FRAMES = 1500
HERE = (300.0, 200.0)


class Scene:
    """Detections of 30x60 boxes, noise of a pixel, with the tracks that they belong to."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.rows: list[tuple[float, float, float, int]] = []
        self.count = 0

    def track(self, frames: np.ndarray, x: np.ndarray | float, y: float) -> int:
        """Detections of one track; its identity."""
        self.count += 1
        self._add(frames, x, y, self.count)
        return self.count

    def loose(self, frames: np.ndarray, x: np.ndarray | float, y: float) -> None:
        """Detections of no track."""
        self._add(frames, x, y, -1)

    def _add(self, frames: np.ndarray, x: np.ndarray | float, y: float, identity: int) -> None:
        x = np.broadcast_to(x, len(frames)) + self.rng.normal(0, 1, len(frames))
        for frame, at in zip(frames.tolist(), x.tolist(), strict=True):
            self.rows.append((frame / FPS, at, y + self.rng.normal(), identity))

    def blinks(self, x: float, y: float, every: int = 60, length: int = 12) -> None:
        """Bursts of no track at one place all the time."""
        for begin in range(10, FRAMES - length, every):
            self.loose(begin + np.arange(length), x, y)

    def walks(self, begin: int, y: float, *, stop: int = 0) -> int:
        """Somebody who walks through the picture, and stops at x = 300 for some frames."""
        way = np.arange(20.0, 620.0, 4.0)
        before = way[way <= 300]
        x = np.concatenate([before, np.full(stop, 300.0), way[way > 300]])
        return self.track(begin + np.arange(len(x)), x, y)

    @property
    def seen(self) -> Sightings:
        time, x, y, identity = np.array(sorted(self.rows)).T
        box = np.stack([x, y, np.full(len(x), 30.0), np.full(len(x), 60.0)])
        return Sightings(box, time, identity.astype(np.int64))


def at(x: float, y: float) -> np.ndarray:
    return np.array([[x], [y], [30.0], [60.0]])


def odds(learned: FlickerMap, x: float, y: float) -> float:
    return float(learned.odds(at(x, y))[0])


def test_a_place_that_blinks_is_learned_and_no_other() -> None:
    scene = Scene()
    scene.blinks(*HERE)
    scene.walks(100, 80.0)
    learned = learn_flicker(scene.seen, SIZE)
    # 25 arrivals against a prior of three visits.
    assert odds(learned, *HERE) == pytest.approx(3 / 25, abs=0.02)
    assert odds(learned, 300, 80) == 1
    assert odds(learned, 60, 200) == 1
    # Of another size.
    assert learned.odds(np.array([[300.0], [200.0], [150.0], [300.0]]))[0] == 1


def test_nothing_is_learned_where_nothing_flickers() -> None:
    scene = Scene()
    for begin in range(0, 1300, 100):
        scene.walks(begin, 200.0)
    assert learn_flicker(scene.seen, SIZE) is NOWHERE
    assert learn_flicker(Scene().seen if Scene().rows else _nothing(), SIZE) is NOWHERE


def _nothing() -> Sightings:
    return Sightings(np.zeros((4, 0)), np.zeros(0), np.zeros(0, np.int64))


def test_a_short_file_teaches_nothing() -> None:
    scene = Scene()
    scene.loose(np.arange(10, 20), *HERE)
    scene.loose(np.arange(40, 50), *HERE)
    scene.loose(np.arange(80, 90), *HERE)
    assert learn_flicker(scene.seen, SIZE) is NOWHERE


def test_people_who_queue_are_no_flicker() -> None:
    """Each comes, stands for four seconds in pieces of tracks, and leaves."""
    scene = Scene()
    for begin in range(0, 1250, 130):
        scene.walks(begin, 200.0, stop=100)
    assert learn_flicker(scene.seen, SIZE) is NOWHERE


@pytest.mark.parametrize("share", [1.0, 0.6, 0.3])
def test_a_person_who_sits_all_the_time_is_no_flicker(share: float) -> None:
    scene = Scene()
    present = np.flatnonzero(scene.rng.random(FRAMES) < share)
    scene.track(present, *HERE)
    learned = learn_flicker(scene.seen, SIZE)
    assert odds(learned, *HERE) == 1


def test_a_person_who_sits_where_leaves_move_is_kept() -> None:
    """Twenty seconds without a gap, where everything else is there for half a second."""
    scene = Scene()
    scene.blinks(*HERE)
    sitting = scene.track(np.arange(600, 1100), *HERE)
    leaves = scene.track(np.arange(1230, 1242), *HERE)
    seen = scene.seen
    learned = learn_flicker(seen, SIZE)
    flicker = without_flicker(seen, learned, arrivals(seen, SIZE, travellers(seen)), SIZE)
    assert flicker.tolist() == [leaves]
    assert sitting not in flicker


def test_a_parked_car_that_leaves_is_no_flicker() -> None:
    scene = Scene()
    x = np.concatenate([np.full(900, 300.0), 300.0 + 5 * np.arange(60)])
    car = scene.track(np.arange(960), x, 200.0)
    # What it leaves behind.
    scene.loose(np.arange(905, 960), *HERE)
    seen = scene.seen
    assert travellers(seen).tolist() == [car]
    assert learn_flicker(seen, SIZE) is NOWHERE


def test_where_cars_enter_is_no_flicker() -> None:
    """First pieces at the border are tracks of their own, too short to show that they travel."""
    scene = Scene()
    for begin in range(0, 1400, 40):
        scene.track(begin + np.arange(6), 13.0, 200.0)
    assert learn_flicker(scene.seen, SIZE) is NOWHERE


def test_tracks_that_go_somewhere_are_never_flicker() -> None:
    scene = Scene()
    scene.blinks(*HERE)
    walker = scene.walks(400, 200.0)
    still = scene.track(np.arange(1330, 1342), *HERE)
    seen = scene.seen
    learned = learn_flicker(seen, SIZE)
    flicker = without_flicker(seen, learned, arrivals(seen, SIZE, travellers(seen)), SIZE)
    assert flicker.tolist() == [still]
    assert walker in travellers(seen)


def test_who_walks_travels_and_who_sways_does_not() -> None:
    time = np.arange(100) / FPS
    size = np.full((2, 100), 30.0)
    walks = np.vstack([100 + 60 * time, np.full(100, 200.0), size])
    sways = np.vstack([300 + 15 * np.sin(5 * time), np.full(100, 200.0), size])
    jumps = np.vstack([np.where(time < 2, 100.0, 300.0), np.full(100, 200.0), size])
    assert distance_travelled(walks, time) == pytest.approx(60 * 4 / 30, rel=0.15)
    assert distance_travelled(sways, time) < 1
    assert distance_travelled(jumps, time) < 1


def test_maps_join_and_fade() -> None:
    scene = Scene()
    scene.blinks(*HERE)
    learned = learn_flicker(scene.seen, SIZE)
    twice = learned.joined(learned)
    assert odds(twice, *HERE) == pytest.approx(odds(learned, *HERE) / 2, abs=0.01)
    faded = learned.joined(NOWHERE, kept=0.1)
    assert odds(faded, *HERE) == 1
    assert len(learned.joined(NOWHERE, kept=0.0).cell) == 0
