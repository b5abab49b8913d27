"""Births learned from where tracks began."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from phdtrack.errors import InputError
from phdtrack.models.learned_births import fit, read_births, write_births

PLACES = np.array([[-8.0, 6, 1, 0], [-10, -15, 0, 1], [15, -8, -1, 0]])


def first_states(rng, counts=(60, 40, 20)) -> np.ndarray:
    parts = [rng.multivariate_normal(place, np.diag([1, 0.5, 0.2, 0.2]), n) for place, n in zip(PLACES, counts, strict=True)]
    return np.vstack(parts).T.copy()


def test_places_are_found_with_their_rates(rng):
    mixture = fit(first_states(rng), 240.0, rng)
    assert len(mixture) == 3
    assert mixture.mass == pytest.approx(120 / 240)
    order = np.argsort(-mixture.weight)
    np.testing.assert_allclose(mixture.weight[order], np.array([60, 40, 20]) / 240, rtol=1e-3)
    np.testing.assert_allclose(mixture.mean[:, order].T, PLACES, atol=0.6)


def test_one_place_is_not_divided(rng):
    states = rng.multivariate_normal(PLACES[0], np.eye(4), 150).T.copy()
    assert len(fit(states, 100.0, rng)) == 1


def test_it_explains_new_tracks_better_than_one_gaussian(rng):
    states, fresh = first_states(rng), first_states(rng)
    mixture = fit(states, 120.0, rng)
    parts = zip(mixture.weight, mixture.mean.T, mixture.covariance, strict=True)
    density = sum(w * multivariate_normal.pdf(fresh.T, m, c) for w, m, c in parts)
    single = multivariate_normal.logpdf(fresh.T, states.mean(1), np.cov(states)).sum()
    assert np.log(density).sum() > single + 50


@pytest.mark.parametrize("states", [np.ones((4, 7)), np.array([[1.0, 2], [1, 2], [0, 0], [0, 0]])], ids=["same", "two"])
def test_few_tracks_and_equal_ones_still_give_a_density(states, rng):
    mixture = fit(states, 10.0, rng)
    assert mixture.mass == pytest.approx(states.shape[1] / 10)
    assert np.linalg.eigvalsh(mixture.covariance).min() > 0


def test_the_same_seed_fits_the_same():
    states = first_states(np.random.default_rng(3))
    a, b = (fit(states, 9.0, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(a.covariance, b.covariance)


@pytest.mark.parametrize(
    ("states", "time"), [(np.ones((4, 1)), 1.0), (np.ones((4, 5)), 0.0), (np.full((4, 5), np.nan), 1.0)]
)
def test_what_nothing_can_be_learned_from(states, time, rng):
    with pytest.raises(InputError, match="two or more"):
        fit(states, time, rng)


def test_a_file_keeps_it(rng, tmp_path):
    mixture = fit(first_states(rng), 60.0, rng)
    write_births(tmp_path / "births.json", mixture)
    again = read_births(tmp_path / "births.json")
    for name in ("weight", "mean", "covariance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(mixture, name))


@pytest.mark.parametrize("text", [
    "[]", "{", '{"weight": [1]}', '{"weight": [1], "mean": [[1, 2]], "covariance": [[[1, 0], [0, -1]]]}',
    json.dumps({"weight": [1, 2], "mean": [[1, 2]], "covariance": [[[1, 0], [0, 1]]]}),
    json.dumps({"weight": [-1], "mean": [[1, 2]], "covariance": [[[1, 0], [0, 1]]]}),
])  # fmt: skip
def test_files_that_hold_no_mixture(text: str, tmp_path):
    path = tmp_path / "births.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"births\.json"):
        read_births(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_births(tmp_path / "none.json")
