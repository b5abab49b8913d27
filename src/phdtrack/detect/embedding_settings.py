"""Settings of networks that describe the appearance of boxes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from phdtrack.errors import Checked, Count, InputError, PositiveCount, did_you_mean

_TYPE_NAMES = {tuple: "a list of numbers", bool: "true or false", int: "a whole number"}


@dataclass(frozen=True, slots=True)
class EmbeddingSettings(Checked):
    """Settings of a network that describes what boxes look like.

    Parameters
    ----------
    mean, deviation : of red, green and blue in shares of 255, which crops are normalised with;
        empty: as the file's metadata state, or those of ImageNet.
    bgr : the network takes blue before red.
    size : width and height of a crop in pixels, if the network takes any; (0, 0): 128x256.
    batch : crops in one call, if the network accepts several.
    threads : of the network; 0: all cores.
    """

    mean: tuple[float, ...] = ()
    deviation: tuple[float, ...] = ()
    bgr: bool = False
    size: tuple[int, int] = (0, 0)
    batch: PositiveCount = 32
    threads: Count = 0

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        for name, values in (("mean", self.mean), ("deviation", self.deviation)):
            if len(values) not in (0, 3) or not all(map(_is_number, values)):
                raise InputError(
                    f"expected three numbers, for red, green and blue, got {values}",
                    where=f"embedding.{name}",
                )
        if len(self.size) != 2 or not all(type(side) is int and side >= 0 for side in self.size):
            raise InputError(
                f"expected a width and height in pixels, got {self.size}", where="embedding.size"
            )
        if self.deviation and min(self.deviation) <= 0:
            raise InputError(
                f"expected deviations above 0, got {self.deviation}", where="embedding.deviation"
            )

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> EmbeddingSettings:
        """The settings with these values by name, lists as tuples. Raises `InputError` for an
        unknown name, and for a value of another type or out of bounds.
        """
        usual = {field.name: field.default for field in fields(cls)}
        made = dict[str, Any]()
        for name, value in values.items():
            if name not in usual:
                problem = f"unknown setting of [embedding]: {name}"
                raise InputError(problem, where="embedding", cure=did_you_mean(name, usual))
            made[name] = tuple(value) if isinstance(value, list) else value
            if type(made[name]) is not type(usual[name]):
                expected = _TYPE_NAMES[type(usual[name])]
                raise InputError(f"expected {expected}, got {value!r}", where=f"embedding.{name}")
        return cls(**made)


def _is_number(value: object) -> bool:
    """True for a finite number."""
    return isinstance(value, int | float) and math.isfinite(value)
