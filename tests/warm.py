"""Compile the kernels that the tests need: ``python tests/warm.py``.

Run once before several test processes start, which would otherwise compile the same kernels at the
same time. Kernels that are up to date are only loaded.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

TESTS = Path(__file__).resolve().parent
sys.path[:0] = [str(TESTS), str(TESTS / "conformance"), str(TESTS.parent)]

import shipped  # noqa: E402

from appearance_cases import LOOKS, frame_of, tracker_of  # noqa: E402
from composed import composed_step  # noqa: E402
from experiments.bearing import BearingSensor, TurningMotion  # noqa: E402
from phdtrack import Tracker  # noqa: E402
from phdtrack.detect import make_detector  # noqa: E402
from phdtrack.errors import InputError  # noqa: E402
from phdtrack.filters import Raw  # noqa: E402
from phdtrack.models import FixedBirth, PointBirth, PointMotion, UniformClutter  # noqa: E402
from phdtrack.protocols import Model  # noqa: E402
from phdtrack.types import Frame, GaussianMixture, Particles  # noqa: E402

GAUSSIAN = ("pmb", "pmbm", "mht", "gm-phd", "gm-cphd")
PARTICLES = ("particle-phd", "particle-cphd", "mcmc", "none")
GROUND = {"motion": {"kind": "plane"}, "sensor": {"scaling": "fixed", "fixed_noise": 1.0}}
WORLDS = ({}, {"preset": "mot15"}, {"preset": "m09"}, {"preset": "d14"}, GROUND)
SIZE = (1280, 720)


def models() -> Iterable[Model]:
    """Every shipped kind of model once: boxes, the ground plane, points, turning targets."""
    yield shipped.model_of()
    yield shipped.model_of(shipped.SENSORS["given"])
    scene = {"birth": shipped.BIRTHS["learned"], "clutter": shipped.CLUTTERS["learned"]}
    yield replace(shipped.model_of(), **scene)
    plane = shipped.PLANE_CLUTTERS["plane, region"]
    births = shipped.PLANE_BIRTHS["plane, region"]
    yield Model(shipped.MOTIONS["plane"], shipped.SENSORS["plane"], births, plane)
    point = PointBirth(births_per_second=0.02, particles=200, frame_size=shipped.SIZE)
    clutter = UniformClutter(2.0, 640.0 * 480)
    yield Model(PointMotion(), shipped.SENSORS["point"], point, clutter)
    mean = np.array([[300.0], [200.0], [0.0], [0.0], [0.0]])
    birth = FixedBirth(GaussianMixture(np.array([0.1]), mean, 25.0 * np.eye(5)[None]), 200)
    yield Model(TurningMotion(form="piecewise"), BearingSensor(0.02, 5.0), birth, clutter)


def follow(names: Iterable[str]) -> None:
    """Run trackers with these filters in every world, and the filters on every kind of model."""
    for name in names:
        for world in WORLDS:
            with suppress(InputError):
                Tracker(SIZE, fps=25, filter=name, **world).warm_up()
    filters = [(name, each) for name, each in shipped.FILTERS.items() if kind(name) in names]
    for model in models():
        for name, each in filters:
            # The others start with boxes.
            if model.motion.dim == 6 or "started" not in name:
                with suppress(InputError):
                    steps(each, model)


def kind(name: str) -> str:
    return name.partition(",")[0]


def steps(filter_: object, model: Model) -> None:
    """Advance a filter with arrays that are writable and read-only, which Numba compiles apart."""
    rng = np.random.default_rng(0)
    z = shipped.fixed(model.sensor.measure(shipped.detections(rng, 4)))
    for advance in (type(filter_).step, composed_step):
        for keep in (lambda state: state, shipped.frozen):
            state = keep(filter_.start(model, rng))
            for here in (z, z[:, :0], z, z):
                state, _ = advance(filter_, state, here, model, 1.0, rng)
                state = keep(state)


def associate() -> None:
    rng = np.random.default_rng(0)
    model = shipped.model_of()
    nothing = Particles(np.zeros((6, 0)), np.zeros(0))
    for associator in shipped.ASSOCIATORS.values():
        state = shipped.frozen(associator.start())
        for number in range(1, 9):
            seen = shipped.detections(rng, 3)
            z = shipped.fixed(model.sensor.measure(seen))
            found = replace(Raw().extract(nothing, z, model), tag=np.arange(3))
            state, _ = associator.extend(state, found, z, seen, number, float(number), model)
        associator.finish(state, model)


def extract() -> None:
    rng = np.random.default_rng(0)
    for scaling in ("particle", "given"):
        model = shipped.model_of(shipped.SENSORS[scaling])
        z = model.sensor.measure(shipped.detections(rng, 4))
        x = shipped.states(rng, 5)
        for extractor in shipped.EXTRACTORS.values():
            extractor.extract(shipped.intensity_for(extractor, x, 150, rng), z, model)


def detect() -> None:
    rng = np.random.default_rng(0)
    ground = rng.integers(90, 110, (128, 160, 3), np.uint8)
    detector = make_detector("change")
    for k in range(12):
        image = ground.copy()
        image[40:80, 10 + 8 * k : 40 + 8 * k] = (20, 30, 220)
        detector(Frame(k + 1, k / 25, image))


def recognise() -> None:
    """Follow boxes with embeddings, of which one is not detected for a while."""
    for name in ("pmb", "pmbm", "gm-phd", "none"):
        tracker = tracker_of(filter={"kind": name})
        for k in range(60):
            tracker.update(frame_of([1, 2, 3] if 30 <= k < 45 else [0, 1, 2, 3], k, LOOKS))
        tracker.tracks()


def gaussians() -> None:
    follow(GAUSSIAN)


def others() -> None:
    detect()
    extract()
    associate()
    recognise()
    follow(PARTICLES)


def run(task: str) -> None:
    warnings.simplefilter("ignore")
    globals()[task]()


if __name__ == "__main__":
    with get_context("spawn").Pool(2) as pool:
        pool.map(run, ["gaussians", "others"], chunksize=1)
