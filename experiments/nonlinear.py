"""The standard nonlinear scenario, targets that turn: OSPA of the particle filters and of the
Gaussian ones by sigma points.

The scenario is `standard_scenes.turning`: ten targets over 100 scans, measured by bearing and
range, with the noises of the literature. All filters have the scenario's model. A section of vo.md.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from experiments.bearing import BearingSensor, TurningMotion
from experiments.common import Options, filled, pyplot
from experiments.scans import (
    FEW,
    NEWBORN,
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
from experiments.standard_scenes import (
    DEGREE,
    TURNING_LAST,
    TURNING_START,
    Turning,
    turning,
    turning_states,
)
from phdtrack.filters import GMCPHD
from phdtrack.filters.extract import Components
from phdtrack.models import FixedBirth, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import F8, GaussianMixture

# The noises of this scene in the literature, see `standard_scenes`.
CASES = {
    "σ_w 5, σ_θ 2°, σ_r 10, λ 20": Turning(),
    "σ_w 15, σ_θ 2°, σ_r 20, λ 20": Turning(sd_acceleration=15.0, sd_range=20.0),
    "σ_w 15, σ_θ 1°, σ_r 5, λ 10": Turning(
        sd_acceleration=15.0, sd_bearing=DEGREE, sd_range=5.0, clutter_rate=10.0
    ),
    "as the first, p_D falling": Turning(fade=2000.0),
}
FIRST_CASE = next(iter(CASES))
FILTERS: dict[str, Stages] = filters_of("unscented") | {
    "gm-cphd": (GMCPHD(1e-5, 2.0, 100, transform="unscented"), Components(merge_iou=1.0)),
}


def world(scenario: Turning) -> Model:
    """The scenario's parameters as a model; metres, radians, seconds."""
    mean = scenario.birth_mean
    sd = np.array(scenario.birth_sd)
    spread = np.tile(np.diag(sd**2), (mean.shape[1], 1, 1))
    sensor = BearingSensor(
        scenario.sd_bearing,
        scenario.sd_range,
        scenario.p_detect,
        scenario.fade,
        birth_speed=2**0.5 * float(sd[2]),
        turn=float(sd[4]),
    )
    return Model(
        TurningMotion(
            scenario.sd_acceleration,
            scenario.sd_turn,
            scenario.p_survive ** (1 / scenario.interval),
            "piecewise",
        ),
        sensor,
        FixedBirth(GaussianMixture(np.array(scenario.birth_weight), mean, spread), NEWBORN),
        UniformClutter(scenario.clutter_rate, scenario.clutter_volume),
        rate=1.0,
    )


def realisation(case: str, seed: int) -> Realisation:
    """The scans of one seed."""
    scene = turning(np.random.default_rng(seed), CASES[case])
    scenario = scene.model
    return Realisation(
        world(scenario),
        scene.measurement,
        scene.state,
        scene.identity,
        scenario.interval,
        scenario.ospa_cutoff,
    )


def run(job: FilterRun) -> SetErrors:
    """Run one filter on one realisation."""
    realised = realisation(job.case, job.seed)
    return measured(realised, followed(realised, FILTERS[job.filter], job.seed))


def picture(path: Path, seed: int = 0) -> None:
    """Draw one realisation over the targets' paths: all measurements, and the states of each
    filter.
    """
    plt = pyplot()
    realised = realisation(FIRST_CASE, seed)
    rows = math.ceil((1 + len(FILTERS)) / 2)
    figure, grid = plt.subplots(
        rows, 2, figsize=(11, 3.1 * rows), layout="constrained", squeeze=False
    )
    axes = grid.ravel()
    places = {"measured": [realised.model.sensor.states(z)[0][:2] for z in realised.scans]}
    for name, stages in FILTERS.items():
        places[name] = [found.state[:2] for found, _ in followed(realised, stages, seed)]
    for axis, (name, each) in zip(axes, places.items(), strict=False):
        _ways(axis)
        axis.plot(
            *np.hstack(each),
            ".",
            ms=2.5,
            color="C3" if name in FILTERS else "0.6",
            zorder=3 if name in FILTERS else 1,
        )
        axis.set(title=name, aspect="equal", xlim=(-2050, 2050), ylim=(-50, 2100))
    for axis in axes[len(places) :]:
        axis.set_axis_off()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _ways(axis: Any) -> None:
    """Draw the observed half disc and the targets' paths."""
    angle = np.linspace(0, math.pi, 181)
    axis.plot(Turning().radius * np.cos(angle), Turning().radius * np.sin(angle), color="0.8", lw=1)
    for who, way in ways().items():
        axis.plot(*way, color="0.35", lw=1)
        axis.plot(*TURNING_START[who - 1, :2], "o", ms=4, mfc="none", mec="0.35")


def ways() -> dict[int, F8]:
    """The path (2, scans) of each target, from its first scan to its last."""
    places: dict[int, list[F8]] = {}
    for scan in range(1, TURNING_LAST.max() + 1):
        state, identity = turning_states(scan)
        for who, x in zip(identity.tolist(), state.T, strict=True):
            places.setdefault(who, []).append(x[:2])
    return {who: np.array(place).T for who, place in places.items()}


def section(options: Options) -> str:
    """Measure and draw; return the section of the page."""
    runs = {case: options.number(RUNS if case == FIRST_CASE else SIDE, FEW) for case in CASES}
    found = compared(run, runs, tuple(FILTERS), "turning", options)
    number = np.array([truth.shape[1] for truth in realisation(FIRST_CASE, 0).truth])
    curves(
        {name: found[FIRST_CASE, name] for name in FILTERS},
        number,
        options.folder / "vo-turning-ospa.png",
    )
    picture(options.folder / "vo-turning-states.png")
    return filled("nonlinear", **tables(found, {}))
