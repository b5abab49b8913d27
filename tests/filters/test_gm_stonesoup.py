"""Stone Soup's GM-PHD update of the same mixture gives the same Gaussians, none of our code behind
it.
"""

from __future__ import annotations

from datetime import datetime

import numpy as np
from phd_cases import NoBirth
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.hypothesiser.gaussianmixture import GaussianMixtureHypothesiser
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.types.array import StateVector
from stonesoup.types.detection import Detection
from stonesoup.types.state import TaggedWeightedGaussianState
from stonesoup.updater.kalman import KalmanUpdater
from stonesoup.updater.pointprocess import PHDUpdater

from phdtrack.filters import GMPHD
from phdtrack.models import BoxMotion, BoxSensor, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import GaussianMixture

NOW = datetime(2000, 1, 1)
# No time passes and all survive: the update alone is compared.
MODEL = Model(
    BoxMotion(scaled_noise=False),
    BoxSensor(detection_probability=0.9, scaling="fixed"),
    NoBirth(),
    UniformClutter(3.0, 640.0 * 480 * 60 * 90),
)


def theirs(mixture: GaussianMixture, z: np.ndarray) -> list[TaggedWeightedGaussianState]:
    sensor = LinearGaussian(ndim_state=6, mapping=(0, 1, 4, 5), noise_covar=np.diag([3.0, 3, 6, 6]))
    still = LinearGaussianTimeInvariantTransitionModel(
        transition_matrix=np.eye(6), covariance_matrix=np.zeros((6, 6))
    )
    updater = KalmanUpdater(sensor)
    base = DistanceHypothesiser(KalmanPredictor(still), updater, Mahalanobis(), missed_distance=1e6)
    parts = zip(mixture.weight, mixture.mean.T, mixture.covariance, strict=True)
    components = [
        TaggedWeightedGaussianState(StateVector(m), p, weight=w, tag=str(i), timestamp=NOW)
        for i, (w, m, p) in enumerate(parts)
    ]
    found = {
        Detection(StateVector(column), timestamp=NOW, measurement_model=sensor) for column in z.T
    }
    hypotheses = GaussianMixtureHypothesiser(base, order_by_detection=True).hypothesise(
        components, found, NOW
    )
    kappa = float(MODEL.clutter.intensity(z)[0])
    update = PHDUpdater(
        updater, clutter_spatial_density=kappa, prob_detection=0.9, prob_survival=1.0
    )
    return list(update.update(hypotheses).components)


def test_update(rng):
    mean = np.array(
        [[100.0, 100, 1, 0, 40, 80], [106, 103, -1, 0, 44, 85], [300, 200, 0, 2, 60, 120]]
    ).T
    root = rng.normal(0, 1.5, (3, 6, 6))
    mixture = GaussianMixture(
        np.array([0.8, 0.5, 1.1]), mean, root @ root.transpose(0, 2, 1) + np.eye(6)
    )
    z = np.hstack([mean[[0, 1, 4, 5]] + rng.normal(0, 2, (4, 3)), [[302.0], [203], [58], [118]]])
    ours, _ = GMPHD(gate_probability=1.0).update(mixture, z, MODEL, 1.0, rng)
    expected = sorted(theirs(mixture, z), key=lambda c: float(c.weight))
    # Theirs may leave out what weighs next to nothing.
    expected = [c for c in expected if float(c.weight) > 1e-6]
    kept = np.flatnonzero(ours.weight > 1e-6)
    kept = kept[np.argsort(ours.weight[kept])]
    assert len(kept) == len(expected) > 6
    for i, component in zip(kept, expected, strict=True):
        np.testing.assert_allclose(ours.weight[i], float(component.weight), rtol=1e-6)
        np.testing.assert_allclose(
            ours.mean[:, i], np.asarray(component.state_vector, float).ravel(), rtol=1e-8
        )
        np.testing.assert_allclose(
            ours.covariance[i], np.asarray(component.covar, float), rtol=1e-6, atol=1e-8
        )
