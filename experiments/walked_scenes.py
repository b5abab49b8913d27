"""People on the ground with known groups: sequences that somebody has annotated, and simulated ones
that these have none of, a tram stop and a busy square.

The simulated people are fitted to nothing. Companies of one to five walk to a goal abreast; who
stands, stands in a circle with the others of the company and sways by some centimetres. People give
way to those of other companies who are nearer than 1.2 m.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from phdtrack.formats.known_positions import KnownPositions
from phdtrack.types import F8, I8

# Seconds of a simulated step, and how many of them there are to an annotated frame.
STEP = 0.1
STEPS = 4
DURATION = 300.0
# Metres around where people walk.
MARGIN = 1.0
# Metres along x and y of the simulated places.
STOP = (24.0, 7.0)
SQUARE = (15.0, 14.0)
DOORS = (5.0, 12.0, 19.0)
# Share of companies that are groups, and how many are of 2, 3 and 4.
IN_GROUPS = 0.35
SIZES = (0.7, 0.22, 0.08)
# Of those who stand on the square and talk: single ones, and groups of 2 to 5.
ALONE = 0.3
TALKING = (0.45, 0.3, 0.15, 0.1)


@dataclass(frozen=True, slots=True, eq=False)
class WalkedScene:
    """A sequence: people, the annotated ``group`` (M,) of each row, 0 for none, number and seconds
    (F,) of its frames.
    """

    people: KnownPositions
    group: I8
    number: I8
    time: F8

    @property
    def region(self) -> tuple[float, float, float, float]:
        """Left, low, right and high border of the walked ground, with a margin."""
        low = self.people.state[:2].min(axis=1) - MARGIN
        high = self.people.state[:2].max(axis=1) + MARGIN
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


@dataclass(slots=True, eq=False)
class _Company:
    """People who belong together, or one alone: where they are, and where they go.

    ``place``, ``velocity`` (n, 2) of each; ``middle`` (2,) walks to the ``goal``; ``sway`` (n, 2)
    of each around its own place; ``lag`` (n,) metres behind the others; ``gap`` between neighbours;
    ``angle`` of the circle. ``stays``: seconds to stand at the goal, 0 to leave there.
    """

    first: int
    group: int
    place: F8
    middle: F8
    goal: F8
    speed: float
    lag: F8
    gap: float
    angle: float
    stays: float
    velocity: F8 = field(init=False)
    sway: F8 = field(init=False)
    stands: bool = False

    def __post_init__(self) -> None:
        self.velocity = np.zeros_like(self.place)
        self.sway = np.zeros_like(self.place)

    def __len__(self) -> int:
        return len(self.place)

    def advance(self, others: F8, rng: np.random.Generator) -> None:
        """One step, giving way to the ``others`` (K, 2)."""
        count = len(self)
        way = self.goal - self.middle
        way = way / max(float(np.hypot(*way)), 1e-6)
        if not self.stands:
            # They wait for those who had to give way.
            behind = np.hypot(*(self.place.mean(axis=0) - self.middle)) > 0.8
            self.middle = self.middle + way * self.speed * STEP * (0.3 if behind else 1.0)
        noise = (0.06 if self.stands else 0.18) * np.sqrt(2 * STEP / 3)
        self.sway += -self.sway * STEP / 3 + noise * rng.standard_normal((count, 2))
        wanted = self.middle + self._formation(way) + self.sway
        pull = _at_most((wanted - self.place) / 0.8, 1.5 * self.speed)
        push = _away(self.place, others)
        if self.stands:
            push *= 0.25
        else:
            pull = 0.7 * pull + 0.6 * self.speed * way
        push = _at_most(push, 2.0)
        self.velocity = _at_most(self.velocity + (pull + push - self.velocity) * STEP / 0.5, 2.0)
        self.place = self.place + self.velocity * STEP

    def _formation(self, way: F8) -> F8:
        """(n, 2) from the middle to each place: a circle, or rows of up to three abreast."""
        number = np.arange(len(self))
        if self.stands and len(self) > 1:
            turn = self.angle + 2 * np.pi * number / len(self)
            radius = self.gap / (2 * np.sin(np.pi / len(self)))
            return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        abreast = min(len(self), 3)
        side = (number % abreast - (abreast - 1) / 2) * self.gap
        back = number // abreast * 1.2 * self.gap + self.lag
        return np.outer(side, [-way[1], way[0]]) - np.outer(back, way)


def _at_most(vectors: F8, length: float) -> F8:
    """Vectors (n, 2), the longer ones shortened to a length."""
    norm = np.hypot(*vectors.T)
    return np.asarray(vectors * np.minimum(1.0, length / np.maximum(norm, 1e-9))[:, None])


def _away(place: F8, others: F8) -> F8:
    """(n, 2) metres per second away from others who are near."""
    offset = place[:, None] - others
    distance = np.maximum(np.hypot(offset[..., 0], offset[..., 1]), 0.1)
    strength = np.where(distance < 1.2, 1.6 * np.exp((0.35 - distance) / 0.25), 0.0)
    return np.asarray((strength / distance)[..., None] * offset).sum(axis=1)


class _Place(ABC):
    """Where companies come, stand and go."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.companies: list[_Company] = []
        self._people = 0
        self._groups = 0

    def come(self, start: F8, goal: F8, size: int, stays: float = 0.0) -> None:
        """A company of a size comes from one point and goes to another."""
        rng = self.rng
        gap = rng.uniform(0.55, 0.85)
        side = gap * (np.arange(size) - (size - 1) / 2)
        place = start + rng.normal(0, 0.3, (size, 2)) + np.stack([0 * side, side], axis=1)
        self._groups += size > 1
        self.companies.append(
            _Company(
                self._people + 1,
                self._groups if size > 1 else 0,
                place,
                start,
                goal,
                max(0.6, float(rng.normal(1.3 if size == 1 else 1.1, 0.2))),
                rng.normal(0, 0.15, size),
                gap,
                rng.uniform(0, 2 * np.pi),
                stays,
            )
        )
        self._people += size

    def size(self) -> int:
        """How many come together."""
        if self.rng.random() >= IN_GROUPS:
            return 1
        return int(self.rng.choice([2, 3, 4], p=SIZES))

    @abstractmethod
    def act(self, time: float) -> None:
        """Let companies come and go, before everybody walks on."""

    @abstractmethod
    def leave(self) -> F8:
        """(2,) where a company goes that has stood long enough."""

    def advance(self, time: float) -> None:
        """One step."""
        self.act(time)
        everybody = [one.place for one in self.companies]
        for k, one in enumerate(self.companies):
            others = [place for j, place in enumerate(everybody) if j != k]
            one.advance(np.concatenate([np.zeros((0, 2)), *others]), self.rng)
        here = []
        for one in self.companies:
            near = np.hypot(*(one.goal - one.middle)) < 0.5
            if one.stands:
                one.stays -= STEP
                if one.stays <= 0:
                    one.stands = False
                    one.goal = self.leave()
            elif near and one.stays > 0:
                one.stands = True
            elif near:
                continue
            here.append(one)
        self.companies = here


