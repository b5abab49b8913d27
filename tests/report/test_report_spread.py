from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from phdtrack.report.record import EvenSample, evenly


@given(st.integers(1, 12), st.integers(0, 500))
def test_what_is_kept_is_bounded_even_and_enough(capacity: int, count: int) -> None:
    spread: EvenSample[int] = EvenSample(capacity)
    for index in range(1, count + 1):
        spread.put(index, index)
        assert len(spread.items) <= capacity
    assert len(spread.items) >= min(count, max(1, capacity // 2))
    assert len(set(np.diff((0, *spread.items)).tolist())) <= 1


@given(st.integers(1, 12), st.integers(1, 300))
def test_wants_tells_before_the_item_is_made_whether_it_is_kept(capacity: int, count: int) -> None:
    spread: EvenSample[int] = EvenSample(capacity)
    for index in range(1, count + 1):
        wanted = spread.wants(index)
        spread.put(index, index)
        if not wanted:
            assert index not in spread.items


@given(st.lists(st.integers(), max_size=30, unique=True), st.integers(0, 8))
def test_evenly_takes_in_order_and_ends_with_the_last(items: list[int], count: int) -> None:
    chosen = evenly(tuple(items), count)
    assert len(chosen) == min(len(items), count)
    places = [items.index(c) for c in chosen]
    assert places == sorted(set(places))
    if chosen:
        assert chosen[-1] == items[-1]
        gaps = np.diff([-1, *places])
        assert gaps.max() - gaps.min() <= 1
