"""Everything shipped that claims a protocol, and worlds to try it in. A new one is added here, and
tested by that.
"""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np

from experiments.bearing import BearingSensor, TurningMotion
from experiments.common import uniform_density
from phdtrack.arrays import to_cxcywh
from phdtrack.associate.graph import GraphMatching
from phdtrack.associate.labels import Labelled
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.filters import (
    GMCPHD,
    GMPHD,
    MCMC,
    MHT,
    PMB,
    PMBM,
    BestBernoullis,
    BestHypothesis,
    Components,
    Joint,
    KMeans,
    Mixture,
    NoFilter,
    ParticleCPHD,
    ParticlePHD,
    PrintedKMeans,
    PrintedMixture,
    Raw,
)
from phdtrack.filters.hypotheses import Cluster, Nodes
from phdtrack.filters.mcmc import JointSamples
from phdtrack.kernels.pmb import Layer
from phdtrack.models import (
    BoxClutter,
    BoxMotion,
    BoxSensor,
    FixedBirth,
    MeasurementBirth,
    PlaneBirth,
    PlaneClutter,
    PlaneMotion,
    PlaneSensor,
    PointBirth,
    PointMotion,
    PointSensor,
    UniformBirth,
    UniformClutter,
)
from phdtrack.models.scene import FalseAlarmRatio, SceneBirth, SceneClutter
from phdtrack.protocols import Model
from phdtrack.scene import LearnedDensity, SceneDensity, TrackedObjects
from phdtrack.types import Detections, Estimates, GaussianMixture, Particles
from plane_cases import FRAME, LevelCamera

SIZE = (640.0, 480.0)

MOTIONS = {
    "scaled": BoxMotion(frame_size=SIZE, roughening=0.0),
    "fixed": BoxMotion(
        acceleration=1.2, size_noise=2.0, scaled_noise=False, frame_size=SIZE, roughening=0.0
    ),
    "borderless": BoxMotion(roughening=0.0),
    "still": BoxMotion(acceleration=0.0, size_noise=0.0, roughening=0.0),
    "plane": PlaneMotion(borders=(0.0, 0.0, 500.0, 400.0)),
    "plane, piecewise": PlaneMotion(form="piecewise"),
    "plane, still": PlaneMotion(acceleration=0.0),
    "turning": TurningMotion(borders=(0.0, 0.0, 500.0, 400.0)),
    "turning, piecewise": TurningMotion(form="piecewise", acceleration=0.0),
    "point": PointMotion(),
}
SENSORS = {
    scaling: BoxSensor(0.95, scaling=scaling)
    for scaling in ("particle", "detection", "fixed", "given")
}
SENSORS["no floor"] = BoxSensor(0.95, min_noise=0.0)
SENSORS["plane"] = PlaneSensor(camera=LevelCamera(horizon=-100.0), frame_size=FRAME)
SENSORS["plane, fixed"] = PlaneSensor(camera=LevelCamera(horizon=-100.0), scaling="fixed")
SENSORS["plan"] = PlaneSensor(scaling="given")
SENSORS["bearing"] = BearingSensor(bearing=0.02, origin=(320.0, -100.0), fade=2000.0)
SENSORS["point"] = PointSensor(noise_variance=2.0)


def mixture(dim: int) -> GaussianMixture:
    mean = np.array([[100.0, 200.0, 0, 0, 40, 100], [300.0, 100.0, 0, 0, 30, 60]]).T
    return GaussianMixture(np.array([0.02, 0.01]), mean, np.tile(4.0 * np.eye(dim), (2, 1, 1)))


def learned(low: list[float], high: list[float]) -> SceneDensity:
    """A density of which a half is one wide Gaussian in the middle."""
    a = np.array(low, np.float64)
    b = np.array(high, np.float64)
    return SceneDensity(
        a, b, 0.5, np.ones(1), (a + b)[:, None] / 2, np.diag(((b - a) / 4) ** 2)[None]
    )


