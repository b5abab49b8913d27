"""Every experiment by its name, the short ones first: what `phdtrack reproduce` offers and `make experiments` runs."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from experiments import blobs, count, d14, e13, groups, m07, m09, occlusion, particles, peers, plane, videos, vo
from experiments.common import Options, need_data
from phdtrack.errors import InputError


@dataclass(frozen=True, slots=True)
class Experiment:
    """``run`` measures and writes a page; ``about``: what it answers, in a line; ``data``: it needs real sequences."""

    run: Callable[[Options], Path]
    about: str
    data: bool = True


EXPERIMENTS = {
    "count": Experiment(count.main, "does the filter count right, with known parameters?", data=False),
    "vo": Experiment(vo.main, "the standard scenarios of simulated points, straight and turning, by OSPA", data=False),
    "groups": Experiment(groups.main, "annotated groups of pedestrians, found among true positions and behind a filter"),
    "plane": Experiment(plane.main, "tracks on the ground plane, in metres, beside those in the image"),
    "e13": Experiment(e13.main, "E13 Figs. 1 and 2: people and groups on E13's own sequence"),
    "d14": Experiment(d14.main, "D14 Tables I-III: SMC PHD and MCMC filters on centroids, by particles and noise"),
    "occlusion": Experiment(occlusion.main, "what hiding costs a detector, and what a filter makes of it"),
    "videos": Experiment(videos.main, "from a video to tracks, with the package's detectors"),
    "blobs": Experiment(blobs.main, "two who share a blob: with and without the merged-measurement model"),
    "m07": Experiment(m07.main, "M07 Table 1 and M09 Fig. 16: PHD against no filter and multiple hypotheses"),
    "m09": Experiment(m09.main, "M09 Figs. 14-16: births and false alarms learned from a scene, part by part"),
    "peers": Experiment(peers.main, "beside the trackers that people use today, and what each default is worth"),
    "particles": Experiment(particles.main, "how many particles real detections need"),
}


def find(name: str) -> Experiment:
    """The experiment of that name.

    Raises
    ------
    InputError : for a name that is none of them, or where the real sequences that it needs are missing.
    """
    if name in EXPERIMENTS:
        if EXPERIMENTS[name].data:
            need_data()
        return EXPERIMENTS[name]
    near = difflib.get_close_matches(name, EXPERIMENTS, n=1)
    known = ", ".join(EXPERIMENTS)
    raise InputError(
        f"expected one of {known}, got {name!r}", where="experiment", cure=f"Did you mean {near[0]}?" if near else ""
    )
