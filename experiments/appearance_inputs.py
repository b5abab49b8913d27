"""The real sequences with embeddings that are made from the truth, for `experiments.appearance`.

Imports nothing of phdtrack: the environment of the peers has neither its dependencies nor itself.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from experiments.degraded_inputs import CameraCase, with_area

F4 = npt.NDArray[np.float32]

# How well made embeddings tell objects apart, by the names of the script that makes them.
QUALITIES = ("weak", "middle", "strong")
PEERS = ("botsort", "deepocsort", "boosttrack", "strongsort")
# The seeds of the embeddings that peers get.
PEERS_SEEDS = (1,)


def made(case: CameraCase, bench: Path, quality: str, seed: int, fps: float) -> F4:
    """(M, D) embeddings of the detections with an area, made by the script in the folder
    ``bench``.
    """
    files = (case.folder / "gt" / "gt.txt", case.detections)
    rows = np.loadtxt(case.detections, delimiter=",", ndmin=2)
    return embeddings_of(files, bench, quality, seed, fps)[with_area(rows)]


def embeddings_of(files: tuple[Path, Path], bench: Path, quality: str, seed: int, fps: float) -> F4:
    """(N, D) embeddings of the rows of the second of the ``files``, detections, made by the script
    in the folder ``bench`` from the first one, the truth.

    Boxes on one object look alike, those that are half hidden also like what is before them.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "embeddings.npy"
        words: Sequence[object] = (
            sys.executable,
            bench / "make_embeddings.py",
            *("--gt", files[0], "--det", files[1], "--out", out),
            *("--quality", quality, "--seed", seed, "--fps", fps),
        )
        subprocess.run([str(word) for word in words], check=True)
        found: F4 = np.load(out)
    return found
