"""Five places that fire with probability 0.5 in every frame: what 40 marked frames do to the tracks there, and to people.

A *false track there*: an identity never mapped to anybody, at least half of whose boxes overlap a place by 0.3. A person
*crosses* a place if his annotated box overlaps it by 0.3 in a frame. He is *lost* if the uniform model maps him in at least
half of his frames and the learned one in less than half, *won* in the other case.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments.common import Case, built, followed, mot15, table
from experiments.m09_lessons import learned_alarms, learned_followed, marked_false, own_births, told
from experiments.m09_scenes import stretch
from phdtrack.arrays import iou
from phdtrack.associate.rejection import without_false_tracks
from phdtrack.metrics import evaluate
from phdtrack.metrics.matching import build, tracking_mapping
from phdtrack.models.scene import FalseAlarmRatio
from phdtrack.protocols import AnyStages
from phdtrack.simulate import DetectorModel, detect, make_scene
from phdtrack.types import F8, Bool, SequenceInfo, Tracks, Truth

# The default filter knows that false alarms come back in one place before anything is learned; without that learning does
# all there is to do.
ALONE = "pmb without sources"
FILTERS = ("particle-phd", "gm-phd", "pmb", ALONE)
REAL, MADE = ("PETS09-S2L1", "TUD-Campus"), ("street", "corridor", "crowd")
RATES = (0.0, 5.0, 20.0)
SCENE_FRAMES = 1500
OVERLAP, MOSTLY = 0.3, 0.5
# Fewer frames than this are not parted: the frames marked are some of those tested.
SHORTEST = 200


@dataclass(frozen=True, slots=True)
class PlacesRun:
    """Detections made of a sequence's truth with Poisson clutter of ``rate`` and five places, for one filter."""

    name: str
    rate: float
    filter: str
    seed: int


@dataclass(frozen=True, slots=True)
class PlacesOutcome:
    """Uniform and learned side by side: pairs of numbers.

    ``false``: false tracks at the places, ``frames``: how many boxes they have; ``other``: false tracks elsewhere;
    ``MOTA``; ``there``: annotated boxes at a place that are mapped, of ``boxes``; ``crossing``, ``lost`` and ``won``:
    people; ``never``: found by the uniform model, and by the learned one never.
    """

    false: tuple[int, int]
    frames: tuple[int, int]
    other: tuple[int, int]
    MOTA: tuple[float, float]
    there: tuple[int, int]
    boxes: int
    crossing: int
    lost: int
    won: int
    never: int


def runs_of(quick: bool, seeds: int) -> list[PlacesRun]:
    """Every case with every filter and seed."""
    cases = [(name, rate) for name in REAL for rate in RATES] + [(name, 2.0) for name in MADE]
    if quick:
        cases = [("street", 2.0)]
    filters = FILTERS[2:3] if quick else FILTERS
    return [PlacesRun(name, rate, which, seed) for name, rate in cases for which in filters for seed in range(1, seeds + 1)]


def made(job: PlacesRun) -> tuple[Case, F8]:
    """The case, and its places (5, 4)."""
    model = DetectorModel(clutter_rate=job.rate, places=5, occlusion=2.0 if job.name in MADE else 0.0)
    if job.name in MADE:
        scene = make_scene(job.name, job.seed, model, frames=SCENE_FRAMES)
        return Case(job.name, scene.info, scene.truth, scene.detections), scene.places
    case = mot15(job.name, "frcnn")
    found = detect(case.truth, case.info, np.random.default_rng(job.seed), model)
    return replace(case, table=found.table), found.places


def work(job: PlacesRun) -> PlacesOutcome:
    """Mark 40 frames of the first half, learn, and track the second half with and without; a short sequence whole."""
    case, places = made(job)
    middle = case.info.frames // 2
    train = test = case
    if case.info.frames >= SHORTEST:
        train, test = stretch(case, 1, middle), stretch(case, middle + 1, case.info.frames)
    uniform = stages_of(job.filter, test.info)
    runs = [followed(stages, test, job.seed).corrected for stages in (uniform, learned(uniform, train, job.seed))]
    false, boxes, other = zip(*(false_tracks(test.truth, tracks, places) for tracks in runs), strict=True)
    mapped = [mapped_rows(test.truth, tracks) for tracks in runs]
    at = ~test.truth.distractor & (iou(test.truth.xyxy, places).max(axis=1) >= OVERLAP)
    shares = np.array([shares_of(test.truth, at, one) for one in mapped])
    mostly, found = shares >= MOSTLY, shares > 0
    scores = [evaluate(test.truth, tracks, frames=test.info.frames).MOTA for tracks in runs]
    return PlacesOutcome(
        (false[0], false[1]),
        (boxes[0], boxes[1]),
        (other[0], other[1]),
        (scores[0], scores[1]),
        (int((mapped[0] & at).sum()), int((mapped[1] & at).sum())),
        int(at.sum()),
        shares.shape[1],
        int((mostly[0] & ~mostly[1]).sum()),
        int((mostly[1] & ~mostly[0]).sum()),
        int((found[0] & ~found[1]).sum()),
    )


