"""With noises and births the fused step and the definition draw from the same law: averages over seeds agree.

Each comparison is of two means over independent seeds, in units of the standard error of their difference. Under equal laws
one comparison in 150 000 exceeds 4.5; a file of a few thousand comparisons should have none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fused_cases import NOTHING, Composed, check, level, preset, seen_by
from phd_cases import FRAME

from phdtrack import config, pipeline
from phdtrack.filters import ParticlePHD
from phdtrack.filters.blocks import plain
from phdtrack.models.scene import SceneBirth, SceneClutter
from phdtrack.scene import SceneDensity, marginal
from phdtrack.types import Detections, ParticleBlocks, SequenceInfo

SEEDS = 120
PHD = ParticlePHD(particles_per_target=250)
PRESETS = ("default", "m07", "m09", "fv")
BIRTHS = {"local": ("birth.volume=local", "clutter.volume=local"), "image": ("birth.volume=image", "clutter.volume=image")}


def moments(state, unit: float, about: np.ndarray) -> np.ndarray:
    """Mass, and Σ weight·f for first and second moments about given states, of the particles near each of them."""
    out = []
    for centre in about.T:
        near = (np.abs(state[0] - centre[0]) < 2.5 * centre[4]) & (np.abs(state[1] - centre[1]) < 2.5 * centre[5])
        d = (state[:, near] - centre[:, None]) / centre[[4, 5, 4, 5, 4, 5], None]
        second = d @ d.T
        out += [[near.sum()], d.sum(1), second[np.triu_indices(6)]]
    return unit * np.concatenate(out)


def sample(recursion, state, z, model, dt: float, about, seeds) -> np.ndarray:
    """(seeds, statistics) of one step."""
    out = []
    for seed in seeds:
        after, info = recursion.step(state, z, model, dt, np.random.default_rng(seed))
        if isinstance(after, ParticleBlocks):
            check(after)
        particles = plain(after)
        unit = float(particles.weight[0]) if len(particles) else 0.0
        masses = [info.mass_predicted, info.mass_born, info.mass, len(particles) * unit]
        out.append(np.concatenate([masses, info.evidence, moments(particles.state, unit, about)]))
    return np.array(out)


def agree(a: np.ndarray, b: np.ndarray, limit: float = 4.5) -> None:
    """The means of the columns are equal within their statistical error; what never varies, to rounding."""
    error = np.sqrt(a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b))
    rounding = 2e-5 * np.maximum(np.abs(a).max(0), np.abs(b).max(0)) + 1e-12
    off = np.abs(a.mean(0) - b.mean(0)) / (error + rounding)
    assert off.max() < limit, (int(off.argmax()), off.max(), a.mean(0)[off.argmax()], b.mean(0)[off.argmax()])


def world(seed: int) -> tuple[ParticleBlocks, np.ndarray, np.ndarray]:
    """Three half-believed targets, detections of two of them, of two newcomers that are close, and of one alone."""
    rng = np.random.default_rng(seed)
    state = level(rng, 3, 120, mass=0.6, spread=0.1)
    fresh = np.array([[60.0, 420, 22, 50], [66, 425, 24, 46], [580, 60, 40, 80]]).T
    z = np.ascontiguousarray(np.hstack([seen_by(rng, state, 2, 0.05), fresh]))
    centres = np.zeros((6, z.shape[1]))
    centres[[0, 1, 4, 5]] = z
    lost = state.state[:, :1].astype(np.float64)
    return state, z, np.hstack([centres, lost])


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("births", BIRTHS)
@pytest.mark.parametrize("name", PRESETS)
def test_one_step(name: str, births: str, dt: float):
    """Evidence, masses, and first and second moments of moved and newborn, around every detection."""
    model = preset(name, "birth.particles=150", f"birth.births_per_second={25 * 0.2}", *BIRTHS[births])
    state, z, about = world(PRESETS.index(name))
    ours = sample(PHD, state, z, model, dt, about, range(SEEDS))
    theirs = sample(Composed(PHD), state, z, model, dt, about, range(1000, 1000 + SEEDS))
    agree(ours, theirs)


@pytest.mark.parametrize("dt", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("scaled", [True, False])
def test_motion_alone(scaled: bool, dt: float):
    """A cloud at one point, moved and nothing else: mean and covariance are those of `transition`, roughened."""
    kind = () if scaled else ("motion.scaled_noise=false", "motion.acceleration=1.5", "motion.size_noise=2")
    model = preset("default", "filter.particles_per_target=20000", *kind)
    x = np.array([[300.0, 200, 3, -2, 60, 120]]).T
    count = 20_000
    start = np.append(np.arange(0, count, 250), count)
    state = ParticleBlocks(np.repeat(x, count, axis=1).astype(np.float32), start, 1 / count)
    # As many as there are, of what a miss leaves.
    dense = ParticlePHD(particles_per_target=round(count / (1 - model.sensor.detection_probability)))
    rougher = replace(model.motion, acceleration=model.motion.drawn, roughening=0.0)
    mean, _, cov = rougher.transition(x, dt)
    found, seeds = [], 6
    for seed in range(seeds):
        after, _ = dense.step(state, np.zeros((4, 0)), model, dt, np.random.default_rng(seed))
        assert len(np.unique(after.state, axis=1).T) > 0.98 * after.state.shape[1], "each particle has noises of its own"
        found.append(after.state.astype(np.float64))
    everything, n = np.hstack(found), seeds * count
    size = np.sqrt(cov[0].diagonal())
    off = (everything.mean(1) - mean[:, 0]) / size * np.sqrt(n)
    assert np.abs(off).max() < 5
    # A correlation of 0 is known to 1/√n, a variance to √2/√n of itself.
    scaled_cov = np.cov(everything) / np.outer(size, size)
    np.testing.assert_allclose(scaled_cov, cov[0] / np.outer(size, size), atol=5 * np.sqrt(2 / n))


@pytest.mark.parametrize("births", BIRTHS)
def test_newborn_alone(births: str):
    """One detection in an empty world: the law of the newborn before and after the update, position to velocity."""
    model = preset("default", "birth.particles=400", f"birth.births_per_second={25 * 0.3}", *BIRTHS[births])
    z = np.array([[200.0], [150], [30], [70]])
    about = np.array([[200.0, 150, 0, 0, 30, 70]]).T
    dense = ParticlePHD(particles_per_target=3000)
    ours = sample(dense, NOTHING, z, model, 1.0, about, range(200))
    theirs = sample(Composed(dense), plain(NOTHING), z, model, 1.0, about, range(1000, 1200))
    agree(ours, theirs)
    # Radii are spread evenly: the mass of 400 newborn is known to a few per cent, not to 14 as of independent ones.
    assert ours[:, 1].std() < 0.06 * ours[:, 1].mean()


def test_newborn_velocities_have_uniform_direction_and_gaussian_amplitude():
    model = preset("default", "birth.particles=1000", f"birth.births_per_second={25 * 0.5}")
    z = np.array([[200.0], [150], [30], [70]])
    speed = model.sensor.birth_speed * np.sqrt(30 * 70)
    v = np.hstack([
        ParticlePHD(particles_per_target=4000).step(NOTHING, z, model, 1.0, np.random.default_rng(seed))[0].state[2:4]
        for seed in range(40)
    ]).astype(np.float64)  # fmt: skip
    # Velocities of a frame repeat where a detection has more offspring than the frame has velocities.
    v = np.unique(v, axis=1)
    n = v.shape[1]
    assert n > 10_000
    assert (v**2).sum(0).mean() == pytest.approx(speed**2, rel=5 * np.sqrt(2 / n))
    assert ((v**2).sum(0) ** 2).mean() == pytest.approx(3 * speed**4, rel=5 * np.sqrt(96 / 9 / n))
    angle = np.arctan2(v[1], v[0])
    for k in (1, 2, 3, 4):
        assert np.hypot(np.cos(k * angle).mean(), np.sin(k * angle).mean()) < 4 / np.sqrt(n)


def test_births_go_with_the_interval():
    """γT: births of half an interval are half as many."""
    for births in BIRTHS:
        model = preset("default", "birth.particles=300", *BIRTHS[births])
        z = np.array([[200.0, 400], [150, 150], [30, 30], [70, 70]])
        born = [
            np.mean([PHD.step(NOTHING, z, model, dt, np.random.default_rng(s))[1].mass_born for s in range(20)])
            for dt in (0.5, 1.0, 3.0)
        ]
        np.testing.assert_allclose(np.array(born) / born[1], [0.5, 1, 3], rtol=0.02)


START, SPEED = np.array([[100.0, 100], [320, 240], [500, 380]]), np.array([[3.0, 1], [-2, 0], [-3, -2]])


def scans(seed: int, frames: int = 30) -> list[np.ndarray]:
    """Three walkers, detected nine times in ten, and one false alarm every other frame."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(frames):
        centre = START + k * SPEED + rng.normal(0, 1, (3, 2))
        size = np.array([40.0, 90]) * (1 + 0.05 * rng.standard_normal((3, 2)))
        found = np.hstack([centre - size / 2, centre + size / 2])[rng.random(3) < 0.9]
        if k % 2:
            corner = rng.uniform(0, 380, 2)
            found = np.vstack([found, np.concatenate([corner, corner + rng.uniform(20, 90, 2)])])
        out.append(found)
    return out


