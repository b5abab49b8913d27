"""Tracks on the ground plane: PETS09-S2L1 with its real detections and its camera.

World-plane tracks of the Gaussian-mixture filters and of the particle filter, with and without
occlusion in p_D, next to the default tracker in the image. Foot points are mapped to the ground by
the camera and compared with the truth's own columns X, Y (metres). Settings are the defaults,
except ``motion.kind=plane`` and the camera.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from experiments.common import (
    Case,
    Options,
    built,
    in_parallel,
    mot15,
    need_data,
    table,
    with_error,
    write,
)
from experiments.group_scores import nearest
from phdtrack import pipeline
from phdtrack.ground import CountedFrom, read_camera
from phdtrack.metrics import evaluate
from phdtrack.metrics.counts import count
from phdtrack.metrics.matching import FramePair, SequencePair
from phdtrack.metrics.scores import scores_of
from phdtrack.types import F8, I8, DetectionTable, Tracks

SEQUENCE = "PETS09-S2L1"
KINDS = ("public", "frcnn")
SEEDS = 3
# Metres: largest distance of a match for MOTA and IDF1, and of the matched rows for RMSE.
NEAR = 1.0
FAR = 2.0
# The overlap above which the default tracker joins two states.
JOINED = 0.4
# MOTChallenge counts pixels from 1.
FIRST_PIXEL = 1.0


@dataclass(frozen=True, slots=True)
class Variant:
    """A way to track: a filter, on the ground or in the image, with or without occlusion in p_D.

    ``joined``: states whose boxes overlap by more than `JOINED` are joined; False: none are.
    ``random``: the filter depends on a seed.
    """

    name: str
    filter: str
    plane: bool
    occlusion: bool
    joined: bool = True
    random: bool = False


VARIANTS = (
    Variant("GM-PHD", "gm-phd", plane=True, occlusion=True),
    Variant("GM-PHD", "gm-phd", plane=True, occlusion=False),
    Variant("GM-CPHD", "gm-cphd", plane=True, occlusion=True),
    Variant("GM-CPHD", "gm-cphd", plane=True, occlusion=False),
    Variant("particle PHD", "particle-phd", plane=True, occlusion=True, random=True),
    Variant("particle PHD", "particle-phd", plane=True, occlusion=False, random=True),
    Variant("GM-PHD, not joined", "gm-phd", plane=True, occlusion=True, joined=False),
    Variant("GM-PHD, not joined", "gm-phd", plane=True, occlusion=False, joined=False),
    Variant("PMB", "pmb", plane=True, occlusion=True),
    Variant("PMB", "pmb", plane=True, occlusion=False),
    Variant("PMB", "pmb", plane=False, occlusion=False),
    Variant("GM-PHD", "gm-phd", plane=False, occlusion=False),
    Variant("particle PHD", "particle-phd", plane=False, occlusion=False, random=True),
)


@dataclass(frozen=True, slots=True)
class GroundRun:
    """One run: the detections, a variant by its place in `VARIANTS`, and a seed."""

    kind: str
    variant: int
    seed: int


@dataclass(frozen=True, slots=True)
class GroundScores:
    """Scores on the ground: MOTA and IDF1 with matches within `NEAR`; for the rows matched one to
    one within `FAR`, the root mean squared distance, the median, and the share of all annotated
    rows within `NEAR`.
    """

    mota: float
    idf1: float
    rmse: float
    median: float
    within: float


@dataclass(frozen=True, slots=True)
class GroundErrors:
    """One run: MOTA and IDF1 in the image with the tracks' boxes (``own``) and with the boxes of
    the detections that rows use (``taken``); scores on the ground; mean absolute errors of the mass
    and of the number of states, and the bias of the mass.
    """

    own: tuple[float, float]
    taken: tuple[float, float]
    ground: GroundScores
    mass: float
    states: float
    bias: float

    def numbers(self) -> tuple[float, ...]:
        """The values in the order of the tables: image, ground, counts."""
        g = self.ground
        return (
            *self.own,
            *self.taken,
            g.mota,
            g.idf1,
            g.rmse,
            g.median,
            g.within,
            self.mass,
            self.states,
            self.bias,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """People on the ground: ``frame`` (M,), ``identity`` (M,), ``point`` (2, M) metres, NaN if the
    ray does not meet the ground.
    """

    frame: I8
    identity: I8
    point: F8


@lru_cache(maxsize=2)
def case(kind: str) -> Case:
    """The sequence with one set of detections."""
    return mot15(SEQUENCE, kind)


@lru_cache(maxsize=1)
def camera() -> CountedFrom:
    """The camera of view 1."""
    return CountedFrom(read_camera(camera_file()), FIRST_PIXEL)


def camera_file() -> str:
    """The file of the camera of view 1."""
    return str(need_data() / "pets2009" / "View_001.xml")


@lru_cache(maxsize=1)
def true_places() -> Places:
    """Ground positions from the columns X, Y of the annotation, for the rows that count."""
    rows = np.loadtxt(need_data() / "mot15" / SEQUENCE / "gt" / "gt.txt", delimiter=",")
    rows = rows[rows[:, 6] != 0]
    return Places(
        rows[:, 0].astype(np.int64),
        rows[:, 1].astype(np.int64),
        np.ascontiguousarray(rows[:, 7:9].T),
    )


def feet(xyxy: F8) -> F8:
    """(2, n) metres: the ground under the middle of each box's lower edge."""
    return camera().ground(np.stack([(xyxy[:, 0] + xyxy[:, 2]) / 2, xyxy[:, 3]]))


