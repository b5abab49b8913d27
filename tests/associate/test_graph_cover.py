"""The links are those of the path cover of maximum total gain [M07 §3]."""

import numpy as np
import pytest
from association_cases import (
    links,
    matching_of,
    measured,
    model_of,
    open_edges,
    run,
    scattered,
    states,
    walkers,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.associate.history import open_links
from reference import graph_twin as twin

seeds = st.integers(0, 2**32 - 1)


def total(state, edges) -> float:
    """The gain of a state's links; a link that is no edge fails."""
    return sum(edges[link] for link in links(state))


def is_cover(pairs) -> bool:
    later = [b for b, _ in pairs]
    earlier = [a for _, a in pairs]
    return (
        len(set(later)) == len(later)
        and len(set(earlier)) == len(earlier)
        and all(a < b for b, a in pairs)
    )


@given(seeds, st.integers(2, 4), st.floats(0.05, 1.0), st.floats(1.5, 6.0))
@settings(max_examples=40, deadline=None)
def test_total_gain_is_that_of_the_best_of_all_covers(
    seed: int, count: int, miss: float, gate: float
):
    frames = scattered(np.random.default_rng(seed), count, 3)
    matching = matching_of(miss=miss, loose_end_distance=gate)
    edges = twin.gains(frames, [1.0] * count, matching, model_of())
    last = run(matching, frames).states[-1]
    assert is_cover(links(last))
    assert total(last, edges) == pytest.approx(twin.best_cover(edges), abs=1e-9)


@given(seeds, st.lists(st.floats(0.2, 3.0), min_size=12, max_size=12))
@settings(max_examples=15, deadline=None)
def test_window_matching_is_optimal_after_every_frame(seed: int, intervals: list[float]):
    frames = scattered(np.random.default_rng(seed), 12, 4, side=120)
    matching = matching_of(window=100.0)
    model = model_of()
    edges = twin.gains(frames, intervals, matching, model)
    first = np.cumsum([len(f) for f in frames])
    for state, end in zip(run(matching, frames, model, intervals).states, first, strict=True):
        known = {(b, a): gain for (b, a), gain in edges.items() if b < end}
        assert is_cover(links(state))
        assert total(state, known) == pytest.approx(twin.best_assignment(known), abs=1e-8)


def test_open_part_is_optimal_after_links_are_closed():
    frames, _ = walkers(np.random.default_rng(4), 80, clutter=3.0)
    for state in run(matching_of(window=0.3), frames).states:
        edges = open_edges(state.window)
        taken = open_links(state.window)
        chosen = list(zip(taken.later.tolist(), taken.earlier.tolist(), strict=True))
        assert sum(edges[link] for link in chosen) == pytest.approx(
            twin.best_assignment(edges), abs=1e-8
        )
        assert taken.gain.tolist() == [edges[link] for link in chosen]
        onward = np.flatnonzero(state.window.next >= 0)
        assert {(int(state.window.next[s]), int(s) + state.window.column) for s in onward} == set(
            chosen
        )


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_edges_are_all_that_are_worth_taking(seed: int):
    """The search by position leaves none out, and gains are the formula's."""
    rng = np.random.default_rng(seed)
    matching = matching_of()
    model = model_of()
    past = scattered(rng, 3, 4, side=200)
    last = run(matching, past).states[-1]
    new = states(100 + rng.uniform(0, 200, (5, 2)), velocity=rng.normal(0, 3, (5, 2)))
    after, _ = matching.extend(last, new, *measured(new), 4, 1.0, model)
    ours = {
        link: gain for link, gain in open_edges(after.window).items() if link[0] >= last.vertices
    }
    theirs = twin.gains([*past, new], [1.0] * 4, matching, model)
    theirs = {link: gain for link, gain in theirs.items() if link[0] >= last.vertices}
    assert ours == pytest.approx(theirs, abs=1e-9)
