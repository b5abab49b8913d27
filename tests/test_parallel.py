"""Work in processes: the same results as without, and whatever dies takes nothing along."""

from __future__ import annotations

import os
from dataclasses import dataclass

import pytest

from phdtrack.errors import InputError
from phdtrack.parallel import Failed, outcomes


@dataclass(frozen=True)
class Piece:
    """Gives the square of a number, or does not."""

    number: int
    way: str = ""

    def __call__(self) -> int:
        if self.way == "mistake":
            raise InputError("no such number", where="here", cure="Take another.")
        if self.way == "bug":
            raise ValueError("two\nlines")
        if self.way == "interrupt":
            # What Numba makes of Ctrl-C while a kernel runs.
            raise SystemError("returned a result with an exception set") from KeyboardInterrupt()
        if self.way == "death" and os.getpid() != PARENT:
            os._exit(9)
        return self.number**2


PARENT = int(os.environ.setdefault("PHDTRACK_TEST_PARENT", str(os.getpid())))


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_and_reasons_are_those_of_each_piece(jobs: int) -> None:
    work = [Piece(3), Piece(4, "mistake"), Piece(5, "bug"), Piece(6)]
    found = dict(outcomes(work, jobs))
    assert found == {
        0: 9,
        1: Failed("here: no such number. Take another."),
        2: Failed("ValueError: two"),
        3: 36,
    }


def test_a_process_that_dies_is_told_and_the_others_go_on() -> None:
    work = [
        Piece(1, "death"),
        *(Piece(number) for number in range(2, 6)),
        Piece(6, "death"),
        Piece(7),
    ]
    found = dict(outcomes(work, 2))
    assert sorted(found) == list(range(7))
    assert [found[number] for number in (1, 2, 3, 4, 6)] == [4, 9, 16, 25, 49]
    for number in (0, 5):
        reason = found[number]
        assert isinstance(reason, Failed)
        assert "its process died" in reason.reason


def test_ctrl_c_in_compiled_code_is_no_failed_run() -> None:
    found = outcomes([Piece(2), Piece(3, "interrupt"), Piece(4)], 1)
    assert next(found) == (0, 4)
    with pytest.raises(KeyboardInterrupt):
        next(found)
