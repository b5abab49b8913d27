"""M09's runs: uniform, learned, and in between, on the second half of a scene; the sweep of the uniform rates."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from phdtrack import config, pipeline
from phdtrack.metrics import Scores, evaluate, first_output_delays
from phdtrack.models.clutter import UniformClutter
from phdtrack.models.learned_scene import ContextClutter
from phdtrack.models.volume import image_volume
from phdtrack.protocols import AnyStages, Birth, Clutter, Model
from phdtrack.reproduce.common import Case, Kept, followed
from phdtrack.reproduce.m09_lessons import BIRTHS, Course, Taught, births_of, everywhere, learn
from phdtrack.reproduce.m09_scenes import halves, stretch
from phdtrack.types import F8, SequenceInfo, Tracks, Truth

PHD = "particle-phd"
# As shipped, births and clutter are spread around each detection; M09's uniform ones are over the image.
UM, IMAGE, GM = "UM", "UM, image", "GM"
ABLATIONS = ("A1", "A2", "A3", "A4", "A5", "A6")
CLUTTER = 0.3
"""The shipped magnitude of clutter a frame."""
# What the sweep of the uniform model goes through: births a time unit and false alarms a frame, around each detection or
# over the image. Around detections it is their ratio alone that counts, but for what it costs to draw births.
LOCAL_SWEEP = tuple((BIRTHS, rate) for rate in (0.1, 1.0, 3.0, 10.0, 30.0))
IMAGE_SWEEP = tuple((births, rate) for births in (0.003, 0.03) for rate in (1.0, 10.0, 100.0))
# Quarters of the stretch, each scored for itself too.
BLOCKS = 4


@dataclass(frozen=True, slots=True)
class Job:
    """One run on the first ``frames`` of the second half of a scene, 0: all; ``rates`` (births, clutter) of a sweep of the
    uniform model, around detections or over the image."""

    course: Course
    run: str
    filter: str = PHD
    rates: tuple[float, float] | None = None
    frames: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a run gave.

    Attributes
    ----------
    scores : of the corrected tracks.     blocks : of the same in a quarter of the stretch each.
    inside, outside : delay of each object found, frames from its first detection to its first confirmed online row; of
        those who are first detected where people enter, and elsewhere.
    seconds : a frame took.
    """

    scores: Scores
    blocks: tuple[Scores, ...]
    inside: tuple[float, ...]
    outside: tuple[float, ...]
    seconds: float


def work(job: Job) -> Outcome:
    """One run, scored."""
    halved = halves(job.course.footage)
    case = stretch(halved.test, 1, job.frames) if job.frames else halved.test
    run = followed(stages_of(job, case.info), case, job.course.seed)
    online = run.online.take(np.flatnonzero(run.online.confirmed))
    inside, outside = delays(case, online, halved.entries)
    scores = evaluate(case.truth, run.corrected, frames=case.info.frames)
    return Outcome(scores, blocks(case, run.corrected), inside, outside, run.seconds)


def blocks(case: Case, tracks: Tracks) -> tuple[Scores, ...]:
    """The scores of each quarter of the stretch for itself."""
    edges = np.linspace(0, case.info.frames, BLOCKS + 1).astype(np.int64)
    found = []
    for begin, end in itertools.pairwise(edges.tolist()):
        part = stretch(case, begin + 1, end)
        rows = np.flatnonzero((tracks.frame > begin) & (tracks.frame <= end))
        some = tracks.take(rows)
        found.append(evaluate(part.truth, replace(some, frame=some.frame - begin), frames=part.info.frames))
    return tuple(found)


def stages_of(job: Job, info: SequenceInfo) -> AnyStages:
    """The stages as shipped, with the births and the clutter of the run."""
    stages = config.build(config.load(), info, job.filter)
    if job.rates is not None:
        return swept(job, info)
    if job.run == UM:
        return stages
    train = halves(job.course.footage).train
    return replace(stages, model=model_of(job.run, stages.model, taught(job.course), train))


