"""Accuracy of the filter's count: the mass of its intensity against the true number of targets,
with known parameters.

Truth by the filter's own model, `experiments.counting_scene`: ten targets at the start, p_S = 0.99,
births that keep the number. ``known``: the filter has all parameters and also the densities of
births and clutter. ``shipped``: it has the rates and the noises, but births and clutter are the
package's, uniform over the image and all sizes, although the false alarms have the sizes of the
targets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from experiments.common import Options, in_parallel, table, write
from experiments.counting_scene import PAPER_DETECTOR, Counting
from phdtrack.errors import InputError
from phdtrack.filters import ParticlePHD
from phdtrack.filters.extract import KMeans
from phdtrack.filters.phd_particle import Intensity
from phdtrack.kernels.gaussian import Births
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.models.volumes import image_volume
from phdtrack.protocols import Birth, Clutter, Model, Sensor
from phdtrack.simulate import DetectorModel, detect
from phdtrack.simulate.detector import ASPECTS, HEIGHTS
from phdtrack.types import F8, I8, Particles

Laws = Literal["known", "shipped"]
P_DETECT = (0.7, 0.9, 0.98)
CLUTTER = (0.0, 5.0, 20.0)
SEEDS = 20
FEW_SEEDS = 6
FRAMES = 200
# M07's numbers: particles per target, and around a detection without predicted mass.
PER_TARGET = 1500
MOST = 1000
# The cost of few particles is shown for one combination.
FEW = (300, 1500, 6000)
FEW_CASE = (0.7, 5.0)
# The squared radius that holds 99 % of a Gaussian in the plane.
_PLANE = -2 * math.log(0.01)


@dataclass(frozen=True, slots=True)
class SceneBirth:
    """γ of the scene: centres uniform over the frame, heights log-uniform, one aspect, ``rate``
    births per frame, of which there are 25 a second.

    Particles are drawn around the detections: heights log-uniform among those that could cause the
    detection, and centres from the noise inside its 99 % region. The weight is γ over the mixture
    of all proposals.
    """

    scene: Counting
    rate: float
    most: int = MOST

    def sample(
        self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator
    ) -> Particles:
        """Newborn particles around the detections that no predicted mass explains."""
        low, high = self._heights(z)
        counts = np.where(high > low, np.ceil(self.most * np.clip(1 - covered, 0, 1)), 0).astype(
            np.int64
        )
        parent = np.repeat(np.arange(z.shape[1]), counts)
        height = low[parent] * (high / low)[parent] ** rng.random(len(parent))
        radius = np.sqrt(-2 * np.log(1 - 0.99 * rng.random(len(parent))))
        angle = rng.uniform(0, 2 * math.pi, len(parent))
        size = np.stack([self.scene.aspect * height, height])
        centre = (
            z[:2, parent]
            + radius * np.stack([np.cos(angle), np.sin(angle)]) * size * PAPER_DETECTOR.jitter
        )
        amplitude = rng.standard_normal(len(parent)) * self.scene.birth_speed * size[0]
        angle = rng.uniform(0, 2 * math.pi, len(parent))
        x = np.vstack([centre, amplitude * np.cos(angle), amplitude * np.sin(angle), size])
        inside = (
            (centre[0] >= 0)
            & (centre[0] < self.scene.width)
            & (centre[1] >= 0)
            & (centre[1] < self.scene.height)
        )
        x = np.ascontiguousarray(x[:, inside])
        shortest, tallest = self.scene.birth_height
        gamma = (
            25
            * self.rate
            * seconds
            / (self.scene.width * self.scene.height * math.log(tallest / shortest) * x[5])
        )
        return Particles(
            x,
            gamma
            / self._proposal(
                x, z[:, counts > 0], low[counts > 0], high[counts > 0], counts[counts > 0]
            ),
        )

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """Raises `InputError`: log-uniform heights are not Gaussian."""
        raise InputError(
            "the births of the counting scene have no Gaussian form", cure="Use a particle filter"
        )

    def expected_count(self, z: F8, seconds: float) -> float:
        """Expected births in ``seconds``."""
        return 25 * self.rate * seconds

    def _heights(self, z: F8) -> tuple[F8, F8]:
        """(N,) each: heights of the shortest and the tallest newborn target that could have caused
        each detection, by its width and height.
        """
        reach = 4 * PAPER_DETECTOR.jitter_size
        smaller = np.minimum(z[2] / self.scene.aspect, z[3])
        larger = np.maximum(z[2] / self.scene.aspect, z[3])
        low, high = self.scene.birth_height
        return np.clip(larger / (1 + reach), low, high), np.clip(smaller / (1 - reach), low, high)

    def _proposal(self, x: F8, z: F8, low: F8, high: F8, counts: I8) -> F8:
        """(L,) Σ_j J_j p_j(x) over centre and height."""
        sigma = PAPER_DETECTOR.jitter * x[4:6, :, None]
        step = (x[:2, :, None] - z[:2, None, :]) / sigma
        distance2 = (step**2).sum(0)
        centre = (
            np.exp(-0.5 * distance2)
            / (2 * math.pi * sigma[0] * sigma[1] * 0.99)
            * (distance2 <= _PLANE * (1 + 1e-9))
        )
        height = x[5][:, None]
        eps = 1e-9
        among = (height >= low * (1 - eps)) & (height <= high * (1 + eps))
        density: F8 = centre * among / (height * np.log(high / low))
        total: F8 = density @ counts
        return total


@dataclass(frozen=True, slots=True)
class SceneClutter:
    """κ of the scene: Poisson(``rate``) false alarms, centres uniform over the frame, log-uniform
    height and aspect.
    """

    scene: Counting
    rate: float

    def intensity(self, z: F8) -> F8:
        """The density where false alarms occur, 0 elsewhere."""
        height = z[3] / self.scene.height
        aspect = z[2] / z[3]
        inside = (z[0] >= 0) & (z[0] < self.scene.width) & (z[1] >= 0) & (z[1] < self.scene.height)
        inside &= (
            (height >= HEIGHTS[0])
            & (height <= HEIGHTS[1])
            & (aspect >= ASPECTS[0])
            & (aspect <= ASPECTS[1])
        )
        spread = math.log(HEIGHTS[1] / HEIGHTS[0]) * math.log(ASPECTS[1] / ASPECTS[0])
        density: F8 = (
            inside * self.rate / (self.scene.width * self.scene.height * spread * z[2] * z[3])
        )
        return density


@dataclass(frozen=True, slots=True)
class Row:
    """Means over seeds and frames of one combination; ``states`` is the number that K-means
    finds.
    """

    laws: Laws
    p_detect: float
    clutter: float
    truth: float
    count: float
    states: float
    rms: float
    particles_per_target: int

    @property
    def bias(self) -> float:
        """Relative to the mean truth."""
        return self.count / self.truth - 1


def _model(scene: Counting, p_detect: float, clutter: float, laws: Laws) -> tuple[Model, Model]:
    """The model of the first frame, whose births are the initial targets, and the model of the
    others.
    """
    size = (float(scene.width), float(scene.height))
    motion = BoxMotion(
        scene.sd_velocity, scene.sd_size, scene.p_survive**25, min_size=1e-3, roughening=0.0
    )
    # A newborn's speed is in widths, the sensor's in √(wh).
    speed = scene.birth_speed * math.sqrt(scene.aspect)
    sensor = BoxSensor(p_detect, PAPER_DETECTOR.jitter_size, min_noise=0.0, birth_speed=speed)
    first: Birth
    later: Birth
    alarms: Clutter
    if laws == "known":
        first = SceneBirth(scene, float(scene.n))
        later = SceneBirth(scene, scene.births)
        alarms = SceneClutter(scene, clutter)
    else:
        first, later = (
            MeasurementBirth(25 * rate, particles=MOST, frame_size=size)
            for rate in (float(scene.n), scene.births)
        )
        alarms = UniformClutter(clutter, image_volume(size))
    model = Model(motion, sensor, later, alarms)
    return replace(model, birth=first), model


def run(
    p_detect: float,
    clutter: float,
    seed: int,
    frames: int = FRAMES,
    laws: Laws = "known",
    particles_per_target: int = PER_TARGET,
) -> F8:
    """(3, frames) the true number, the mass of the intensity and the number of states, frame by
    frame.
    """
    scene = Counting(10, frames=frames)
    rng = np.random.default_rng([seed, round(100 * p_detect), round(clutter)])
    truth = scene.figures(rng)
    alarms = DetectorModel(clutter_rate=clutter, clutter_of_all_sizes=laws == "known")
    seen = replace(
        alarms,
        p_detect=p_detect,
        jitter=PAPER_DETECTOR.jitter,
        jitter_size=PAPER_DETECTOR.jitter_size,
    )
    found = detect(truth, scene.info, rng, seen).table
    first, model = _model(scene, p_detect, clutter, laws)
    recursion = ParticlePHD(particles_per_target)
    extractor = KMeans()
    state: Intensity = recursion.start(model, rng)
    out = np.zeros((3, frames))
    out[0] = np.bincount(truth.frame, minlength=frames + 1)[1 : frames + 1]
    for k in range(frames):
        now = model if k else first
        z = model.sensor.measure(found.at(k + 1))
        state, info = recursion.step(state, z, now, 1.0, rng)
        out[1, k] = info.mass
        out[2, k] = len(extractor.extract(state, z, now))
    return out


def row(
    p_detect: float,
    clutter: float,
    seeds: Sequence[int] = range(SEEDS),
    frames: int = FRAMES,
    laws: Laws = "known",
    particles_per_target: int = PER_TARGET,
) -> Row:
    """One combination, over several seeds."""
    out = np.stack(
        [run(p_detect, clutter, seed, frames, laws, particles_per_target) for seed in seeds]
    )
    truth, count, states = out.mean((0, 2))
    rms = float(np.sqrt(np.mean((out[:, 1] - out[:, 0]) ** 2)))
    return Row(
        laws,
        p_detect,
        clutter,
        float(truth),
        float(count),
        float(states),
        rms,
        particles_per_target,
    )


@dataclass(frozen=True, slots=True)
class CountCase:
    """One combination: the densities that the filter has, p_D, clutter, number of seeds, particles
    per target.
    """

    laws: Laws
    p_detect: float
    clutter: float
    seeds: int
    particles_per_target: int = PER_TARGET


def work(job: CountCase) -> Row:
    """One combination over its seeds."""
    return row(
        job.p_detect,
        job.clutter,
        range(job.seeds),
        laws=job.laws,
        particles_per_target=job.particles_per_target,
    )


def jobs_of(seeds: int, laws: Sequence[Laws] = ("known", "shipped")) -> list[CountCase]:
    """All combinations."""
    return [CountCase(law, p, c, seeds) for law in laws for p in P_DETECT for c in CLUTTER]


def _cells(found: Sequence[Row]) -> str:
    """Rows as a table."""
    header = (
        "laws",
        "p_D",
        "λ per frame",
        "ρ",
        "mean truth",
        "mean count",
        "relative bias",
        "RMS error",
        "states",
    )
    return table(
        header,
        [
            (
                r.laws,
                f"{r.p_detect:g}",
                f"{r.clutter:g}",
                r.particles_per_target,
                r.truth,
                r.count,
                f"{r.bias:+.3f}",
                r.rms,
                r.states,
            )
            for r in found
        ],
    )


def main(options: Options) -> Path:
    """Measure, and write count.md."""
    seeds = options.number(SEEDS, 1)
    few_seeds = options.number(FEW_SEEDS, 1)
    found = in_parallel(work, jobs_of(seeds)[:: 3 if options.quick else 1], "count", options)
    fewer = [
        CountCase("known", *FEW_CASE, few_seeds, particles_per_target)
        for particles_per_target in FEW
    ]
    few = in_parallel(work, fewer, "particles", options)
    worst = max(abs(r.bias) for r in found)
    tables = {"found": _cells(found), "few": _cells(few)}
    return write(
        "count", options, seeds=seeds, frames=FRAMES, worst=worst, few_seeds=few_seeds, **tables
    )
