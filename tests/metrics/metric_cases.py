"""Sequences to score: random ones with every kind of error, and real ones with crude tracks."""

from pathlib import Path

import numpy as np
import pytest

from phdtrack.arrays import iou
from phdtrack.formats import read_detections, read_truth
from phdtrack.types import DetectionTable, Tracks, Truth

REAL = [
    (sequence, detector)
    for sequence in ("PETS09-S2L1", "TUD-Campus", "ETH-Sunnyday", "KITTI-17", "ADL-Rundle-6")
    for detector in ("det_public", "det_frcnn")
    if (sequence, detector) != ("ADL-Rundle-6", "det_public")
]


def close(ours, theirs, within: float = 1e-9) -> None:
    """Equal but for rounding; NaN equals NaN."""
    assert ours == pytest.approx(theirs, abs=within, rel=0, nan_ok=True)


def tracks_of(frame, identity, xyxy) -> Tracks:
    n = len(frame)
    return Tracks(
        np.asarray(frame, np.int64),
        np.asarray(identity, np.int64),
        np.asarray(xyxy, np.float64).reshape(n, 4),
        np.ones(n),
        np.full(n, -1),
        np.ones(n, np.bool_),
    )


def truth_of(frame, identity, xyxy, distractor=None) -> Truth:
    rows = tracks_of(frame, identity, xyxy)
    flags = ~rows.confirmed if distractor is None else np.asarray(distractor, np.bool_)
    return Truth(rows.frame, rows.identity, rows.xyxy, flags)


def perfect(truth: Truth) -> Tracks:
    rows = ~truth.distractor
    return tracks_of(truth.frame[rows], truth.identity[rows], truth.xyxy[rows])


def random_case(
    rng: np.random.Generator,
    *,
    frames: int = 30,
    objects: int = 5,
    distractors: bool = False,
    side: float = 150.0,
) -> tuple[Truth, Tracks]:
    """Crowded walkers that come and go; output with misses, jitter, clutter, swapped and renewed
    identities.
    """
    t = []
    o = []
    name = {i: 100 + 7 * i for i in range(objects)}
    fresh = 1000
    start = rng.uniform(0, side, (objects, 2))
    speed = rng.normal(0, 3, (objects, 2))
    size = rng.uniform(25, 60, (objects, 2))
    life = np.sort(rng.integers(1, frames + 1, (objects, 2)), axis=1)
    ignored = rng.random(objects) < (0.3 if distractors else 0.0)
    gap = rng.integers(0, frames, 2)
    for k in range(1, frames + 1):
        if rng.random() < 0.1 and objects > 1:
            a, b = rng.choice(objects, 2, replace=False)
            name[a], name[b] = name[b], name[a]
        for i in range(objects):
            if not life[i, 0] <= k <= life[i, 1] or rng.random() < 0.05:
                continue
            corner = start[i] + k * speed[i] + rng.normal(0, 0.5, 2)
            t.append((k, 5 * i + 3, *corner, *(corner + size[i]), ignored[i]))
            if rng.random() < 0.1:
                name[i] = fresh
                fresh = fresh + 1
            if rng.random() < 0.8 and k not in gap:
                noisy = np.concatenate([corner, corner + size[i]]) + rng.normal(0, 5, 4)
                o.append(
                    (
                        k,
                        name[i],
                        *np.minimum(noisy[:2], noisy[2:]),
                        *np.maximum(noisy[:2], noisy[2:]),
                    )
                )
        for _ in range(rng.poisson(1.0)):
            corner = rng.uniform(0, side, 2)
            o.append((k, fresh, *corner, *(corner + rng.uniform(20, 60, 2))))
            fresh += 1
    tt = np.array(t, np.float64).reshape(-1, 7)
    oo = np.array(o, np.float64).reshape(-1, 6)
    return truth_of(tt[:, 0], tt[:, 1], tt[:, 2:6], tt[:, 6]), tracks_of(
        oo[:, 0], oo[:, 1], oo[:, 2:]
    )


def real_case(data: Path, sequence: str, detector: str) -> tuple[Truth, Tracks]:
    """The annotation of a sequence and crude tracks of a detector's boxes."""
    folder = data / "mot15" / sequence
    return read_truth(folder / "gt" / "gt.txt"), crude_tracks(
        read_detections(folder / detector / "det.txt")
    )


def crude_tracks(table: DetectionTable, patience: int = 2) -> Tracks:
    """Greedy linking by overlap: enough to have realistic identities, switches and breaks."""
    frame = []
    identity = []
    live: list[tuple[int, int, np.ndarray]] = []
    fresh = 1
    for k in range(1, table.last + 1):
        boxes = table.at(k).xyxy
        live = [entry for entry in live if k - entry[1] <= patience]
        overlap = iou(np.array([e[2] for e in live]).reshape(-1, 4), boxes)
        names = np.zeros(len(boxes), np.int64)
        while overlap.size and overlap.max() > 0.3:
            i, j = np.unravel_index(overlap.argmax(), overlap.shape)
            names[j] = live[i][0]
            overlap[i] = 0
            overlap[:, j] = 0
        for j in np.flatnonzero(names == 0):
            names[j] = fresh
            fresh = fresh + 1
        found = {int(n): (int(n), k, b) for n, b in zip(names, boxes, strict=True)}
        live = [e for e in live if e[0] not in found] + list(found.values())
        frame += [k] * len(boxes)
        identity += names.tolist()
    return tracks_of(frame, identity, table.detections.xyxy)
