"""Scenes learned again while tracking: what a camera would gain whose false alarms come from other
places by night than by day.

A stream of a day, a night, a day and a night, with other places of false alarms by night. What was
learned unattended from the first two is used on the last two, whose online rows are scored. Boxes
without scores are simulated; those of the change detector are of rendered gardens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from experiments.claims import decided
from experiments.common import Case, Options, detections_in, in_parallel, table, with_error, write
from experiments.m09_scenes import stretch
from phdtrack import config, pipeline
from phdtrack.label.learn_scene import SceneTraining
from phdtrack.metrics import Scores, evaluate
from phdtrack.multiclass import ClassSettings
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import counted
from phdtrack.run.scene_pass import learning_flicker
from phdtrack.scene import write_scene
from phdtrack.simulate import Rendered, default_look, make_scene
from phdtrack.types import Detections, DetectionTable, Tracks, Truth

SEEDS = 3
# Frames of a day or a night.
FRAMES = 500
# Scene, and whether it is rendered for the change detector.
WORLDS = {"street, boxes without scores": ("street", False), "garden, change": ("garden", True)}
NONE = "none"
FLICKER = "as live"
ONE = "day's"
BIRTHS = "births"
ANEW = "anew"
TWO = "two"
# What the second scene, and what learning again is worth.
WORTH = ((TWO, ONE), (TWO, BIRTHS), (ANEW, BIRTHS), (BIRTHS, NONE))
COUNTS = ("misses", "false_positives", "false_tracks")
# Phases of the stream.
PHASES = 4


@dataclass(frozen=True, slots=True)
class StreamJob:
    """A stream of a world, with a seed and the frames of a phase."""

    world: str
    seed: int
    frames: int


def stream(job: StreamJob) -> Case:
    """The detections and the truth of day, night, day and night."""
    name, is_rendered = WORLDS[job.world]
    scenes = [
        whole(name, seed, job.frames, is_rendered) for seed in (2 * job.seed, 2 * job.seed + 1)
    ]
    parts = [
        stretch(scenes[k % 2], 1 + (k // 2) * job.frames, (1 + k // 2) * job.frames)
        for k in range(PHASES)
    ]
    return joined(parts)


def whole(name: str, seed: int, frames: int, is_rendered: bool) -> Case:
    """Both days or both nights: the places of false alarms are those of the seed."""
    scene = make_scene(name, seed, frames=2 * frames)
    found = scene.detections
    if is_rendered:
        found = detections_in(Rendered(scene, np.random.default_rng(seed), default_look(name)))
    return Case(name, scene.info, scene.truth, found)


def joined(parts: Sequence[Case]) -> Case:
    """The parts one after the other, with identities of their own."""
    offsets = np.cumsum([0, *(part.info.frames for part in parts)]).tolist()
    most = 1 + max(int(part.truth.identity.max(initial=0)) for part in parts)
    truth = [part.truth for part in parts]
    found = [part.table for part in parts]
    return Case(
        parts[0].name,
        replace(parts[0].info, frames=offsets[-1]),
        Truth(
            np.concatenate([one.frame + at for one, at in zip(truth, offsets, strict=False)]),
            np.concatenate([one.identity + k * most for k, one in enumerate(truth)]),
            np.concatenate([one.xyxy for one in truth]),
            np.concatenate([one.distractor for one in truth]),
        ),
        DetectionTable(
            np.concatenate([one.frame + at for one, at in zip(found, offsets, strict=False)]),
            Detections.of(
                np.concatenate([one.detections.xyxy for one in found]),
                np.concatenate([one.detections.confidence for one in found]),
            ),
        ),
    )


def settings(world: str, *sets: str) -> config.Settings:
    """The defaults for the detector of a world, with these changes."""
    return config.load(None, sets, "background" if WORLDS[world][1] else "")


def learned(world: str, case: Case, frames: range, folder: Path) -> Path:
    """The scene that `phdtrack learn --clutter unattended` learns from these frames."""
    classes = ClassSettings(config.build(settings(world), case.info))
    trained = SceneTraining(
        source=case.name,
        info=case.info,
        table=case.table,
        stretch=frames,
        classes=classes,
        seed=1,
        marks=None,
        labels=folder,
        advance=lambda _: None,
        background=WORLDS[world][1],
    ).train("tracks", "unattended")
    file = folder / f"{frames.start}.json"
    write_scene(file, trained.scene)
    return file


def work(job: StreamJob) -> dict[str, Scores]:
    """The scores of all runs on the second day and night."""
    case = stream(job)
    one = job.frames
    usual = config.build(settings(job.world), case.info)
    with TemporaryDirectory() as folder:

        def of(first: int, last: int) -> Path:
            return learned(job.world, case, range(first, last + 1), Path(folder))

        def knowing(file: Path, *sets: str) -> AnyStages:
            return config.build(settings(job.world, f"scene.file={file}", *sets), case.info)

        files = [of(1, one), of(one + 1, 2 * one)]
        scenes = [knowing(file) for file in files]
        births = knowing(files[0], 'scene.use=["births"]')
        half = one // 2
        # At every half phase from the last half of the first night on, what the one before taught.
        again = {k: knowing(of((k - 1) * half + 1, k * half)) for k in range(4, 8)}
    size = float(case.info.width), float(case.info.height)
    by_frame: Mapping[str, Callable[[int], AnyStages]] = {
        NONE: lambda _: usual,
        FLICKER: lambda _: learning_flicker(ClassSettings(usual), size).usual,
        ONE: lambda frame: usual if frame <= one else scenes[0],
        BIRTHS: lambda frame: usual if frame <= one else births,
        ANEW: lambda frame: again.get((frame - 1) // half, usual),
        TWO: lambda frame: usual if frame <= 2 * one else scenes[(frame - 1) // one % 2],
    }
    if not WORLDS[job.world][1]:
        by_frame = {name: each for name, each in by_frame.items() if name != FLICKER}
    return {name: followed(case, stages_at, 2 * one) for name, stages_at in by_frame.items()}


def followed(case: Case, stages_at: Callable[[int], AnyStages], before: int) -> Scores:
    """The scores of the confirmed online rows after the frame ``before``, with the stages of each
    frame.
    """
    rng = np.random.default_rng(1)
    state = pipeline.start(stages_at(1), rng)
    rows = []
    fixed = stages_at(1)
    for number in range(1, case.info.frames + 1):
        stages = stages_at(number)
        fixed = fixed if stages == fixed else stages
        time = (number - 1) / case.info.fps
        state, step = pipeline.advance(fixed, state, case.table.at(number), number, time, rng)
        rows.append(step.tracks)
    rows.append(pipeline.flush(fixed, state))
    tracks = Tracks.concatenate(rows)
    late = tracks.select(np.flatnonzero(tracks.confirmed & (tracks.frame > before)))
    rest = stretch(case, before + 1, case.info.frames)
    return evaluate(rest.truth, replace(late, frame=late.frame - before), frames=rest.info.frames)


def main(options: Options) -> Path:
    """Run everything and write day_night.md."""
    seeds = options.number(SEEDS, 1)
    frames = 200 if options.quick else FRAMES
    worlds = [*WORLDS][: 1 if options.quick else None]
    jobs = [StreamJob(world, seed, frames) for world in worlds for seed in range(1, seeds + 1)]
    found = dict(zip(jobs, in_parallel(work, jobs, "day_night", options), strict=True))
    results = []
    worth = []
    for world in worlds:
        each = [found[job] for job in jobs if job.world == world]
        today = FLICKER if FLICKER in each[0] else NONE
        for run in each[0]:
            scores = [one[run] for one in each]
            cells = [
                with_error([getattr(one, key) for one in scores], digits)
                for key, digits in (("MOTA", 3), *((key, 0) for key in COUNTS))
            ]
            results.append((world, run, *cells, *compared(each, run, today)))
        pairs = (*WORTH, (TWO, today), (ANEW, today))
        worth += [(world, f"{a} less {b}", *compared(each, a, b)) for a, b in dict.fromkeys(pairs)]
    header = (
        "MOTA",
        "misses",
        "false boxes",
        "false tracks",
        "MOTA less that of the reference",
        "",
    )
    return write(
        "day_night",
        options,
        results=table(("stream", "scenes", *header), results),
        worth=table(("stream", "", "MOTA", ""), worth),
        seeds=counted(seeds, "seed"),
        frames=frames,
    )


def compared(found: Sequence[Mapping[str, Scores]], run: str, other: str) -> tuple[str, str]:
    """The differences in MOTA of two runs, and whether they are better in a word."""
    if run == other:
        return "–", "–"
    gaps = [one[run].MOTA - one[other].MOTA for one in found]
    word = {True: "better", False: "worse", None: "within its error"}[decided(gaps)]
    return with_error(gaps, sign="+"), word