def swept(job: Job, info: SequenceInfo) -> AnyStages:
    """The uniform model with the rates of a sweep."""
    assert job.rates is not None
    births, clutter = job.rates
    volume = "local" if job.run == UM else "image"
    sets = (f"birth.rate={births}", f"clutter.rate={clutter}", f"birth.volume={volume}", f"clutter.volume={volume}")
    return config.build(config.load(None, sets), info, job.filter)


def taught(course: Course) -> Taught:
    """What the scene has taught, kept where the footage is."""
    folder = course.footage.folder
    return Kept(learn, Path(folder))(course) if folder else learn(course)


def model_of(run: str, model: Model, scene: Taught, train: Case) -> Model:
    """The model with the births and the clutter of a run [M09 §V]; what is uniform is so over the image.

    UM, image: the shipped magnitudes; A3, A4, A5: magnitudes as learned.
    """
    info = train.info
    volume = image_volume((float(info.width), float(info.height)))
    learned = ContextClutter(scene.clutter.rate, scene.clutter.density)
    estimated = UniformClutter(scene.clutter.rate, volume)
    births = births_of(scene.births, train)
    usual = everywhere(info, BIRTHS), UniformClutter(CLUTTER, volume)
    uniform = everywhere(info, scene.births.rate if scene.births else BIRTHS)
    pairs: dict[str, tuple[Birth, Clutter]] = {
        IMAGE: usual,
        GM: (births, learned),
        "A1": (births, usual[1]),
        "A2": (usual[0], learned),
        "A3": (uniform, estimated),
        "A4": (births, estimated),
        "A5": (uniform, learned),
        "A6": (births_of(scene.hand, train), learned),
    }
    birth, clutter = pairs[run]
    return replace(model, birth=birth, clutter=clutter)


def delays(case: Case, tracks: Tracks, entries: F8) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Frames from first detection to first row of the objects first detected inside and outside of ``entries`` (n, 4)."""
    found = first_output_delays(case.truth, tracks, case.table)
    inside: list[float] = []
    outside: list[float] = []
    for identity, frame, delay in zip(found.identity, found.detected, found.delay, strict=True):
        if np.isfinite(delay):
            within = entered(case.truth, int(identity), int(frame), entries)
            (inside if within else outside).append(float(delay))
    return tuple(inside), tuple(outside)


def entered(truth: Truth, identity: int, frame: int, entries: F8) -> bool:
    """Whether the centre of an object's box lies in one of the ``entries`` in a frame."""
    box = truth.xyxy[(truth.frame == frame) & (truth.identity == identity)][0]
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    return bool(((entries[:, 0] <= x) & (x <= entries[:, 2]) & (entries[:, 1] <= y) & (y <= entries[:, 3])).any())


@dataclass(frozen=True, slots=True)
class Race:
    """UM and GM of one filter, block by block in turn on the same frames, so that what else a machine does slows both."""

    course: Course
    filter: str
    frames: int = 2000


TURN = 50


def race(job: Race) -> tuple[float, float]:
    """Median seconds that a frame took, over blocks, uniform and learned; what is compiled is compiled before."""
    case = halves(job.course.footage).test
    both = [stages_of(Job(job.course, run, job.filter), case.info) for run in (UM, GM)]
    rngs = [np.random.default_rng(job.course.seed) for _ in both]
    states = [pipeline.start(stages, rng) for stages, rng in zip(both, rngs, strict=True)]
    spent: list[list[float]] = [[], []]
    for first in range(1, min(job.frames, case.info.frames) + 1, TURN):
        for which, stages in enumerate(both):
            seconds = []
            for number in range(first, min(first + TURN, case.info.frames + 1)):
                time = (number - 1) / case.info.fps
                states[which], step = pipeline.advance(
                    stages, states[which], case.table.at(number), number, time, rngs[which]
                )
                seconds.append(sum(step.seconds))
            spent[which].append(float(np.mean(seconds)))
    # The first blocks compile, and load what is compiled.
    warm = slice(2, None) if len(spent[0]) > 4 else slice(None)
    uniform, learned = (float(np.median(each[warm])) for each in spent)
    return uniform, learned
