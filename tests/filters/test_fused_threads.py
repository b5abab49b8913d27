"""Any number of threads gives the same bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fused_cases import check, identical, level, model_of, same_info, seen_by

from phdtrack.filters import ParticlePHD
from phdtrack.filters.threads import in_ranges
from phdtrack.models import BoxMotion, MeasurementBirth


@pytest.mark.parametrize("scaling", ["particle", "detection"])
def test_any_number_of_threads_gives_the_same_bits(scaling: str):
    """Seventy targets, ninety detections, some scans empty: every sweep is divided."""
    rng = np.random.default_rng(3)
    first = level(rng, 70, 300, width=4000.0)
    scans = [seen_by(rng, first, n, 0.05) for n in (90, 90, 0, 60)]
    model = model_of(BoxMotion(), MeasurementBirth(25 * 0.05, 100, "local"), scaling=scaling)
    assert len(first.start) > 70
    results = {}
    for threads in (1, 2, 3, 8, 0):
        recursion, own, state, infos = ParticlePHD(300, threads=threads), np.random.default_rng(5), first, []
        for z in scans:
            state, info = recursion.step(state, z, model, 1.5, own)
            check(state)
            infos.append(info)
        results[threads] = state, infos
    assert len(first) > 20_000
    assert len(results[1][0]) > 3_000
    for state, infos in results.values():
        identical(state, results[1][0])
        for a, b in zip(infos, results[1][1], strict=True):
            same_info(a, b)


@pytest.mark.parametrize("threads", [0, 1, 2, 3, 8])
@pytest.mark.parametrize("count", [0, 1, 2, 5, 16, 97, 1000])
def test_ranges_cover_the_work_in_order(count: int, threads: int):
    parts = in_ranges(lambda lo, hi: list(range(lo, hi)), count, threads)
    assert [i for part in parts for i in part] == list(range(count))


def test_an_error_in_a_thread_is_raised():
    def fail(lo: int, hi: int) -> None:
        raise ZeroDivisionError(lo)

    with pytest.raises(ZeroDivisionError):
        in_ranges(fail, 100, 2)


def test_settings_do_not_depend_on_threads():
    assert replace(ParticlePHD(), threads=4) == ParticlePHD(threads=4)
    assert ParticlePHD().threads == 1
