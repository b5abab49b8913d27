"""Stone Soup's GM-PHD and SMC-PHD filters as loops, on the model and births of phdtrack's stages."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.gaussianmixture import GaussianMixtureHypothesiser, GaussianMixtureKDTreeHypothesiser
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

from phdtrack.protocols import AnyStages, Model
from phdtrack.types import F8, Detections, Particles

START = datetime(2000, 1, 1)
# Mahalanobis distance, as phdtrack's gate. Pixels within which a k-d tree looks: more than the gate of any component here.
GATE, TREE = 5.0, 60.0
REGION = 13.28


def transition(model: Model) -> LinearGaussianTimeInvariantTransitionModel:
    """f of one time unit; the fixed variances make it the same for every state."""
    _, f, q = model.motion.transition(np.full((model.motion.dim, 1), 30.0), 1.0)
    return LinearGaussianTimeInvariantTransitionModel(transition_matrix=f[0], covariance_matrix=q[0])


def measurement(stages: AnyStages) -> LinearGaussian:
    """g: four of the six components with the sensor's deviations."""
    position, size = stages.model.sensor.fixed
    return LinearGaussian(ndim_state=6, mapping=(0, 1, 4, 5), noise_covar=np.diag([position**2] * 2 + [size**2] * 2))


def detected(z: F8, when: datetime, model: LinearGaussian) -> set[Detection]:
    """Stone Soup's detections."""
    return {Detection(StateVector(column), timestamp=when, measurement_model=model) for column in z.T}


class Mixture:
    """GM-PHD; ``settings``: ``gate`` (none or tree) for the hypotheses, ``merge`` (none or tree) for the merging."""

    def __init__(self, stages: AnyStages, settings: Mapping[str, str], most: int) -> None:
        model = stages.model
        self.model, self.sensor = model, measurement(stages)
        predictor, updater = KalmanPredictor(transition(model)), KalmanUpdater(self.sensor)
        base = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=GATE)
        if settings["gate"] == "tree":
            self.hypothesiser = GaussianMixtureKDTreeHypothesiser(
                base, predictor=predictor, updater=updater, max_distance=TREE, order_by_detection=True
            )
        else:
            self.hypothesiser = GaussianMixtureHypothesiser(base, order_by_detection=True)
        kappa = float(model.clutter.intensity(np.zeros((4, 1)))[0])
        self.updater = PHDUpdater(
            updater,
            clutter_spatial_density=kappa,
            prob_detection=model.sensor.detection,
            prob_survival=model.motion.survival,
        )
        tree = TREE if settings["merge"] == "tree" else None
        self.reducer = GaussianMixtureReducer(
            prune_threshold=1e-5, merge_threshold=4.0, max_number_components=most, kdtree_max_distance=tree
        )
        self.components: list[TaggedWeightedGaussianState] = []

    def frame(self, number: int, detections: Detections) -> tuple[tuple[float, ...], F8]:
        """Seconds of a step, and the means of the components of weight ≥ 0.5. Births are made before the clock starts."""
        when = START + timedelta(seconds=number)
        z = self.model.sensor.measure(detections)
        found = detected(z, when, self.sensor)
        births = self._births(z, when - timedelta(seconds=1))
        began = time.perf_counter()
        hypotheses = self.hypothesiser.hypothesise([*self.components, *births], found, when)
        self.components = self.reducer.reduce(list(self.updater.update(hypotheses).components))
        spent = time.perf_counter() - began
        heavy = [np.asarray(c.state_vector[:2], float).ravel() for c in self.components if float(c.weight) >= 0.5]
        return (spent,), np.array(heavy).reshape(-1, 2).T

    def _births(self, z: F8, when: datetime) -> list[TaggedWeightedGaussianState]:
        """phdtrack's own births: fewer where mass is predicted, none where all of a target is."""
        covered = np.zeros(z.shape[1])
        if self.components:
            mean = np.array([np.asarray(c.state_vector, float).ravel() for c in self.components])
            at = (mean[:, :2] + mean[:, 2:4]).T
            sd = np.sqrt(np.diag(self.sensor.noise_covar))
            step = np.concatenate([at, mean[:, 4:].T])[:, :, None] - z[:, None, :]
            near = ((step / sd[:, None, None]) ** 2).sum(0) <= 2 * REGION
            covered = np.array([float(c.weight) for c in self.components]) @ near
        born = self.model.birth.components(z, covered, self.model.sensor, 1.0)
        parts: Iterable[tuple[Any, ...]] = zip(born.weight, born.mean.T, born.covariance, strict=True)
        return [
            TaggedWeightedGaussianState(StateVector(m), p, weight=w, tag="birth", timestamp=when)
            for w, m, p in parts
            if w > 0
        ]


class Sampled:
    """SMC-PHD with ``count`` particles; a fifth as many newborn, drawn around the detections from phdtrack's births."""

    def __init__(self, stages: AnyStages, count: int, seed: int) -> None:
        model = stages.model
        self.stages, self.model, self.sensor, self.count = stages, model, measurement(stages), count
        self.rng = np.random.default_rng(seed)
        self.born = Particles(np.zeros((6, 0)), np.zeros(0))
        sampler = ParticleSampler(distribution_func=self._draw, params={}, ndim_state=6)
        self.predictor = SMCPHDPredictor(
            transition(model),
            death_probability=1 - model.motion.survival,
            birth_probability=0.2,
            birth_rate=1e-3,
            birth_sampler=sampler,
        )
        kappa = float(model.clutter.intensity(np.zeros((4, 1)))[0])
        self.updater = SMCPHDUpdater(
            measurement_model=self.sensor,
            resampler=SystematicResampler(),
            prob_detect=model.sensor.detection,
            clutter_intensity=kappa,
            num_samples=count,
        )
        self.state: ParticleState | None = None

    def _draw(self, num_samples: int) -> Any:
        """Newborn of the frame, made before the clock starts."""
        return self.born.state[:, self.rng.integers(0, len(self.born), num_samples)].T

    def frame(self, number: int, detections: Detections) -> tuple[tuple[float, ...], F8]:
        """Seconds of a step, and the centres of phdtrack's K-means of the particles."""
        when = START + timedelta(seconds=number)
        z = self.model.sensor.measure(detections)
        self.born = self.model.birth.sample(z, np.zeros(z.shape[1]), self.model.sensor, 1.0, self.rng)
        if len(self.born) == 0:
            return (float("nan"),), np.zeros((2, 0))
        self.predictor.birth_rate = self.born.mass
        found = detected(z, when, self.sensor)
        if self.state is None:
            first = self.born.state[:, self.rng.integers(0, len(self.born), self.count)]
            weight = np.full(self.count, np.log(self.born.mass / self.count))
            self.state = ParticleState(StateVectors(first), log_weight=weight, timestamp=when - timedelta(seconds=1))
        began = time.perf_counter()
        prediction = self.predictor.predict(self.state, timestamp=when)
        hypotheses = MultipleHypothesis(
            [
                SingleHypothesis(prediction, MissedDetection(timestamp=when)),
                *(SingleHypothesis(prediction, d) for d in found),
            ]
        )
        self.state = self.updater.update(hypotheses)
        spent = time.perf_counter() - began
        cloud = Particles(
            np.ascontiguousarray(np.asarray(self.state.state_vector, float)),
            np.exp(np.asarray(self.state.log_weight, float)),
        )
        return (spent,), self.stages.extractor.extract(cloud, z, self.model).state[:2]