def run(stages, form, seed: int) -> np.ndarray:
    """Averages over the frames from 10: mass, states, distance of each walker to the nearest state (at most 40), spread."""
    rng, rows = np.random.default_rng(seed), []
    own = type(stages)(stages.model, form, stages.extractor, stages.associator)
    state = pipeline.start(own, rng)
    for k, boxes in enumerate(scans(seed), 1):
        state, step = pipeline.advance(own, state, Detections.of(boxes), k, k / 25, rng)
        found = step.estimates
        at = START + (k - 1) * SPEED
        apart = np.hypot(*(found.state[:2, :, None] - at.T[:, None, :])).min(0, initial=40.0)
        spread = np.sqrt(np.einsum("nii->n", found.covariance[:, :2, :2])).mean() if len(found) else 0.0
        rows.append([step.info.mass, len(found), apart.mean(), spread])
    return np.mean(rows[10:], axis=0)


@pytest.mark.parametrize("name", PRESETS)
def test_estimates_of_a_scene(name: str):
    """The same walkers are found as often, as near, with the same covariance: paired by scene, over eight of them."""
    sets = ["filter.kind=particle-phd", "filter.particles_per_target=400", "birth.particles=200"]
    stages = config.build(config.load(preset=name, sets=sets), SequenceInfo(int(FRAME[0]), int(FRAME[1]), 25.0))
    ours, theirs = (np.array([run(stages, f, s) for s in range(8)]) for f in (stages.filter, Composed(stages.filter)))
    assert ours[:, 2].mean() < 8, "the walkers are found"
    off = ours - theirs
    assert (np.abs(off.mean(0)) < 4.5 * off.std(0, ddof=1) / np.sqrt(len(off)) + 1e-3).all()
    assert (np.abs(off.mean(0)) < [0.1, 0.15, 1.0, 0.5]).all(), off.mean(0)


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "laid over"])
@pytest.mark.parametrize("dt", [1.0, 3.0])
def test_one_step_with_births_that_were_learned(dt: float, beside: bool):
    """An entrance where people walk to the right reaches some of the newcomers, and false alarms were learned too."""
    low, high = np.array([0.0, 0, -40, -40, 0, 0]), np.array([640.0, 480, 40, 40, 640, 480])
    cov = np.diag([900.0, 1600, 1.0, 0.5, 16, 64])
    cov[1, 2] = cov[2, 1] = 20.0
    cov[2, 3] = cov[3, 2] = 0.3
    entrance = SceneDensity(low, high, 0.3, np.ones(1), np.array([[70.0, 430, 5, -1, 24, 52]]).T, cov[None])
    alarms = marginal(entrance, (0, 1, 4, 5))
    model = preset("default", "birth.particles=150")
    birth, clutter = SceneBirth(0.3, entrance, particles=150), SceneClutter(1.0, alarms)
    if beside:
        # Births and false alarms around each detection too, among objects that are seen in the middle.
        centre = np.array([[300.0, 200, 40, 90]]).T
        people = SceneDensity(alarms.low, alarms.high, 0.4, np.ones(1), centre, np.diag([8000.0, 4000, 200, 900])[None])
        birth, clutter = replace(birth, around_detections=0.2, among=people), replace(clutter, around_detections=0.5)
    model = replace(model, birth=birth, clutter=clutter)
    state, z, about = world(7)
    ours = sample(PHD, state, z, model, dt, about, range(SEEDS))
    theirs = sample(Composed(PHD), state, z, model, dt, about, range(1000, 1000 + SEEDS))
    assert ours[:, 1].mean() > 0.01
    agree(ours, theirs)
