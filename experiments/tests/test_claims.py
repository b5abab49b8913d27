"""Verdicts on claims, and the two forms in which they are shown."""

from __future__ import annotations

import math

import pytest

from experiments.claims import Claim, claims_table, claims_text, decided


def claim(**where: bool | None) -> Claim:
    return Claim("A above B", "+9 %", "word by word", "+3 %", where)


@pytest.mark.parametrize(
    ("where", "verdict"),
    [
        ({}, "not measured"),
        ({"a": True}, "holds"),
        ({"a": False}, "does not hold"),
        ({"a": True, "b": True}, "holds on all 2"),
        ({"a": False, "b": False}, "holds on none of 2"),
        ({"a": True, "b": False, "c": False}, "holds on 1 of 3: a"),
        ({"a": True, "b": False, "c": True}, "holds on 2 of 3, not on b"),
        (dict.fromkeys("abcde", True) | dict.fromkeys("vwxyz", False), "holds on 5 of 10"),
        ({"a": None}, "within its error"),
        ({"a": None, "b": None}, "within its error on all 2"),
        ({"a": True, "b": None}, "holds on 1 of 2 (a), within its error on 1 (b)"),
        (
            {"a": True, "b": False, "c": None},
            "holds on 1 of 3 (a), does not on 1 (b), within its error on 1 (c)",
        ),
        (
            dict.fromkeys("abcde", True) | {"v": None},
            "holds on 5 of 6, within its error on 1 (v)",
        ),
    ],
)
def test_the_verdict_says_where_a_claim_holds(where: dict[str, bool | None], verdict: str) -> None:
    assert claim(**where).verdict == verdict


@pytest.mark.parametrize(
    ("gaps", "holds"),
    [
        # Half the 95 % interval of five seeds is 2.78 standard errors.
        ([0.9, 1.0, 1.0, 1.0, 1.1], True),
        ([-0.9, -1.0, -1.0, -1.0, -1.1], False),
        ([-0.9, 1.0, 1.0, 1.0, -0.9], None),
        ([0.0] * 5, None),
        ([0.9, 1.0, 1.1], True),
        ([-0.9, 1.0, 1.0], None),
        # Too few for an error: the mean decides.
        ([-0.9, 1.0], True),
        ([-1.1, 1.0], False),
        ([0.01], True),
        ([-0.01], False),
        ([0.0], False),
        ([math.nan], False),
        ([math.nan, 1.0, 1.0], False),
        ([], False),
    ],
)
def test_a_difference_within_its_error_decides_nothing(
    gaps: list[float], holds: bool | None
) -> None:
    assert decided(gaps) is holds


def test_a_claim_in_two_forms_is_written_once() -> None:
    claims = [claim(a=True), claim(a=False)]
    lines = claims_table(claims).splitlines()
    assert lines[2] == "| A above B | +9 % | word by word | +3 % | **holds** |"
    assert lines[3] == "|  |  | word by word | +3 % | **does not hold** |"
    assert claims_text(claims) == (
        "A above B (printed: +9 %)\n"
        "    word by word  +3 %: holds\n"
        "    word by word  +3 %: does not hold"
    )
