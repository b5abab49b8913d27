"""The standard linear-Gaussian scenario: OSPA of the PHD and the cardinalised PHD filters, by Gaussians and by particles.

    python -m phdtrack.reproduce.standard [runs [folder]]

The scenario is `phdtrack.simulate.linear_gaussian`: twelve targets over 100 scans, clutter uniform over the region. Every
filter is given its true parameters, prunes at 1e-5, merges at squared distance 4 and keeps 100 Gaussians, or 1500 particles
per target. The same scans are given to all filters. OSPA with c = 100 m, p = 1, mean over scans and runs. With a folder,
every run is kept there, and what is there is not run again.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.extract import Components, CountedComponents, CountedMixture, KMeans
from phdtrack.filters import GMCPHD, GMPHD, ParticleCPHD, ParticlePHD
from phdtrack.metrics import ospa
from phdtrack.models import FixedBirth, PlaneMotion, PlaneSensor, UniformClutter
from phdtrack.protocols import Extractor, Filter, Model
from phdtrack.reproduce.common import in_parallel, table, write
from phdtrack.simulate.points import LinearGaussian, linear_gaussian
from phdtrack.types import F8, GaussianMixture

RUNS = 100
# Clutter points per scan, and p_D.
SETTINGS = ((30.0, 0.98), (60.0, 0.98), (30.0, 0.7))
# The mean OSPA of other implementations.
ELSEWHERE = {
    (30.0, 0.98, "gm-phd"): "17.6",
    (60.0, 0.98, "gm-phd"): "20.7",
    (30.0, 0.7, "gm-phd"): "41.7",
    (30.0, 0.98, "gm-cphd"): "about 16.2",
}
COMPARED = (("gm-cphd", "gm-phd"), ("particle-phd", "gm-phd"), ("particle-cphd", "gm-cphd"))
PER_TARGET, NEWBORN = 1500, 500

# Targets that start together lie in one place: without a number a peak counts as often as its mass says.
FILTERS: dict[str, tuple[Filter[Any], Extractor[Any]]] = {
    "gm-phd": (GMPHD(1e-5, 2.0, 100), Components(repeat=True)),
    "gm-cphd": (GMCPHD(1e-5, 2.0, 100), CountedComponents()),
    "particle-phd": (ParticlePHD(PER_TARGET), KMeans(lightest=0.5, overlap=1.0)),
    "particle-cphd": (ParticleCPHD(PER_TARGET), CountedMixture(overlap=1.0)),
}


PAGE = """# The standard linear-Gaussian scenario

Twelve targets over 100 scans, clutter uniform over 4 km²; OSPA in metres with c = 100 and p = 1, mean over scans and
{runs} runs ± its standard error. Every filter is given the scenario's true parameters and the same scans; {particles}
particles per target. Written by `python -m phdtrack.reproduce.standard`.

{rows}
*elsewhere*: what other implementations of the same filter reach. *mean count error*: of the number of states, absolute;
*bias*: signed. *ms per scan*: filter, extraction and OSPA, while other runs share the machine.

Differences, run by run on the same scans:

{claims}
Without a number (the PHD filters), a peak is extracted as often as its mass says; with one (the CPHD filters), the
heaviest peaks, as many as the most probable number.

Asked for: the GM-PHD filter at 17.6 ± 0.3 or better, the GM-CPHD filter at least 1.0 below it, the particle forms within
5 % of the Gaussian ones. At p_D = 0.7 the particle forms miss that, because they count fewer targets: one that is missed
keeps 0.3 of its mass and as many of its particles, and after two misses too few of them are where it is seen again.
"""


@dataclass(frozen=True, slots=True)
class Job:
    """One run of one filter; ``seed`` decides the scans, whatever the filter."""

    filter: str
    clutter: float
    p_detect: float
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Per scan: ``ospa`` in metres, ``error`` the number of states less that of targets; ``seconds`` a scan took."""

    ospa: F8
    error: F8
    seconds: float


def world(given: LinearGaussian) -> Model:
    """The scenario's parameters as a model; metres, seconds."""
    mean = given.birth_mean
    spread = np.tile(given.birth_sd**2 * np.eye(4), (mean.shape[1], 1, 1))
    birth = GaussianMixture(np.full(mean.shape[1], given.birth_weight), mean, spread)
    return Model(
        PlaneMotion(given.sd_acceleration, given.p_survive, given.interval, "piecewise"),
        PlaneSensor(given.p_detect, "fixed", given.sd_position, speed=2**0.5 * given.birth_sd),
        FixedBirth(birth, NEWBORN),
        UniformClutter(given.clutter_rate, (2 * given.half_width) ** 2),
        rate=1.0,
    )


