"""The evidence for a link against the densities of the measurements themselves."""

import numpy as np
import pytest
from smoothing_cases import model_of, piece, sequence, walk

from phdtrack.smooth.paths import paths_of
from phdtrack.smooth.smoothing import Sequence, Smoothing, _candidates, _matched
from reference import smoothing_twin as twin


@pytest.mark.parametrize("seed", range(6))
def test_it_is_the_ratio_of_one_trajectorys_density_to_two(seed: int):
    rng, model, n = np.random.default_rng(seed), model_of(survival_probability=1.0), 24
    walked = walk(rng, n, (200, 200), rng.normal(0, 2, 2), noise=2.0)
    walked[14:] += rng.normal(0, 6, 4)
    tracks, measured = sequence([piece(walked, 1, (1, 9)), piece(walked, 1, (15, n))], n, model)
    seen = Sequence.of(measured, model)
    paths = paths_of(tracks, measured)
    settings = Smoothing(mean_occluded_time=0.4, max_gap=2.0, max_overlap_time=0.0, reentry_probability=0.25)
    before, after, odds = _candidates(paths, seen.smooth(paths), seen, settings)
    assert (before.tolist(), after.tolist()) == ([0], [1])
    one = np.concatenate([np.arange(9), np.full(5, -1), np.arange(9, 19)])
    ratio = twin.log_density(model.motion, measured.time, seen, one)
    ratio -= twin.log_density(model.motion, measured.time[:9], seen, one[:9])
    ratio -= twin.log_density(model.motion, measured.time[14:], seen, one[14:])
    # Two beginnings in 23 frames, anywhere among the measurements, seen as finely as those are.
    noise = np.sqrt(seen.covariance[0].diagonal()[seen.observed])
    volume = np.prod(np.ptp(measured.z, axis=1) + 4 * noise)
    prior = np.log(0.25 / 0.75) + np.log(np.exp(-6 / 10) / 10) - np.log(2 / (23 * volume))
    assert odds[0] == pytest.approx(ratio + prior, rel=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_the_matching_is_the_best_of_all(seed: int):
    rng = np.random.default_rng(seed)
    k = 5
    odds = np.where(rng.random((k, k)) < 0.6, rng.normal(1, 3, (k, k)), -1.0)
    before, after = np.nonzero(odds > -0.5)
    found = _matched(before, after, odds[before, after], k)

    def best(row: int, free: frozenset[int]) -> float:
        if row == k:
            return 0.0
        return max([best(row + 1, free), *(max(odds[row, c], 0) + best(row + 1, free - {c}) for c in free)])

    chosen = np.flatnonzero(found >= 0)
    assert len(set(found[chosen].tolist())) == len(chosen)
    assert odds[chosen, found[chosen]].sum() == pytest.approx(best(0, frozenset(range(k))))
    assert (odds[chosen, found[chosen]] > 0).all()
