"""The pictures of M09's experiment: maps of the learned densities (Figs. 7, 8, 11), gains (14), the
sweep (15).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from experiments.common import pyplot
from experiments.m09_lessons import LearnedScene
from phdtrack.compare.statistics import Interval
from phdtrack.scene import SceneDensity
from phdtrack.scene.mixture import place_map
from phdtrack.types import F8, Image

_RED = np.array([220.0, 30, 30])
_GREEN = np.array([20.0, 190, 60])
# Square root: a place a quarter as likely as the highest remains visible.
_OPAQUE = 0.85
Sweep = Mapping[tuple[float, float], float]


def maps(scenes: Mapping[str, tuple[Image, LearnedScene]], path: Path) -> None:
    """Draw over a frame of each scene: false alarms, births of the tracker's own tracks, manual
    births.
    """
    plt = pyplot()
    figure, axes = plt.subplots(
        len(scenes), 3, figsize=(12, 3.1 * len(scenes)), squeeze=False, layout="constrained"
    )
    for row, (name, (picture, scene)) in zip(axes, scenes.items(), strict=True):
        panels = ((scene.clutter, _RED), (scene.births, _GREEN), (scene.hand, _GREEN))
        for axis, (learned, colour), title in zip(
            row, panels, ("false alarms", "births", "births by hand"), strict=True
        ):
            axis.imshow(over(picture, learned.density if learned else None, colour))
            rate = "r̄" if colour is _RED else "s̄"
            note = (
                f", {rate} = {learned.rate:.3g}, {len(learned.density)} places"
                if learned
                else ": too few"
            )
            axis.set(xticks=[], yticks=[])
            axis.set_title(f"{name}: {title}{note}", fontsize=9)
    figure.savefig(path, dpi=60)
    plt.close(figure)


def over(picture: Image, density: SceneDensity | None, colour: F8) -> Image:
    """(H, W, 3) RGB: the picture, darker and grey, with the density's places in ``colour``."""
    grey = np.repeat(0.7 * picture.mean(axis=2, keepdims=True), 3, axis=2)
    if density is None:
        return grey.astype(np.uint8)
    opacity = (
        _OPAQUE * np.sqrt(place_map(density, (picture.shape[0], picture.shape[1]), 1.0))[:, :, None]
    )
    mixed: Image = ((1 - opacity) * grey + opacity * colour).astype(np.uint8)
    return mixed


def bars(gains: Mapping[str, Mapping[str, Mapping[str, Interval]]], path: Path) -> None:
    """Draw differences to the uniform model with half their intervals: a row for each score, a
    column for each scene.
    """
    plt = pyplot()
    first = next(iter(gains.values()))
    runs = list(first)
    scores = list(next(iter(first.values())))
    shape = (len(scores), len(gains))
    figure, axes = plt.subplots(
        *shape, figsize=(2.2 * shape[1], 2.6 * shape[0]), squeeze=False, layout="constrained"
    )
    for row, score in zip(axes, scores, strict=True):
        for axis, (scene, found) in zip(row, gains.items(), strict=True):
            each = [found[run][score] for run in runs]
            half = [one.half if np.isfinite(one.half) else 0.0 for one in each]
            colours = [f"C{k}" for k in range(len(runs))]
            axis.bar(
                runs, [one.mean for one in each], yerr=half, color=colours, error_kw={"lw": 0.8}
            )
            axis.axhline(0, color="k", lw=0.8)
            axis.grid(axis="y", alpha=0.3)
            axis.tick_params(labelsize=7)
            axis.set_title(scene, fontsize=9)
        row[0].set_ylabel(f"{score}, less UM's")
    figure.savefig(path, dpi=75)
    plt.close(figure)


def sweeps(found: Mapping[str, tuple[Sweep, float]], path: Path) -> None:
    """Draw MOTA of the uniform model over its rate of clutter, and that of the learned model."""
    plt = pyplot()
    across = min(3, len(found))
    down = -(-len(found) // across)
    figure, axes = plt.subplots(
        down, across, figsize=(3.6 * across, 3.0 * down), squeeze=False, layout="constrained"
    )
    for axis, (name, (sweep, learned)) in zip(axes.ravel(), found.items(), strict=False):
        axis.plot([clutter for _, clutter in sweep], list(sweep.values()), "o-", ms=3, label="UM")
        axis.axhline(learned, color="k", lw=1, label="GM")
        axis.set(xscale="log", xlabel="false alarms in a box's neighbourhood", ylabel="MOTA")
        axis.set_title(name, fontsize=9)
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=7)
    figure.savefig(path, dpi=75)
    plt.close(figure)