BIRTHS = {
    "measurement, image": MeasurementBirth(births_per_second=0.02, particles=200, frame_size=SIZE),
    "measurement, local": MeasurementBirth(births_per_detection=0.02, particles=200),
    "fixed": FixedBirth(mixture(6), particles=100),
    "learned": SceneBirth(
        0.05, learned([0, 0, -9, -9, 0, 0], [640, 480, 9, 9, 640, 480]), particles=200
    ),
}
PEOPLE = learned([0, 0, 0, 0], [640, 480, 640, 480])
BIRTHS["laid over"] = replace(BIRTHS["learned"], births_per_detection=0.02, among=PEOPLE)
GROUND = SENSORS["plane"]
PLANE_BIRTHS = {
    "plane, region": PlaneBirth(
        births_per_second=0.02,
        births_per_detection=0,
        particles=200,
        borders=(-40.0, 0.0, 40.0, 60.0),
    ),
    "plane, local": PlaneBirth(births_per_detection=0.02, particles=200),
    "plane, fixed": FixedBirth(
        GaussianMixture(
            np.array([0.02, 0.01]),
            np.array([[0.0, 1], [10, 20], [0, 0], [0, 1]]),
            np.tile(np.eye(4), (2, 1, 1)),
        )
    ),
}
POINT_BIRTHS = {
    "point": PointBirth(births_per_second=0.02, particles=200, frame_size=SIZE),
    "point, uniform": UniformBirth(SIZE, particles=40),
}
CLUTTERS = {
    "uniform": UniformClutter(2.0, (640.0 * 480) ** 2),
    "local": BoxClutter(2.0),
    "none": UniformClutter(0.0, 1.0),
}
CLUTTERS["learned"] = SceneClutter(2.0, PEOPLE)
CLUTTERS["laid over"] = SceneClutter(2.0, PEOPLE, clutter_per_detection=0.5)
PLANE_CLUTTERS = {"plane, region": UniformClutter(2.0, 800.0), "plane, local": PlaneClutter(2.0)}
FILTERS = {
    "particle-phd": ParticlePHD(particles_per_target=200),
    "bounded": ParticlePHD(particles_per_target=200, max_particles=150),
    "skipping": ParticlePHD(particles_per_target=200, skip_empty_frames=True),
    "started": ParticlePHD(particles_per_target=200, initial=mixture(6)),
    "gm-phd": GMPHD(),
    "gm-phd, started": GMPHD(initial=mixture(6), max_components=20),
    "gm-cphd": GMCPHD(),
    "gm-cphd, started": GMCPHD(initial=mixture(6), max_components=20),
    "particle-cphd": ParticleCPHD(particles_per_target=200),
    "particle-cphd, started": ParticleCPHD(particles_per_target=200, initial=mixture(6)),
    "mht": MHT(),
    "mht, started": MHT(initial=mixture(6), max_hypotheses=20, history=3),
    "pmbm": PMBM(),
    "pmbm, started": PMBM(initial=mixture(6), history=3),
    "pmb": PMB(),
    "pmb, started": PMB(initial=mixture(6), history=3),
    "pmb, plain": PMB(mean_visible_time=0.0, static_clutter_prior=0.0),
    "mcmc": MCMC(samples=200),
    "mcmc, alone": MCMC(samples=200, interaction_strength=0.0, thin=2),
    "mcmc, started": MCMC(samples=200, initial=mixture(6)),
    "none": NoFilter(),
}
EXTRACTORS = {
    "kmeans": KMeans(),
    "kmeans-printed": PrintedKMeans(),
    "mixture": Mixture(),
    "mixture-printed": PrintedMixture(),
    "components": Components(),
    "joint": Joint(),
    "hypotheses": BestHypothesis(),
    "bernoullis": BestBernoullis(),
    "raw": Raw(),
}
ASSOCIATORS = {
    "graph": GraphMatching(),
    "delayed": GraphMatching(output_delay=3),
    "plain": GraphMatching(bridge_gaps=False, back_dating=0),
    "labelled": Labelled(),
    "labelled, delayed": Labelled(output_delay=3, history=0.4),
    "labelled, plain": Labelled(bridge_gaps=False, min_track_length=1),
}
SCENE_ODDS = FalseAlarmRatio(
    LearnedDensity(2.0, PEOPLE),
    TrackedObjects(0.5, LearnedDensity(3.0, uniform_density(PEOPLE.low, PEOPLE.high))),
)
ASSOCIATORS |= {
    f"vetted, {name}": FalseTrackRejection(ASSOCIATORS[name], SCENE_ODDS)
    for name in ("delayed", "labelled, delayed")
}


def often(birth: MeasurementBirth | SceneBirth) -> MeasurementBirth | SceneBirth:
    """25 times as many births a second."""
    return replace(
        birth,
        **{
            name: 25 * getattr(birth, name)
            for name in ("births_per_second", "births_per_detection")
        },
    )


def model_of(sensor: BoxSensor | None = None) -> Model:
    sensor = sensor or SENSORS["particle"]
    return Model(
        BoxMotion(frame_size=SIZE), sensor, often(BIRTHS["measurement, image"]), CLUTTERS["uniform"]
    )


