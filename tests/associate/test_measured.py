"""What associators remember of the measurements: all of them, in order, as far back as anything is remembered."""

from dataclasses import replace

import numpy as np
import pytest
from association_cases import matching_of, model_of, states

from phdtrack.associate.history import CHUNK
from phdtrack.associate.labels import Labelled

MODEL = model_of()


def remembered(matching, rng: np.random.Generator, frames: int, moving: bool = False):
    """The state after so many frames, and the measurements that they brought: of some, states rest on a part."""
    state, given = matching.start(), []
    for number in range(1, frames + 1):
        found = states(rng.uniform(50, 400, (int(rng.integers(0, 4)), 2)))
        found = replace(found, tag=np.arange(len(found)))
        z = np.hstack([found.state[list(MODEL.sensor.observed)], rng.uniform(10, 90, (4, int(rng.integers(0, 3))))])
        warp = np.eye(3) + np.array([[0, 0, number], [0, 0, 0], [0, 0, 0]]) * 0.1
        model = replace(MODEL, warp=warp) if moving and number > 1 else MODEL
        state, _ = matching.extend(state, found, z, 2 * number, 1.5, model)
        given.append((2 * number, z, warp if moving and number > 1 else np.eye(3)))
    return state, given


@pytest.mark.parametrize("matching", [matching_of(), Labelled()], ids=["graph", "labelled"])
@pytest.mark.parametrize("frames", [0, 1, 2 * CHUNK + 3])
@pytest.mark.parametrize("moving", [False, True])
def test_every_measurement_is_remembered(matching, frames: int, moving: bool, rng):
    state, given = remembered(matching, rng, frames, moving)
    measured = matching.measurements(state)
    assert measured.number.tolist() == [number for number, _, _ in given]
    np.testing.assert_allclose(np.diff(measured.time), 1.5)
    assert len(measured.start) == frames + 1
    for place, (_, z, warp) in enumerate(given):
        np.testing.assert_array_equal(measured.z[:, measured.start[place] : measured.start[place + 1]], z)
        if len(measured.warp):
            np.testing.assert_array_equal(measured.warp[place], warp)
    assert len(measured.warp) == (frames if moving and frames > 1 else 0)


@pytest.mark.parametrize("matching", [matching_of(history=0.5), Labelled(history=0.5)], ids=["graph", "labelled"])
def test_what_is_forgotten_is_measured_no_more(matching, rng):
    frames = 6 * CHUNK
    state, given = remembered(matching, rng, frames)
    measured = matching.measurements(state)
    assert CHUNK <= len(measured.number) < frames
    kept = given[-len(measured.number) :]
    assert measured.number.tolist() == [number for number, _, _ in kept]
    np.testing.assert_array_equal(measured.z, np.hstack([z for _, z, _ in kept]))
