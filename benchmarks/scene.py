"""The cost of a learned scene: ms per frame of each filter with learned births and false alarms,
against the default ones.

`benchmarks.workload`'s boxes, detections in and tracks out, under the default settings of each
filter. What the scene has taught is added to the default births and false alarms as `track --scene`
does it, with tracks held back where false alarms last. Half of each density are Gaussians: as many
as the case says, at places drawn over the whole area, or M09's grids from which learning begins (12
× 10 for births, 16 × 14 for false alarms), where most detections are near most Gaussians. Of what
is learned a Gaussian needs 14 tracks, or 7 false alarms, to stay: M09's 320 tracks leave 23 at
most. The sides take turns; of each frame the fastest run counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.parts import Outcome, Row, Scale
from benchmarks.timing import Spread, clock, took
from benchmarks.workload import Crowd, Stream, draw
from experiments.common import with_scene
from phdtrack import config, pipeline
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.kernels.box import OBSERVED
from phdtrack.models.scene import FalseAlarmRatio
from phdtrack.protocols import AnyStages
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects, grid, marginal
from phdtrack.scene.training import state_volume
from phdtrack.types import F8

KEYS = ("scene_ratio", "scene")
FILTERS = ("pmb", "particle-phd", "gm-phd", "gm-cphd", "mht", "mcmc")
SLOW = ("mht", "mcmc")
TARGETS = 15
BIRTHS = 0.1
ALARMS = 5.0
LIMIT = 1.1


@dataclass(frozen=True, slots=True)
class Places:
    """How many Gaussians births and false alarms have; none: M09's grids."""

    births: int = 0
    alarms: int = 0

    @property
    def name(self) -> str:
        return f"{self.births} + {self.alarms} places" if self.births else "M09's grids"


CASES = (Places(10, 30), Places(25, 60), Places(50, 120), Places())


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Ratios learned/uniform of every filter and case."""
    rows = []
    details = []
    for name in FILTERS:
        say(name)
        frames, repeats = (30, 2) if name in SLOW else (60, 20)
        stream = draw(
            Crowd(min(TARGETS, max(scale.sizes)), min(scale.frames, frames), clutter=ALARMS), 1
        )
        for row, detail in _measured(name, stream, min(scale.repeats, repeats)):
            rows.append(row)
            details.append(detail)
    return Outcome(
        tuple(rows), {"scene_ratio": {row.what: row.value for row in rows}, "scene": details}
    )


def _measured(name: str, stream: Stream, repeats: int) -> Iterator[tuple[Row, dict[str, Any]]]:
    """Row and details of each case."""
    plain = config.build(config.load(sets=[f"filter.kind={name}"]), stream.info)
    size = (float(stream.info.width), float(stream.info.height))
    whole, step = _fastest(
        [plain, *(_learned(plain, size, places) for places in CASES)], stream, repeats
    )
    for places, frame, alone in zip(CASES, whole[1:], step[1:], strict=True):
        ratio = float(frame.sum() / whole[0].sum())
        of_step = float(alone.sum() / step[0].sum())
        note = (
            f"uniform {1e3 * whole[0].mean():.3g} ms; the filter alone {of_step:.2f} ×"
            f" {1e3 * step[0].mean():.3g} ms"
        )
        row = Row(
            f"{name}, {places.name}", ratio, "×", Spread.of(frame / whole[0]), LIMIT, note=note
        )
        detail = {
            "ratio": ratio,
            "filter_ratio": of_step,
            "uniform_ms": 1e3 * float(whole[0].mean()),
        }
        yield row, {"filter": name, "case": places.name} | detail


def _learned(stages: AnyStages, size: tuple[float, float], places: Places) -> AnyStages:
    births = LearnedDensity(BIRTHS, _density(size, places.births, (12, 10)))
    alarms = LearnedDensity(ALARMS, marginal(_density(size, places.alarms, (16, 14)), OBSERVED))
    # People are everywhere.
    objects = LearnedDensity(
        float(TARGETS), marginal(_density(size, 1, (1, 1), size[0] / 3), OBSERVED)
    )
    seen = TrackedObjects(0.1, objects)
    model = with_scene(stages.model, births, alarms, seen, 500)
    return replace(
        stages,
        model=model,
        associator=FalseTrackRejection(
            stages.associator, FalseAlarmRatio(alarms, seen, births), 0.1, 5
        ),
    )


def _density(
    size: tuple[float, float], count: int, counts: tuple[int, int], wide: float = 30.0
) -> SceneDensity:
    """Return a density of states: ``count`` places about ``wide`` pixels across, or the grid."""
    low, high = state_volume(size, 20.0)
    usual = np.array([0.0, 0, 0, 0, 35, 70])
    spread = np.array([wide, wide, 2, 2, 9, 18])
    if not count:
        return grid(low, high, counts, usual, spread, uniform=0.5)
    rng = np.random.default_rng(count)
    mean = np.tile(usual[:, None], count)
    mean[:2] = rng.uniform(0, 1, (2, count)) * np.array(size)[:, None]
    return SceneDensity(
        low, high, 0.5, np.full(count, 1 / count), mean, np.tile(np.diag(spread**2), (count, 1, 1))
    )


def _fastest(sides: list[AnyStages], stream: Stream, repeats: int) -> tuple[F8, F8]:
    """(sides, frames) seconds of each frame's fastest run, of the second half: all of it, and the
    filter alone.
    """
    found: list[list[list[tuple[float, float]]]] = [[] for _ in sides]
    # The first runs compile.
    for turn in range(1 + repeats):
        for side, stages in enumerate(sides):
            spent = _run(stages, stream)
            if turn:
                found[side].append(spent)
    whole, step = np.moveaxis(np.array(found).min(axis=1), 2, 0)
    half = whole.shape[1] // 2
    return whole[:, half:], step[:, half:]


def _run(stages: AnyStages, stream: Stream) -> list[tuple[float, float]]:
    """Seconds of each frame, and of the filter in it."""
    rng = np.random.default_rng(0)
    state = pipeline.start(stages, rng)
    spent = []
    for number, found in enumerate(stream.detections(), start=1):
        began = clock()
        state, step = pipeline.advance(stages, state, found, number, number / stream.info.fps, rng)
        spent.append((took(began, clock())[0], step.seconds[0]))
    return spent
