"""The PMB filter for boxes: µs per step (predict, update, new targets, merge) and OSPA against the
truth.

The workload is `benchmarks.workload`'s, as many false alarms as targets, under the default
settings. Extraction is not part of a step; OSPA is between the centres of the targets that are
there with probability 0.5 or more and the true ones.
"""

from __future__ import annotations

from typing import Any

from benchmarks.gm_phd import steps
from benchmarks.workload import Crowd
from phdtrack import config
from phdtrack.filters.pmb import Bernoullis
from phdtrack.types import F8


def measure(targets: int, seed: int = 1, frames: int = 60) -> dict[str, Any]:
    """The PMB filter's step, see `gm_phd.steps`; its components are hypotheses."""
    crowd = Crowd(targets, frames)
    stages = config.build(config.load(sets=["filter.kind=pmb"]), crowd.info)
    return steps(stages.filter, stages.model, crowd, seed, _there)


def _there(state: Bernoullis) -> F8:
    """Positions (2, n) of the best hypotheses of who is there."""
    now = state.present
    return now.mean[now.targets["best"][now.targets["presence"] >= 0.5], :2].T
