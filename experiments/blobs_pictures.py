"""The picture of a meeting: blobs, truth and tracks along the picture's width, over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from experiments.common import Case, followed
from phdtrack import config


def meeting_picture(case: Case, filter_name: str, ways: Mapping[str, tuple[str, ...]], path: Path) -> None:
    """A panel for each way to treat blobs: their extent in grey, the truth's axes in black, online rows by identity."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(ways), figsize=(10, 4), sharey=True, squeeze=False, layout="constrained")
    blobs, truth = case.table, case.truth
    for axis, (way, sets) in zip(axes[0], ways.items(), strict=True):
        rows = followed(config.build(config.load(None, sets), case.info, filter_name), case, 1).online
        rows = rows.take(rows.confirmed)
        axis.hlines(
            blobs.frame, blobs.detections.xyxy[:, 0], blobs.detections.xyxy[:, 2], color="0.85", linewidth=2, zorder=0
        )
        for who in np.unique(truth.identity).tolist():
            own = truth.identity == who
            axis.plot(truth.xyxy[own][:, [0, 2]].mean(axis=1), truth.frame[own], color="black", linewidth=0.8, zorder=4)
        for k, identity in enumerate(np.unique(rows.identity).tolist()):
            own = rows.identity == identity
            place = rows.xyxy[own][:, [0, 2]].mean(axis=1)
            axis.scatter(place, rows.frame[own], s=7, color=f"C{k % 10}", zorder=3, label=f"identity {identity}")
        axis.set(xlabel="along the picture, pixels", title=f"{filter_name}, {way}")
        axis.legend(fontsize=7, loc="upper center")
    axes[0][0].set(ylabel="frame")
    axes[0][0].invert_yaxis()
    figure.savefig(path, dpi=80)
    plt.close(figure)