class _Stop(_Place):
    """People wait for a tram, and board it together; others alight."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self._tram = rng.uniform(60, 120)

    def act(self, time: float) -> None:
        """Every 4.5 s somebody comes to wait; every two minutes there is a tram."""
        rng = self.rng
        width, depth = STOP
        if rng.random() < STEP / 4.5:
            start = np.array([rng.choice([-1.0, width + 1]), rng.uniform(0.5, depth - 3)])
            self.come(start, self._free(), self.size(), np.inf)
        if time < self._tram:
            return
        self._tram += rng.uniform(90, 150)
        for one in self.companies:
            if one.stays > 0:
                one.stays = 0.0
                one.stands = False
                one.goal = np.array([min(DOORS, key=lambda x: abs(x - one.middle[0])), -0.3])
        for _ in range(rng.integers(5, 14)):
            goal = np.array([rng.choice([-2.0, width + 2]), rng.uniform(1, depth - 0.5)])
            self.come(np.array([rng.choice(DOORS), 0.3]), goal, self.size())

    def _free(self) -> F8:
        """A place to wait that is some steps from those who wait, if there is one."""
        spot = np.zeros(2)
        waiting = [one.goal for one in self.companies if one.stays > 0]
        for _ in range(60):
            spot = self.rng.uniform([3.0, 1.2], [STOP[0] - 3, 4.5])
            if all(np.hypot(*(spot - goal)) > 1.0 for goal in waiting):
                break
        return np.asarray(spot)

    def leave(self) -> F8:
        """(2,) the end of the platform: of those who wait nobody gives up."""
        return np.array([-2.0, 1.0])


class _Square(_Place):
    """People cross a square from side to side, and groups stand on it and talk."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        for _ in range(8):
            self._talk()

    def act(self, time: float) -> None:
        """Sixteen companies cross in ten seconds; every 25 s one comes to stay."""
        if self.rng.random() < 1.6 * STEP:
            start, goal = self.rng.choice(4, 2, replace=False)
            self.come(self._edge(start), self._edge(goal), self.size())
        if self.rng.random() < STEP / 25:
            self._talk()

    def _talk(self) -> None:
        """A company comes that stays for a minute or more."""
        rng = self.rng
        size = 1 if rng.random() < ALONE else int(rng.choice([2, 3, 4, 5], p=TALKING))
        goal = rng.uniform(2.0, np.subtract(SQUARE, 2.0))
        self.come(self._edge(int(rng.integers(4))), goal, size, 20 + rng.exponential(60))

    def _edge(self, side: int) -> F8:
        """A point at one of the four sides."""
        along = self.rng.uniform(0.1, 0.9)
        width, depth = SQUARE
        points = [
            (-0.5, along * depth),
            (width + 0.5, along * depth),
            (along * width, -0.5),
            (along * width, depth + 0.5),
        ]
        return np.array(points[side])

    def leave(self) -> F8:
        """Any side."""
        return self._edge(int(self.rng.integers(4)))


SIMULATED = {"stop": _Stop, "square": _Square}


def simulated(name: str, seed: int, duration: float = DURATION) -> WalkedScene:
    """One of the `SIMULATED` places for some seconds, every 0.4 s."""
    place = SIMULATED[name](np.random.default_rng([seed, len(name)]))
    rows = []
    for step in range(round(duration / STEP)):
        place.advance(step * STEP)
        if step % STEPS == 0:
            rows += [
                (step // STEPS, one.first + k, one.group, *one.place[k], *one.velocity[k])
                for one in place.companies
                for k in range(len(one))
            ]
    table = np.array(rows)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    frame, identity, group = table[:, :3].T.astype(np.int64)
    number = np.unique(frame)
    people = KnownPositions(frame, identity, np.ascontiguousarray(table[:, 3:].T))
    return WalkedScene(people, group, number, number * STEP * STEPS)
