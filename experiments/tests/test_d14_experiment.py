"""The D14 experiment: the bound that it claims, what its filters are given, and the page in
short.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from experiments import d14, d14_printed
from experiments.claims import WORDS
from experiments.d14_runs import (
    FILTERS,
    GATE,
    IN_ALL,
    KALMAN,
    VARIANCES,
    CorridorRun,
    Points,
    RunErrors,
    errors,
    kalman,
    posterior_deviation,
    scans_of,
    stages_of,
    track,
    work,
)
from phdtrack.types import Particles


def test_the_models_posterior_deviation_is_the_papers():
    np.testing.assert_allclose(
        [posterior_deviation(v) for v in VARIANCES], [0.68, 0.94, 1.28], atol=0.005
    )


@pytest.mark.parametrize("variance", VARIANCES)
def test_kalman_error_equals_its_posterior_deviation(
    variance: float,
):
    """Four points over 1048 frames in all, five seeds: within 4 %."""
    squares = [
        work(CorridorRun("model", KALMAN, 0, variance, seed)).overall ** 2 for seed in range(5)
    ]
    assert math.sqrt(np.mean(squares)) == pytest.approx(posterior_deviation(variance), rel=0.04)


def test_the_kalman_filters_are_those_of_single_targets():
    """Each target alone, with textbook matrices."""
    job = CorridorRun("corridor", KALMAN, 0, 2.0, 3)
    scans = scans_of(job)
    found = kalman(stages_of(job).model, scans)
    f = np.eye(4) + np.eye(4, k=2)
    for one in range(1, 5):
        mean = None
        for number in np.unique(found.frame[found.identity == one]):
            z = scans[number - 1][:2, scans[number - 1][2] == one][:, 0]
            if mean is None:
                mean = np.array([*z, 0, 0])
                cov = 2.0 * np.eye(4)
            else:
                mean = f @ mean
                cov = f @ cov @ f.T + 2.0 * np.eye(4)
                gain = cov[:, :2] @ np.linalg.inv(cov[:2, :2] + 2.0 * np.eye(2))
                mean = mean + gain @ (z - mean[:2])
                cov = cov - gain @ cov[:2]
            mine = (found.frame == number) & (found.identity == one)
            np.testing.assert_allclose(found.point[:, mine][:, 0], mean[:2], rtol=1e-9)


@pytest.mark.slow
def test_all_filters_get_the_same_measurements():
    """N is the number of samples, or of particles for each estimated target; the sensor's
    variance is that of the measurements.
    """
    scans = [
        scans_of(CorridorRun("corridor", name, n, 0.5, 4)) for name in FILTERS for n in (100, 500)
    ]
    for other in scans[1:]:
        for a, b in zip(scans[0], other, strict=True):
            np.testing.assert_array_equal(a, b)
    phd, joint, true, greedy = (
        stages_of(CorridorRun("corridor", name, 300, 0.5, 4)) for name in FILTERS
    )
    assert (
        phd.filter.particles_per_target,
        phd.filter.max_particles,
        phd.filter.skip_empty_frames,
    ) == (300, 0, True)
    assert (true.filter.samples, true.filter.burn_in, true.filter.thin, true.filter.greedy) == (
        300,
        50,
        1,
        False,
    )
    assert greedy.filter.greedy
    assert (true.filter.ancestors, joint.filter.ancestors) == ("each", "joint")
    assert all(stages.model.sensor.noise_variance == 0.5 for stages in (phd, true, greedy, joint))
    found, _ = track(CorridorRun("corridor", "SMC PHD", 100, 0.5, 4))
    assert set(found.identity) == {-1}
    found, _ = track(CorridorRun("corridor", "MCMC", 100, 0.5, 4))
    assert set(found.identity) == {1, 2, 3, 4}


def test_a_state_far_from_everybody_is_nobodys_error():
    true = Points(np.array([1, 1]), np.array([1, 2]), np.array([[0.0, 100], [0, 0]]))
    found = Points(np.array([1, 1]), np.array([-1, -1]), np.array([[3.0, 140], [4, 0]]))
    outcome = errors(true, found)
    np.testing.assert_array_equal(outcome.mapped, [1, 0])
    assert outcome.overall == pytest.approx(5.0)


@pytest.mark.slow
def test_sampler_but_not_greedy_chain_nears_posterior_mean():
    """With the true model: root mean squared distances per axis from the exact mean, two seeds."""
    far = {}
    for name in d14.CHAINS:
        for n in (500, 4000):
            runs = [work(CorridorRun("model", name, n, 2.0, seed)) for seed in range(2)]
            far[name, n] = np.mean([run.to_posterior for run in runs])
    assert far["MCMC", 4000] < 0.45 * far["MCMC", 500]
    assert far["MCMC joint", 4000] < 0.45 * far["MCMC joint", 500]
    assert far["MCMC greedy", 4000] > 5 * far["MCMC", 4000]
    assert far["MCMC greedy", 4000] > 0.6 * far["MCMC greedy", 500]


def test_phd_filter_locates_people_near_the_bound():
    phd, bound = (
        work(CorridorRun("corridor", name, n, 1.0, 0))
        for name, n in (("SMC PHD", 1000), (KALMAN, 0))
    )
    assert phd.located.min() > 0.9
    assert bound.located.min() > 0.999
    assert bound.settled <= phd.settled < 1.15 * bound.settled
    assert phd.spare < 0.1


def outcome(truth, located) -> RunErrors:
    """Errors and located shares of two targets; nothing else is asked for."""
    return RunErrors(
        np.array(truth), np.array(truth), np.array(located), 1.0, 1.0, 1.0, 1.0, 0.0, 0.1
    )


def test_with_misses_who_is_not_located_is_the_gate_away():
    assert d14.with_misses(outcome([1.5, 1.5], [1.0, 1.0])) == pytest.approx(1.5)
    assert d14.with_misses(outcome([math.nan, math.nan], [0.0, 0.0])) == pytest.approx(
        GATE / math.sqrt(2)
    )
    # Half of one target's frames at 2 px, the other half and all of the other target's missed: (½·4
    # + ½·50 + 50) / 2.
    assert d14.with_misses(outcome([2.0, math.nan], [0.5, 0.0])) == pytest.approx(math.sqrt(38.5))


def test_n_is_for_each_estimated_target():
    """As D14 prints it: two targets have twice N particles; the other reading has N in all."""
    rng = np.random.default_rng(2)
    for name, count in (("SMC PHD", 400), (IN_ALL, 200)):
        stages = stages_of(CorridorRun("corridor", name, 200, 1.0, 0))
        place = np.array([[100.0, 250], [100, 200], [0, 0], [0, 0]])
        near = np.repeat(place, 100, axis=1)
        state, _ = stages.filter.step(
            Particles(near, np.full(200, 0.01)), place[:2], stages.model, 1.0, rng
        )
        assert len(state) == count


def test_the_papers_tables_have_96_cells():
    cells = [
        value
        for of in d14_printed.PRINTED.values()
        for mcmc, _, phd, _ in of.values()
        for value in (*mcmc, *phd)
    ]
    assert len(cells) == 96
    assert (min(cells), max(cells)) == (0.002, 1.28)
    assert set(d14_printed.PRINTED) == set(VARIANCES)
    assert {number for of in d14_printed.PRINTED.values() for number in of} == set(d14.NUMBERS)


def made_up(of_phd: Sequence[float]) -> dict[CorridorRun, RunErrors]:
    """Runs of as many seeds: the chains' mean squares double with σ²; the PHD filter's are theirs,
    times a factor for each seed, and fall with N.
    """
    results = {}
    for variance in VARIANCES:
        for number in d14.NUMBERS:
            for name in FILTERS:
                for seed, factor in enumerate(of_phd):
                    root = np.sqrt(np.array([0.24, 0.28, 0.52, 0.6]) * variance)
                    if name == "SMC PHD":
                        root = root * 10 / np.sqrt(number) * factor
                    run = RunErrors(root, root, np.ones(4), 1.0, 1.0, 1.0, 1.0, 0.0, 1.0)
                    results[CorridorRun("corridor", name, number, variance, seed)] = run
    return results


def test_claims_of_d14_for_made_up_errors():
    """The PHD filter's error falls and is below the chain's, which doubles with σ²."""
    claims = d14_printed.claims(made_up([0.9]), d14.NUMBERS, 1)
    verdict = {(one.claim, one.form): one.verdict for one in claims}
    assert set(verdict.values()) == {"holds on all 12", "holds on all 3", "holds on all 4"} | {
        "holds on none of 4"
    }
    assert verdict["SMC PHD takes less time than MCMC", WORDS] == "holds on none of 4"
    first = claims[0]
    assert first.printed == "in 43 of 48 cells"
    assert first.ours == "in 48 of 48 cells; 1 seed"


def test_claims_of_d14_have_errors_from_three_seeds_on():
    """At N = 100 the PHD filter is better with one seed, and worse with two, but less."""
    claims = d14_printed.claims(made_up([0.5, 1.02, 1.02]), d14.NUMBERS, 3)
    order = claims[0]
    assert order.ours == "in 48 of 48 cells"
    assert order.where["σ² = 1, N = 100"] is None
    assert order.where["σ² = 1, N = 4000"] is True


def test_intervals_are_promised_only_if_there_are_seeds_for_them() -> None:
    values = np.array([1.0, 1.2])
    for seeds in (1, 2):
        words = d14.error_words(seeds)
        assert ("±" in words["errors"]) == ("±" in d14.spread(values[:seeds]))
        assert ("95 %" in words["bars"]) == (seeds > 1)