def run(job: Job) -> Outcome:
    """One filter over one realisation."""
    scene = linear_gaussian(np.random.default_rng(job.seed), job.clutter, job.p_detect)
    given, model = scene.model, world(scene.model)
    recursion, extractor = FILTERS[job.filter]
    rng = np.random.default_rng([job.seed, 1])
    state = recursion.start(model, rng)
    distance, error = np.zeros(given.scans), np.zeros(given.scans)
    began = time.perf_counter()
    for k, (truth, place) in enumerate(zip(scene.state, scene.measurement, strict=True)):
        variance = np.array([[given.sd_position**2], [0.0], [given.sd_position**2]])
        z = np.vstack([place, np.tile(variance, place.shape[1])])
        state, _ = recursion.step(state, z, model, given.interval, rng)
        found = extractor.extract(state, z, model).state
        distance[k] = ospa(found[:2], truth[:2], given.ospa_cutoff, given.ospa_order)
        error[k] = found.shape[1] - truth.shape[1]
    return Outcome(distance, error, (time.perf_counter() - began) / given.scans)


@dataclass(frozen=True, slots=True)
class Summary:
    """Over runs: mean OSPA with its standard error, mean absolute and signed error of the count, milliseconds a scan."""

    ospa: float
    error: float
    count: float
    bias: float
    milliseconds: float

    @classmethod
    def of(cls, outcomes: Sequence[Outcome]) -> Summary:
        """The median of the time, because the first run of a process compiles."""
        each = np.array([outcome.ospa.mean() for outcome in outcomes])
        counts = np.concatenate([outcome.error for outcome in outcomes])
        return cls(
            float(each.mean()),
            float(each.std(ddof=1) / math.sqrt(len(each))),
            float(np.abs(counts).mean()),
            float(counts.mean()),
            1000 * float(np.median([outcome.seconds for outcome in outcomes])),
        )


@dataclass(frozen=True, slots=True)
class Kept:
    """`run`, with what was run before read from ``folder``; the empty string for none."""

    folder: str = ""

    def __call__(self, job: Job) -> Outcome:
        """The outcome of a job, from its file where there is one."""
        if not self.folder:
            return run(job)
        path = Path(self.folder) / f"{job.filter}-{job.clutter:g}-{job.p_detect:g}-{job.seed}.npz"
        if path.exists():
            with np.load(path) as kept:
                return Outcome(kept["ospa"], kept["error"], float(kept["seconds"]))
        outcome = run(job)
        path.parent.mkdir(parents=True, exist_ok=True)
        # Whole or not at all: a run that is broken off leaves no half of a file.
        part = path.with_suffix(".part.npz")
        np.savez(part, ospa=outcome.ospa, error=outcome.error, seconds=outcome.seconds)
        part.replace(path)
        return outcome


Case = tuple[float, float, str]


def measure(runs: int = RUNS, folder: str = "") -> dict[Case, list[Outcome]]:
    """Every filter in every setting, one run for each seed."""
    cases = [(clutter, p_detect, name) for clutter, p_detect in SETTINGS for name in FILTERS]
    jobs = [Job(name, clutter, p_detect, seed) for clutter, p_detect, name in cases for seed in range(runs)]
    found = in_parallel(Kept(folder), jobs, "standard scenario")
    return {case: found[i * runs : (i + 1) * runs] for i, case in enumerate(cases)}


def apart(ours: Sequence[Outcome], theirs: Sequence[Outcome]) -> tuple[float, float]:
    """Mean difference of the OSPA, run by run, and its standard error."""
    each = np.array([a.ospa.mean() - b.ospa.mean() for a, b in zip(ours, theirs, strict=True)])
    return float(each.mean()), float(each.std(ddof=1) / math.sqrt(len(each)))


def page(found: dict[Case, list[Outcome]]) -> str:
    """The page of results."""
    rows, claims = [], []
    for clutter, p_detect in SETTINGS:
        outcomes = {name: found[clutter, p_detect, name] for name in FILTERS}
        for name, each in outcomes.items():
            s = Summary.of(each)
            there = ELSEWHERE.get((clutter, p_detect, name), "")
            cells = (f"{s.ospa:.2f} ± {s.error:.2f}", there, f"{s.count:.2f}", f"{s.bias:+.2f}", f"{s.milliseconds:.1f}")
            rows.append((f"{clutter:g}", f"{p_detect:g}", name, *cells))
        for ours, theirs in COMPARED:
            difference, error = apart(outcomes[ours], outcomes[theirs])
            share = difference / np.mean([o.ospa.mean() for o in outcomes[theirs]])
            apart_by = (f"{difference:+.2f} ± {error:.2f}", f"{100 * share:+.1f} %")
            claims.append((f"{clutter:g}", f"{p_detect:g}", f"{ours} beside {theirs}", *apart_by))
    runs = len(next(iter(found.values())))
    header = ("λ", "p_D", "filter", "OSPA", "elsewhere", "mean count error", "bias", "ms per scan")
    return PAGE.format(
        runs=runs,
        rows=table(header, rows),
        claims=table(("λ", "p_D", "", "difference of OSPA", "share"), claims),
        particles=PER_TARGET,
    )


def main() -> None:
    """Measure, and write docs/results/standard.md."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else RUNS
    write("standard.md", page(measure(runs, sys.argv[2] if len(sys.argv) > 2 else "")))


if __name__ == "__main__":
    main()
