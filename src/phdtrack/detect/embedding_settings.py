"""Settings of networks that describe what boxes look like. Light: the configuration imports it."""

from __future__ import annotations

from dataclasses import dataclass

from phdtrack.errors import Checked, Count, InputError, PositiveCount


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
            if len(values) not in (0, 3):
                raise InputError(
                    f"expected three numbers, for red, green and blue, got {len(values)}",
                    where=f"embedding.{name}",
                )
        if min(self.size) < 0:
            raise InputError(
                f"expected a width and height in pixels, got {self.size}", where="embedding.size"
            )
        if self.deviation and min(self.deviation) <= 0:
            raise InputError(
                f"expected deviations above 0, got {self.deviation}", where="embedding.deviation"
            )
