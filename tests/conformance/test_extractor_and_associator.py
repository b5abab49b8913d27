"""What every extractor and every associator must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped import (
    ASSOCIATORS,
    EXTRACTORS,
    SENSORS,
    check_estimates,
    detections,
    fixed,
    frozen,
    intensity_for,
    keeps,
    model_of,
    states,
)

from phdtrack.filters import Raw
from phdtrack.protocols import Associator, Extractor
from phdtrack.types import Detections, Particles, Tracks

extractors = pytest.mark.parametrize("extractor", EXTRACTORS.values(), ids=EXTRACTORS)
associators = pytest.mark.parametrize("associator", ASSOCIATORS.values(), ids=ASSOCIATORS)


@extractors
@pytest.mark.parametrize("scaling", ["particle", "detection", "fixed", "given"])
@pytest.mark.parametrize("seed", range(3))
def test_states_of_an_intensity(extractor, scaling: str, seed: int):
    keeps(Extractor, extractor)
    rng = np.random.default_rng(seed)
    model = model_of(SENSORS[scaling])
    z = fixed(model.sensor.measure(detections(rng, 4)))
    seen, _ = model.sensor.states(z)
    unseen = states(rng, 2, model.motion.dim)
    intensity = frozen(intensity_for(extractor, np.hstack([seen[:, :3], unseen]), 150, rng))
    first, second = (extractor.extract(intensity, z, model) for _ in range(2))
    check_estimates(first, model.motion.dim, 4)
    np.testing.assert_array_equal(first.state, second.state)
    np.testing.assert_allclose(first.xyxy, model.sensor.boxes(first.state))
    assert len(first) >= 3


@extractors
def test_nothing_is_in_an_empty_intensity(extractor, rng):
    model = model_of()
    found = extractor.extract(
        intensity_for(extractor, np.zeros((6, 0)), 1, rng), np.zeros((4, 0)), model
    )
    check_estimates(found, 6, 0)
    assert len(found) == 0


@pytest.mark.parametrize("name", sorted({*EXTRACTORS} - {"raw"}))
def test_next_to_no_mass_is_no_state(name: str, rng):
    """Raw is left out: the detections are its states, whatever the intensity."""
    extractor = EXTRACTORS[name]
    model = model_of()
    z = model.sensor.measure(detections(rng, 3))
    seen, _ = model.sensor.states(z)
    assert (
        len(extractor.extract(intensity_for(extractor, seen, 100, rng, mass=0.05), z, model)) == 0
    )


def sequence(rng: np.random.Generator, count: int):
    """States and measurements of two targets that walk, with labels and misses, and of clutter, a
    new label each.
    """
    model = model_of()
    begin = states(rng, 2)
    velocity = rng.normal(0, 2, (2, 2))
    for k in range(count):
        here = begin.copy()
        here[:2] += k * velocity
        found = detections(rng, int(rng.integers(0, 2)))
        seen = np.flatnonzero(rng.random(2) < 0.9)
        boxes = np.vstack([model.sensor.boxes(here[:, seen]), found.xyxy])
        z = model.sensor.measure(type(found).of(boxes))
        raw = Raw().extract(Particles(np.zeros((6, 0)), np.zeros(0)), z, model)
        yield replace(raw, tag=np.concatenate([seen, 2 + k + np.arange(len(found))])), fixed(z)


def check_rows(tracks: Tracks) -> None:
    """What every set of rows must be."""
    n = len(tracks)
    for name in ("frame", "identity", "confidence", "detection", "confirmed"):
        assert getattr(tracks, name).shape == (n,)
    assert tracks.xyxy.shape == (n, 4)
    assert np.isfinite(tracks.xyxy).all()
    assert (tracks.identity >= 1).all()
    assert (tracks.detection >= -1).all()
    assert ((tracks.confidence >= 0) & (tracks.confidence <= 1)).all()
    np.testing.assert_array_equal(np.lexsort((tracks.identity, tracks.frame)), np.arange(n))
    assert len({*zip(tracks.frame.tolist(), tracks.identity.tolist(), strict=True)}) == n


@associators
@pytest.mark.parametrize("seed", range(4))
def test_rows_of_a_sequence(associator, seed: int):
    keeps(Associator, associator)
    model = model_of()
    before = repr(associator)
    results = []
    for _ in range(2):
        state = associator.start()
        given = []
        for number, (estimates, z) in enumerate(sequence(np.random.default_rng(seed), 30), start=3):
            seen = Detections.of(np.zeros((z.shape[1], 4)))
            state, rows = associator.extend(state, frozen(estimates), z, seen, number, 1.0, model)
            check_rows(rows)
            assert len(set(rows.frame)) <= 1
            assert rows.frame.max(initial=0) <= number
            given.append(rows)
        online = Tracks.concatenate([*given, associator.flush(state, model)])
        corrected = associator.finish(state, model)
        check_rows(online)
        check_rows(corrected)
        assert set(corrected.frame) <= set(range(3, 33))
        assert corrected.confirmed.all()
        results.append((online, corrected))
    assert repr(associator) == before
    for a, b in zip(*results, strict=True):
        np.testing.assert_array_equal(a.xyxy, b.xyxy)
        np.testing.assert_array_equal(a.identity, b.identity)
