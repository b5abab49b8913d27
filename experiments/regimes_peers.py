"""Scores of SORT, ByteTrack and OC-SORT in regimes drawn at random, for `experiments.regimes`.

Runs in the environment of the peers (`make peers`), which has the package `trackers`:

    .venv-peers/bin/python -m experiments.regimes_peers ../shared/bench

writes experiments/regimes_peers.csv. The harness regimes.py in the given folder makes the scenes,
runs the trackers with their defaults, and scores them.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from experiments.regimes_scenes import (
    CSV,
    PEERS,
    REGIMES,
    SCENES,
    SEED,
    Parameters,
    described,
    harness,
    random_regimes,
)


def peer_scores(regime: Parameters, folder: Path, scenes: int = SCENES) -> list[float]:
    """MOTA and IDF1 of each peer, means over the scenes of a regime."""
    bench = harness(folder)
    each = []
    for seed in range(scenes):
        found, truth = bench.scene(seed=seed, **regime)
        ran = [k for k, detections in enumerate(found) if detections is not None]
        row: list[float] = []
        for name in PEERS:
            (rows,) = bench.peer(found, regime, name)
            row += bench.scores([truth[k] for k in ran], [rows.get(k, []) for k in ran])
        each.append(row)
    return [float(value) for value in np.mean(each, axis=0)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Score the peers, and write a row for each regime."""
    parser = argparse.ArgumentParser(prog="experiments.regimes_peers", description=__doc__)
    parser.add_argument("bench", type=Path, help="folder of regimes.py")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the regimes")
    parser.add_argument("--regimes", type=int, default=REGIMES, metavar="N")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), metavar="N")
    parser.add_argument("--out", type=Path, default=CSV, metavar="FILE")
    options = parser.parse_args(arguments)
    regimes = random_regimes(options.seed, options.regimes)
    with ProcessPoolExecutor(max_workers=options.jobs) as pool:
        scores = list(pool.map(partial(peer_scores, folder=options.bench), regimes))
    with options.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["regime", *(f"{p}_{s}" for p in PEERS for s in ("mota", "idf1"))])
        for regime, row in zip(regimes, scores, strict=True):
            writer.writerow([described(regime), *(f"{value:.3f}" for value in row)])


if __name__ == "__main__":
    main()
