"""phdtrack against the twins in NumPy on the same workload, worst case of births, K-means included,
frames by turns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.loops import Lap, Loop, Ours, race
from benchmarks.parts import Outcome, Row, Scale
from benchmarks.timing import Spread
from benchmarks.twins import Twin, World
from benchmarks.workload import Crowd, draw, stages
from phdtrack.models.volumes import image_volume

KEYS = ("ratio_gated_numpy", "ratio_dense_numpy", "numpy_twins")
# Gated NumPy at 1000 targets takes seconds a frame; the dense twin's table at 100 would hold 10
# million pairs.
DENSE_UP_TO = 10
LEAST = {"gated": 25.0, "dense": 70.0}


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """The ratios at each size; the entries are the least over the sizes."""
    rows: list[Row] = []
    ratios: dict[str, dict[str, float]] = {"gated": {}, "dense": {}}
    details: list[dict[str, Any]] = []
    for targets in scale.twin_sizes:
        say(f"{targets} targets")
        crowd = Crowd(targets, scale.twin_frames)
        world = World.of(
            crowd,
            image_volume((crowd.info.width, crowd.info.height))
            / (crowd.info.width * crowd.info.height),
        )
        names = ["gated", *(["dense"] if targets <= DENSE_UP_TO else [])]
        loops: list[Loop] = [Ours(stages(crowd, worst=True), 1)]
        loops += [Twin(world, 1, gated=name == "gated") for name in names]
        ours, *twins = race(loops, draw(crowd, 1), scale.twin_frames // 3, 2 * scale.budget)
        details.append({"targets": targets, "twin": "phdtrack", **_scores(ours)})
        for name, lap in zip(names, twins, strict=True):
            ratio = float(np.median(lap.total) / np.median(ours.total))
            ratios[name][str(targets)] = ratio
            of_cpu = lap.cpu_median() / ours.cpu_median()
            details.append(
                {
                    "targets": targets,
                    "twin": name,
                    "ratio": ratio,
                    "ratio_cpu": of_cpu,
                    **_scores(lap),
                }
            )
            spread = Spread.of(lap.total, 1e3)
            mine = Spread.of(ours.total, 1e3)
            note = (
                f"OSPA {np.nanmean(lap.ospa):.1f} px, ours {np.nanmean(ours.ospa):.1f} px in"
                f" {mine.median:.3g} ms"
            )
            rows.append(
                Row(
                    f"{name} NumPy, {targets} targets",
                    spread.median,
                    "ms",
                    spread,
                    note=note,
                    cpu=lap.cpu_median(1e3),
                )
            )
            rows.append(
                Row(
                    f"phdtrack against {name} NumPy, {targets} targets",
                    ratio,
                    "×",
                    least=LEAST[name],
                    cpu=of_cpu,
                )
            )
    entries = {
        "ratio_gated_numpy": min(ratios["gated"].values(), default=None),
        "ratio_dense_numpy": min(ratios["dense"].values(), default=None),
        "numpy_twins": {"ratios": ratios, "runs": details},
    }
    return Outcome(tuple(rows), entries)


def _scores(lap: Lap) -> dict[str, Any]:
    spread = Spread.of(lap.total, 1e3).as_dict()
    return {
        "ms": spread,
        "cpu_ms": lap.cpu_median(1e3),
        "count_error": float(np.mean(lap.count)),
        "ospa": float(np.nanmean(lap.ospa)),
    }
