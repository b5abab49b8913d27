"""The standard linear-Gaussian scenario with p_D and λ unknown, or λ wrong by a factor of three: a
section of vo.md.

The filter starts with wrong rates and learns them from the scans (`learned_rates`), or keeps them.
p_D is learned from the tracks: those of the association, or the MHT's own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from experiments import standard
from experiments.common import Options, filled, table
from experiments.learned_rates import (
    RateLearning,
    RatesLearning,
    RatesSettings,
    priors_of,
    with_rate,
)
from experiments.scans import FilterRun, Realisation, SetErrors, Stages, apart, measure, measured
from phdtrack import pipeline
from phdtrack.associate.graph import GraphMatching
from phdtrack.associate.labels import Labelled
from phdtrack.models import UniformClutter
from phdtrack.protocols import AnyStages, Learning, Model
from phdtrack.protocols import Stages as Whole
from phdtrack.types import Detections, Estimates

RUNS = 8
FEW = 2
# Usual initial values of an image-based tracker: the package's own p_D, ten false alarms a scan.
P_DETECT = 0.8
CLUTTER = 10.0
FILTERS = ("gm-phd", "gm-cphd", "particle-phd", "mht", "pmb")
LABELLED = ("mht", "pmb")
# Scans until a detection is labelled, and after which one counts for 37 %; scans over which tracks
# are linked, and the probability that a target continues for another scan without a state.
WAIT = 3.0
MEMORY = 600.0
SPAN = 5.0
MISS = 0.5
RATES = RatesSettings(
    detection=True, clutter=True, cautious=False, memory=MEMORY, update_interval=0.0
)
# Half the side of a target's box in metres; any value will do.
_HALF = 0.3


@dataclass(frozen=True, slots=True)
class Start:
    """The initial values of the filter: p_D (0: the true one), λ (0: a multiple of the true one);
    and whether it learns.
    """

    p_detect: float
    clutter: float
    multiple: float
    learns: bool


STARTS = {
    "known": Start(0.0, 0.0, 1.0, False),
    "unknown, learned": Start(P_DETECT, CLUTTER, 1.0, True),
    "unknown, kept": Start(P_DETECT, CLUTTER, 1.0, False),
    "λ a third, learned": Start(0.0, 0.0, 1 / 3, True),
    "λ a third, kept": Start(0.0, 0.0, 1 / 3, False),
    "λ three times, learned": Start(0.0, 0.0, 3.0, True),
    "λ three times, kept": Start(0.0, 0.0, 3.0, False),
}
KNOWN = "known"
UNKNOWN = "unknown, learned"


def begun(model: Model, start: Start) -> Model:
    """The model with the initial values of the filter."""
    if start.p_detect:
        model = replace(model, sensor=with_rate(model.sensor, start.p_detect))
    if isinstance(model.clutter, UniformClutter):
        rate = start.clutter or start.multiple * model.clutter.clutter_per_frame
        model = replace(model, clutter=with_rate(model.clutter, rate))
    return model


def whole(model: Model, stages: Stages, learns: bool, labelled: bool) -> AnyStages:
    """The stages: filter and extraction, tracks and, if it ``learns``, rates."""
    learning: Learning[Any] | None = None
    if learns:
        learning = RateLearning(RatesLearning(RATES, priors_of(model), WAIT))
    associator = (
        Labelled(max_coast=0.2, coast_by_evidence=False)
        if labelled
        else GraphMatching(window=SPAN, gap_cost=-model.rate * math.log(MISS))
    )
    return Whole(model, *stages, associator, learning, longest_interval=0.0)


def followed(
    realised: Realisation, stages: AnyStages, seed: int
) -> Iterator[tuple[Estimates, float]]:
    """The estimates of each scan, and their seconds of processor time."""
    rng = np.random.default_rng([seed, 1])
    state = pipeline.start(stages, rng)
    for k, z in enumerate(realised.scans, start=1):
        began = time.thread_time()
        place = z[:2].T
        found = Detections.of(np.hstack([place - _HALF, place + _HALF]))
        state, step = pipeline.advance(stages, state, found, k, k * realised.interval, rng)
        yield step.estimates, time.thread_time() - began


def run(job: FilterRun) -> SetErrors:
    """Run one filter from one start on one realisation."""
    case, start = job.case.split(" | ")
    realised = standard.realisation(case, job.seed)
    values = STARTS[start]
    stages = whole(
        begun(realised.model, values),
        standard.FILTERS[job.filter],
        values.learns,
        job.filter in LABELLED,
    )
    return measured(realised, followed(realised, stages, job.seed))


def section(options: Options) -> str:
    """Measure; return the section of the page."""
    number = options.number(RUNS, FEW)
    cases, filters = (
        (tuple(standard.CASES)[:1], FILTERS[:1])
        if options.quick
        else (tuple(standard.CASES), FILTERS)
    )
    pairs = [(case, name, start) for case in cases for name in filters for start in STARTS]
    found = measure(run, {(f"{c} | {s}", f): number for c, f, s in pairs}, "rates unknown", options)
    rows = []
    for case in cases:
        for name in filters:
            known = found[f"{case} | {KNOWN}", name]
            level = float(np.mean([outcome.ospa.mean() for outcome in known]))
            cells = [case, name, f"{level:.2f}"]
            for start in [s for s in STARTS if s != KNOWN]:
                gap = apart(found[f"{case} | {start}", name], known)
                cells.append(f"{100 * gap.mean / level:+.1f} ± {100 * gap.half / level:.1f} %")
            rows.append(tuple(cells))
    return filled(
        "unknown",
        runs=number,
        rows=table(("", "filter", KNOWN, *[s for s in STARTS if s != KNOWN]), rows),
        p_detect=P_DETECT,
        clutter=f"{CLUTTER:g}",
    )
