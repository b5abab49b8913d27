"""The two sweeps and the account between them, against loops over single particles; and the whole step as plain Python."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from inner_kernels import from_python
from phdtrack.filters import ParticlePHD
from phdtrack.filters.box_tables import BoxModel, motion_numbers, seen
from phdtrack.filters.fused import fused_step
from phdtrack.kernels.account import account, births
from phdtrack.kernels.box_blocks import BLOCK, ROWS, SUM
from phdtrack.kernels.comb import by_cells, comb, cut
from phdtrack.kernels.newborn import PEAK, standard_points, stretch
from phdtrack.kernels.offspring import _pick, sweep_offspring
from phdtrack.kernels.sweeps import EXTENTS, sweep_born, sweep_old
from phdtrack.models import BoxMotion, BoxSensor, LocalClutter, MeasurementBirth
from phdtrack.models.births import KEPT, region
from phdtrack.protocols import Model
from phdtrack.types import ParticleBlocks
from reference import fused_twin as twins

_pick, stretch = from_python(_pick, stretch)

F = np.float32
KEY = (17, 2**32 - 5)
P_D, PER_TARGET, MOST = 0.9, 60, 300
LIMIT, RADIUS = region()


def world(scaling: str, local: bool, border: bool = True) -> Model:
    frame = (300.0, 200.0)
    motion = BoxMotion(frame_size=frame if border else (0.0, 0.0))
    birth = MeasurementBirth(25 * 0.3, MOST, "local" if local else "image", frame)
    return Model(motion, BoxSensor(P_D, scaling=scaling, fixed_noise=(4.0, 6.0)), birth, LocalClutter(0.5))


def scene(n: int = 5) -> tuple[ParticleBlocks, np.ndarray]:
    """Three clusters in six blocks, one leaving the frame; detections of two, of nothing, and two that are close."""
    rng = np.random.default_rng(8)
    centre = np.array([[80.0, 90, 3, -2, 30, 60], [295, 150, 20, 0, 20, 45], [200, 60, 0, 1, 40, 50]]).T
    scale = np.array([3.0, 5, 1, 1, 4, 6])[:, None]
    x = np.hstack([c[:, None] + scale * rng.standard_normal((6, 50)) for c in centre.T])
    x[0, 50:60] = 330
    state = ParticleBlocks(x.astype(F), np.array([0, 20, 50, 70, 100, 130, 150]), 0.02)
    z = np.array([[83.0, 88, 30, 60], [199, 62, 38, 52], [205, 65, 42, 47], [30, 170, 20, 40], [33, 172, 22, 36]]).T
    return state, np.ascontiguousarray(z[:, :n])


def swept(model: Model, state: ParticleBlocks, z, dt: float = 1.0, pieces: int = 1) -> SimpleNamespace:
    """The first sweep over the particles, in one piece or several."""
    parts = BoxModel(model.motion, model.sensor, model.birth)
    frame, count = seen(parts, z, 13.28, dt), len(state.start) - 1
    out = SimpleNamespace(parts=parts, frame=frame, key=np.array(KEY), blocks=state)
    out.moved, out.extents, out.alive = np.empty_like(state.state), np.empty((count, EXTENTS), F), np.empty(count)
    edges, found = np.linspace(0, count, pieces + 1).astype(int), []
    for lo, hi in pairwise(edges):
        found.append(sweep_old(
            lo, hi, state.state, state.start, motion_numbers(model.motion, dt), out.key, frame.table, parts.own,
            frame.numbers, frame.lower, frame.upper, *frame.grid, out.moved, out.extents, out.alive,
        ))  # fmt: skip
    lengths = np.cumsum([0, *(len(part[1]) for part in found)])
    out.first = np.concatenate([[0], *(part[0][1:] + e for part, e in zip(found, lengths[:-1], strict=True))])
    out.which = np.concatenate([part[1] for part in found])
    out.sums = np.concatenate([part[2][:, : len(part[1])] for part in found], axis=1)
    return out


def born(model: Model, old: SimpleNamespace, flat: float) -> SimpleNamespace:
    frame = old.frame
    flats = np.full(frame.table.shape[1], flat, F)
    out = SimpleNamespace(points=standard_points(2 * MOST, RADIUS, old.key), flat=flats)
    unit = old.blocks.unit * 0.99
    out.many, out.start, out.gain_start = births(old.which, old.sums, unit, MOST, KEPT, frame.touching, frame.table)
    out.base, out.gains = np.empty(out.start[-1], F), np.empty(out.gain_start[-1], F)
    sweep_born(
        0, len(out.many), out.many, out.start, out.points, MOST, old.key, frame.table, old.parts.own, frame.numbers,
        old.parts.local, out.flat, frame.near_start, frame.near, frame.touching, out.gain_start, out.base, out.gains,
    )  # fmt: skip
    return out


def sigma_of(model: Model, z, j: int, x) -> tuple:
    if model.sensor.scaling == "particle":
        return twins.own_sigma(x, 0.15, 1.0)
    at_rest = np.array([[*z[:2, j], 0, 0, *z[2:, j]]]).T
    return tuple(model.sensor.noise(at_rest)[[0, 1, 4, 5], 0])


def g(model: Model, z, j: int, x) -> float:
    return twins.likelihood(z[:, j], x, sigma_of(model, z, j, x))


def proposal(scaling: str, z) -> np.ndarray:
    """(4, N) deviations that newborn are drawn with: the detection's own where the likelihood's follow the particle."""
    model = world("detection" if scaling == "particle" else scaling, True)
    return np.array([sigma_of(model, z, j, None) for j in range(z.shape[1])]).T


SCALINGS = ("particle", "detection", "fixed")


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("dt", [1.0, 2.0])
def test_first_sweep(scaling: str, dt: float):
    model, (state, z) = world(scaling, True), scene()
    found = swept(model, state, z, dt)
    rest = 0.03 * np.sqrt((dt**3 - dt) / 12) if dt > 1 else 0.0
    for b, (lo, hi) in enumerate(zip(state.start[:-1], state.start[1:], strict=True)):
        moved = np.empty((6, hi - lo))
        alive = np.empty(hi - lo, bool)
        for i in range(hi - lo):
            x = state.state[:, lo + i].astype(float)
            moved[:, i] = twins.move(x, twins.normals(i, b, 0, KEY), dt, 0.03, 0.1, 1.0, True)
            if dt > 1:
                moved[:2, i] += rest * np.maximum(x[4:6], 1) * twins.normals(i, b, 1, KEY)[:2]
            alive[i] = twins.survives(x, 300, 200)
        got = found.moved[:, lo:hi].astype(float)
        np.testing.assert_allclose(np.abs(got), np.abs(moved), rtol=1e-4, atol=1e-3)
        np.testing.assert_array_equal(got[4] > 0, alive)
        assert found.alive[b] == alive.sum()
        near = found.which[found.first[b] : found.first[b + 1]].tolist()
        sums = found.sums[:, found.first[b] : found.first[b + 1]]
        box = got[0].min(), got[1].min(), got[0].max(), got[1].max()
        frame = found.frame
        assert sorted(near) == [j for j in range(5) if twins.touches(box, frame.lower, frame.upper, j)]
        for j, total, explained in zip(near, *sums, strict=True):
            x = got[:, alive].T
            assert total == pytest.approx(sum(g(model, z, j, p) for p in x), rel=1e-3, abs=1e-30)
            d2 = np.array([twins.distance2(z[:, j], p, sigma_of(model, z, j, p)) for p in x])
            assert explained == (d2 <= 13.28).sum()
    assert 0 < found.alive[2] < 20


def test_pieces_give_the_same_bits():
    model, (state, z) = world("particle", True), scene()
    one, three = swept(model, state, z), swept(model, state, z, pieces=3)
    for name in ("moved", "extents", "alive", "first", "which", "sums"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


def test_more_detections_near_a_block_than_there_was_room_for():
    """The lists begin with room for 64 and four a block."""
    model, (state, _) = world("particle", True), scene()
    z = np.repeat([[80.0], [90.0], [30.0], [60.0]], 150, axis=1)
    found = swept(model, state, z)
    assert np.diff(found.first)[:2].tolist() == [150, 150]
    np.testing.assert_array_equal(found.sums[:, :150], np.repeat(found.sums[:, :1], 150, axis=1))


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("local", [True, False])
def test_newborn_and_account(scaling: str, local: bool):
    model, (state, z) = world(scaling, local), scene()
    old = swept(model, state, z)
    new = born(model, old, 0.0 if local else 2e-8)
    covered = np.bincount(old.which, old.sums[1], 5) * 0.02 * 0.99
    np.testing.assert_array_equal(new.many, np.ceil(MOST * np.clip(1 - covered, 0, 1)).astype(int))
    assert new.many[3] == MOST > BLOCK
    sigma = proposal(scaling, z)
    np.testing.assert_allclose(old.frame.table[PEAK], new.many / ((2 * np.pi) ** 2 * sigma.prod(0)) / KEPT, rtol=1e-5)
    base, gains = [], {}
    for j in range(5):
        begin = stretch(j, MOST, np.uint32(KEY[0]), np.uint32(KEY[1]))
        at = z[:, [j]] + sigma[:, [j]] * new.points[:4, begin : begin + new.many[j]]
        x = [np.array([p[0], p[1], 0, 0, p[2], p[3]]) for p in at.T]
        w = [twins.newborn_weight(p, z, sigma, new.many, LIMIT * (1 + 1e-6), KEPT, 0.3, None if local else 2e-8) for p in x]
        batch = np.arange(len(x)) // BLOCK
        base.append(np.bincount(batch, w, -(-len(x) // BLOCK)))
        for k in old.frame.near[old.frame.near_start[j] :][: old.frame.touching[j]]:
            gains[j, int(k)] = np.bincount(batch, [a * g(model, z, k, p) for a, p in zip(w, x, strict=True)])
    np.testing.assert_allclose(new.base, np.concatenate(base), rtol=5e-3)
    kappa = model.clutter.intensity(z)
    evidence, weight, mass, batch_mass, vanished, masses = account(
        old.first, old.which, old.sums, old.alive, 0.02 * 0.99, new.start, old.frame.near_start, old.frame.near,
        old.frame.touching, new.gain_start, new.base, new.gains, kappa, P_D,
    )  # fmt: skip
    block = np.repeat(np.arange(6), np.diff(old.first))
    pairs = {(b, j): s for b, j, s in zip(block.tolist(), old.which.tolist(), old.sums[0].tolist(), strict=True)}
    wanted, w, blocks, newborn = twins.account(pairs, old.alive, 0.02 * 0.99, base, gains, kappa, P_D)
    np.testing.assert_allclose(evidence, wanted, rtol=5e-3)
    np.testing.assert_allclose(weight, w, rtol=5e-3)
    np.testing.assert_allclose(mass[:6], blocks, rtol=5e-3)
    np.testing.assert_allclose(mass[6:], [part.sum() for part in newborn], rtol=5e-3)
    np.testing.assert_allclose(batch_mass, np.concatenate(newborn), rtol=5e-3)
    assert vanished == 0
    np.testing.assert_allclose(masses, [old.alive.sum() * 0.02 * 0.99, new.base.sum(), mass.sum()], rtol=1e-6)


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_second_sweep(scaling: str, offset: float):
    """Every tooth falls on the particle that the weights, recomputed one by one, put there."""
    model, (state, z) = world(scaling, True), scene()
    old = swept(model, state, z)
    new, frame, unit = born(model, old, 0.0), old.frame, 0.02 * 0.99
    kappa = model.clutter.intensity(z)
    _, weight, mass, batch_mass, _, _ = account(
        old.first, old.which, old.sums, old.alive, unit, new.start, frame.near_start, frame.near, frame.touching,
        new.gain_start, new.base, new.gains, kappa, P_D,
    )  # fmt: skip
    count = round(PER_TARGET * mass.sum())
    extents = np.concatenate([old.extents, frame.extents])
    order = by_cells(extents)
    teeth, place, phase, width = comb(mass, order, count, offset)
    start, divided = cut(extents, order, teeth, 1.0)
    assert start[-1] == teeth.sum() == count
    # Any mean and any triangle, as births that were learned have them.
    turned = np.random.default_rng(9).normal(size=frame.velocity.shape).astype(F)
    out = np.full((6, count), np.nan, F)
    for lo, hi in ((0, 4), (4, len(order))):
        sweep_offspring(
            lo, hi, order, teeth, place, phase, width, divided, old.moved, state.start, old.first, old.which,
            weight.astype(F), F(1 - P_D), frame.table, old.parts.own, frame.numbers, old.key, new.many, new.start,
            new.points, MOST, True, new.flat, frame.near_start, frame.near, frame.touching, batch_mass, turned, out,
        )  # fmt: skip
    sigma = proposal(scaling, z)
    doubtful = 0
    for source in order:
        if source < 6:
            lo, hi = state.start[source], state.start[source + 1]
            x = old.moved[:, lo:hi].astype(float)
            w = np.where(x[4] > 0, unit, 0.0)
            x[4] = np.abs(x[4])
            near = old.which[old.first[source] : old.first[source + 1]]
            if divided[source]:
                row = x[divided[source] - 1].astype(F)
                left = row < F(0.5) * (row.min() + row.max())
                sorting = np.argsort(~left, kind="stable")
                x, w = x[:, sorting], w[sorting]
            velocity = None
        else:
            j = source - 6
            begin = stretch(j, MOST, np.uint32(KEY[0]), np.uint32(KEY[1]))
            at = z[:, [j]] + sigma[:, [j]] * new.points[:4, begin : begin + new.many[j]]
            x = np.vstack([at[:2], np.zeros_like(at[:2]), at[2:]])
            w = np.array([twins.newborn_weight(p, z, sigma, new.many, LIMIT * (1 + 1e-6), KEPT, 0.3, None) for p in x.T])
            near = frame.near[frame.near_start[j] :][: frame.touching[j]]
            which = (begin + np.arange(teeth[source])) % new.points.shape[1]
            mean, (a, b, c), (u, v) = turned[:2, [j]], turned[2:, j], new.points[5:7, which]
            velocity = mean + np.array([a * u, b * u + c * v])
        total = np.array([(1 - P_D) + sum(weight[k] * g(model, z, k, p) for k in near) for p in x.T]) * w
        chosen, margin = twins.teeth_on(total, phase[source], width[source], teeth[source])
        got = out[:, place[source] : place[source] + teeth[source]].astype(float)
        rows = [0, 1, 2, 3, 4, 5] if velocity is None else [0, 1, 4, 5]
        same = np.isclose(got[rows], x[np.ix_(rows, chosen)], rtol=1e-4, atol=1e-3).all(0)
        assert (same | (margin < 1e-2)).all(), "but for teeth on an edge"
        doubtful += (~same).sum()
        if velocity is not None:
            np.testing.assert_allclose(got[2:4], velocity, rtol=1e-5, atol=1e-5)
    assert doubtful <= 0.05 * count
    assert teeth[6:].sum() > 0
    assert divided.any()


@pytest.mark.parametrize(("weight", "phase", "width", "teeth", "chosen"), [
    ([1, 1, 1, 1], 0.5, 4.0, 4, [0, 1, 2, 3]),
    ([3, 0, 0, 1], 0.25, 4.0, 4, [0, 0, 0, 3]),
    ([0, 5, 0, 0], 0.9, 7.0, 7, [1] * 7),
    ([1, 1, 1, 1], 0.6, 1.0, 1, [2]),
    # A tooth at the very beginning, and one that rounding has put at or behind the end.
    ([0, 0.7, 1.3, 0], 0.0, 2.0, 2, [1, 2]),
    ([0, 0.7, 1.3, 0], 1e-12, 2.0, 2, [1, 2]),
    ([0, 0.7, 1.3, 0], 0.0, 1.999, 3, [1, 2, 2]),
    ([0, 1, 0, 0], 0.9999999, 0.9999999, 1, [1]),
])  # fmt: skip
def test_teeth_fall_on_particles_that_have_a_weight(weight, phase: float, width: float, teeth: int, chosen):
    n, s = len(weight), np.full(ROWS * BLOCK, np.nan, F)
    s.reshape(ROWS, BLOCK)[:6, :n] = np.arange(n)
    s[SUM : SUM + n] = weight
    out = np.full((6, teeth + 3), np.nan, F)
    _pick(s, n, teeth, 2, phase, width, np.empty(BLOCK, np.int32), np.full(teeth + 2, 99, np.uint32), out)
    np.testing.assert_array_equal(out[:, 2 : 2 + teeth], np.tile(chosen, (6, 1)))
    assert np.isnan(out[:, :2]).all()
    assert np.isnan(out[:, 2 + teeth :]).all()


@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize("n", [0, 3])
def test_the_whole_step_runs_as_plain_python(local: bool, n: int):
    """No overflow, no index past the end, no division by zero that the JIT would hide."""
    model, (state, z) = world("particle", local, border=False), scene(n)
    parts = BoxModel(model.motion, model.sensor, MeasurementBirth(25 * 0.3, 40, model.birth.volume, (300.0, 200.0)))
    rng = np.random.default_rng(1)
    for _ in range(2):
        state, info = fused_step(ParticlePHD(particles_per_target=40), parts, state, z, model, 1.5, rng)
        assert np.isfinite(state.state).all()
        claimed = (info.evidence / (info.evidence + info.clutter)).sum()
        assert info.mass == pytest.approx(0.1 * info.mass_predicted + claimed, rel=1e-4)
        assert len(state) == round(40 * info.mass)
