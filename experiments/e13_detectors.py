"""E13's filter on real detections: PETS09-S2L1, the same camera, people counted and located on the
ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.common import Options, detections_in, filled, in_parallel, mot15, need_data, table
from experiments.scans import ospa
from phdtrack import config, pipeline
from phdtrack.ground import CountedFrom, read_camera
from phdtrack.types import F8, DetectionTable
from phdtrack.video import open_source

SEQUENCE = "PETS09-S2L1"
DETECTORS = ("public", "frcnn", "person")
# Cut-off of OSPA, metres.
CUTOFF = 2.0
# Births anywhere, one in three seconds, a false alarm a frame on the ground, a current p_D, each
# detection's noise.
ANYWHERE = (
    "birth.kind=ground",
    "birth.births_per_second=0.35",
    "clutter.density=0",
    "clutter.clutter_per_frame=1",
    "sensor.detection_probability=0.9",
    "sensor.scaling=given",
)
FILTERS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "GM-PHD": ("gm-phd", ()),
    "GM-PHD, rates": ("gm-phd", ANYWHERE),
    "GM-CPHD, rates": ("gm-cphd", ANYWHERE),
    "PMB, rates": ("pmb", ANYWHERE),
}


@dataclass(frozen=True, slots=True, eq=False)
class Crowd:
    """By frame: people, detections, the intensity's mass, the states extracted, and OSPA of
    detections and of states.
    """

    people: F8
    raw: F8
    mass: F8
    states: F8
    raw_ospa: F8
    ospa: F8


def detections(kind: str) -> DetectionTable:
    """The detections of the sequence, or those of the ``person`` detector on its video."""
    if kind != "person":
        return mot15(SEQUENCE, kind).table
    return detections_in(open_source(Path(need_data(), "mot15", SEQUENCE, f"{SEQUENCE}.mp4")), kind)


def work(job: tuple[str, DetectionTable]) -> Crowd:
    """Run a filter on the sequence with these detections, and score it on the ground."""
    kind, sets = FILTERS[job[0]]
    table_ = job[1]
    case = mot15(SEQUENCE, "public")
    file = need_data() / "pets2009" / "View_001.xml"
    camera = CountedFrom(read_camera(file), 1)
    place = camera.ground(
        np.stack([case.truth.xyxy[:, [0, 2]].mean(axis=1), case.truth.xyxy[:, 3]])
    )
    low = place.min(axis=1)
    high = place.max(axis=1)
    region = f"camera.region=[{low[0]}, {low[1]}, {high[0]}, {high[1]}]"
    camera_settings = (f"camera.file={file}", "camera.first_pixel=1", *((region,) if sets else ()))
    stages = config.build(config.load(None, (*camera_settings, *sets), "e13"), case.info, kind)
    rng = np.random.default_rng(1)
    rows = []
    state = pipeline.start(stages, rng)
    for number in range(1, case.info.frames + 1):
        state, step = pipeline.advance(
            stages, state, table_.at(number), number, (number - 1) / case.info.fps, rng
        )
        true = place[:, case.truth.frame == number]
        box = step.detections.xyxy
        seen = camera.ground(np.stack([(box[:, 0] + box[:, 2]) / 2, box[:, 3]]))
        seen = seen[:, np.isfinite(seen).all(axis=0)]
        found = step.estimates.state[:2]
        distance = (ospa(one, true, CUTOFF) for one in (seen, found))
        rows.append([true.shape[1], len(box), step.info.mass, found.shape[1], *distance])
    return Crowd(*np.array(rows, np.float64).T)


def section(options: Options) -> str:
    """Measure; return the section of the page."""
    kinds = DETECTORS[: 1 if options.quick else None]
    tables = dict(
        zip(kinds, in_parallel(detections, kinds, "e13, detecting", options), strict=True)
    )
    each = [(name, kind) for kind in kinds for name in FILTERS]
    found = in_parallel(
        work, [(name, tables[kind]) for name, kind in each], "e13, real detectors", options
    )
    rows = []
    for (name, kind), one in zip(each, found, strict=True):
        if name == next(iter(FILTERS)):
            rows.append(
                (
                    kind,
                    "raw detections",
                    *_cells(one.raw - one.people),
                    "",
                    f"{one.raw_ospa.mean():.2f}",
                )
            )
        off = f"{np.abs(one.states - one.people).mean():.2f}"
        rows.append((kind, name, *_cells(one.mass - one.people), off, f"{one.ospa.mean():.2f}"))
    header = (
        "detector",
        "filter",
        "mass: error",
        "bias",
        "states: error",
        f"OSPA, m (c = {CUTOFF:g})",
    )
    return filled("e13_detectors", people=f"{one.people.mean():.1f}", table=table(header, rows))


def _cells(error: F8) -> tuple[str, str]:
    return f"{np.abs(error).mean():.2f}", f"{error.mean():+.2f}"
