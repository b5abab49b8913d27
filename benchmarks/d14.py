"""D14's time: 475 frames of the simulated corridor with N = 4000, on one core (the paper: 53 s and
63 s).

The MCMC filter samples the posterior of given associations, ``mcmc`` with moves between the
targets' common ancestors, ``mcmc_each`` with ancestors of every target's own; all with extraction.
"""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.parts import Outcome, Row, Scale
from benchmarks.timing import Spread, clock, took

KEYS = ("d14_seconds",)
NAMES = {"mcmc": "MCMC joint", "mcmc_each": "MCMC", "particle-phd": "SMC PHD"}


def run(scale: Scale, say: Callable[[str], None]) -> Outcome:
    """Seconds for the whole sequence; the filters take turns."""
    from experiments.d14_runs import CorridorRun, track

    number = 4000 if scale.others else 100
    spent: dict[str, list[tuple[float, float]]] = {key: [] for key in NAMES}
    for repeat in range(1 + min(scale.repeats, 7)):
        for key, name in NAMES.items():
            say(f"{name}, N = {number}")
            began = clock()
            track(CorridorRun("corridor", name, number, 1.0, repeat))
            # The first round compiles.
            if repeat:
                spent[key].append(took(began, clock()))
    rows = []
    seconds = {}
    for key, each in spent.items():
        wall, cpu = (Spread.of(times) for times in zip(*each, strict=True))
        seconds[key] = wall.median
        note = f"least {wall.least:.2f} s; settings and measurements included"
        rows.append(
            Row(
                f"{NAMES[key]}, N = {number}, 475 frames",
                wall.median,
                "s",
                wall,
                note=note,
                cpu=cpu.median,
            )
        )
    return Outcome(tuple(rows), {"d14_seconds": seconds})
