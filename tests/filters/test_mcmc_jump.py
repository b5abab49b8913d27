"""The MCMC filter without given associations, where everything that it samples can be enumerated
[K05].
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from mcmc_cases import apart, joint_law, ring, variation

from phdtrack.filters import MCMC
from phdtrack.filters.mcmc import JointSamples
from phdtrack.kernels.mcmc import Chain, jump_chain, make_options

# Two targets that were there, and a newborn one, at two measurements; each has two states of its
# own.
CANDIDATE = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 2, 2])
WHICH = np.array([-1, -1, 0, 0, 1, 1, -1, -1, 0, 0, 1, 1, 0, 0])
MEMBER = np.array([0, 1, 0, 1, 0, 1, 2, 3, 2, 3, 2, 3, 4, 5])
WEIGHT = np.array([0.1, 0.2, 1.5, 0.4, 0.3, 0.1, 0.2, 0.1, 0.9, 0.2, 0.5, 0.6, 0.7, 0.5])
ABSENT = np.array([0.3, 0.5, 1.0])
PLACE = np.array(
    [
        [0.0, 0, 2, 2],
        [1, 0, 3, 2],
        [0.5, 0.5, 2.5, 2.5],
        [4, 4, 5, 5],
        [0.2, 0, 2, 2],
        [4, 4.5, 5, 5],
    ]
)
interactions = pytest.mark.parametrize("strength", [0.0, 2.0])


def law_of(strength: float) -> dict[tuple, float]:
    """Enumerated from the entries themselves."""
    candidates = [
        [(-1, -1, ABSENT[c])]
        + [
            (int(j), int(i), w)
            for d, j, i, w in zip(CANDIDATE, WHICH, MEMBER, WEIGHT, strict=True)
            if d == c
        ]
        for c in range(3)
    ]
    return joint_law(candidates, apart(PLACE, strength))


@interactions
@pytest.mark.parametrize("exchange", [0.0, 0.4])
def test_the_chain_samples_the_posterior(strength: float, exchange: float, rng):
    """Numbers 0 to 3, births, deaths, clutter and associations at once; total variation below
    0.02.
    """
    law = law_of(strength)
    can = make_options(CANDIDATE, WHICH, MEMBER, WEIGHT, ABSENT, PLACE)
    chain = Chain(50, 1, 100_000, exchange, strength)
    options, states, chance = jump_chain(2, can, np.array([(0, 1), (0, 2), (1, 2)]), chain, rng)
    there = options > can.first[:-1, None]
    now = np.stack([can.measurement[options], np.where(there, states, -1)], axis=2).transpose(
        1, 0, 2
    )
    assert len(law) > 60
    assert variation(law, now) < 0.02
    # The probabilities of the samples say the same of each candidate, with less noise: existence
    # and state.
    for c in range(3):
        exact = defaultdict(float)
        for key, p in law.items():
            exact[key[c][1]] += p
        assert chance[c].mean() == pytest.approx(1 - exact[-1], abs=0.006)
        for i in np.unique(MEMBER[c == CANDIDATE]):
            assert chance[c][states[c] == i].sum() / 100_000 == pytest.approx(exact[i], abs=0.008)


def predicted() -> JointSamples:
    """Two targets, three states each."""
    x = np.array([[0.0, 1, 1, 2, 3, 3], np.zeros(6)])
    chance = np.array([[0.9, 0.7, 0.8], [0.2, 0.5, 0.4]])
    return JointSamples(x, chance, np.array([4, 7]), 9)


def exact(z: np.ndarray, strength: float):
    """Laws of the number of targets, of existence by label, and of each label's cell, by
    enumeration of the model.
    """
    model = ring()
    state = predicted()
    born = model.birth.sample(z, np.zeros(0), model.sensor, 1.0, np.random.default_rng(0))
    x = np.hstack([state.state, born.state])
    kappa = model.clutter.intensity(z)
    shown = model.sensor.p_detect(x)

    def seen(i: int, j: int, w: float) -> tuple[int, int, float]:
        g = model.sensor.likelihood(z[:, j], x[:, i])
        return j, i, w * shown[i] * g / kappa[j]

    candidates = []
    for t in range(2):
        own = [(3 * t + s, state.chance[t, s] / 3) for s in range(3)]
        options = [(-1, -1, 1 - state.chance[t].mean())] + [
            (-1, i, w * (1 - shown[i])) for i, w in own
        ]
        candidates.append(options + [seen(i, j, w) for i, w in own for j in range(z.shape[1])])
    for j in range(z.shape[1]):
        candidates.append([(-1, -1, 1.0)] + [seen(6 + k, j, w) for k, w in enumerate(born.weight)])
    return joint_law(candidates, apart(model.sensor.boxes(x), strength)), x


@interactions
@pytest.mark.parametrize("seen", [(), (1.0,), (1.0, 3.0)])
def test_the_filter_samples_what_the_model_says(seen: tuple[float, ...], strength: float, rng):
    """Tables, labels and information from the model's own functions: everything against
    enumeration.
    """
    z = np.array([seen, np.zeros(len(seen))]).reshape(2, -1)
    filter_ = MCMC(samples=40_000, interaction_strength=strength, min_weight=0.0)
    state, info = filter_.update(predicted(), z, ring(), 1.0, rng)
    law, x = exact(z, strength)
    number = np.zeros(len(info.cardinality))
    for key, p in law.items():
        number[sum(i >= 0 for _, i in key)] += p
    assert 0.5 * np.abs(number - info.cardinality).sum() < 0.02
    assert info.mass == pytest.approx(number @ np.arange(len(number)), abs=0.02)
    np.testing.assert_array_equal(state.label, [4, 7, *(9 + np.arange(len(seen)))])
    assert state.fresh == 9 + len(seen)
    for c, label in enumerate(state.label):
        place = np.zeros(4)
        for key, p in law.items():
            if key[c][1] >= 0:
                place[int(x[0, key[c][1]])] += p
        mine = state.state[0].reshape(len(state.label), -1)[c].astype(int)
        ours = np.bincount(mine, state.chance[c], 4) / filter_.samples
        np.testing.assert_allclose(ours, place, atol=0.01, err_msg=f"label {label}")


def test_an_empty_scene(rng):
    empty = JointSamples.empty(2, 3)
    filter_ = MCMC(samples=100, burn_in=5, interaction_strength=0.0)
    state, info = filter_.update(empty, np.zeros((2, 0)), ring(), 1.0, rng)
    assert len(state.label) == 0
    assert info.mass == 0
    np.testing.assert_array_equal(info.cardinality, [1.0])


def test_faint_targets_are_dropped(rng):
    z = np.array([[1.0], [0.0]])
    filter_ = MCMC(samples=2000, interaction_strength=0.0, min_weight=0.0)
    state, _ = filter_.update(predicted(), z, ring(), 1.0, rng)
    bound = np.sort(state.existence)[1]
    kept, _ = replace(filter_, min_weight=bound).update(
        predicted(), z, ring(), 1.0, np.random.default_rng(1)
    )
    assert 0 < len(kept.label) < 3
    assert (kept.existence >= bound).all()
