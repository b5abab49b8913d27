"""K-means on the islands of a cloud, several at a time; which threads do what does not change a bit of the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phdtrack.filters.extract.cloud import Cloud
from phdtrack.filters.threads import in_ranges
from phdtrack.kernels.islands import islands, united
from phdtrack.kernels.kmeans import kmeans
from phdtrack.types import F8, I8

I4 = NDArray[np.int32]

# A cluster reaches this many deviations of the measurement noise. Wide, because a target that was missed spreads.
REACH = 8.0
# So many blocks stay in a core's cache, and to part them would cost more than it saves.
FEW = 256


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where clusters start.

    Attributes
    ----------
    centre : (d, k), ``scale`` (d, k) deviations by which distances from them are measured.
    head, link, used : which of the first ``filed`` centres are near each block, as `kernels.clustering.outside` gives it.
    """

    centre: F8
    scale: F8
    head: I8
    link: I8
    used: int
    filed: int


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """Clusters of particles, in the order of their islands, and which of them each particle belongs to.

    Attributes
    ----------
    mass, mean, covariance : (k,), (d, k), (k, d, d) of the clusters; an empty one keeps its centre.
    block, own : clusters of whole blocks (B,) and of the particles of mixed ones (L,), as in `kernels.kmeans`: by their
        numbers on their island.
    count, island : clusters of each island (I,), and the island of each block (B,), −1 for none.
    """

    mass: F8
    mean: F8
    covariance: F8
    block: I4
    own: I4
    count: I8
    island: I8


@dataclass(frozen=True, slots=True, eq=False)
class _Islands:
    """The islands, as `kernels.islands.islands` gives them."""

    begin: I8
    centre: I8
    block: I8

    def __len__(self) -> int:
        return len(self.begin[0]) - 1


# Rows of clusters and those who have left their island, of the islands in a range; writes how many clusters each has.
_Settle = Callable[[_Islands, int, int, I8], tuple[F8, I8]]


def cluster(cloud: Cloud, start: Start, split: float, iterations: int) -> Clusters:
    """K-means from a start with k centres: those of clusters heavier than ``split`` are divided.

    A centre moves ``iterations`` times at most, and again after each division of its cluster. Distances are measured in the
    noise at the first centres; that changes little as the centres move, and asking the sensor in every iteration would cost
    as much as the iteration.
    """
    grid, d = (cloud.grid.lower, cloud.grid.upper, *cloud.grid.grid), len(cloud.state)
    link, *found = islands(start.head, start.link, start.used, start.filed, start.centre, start.scale, REACH, *grid, FEW)
    block, own = np.empty(len(cloud.known), np.int32), np.empty(cloud.state.shape[1], np.int32)

    def settle(on: _Islands, lo: int, hi: int, count: I8) -> tuple[F8, I8]:
        out: tuple[F8, I8] = kmeans(
            lo, hi, cloud.state, cloud.weight, cloud.start, cloud.known, cloud.second, *grid, start.centre, start.scale,
            REACH, split, iterations, cloud.mass, link, on.begin, on.centre, on.block, block, own, count, cloud.most,
        )  # fmt: skip
        return out

    rows, count, island = _settled(_Islands(*found), settle, cloud.threads)
    mean, covariance = rows[:, 1 : 1 + d].T.copy(), rows[:, 1 + d :].reshape(-1, d, d).copy()
    return Clusters(rows[:, 0].copy(), mean, covariance, block, own, count, island)


def _settled(on: _Islands, settle: _Settle, threads: int) -> tuple[F8, I8, I8]:
    """Rows of clusters, how many there are on each island, and the island of each block."""
    count = np.empty(len(on), np.int64)
    parts = in_ranges(lambda lo, hi: settle(on, lo, hi, count), len(on), threads)
    rows, escaped = parts[0]
    if len(parts) > 1:
        rows = np.concatenate([part[0] for part in parts])
        escaped = np.concatenate([part[1] for part in parts], axis=1)
    if escaped.shape[1] == 0:
        return rows, count, on.block[2]
    return _together(on, settle, rows, count, escaped)


def _together(on: _Islands, settle: _Settle, rows: F8, count: I8, escaped: I8) -> tuple[F8, I8, I8]:
    """As `_settled`, once centres have left their islands: these and those they have reached are settled again, as one.

    The one may reach others in turn.
    """
    drop, more = np.zeros(len(on), np.bool_), np.zeros(on.block.shape[1], np.bool_)
    again, many = on, np.zeros(1, np.int64)
    while escaped.shape[1] > 0:
        again = _Islands(*united(escaped, on.centre, on.block, drop, more))
        merged, escaped = settle(again, 0, 1, many)
        # Those that it has reached are reached from one of its parts.
        escaped = np.stack([np.full_like(escaped[1], drop.argmax()), escaped[1]])
    kept = np.repeat(~drop, count)
    count = np.append(np.where(drop, 0, count), many)
    return np.concatenate([rows[kept], merged]), count, np.where(again.block[2] == 0, len(on), on.block[2])
