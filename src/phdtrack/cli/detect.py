"""``phdtrack detect``: only the detections."""

from __future__ import annotations

import json
import time
from typing import Annotated

from phdtrack.addresses import shown
from phdtrack.cli import options as given
from phdtrack.cli.options import option
from phdtrack.cli.output import Output, counted
from phdtrack.config import load
from phdtrack.detect.base import guesses
from phdtrack.detect.moving_regions import reported_kind
from phdtrack.errors import InputError
from phdtrack.run import directory as rundir
from phdtrack.run.inputs import open_inputs, write_detected
from phdtrack.run.requests import DEFAULT_DETECTOR, SourceRequest


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
        str, option("NAMES", "Classes of a network to write, as person,car. Default: all.")
    ] = "",
) -> None:
    """Detect objects in a video and write detections.csv, a MOTChallenge file.

    Detections are written frame by frame, so that Ctrl-C loses nothing.
    """
    request = SourceRequest(source, detector=detector, fps=fps, max_width=max_width, mask=mask)
    sets = list(sets or ())
    if classes:
        sets.append(f"detector.classes={json.dumps(classes)}")
    inputs = open_inputs(request, load(config, sets).values("detector"))
    guessed = guesses(inputs.detector)
    files = {rundir.DETECTIONS: rundir.RUN_FILES[rundir.DETECTIONS]}
    directory = rundir.claim(out, overwrite, files, name=inputs.info.name, inputs=(source, mask))
    file = directory.file(rundir.DETECTIONS)
    frames = 0
    boxes = 0
    began = time.perf_counter()
    try:
        for detected in write_detected(inputs, file, output):
            frames += 1
            boxes += len(detected.detections)
    except InputError:
        if not frames:
            # An empty file would stand for "nothing was detected".
            directory.clear()
        raise
    rate = frames / (time.perf_counter() - began)
    notes = (*guessed, inputs.source.note, inputs.source.problem)
    warnings = list(filter(None, notes))
    output.warn(warnings)
    done = f"{counted(boxes, 'box')} in {counted(frames, 'frame')} by {inputs.described}"
    output.say(f"{done}, {rate:.0f} frames per second: {file}")
    if reports := reported_kind(inputs.described):
        output.say(reports)
    document = {
        "source": shown(source),
        "detector": inputs.described,
        "frames": frames,
        "detections": boxes,
        "frames_per_second": rate,
        "file": str(file),
        "warnings": warnings,
    }
    output.document(document)