def places_of(rows: Tracks) -> Places:
    """The ground positions of tracks."""
    return Places(rows.frame, rows.identity, feet(rows.xyxy))


def ground_scene(truth: Places, found: Places, frames: int, near: float) -> SequencePair:
    """Truth and output side by side as for boxes, with 1 − d/(2 near), at least 0, for the distance
    d in place of the overlap: an overlap of a half is a distance of ``near``.
    """
    names, who = np.unique(truth.identity, return_inverse=True)
    outputs, which = np.unique(found.identity, return_inverse=True)
    pairs = []
    for number in np.union1d(truth.frame, found.frame).tolist():
        t = np.flatnonzero(truth.frame == number)
        o = np.flatnonzero(found.frame == number)
        apart = np.hypot(*(truth.point[:, t, None] - found.point[:, None, o]))
        closeness = np.maximum(1 - np.nan_to_num(apart, nan=np.inf) / (2 * near), 0.0)
        pairs.append(FramePair(number, who[t], which[o], closeness, t, o))
    return SequencePair(tuple(pairs), frames, names, outputs, 0)


def errors(truth: Places, found: Places, far: float) -> F8:
    """(K,) distances of the pairs matched one to one within ``far`` metres, frame by frame."""
    out = []
    for number in np.intersect1d(truth.frame, found.frame).tolist():
        a = truth.point[:, truth.frame == number]
        b = found.point[:, found.frame == number]
        b = b[:, np.isfinite(b).all(axis=0)]
        rows, columns = nearest(a, b, far)
        out.append(np.hypot(*(a[:, rows] - b[:, columns])))
    return np.concatenate([np.zeros(0), *out])


def on_the_ground(truth: Places, found: Places, frames: int) -> GroundScores:
    """All scores on the ground."""
    scores = scores_of(count(ground_scene(truth, found, frames, NEAR), 0.5), 0.5)
    off = errors(truth, found, FAR)
    return GroundScores(
        scores.MOTA,
        scores.IDF1,
        math.sqrt(float((off**2).mean())),
        float(np.median(off)),
        float(np.count_nonzero(off <= NEAR) / len(truth.frame)),
    )


def with_detections(tracks: Tracks, found: DetectionTable) -> Tracks:
    """The tracks, with the detections' boxes in rows that use one."""
    xyxy = tracks.xyxy.copy()
    held = np.flatnonzero(tracks.detection >= 0)
    first = np.searchsorted(found.frame, tracks.frame[held])
    xyxy[held] = found.detections.xyxy[first + tracks.detection[held]]
    return replace(tracks, xyxy=xyxy)


