"""Worlds, scans and readings for the tests of multiple hypotheses and of multi-Bernoulli
filters.
"""

from __future__ import annotations

import itertools

import numpy as np

from phdtrack.filters import MHT, PMB, PMBM, BestBernoullis, BestHypothesis
from phdtrack.filters.hypotheses import Hypotheses, before
from phdtrack.filters.pmb import Bernoullis
from phdtrack.models import BoxMotion, BoxSensor, FixedBirth, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import F8, Estimates, GaussianMixture

FRAME = (640.0, 480.0)
RNG = np.random.default_rng(0)
# Nothing is cut, pruned or decided.
EVERYTHING = MHT(
    max_hypotheses=20000,
    hypothesis_threshold=1e-290,
    history=30,
    existence_threshold=1e-290,
    gate_probability=1.0,
)


def world(
    *, detection: float = 0.8, clutter: float = 1e-9, birth: float = 0.05, survival: float = 0.9
) -> Model:
    """Boxes with constant noises, born at one wide place."""
    sensor = BoxSensor(
        detection_probability=detection,
        scaling="fixed",
        fixed_noise=(4.0, 4.0),
        birth_speed_pixels=6.0,
    )
    place = GaussianMixture(
        np.array([25 * birth]),
        np.array([[300.0], [200], [0], [0], [40], [80]]),
        np.diag([4000.0, 4000, 18, 18, 60, 60])[None],
    )
    motion = BoxMotion(
        acceleration=1.0, size_noise=1.0, survival_probability=survival**25, scaled_noise=False
    )
    return Model(motion, sensor, FixedBirth(place), UniformClutter(clutter, 1.0))


def boxes(*points: tuple[float, float], size: tuple[float, float] = (40.0, 80.0)) -> F8:
    """(4, N) measurements at these points."""
    return np.array([[x, y, *size] for x, y in points], np.float64).reshape(-1, 4).T.copy()


def walk(start, velocity, count: int, rng=None, noise: float = 3.0) -> F8:
    """(count, 2) positions, seen with noise."""
    path = np.array(start, np.float64) + np.arange(count)[:, None] * np.array(velocity, np.float64)
    return path if rng is None else path + noise * rng.standard_normal(path.shape)


def scene(
    rng, frames: int, targets: int = 4, clutter: int = 3, detection: float = 0.85, size=FRAME
) -> list[F8]:
    """Targets that walk among false alarms."""
    start = rng.uniform([100, 80], [size[0] - 100, size[1] - 80], (targets, 2))
    velocity = rng.normal(0, 3, (targets, 2))
    scans = []
    for k in range(frames):
        here = (start + k * velocity + 3 * rng.standard_normal((targets, 2)))[
            rng.random(targets) < detection
        ]
        scans.append(boxes(*here, *rng.uniform([0, 0], size, (clutter, 2))))
    return scans


def run(filter_: PMBM | PMB, scans: list[F8], model: Model, dt: float = 1.0) -> tuple:
    """The last state, and what the last update told."""
    state = filter_.start(model, RNG)
    info = None
    for z in scans:
        state, info = filter_.step(state, z, model, dt, RNG)
    return state, info


def chain(taken: tuple, scans: list[F8], mean: F8, cov: F8, model: Model) -> tuple[F8, F8]:
    """Means (K, d) and covariances (K, d, d) of a target's states in all scans, given the
    measurements ``taken``.

    Mean and covariance are those before the first scan. By the joint Gaussian of all states at
    once.
    """
    d = len(mean)
    count = len(scans)
    rows = list(model.sensor.observed)
    means = np.empty((count, d))
    joint = np.zeros((count * d, count * d))
    for k in range(count):
        moved, f, q = model.motion.transition(mean[:, None], 1.0)
        mean = moved[:, 0]
        cov = f[0] @ cov @ f[0].T + q[0]
        here = slice(k * d, k * d + d)
        joint[here] = 0 if k == 0 else f[0] @ joint[(k - 1) * d : k * d]
        joint[:, here] = joint[here].T
        joint[here, here] = cov
        means[k] = mean
    seen = [k * d + row for k, _ in taken for row in rows]
    z = np.concatenate([scans[k][: len(rows), j] for k, j in taken])
    noise = [model.sensor.covariance(scans[k][:, [j]], means[k][:, None])[0] for k, j in taken]
    s = joint[np.ix_(seen, seen)]
    for i, r in enumerate(noise):
        s[i * len(rows) : (i + 1) * len(rows), i * len(rows) : (i + 1) * len(rows)] += r
    gain = np.linalg.solve(s, joint[seen]).T
    means = (means.ravel() + gain @ (z - means.ravel()[seen])).reshape(count, d)
    after = joint - gain @ joint[seen]
    return means, np.array([after[k * d : k * d + d, k * d : k * d + d] for k in range(count)])


def told(state: Hypotheses | Bernoullis, model: Model, merge_iou: float = 1.0) -> Estimates:
    """What is reported, with nobody left out for another's sake unless they overlap by more."""
    kind = BestHypothesis if isinstance(state, Hypotheses) else BestBernoullis
    return kind(merge_iou=merge_iou).extract(state, np.zeros((4, 0)), model)


def histories(state: Hypotheses) -> list[tuple]:
    """Of each leaf the measurements it rests on, ((frame, index), …)."""
    at = np.arange(len(state))
    taken = [[] for _ in range(len(state))]
    for back, nodes in enumerate(reversed(state.layers)):
        for i, node in enumerate(at.tolist()):
            if node >= 0 and nodes.detection[node] >= 0:
                taken[i].insert(0, (len(state.layers) - 2 - back, int(nodes.detection[node])))
        at = before(nodes, at)
    return [tuple(t) for t in taken]


def partitions(state: Hypotheses, scans: list[F8]) -> dict[frozenset, tuple[float, dict]]:
    """Probability of each partition of the measurements, over all clusters, and the leaf of each of
    its sequences.
    """
    told = histories(state)
    everything = {(k, j) for k, z in enumerate(scans) for j in range(z.shape[1])}
    choices = [[(1.0, tuple(state.lone.tolist()))]]
    choices += [
        [
            (float(w), tuple(leaf for leaf in row.tolist() if leaf >= 0))
            for w, row in zip(c.weight, c.leaf, strict=True)
        ]
        for c in state.clusters
    ]
    out = {}
    for picked in itertools.product(*choices):
        leaves = [leaf for _, row in picked for leaf in row]
        sequences = {told[leaf]: leaf for leaf in leaves}
        rest = everything - {one for sequence in sequences for one in sequence}
        key = frozenset([*sequences, *((one,) for one in rest)])
        assert key not in out, "each partition once"
        out[key] = (float(np.prod([w for w, _ in picked])), sequences)
    return out
