"""Models, states and sequences for the tests of association."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from phdtrack.associate.graph import GraphMatching, GraphState
from phdtrack.associate.history import open_links
from phdtrack.kernels.linking import Window
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.protocols import Model
from phdtrack.types import Detections, Estimates, Tracks

WIDTH = 640.0
HEIGHT = 480.0
FIELDS = ("frame", "identity", "xyxy", "confidence", "detection", "confirmed")


def model_of(*, rate: float = 25.0, detection: float = 0.95, **motion) -> Model:
    size = (WIDTH, HEIGHT)
    settings = {
        "acceleration": 0.03,
        "size_noise": 0.05,
        "survival_probability": 0.99**25,
        "frame_size": size,
    } | motion
    sensor = BoxSensor(
        detection_probability=detection,
        box_noise=0.15,
        min_noise=1.0,
        scaling="particle",
        birth_speed=0.06,
    )
    return Model(
        BoxMotion(**settings),
        sensor,
        MeasurementBirth(0.25, frame_size=size),
        UniformClutter(1.0, 1e10),
        rate,
    )


def matching_of(*, miss: float = 0.3, **settings) -> GraphMatching:
    """Settings other than the defaults; ``miss`` is the probability of one more time unit (1/25 s)
    without a state.
    """
    plain = {
        "window": 2.0,
        "min_track_length": 5,
        "loose_end_distance": 4.0,
        "gap_cost": -25 * math.log(miss),
        "max_link_distance": 3.5,
        "output_delay": 0,
        "max_coast": 0.3,
        "bridge_gaps": True,
        "back_dating": 0,
    }
    return GraphMatching(**(plain | settings))


def states(
    points, *, velocity=None, size: float = 40.0, sure: float = 0.3, model: Model | None = None
) -> Estimates:
    """States at ``points`` (n, 2): at rest, or with a ``velocity`` (n, 2) known to ``sure``
    pixels.
    """
    sensor = (model or model_of()).sensor
    xy = np.asarray(points, np.float64).reshape(-1, 2).T
    n = xy.shape[1]
    state, cov = sensor.states(np.vstack([xy, np.full((2, n), size)]))
    if velocity is not None:
        state[2:4] = np.asarray(velocity, np.float64).reshape(-1, 2).T
        cov[:, [2, 3], [2, 3]] = sure**2
    return Estimates(state, cov, np.ones(n), sensor.boxes(state), np.arange(n))


@dataclass(frozen=True, slots=True)
class Result:
    """The state after each frame, the online rows with each, the rows of the end,
    the corrected tracks.
    """

    states: list[GraphState]
    emitted: list[Tracks]
    flushed: Tracks
    tracks: Tracks

    @property
    def online(self) -> Tracks:
        return Tracks.concatenate([*self.emitted, self.flushed])


def seen_as(z) -> Detections:
    """The detections of measurements (m, N)."""
    return Detections.of(np.zeros((z.shape[1], 4)))


def measured(estimates: Estimates):
    """Estimates as measurements and their detections."""
    z = estimates.state[[0, 1, 4, 5]]
    return z, seen_as(z)


def run(matching, frames, model: Model | None = None, intervals=None, shown=None) -> Result:
    """Association of a sequence of `Estimates` whose detections they are themselves, or those in
    ``shown``.
    """
    model = model or model_of()
    state = matching.start()
    after = []
    emitted = []
    for number, estimates in enumerate(frames, start=1):
        dt = 1.0 if intervals is None else intervals[number - 1]
        z = estimates.state[list(model.sensor.observed)] if shown is None else shown[number - 1]
        state, rows = matching.extend(state, estimates, z, seen_as(z), number, dt, model)
        after.append(state)
        emitted.append(rows)
    return Result(after, emitted, matching.flush(state, model), matching.finish(state, model))


def links(state: GraphState) -> set[tuple[int, int]]:
    """All links (later, earlier), open ones and those that can no longer change."""
    parts = [open_links(state.window), *(m.final for m in state.history)]
    return {
        pair
        for part in parts
        for pair in zip(part.later.tolist(), part.earlier.tolist(), strict=True)
    }


def open_edges(window: Window) -> dict[tuple[int, int], float]:
    """{(later, earlier): gain} of all edges between open rows and columns."""
    found = {}
    for row, (low, high) in enumerate(itertools.pairwise(window.start.tolist())):
        for earlier, gain in zip(
            window.target[low:high].tolist(), window.edge_gain[low:high].tolist(), strict=True
        ):
            if earlier >= window.column and window.next[earlier - window.column] > -2:
                found[window.row + row, earlier] = gain
    return found


def scattered(
    rng: np.random.Generator, frames: int, most: int, side: float = 20.0
) -> list[Estimates]:
    """Up to ``most`` states a frame, so close that nearly all could be linked, half with a known
    velocity.
    """
    out = []
    for _ in range(frames):
        n = int(rng.integers(0, most + 1))
        points = 100 + rng.uniform(0, side, (n, 2))
        velocity = rng.normal(0, 4, (n, 2)) if rng.random() < 0.5 else None
        out.append(
            states(points, velocity=velocity, size=rng.uniform(36, 44), sure=rng.uniform(0.5, 4))
        )
    return out


def walkers(
    rng: np.random.Generator, frames: int, *, p_seen: float = 0.9, clutter: float = 1.0, n: int = 3
):
    """Targets at nearly constant velocity that meet in the middle; states with noise, misses and
    clutter.

    Returns the frames and, for each, who each state is (−1: clutter), in the random order of the
    states.
    """
    model = model_of()
    middle = np.array([WIDTH / 2, HEIGHT / 2]) + rng.normal(0, 8, (n, 2))
    angle = rng.uniform(0, 2 * np.pi, n)
    velocity = 3.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    out = []
    who = []
    for k in range(frames):
        here = middle + (k - frames / 2) * velocity + rng.normal(0, 1.5, (n, 2))
        seen = np.flatnonzero(rng.random(n) < p_seen)
        false = rng.uniform(0, (WIDTH, HEIGHT), (rng.poisson(clutter), 2))
        points = np.vstack([here[seen], false])
        names = np.concatenate([seen, np.full(len(false), -1)])
        order = rng.permutation(len(names))
        out.append(states(points[order], model=model))
        who.append(names[order])
    return out, who


def same(a: Tracks, b: Tracks, *but: str) -> bool:
    """Equal to the last bit, but for some fields."""
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in FIELDS if name not in but
    )


def table(tracks: Tracks) -> list[tuple[int, int, int]]:
    """Frame, identity and detection of each row."""
    return list(
        zip(tracks.frame.tolist(), tracks.identity.tolist(), tracks.detection.tolist(), strict=True)
    )