def sets_of(variant: Variant) -> tuple[str, ...]:
    """The settings of a variant."""
    joined = f"extract.merge_iou={JOINED if variant.joined else 1.0}"
    if not variant.plane:
        return (joined,)
    occlusion = f"sensor.occlusion={str(variant.occlusion).lower()}"
    return (
        "motion.kind=plane",
        f"camera.file={camera_file()}",
        f"camera.first_pixel={FIRST_PIXEL}",
        occlusion,
        joined,
    )


def work(job: GroundRun) -> GroundErrors:
    """Run a variant on the sequence, and compute its errors."""
    sequence = case(job.kind)
    variant = VARIANTS[job.variant]
    stages = built(sequence.info, variant.filter, sets_of(variant))
    rng = np.random.default_rng(job.seed)
    state = pipeline.start(stages, rng)
    mass = np.zeros(sequence.info.frames)
    states = np.zeros(sequence.info.frames)
    for k in range(sequence.info.frames):
        state, step = pipeline.advance(
            stages, state, sequence.table.at(k + 1), k + 1, k / sequence.info.fps, rng
        )
        mass[k] = step.info.mass
        states[k] = len(step.estimates)
    tracks = pipeline.finish(stages, state)
    people = numbers(sequence.truth.frame, sequence.info.frames)
    return GroundErrors(
        in_the_image(sequence, tracks),
        in_the_image(sequence, with_detections(tracks, sequence.table)),
        on_the_ground(true_places(), places_of(tracks), sequence.info.frames),
        float(np.abs(mass - people).mean()),
        float(np.abs(states - people).mean()),
        float((mass - people).mean()),
    )


def in_the_image(sequence: Case, tracks: Tracks) -> tuple[float, float]:
    """MOTA and IDF1 at IoU 0.5."""
    scores = evaluate(sequence.truth, tracks, frames=sequence.info.frames)
    return scores.MOTA, scores.IDF1


def numbers(frame: I8, frames: int) -> F8:
    """(frames,) number of rows in each frame."""
    return np.bincount(frame, minlength=frames + 1)[1 : frames + 1].astype(np.float64)


def main(options: Options) -> Path:
    """Run everything and write plane.md."""
    seeds = options.number(SEEDS, 1)
    kinds, variants = (KINDS[:1], VARIANTS[:2]) if options.quick else (KINDS, VARIANTS)
    ways = [(kind, i, v) for kind in kinds for i, v in enumerate(variants)]
    jobs = [
        GroundRun(kind, i, seed) for kind, i, v in ways for seed in range(seeds if v.random else 1)
    ]
    outcomes = dict(zip(jobs, in_parallel(work, jobs, "plane", options), strict=True))
    return write("plane", options, **figures(outcomes, seeds))


def figures(outcomes: dict[GroundRun, GroundErrors], seeds: int) -> dict[str, object]:
    """The values of the page's placeholders."""
    ways = dict.fromkeys((run.kind, run.variant) for run in outcomes)
    each = {
        way: [one for run, one in outcomes.items() if (run.kind, run.variant) == way]
        for way in ways
    }
    rows = [(_head(kind, VARIANTS[i]), _means(those)) for (kind, i), those in each.items()]
    image = [(*head, *cells[:4]) for head, cells in rows]
    ground = [*_references(), *((*head, *cells[4:9]) for head, cells in rows)]
    counts = [*_raw(), *((*head, *cells[9:]) for head, cells in rows)]
    return {
        "seeds": seeds,
        "joined": JOINED,
        "near": NEAR,
        "far": FAR,
        "image": table(
            (*_HEAD, "MOTA", "IDF1", "MOTA, detections' boxes", "IDF1, detections' boxes"), image
        ),
        "ground": table(
            (*_HEAD, "MOTA", "IDF1", "RMSE, m", "median, m", f"within {NEAR:g} m"), ground
        ),
        "counts": table((*_HEAD, "mass", "states", "bias of the mass"), counts),
        "changes": table(_CHANGED, changes(each)),
    }


_HEAD = ("detections", "world", "filter", "occlusion")
_CHANGED = (
    "change",
    "filter",
    "detections",
    "MOTA, ground",
    "IDF1, ground",
    "RMSE, m",
    "MOTA, image",
    "IDF1, image",
    "error of the states",
)