def stages_of(name: str, info: SequenceInfo) -> AnyStages:
    """The stages of one of `FILTERS`, as shipped but for what its name says."""
    return built(info, "pmb", ("filter.static_clutter_prior=0",)) if name == ALONE else built(info, name)


def learned(stages: AnyStages, train: Case, seed: int) -> AnyStages:
    """The stages with false alarms from 40 marked frames and births from the tracker's own run."""
    with TemporaryDirectory() as folder:
        marks = marked_false(train, Path(folder) / "false.sqlite", seed)
        alarms = learned_alarms(train, marks).learned
        run = followed(told(stages, None, alarms, None), train, seed).corrected
        seen = learned_followed(run, train, marks)
    births = own_births(without_false_tracks(run, FalseAlarmRatio(alarms, seen)) if seen else run, train, stages.model.rate)
    return told(stages, births.learned if births else None, alarms, seen)


def false_tracks(truth: Truth, tracks: Tracks, places: F8) -> tuple[int, int, int]:
    """How many identities that are never mapped to anybody lie at a place, how many boxes they have, how many elsewhere."""
    scene = build(truth, tracks)
    real = scene.output_identity[np.unique(tracking_mapping(scene, 0.5).output)]
    at = iou(tracks.xyxy, places).max(axis=1, initial=0) >= OVERLAP
    there = boxes = elsewhere = 0
    for identity in np.setdiff1d(tracks.identity, real):
        own = at[tracks.identity == identity]
        if own.mean() >= MOSTLY:
            there, boxes = there + 1, boxes + len(own)
        else:
            elsewhere += 1
    return there, boxes, elsewhere


def mapped_rows(truth: Truth, tracks: Tracks) -> Bool:
    """(M,) which annotated boxes are mapped."""
    scene = build(truth, tracks)
    mapping = tracking_mapping(scene, 0.5)
    numbers = np.array([pair.number for pair in scene.pairs], np.int64)
    pairs = set(zip(numbers[mapping.position].tolist(), scene.truth_identity[mapping.truth].tolist(), strict=True))
    return np.array([pair in pairs for pair in zip(truth.frame.tolist(), truth.identity.tolist(), strict=True)], np.bool_)


def shares_of(truth: Truth, at: Bool, mapped: Bool) -> F8:
    """(C,) in which share of his frames everybody who crosses a place is mapped; ``at``, ``mapped`` (M,) of his boxes."""
    real = ~truth.distractor
    who = np.unique(truth.identity[at])
    return np.array([mapped[real & (truth.identity == one)].mean() for one in who])


def summary(outcomes: Mapping[PlacesRun, PlacesOutcome]) -> str:
    """A row for each case and filter, summed over the seeds."""
    header = (
        "detections", "clutter", "filter", "false tracks there", "gone", "their boxes", "gone", "elsewhere", "MOTA",
        "people crossing", "lost", "won", "never found again", "boxes there mapped",
    )  # fmt: skip
    jobs = list(outcomes)
    cases = list(dict.fromkeys((job.name, job.rate, job.filter) for job in jobs))
    rows = []
    for name, rate, filter_ in cases:
        some = [outcomes[job] for job in jobs if (job.name, job.rate, job.filter) == (name, rate, filter_)]
        rows.append((name, f"{rate:g}", filter_, *_cells(some)))
    for filter_ in dict.fromkeys(job.filter for job in jobs):
        rows.append(("**all**", "", filter_, *_cells([outcomes[job] for job in jobs if job.filter == filter_])))
    return table(header, rows)


def _cells(some: Sequence[PlacesOutcome]) -> tuple[object, ...]:
    before, after = (sum(one.false[k] for one in some) for k in range(2))
    many, few = (sum(one.frames[k] for one in some) for k in range(2))
    others = " → ".join(str(sum(one.other[k] for one in some)) for k in range(2))
    scores = " → ".join(f"{np.mean([one.MOTA[k] for one in some]):.3f}" for k in range(2))
    boxes = sum(one.boxes for one in some)
    there = " → ".join(f"{sum(one.there[k] for one in some) / max(boxes, 1):.3f}" for k in range(2))
    people = (sum(getattr(one, key) for one in some) for key in ("crossing", "lost", "won", "never"))
    cells = (f"{before} → {after}", f"{gone(before, after):.1%}", f"{many} → {few}", f"{gone(many, few):.1%}")
    return *cells, others, scores, *people, f"{there} of {boxes}"


def gone(before: int, after: int) -> float:
    """Which share of the false tracks is gone."""
    return 1 - after / before if before else 1.0
