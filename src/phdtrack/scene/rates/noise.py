"""How exactly boxes are measured and how unsteadily objects move, from five detections of a track in a row.

In units of its own size a box that is measured with deviation s of width and height (s/2 of the centre) and moves as
`models.box_motion` has it, with acceleration a and change of size b, differs from frame to frame so: of ln w, of the first
differences d, and of the centre, of the second differences u (T time units between frames; q₁₁, q₁₂: of the covariance of f
for a = 1)

    E d² = 2 s² + b² T    E d d′ = −s²
    E u² = 6 s²/4 + 2 a² q₁₁    E u u′ = −4 s²/4 + a² (T q₁₂ − q₁₁)    E u u″ = s²/4

with ′ for the next and ″ for the one after. So noise that is new in every frame is told from motion by what the next
differences have of it. The moments are means over the newest detections without the most extreme ones, about those that the
settings give, and s, a, b what fits them best.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.scene.verdict import Look
from phdtrack.types import F8, Tracks

# Detections in a row, and how many such series are learned from; what the settings are worth of them.
ROW, NEWEST, SERIES = 5, 2000, 50.0
# Share of the series that is left out, as it holds wrong links.
EXTREME = 0.02
# Limits as multiples of the settings.
LIMIT = 10.0


@dataclass(frozen=True, slots=True)
class Noise:
    """``spread`` s of measured sizes, ``acceleration`` a, ``resize`` b, as shares of the size; 0 where there are none."""

    spread: float = 0.0
    acceleration: float = 0.0
    resize: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Products (5, n) of each series, d², d d′, u², u u′, u u″, means over both axes; the interval T (n,) of its frames."""

    products: F8 = field(default_factory=lambda: np.zeros((5, 0)))
    interval: F8 = field(default_factory=lambda: np.zeros(0))

    def joined(self, looks: tuple[Look, ...], due: int, rate: float) -> Moments:
        """With the series of confirmed tracks that begin in the first ``due`` frames; ``rate`` time units a second."""
        box, time = _series(looks, due)
        size = box[:, :, 2:].mean(axis=1, keepdims=True)
        d = np.diff(np.log(box[:, :, 2:]), axis=1)
        u = np.diff(box[:, :, :2] / size, n=2, axis=1)
        pairs = (d[:, 0] * d[:, 0], d[:, 0] * d[:, 1], u[:, 0] * u[:, 0], u[:, 0] * u[:, 1], u[:, 0] * u[:, 2])
        products = np.stack([pair.mean(axis=1) for pair in pairs])
        interval = (time[:, -1] - time[:, 0]) * rate / (ROW - 1)
        return Moments(
            np.hstack([self.products, products])[:, -NEWEST:], np.concatenate([self.interval, interval])[-NEWEST:]
        )

    def noise(self, settings: Noise) -> Noise:
        """What fits best; the settings where there is nothing to fit."""
        n = len(self.interval)
        if n == 0 or settings.spread <= 0:
            return settings
        extent = self.products[0] + self.products[2]
        kept = extent <= np.quantile(extent, 1 - EXTREME)
        table = _table(float(self.interval[kept].mean()))
        begun = np.square([settings.spread, settings.acceleration, settings.resize])
        many = float(np.count_nonzero(kept))
        moments = (SERIES * (table @ begun) + many * self.products[:, kept].mean(axis=1)) / (SERIES + many)
        fitted = np.linalg.lstsq(table, moments, rcond=None)[0]
        roots = np.sqrt(np.clip(fitted, begun / LIMIT**2, begun * LIMIT**2))
        return Noise(float(roots[0]), float(roots[1]), float(roots[2]))


def _table(interval: float) -> F8:
    """(5, 3) the moments of s², a², b² = 1."""
    t = interval
    position, both = t**3 / 3 - min(t, t**3) / 12, t**2 / 2
    return np.array(
        [[2, 0, t], [-1, 0, 0], [1.5, 2 * position, 0], [-1, t * both - position, 0], [0.25, 0, 0]], dtype=np.float64
    )


def _series(looks: tuple[Look, ...], due: int) -> tuple[F8, F8]:
    """(n, 5, 4) centres and sizes of detections in successive looks of one track, and their times (n, 5)."""
    number, time = np.array([look.number for look in looks], np.int64), np.array([look.time for look in looks])
    rows = Tracks.concatenate([look.rows for look in looks])
    rows = rows.take((rows.detection >= 0) & rows.confirmed & np.isin(rows.frame, number))
    place = np.searchsorted(number, rows.frame)
    many = np.array([len(look.xyxy) for look in looks], np.int64)
    order = np.lexsort((place, rows.identity))
    place, identity = place[order], rows.identity[order]
    found = (np.cumsum(many) - many)[place] + rows.detection[order]
    first = np.arange(max(0, len(place) - ROW + 1))
    last = first + ROW - 1
    whole = (identity[first] == identity[last]) & (place[last] == place[first] + ROW - 1) & (place[first] < due)
    each = first[whole][:, None] + np.arange(ROW)
    everything = to_cxcywh(np.concatenate([np.zeros((0, 4)), *[look.xyxy for look in looks]])).T
    box = np.maximum(everything[found[each]], [-math.inf, -math.inf, 1e-3, 1e-3])
    return box, time[place[each]]
