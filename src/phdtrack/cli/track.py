"""``phdtrack track``: from a video or from detections to tracks; ``phdtrack detect``: only the
detections.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from phdtrack import config
from phdtrack.cli import options as given
from phdtrack.cli.options import (
    DEFAULT_DETECTOR,
    RunOptions,
    SourceOptions,
    TrackingOptions,
    option,
)
from phdtrack.cli.output import Output, counted
from phdtrack.cli.show_settings import chosen, scene_settings
from phdtrack.config import Settings, load
from phdtrack.errors import InputError, shown
from phdtrack.files import json_value
from phdtrack.formats import read_truth
from phdtrack.run import directory as rundir
from phdtrack.run.detection_log import EVERY, source_of
from phdtrack.run.inputs import frame_range, open_inputs, write_detected
from phdtrack.run.observers import CameraObserver, mover_of
from phdtrack.run.video import Job, about, run


def track(
    source: SourceOptions,
    options: TrackingOptions,
    output: Output,
    to: RunOptions,
    video: given.Video = True,
    video_size: given.VideoSize = 1920,
    camera_motion: Annotated[
        str, option("flow|FILE|none", "A camera that moves: measured, or from a file.")
    ] = "",
    checkpoint_every: given.CheckpointEvery = EVERY,
    frames: given.Frames = "",
) -> None:
    """Track the objects in a video, or in a file of detections.

    The run's directory holds tracks.csv (MOTChallenge), detections.csv, states.csv, annotated.mp4,
    report.html and run.json. A video that is cut short is tracked as far as it goes, with a
    warning. Ctrl-C finishes what was done so far; --resume goes on from there, or from where a run
    was killed.
    """
    settings = chosen(options, scene_settings(to.scene, camera_motion), detector=source.observed_by)
    job = prepare(source, options, settings, to, video=video, frames=frames)
    finish(output, replace(job, every=checkpoint_every, video_size=video_size), to)


def detect(
    source: given.Source,
    output: Output,
    detector: given.Detector = DEFAULT_DETECTOR,
    out: given.Out = None,
    overwrite: given.Overwrite = False,
    config: given.Config = None,
    sets: given.Sets = None,
    fps: given.Fps = 0.0,
    max_width: given.MaxWidth = None,
    mask: given.Mask = None,
    classes: Annotated[
        str, option("NAME,...", "Classes of a network to write; default: all.")
    ] = "",
) -> None:
    """Detect objects in a video and write detections.csv, a MOTChallenge file.

    What was detected is written frame by frame, so that Ctrl-C loses nothing.
    """
    looked = SourceOptions(source, detector=detector, fps=fps, max_width=max_width, mask=mask)
    sets = [*(sets or ()), *([f"detector.classes={json.dumps(classes)}"] if classes else [])]
    inputs = open_inputs(looked, load(config, sets).values("detector"))
    files = {rundir.DETECTIONS: rundir.RUN_FILES[rundir.DETECTIONS]}
    directory = rundir.claim(out, overwrite, files, name=inputs.info.name, inputs=(source, mask))
    counts = list[int]()
    file = directory.file(rundir.DETECTIONS)
    clock = time.perf_counter()
    try:
        counts.extend(write_detected(inputs, file))
    except InputError:
        if not counts:
            # Nothing was looked at: an empty file would be taken for "nothing was detected".
            directory.clear()
        raise
    frames = len(counts)
    boxes = sum(counts)
    rate = len(counts) / (time.perf_counter() - clock)
    warnings = list(filter(None, (inputs.source.note, inputs.source.problem)))
    output.warn(warnings)
    done = f"{counted(boxes, 'box')} in {counted(frames, 'frame')} by {inputs.described}"
    output.say(f"{done}, {rate:.0f} frames per second: {file}")
    document = {
        "source": shown(source),
        "detector": inputs.described,
        "frames": frames,
        "detections": boxes,
    }
    output.document(document | {"frames_per_second": rate, "file": str(file), "warnings": warnings})


def prepare(
    source: SourceOptions,
    options: TrackingOptions,
    settings: Settings,
    to: RunOptions,
    *,
    video: bool,
    frames: str = "",
) -> Job:
    """Everything that a run needs; ``settings`` are those `chosen`, or made of them; ``frames``: as
    `frame_range`. Raises `InputError` where an input cannot be read, files would be replaced
    unasked, or options do not go together."""
    if to.resume and to.overwrite:
        problem = "--resume goes on with a run, and --overwrite begins anew"
        raise InputError(problem, where="--resume", cure="Say one of them.")
    rundir.check(to.out, to.overwrite or to.resume)
    if options.truth is None:
        truth = None
    else:
        truth = read_truth(options.truth)
    if source.detections is None:
        settings = replace(settings, detector=source.observed_by)
    if truth is None:
        last = 0
    else:
        last = int(truth.frame.max(initial=0))
    if source.source and rundir.is_run(Path(source.source)):
        problem = "a video was expected, and this is the directory of a run"
        raise InputError(
            problem,
            where=source.source,
            cure="Name the video, or give detections with --detections.",
        )
    inputs = open_inputs(source, settings.values("detector"), last, frame_range(frames))
    motion = settings.values("camera_motion").get("file")
    files = (source.source, source.detections, source.mask, options.truth, options.config, motion)
    inputs = replace(inputs, files=files)
    settings = config.for_run(settings, endless=not inputs.again)
    kinds = config.build_classes(settings, inputs.info, inputs.names, inputs.classes, moving=True)
    if truth is not None and frames:
        counts = (truth.frame >= inputs.source.first) & (
            truth.frame <= (inputs.source.last or truth.frame)
        )
        frame = truth.frame[counts]
        identity = truth.identity[counts]
        distractor = truth.distractor[counts]
        truth = replace(
            truth, frame=frame, identity=identity, distractor=distractor, xyxy=truth.xyxy[counts]
        )
    stages = kinds.usual
    moving = settings.kind("camera_motion")
    some = {"frames": frames} if frames else {}
    read: dict[str, object] = {
        "detections": _absolute(source.detections),
        **inputs.left_out,
        **some,
    }
    looked: dict[str, object] = {}
    if source.detections is None:
        mask = _absolute(source.mask or "")
        fps = inputs.info.fps
        read = {
            "detector": inputs.described,
            "max_width": inputs.max_width,
            "mask": mask,
            "fps": fps,
        } | some
        network = inputs.described.partition(":")[2]
        read |= {"network": source_of(network)} if network else {}
        if inputs.again and Path(source.source).exists():
            file = source_of(str(Path(source.source).resolve()))
            drawn = source_of(mask) if mask else []
            looked = {
                **read,
                "mask": drawn,
                "file": file,
                "parameters": settings.values("detector"),
            }
    return Job(
        inputs=inputs,
        kinds=kinds,
        configuration=settings.as_dict(),
        read={"source": shown(_absolute(source.source)), **read},
        about=about(inputs.name, options.seed),
        truth=truth,
        video=video,
        looked=looked,
        anew=source.detect_again,
        observers=() if moving == "none" else (CameraObserver(moving),),
        mover=mover_of(settings, inputs, stages.model),
        delay=settings.build("associate").output_delay,
        blur=to.blur,
    )


def _absolute(name: str | Path | None) -> str:
    """The absolute path of what is there; an address, a pattern or - as it is."""
    if name and "://" not in str(name) and Path(name).exists():
        return os.path.realpath(name)
    return str(name)


def finish(output: Output, job: Job, to: RunOptions) -> None:
    """Run the job and say what came of it. Raises what ended it before its time: that decides the
    exit status.
    """
    if to.resume and not job.inputs.again:
        cure = "`phdtrack live` goes on by itself after an interruption."
        raise InputError("the pictures of a camera do not come again", where="--resume", cure=cure)
    directory = rundir.claim(
        to.out, to.overwrite, name=job.inputs.info.name, resume=to.resume, inputs=job.inputs.files
    )
    if to.resume and rundir.completed(directory):
        before = rundir.document_of(directory)
        now = {"seed": job.about.seed, "configuration": job.configuration}
        # What only one of them says differs, too; earlier versions wrote paths as they were given.
        was = before.get("input", {})
        paths = {
            name: _absolute(was[name]) for name in ("source", "detections", "mask") if was.get(name)
        }
        every: dict[str, object] = dict.fromkeys((*was, *job.read))
        before["input"] = every | was | paths
        now["input"] = every | job.read
        if other := _differing(before, json_value(now)):
            problem = f"the run is complete, and differs in {', '.join(other)}"
            cure = "Choose another --out, or say --overwrite in its place."
            raise InputError(problem, where=f"--resume, {directory.path}", cure=cure)
        output.say(f"The run in {directory.path} is complete: there is nothing to go on with.")
        return
    if to.resume and not any(
        directory.file(name).exists() for name in (rundir.KNOWN, rundir.DETECTED)
    ):
        output.note("There is no checkpoint to go on from: the run begins with the first frame.")
    outcome = run(job, directory, resume=to.resume)
    output.warn(outcome.warnings)
    output.say(*outcome.summary, "", *directory.listing())
    if outcome.scores is not None:
        # Scores are loaded only where there are any.
        from phdtrack.cli.evaluate import score_table

        output.say()
        score_table(output, {"": outcome.scores})
    output.document(outcome.document)
    if outcome.stop is not None:
        raise outcome.stop


def _differing(before: Any, now: Any, name: str = "") -> list[str]:
    """The names, as section.name, of values that two documents both have and that are not the
    same.
    """
    if not (isinstance(before, dict) and isinstance(now, dict)):
        if before == now:
            return []
        return [name.removeprefix("configuration.")]
    both = [key for key in now if key in before]
    return [
        one for key in both for one in _differing(before[key], now[key], f"{name}.{key}".strip("."))
    ]
