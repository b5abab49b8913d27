"""Stone Soup's GM-PHD and SMC-PHD filters as loops, on the model and births of phdtrack's
stages.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.gaussianmixture import (
    GaussianMixtureHypothesiser,
    GaussianMixtureKDTreeHypothesiser,
)
from stonesoup.measures import Mahalanobis
from stonesoup.mixturereducer.gaussianmixture import GaussianMixtureReducer
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.predictor.particle import SMCPHDPredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.sampler.particle import ParticleSampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection, MissedDetection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.multihypothesis import MultipleHypothesis
from stonesoup.types.state import ParticleState, TaggedWeightedGaussianState
from stonesoup.updater.kalman import KalmanUpdater
from stonesoup.updater.particle import SMCPHDUpdater
from stonesoup.updater.pointprocess import PHDUpdater

from benchmarks.timing import Took, clock, took
from phdtrack.filters import GMPHD, ParticlePHD
from phdtrack.protocols import AnyStages, Model
from phdtrack.types import F8, Detections, Particles

START = datetime(2000, 1, 1)
# Mahalanobis distance, as phdtrack's gate. Pixels within which a k-d tree looks: more than the gate
# of any component here.
GATE = 5.0
TREE = 60.0
REGION = 13.28


def _stays(model: Model) -> float:
    """p_S of one time unit."""
    motion: Any = model.motion
    return float(motion.survival_probability ** (1 / model.rate))


def matrices(model: Model) -> tuple[F8, F8]:
    """F and Q of one time unit; the fixed variances make them the same for every state."""
    _, f, q = model.motion.transition(np.full((model.motion.dim, 1), 30.0), 1.0)
    return f[0], q[0]


def transition(model: Model) -> LinearGaussianTimeInvariantTransitionModel:
    """f of one time unit."""
    f, q = matrices(model)
    return LinearGaussianTimeInvariantTransitionModel(transition_matrix=f, covariance_matrix=q)


def measurement(stages: AnyStages) -> LinearGaussian:
    """g: four of the six components with the sensor's deviations."""
    position, size = stages.model.sensor.fixed_noise
    return LinearGaussian(
        ndim_state=6, mapping=(0, 1, 4, 5), noise_covar=np.diag([position**2] * 2 + [size**2] * 2)
    )


def detected(z: F8, when: datetime, model: LinearGaussian) -> set[Detection]:
    """Stone Soup's detections."""
    return {
        Detection(StateVector(column), timestamp=when, measurement_model=model) for column in z.T
    }


class Mixture:
    """GM-PHD; ``settings``: ``gate`` (none or tree) for the hypotheses, ``merge`` (none or tree)
    for the merging.
    """

    def __init__(self, stages: AnyStages, settings: Mapping[str, str], most: int) -> None:
        model = stages.model
        self.model = model
        self.sensor = measurement(stages)
        self.f, self.q = matrices(model)
        predictor = KalmanPredictor(transition(model))
        updater = KalmanUpdater(self.sensor)
        base = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=GATE)
        if settings["gate"] == "tree":
            self.hypothesiser = GaussianMixtureKDTreeHypothesiser(
                base,
                predictor=predictor,
                updater=updater,
                max_distance=TREE,
                order_by_detection=True,
            )
        else:
            self.hypothesiser = GaussianMixtureHypothesiser(base, order_by_detection=True)
        kappa = float(model.clutter.intensity(np.zeros((4, 1)))[0])
        self.updater = PHDUpdater(
            updater,
            clutter_spatial_density=kappa,
            prob_detection=model.sensor.detection_probability,
            prob_survival=_stays(model),
        )
        tree = TREE if settings["merge"] == "tree" else None
        self.reducer = GaussianMixtureReducer(
            prune_threshold=1e-5,
            merge_threshold=4.0,
            max_number_components=most,
            kdtree_max_distance=tree,
        )
        self.components: list[TaggedWeightedGaussianState] = []

    def frame(self, number: int, detections: Detections) -> tuple[tuple[Took, ...], F8]:
        """Seconds of a step, and the means of the components of weight ≥ 0.5. Births are made
        before the clock starts.
        """
        when = START + timedelta(seconds=number)
        z = self.model.sensor.measure(detections)
        found = detected(z, when, self.sensor)
        births = self._births(z, when - timedelta(seconds=1))
        began = clock()
        hypotheses = self.hypothesiser.hypothesise([*self.components, *births], found, when)
        self.components = self.reducer.reduce(list(self.updater.update(hypotheses).components))
        spent = took(began, clock())
        heavy = [
            np.asarray(c.state_vector[:2], float).ravel()
            for c in self.components
            if float(c.weight) >= 0.5
        ]
        return (spent,), np.array(heavy).reshape(-1, 2).T

    def _births(self, z: F8, when: datetime) -> list[TaggedWeightedGaussianState]:
        """phdtrack's own births, where less than a target's mass is predicted; as they are before
        f, which is applied.
        """
        covered = np.zeros(z.shape[1])
        if self.components:
            covered = self._covered(z)
        # What the filter makes of a frame in which nothing is expected, and nothing is detected:
        # its births.
        unseen = replace(self.model, sensor=replace(self.model.sensor, detection_probability=0.0))
        none = GMPHD().start(self.model, np.random.default_rng(0))
        born, _ = GMPHD().update(
            none, np.ascontiguousarray(z[:, covered < 1]), unseen, 1.0, np.random.default_rng(0)
        )
        back = np.linalg.inv(self.f)
        mean = back @ born.mean
        cov = back @ (born.covariance - self.q) @ back.T
        parts: Iterable[tuple[Any, ...]] = zip(born.weight, mean.T, cov, strict=True)
        return [
            TaggedWeightedGaussianState(StateVector(m), p, weight=w, tag="birth", timestamp=when)
            for w, m, p in parts
            if w > 0
        ]

    def _covered(self, z: F8) -> F8:
        """M(z): mass of the predicted components within whose 99 % region a detection lies."""
        rows = list(self.model.sensor.observed)
        mean = (
            np.array([np.asarray(c.state_vector, float).ravel() for c in self.components])
            @ self.f.T
        )
        cov = (
            self.f @ np.array([np.asarray(c.covar, float) for c in self.components]) @ self.f.T
            + self.q
        )
        inverse = np.linalg.inv(
            cov[:, rows][:, :, rows] + np.asarray(self.sensor.noise_covar, float)
        )
        step = z.T[None] - mean[:, None, rows]
        near = np.einsum("knr,krs,kns->kn", step, inverse, step) <= REGION
        weight = _stays(self.model) * np.array([float(c.weight) for c in self.components])
        out: F8 = weight @ near
        return out


