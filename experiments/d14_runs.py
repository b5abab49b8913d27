"""The runs behind D14's tables: SMC PHD and MCMC filters, and a Kalman filter per target, on
centroids of people.

All filters get the same centroids, true ones with Gaussian noise, and D14's model (preset ``d14``):
constant velocity, process variance 2 on every component, the measurement's own variance. The MCMC
and Kalman filters also get the identity of each measurement, as in D14; the PHD filter does not.
States are mapped to the truth one to one within `GATE` pixels.

The Kalman filter per target gives the exact posterior mean for known associations; the distance to
it is the sampling error of the MCMC filter. Three worlds: points drawn from D14's model, for which
this mean is the optimal estimate; the simulated corridor; the annotated people of a CAVIAR
sequence.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from experiments.common import need_data
from experiments.corridor import PATHS, centroids, measured, paths, wandering
from experiments.given_mcmc import GivenMCMC
from phdtrack import config
from phdtrack.filters.mcmc import Joint
from phdtrack.formats import read_truth
from phdtrack.metrics import TargetErrors, rmse_per_target
from phdtrack.protocols import AnyStages, Model
from phdtrack.types import F8, I8, SequenceInfo, Truth

VARIANCES = (0.5, 1.0, 2.0)
GATE = 10.0
"""Pixels: half the width of a person far away."""
BURN = 50
INFOS = {
    "model": PATHS.info,
    "corridor": PATHS.info,
    "caviar": SequenceInfo(384, 288, 25.0, 295, "OneLeaveShop1cor"),
}
KALMAN = "Kalman"
FILTERS = {
    "SMC PHD": None,
    "MCMC joint": GivenMCMC(burn_in=BURN, ancestors="joint"),
    "MCMC": GivenMCMC(burn_in=BURN, ancestors="each"),
    "MCMC greedy": GivenMCMC(burn_in=BURN, greedy=True),
}
"""The filter in place of the preset's, but for N. With ``joint`` all targets of a sample have one
ancestor.
"""
# The SMC PHD filter with N particles in all, in place of N for each estimated target.
IN_ALL = "SMC PHD, N in all"
MODEL_SEEDS = 3
"""At most so many seeds of the points drawn from the model, each of which draws paths too."""
SETTLED = 25
"""Frames after a target's first from which it counts as settled: a second."""


@dataclass(frozen=True, slots=True)
class CorridorRun:
    """One run; ``number`` is N, 0 for the Kalman filter. The measurements depend on world, variance
    and seed only.
    """

    world: str
    filter: str
    number: int
    variance: float
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points (2, M) of frames (M,), and their identities (M,); −1 where unknown."""

    frame: I8
    identity: I8
    point: F8


@dataclass(frozen=True, slots=True, eq=False)
class RunErrors:
    """Errors of one run, RMSE per axis in pixels.

    Attributes
    ----------
    truth, measurement : (G,) against each target's true and measured centroids; NaN for a target
        never located.
    located : (G,) share of its frames in which a state is within the gate of the truth.
    overall, settled, to_posterior : over all targets, against the truth; in the frames after their
        first second; against the Kalman filter's states.
    detected : over all targets, against the measurements.
    spare : states a frame that are mapped to no target.
    seconds : of processor time for the whole sequence, filter and extraction.
    """

    truth: F8
    measurement: F8
    located: F8
    overall: float
    settled: float
    to_posterior: float
    detected: float
    spare: float
    seconds: float


@lru_cache(maxsize=4)
def scene(world: str, seed: int = 0) -> Truth:
    """The truth: points drawn from D14's model, the simulated corridor, or the annotated people of
    CAVIAR.
    """
    if world == "model":
        model = stages_of(CorridorRun(world, KALMAN, 0, 1.0, seed)).model
        deviation = float(np.sqrt(model.sensor.states(np.zeros((2, 1)))[1][0, 2, 2]))
        return wandering(model.motion, deviation, np.random.default_rng([seed, 2]))
    return paths() if world == "corridor" else read_truth(need_data() / "caviar" / "cols1gt.xml")


def scans_of(job: CorridorRun) -> tuple[F8, ...]:
    """The measurements (3, n) of every frame, with identities."""
    rng = np.random.default_rng([job.seed, round(100 * job.variance)])
    return measured(scene(job.world, job.seed), INFOS[job.world].frames, job.variance, rng)


def stages_of(job: CorridorRun) -> AnyStages:
    """The stages of a run; for the Kalman filter those of the PHD filter, whose model it uses."""
    stages = config.build(
        config.load(None, (f"sensor.noise_variance={job.variance}",), "d14"), INFOS[job.world]
    )
    if job.filter == KALMAN:
        return stages
    chain = FILTERS.get(job.filter)
    if chain is None:
        most = job.number if job.filter == IN_ALL else 0
        return replace(
            stages,
            filter=replace(stages.filter, particles_per_target=job.number, max_particles=most),
        )
    return replace(
        stages, filter=replace(chain, samples=job.number), extractor=Joint(merge_iou=1.0)
    )


def track(job: CorridorRun) -> tuple[Points, float]:
    """The states that the filter of a job reports, and the seconds of processor time."""
    scans = scans_of(job)
    stages = stages_of(job)
    began = time.thread_time()
    if job.filter == KALMAN:
        found = kalman(stages.model, scans)
        return found, time.thread_time() - began
    named = FILTERS.get(job.filter) is not None
    rng = np.random.default_rng([job.seed, job.number, 1])
    state = stages.filter.start(stages.model, rng)
    points = []
    tags = []
    for whole in scans:
        z = whole if named else np.ascontiguousarray(whole[:2])
        state, _ = stages.filter.step(state, z, stages.model, 1.0, rng)
        states = stages.extractor.extract(state, z, stages.model)
        points.append(states.state[:2])
        tags.append(states.tag if named else np.full(len(states), -1))
    spent = time.thread_time() - began
    frame = np.repeat(np.arange(1, len(scans) + 1), [p.shape[1] for p in points])
    return Points(frame, np.concatenate(tags), np.hstack(points)), spent


def kalman(model: Model, scans: Sequence[F8]) -> Points:
    """Means of the exact posterior for known associations: a Kalman filter for every target.

    A target starts at its first measurement, with the state and covariance that this implies.
    """
    rows = list(model.sensor.observed)
    mean = np.zeros((4, 0))
    cov = np.zeros((0, 4, 4))
    label = np.zeros(0)
    frames = []
    labels = []
    points = []
    for number, z in enumerate(scans, 1):
        fresh, start = model.sensor.states(z)
        known = np.isin(z[2], label)
        at = np.searchsorted(label, z[2])
        place = at[known]
        ahead, f, q = model.motion.transition(np.ascontiguousarray(mean[:, place]), 1.0)
        cov = f @ cov[place] @ f.transpose(0, 2, 1) + q
        fresh[:, known], start[known] = updated(model, rows, ahead, cov, z[:, known])
        order = np.argsort(z[2])
        mean = fresh[:, order]
        cov = start[order]
        label = z[2, order]
        frames.append(np.full(len(label), number))
        labels.append(label.astype(np.int64))
        points.append(mean[:2])
    return Points(np.concatenate(frames), np.concatenate(labels), np.hstack(points))


def updated(model: Model, rows: list[int], mean: F8, cov: F8, z: F8) -> tuple[F8, F8]:
    """Means (d, n) and covariances of targets with measurements ``z`` (m, n), column by column."""
    cross = cov[:, :, rows]
    innovation = cross[:, rows] + model.sensor.covariance(z, mean)
    gain = np.linalg.solve(innovation, cross.transpose(0, 2, 1)).transpose(0, 2, 1)
    step = model.sensor.innovation(z, model.sensor.predicted_measurements(mean))
    return mean + np.einsum("pdr,rp->dp", gain, step), cov - gain @ cross.transpose(0, 2, 1)


def posterior_deviation(variance: float) -> float:
    """Steady-state deviation of a coordinate in the Kalman filter of D14's model, pixels."""
    model = stages_of(CorridorRun("corridor", KALMAN, 0, variance, 0)).model
    mean = np.zeros((4, 1))
    z = np.zeros((3, 1))
    _, cov = model.sensor.states(z)
    _, f, q = model.motion.transition(mean, 1.0)
    for _ in range(200):
        _, cov = updated(model, [0, 1], mean, f @ cov @ f.transpose(0, 2, 1) + q, z)
    return math.sqrt(cov[0, 0, 0])