def detections(rng: np.random.Generator, n: int) -> Detections:
    """``n`` boxes in the frame, with a covariance."""
    size = rng.uniform(20, 120, (n, 2))
    corner = rng.uniform(0, 1, (n, 2)) * (np.array(SIZE) - size)
    variance = rng.uniform(1, 25, (n, 4))
    found = Detections.of(np.hstack([corner, corner + size]))
    return Detections(
        found.xyxy,
        found.confidence,
        found.class_id,
        np.apply_along_axis(np.diag, 1, variance) if n else None,
    )


def states(rng: np.random.Generator, n: int, dim: int = 6) -> np.ndarray:
    """(dim, n) states in the frame: of boxes, points, or with five components of targets that
    turn.
    """
    z = to_cxcywh(detections(rng, n).xyxy) if n else np.zeros((4, 0))
    x = np.vstack([z[:2], rng.normal(0, 3, (2, n)), z[2:], z[2:]])
    if dim == 5:
        x[4] = rng.normal(0, 0.2, n)
    return np.ascontiguousarray(x[:dim])


def gaussians(x: np.ndarray, mass: float = 1.0) -> GaussianMixture:
    """A Gaussian of ``mass`` about every column of ``x``."""
    d, n = x.shape
    return GaussianMixture(np.full(n, mass), x, np.tile(np.eye(d), (n, 1, 1)))


def intensity_for(
    extractor: object, x: np.ndarray, each: int, rng: np.random.Generator, mass: float = 1.0
):
    """What the extractor can read about every column of ``x``: Gaussians or ``each`` particles, and
    their number.
    """
    if isinstance(extractor, BestHypothesis | BestBernoullis):
        labelled = MHT if isinstance(extractor, BestHypothesis) else PMB
        return labelled(initial=gaussians(x, mass)).start(model_of(), rng)
    if isinstance(extractor, Joint):
        n = x.shape[1]
        return JointSamples(about(x, each, rng).state, np.full((n, each), mass), np.arange(n), n)
    return gaussians(x, mass) if isinstance(extractor, Components) else about(x, each, rng, mass)


def about(x: np.ndarray, each: int, rng: np.random.Generator, mass: float = 1.0) -> Particles:
    """``each`` particles of ``mass`` about every column of ``x``."""
    cloud = np.repeat(x, each, axis=1)
    return Particles(cloud + rng.normal(0, 1, cloud.shape), np.full(cloud.shape[1], mass / each))


def frozen(record):
    """The record, its arrays and those of the records in it made read-only."""
    for name in getattr(record, "_fields", None) or record.__dataclass_fields__:
        value = getattr(record, name)
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        elif isinstance(value, Particles | GaussianMixture):
            frozen(value)
        elif isinstance(value, tuple):
            for item in value:
                if isinstance(item, Nodes | Cluster | Layer):
                    frozen(item)
    return record


def fixed(array: np.ndarray) -> np.ndarray:
    """The array, made read-only."""
    array.flags.writeable = False
    return array


def keeps(protocol: type, implementation: object) -> None:
    """Every method of the protocol is there, with the protocol's arguments in its order; properties
    are properties.
    """
    for name, wanted in vars(protocol).items():
        if name.startswith("_") and name not in ("__call__", "__iter__"):
            continue
        if isinstance(wanted, property):
            assert not callable(getattr(implementation, name)), name
        elif callable(wanted):
            theirs = list(inspect.signature(wanted).parameters)[1:]
            ours = inspect.signature(getattr(implementation, name)).parameters
            assert list(ours)[: len(theirs)] == theirs, f"{type(implementation).__name__}.{name}"
            rest = list(ours.values())[len(theirs) :]
            assert all(p.default is not p.empty for p in rest), (
                f"{type(implementation).__name__}.{name} asks for more"
            )


def check_estimates(found: Estimates, dim: int, n: int) -> None:
    """What every set of states must be, drawn from ``n`` detections."""
    k = len(found)
    assert found.state.shape == (dim, k)
    assert found.covariance.shape == (k, dim, dim)
    assert found.xyxy.shape == (k, 4)
    assert found.detection.shape == (k,)
    assert found.detection.dtype == np.int64
    for array in (found.state, found.covariance, found.weight, found.xyxy):
        assert np.isfinite(array).all()
    assert (found.weight > 0).all()
    assert (found.xyxy[:, 2:] > found.xyxy[:, :2]).all()
    np.testing.assert_allclose(found.covariance, found.covariance.transpose(0, 2, 1))
    if k:
        assert np.linalg.eigvalsh(found.covariance).min() > 0
    rests = found.detection[found.detection >= 0]
    assert len(set(rests.tolist())) == len(rests), "a detection serves one state"
    assert rests.max(initial=-1) < n
