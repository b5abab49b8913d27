"""Stages in threads: order, values and errors of the plain loop, a bounded number of items, nothing
left behind. Work beside a block: begun at once, its errors dropped.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Iterable, Iterator

import pytest

from phdtrack.run.pipeline_threads import ahead, beside

WAIT = 20.0


def doubled(items: Iterable[int]) -> Iterator[int]:
    for item in items:
        yield 2 * item


def failing(after: int, error: BaseException) -> Iterator[int]:
    yield from range(after)
    raise error


@pytest.mark.parametrize("depth", [1, 2, 7])
def test_the_same_items_in_the_same_order(depth: int) -> None:
    with ahead(range(500), depth) as numbers, ahead(doubled(numbers), depth) as twice:
        assert list(twice) == [2 * n for n in range(500)]
        assert list(twice) == []


def test_nothing_is_made_before_it_is_asked_for() -> None:
    made = list[int]()
    before = threading.active_count()
    with ahead(map(made.append, range(9))):
        time.sleep(0.05)
        assert made == []
    assert threading.active_count() == before
    with ahead(iter([7])) as numbers:
        assert next(numbers) == 7


@pytest.mark.parametrize("error", [ValueError("broken"), KeyboardInterrupt(), SystemExit(3)])
def test_an_error_comes_after_what_was_made_before_it(error: BaseException) -> None:
    got: list[int] = []
    with (
        ahead(failing(5, error)) as numbers,
        ahead(doubled(numbers)) as twice,
        pytest.raises(type(error)) as raised,
    ):
        got.extend(twice)
    assert raised.value is error
    assert got == [0, 2, 4, 6, 8]


def test_an_error_in_the_loop_ends_all_stages() -> None:
    closed: list[str] = []

    def endless() -> Iterator[int]:
        try:
            while True:
                yield 1
        finally:
            closed.append(threading.current_thread().name)

    def loop() -> None:
        with ahead(endless()) as ones, ahead(doubled(ones)) as twice:
            assert next(twice) == 2
            raise RuntimeError("mine")

    before = threading.active_count()
    with pytest.raises(RuntimeError, match="mine"):
        loop()
    # The file that a stage has open is closed, by the thread that used it, when the block has been
    # left.
    assert len(closed) == 1
    assert closed[0] != threading.main_thread().name
    assert threading.active_count() == before


def test_stages_really_overlap() -> None:
    """The first stage makes item 2 only after the loop has begun with item 1, and the loop waits
    for it there.
    """
    begun = threading.Event()
    made = threading.Event()

    def source() -> Iterator[int]:
        yield 1
        assert begun.wait(WAIT)
        made.set()
        yield 2

    with ahead(source()) as items:
        assert next(items) == 1
        begun.set()
        assert made.wait(WAIT)
        assert list(items) == [2]


def test_the_number_of_living_frames_is_bounded() -> None:
    living: weakref.WeakSet[Picture] = weakref.WeakSet()
    most = 0

    class Picture:
        def __init__(self) -> None:
            living.add(self)

    def frames() -> Iterator[Picture]:
        for _ in range(200):
            yield Picture()

    with ahead(frames(), 2) as pictures, ahead(((picture, 1) for picture in pictures), 2) as found:
        for _ in found:
            time.sleep(0.001)
            most = max(most, len(living))
    # Two under way on each of two belts, one held by each of the two takers, one being made by the
    # source.
    assert most <= 2 * 2 + 2 + 1


def test_work_beside_a_block_is_done_at_its_end() -> None:
    begun = threading.Event()
    done = list[str]()

    def work() -> None:
        begun.set()
        time.sleep(0.05)
        done.append(threading.current_thread().name)

    with beside(work):
        assert begun.wait(WAIT)
    assert done == ["phdtrack beside"]


def test_errors_beside_a_block_are_dropped() -> None:
    def work() -> None:
        raise ValueError("not needed yet")

    with beside(work):
        pass
    with pytest.raises(OSError, match="of the block"), beside(work):
        raise OSError("of the block")


def test_a_block_does_not_wait_for_work_that_hangs() -> None:
    go_on = threading.Event()
    began = time.monotonic()
    with beside(go_on.wait):
        pass
    assert time.monotonic() - began < WAIT / 2
    go_on.set()