def work(job: CorridorRun) -> RunErrors:
    """The errors of one run."""
    found, seconds = track(job)
    exact, _ = track(CorridorRun(job.world, KALMAN, 0, job.variance, job.seed))
    truth = scene(job.world, job.seed)
    scans = scans_of(job)
    true = Points(truth.frame, truth.identity, centroids(truth))
    frame = np.repeat(np.arange(1, len(scans) + 1), [z.shape[1] for z in scans])
    every = np.hstack(scans)
    against_truth = errors(true, found)
    against_measured = errors(Points(frame, every[2].astype(np.int64), every[:2]), found)
    return RunErrors(
        axis(against_truth),
        axis(against_measured),
        against_truth.mapped / against_truth.frames,
        against_truth.overall / math.sqrt(2),
        errors(settled(true), found).overall / math.sqrt(2),
        errors(exact, found).overall / math.sqrt(2),
        against_measured.overall / math.sqrt(2),
        (len(found.frame) - against_truth.mapped.sum()) / len(scans),
        seconds,
    )


def errors(true: Points, found: Points) -> TargetErrors:
    """RMSE per target after association."""
    return rmse_per_target(true.frame, true.identity, true.point, found.frame, found.point, GATE)


def axis(of: TargetErrors) -> F8:
    """(G,) RMSE per axis: the root of the mean of both axes' squares."""
    each: F8 = of.rmse / math.sqrt(2)
    return each


def settled(true: Points) -> Points:
    """The truth without each target's first second."""
    first = {int(i): true.frame[true.identity == i].min() for i in np.unique(true.identity)}
    late = true.frame >= np.array([first[int(i)] for i in true.identity]) + SETTLED
    return Points(true.frame[late], true.identity[late], true.point[:, late])


def seeds_of(world: str, seeds: int) -> int:
    """The number of seeds of a world."""
    return min(seeds, MODEL_SEEDS) if world == "model" else seeds


def jobs_of(numbers: Sequence[int], seeds: int) -> list[CorridorRun]:
    """Every filter in every setting, seed by seed, so that an interrupted run has complete
    seeds.
    """
    filters = [(name, number) for number in numbers for name in FILTERS] + [(KALMAN, 0)]
    return [
        CorridorRun(world, name, number, variance, seed)
        for seed in range(seeds)
        for world in INFOS
        if seed < seeds_of(world, seeds)
        for variance in VARIANCES
        for name, number in filters
    ] + [
        CorridorRun("corridor", IN_ALL, number, variance, seed)
        for seed in range(seeds)
        for variance in VARIANCES
        for number in numbers
    ]
