"""Trackers over a stream of detections, in turns: all see the same frames, on the same machine, at
the same time.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from benchmarks.timing import Took, clock, took
from benchmarks.workload import RATE, Stream
from experiments.scans import ospa
from phdtrack.protocols import AnyStages
from phdtrack.types import F8, Detections

# Frames by turns: long enough that each finds its own data in the cache again, short against the
# machine's moods.
TURN = 6
# OSPA between centres, pixels: a target too many or too few costs about its height.
CUTOFF = 50.0


class Loop(Protocol):
    """Something that takes frames."""

    def frame(self, number: int, detections: Detections) -> tuple[tuple[Took, ...], F8]:
        """Seconds of each stage, and the centres (2, n) that were found."""


class Ours:
    """phdtrack's stages, the filter's step and the extraction, and the association where
    ``link``.
    """

    def __init__(self, stages: AnyStages, seed: int, *, link: bool = False) -> None:
        self.stages = stages
        self.link = link
        self.rng = np.random.default_rng(seed)
        self.state: Any = stages.filter.start(stages.model, self.rng)
        self.association: Any = stages.associator.start()

    def frame(self, number: int, detections: Detections) -> tuple[tuple[Took, ...], F8]:
        """Seconds of filter, extraction and association."""
        model = self.stages.model
        stages = self.stages
        began = clock()
        z = model.sensor.measure(detections)
        self.state, _ = stages.filter.step(self.state, z, model, model.rate / RATE, self.rng)
        filtered = clock()
        found = stages.extractor.extract(self.state, z, model)
        extracted = clock()
        if self.link:
            self.association, _ = stages.associator.extend(
                self.association, found, z, detections, number, model.rate / RATE, model
            )
        ended = clock()
        return (
            took(began, filtered),
            took(filtered, extracted),
            took(extracted, ended),
        ), found.state[:2]


@dataclass(frozen=True, slots=True, eq=False)
class Lap:
    """Times and rows of one loop.

    ``seconds`` and ``cpu`` (T, stages): by the clock on the wall, and of processor time that the
    thread was given; ``count`` (T,) states found less truth; ``ospa`` (T,) pixels.
    """

    seconds: F8
    cpu: F8
    count: F8
    ospa: F8

    @property
    def total(self) -> F8:
        """(T,) seconds of all stages."""
        out: F8 = self.seconds.sum(axis=1)
        return out

    def cpu_median(self, unit: float = 1.0) -> float:
        """Median processor time of a frame, all stages, times ``unit``."""
        return unit * float(np.median(self.cpu.sum(axis=1)))


def race(loops: Sequence[Loop], stream: Stream, warm_up: int, budget: float = 20.0) -> list[Lap]:
    """All loops over the stream, in turns; the first ``warm_up`` frames do not count.

    After ``budget`` seconds no further turn begins, once two turns have counted. The scores are not
    part of any time.
    """
    detections = stream.detections()
    spent: list[list[tuple[Took, ...]]] = [[] for _ in loops]
    found: list[list[F8]] = [[] for _ in loops]
    began = time.perf_counter()
    first = 1
    while first <= len(detections):
        numbers = range(first, min(first + (warm_up if first == 1 else TURN), len(detections) + 1))
        for loop, times, centres in zip(loops, spent, found, strict=True):
            for number in numbers:
                stages, where = loop.frame(number, detections[number - 1])
                times.append(stages)
                centres.append(where)
        first = numbers[-1] + 1
        if first > warm_up + TURN and time.perf_counter() - began > budget:
            break
    skip = min(warm_up, len(spent[0]) - 1)
    return [_lap(times, centres, stream, skip) for times, centres in zip(spent, found, strict=True)]


def _lap(spent: list[tuple[Took, ...]], centres: list[F8], stream: Stream, skip: int) -> Lap:
    """The frames after ``skip``."""
    count = []
    distance = []
    for number in range(skip + 1, len(spent) + 1):
        truth = stream.truth_at(number)
        where = centres[number - 1]
        count.append(where.shape[1] - len(truth))
        # The assignment of a thousand to a thousand is slow: a few frames tell.
        if len(truth) <= 300 or number % TURN == 0:
            distance.append(ospa(where, (truth[:, :2] + truth[:, 2:]).T / 2, CUTOFF))
    seconds = np.array(spent[skip:])
    return Lap(
        seconds[:, :, 0],
        seconds[:, :, 1],
        np.array(count, np.float64),
        np.array(distance or [np.nan]),
    )
