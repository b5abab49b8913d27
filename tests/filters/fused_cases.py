"""The fused form and the definition beside each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from phd_cases import FRAME, crowd

from phdtrack import config
from phdtrack.filters import ParticlePHD
from phdtrack.filters.blocks import blocked
from phdtrack.filters.composed import composed_step
from phdtrack.models import BoxMotion, BoxSensor, LocalClutter, MeasurementBirth, UniformClutter
from phdtrack.models.volume import image_volume
from phdtrack.protocols import Model
from phdtrack.types import ParticleBlocks, Particles, SequenceInfo, UpdateInfo

INFO = SequenceInfo(int(FRAME[0]), int(FRAME[1]), 25.0)
NOTHING = ParticleBlocks.empty(6)
NO_BOXES = np.zeros((4, 0))


@dataclass(frozen=True)
class Fixed:
    """A generator that gives one key and one start of the comb."""

    offset: float
    key: tuple[int, int] = (11, 12)

    def random(self, size):
        """The key's words as shares of 2³², then the offset."""
        assert size == 3
        return np.array([*np.array(self.key) / 2.0**32, self.offset])


@dataclass(frozen=True)
class Composed:
    """The particle PHD filter as it is defined: predict, update and reduce."""

    parts: ParticlePHD

    def start(self, model, rng):
        return self.parts.start(model, rng)

    def predict(self, state, model, dt, rng):
        return self.parts.predict(state, model, dt, rng)

    def update(self, state, z, model, dt, rng):
        return self.parts.update(state, z, model, dt, rng)

    def reduce(self, state, rng):
        return self.parts.reduce(state, rng)

    def step(self, state, z, model, dt, rng):
        return composed_step(self.parts, state, z, model, dt, rng)


def model_of(motion=None, birth=None, clutter=None, **sensor) -> Model:
    """Boxes with the default noises, births of 0.05 and clutter of 1 a frame, both around the detections."""
    motion = BoxMotion(frame_size=FRAME) if motion is None else motion
    birth = MeasurementBirth(25 * 0.05, 300, "local") if birth is None else birth
    return Model(motion, BoxSensor(**sensor), birth, LocalClutter(1.0) if clutter is None else clutter)


def still(dt_border: bool = True, **sensor) -> Model:
    """Nothing random but the comb: no noises, no births; gates that let everything in."""
    motion = BoxMotion(acceleration=0.0, size_noise=0.0, frame_size=FRAME if dt_border else (0.0, 0.0))
    clutter = UniformClutter(2.0, image_volume(FRAME))
    return Model(motion, BoxSensor(gate_probability=1.0, **sensor), MeasurementBirth(0.0, 50, "local"), clutter)


def preset(name: str, *sets: str) -> Model:
    return config.build(config.load(preset=name, sets=["filter.kind=particle-phd", *sets]), INFO).model


def level(rng, targets: int, each: int, mass: float = 1.0, **kind) -> ParticleBlocks:
    """Particles of equal weight about random targets, in blocks."""
    state = crowd(rng, targets, each, **kind).state
    equal = Particles(state, np.full(state.shape[1], mass / each))
    return blocked(equal, 1, rng)


def seen_by(rng, state: ParticleBlocks, count: int, noise: float = 0.1) -> np.ndarray:
    """(4, count) detections of randomly chosen particles."""
    x = state.state[:, rng.integers(len(state), size=count)].astype(np.float64)
    z = x[[0, 1, 4, 5]] + noise * rng.standard_normal((4, count)) * np.vstack([x[4:6], x[4:6]])
    z[2:] = np.maximum(z[2:], 2.0)
    return z


def check(state: ParticleBlocks) -> None:
    """What blocks of particles must be."""
    assert state.state.dtype == np.float32
    assert state.state.flags.c_contiguous
    assert state.start.dtype == np.int64
    assert state.start[0] == 0
    sizes = np.diff(state.start)
    assert ((sizes > 0) & (sizes <= 256)).all()
    assert state.start[-1] == state.state.shape[1] == len(state)
    assert np.isfinite(state.state).all()
    assert (state.state[4:6] > 0).all()
    assert type(state.unit) is float
    assert state.unit >= 0


def check_info(info: UpdateInfo, n: int) -> None:
    assert info.evidence.shape == info.clutter.shape == (n,)
    assert np.isfinite(info.evidence).all()
    assert (info.evidence >= 0).all()
    assert 0 <= info.mass_born <= info.mass_predicted * (1 + 1e-12)
    assert np.isfinite(info.mass)
    assert 0 <= info.vanished <= n


def freeze(state: ParticleBlocks) -> ParticleBlocks:
    state.state.flags.writeable = state.start.flags.writeable = False
    return state


def identical(a: ParticleBlocks, b: ParticleBlocks) -> None:
    np.testing.assert_array_equal(a.state, b.state)
    np.testing.assert_array_equal(a.start, b.start)
    assert a.unit == b.unit


def same_info(a: UpdateInfo, b: UpdateInfo) -> None:
    np.testing.assert_array_equal(a.evidence, b.evidence)
    np.testing.assert_array_equal(a.clutter, b.clutter)
    assert (a.mass_predicted, a.mass_born, a.mass, a.vanished) == (b.mass_predicted, b.mass_born, b.mass, b.vanished)


def several_threads(recursion: ParticlePHD, threads: int) -> ParticlePHD:
    return replace(recursion, threads=threads)
