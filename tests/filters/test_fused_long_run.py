"""Thousands of frames: blocks stay full and compact, what is gone leaves, memory stays flat."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from fused_cases import NO_BOXES, NOTHING, check, model_of, preset

from phdtrack.filters import ParticlePHD
from phdtrack.models import BoxMotion
from phdtrack.types import ParticleBlocks

PHD = ParticlePHD(particles_per_target=400)


def scan(rng, k: int, targets: int = 5) -> np.ndarray:
    """Targets that circle through the frame, seen nine times in ten, and two false alarms."""
    phase = 2 * np.pi * (k / 400 + np.arange(targets) / targets)
    at = np.stack([320 + 200 * np.cos(phase), 240 + 150 * np.sin(2 * phase)])
    z = np.vstack([at, np.repeat([[40.0], [90.0]], targets, axis=1)]) * (1 + 0.01 * rng.standard_normal((4, targets)))
    false = np.stack([rng.uniform(0, 640, 2), rng.uniform(0, 480, 2), rng.uniform(20, 60, 2), rng.uniform(30, 120, 2)])
    return np.ascontiguousarray(np.hstack([z[:, rng.random(targets) < 0.9], false]))


def extents(state: ParticleBlocks) -> np.ndarray:
    """(B,) the longer side of each block, in boxes."""
    out = []
    for lo, hi in zip(state.start[:-1], state.start[1:], strict=True):
        x = state.state[:, lo:hi]
        out.append(max(np.ptp(x[0]) / x[4].mean(), np.ptp(x[1]) / x[5].mean()))
    return np.array(out)


def entries(state: ParticleBlocks, gates) -> float:
    """How many gates a block meets on average."""
    (left, top), (right, bottom) = gates
    count = 0
    for lo, hi in zip(state.start[:-1], state.start[1:], strict=True):
        x, y = state.state[:2, lo:hi]
        count += ((left <= x.max()) & (right >= x.min()) & (top <= y.max()) & (bottom >= y.min())).sum()
    return count / max(1, len(state.start) - 1)


@pytest.mark.parametrize("births", ["local", "image"])
def test_two_thousand_frames(births: str):
    """The paths of the targets cross again and again; blocks neither multiply nor grow."""
    rng = np.random.default_rng(4)
    model = preset("default", "birth.particles=200", f"birth.volume={births}", f"clutter.volume={births}")
    state, fill, blocks, particles, wide, near = NOTHING, [], [], [], [], []
    for k in range(2000):
        z = scan(rng, k)
        state, info = PHD.step(state, z, model, 1.0, rng)
        if k < 50 or k % 10:
            continue
        check(state)
        sizes = np.diff(state.start)
        fill.append(sizes.mean() / 256)
        blocks.append(len(sizes))
        particles.append(len(state))
        wide.append(np.average(extents(state), weights=sizes))
        near.append(entries(state, model.sensor.gate(z)))
        assert 1 < info.mass < 9, k
    fill, blocks, wide = np.array(fill), np.array(blocks), np.array(wide)
    assert max(particles) < 9 * 400
    assert fill.mean() > 0.35, "blocks are used"
    assert blocks.max() < 40
    assert wide.mean() < 0.8, "blocks are compact"
    assert np.mean(near) < 2, "and few detections near one"
    late, early = slice(-40, None), slice(0, 40)
    assert blocks[late].mean() < 1.3 * blocks[early].mean()
    assert wide[late].mean() < 1.3 * wide[early].mean()


def test_targets_that_cross_part_again():
    """While they are one cloud they share blocks; once apart every block belongs to one of them."""
    rng = np.random.default_rng(6)
    model, state = model_of(BoxMotion(frame_size=(640.0, 480.0))), NOTHING
    for k in range(120):
        offset = 3.0 * (k - 60)
        z = np.array([[320 + offset, 320 - offset], [240.0, 242.0], [40, 40], [90, 90]])
        state, info = PHD.step(state, z * (1 + 0.005 * rng.standard_normal((4, 2))), model, 1.0, rng)
    assert info.mass == pytest.approx(2, abs=0.3)
    assert np.average(extents(state), weights=np.diff(state.start)) < 1.2
    for lo, hi in zip(state.start[:-1], state.start[1:], strict=True):
        right = state.state[0, lo:hi] > 320
        assert right.all() or not right.any() or hi - lo < 20


def test_what_has_drifted_apart_is_parted():
    """One block over the whole frame becomes blocks of at most about a box."""
    rng = np.random.default_rng(1)
    x = np.repeat(np.array([[0.0, 0, 0, 0, 40, 90]]).T, 200, axis=1)
    x[0], x[1] = rng.uniform(0, 640, 200), rng.uniform(0, 480, 200)
    state = ParticleBlocks(x.astype(np.float32), np.array([0, 200]), 1 / 400)
    model = model_of(BoxMotion(acceleration=0.0, size_noise=0.0, survival_probability=1.0), detection_probability=0.0)
    for _ in range(14):
        state, _ = PHD.step(state, NO_BOXES, model, 1.0, rng)
        check(state)
    assert len(state) == 200
    assert extents(state).max() <= 1.0 + 1e-6


def test_what_leaves_the_frame_leaves_the_filter():
    rng = np.random.default_rng(2)
    x = np.array([[600.0, 240, 12, 0, 40, 90]]).T + np.array([5, 5, 1, 1, 2, 4])[:, None] * rng.standard_normal((6, 400))
    state = ParticleBlocks(x.astype(np.float32), np.array([0, 200, 400]), 1 / 400)
    model = model_of(detection_probability=0.0)
    masses = []
    for _ in range(40):
        state, info = PHD.step(state, NO_BOXES, model, 1.0, rng)
        masses.append(info.mass)
    assert masses[0] == pytest.approx(0.99)
    assert masses[-1] < 0.02
    assert len(state) < 10


def test_memory_is_flat():
    """After the first frames nothing is kept but the state: fresh megabytes would show within four hundred."""
    rng = np.random.default_rng(4)
    model, state = preset("default", "birth.particles=200"), NOTHING
    for k in range(60):
        state, _ = PHD.step(state, scan(rng, k), model, 1.0, rng)
    tracemalloc.start()
    try:
        held = []
        for k in range(60, 460):
            state, _ = PHD.step(state, scan(rng, k), model, 1.0, rng)
            if k in (99, 459):
                held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert held[1] - held[0] < 200_000
