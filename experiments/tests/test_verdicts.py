"""Verdicts on claims that consist of several."""

from __future__ import annotations

import pytest

from experiments.verdicts import all_hold, most_hold, with_seeds


@pytest.mark.parametrize(
    ("each", "all_", "most"),
    [
        ([True, True, True, True], True, True),
        ([True, True, True, None], None, True),
        ([True, True, True, False], False, True),
        ([True, True, None, None], None, None),
        ([True, True, False, False], False, False),
        ([True, None, False, None], False, None),
    ],
)
def test_verdicts_on_several_cases_are_joined(
    each: list[bool | None], all_: bool | None, most: bool | None
) -> None:
    assert all_hold(each) is all_
    assert most_hold(each) is most


def test_few_seeds_are_named_beside_the_figures() -> None:
    words = [with_seeds("+0.20", seeds) for seeds in (0, 1, 2, 3)]
    assert words == ["+0.20", "+0.20; 1 seed", "+0.20; 2 seeds", "+0.20"]
