"""Where nothing is pruned, the hypotheses and their probabilities are those of Reid's enumeration
of all histories.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mht_cases import EVERYTHING, boxes, partitions, run, world
from phd_cases import NoBirth

from phdtrack.models import UniformClutter
from reference.mht_twin import enumerate_histories, summed

SCANS = {
    "two and two": [
        boxes((300, 200), (330, 210)),
        boxes((305, 203), (325, 212)),
        boxes((310, 205), (322, 215)),
    ],
    "a miss": [boxes((300, 200), (320, 190)), boxes(), boxes((304, 201), (318, 195))],
    "one more": [boxes((300, 200)), boxes((303, 199), (310, 205)), boxes((308, 202), (313, 203))],
    "one after the other": [
        boxes((300, 200)),
        boxes((303, 202)),
        boxes((307, 203)),
        boxes((309, 207)),
    ],
    "far apart": [
        boxes((150, 100), (500, 400)),
        boxes((152, 101), (497, 401)),
        boxes((155, 103), (501, 399)),
    ],
}


@pytest.mark.parametrize("name", SCANS)
@pytest.mark.parametrize(
    "settings", [{}, {"detection": 0.99, "survival": 0.99}, {"clutter": 1e-7, "birth": 0.2}]
)
def test_hypothesis_probabilities_equal_enumeration(name: str, settings: dict):
    model = world(**settings)
    scans = SCANS[name]
    histories = enumerate_histories(scans, model, 1.0)
    wanted, there, states = summed(histories)
    state, info = run(EVERYTHING, scans, model)
    found = partitions(state, scans)
    assert found.keys() == wanted.keys()
    for key, (weight, leaves) in found.items():
        assert weight == pytest.approx(wanted[key], rel=1e-8), key
        for sequence, leaf in leaves.items():
            assert state.leaves.r[leaf] == pytest.approx(there.get((key, sequence), 0.0), rel=1e-8)
            mean, cov = states[key, sequence]
            np.testing.assert_allclose(state.leaves.mean[leaf], mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(state.leaves.covariance[leaf], cov, rtol=1e-8, atol=1e-8)
    expected = sum(wanted[key] * p for (key, _), p in there.items())
    assert state.mass == pytest.approx(expected, rel=1e-8)
    assert info.mass == pytest.approx(expected, rel=1e-8)
    total = sum(w for w, *_ in histories)
    last = len(scans) - 1
    false = [
        sum(w for w, alarms, _ in histories if (last, j) in alarms) / total
        for j in range(scans[-1].shape[1])
    ]
    np.testing.assert_allclose(info.clutter_probability, false, rtol=1e-8)
    born = sum(w * sum(t.taken[0][0] == last for t in tracks) for w, _, tracks in histories) / total
    assert info.mass_born == pytest.approx(born, rel=1e-8)


def test_far_targets_are_in_clusters_of_their_own():
    """No gate: every measurement is near every track, and all hang together; with one, what is far
    apart is independent.
    """
    model = world()
    scans = SCANS["far apart"]
    whole = partitions(run(EVERYTHING, scans, model)[0], scans)
    gated, _ = run(replace(EVERYTHING, gate_probability=0.9999998), scans, model)
    assert len(gated.clusters) == 2
    for key, (weight, _) in partitions(gated, scans).items():
        assert weight == pytest.approx(whole[key][0], rel=1e-6)


@pytest.mark.parametrize("name", ["two and two", "one more"])
def test_the_best_few_are_the_first_of_all(name: str):
    """The last scan with few hypotheses allowed, after others with all."""
    model = world()
    scans = SCANS[name]
    before, _ = run(EVERYTHING, scans[:-1], model)
    rng = np.random.default_rng(0)
    every = sorted(
        (w for w, _ in partitions(run(EVERYTHING, scans, model)[0], scans).values()), reverse=True
    )
    for most in (1, 3, 7):
        few, _ = replace(EVERYTHING, max_hypotheses=most).step(before, scans[-1], model, 1.0, rng)
        kept = sorted((w for w, _ in partitions(few, scans).values()), reverse=True)
        np.testing.assert_allclose(kept, np.array(every[:most]) / sum(every[:most]), rtol=1e-8)
    sparse, _ = replace(EVERYTHING, hypothesis_threshold=0.01).step(
        before, scans[-1], model, 1.0, rng
    )
    kept = [w for w in every if w >= 0.01 * every[0]]
    assert len(partitions(sparse, scans)) == len(kept) < len(every)


def test_no_births_and_no_clutter_leave_nothing_to_believe():
    model = replace(world(), birth=NoBirth(), clutter=UniformClutter(0.0, 1.0))
    state, info = run(EVERYTHING, SCANS["a miss"], model)
    assert len(state) == 0
    assert info.vanished == 2
    np.testing.assert_array_equal(info.clutter_probability, 1.0)
