"""What `phdtrack groups` reads beside a run's inputs: edges of roads, and how fast known positions follow each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phdtrack.errors import InputError
from phdtrack.files import load
from phdtrack.formats.positions import Positions
from phdtrack.types import F8

# Who moves less, metres and metres per second, tells little about time.
_STIRS, _WALKS = 0.05, 0.1
# How far the middle half of the estimates may be from the median before they are not believed.
_SPREAD = 0.3


def read_edges(path: Path) -> tuple[F8, ...]:
    """Lines (2, K) in metres: a point ``x y`` or ``x,y`` on each line of text, an empty line between one edge and the next.

    Raises
    ------
    InputError : the file is missing, or a line is not two finite numbers.
    """
    text = load(path).decode("utf-8-sig", errors="replace")
    edges: list[list[tuple[float, float]]] = [[]]
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            edges.append([])
            continue
        try:
            x, y = (float(word) for word in words)
        except ValueError:
            x = y = np.nan
        if not np.isfinite(x + y):
            raise InputError(
                f"expected a point of an edge, x and y in metres, came '{line.strip()[:40]}'", where=f"{path}, line {number}"
            )
        edges[-1].append((x, y))
    return tuple(np.array(edge).T for edge in edges if len(edge) > 1)


def rate_of(positions: Positions, path: Path) -> float:
    """Frames per second, from how far people come between two frames and how fast they go.

    Raises
    ------
    InputError : nobody moves, or ways and velocities do not fit each other.
    """
    order = np.lexsort((positions.frame, positions.identity))
    who, frame, state = positions.identity[order], positions.frame[order], positions.state[:, order]
    same = who[1:] == who[:-1]
    frames = np.diff(frame)[same].astype(np.float64)
    way = np.hypot(*np.diff(state[:2])[:, same])
    speed = np.hypot(*((state[2:, 1:] + state[2:, :-1]) / 2)[:, same])
    moving = (way > _STIRS) & (speed > _WALKS)
    cure = "Say --fps F, the rate of the video that the frames are numbered in."
    if not moving.any():
        raise InputError("the rate of the frames is not known, and nobody moves who could tell it", where=path, cure=cure)
    low, rate, high = np.quantile(frames[moving] * speed[moving] / way[moving], [0.25, 0.5, 0.75]).tolist()
    if high - low > _SPREAD * rate:
        raise InputError(
            f"the rate of the frames is not known; from ways and velocities it is anything from {low:.3g} to {high:.3g} per "
            "second",
            where=path,
            cure=cure,
        )
    return float(rate)
