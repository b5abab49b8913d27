"""M09's runs: uniform, learned, and in between, on the second half of a scene; the sweep of the
uniform rates.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from experiments.common import Case, followed
from experiments.delays import first_output_delays
from experiments.m09_lessons import LearnedScene, with_learned
from experiments.m09_scenes import Halves, stretch
from phdtrack import config, pipeline
from phdtrack.metrics import Scores, evaluate
from phdtrack.models import MeasurementBirth
from phdtrack.models.clutter import BoxClutter
from phdtrack.protocols import AnyStages, Model
from phdtrack.types import F8, Tracks, Truth

UM = "UM"
GM = "GM"
ABLATIONS = ("A1", "A2", "A3", "A4", "A5", "A6")
# Of the paper's own filter: births of tracks that know the false alarms; the paper's recursion
# alone; the uniform model with the rates that are best on the first half, and each as printed.
AFTER = "after"
PRINTED = "printed"
TUNED = "UM tuned"
UM_PRINTED = "UM, printed"
TUNED_PRINTED = "UM tuned, printed"
# Those with the extraction that M09 prints.
WORD_BY_WORD = (UM_PRINTED, TUNED_PRINTED, PRINTED)
# Births a second and false alarms a frame in the neighbourhood of a box; their ratio counts most.
SWEEP = tuple((0.01, rate) for rate in (0.1, 1.0, 3.0, 10.0, 30.0))
# Quarters of the frames, each also scored alone.
BLOCKS = 4


@dataclass(frozen=True, slots=True)
class SceneRun:
    """One run on the first ``frames`` of the second half of a scene, 0: all; ``filter``: in place
    of the experiment's own; ``rates`` (births, clutter) of a sweep of the uniform model.
    """

    scene: str
    seed: int
    run: str
    filter: str = ""
    rates: tuple[float, float] | None = None
    frames: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class SceneScores:
    """The result of a run.

    Attributes
    ----------
    scores : of the corrected tracks. blocks : the same for each quarter of the frames.
    live : scores of the confirmed online rows.
    inside, outside : delay of each object found, by its identity: frames from its first detection
        to its first confirmed online row; for objects first detected where people enter, and
        elsewhere.
    """

    scores: Scores
    blocks: tuple[Scores, ...]
    live: Scores
    inside: dict[int, float]
    outside: dict[int, float]


def work(job: tuple[SceneRun, Halves, LearnedScene]) -> SceneScores:
    """One run, scored."""
    one, halved, learned = job
    return score(one, halved, stages_of(one, halved, learned))


def score(one: SceneRun, halved: Halves, stages: AnyStages) -> SceneScores:
    """The scores of a run with these stages on the second half."""
    case = stretch(halved.test, 1, one.frames) if one.frames else halved.test
    run = followed(stages, case, one.seed)
    online = run.online.select(np.flatnonzero(run.online.confirmed))
    inside, outside = delays(case, online, halved.entries)
    scores, live = (
        evaluate(case.truth, tracks, frames=case.info.frames) for tracks in (run.corrected, online)
    )
    return SceneScores(scores, blocks(case, run.corrected), live, inside, outside)


def blocks(case: Case, tracks: Tracks) -> tuple[Scores, ...]:
    """The scores of each quarter of the frames."""
    edges = np.linspace(0, case.info.frames, BLOCKS + 1).astype(np.int64)
    found = []
    for begin, end in itertools.pairwise(edges.tolist()):
        part = stretch(case, begin + 1, end)
        rows = np.flatnonzero((tracks.frame > begin) & (tracks.frame <= end))
        some = tracks.select(rows)
        found.append(
            evaluate(part.truth, replace(some, frame=some.frame - begin), frames=part.info.frames)
        )
    return tuple(found)


def stages_of(one: SceneRun, halved: Halves, scene: LearnedScene) -> AnyStages:
    """The preset ``mot15``, which does not use scores, with the births and the clutter of the
    run.
    """
    info = halved.test.info
    if one.rates is not None:
        births, clutter = one.rates
        sets = (
            f"birth.births_per_detection={25 * births}",
            f"clutter.clutter_per_detection={clutter}",
        )
        return config.build(config.load(None, sets, "mot15"), info)
    stages = config.build(config.load(preset="mot15"), info)
    if one.run == UM:
        return stages
    if one.run in ("A3", "A4", "A5"):
        stages = replace(stages, model=estimated(one.run, stages.model, scene, halved.train))
    births = {GM: scene.births, "A1": scene.births, "A4": scene.births, "A6": scene.hand}
    clutter = scene.clutter if one.run in (GM, "A2", "A5", "A6") else None
    return with_learned(stages, births.get(one.run), clutter, scene.seen)


def estimated(run: str, model: Model, scene: LearnedScene, train: Case) -> Model:
    """Births and clutter that are the same at every scale, with the learned rates [M09 §V]."""
    birth = model.birth
    clutter = model.clutter
    assert isinstance(birth, MeasurementBirth)
    assert isinstance(clutter, BoxClutter)
    # As many per detection as give the learned rate.
    each = train.info.frames / max(len(train.table.frame), 1)
    if run in ("A3", "A5") and scene.births:
        birth = replace(birth, births_per_detection=each * model.rate * scene.births.rate)
    if run in ("A3", "A4"):
        clutter = BoxClutter(each * scene.clutter.rate)
    return replace(model, birth=birth, clutter=clutter)


def delays(case: Case, tracks: Tracks, entries: F8) -> tuple[dict[int, float], dict[int, float]]:
    """Frames from first detection to first row of the objects first detected inside and outside of
    ``entries`` (n, 4).
    """
    found = first_output_delays(case.truth, tracks, case.table)
    inside: dict[int, float] = {}
    outside: dict[int, float] = {}
    for identity, frame, delay in zip(
        found.identity.tolist(), found.detected.tolist(), found.delay, strict=True
    ):
        if np.isfinite(delay):
            within = entered(case.truth, identity, frame, entries)
            (inside if within else outside)[identity] = float(delay)
    return inside, outside


def entered(truth: Truth, identity: int, frame: int, entries: F8) -> bool:
    """True if the centre of an object's box lies in one of the ``entries`` in a frame."""
    box = truth.xyxy[(truth.frame == frame) & (truth.identity == identity)][0]
    x = (box[0] + box[2]) / 2
    y = (box[1] + box[3]) / 2
    return bool(
        (
            (entries[:, 0] <= x)
            & (x <= entries[:, 2])
            & (entries[:, 1] <= y)
            & (y <= entries[:, 3])
        ).any()
    )


TURN = 50


def seconds_per_frame(both: Sequence[AnyStages], case: Case, frames: int) -> tuple[F8, F8]:
    """Seconds per frame in each block with each of two sets of stages, without the detector.

    Both run block by block in turn on the same frames, so that other load slows both.
    """
    rngs = [np.random.default_rng(1) for _ in both]
    states = [pipeline.start(stages, rng) for stages, rng in zip(both, rngs, strict=True)]
    spent: list[list[float]] = [[], []]
    for first in range(1, min(frames, case.info.frames) + 1, TURN):
        for which, stages in enumerate(both):
            seconds = []
            for number in range(first, min(first + TURN, case.info.frames + 1)):
                time = (number - 1) / case.info.fps
                z = case.table.at(number)
                states[which], step = pipeline.advance(
                    stages, states[which], z, number, time, rngs[which]
                )
                seconds.append(sum(step.seconds))
            spent[which].append(float(np.mean(seconds)))
    # The first blocks compile and load kernels.
    warm = slice(2, None) if len(spent[0]) > 4 else slice(None)
    one, other = (np.array(each[warm]) for each in spent)
    return one, other
