"""Memory is used again only where nobody refers to it: states stay values."""

from __future__ import annotations

import gc
import threading

import numpy as np
import pytest
from fused_cases import NOTHING, identical, level, model_of, seen_by

from phdtrack.filters import ParticlePHD
from phdtrack.filters.memory import empty
from phdtrack.types import ParticleBlocks


def test_earlier_states_are_not_written_over():
    """Twenty frames, all states held, some of them by a view of one row only."""
    rng = np.random.default_rng(1)
    model, recursion, state = model_of(), ParticlePHD(300), level(rng, 4, 300)
    z = seen_by(rng, state, 4, 0.02)
    held, rows = [], []
    for k in range(20):
        state, _ = recursion.step(state, z, model, 1.0, rng)
        copy = ParticleBlocks(state.state.copy(), state.start.copy(), state.unit)
        if k % 3:
            held.append((state, copy))
        else:
            rows.append((state.state[2, ::3], copy.state[2, ::3]))
    for state, copy in held:
        identical(state, copy)
    for row, copy in rows:
        np.testing.assert_array_equal(row, copy)
    identical(NOTHING, ParticleBlocks.empty(6))


@pytest.mark.parametrize("hold", [
    lambda a: a, lambda a: a[3], lambda a: a.T, lambda a: a[:, ::7].view(np.int32), memoryview, lambda a: a.reshape(-1)[5:6]
])  # fmt: skip
def test_whatever_refers_to_an_array_keeps_its_memory(hold):
    array = empty(6, 5000)
    array[:] = 1.5
    kept = hold(array)
    before = np.array(kept).copy()
    del array
    gc.collect()
    others = [empty(6, 5000) for _ in range(8)]
    for other in others:
        other[:] = -3
    np.testing.assert_array_equal(np.array(kept), before)


def test_arrays_that_are_in_use_do_not_overlap():
    rng = np.random.default_rng(2)
    arrays = []
    for k in range(300):
        array = empty(6, int(rng.integers(0, 3000)))
        array[:] = k
        arrays.append((k, array))
        if len(arrays) > 6:
            arrays.pop(int(rng.integers(len(arrays))))
        for number, other in arrays:
            assert (other == number).all()
    assert array.flags.c_contiguous
    assert array.dtype == np.float32


def test_threads_do_not_get_the_same_memory():
    wrong = []

    def work(number: int) -> None:
        for _ in range(300):
            array = empty(6, 400)
            array[:] = number
            if not (array == number).all():
                wrong.append(number)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