class Sampled:
    """SMC-PHD with ``count`` particles; a fifth as many newborn, drawn around the detections from
    phdtrack's births.
    """

    def __init__(self, stages: AnyStages, count: int, seed: int) -> None:
        model = stages.model
        self.stages = stages
        self.model = model
        self.sensor = measurement(stages)
        self.count = count
        self.rng = np.random.default_rng(seed)
        self.born = Particles(np.zeros((6, 0)), np.zeros(0))
        sampler = ParticleSampler(distribution_func=self._draw, params={}, ndim_state=6)
        self.predictor = SMCPHDPredictor(
            transition(model),
            death_probability=1 - _stays(model),
            birth_probability=0.2,
            birth_rate=1e-3,
            birth_sampler=sampler,
        )
        kappa = float(model.clutter.intensity(np.zeros((4, 1)))[0])
        self.updater = SMCPHDUpdater(
            measurement_model=self.sensor,
            resampler=SystematicResampler(),
            prob_detect=model.sensor.detection_probability,
            clutter_intensity=kappa,
            num_samples=count,
        )
        self.state: ParticleState | None = None

    def _draw(self, num_samples: int) -> Any:
        """Newborn of the frame, made before the clock starts, as likely as they weigh: Stone Soup's
        all weigh the same.
        """
        share = self.born.weight / self.born.mass
        return self.born.state[:, self.rng.choice(len(self.born), num_samples, p=share)].T

    def _births(self, z: F8) -> Particles:
        """phdtrack's births where less than a target's mass is predicted, and everywhere where that
        leaves none.
        """
        sensor = self.model.sensor
        covered = np.zeros(z.shape[1])
        if self.state is not None:
            weight = np.exp(np.asarray(self.state.log_weight, float))
            old = Particles(_plain(self.state.state_vector), weight, np.array([0, len(weight)]))
            moved = ParticlePHD().predict(old, self.model, 1.0, self.rng).particles()
            apart = z[:, :, None] - sensor.predicted_measurements(moved.state)[:, None, :]
            variance = np.diag(sensor.covariance(z[:, :1], moved.state[:, :1])[0])
            near = (apart**2 / variance[:, None, None]).sum(axis=0) <= REGION
            covered = near @ moved.weight
        born = self.model.birth.sample(z, covered, sensor, 1 / self.model.rate, self.rng)
        return (
            born
            if len(born)
            else self.model.birth.sample(z, np.zeros_like(covered), sensor, 1.0, self.rng)
        )

    def frame(self, number: int, detections: Detections) -> tuple[tuple[Took, ...], F8]:
        """Seconds of a step, and the centres of phdtrack's K-means of the particles."""
        when = START + timedelta(seconds=number)
        z = self.model.sensor.measure(detections)
        self.born = self._births(z)
        if len(self.born) == 0:
            raise RuntimeError(
                f"frame {number} of the scene has no detections, for which this loop is not made"
            )
        self.predictor.birth_rate = self.born.mass
        found = detected(z, when, self.sensor)
        if self.state is None:
            first = self._draw(self.count).T
            weight = np.full(self.count, np.log(self.born.mass / self.count))
            self.state = ParticleState(
                StateVectors(first), log_weight=weight, timestamp=when - timedelta(seconds=1)
            )
        began = clock()
        prediction = self.predictor.predict(self.state, timestamp=when)
        hypotheses = MultipleHypothesis(
            [
                SingleHypothesis(prediction, MissedDetection(timestamp=when)),
                *(SingleHypothesis(prediction, d) for d in found),
            ]
        )
        self.state = self.updater.update(hypotheses)
        spent = took(began, clock())
        cloud = Particles(
            _plain(self.state.state_vector), np.exp(np.asarray(self.state.log_weight, float))
        )
        return (spent,), self.stages.extractor.extract(cloud, z, self.model).state[:2]


def _plain(vectors: Any) -> F8:
    """Stone Soup's state vectors as an array."""
    return np.ascontiguousarray(np.asarray(vectors, float))
