"""Classes in formats that have words for them, and no numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable

# A class without a name is written as one of these words, and read as its number again.
_OBJECT = "object"
_NUMBERED = re.compile(r"class_([1-9]\d{0,8})")


def word_of_class(number: int) -> str:
    """The word that stands for a class without a name."""
    return f"class_{number}" if number else _OBJECT


def words_by_number(words: Iterable[str]) -> dict[int, str]:
    """Different words by the number that each class gets: its own if all are those of classes
    without names, else from 1 in alphabetical order.

    Parameters
    ----------
    words : the word of each row.
    """
    different = sorted(set(words))
    own = [_number_of(word) for word in different]
    if -1 in own:
        return dict(enumerate(different, start=1))
    return dict(zip(own, different, strict=True))


def _number_of(word: str) -> int:
    """The number of a class without a name; −1 for any other word."""
    if word == _OBJECT:
        return 0
    match = _NUMBERED.fullmatch(word)
    return int(match[1]) if match else -1
