"""The lower bound on the number of particles: what it does to the number, and to a target that has just begun."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fused_cases import Composed, Fixed, check, level, model_of, seen_by
from phd_cases import FRAME, crowd

from phdtrack.filters import ParticleCPHD, ParticlePHD
from phdtrack.filters.blocks import plain
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.models.volume import image_volume
from phdtrack.protocols import Model


def test_there_are_as_many_where_there_is_anything(rng):
    state = crowd(rng, 5, 100)
    few = ParticlePHD(100, min_particles=700).reduce(state, rng)
    assert len(few) == 700
    assert few.mass == pytest.approx(state.mass)
    assert len(ParticlePHD(1000, min_particles=700).reduce(state, rng)) == 5000
    # The upper bound is the last word, and nothing stays nothing.
    assert len(ParticlePHD(100, min_particles=700, max_particles=600).reduce(state, rng)) == 600
    assert len(ParticlePHD(100, min_particles=700).reduce(replace(state, weight=1e-6 * state.weight), rng)) == 0


def test_so_it_is_in_the_fused_step(rng):
    state = level(rng, 5, 200)
    z = seen_by(rng, state, 5)
    usual, info = ParticlePHD(100).step(state, z, model_of(), 1.0, Fixed(0.5))
    more, same = ParticlePHD(100, min_particles=1700).step(state, z, model_of(), 1.0, Fixed(0.5))
    check(more)
    assert len(usual) < len(more) == 1700
    assert more.mass == pytest.approx(usual.mass) == pytest.approx(info.mass) == pytest.approx(same.mass)


def test_and_in_the_cardinalised_filter(rng):
    z = np.array([[200.0], [200.0], [30.0], [60.0]])
    sizes = []
    for fewest in (0, 900):
        recursion = ParticleCPHD(100, min_particles=fewest)
        state, _ = recursion.step(recursion.start(model_of(), rng), z, model_of(), 1.0, rng)
        sizes.append(len(state.intensity))
    assert sizes[0] < sizes[1] == 900


@pytest.mark.parametrize("form", [lambda settings: settings, Composed], ids=["fused", "definition"])
def test_who_has_just_begun_is_placed_better(form):
    """A walker alone, detected in each of five frames with √3 pixels of noise: without the bound the first frame leaves four
    particles of him, none of which has his velocity."""
    motion = BoxMotion(acceleration=0.3, size_noise=0.3, scaled_noise=False, frame_size=FRAME)
    sensor = BoxSensor(scaling="fixed", birth_speed_pixels=2.0)
    model = Model(
        motion, sensor, MeasurementBirth(25 * 0.01, 1000, "image", FRAME), UniformClutter(1.0, image_volume(FRAME))
    )
    filters = [form(ParticlePHD(1500, min_particles=fewest)) for fewest in (0, 1500)]
    without, with_it = np.array([[_miss(one, model, seed) for seed in range(40)] for one in filters])
    # 4.0 and 1.7 pixels over 150 seeds; the means of 40 have errors of about 0.5 and 0.15.
    assert with_it.mean() < 0.75 * without.mean()
    assert with_it.mean() < 2.3


def _miss(recursion, model: Model, seed: int) -> float:
    """How far the mean of the particles is from the walker in the end, pixels."""
    rng = np.random.default_rng(seed)
    state, velocity, at = recursion.start(model, rng), rng.normal(0, 1.4, 2), np.array([300.0, 200.0])
    for _ in range(5):
        at = at + velocity
        z = np.concatenate([at + rng.normal(0, 3**0.5, 2), rng.normal((30, 60), 6**0.5)])[:, None]
        state, _ = recursion.step(state, z, model, 1.0, rng)
    assert len(state) > 0
    return float(np.hypot(*(plain(state).state[:2].mean(axis=1) - at)))