def changes(each: Mapping[tuple[str, int], Sequence[GroundErrors]]) -> list[tuple[str, ...]]:
    """What a change of one thing does to the scores, a row for each pair of variants that were
    run and set of detections.

    Parameters
    ----------
    each : by detections and variant, the outcome of each seed.
    """
    return [
        (words, name, kind, *_differences(each[kind, place_of(new)], each[kind, place_of(old)]))
        for words, name, new, old in pairs_of_variants()
        for kind in dict.fromkeys(kind for kind, _ in each)
        if (kind, place_of(new)) in each and (kind, place_of(old)) in each
    ]


def pairs_of_variants() -> list[tuple[str, str, Variant, Variant]]:
    """The changes, the filters, and the variants with and without them."""
    found = []
    for words, changed in (
        ("on the ground, not in the image", {"plane": False, "occlusion": False}),
        ("occlusion in p_D", {"occlusion": False}),
    ):
        found += [
            (words, one.name, one, replace(one, **changed))
            for one in VARIANTS
            if one.plane and one.occlusion and replace(one, **changed) in VARIANTS
        ]
    plain, cardinalised, apart = (
        next(one for one in VARIANTS if one.name == name)
        for name in ("GM-PHD", "GM-CPHD", "GM-PHD, not joined")
    )
    return [
        *found,
        ("states joined", "GM-PHD", plain, apart),
        ("cardinalised", "GM-PHD", cardinalised, plain),
    ]


def place_of(variant: Variant) -> int:
    """The place of a variant in `VARIANTS`."""
    return VARIANTS.index(variant)


def _differences(new: Sequence[GroundErrors], old: Sequence[GroundErrors]) -> list[str]:
    """Differences of the scores, seed by seed, with their standard errors."""
    columns = np.array(
        [
            (
                a.ground.mota - b.ground.mota,
                a.ground.idf1 - b.ground.idf1,
                a.ground.rmse - b.ground.rmse,
                a.own[0] - b.own[0],
                a.own[1] - b.own[1],
                a.states - b.states,
            )
            for a, b in zip(new, old, strict=True)
        ]
    )
    return [with_error(column.tolist(), sign="+") for column in columns.T]


def _head(kind: str, variant: Variant) -> tuple[str, ...]:
    """The first cells of a row."""
    return (
        kind,
        "ground" if variant.plane else "image",
        variant.name,
        "on" if variant.occlusion else "off",
    )


def _means(outcomes: Sequence[GroundErrors]) -> list[str]:
    """Means over the seeds, with their standard errors."""
    return [
        with_error(column)
        for column in zip(*(outcome.numbers() for outcome in outcomes), strict=True)
    ]


def _references() -> list[tuple[str, ...]]:
    """The scores of the truth's boxes and of the detections before tracking: positions without
    identities.
    """
    truth = true_places()
    out = []
    annotated = case(KINDS[0]).truth
    boxes = Places(annotated.frame, annotated.identity, feet(annotated.xyxy))
    for name, found in (
        ("annotated boxes", boxes),
        *((f"{kind}, all", _seen(kind)) for kind in KINDS),
    ):
        off = errors(truth, found, FAR)
        near = np.count_nonzero(off <= NEAR) / len(truth.frame)
        numbers_ = (math.sqrt(float((off**2).mean())), float(np.median(off)), float(near))
        out.append((name, "", "none", "", "", "", *(f"{number:.3f}" for number in numbers_)))
    return out


def _seen(kind: str) -> Places:
    """The ground position of every detection; identities are row numbers."""
    found = case(kind).table
    return Places(found.frame, np.arange(1, len(found) + 1), feet(found.detections.xyxy))


def _raw() -> list[tuple[str, ...]]:
    """Errors of the raw number of detections as a count of people."""
    out: list[tuple[str, ...]] = []
    for kind in KINDS:
        sequence = case(kind)
        off = numbers(sequence.table.frame, sequence.info.frames) - numbers(
            sequence.truth.frame, sequence.info.frames
        )
        out.append(
            (
                kind,
                "",
                "number of detections",
                "",
                "",
                f"{np.abs(off).mean():.3f}",
                f"{off.mean():.3f}",
            )
        )
    return out
