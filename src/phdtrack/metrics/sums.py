"""Counts that add up: what a sequence contributes to a score over many.

Every metric keeps sums, and forms quotients last. Pooling sequences is then adding their sums.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")


def total(parts: Sequence[T]) -> T:
    """The sum, field by field, of frozen dataclasses of one type whose fields can be added, or are such dataclasses."""
    first = parts[0]
    sums = {}
    for field in fields(first):
        values = [getattr(part, field.name) for part in parts]
        sums[field.name] = total(values) if hasattr(values[0], "__dataclass_fields__") else sum(values[1:], values[0])
    return type(first)(**sums)


def ratio(numerator: float, denominator: float) -> float:
    """The quotient; NaN where nothing was counted in the denominator."""
    return numerator / denominator if denominator else math.nan
