"""The matching that grows row by row: as good as solving anew, with a certificate that says so."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inner_kernels import from_python
from phdtrack.kernels.matching import insert_rows
from reference import kernel_twins as twins

[insert_rows] = from_python(insert_rows)

Edges = dict[tuple[int, int], float]


def random_edges(rng: np.random.Generator, rows: int, columns: int, share: float, whole: bool) -> Edges:
    edges = {}
    for r in range(rows):
        for c in range(columns):
            if rng.random() < share:
                edges[r, c] = float(rng.integers(-2, 5)) if whole else float(rng.normal(1, 2))
    return edges


def part(edges: Edges, low: int, high: int, base: int):
    """The edges of rows ``low`` … ``high`` − 1 as compressed rows, columns numbered from ``base``."""
    order = sorted(e for e in edges if low <= e[0] < high)
    start = np.searchsorted([r for r, _ in order], np.arange(low, high + 1)).astype(np.int64)
    return start, np.array([c + base for _, c in order], np.int64), np.array([edges[e] for e in order])


def inserted(first: int, base: tuple[int, int], older, recent, *matching):
    """The matching with the rows from ``first`` on: column_of, row_of, worth, u, v."""
    result = tuple(a.copy() for a in matching)
    size = len(result[1])
    work = np.zeros(size, np.uint8), np.empty(size), np.empty(size, np.int64), np.empty(size), np.empty(size, np.int64)
    insert_rows(first, *base, *older, *recent, *result, *work)
    assert not work[0].any()
    return result


def solve(rows: int, columns: int, edges: Edges, batches: list[int], base: tuple[int, int] = (0, 0)):
    """Insert the rows in batches that end before the given rows; each call sees the rows inserted so far.

    The edges of the last batch come in the second part; rows and columns are numbered from ``base``.
    """
    row_of, v = np.full(columns, -1, np.int64), np.zeros(columns)
    column_of, worth, u, first = np.zeros(0, np.int64), np.zeros(0), np.zeros(0), 0
    for last in [*batches, rows]:
        column_of = np.append(column_of, np.full(last - first, -1, np.int64))
        worth, u = np.append(worth, np.zeros(last - first)), np.append(u, np.zeros(last - first))
        older, recent = part(edges, 0, first, base[1]), part(edges, first, last, base[1])
        before = [a.copy() for a in (*older, *recent)]
        column_of, row_of, worth, u, v = inserted(first, base, older, recent, column_of, row_of, worth, u, v)
        for was, now in zip(before, (*older, *recent), strict=True):
            np.testing.assert_array_equal(was, now)
        first = last
        plain_column, plain_row = column_of - base[1] * (column_of >= 0), row_of - base[0] * (row_of >= 0)
        certify({e: g for e, g in edges.items() if e[0] < last}, plain_column, plain_row, u, v)
        assert worth.tolist() == [edges[r, c] if c >= 0 else 0.0 for r, c in enumerate(plain_column.tolist())]
    return plain_column, plain_row, u, v


def total(edges: Edges, column_of) -> float:
    return sum(edges[r, int(c)] for r, c in enumerate(column_of) if c >= 0)


def certify(edges: Edges, column_of, row_of, u, v) -> None:
    """Matching and duals are feasible and of equal value: nothing better exists."""
    for r, c in enumerate(column_of):
        assert c < 0 or row_of[c] == r
    for c, r in enumerate(row_of):
        assert r < 0 or column_of[r] == c
    for (r, c), gain in edges.items():
        assert u[r] + v[c] <= -gain + 1e-9
    assert np.all(u <= 1e-9)
    assert np.all(v <= 1e-9)
    np.testing.assert_allclose(u[column_of < 0], 0, atol=1e-9)
    np.testing.assert_allclose(v[row_of < 0], 0, atol=1e-9)
    assert -u.sum() - v.sum() == pytest.approx(total(edges, column_of), abs=1e-9)


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 9),
    st.integers(0, 9),
    st.sampled_from([0.15, 0.5, 1.0]),
    st.booleans(),
    st.lists(st.integers(0, 9), max_size=3),
    st.tuples(st.integers(0, 99), st.integers(0, 99)),
)
@settings(max_examples=150, deadline=None)
def test_total_gain_is_the_maximum(
    seed: int, rows: int, columns: int, share: float, whole: bool, cuts: list[int], base: tuple[int, int]
):
    edges = random_edges(np.random.default_rng(seed), rows, columns, share, whole)
    column_of, *_ = solve(rows, columns, edges, sorted(min(c, rows) for c in cuts), base)
    assert total(edges, column_of) == pytest.approx(twins.best_matching(rows, columns, edges), abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_larger_and_one_row_at_a_time(seed: int):
    edges = random_edges(np.random.default_rng(seed), 40, 35, 0.12, whole=seed % 2 == 0)
    column_of, *_ = solve(40, 35, edges, list(range(1, 40)))
    assert total(edges, column_of) == pytest.approx(twins.best_matching(40, 35, edges), abs=1e-9)


def test_a_later_row_takes_the_column_of_an_earlier_one():
    edges = {(0, 0): 2.0, (1, 0): 5.0}
    column_of, row_of, *_ = solve(2, 1, edges, [1])
    assert list(column_of) == [-1, 0]
    assert list(row_of) == [1]


def test_a_later_row_pushes_an_earlier_one_to_its_second_choice():
    edges = {(0, 0): 3.0, (0, 1): 2.5, (1, 0): 3.0}
    column_of, *_ = solve(2, 2, edges, [1])
    assert list(column_of) == [1, 0]


def test_edges_that_lose_are_not_taken():
    column_of, *_ = solve(2, 2, {(0, 0): -1.0, (1, 1): -0.5}, [])
    assert list(column_of) == [-1, -1]


def test_columns_may_be_added_between_calls():
    """The window grows: new states bring rows and columns; old duals stay valid."""
    edges = {(0, 0): 1.0, (1, 0): 2.0, (1, 1): 4.0}
    none = part({}, 0, 0, 0)
    nobody, zero = np.array([-1]), np.zeros(1)
    column_of, row_of, worth, u, v = inserted(0, (0, 0), none, part(edges, 0, 1, 0), nobody, nobody, zero, zero, zero)
    column_of, row_of, worth, u, v = inserted(
        1,
        (0, 0),
        part(edges, 0, 2, 0),
        none,
        np.append(column_of, -1),
        np.append(row_of, -1),
        np.append(worth, 0.0),
        np.append(u, 0.0),
        np.append(v, 0.0),
    )
    certify(edges, column_of, row_of, u, v)
    assert list(column_of) == [0, 1]
    assert list(worth) == [1.0, 4.0]


def test_closed_columns_and_those_before_the_first_are_no_ends():
    """Columns are numbered from 10; the row's edges lead to 8 (gone), 10 (closed), 11 and 12."""
    edges = (np.array([0, 4]), np.array([8, 10, 11, 12]), np.array([9.0, 8.0, 1.0, 2.0]))
    one = np.zeros(1)
    column_of, row_of, worth, _, _ = inserted(
        0, (20, 10), part({}, 0, 0, 0), edges, np.array([-1]), np.array([-2, -1, -1]), one, one, np.zeros(3)
    )
    assert list(column_of) == [12]
    assert list(row_of) == [-2, -1, 20]
    assert list(worth) == [2.0]
