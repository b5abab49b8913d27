"""The compiled update of the PMB filter against its definition, one target, hypothesis and
measurement at a time.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from mht_cases import RNG
from pmb_cases import world

from phdtrack.filters import PMB
from phdtrack.filters.pmb import Bernoullis
from phdtrack.kernels.association import ROUNDS, SETTLED
from phdtrack.kernels.pmb import CERTAIN, HYPOTHESIS, TARGET, Layer
from phdtrack.models.clutter import ScoredClutter
from phdtrack.types import GaussianMixture
from reference import pmb_twin as twin
from views import mixture_of

H = np.eye(6)[[0, 1, 4, 5]]
SETTINGS = {
    "default": PMB(merge_distance=0.0),
    "no new velocities": PMB(merge_distance=0.0, turns_per_second=0.0, detection_memory=0.0),
    "static clutter": PMB(merge_distance=0.0, lasting_clutter_prior=0.0, noise_freedom=0.0),
    "no static clutter": PMB(static_clutter_prior=0.0, merge_distance=0.0),
    "few": PMB(
        max_hypotheses=2,
        hypothesis_threshold=0.2,
        existence_threshold=0.05,
        gate_probability=0.9,
        merge_distance=0.0,
    ),
    "merging": PMB(merge_distance=2.0),
    "scales and motions": PMB(
        merge_distance=0.0, noise_freedom=5.0, acceleration_factors=(1.0, 3.0, 9.0)
    ),
    "lasting clutter": PMB(merge_distance=0.0, lasting_clutter_prior=0.2, noise_freedom=5.0),
    "scales merging": PMB(
        merge_distance=2.0,
        noise_freedom=2.0,
        acceleration_factors=(1.0, 4.0),
        static_clutter_prior=0.0,
    ),
}


def a_state(rng: np.random.Generator, targets: int, settings: PMB) -> tuple[Bernoullis, list]:
    """Targets near each other with hypotheses of every kind, as the filter and as the definition
    take them.
    """
    several = rng.integers(1, 5, targets)
    offsets = np.concatenate([[0], np.cumsum(several)])
    count = int(several.sum())
    weight = np.concatenate([rng.dirichlet(np.ones(k)) for k in several])
    mean = rng.normal([300, 200, 0, 0, 40, 80], [12, 12, 3, 3, 3, 3], (count, 6))
    root = rng.normal(0, 1.5, (count, 6, 6))
    cov = root @ root.transpose(0, 2, 1) + 2 * np.eye(6)
    static = rng.random(count) < 0.3
    r = rng.uniform(0.05, 1, targets)
    occluded = rng.uniform(0, 0.9, count)
    best = np.array(
        [
            max((c for c in range(a, b) if not static[c]), key=lambda c: weight[c], default=-1)
            for a, b in itertools.pairwise(offsets)
        ]
    )
    targets = np.zeros(len(r), TARGET)
    hypotheses = np.zeros(count, HYPOTHESIS)
    for name, value in {
        "r": r,
        "presence": 0.5 * r,
        "max_presence": r,
        "label": np.arange(len(r)),
        "best": best,
    }.items():
        targets[name] = value
    targets["begin"] = offsets[:-1]
    targets["end"] = offsets[1:]
    hypotheses["weight"] = weight
    hypotheses["occluded"] = occluded
    hypotheses["static"] = static
    hypotheses["detection"] = -1
    hypotheses["parent"] = np.arange(count)
    hypotheses["target"] = np.repeat(np.arange(len(r)), several)
    # Far from 1 and few, so that both tails and what is learned of them differ from the Gaussian's.
    scale = np.exp(rng.normal(0, 0.7, (count, 2)))
    freedom = rng.uniform(1, 30, count) * (settings.noise_freedom > 0)
    scale[freedom == 0] = 1.0
    motion = np.where(static, 0, rng.integers(0, len(settings.acceleration_factors), count))
    hypotheses["position_scale"], hypotheses["size_scale"] = scale.T
    genuine = rng.normal(0, 3, count)
    if not settings.lasting_clutter_prior:
        genuine[~static] = CERTAIN
    hypotheses["freedom"] = freedom
    hypotheses["motion"] = motion
    hypotheses["genuine"] = genuine
    layer = Layer(targets, hypotheses, mean, cov)
    known = list(zip(map(tuple, scale), freedom, motion, genuine, strict=True))
    forms = [
        [
            twin.Hypothesis(
                weight[c], mean[c], cov[c], bool(static[c]), occluded[c], -1, -1, *known[c]
            )
            for c in range(a, b)
        ]
        for a, b in itertools.pairwise(offsets)
    ]
    return Bernoullis(
        (layer, layer),
        np.zeros((0, 2), np.int64),
        len(r),
        GaussianMixture.empty(6),
        1,
        tuple(rng.uniform([10, 50, 30], [50, 60, 50])),
    ), list(zip(r, forms, strict=True))


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("seed", range(6))
def test_the_update_is_its_definition(seed: int, name: str):
    """Existence, weights, states, noises, measurements, order; false alarms, masses, and what was
    learned of p_D.
    """
    rng = np.random.default_rng(seed)
    settings = SETTINGS[name]
    model = world(clutter=3e-7, birth=1e-7, detection=0.8)
    state, targets = a_state(rng, int(rng.integers(0, 7)), settings)
    z = np.vstack([rng.normal([[300], [200]], 15, (2, 6)), rng.normal([[40], [80]], 3, (2, 6))])
    first, spread = model.sensor.states(z)
    occluded = settings.mean_occluded_time / (
        settings.mean_visible_time + settings.mean_occluded_time
    )
    new = [(0.8 * 1e-7 * (1 - occluded), first[:, j], spread[j]) for j in range(6)]
    # Scores that tell lasting false alarms leave nothing to static clutter.
    scores = np.exp(rng.normal(0, 2, 6)), rng.normal(0, 3, 6) * (settings.lasting_clutter_prior > 0)
    missing = (0.02, rng.uniform(0.1, 0.4))
    model = replace(model, clutter=ScoredClutter(model.clutter, *scores, missing=missing))
    ruled = (
        replace(settings, static_clutter_prior=0.0) if settings.lasting_clutter_prior else settings
    )
    turn = None
    if settings.turns_per_second:
        turn = model.sensor.noise(np.zeros((6, 1)))[2:4, 0], 1.0, 25.0
    odds = twin.learned_odds(state.detections, settings)
    wanted, false, counted = twin.updated(
        targets,
        z.T,
        H,
        9 * np.eye(4),
        0.8,
        [3e-7] * 6,
        new,
        ruled,
        (*scores, missing),
        ROUNDS,
        SETTLED,
        odds,
        turn,
    )
    after, info = settings.update(state, z, model, 1.0, RNG)
    now = after.present
    begins = state.present.targets["begin"]
    label = now.targets["label"].tolist()
    assert label == [t if t >= 0 else label[i] for i, (t, *_) in enumerate(wanted)]
    np.testing.assert_allclose(now.targets["r"], [r for _, r, _ in wanted], rtol=1e-9)
    for k, (t, _, forms) in enumerate(wanted):
        forms = twin.merged(forms, settings.merge_distance) if settings.merge_distance else forms
        at = slice(now.targets["begin"][k], now.targets["end"][k])
        np.testing.assert_allclose(
            now.hypotheses["weight"][at], [x.weight for x in forms], rtol=1e-8
        )
        np.testing.assert_allclose(now.mean[at], [x.mean for x in forms], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(now.covariance[at], [x.cov for x in forms], rtol=1e-8, atol=1e-8)
        scales = np.stack(
            [now.hypotheses["position_scale"][at], now.hypotheses["size_scale"][at]], axis=1
        )
        np.testing.assert_allclose(scales, [x.scale for x in forms], rtol=1e-8)
        np.testing.assert_allclose(
            now.hypotheses["freedom"][at], [x.freedom for x in forms], rtol=1e-12
        )
        assert now.hypotheses["motion"][at].tolist() == [x.motion for x in forms]
        np.testing.assert_allclose(
            now.hypotheses["genuine"][at], [min(x.genuine, CERTAIN) for x in forms], rtol=1e-9
        )
        np.testing.assert_allclose(
            now.hypotheses["occluded"][at], [x.occluded for x in forms], rtol=1e-9
        )
        assert now.hypotheses["static"][at].tolist() == [x.static for x in forms]
        assert now.hypotheses["detection"][at].tolist() == [x.taken for x in forms]
        assert now.hypotheses["parent"][at].tolist() == [
            begins[t] + x.source if t >= 0 else -1 for x in forms
        ]
    np.testing.assert_allclose(info.clutter_probability, false, rtol=1e-8)
    if settings.detection_memory:
        fade = 1 - counted[1] / settings.detection_memory
        remembered = fade * np.array(state.detections) + counted
        np.testing.assert_allclose(after.detections, remembered, rtol=1e-8)
    assert info.mass_predicted == pytest.approx(0.5 * sum(r for r, _ in targets) + info.mass_born)
    assert info.mass == pytest.approx(after.mass)
    assert info.mass == pytest.approx(mixture_of(after).weight.sum())
