"""Arguments and results of the parts of the benchmark."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from benchmarks.timing import Spread


class Skipped(Exception):
    """A part cannot be measured here, and why."""


@dataclass(frozen=True, slots=True)
class Scale:
    """How much is measured; ``SMOKE`` is for tests: it shows that everything runs, not how fast."""

    name: str
    sizes: tuple[int, ...]
    threads_at: int
    frames: int
    budget: float
    twin_sizes: tuple[int, ...]
    twin_frames: int
    memory_at: int
    memory_frames: int
    peer_objects: tuple[int, ...]
    peer_frames: int
    stone_sizes: tuple[int, ...]
    stone_frames: int
    stone_seeds: tuple[int, ...]
    stone_particles: int
    rounds: int
    repeats: int
    triad: int
    others: bool = True
    seeds: tuple[int, ...] = (1,)


SIZES = (10, 30, 100, 300, 1000)
QUICK = Scale(
    name="quick",
    sizes=SIZES,
    threads_at=1000,
    frames=60,
    budget=10.0,
    twin_sizes=(10, 100),
    twin_frames=24,
    memory_at=300,
    memory_frames=2000,
    peer_objects=(10, 20, 200),
    peer_frames=120,
    stone_sizes=(10, 100),
    stone_frames=30,
    stone_seeds=(1, 2, 3),
    stone_particles=15_000,
    rounds=1,
    repeats=15,
    triad=2**24,
)
FULL = Scale(
    name="full",
    sizes=SIZES,
    threads_at=1000,
    frames=200,
    budget=60.0,
    twin_sizes=(10, 100, 1000),
    twin_frames=48,
    memory_at=1000,
    memory_frames=10_000,
    peer_objects=(10, 20, 200),
    peer_frames=400,
    stone_sizes=(10, 100),
    stone_frames=100,
    stone_seeds=(1, 2, 3, 4, 5),
    stone_particles=15_000,
    rounds=3,
    repeats=40,
    triad=2**25,
    seeds=(1, 2, 3),
)
SMOKE = Scale(
    name="smoke",
    sizes=(2, 4),
    threads_at=4,
    frames=4,
    budget=10.0,
    twin_sizes=(2,),
    twin_frames=4,
    memory_at=2,
    memory_frames=40,
    peer_objects=(3,),
    peer_frames=8,
    stone_sizes=(2,),
    stone_frames=2,
    stone_seeds=(1,),
    stone_particles=300,
    rounds=1,
    repeats=2,
    triad=2**14,
    others=False,
)
SCALES: Mapping[str, Scale] = {scale.name: scale for scale in (QUICK, FULL, SMOKE)}


# Units that depend on the machine.
TIMES = ("s", "ms", "µs", "frames/s")


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table: a value with its quartiles, and the limit it is held to (``most`` or
    ``least``): none for times, which depend on the machine, but for ratios of one run.

    ``cpu`` is the same of the thread's processor time, which a busy machine does not lengthen; no
    limit is for it.
    """

    what: str
    value: float
    unit: str
    spread: Spread | None = None
    most: float | None = None
    least: float | None = None
    note: str = ""
    cpu: float | None = None

    def __post_init__(self) -> None:
        if self.unit in TIMES and (self.most is not None or self.least is not None):
            raise ValueError(f"{self.what}: expected a ratio for a limit, got {self.unit}")

    @property
    def kept(self) -> bool | None:
        """True if the limit is kept; None without a limit."""
        if self.most is None and self.least is None:
            return None
        return (self.most is None or self.value <= self.most) and (
            self.least is None or self.value >= self.least
        )


@dataclass(frozen=True, slots=True)
class Outcome:
    """Rows for the table and entries for the top level of the JSON document."""

    rows: tuple[Row, ...]
    entries: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Part:
    """One part: ``keys`` are the entries it makes, which are null where it fails; ``quick``: of
    `make bench`, the others of `make bench-full`.
    """

    name: str
    title: str
    run: Callable[[Scale, Callable[[str], None]], Outcome]
    keys: tuple[str, ...] = ()
    quick: bool = False
