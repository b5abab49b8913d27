"""Filters with global hypotheses among false alarms: ms per frame, detections in, tracks out, and
how much they hold.

`benchmarks.workload`'s ten boxes on 720 × 480, with 10 and with 50 false alarms a frame, under the
default settings.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.parts import Outcome, Row, Scale
from benchmarks.timing import Spread, clock, took
from benchmarks.workload import Crowd, Stream, draw
from phdtrack import config, pipeline
from phdtrack.filters.hypotheses import Hypotheses

KEYS = ("mht_ms", "mht", "pmbm_ms", "pmbm")
TARGETS = 10
CLUTTER = (10, 50)


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Medians over the second half of the frames and all repeats."""
    rows = []
    found = dict[str, Any]()
    for kind in ("mht", "pmbm"):
        ms = found.setdefault(f"{kind}_ms", {})
        held = found.setdefault(kind, {})
        for clutter in CLUTTER:
            say(f"{kind}, {clutter} false alarms a frame")
            stream = draw(Crowd(TARGETS, min(scale.frames, 100), clutter=clutter), 1)
            # The first compiles.
            runs = [_run(kind, stream) for _ in range(1 + min(scale.repeats, 5))]
            wall, cpu = np.moveaxis(
                np.array([spent for spent, _ in runs[1:]])[:, stream.info.frames // 2 :], 2, 0
            )
            spread = Spread.of(wall.ravel(), 1e3)
            sizes = np.array(runs[-1][1])
            ms[str(clutter)] = spread.median
            held[str(clutter)] = dict(
                zip(("leaves", "nodes", "hypotheses"), sizes.max(axis=0).tolist(), strict=True)
            )
            note = ", ".join(
                f"{name} at most {count}" for name, count in held[str(clutter)].items()
            )
            name = f"{kind.upper()}, {TARGETS} targets, {clutter} false alarms"
            rows.append(
                Row(
                    name,
                    spread.median,
                    "ms",
                    spread,
                    note=note,
                    cpu=float(np.median(cpu)) * 1e3,
                )
            )
    return Outcome(tuple(rows), found)


def _run(kind: str, stream: Stream) -> tuple[list[tuple[float, float]], list[tuple[int, int, int]]]:
    """Seconds of every frame, on the wall and of the processor; leaves, nodes and hypotheses after
    it.
    """
    stages = config.build(config.load(sets=[f"filter.kind={kind}"]), stream.info)
    rng = np.random.default_rng(0)
    state = pipeline.start(stages, rng)
    spent = []
    sizes = []
    for number, found in enumerate(stream.detections(), start=1):
        began = clock()
        state, _ = pipeline.advance(stages, state, found, number, number / stream.info.fps, rng)
        spent.append(took(began, clock()))
        sizes.append(_sizes(state.intensity))
    return spent, sizes


def _sizes(state: Hypotheses) -> tuple[int, int, int]:
    """Leaves, nodes, and hypotheses of all clusters."""
    return (
        len(state),
        sum(len(layer) for layer in state.layers),
        sum(len(cluster.weight) for cluster in state.clusters),
    )
