"""The standard linear-Gaussian scenario: OSPA of the PHD and the cardinalised PHD filters, by
Gaussians and by particles.

The scenario is `standard_scenes.linear_gaussian`: twelve targets over 100 scans, clutter uniform
over the region. All filters have its true parameters. A section of vo.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from experiments.common import Options, filled, table
from experiments.scans import (
    FEW,
    NEWBORN,
    PER_TARGET,
    PLAIN_PMB,
    RUNS,
    SIDE,
    FilterRun,
    Realisation,
    SetErrors,
    Stages,
    compared,
    curves,
    filters_of,
    followed,
    measured,
    tables,
)
from experiments.standard_scenes import LinearGaussian, linear_gaussian
from phdtrack.compare.statistics import interval
from phdtrack.filters import GMPHD, BestBernoullis
from phdtrack.filters.extract import Components
from phdtrack.models import FixedBirth, PlaneBirth, PlaneMotion, PlaneSensor, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture

# Clutter points per scan, and p_D.
CASES = {
    "λ 30, p_D 0.98": (30.0, 0.98),
    "λ 60, p_D 0.98": (60.0, 0.98),
    "λ 30, p_D 0.7": (30.0, 0.7),
}
EASY, CLUTTERED, HIDDEN = CASES
# The mean OSPA of other implementations.
ELSEWHERE = {
    (EASY, "gm-phd"): "17.6",
    (CLUTTERED, "gm-phd"): "20.7",
    (HIDDEN, "gm-phd"): "41.7",
    (EASY, "gm-cphd"): "about 16.2",
}
# The mean OSPA of labelled filters of others in the first case, over a few runs each.
LABELLED = {"joint GLMB": 10.9, "joint LMB": 14.9}
# What a few runs may be, and our filters that keep identities.
A_FEW = 5
WITH_IDENTITIES = ("mht", "pmbm", "pmb")
AGILITY = "pmb, agility found"
FILTERS: dict[str, Stages] = filters_of("linear") | {
    "gm-phd, anywhere": (GMPHD(1e-5, 2.0, 100), Components(repeat=True)),
    AGILITY: (
        replace(PLAIN_PMB, acceleration_factors=(1.0, 0.3, 0.1)),
        BestBernoullis(merge_iou=0.5),
    ),
}


def world(scenario: LinearGaussian) -> Model:
    """The scenario's parameters as a model; metres, seconds."""
    mean = scenario.birth_mean
    spread = np.tile(scenario.birth_sd**2 * np.eye(4), (mean.shape[1], 1, 1))
    birth = GaussianMixture(np.full(mean.shape[1], scenario.birth_weight), mean, spread)
    return Model(
        PlaneMotion(
            scenario.sd_acceleration, scenario.p_survive ** (1 / scenario.interval), "piecewise"
        ),
        PlaneSensor(
            scenario.p_detect, "fixed", scenario.sd_position, birth_speed=2**0.5 * scenario.birth_sd
        ),
        FixedBirth(birth, NEWBORN),
        UniformClutter(scenario.clutter_rate, (2 * scenario.half_width) ** 2),
        rate=1.0,
    )


def realisation(case: str, seed: int) -> Realisation:
    """The scans of one seed, each measurement with its covariance, as the plane's sensor expects
    it.
    """
    scene = linear_gaussian(np.random.default_rng(seed), *CASES[case])
    scenario = scene.model
    variance = np.array([[scenario.sd_position**2], [0.0], [scenario.sd_position**2]])
    scans = tuple(
        np.vstack([place, np.tile(variance, place.shape[1])]) for place in scene.measurement
    )
    return Realisation(
        world(scenario), scans, scene.state, scene.identity, scenario.interval, scenario.ospa_cutoff
    )


def anywhere(model: Model) -> PlaneBirth:
    """Births uniform over the region, around the measurements, at the scenario's rate."""
    assert isinstance(model.birth, FixedBirth)
    side = LinearGaussian().half_width
    return PlaneBirth(model.birth.places.mass, 0.0, NEWBORN, (-side, -side, side, side))


def run(job: FilterRun) -> SetErrors:
    """Run one filter on one realisation."""
    realised = realisation(job.case, job.seed)
    if "anywhere" in job.filter:
        realised = replace(realised, model=replace(realised.model, birth=anywhere(realised.model)))
    return measured(realised, followed(realised, FILTERS[job.filter], job.seed))


def section(options: Options) -> str:
    """Measure and draw; return the section of the page."""
    number = {case: options.number(RUNS if case == EASY else SIDE, FEW) for case in CASES}
    found = compared(run, number, tuple(FILTERS), "linear", options)
    targets = np.array([truth.shape[1] for truth in realisation(EASY, 0).truth])
    # Variants would cover the curves of their filters.
    drawn = {name: found[EASY, name] for name in FILTERS if "," not in name}
    curves(drawn, targets, options.folder / "vo-linear-ospa.png")
    return filled(
        "standard",
        particles=PER_TARGET,
        agility=AGILITY,
        labelled=labelled({name: found[EASY, name] for name in WITH_IDENTITIES}),
        few=A_FEW,
        **tables(found, ELSEWHERE),
    )


def labelled(found: Mapping[str, Sequence[SetErrors]]) -> str:
    """A table of our filters with identities beside labelled filters of others: OSPA, what it is
    less theirs, and the error that a mean over `A_FEW` runs has.
    """
    rows = []
    for name, each in found.items():
        runs = [float(one.ospa.mean()) for one in each]
        mean = interval(runs)
        error = np.std(runs, ddof=1) / A_FEW**0.5 if len(runs) > 1 else np.nan
        gaps = (f"{mean.mean - other:+.1f}" for other in LABELLED.values())
        rows.append((name, f"{mean:.2f}", *gaps, f"{error:.1f}"))
    header = (f"less {name}, {value:g}" for name, value in LABELLED.items())
    return table(("filter", "OSPA", *header, f"error of {A_FEW} runs"), rows)
