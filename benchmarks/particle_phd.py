"""The particle PHD filter on the workload: time per stage and target number, both forms of birth,
one thread and two.

``specified``: J_j = ⌈Jmax·max(0, 1 − M_j)⌉ newborn at a detection; ``worst``: Jmax at each, which
the limits are for.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from benchmarks.loops import Lap, Ours, race
from benchmarks.parts import Outcome, Row, Scale
from benchmarks.timing import Spread, exponent
from benchmarks.workload import Crowd, draw, stages
from phdtrack.filters import ParticlePHD
from phdtrack.kernels.grid import points_in_rectangles
from phdtrack.kernels.mcmc import pair_likelihoods
from phdtrack.protocols import AnyStages
from phdtrack.types import ParticleBlocks, Particles

KEYS = ("particle_phd_ms", "particle_phd", "growth_exponent", "threads", "ns_per_pair")
WARM_UP = 12


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """All sizes, forms and thread numbers."""
    rows = []
    details = []
    worst = {}
    of_cpu = {}
    particles_per_target = pairs_per_target(Crowd(min(100, max(scale.sizes)), 12))
    for targets in scale.sizes:
        say(f"{targets} targets")
        crowd = Crowd(targets, scale.frames)
        warm = min(WARM_UP, scale.frames // 2)
        for seed in scale.seeds:
            loops = [Ours(stages(crowd, worst=worst), seed, link=True) for worst in (True, False)]
            laps = race(loops, draw(crowd, seed), warm, scale.budget)
            for form, lap, loop in zip(("worst", "specified"), laps, loops, strict=True):
                details.append(
                    _detail(
                        targets,
                        form,
                        seed,
                        lap,
                        len(loop.state),
                        particles_per_target[form] * targets,
                    )
                )
        for form in ("worst", "specified"):
            mine = [d for d in details if d["targets"] == targets and d["form"] == form]
            rows.append(_row(targets, form, mine))
        mine = [d["total_ms"] for d in details if d["targets"] == targets and d["form"] == "worst"]
        worst[str(targets)] = float(np.median(mine))
        mine = [
            d["cpu"]["median"] for d in details if d["targets"] == targets and d["form"] == "worst"
        ]
        of_cpu[str(targets)] = float(np.median(mine))
    growth = exponent([float(n) for n in worst], list(worst.values()))
    cpu_growth = exponent([float(n) for n in of_cpu], list(of_cpu.values()))
    span = f"{scale.sizes[0]} … {scale.sizes[-1]} targets, worst case"
    rows.append(Row(f"growth exponent, {span}", growth, "", most=1.1, cpu=cpu_growth))
    threads, more = _threads(scale, say)
    largest = [d for d in details if d["targets"] == scale.sizes[-1] and d["form"] == "worst"]
    ns = float(np.median([d["ns_per_pair"] for d in largest]))
    rows.append(
        Row(f"filter per particle–detection pair, {scale.sizes[-1]} targets, worst", ns, "ns")
    )
    entries = {
        "particle_phd_ms": worst,
        "particle_phd": details,
        "growth_exponent": growth,
        "threads": threads,
        "ns_per_pair": ns,
    }
    return Outcome((*rows, *more), entries)


def pairs_per_target(crowd: Crowd) -> dict[str, float]:
    """Particle–detection pairs inside the gates, for each target: old particles and newborn, by
    form.

    Counted on one frame with the general model; the density is the same at every size.
    """
    built = stages(crowd)
    loop = Ours(built, 1)
    stream = draw(crowd, 1).detections()
    for number, detections in enumerate(stream[:-1], start=1):
        loop.frame(number, detections)
    z = built.model.sensor.measure(stream[-1])
    rng = np.random.default_rng(1)
    old = plain(loop.state)
    moved = ParticlePHD().predict(old, built.model, 1.0, rng).particles()
    lower, upper = built.model.sensor.gate(z)
    point, which = points_in_rectangles(moved.state[:2].astype(np.float64), lower, upper)
    numbers = built.model.sensor.particle_model(z)
    near = pair_likelihoods(moved.state, numbers.model, numbers.table, point, which)[0] <= 13.28
    covered = np.bincount(which[near], moved.weight[point[near]], z.shape[1])
    out = {}
    for form, mass in (("worst", np.zeros_like(covered)), ("specified", covered)):
        born = built.model.birth.sample(
            z, np.asarray(mass, np.float64), built.model.sensor, 1.0, rng
        )
        newborn, _ = points_in_rectangles(born.state[:2].astype(np.float64), lower, upper)
        out[form] = (len(point) + len(newborn)) / crowd.targets
    return out


def plain(state: Particles | ParticleBlocks) -> Particles:
    """The state as plain particles."""
    return state.particles() if isinstance(state, ParticleBlocks) else state


def _detail(
    targets: int, form: str, seed: int, lap: Lap, particles: int, pairs: float
) -> dict[str, Any]:
    """Return the figures of one run.

    The total is filter and extraction, M09's workload, without the association.
    """
    filtering, extraction, association = (Spread.of(column, 1e3) for column in lap.seconds.T)
    total = Spread.of(lap.seconds[:, :2].sum(axis=1), 1e3)
    cpu = Spread.of(lap.cpu[:, :2].sum(axis=1), 1e3)
    return {
        "targets": targets,
        "form": form,
        "seed": seed,
        "particles": particles,
        "pairs": round(pairs),
        "total_ms": total.median,
        "total": total.as_dict(),
        "cpu": cpu.as_dict(),
        "filter": filtering.as_dict(),
        "extract": extraction.as_dict(),
        "associate": association.as_dict(),
        "ns_per_pair": 1e6 * filtering.median / max(pairs, 1),
        "count_error": float(np.mean(lap.count)),
        "ospa": float(np.nanmean(lap.ospa)),
    }


def _row(targets: int, form: str, mine: list[dict[str, Any]]) -> Row:
    """The line of a size and form: the run with the median total."""
    middle = sorted(mine, key=lambda d: d["total_ms"])[len(mine) // 2]
    note = " + ".join(f"{name} {middle[name]['median']:.3g}" for name in ("filter", "extract"))
    note += f"; association {middle['associate']['median']:.3g}; OSPA {middle['ospa']:.1f} px"
    return Row(
        f"{targets} targets, {form} births",
        middle["total_ms"],
        "ms",
        Spread(**middle["total"]),
        note=note,
        cpu=middle["cpu"]["median"],
    )


def has_threads() -> bool:
    """Return true if the filter has a setting for its threads."""
    return any(field.name == "threads" for field in fields(ParticlePHD))


def threaded(crowd: Crowd, threads: int, *, worst: bool = True) -> AnyStages:
    """The workload's stages with that many threads."""
    return stages(crowd, worst=worst, sets=(f"filter.threads={threads}",))


