"""The pictures of M09's experiment: what was learned where (Figs. 7, 8, 11), what it brings (14), the sweep (15)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phdtrack.compare.statistics import Interval
from phdtrack.context import ContextDensity
from phdtrack.context.maps import place_map
from phdtrack.reproduce.m09_lessons import Taught
from phdtrack.types import F8, Image

_RED, _GREEN = np.array([220.0, 30, 30]), np.array([20.0, 190, 60])
# By the square root a place a quarter as likely as the worst is still plain to see.
_OPAQUE = 0.85
Sweep = Mapping[tuple[float, float], float]


def maps(scenes: Mapping[str, tuple[Image, Taught]], path: Path) -> None:
    """Over a frame of each scene: false alarms, births of the tracker's own tracks, births marked by hand."""
    plt = _pyplot()
    figure, axes = plt.subplots(len(scenes), 3, figsize=(12, 3.1 * len(scenes)), squeeze=False, layout="constrained")
    for row, (name, (picture, scene)) in zip(axes, scenes.items(), strict=True):
        shown = ((scene.clutter, _RED), (scene.births, _GREEN), (scene.hand, _GREEN))
        for axis, (learned, colour), what in zip(row, shown, ("false alarms", "births", "births by hand"), strict=True):
            axis.imshow(over(picture, learned.density if learned else None, colour))
            told = f", {learned.rate:.3g} each, {len(learned.density)} places" if learned else ": too few"
            axis.set(xticks=[], yticks=[])
            axis.set_title(f"{name}: {what}{told}", fontsize=9)
    figure.savefig(path, dpi=70)
    plt.close(figure)


def over(picture: Image, density: ContextDensity | None, colour: F8) -> Image:
    """(H, W, 3) RGB: the picture, darker and grey, with the density's places in ``colour``."""
    grey = np.repeat(0.7 * picture.mean(axis=2, keepdims=True), 3, axis=2)
    if density is None:
        return grey.astype(np.uint8)
    opacity = _OPAQUE * np.sqrt(place_map(density, (picture.shape[0], picture.shape[1]), 1.0))[:, :, None]
    mixed: Image = ((1 - opacity) * grey + opacity * colour).astype(np.uint8)
    return mixed


def bars(gains: Mapping[str, Mapping[str, Mapping[str, Interval]]], path: Path) -> None:
    """Differences to the uniform model by score, scene and run, with the half of their intervals."""
    plt = _pyplot()
    scores = list(next(iter(next(iter(gains.values())).values())))
    figure, axes = plt.subplots(len(scores), 1, figsize=(11, 2.6 * len(scores)), squeeze=False, layout="constrained")
    runs = list(next(iter(gains.values())))
    for axis, score in zip(axes[:, 0], scores, strict=True):
        for k, run in enumerate(runs):
            each = [gains[scene][run][score] for scene in gains]
            at = np.arange(len(each)) + (k - (len(runs) - 1) / 2) * 0.8 / len(runs)
            half = [one.half if np.isfinite(one.half) else 0.0 for one in each]
            axis.bar(
                at, [one.mean for one in each], 0.8 / len(runs), yerr=half, label=run, color=f"C{k}", error_kw={"lw": 0.8}
            )
        axis.set_xticks(np.arange(len(gains)), list(gains))
        axis.set_ylabel(f"{score}, less UM's")
        axis.axhline(0, color="k", lw=0.8)
        axis.grid(axis="y", alpha=0.3)
    axes[0, 0].legend(ncols=len(runs), fontsize=8)
    figure.savefig(path, dpi=75)
    plt.close(figure)


def sweeps(found: Mapping[str, tuple[Mapping[str, Sweep], float]], path: Path) -> None:
    """MOTA of the uniform model over its rate of clutter, a line for each rate of births; the learned one's beside it."""
    plt = _pyplot()
    figure, axes = plt.subplots(1, len(found), figsize=(3.6 * len(found), 3.4), squeeze=False, layout="constrained")
    for axis, (name, (kinds, learned)) in zip(axes[0], found.items(), strict=True):
        for k, (kind, sweep) in enumerate(kinds.items()):
            for births in _sorted(rates[0] for rates in sweep):
                clutter = _sorted(rates[1] for rates in sweep if rates[0] == births)
                values = [sweep[births, rate] for rate in clutter]
                style = ("-", "--", ":")[_sorted(rates[0] for rates in sweep).index(births) % 3]
                axis.plot(clutter, values, style, marker="o", ms=3, color=f"C{k}", label=f"{kind}, births {births:g}")
        axis.axhline(learned, color="k", lw=1, label="GM")
        axis.set(xscale="log", title=name, xlabel="uniform clutter a frame")
        axis.grid(alpha=0.3)
    axes[0, 0].set_ylabel("MOTA")
    axes[0, -1].legend(fontsize=7)
    figure.savefig(path, dpi=75)
    plt.close(figure)


def _sorted(values: Any) -> Sequence[float]:
    return sorted(set(values))


def _pyplot() -> Any:
    """Matplotlib without a screen."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot
