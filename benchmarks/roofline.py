"""How far each stage is from what this machine allows: memory bandwidth, normals and exponentials
measured in the same run.

What a frame of the filter cannot avoid: every old particle is read and written once (24 bytes each
way), moved by four normals and weighed by one exponential per detection in whose gate it is; every
newborn needs four normals and its pairs. The floor is the larger of the two times, memory and
arithmetic, on one thread. The extraction reads every particle once.

The bandwidth is STREAM's triad over three arrays of 128 MiB each or more, many times what a
last-level cache holds. A limit is the best of its repeats: it is what the machine can do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.loops import Ours, race
from benchmarks.particle_phd import pairs_per_target
from benchmarks.parts import Outcome, Row, Scale
from benchmarks.timing import Spread, seconds
from benchmarks.twins import NEWBORN
from benchmarks.workload import Crowd, draw, stages
from phdtrack.kernels.fast32 import FAST, exp32
from phdtrack.kernels.particle_models import BLOCK
from phdtrack.kernels.particles import ROWS, fill_normals

KEYS = ("roofline",)
PARTICLE = 24
F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


@njit
def triad(a: F8, b: F8, c: F8) -> None:
    """a = b + 3c: 24 bytes per element, as STREAM counts them."""
    for i in range(a.size):
        a[i] = b[i] + 3.0 * c[i]


@njit
def normals(s: F4, calls: int) -> None:
    """Four standard normals per particle of a block, ``calls`` times."""
    for call in range(calls):
        fill_normals(s, BLOCK, np.uint32(call), np.uint32(1), np.uint32(2), np.uint32(3))


@njit(fastmath=FAST)
def exponentials(x: F4, out: F4, calls: int) -> None:
    """exp of every element of a block, ``calls`` times."""
    for _ in range(calls):
        for i in range(x.size):
            out[i] = exp32(x[i])


def limits(scale: Scale) -> dict[str, tuple[float, Spread]]:
    """Bytes, normals and exponentials per nanosecond (10⁹ a second): the best of the repeats, and
    their spread.
    """
    n = scale.triad
    a = np.zeros(n)
    b = np.ones(n)
    c = np.ones(n)
    s = np.zeros(ROWS * BLOCK, np.float32)
    x = np.linspace(-40, 0, BLOCK, dtype=np.float32)
    out = np.zeros(BLOCK, np.float32)
    calls = 2000
    # Amounts in 10⁹ and what does them.
    work: dict[str, tuple[float, Callable[[], None]]] = {
        "bandwidth": (24e-9 * n, lambda: triad(a, b, c)),
        "normals": (4e-9 * BLOCK * calls, lambda: normals(s, calls)),
        "exponentials": (1e-9 * BLOCK * calls, lambda: exponentials(x, out, calls)),
    }
    rates = {
        name: amount / seconds(call, scale.repeats, 2) for name, (amount, call) in work.items()
    }
    return {name: (float(rate.max()), Spread.of(rate)) for name, rate in rates.items()}


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """The limits, and each stage's time over its floor in the worst case of births."""
    say("limits")
    measured = limits(scale)
    best = {name: fastest for name, (fastest, _) in measured.items()}
    targets = scale.threads_at
    say(f"{targets} targets")
    crowd = Crowd(targets, min(scale.frames, 40))
    stream = draw(crowd, 1)
    loop = Ours(stages(crowd, worst=True), 1)
    (lap,) = race([loop], stream, min(12, crowd.frames // 2), scale.budget)
    old = len(loop.state)
    born = NEWBORN * len(stream.table) / crowd.frames
    pairs = targets * pairs_per_target(Crowd(min(100, targets), min(12, crowd.frames)))["worst"]
    parts = {
        "memory": 2 * PARTICLE * old / best["bandwidth"] * 1e-6,
        "normals": 4 * (old + born) / best["normals"] * 1e-6,
        "exponentials": pairs / best["exponentials"] * 1e-6,
    }
    floors = {
        "filter": max(parts["memory"], parts["normals"] + parts["exponentials"]),
        "extraction": PARTICLE * old / best["bandwidth"] * 1e-6,
    }
    units = {"bandwidth": "GB/s", "normals": "10⁹/s", "exponentials": "10⁹/s"}
    rows = [
        Row(f"{name}, one thread", fastest, units[name], spread, note="best of the repeats")
        for name, (fastest, spread) in measured.items()
    ]
    stage_entries: dict[str, Any] = {}
    for column, (stage, floor) in enumerate(floors.items()):
        spent = Spread.of(lap.seconds[:, column], 1e3)
        note = f"floor {floor:.3g} ms"
        if stage == "filter":
            note += " of " + ", ".join(f"{name} {ms:.3g}" for name, ms in parts.items())
        rows.append(
            Row(f"{stage}, {targets} targets, over its floor", spent.median / floor, "×", note=note)
        )
        stage_entries[stage] = {
            "ms": spent.as_dict(),
            "floor_ms": floor,
            "over_floor": spent.median / floor,
        }
    rate = {
        name: {"best": fastest, **spread.as_dict()} for name, (fastest, spread) in measured.items()
    }
    entry = {
        "limits_per_ns": rate,
        "targets": targets,
        "floor_parts_ms": parts,
        "stages": stage_entries,
    }
    return Outcome(tuple(rows), {"roofline": entry})