def _threads(scale: Scale, say: Callable[[str], None]) -> tuple[dict[str, Any], list[Row]]:
    """One thread against two, in turns."""
    if not has_threads():
        return {"reason": "the filter has no setting for threads"}, []
    cores = os.cpu_count() or 1
    if cores < 2:
        return {"reason": "this machine has one core"}, []
    say(f"{scale.threads_at} targets, two threads")
    crowd = Crowd(scale.threads_at, scale.frames)
    loops = [Ours(threaded(crowd, threads), 1) for threads in (1, 2)]
    one, two = race(loops, draw(crowd, 1), min(WARM_UP, scale.frames // 2), scale.budget)
    same = bool(np.array_equal(plain(loops[0].state).state, plain(loops[1].state).state))
    ratio = float(np.median(one.total) / np.median(two.total))
    alone = float(np.median(one.seconds[:, 0]) / np.median(two.seconds[:, 0]))
    spread = Spread.of(two.total, 1e3)
    rows = [
        Row(f"{crowd.targets} targets, worst births, two threads", spread.median, "ms", spread),
        Row(
            f"two threads against one, {crowd.targets} targets",
            ratio,
            "×",
            least=1.5,
            note=(
                f"filter alone {alone:.2f} ×; {'same' if same else 'DIFFERENT'} particles; {cores}"
                " cores, not idle perhaps"
            ),
        ),
    ]
    entry = {
        "targets": crowd.targets,
        "ratio": ratio,
        "filter_ratio": alone,
        "identical": same,
        "two_ms": spread.as_dict(),
    }
    return entry, rows
