"""The pictures of the D14 experiment: errors by N, ellipses on frames, trajectories.

The frames are rendered ones of the simulated corridor: CAVIAR's real footage may not be passed on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from experiments.common import pyplot
from experiments.corridor import PATHS, centroids
from experiments.d14_runs import (
    FILTERS,
    INFOS,
    KALMAN,
    VARIANCES,
    CorridorRun,
    Points,
    RunErrors,
    posterior_deviation,
    scene,
    seeds_of,
    track,
)
from phdtrack.arrays import to_cxcywh
from phdtrack.simulate import DetectorModel, Look, Rendered, make_scene
from phdtrack.types import F8, Frame

SHOWN = (100, 200, 265, 350)
_COLOURS = dict(zip((*FILTERS, KALMAN), ("C0", "C1", "C2", "C3", "k"), strict=True))


def pictures(
    results: Mapping[CorridorRun, RunErrors], numbers: Sequence[int], seeds: int, out: Path
) -> None:
    """Write errors, frames and trajectories of the simulated corridor as PNG files into ``out``."""
    errors_by_number(results, numbers, seeds, out / "d14-errors.png")
    found = _tracked("corridor", numbers[-1])
    rendered = Rendered(
        make_scene(PATHS, 1, DetectorModel()),
        np.random.default_rng(1),
        Look(noise=0.0, plants=0, flicker=0.0),
    )
    ellipses("corridor", found, rendered, out / "d14-frames.png")
    trajectories("corridor", found, out / "d14-trajectories.png")


def _tracked(world: str, number: int) -> dict[str, Points]:
    """The states of each filter with σ² = 1 and the first seed."""
    return {name: track(CorridorRun(world, name, number, 1.0, 0))[0] for name in FILTERS}


def errors_by_number(
    results: Mapping[CorridorRun, RunErrors], numbers: Sequence[int], seeds: int, path: Path
) -> None:
    """Draw the RMSE against the truth over N with the spread over seeds, a panel for each world and
    variance.
    """
    plt = pyplot()
    shape = (len(INFOS), len(VARIANCES))
    figure, axes = plt.subplots(
        *shape, figsize=(11, 8), sharex=True, squeeze=False, layout="constrained"
    )
    for row, world in zip(axes, INFOS, strict=True):
        for axis, variance in zip(row, VARIANCES, strict=True):
            for name in FILTERS:
                some = range(seeds_of(world, seeds))
                each = np.array(
                    [
                        [results[CorridorRun(world, name, n, variance, s)].overall for s in some]
                        for n in numbers
                    ]
                )
                low, middle, high = np.percentile(each, [2.5, 50, 97.5], axis=1)
                bars = np.stack([middle - low, high - middle])
                axis.errorbar(
                    numbers, middle, bars, color=_COLOURS[name], label=name, capsize=2, lw=1
                )
            bound = np.mean(
                [results[CorridorRun(world, KALMAN, 0, variance, s)].overall for s in some]
            )
            axis.axhline(bound, color="k", lw=1, label=KALMAN)
            axis.axhline(
                posterior_deviation(variance), color="0.5", lw=1, ls=":", label="posterior"
            )
            axis.set(xscale="log", title=f"{world}, σ² = {variance:g}")
            axis.set_ylim(0, 4)
            axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("N")
    for axis in axes[:, 0]:
        axis.set_ylabel("RMSE to the truth, px per axis")
    axes[1, 0].legend(fontsize=8)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def ellipses(world: str, found: Mapping[str, Points], frames: Iterable[Frame], path: Path) -> None:
    """Draw truth and states on some frames: a row for each filter, as in D14's Figs. 2–4."""
    plt = pyplot()
    from matplotlib.patches import Ellipse

    numbers = SHOWN
    images = {frame.number: frame.image[:, :, ::-1] for frame in frames if frame.number in numbers}
    figure, axes = plt.subplots(
        len(found), len(numbers), figsize=(12, 2.45 * len(found)), layout="constrained"
    )
    truth = scene(world)
    for row, (name, points) in zip(axes, found.items(), strict=True):
        for axis, number in zip(row, numbers, strict=True):
            axis.imshow(images[number])
            boxes = to_cxcywh(truth.xyxy[truth.frame == number])
            for x, y, w, h in boxes.T:
                axis.add_patch(Ellipse((x, y), w, h, fill=False, color="yellow", lw=1.2, ls="--"))
            for place in points.point[:, points.frame == number].T:
                w, h = _size_near(boxes, place)
                axis.add_patch(Ellipse(tuple(place), w, h, fill=False, color="red", lw=1.2))
                axis.plot(*place, "r+", ms=5)
            axis.set(
                xticks=[], yticks=[], xlim=(0, INFOS[world].width), ylim=(INFOS[world].height, 0)
            )
            axis.set_title(f"{name}, frame {number}", fontsize=9)
    figure.savefig(path, dpi=70)
    plt.close(figure)


def _size_near(boxes: F8, place: F8) -> tuple[float, float]:
    """Width and height of the box (4, n) with its centre nearest to ``place``; a small size if
    there is none.
    """
    if boxes.shape[1] == 0:
        return 10.0, 10.0
    w, h = boxes[2:, np.hypot(*(boxes[:2] - place[:, None])).argmin()]
    return float(w), float(h)


def trajectories(world: str, found: Mapping[str, Points], path: Path) -> None:
    """Draw the states of all frames over the true paths, a panel for each filter, coloured by
    label.
    """
    plt = pyplot()
    truth = scene(world)
    figure, axes = plt.subplots(
        1, len(found), figsize=(4.3 * len(found), 4.2), sharey=True, layout="constrained"
    )
    for axis, (name, points) in zip(axes, found.items(), strict=True):
        for one in np.unique(truth.identity):
            axis.plot(*centroids(truth)[:, truth.identity == one], "k", lw=0.8)
        for one in np.unique(points.identity):
            mine = points.identity == one
            axis.plot(
                *points.point[:, mine], ".", ms=1.5, color="C0" if one < 0 else f"C{int(one) % 10}"
            )
        axis.set(
            title=name,
            xlim=(0, INFOS[world].width),
            ylim=(INFOS[world].height, 0),
            aspect="equal",
            xlabel="px",
        )
    axes[0].set_ylabel("px")
    figure.savefig(path, dpi=80)
    plt.close(figure)
