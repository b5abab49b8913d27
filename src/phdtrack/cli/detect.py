"""``phdtrack detect``: the detections of a video, as a file that `phdtrack track --detections` and other trackers read."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from phdtrack.cli.options import Config, Detector, Fps, Json, Mask, MaxWidth, Overwrite, Sets
from phdtrack.cli.output import Output, counted, progress
from phdtrack.cli.pipeline_threads import ahead
from phdtrack.cli.run_directory import DETECTIONS, claim
from phdtrack.cli.wanted import DEFAULT_DETECTOR, Wanted
from phdtrack.errors import InputError


def detect(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help="Video, folder or pattern of images, camera number.")],
    detector: Detector = DEFAULT_DETECTOR,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where to write; default: runs/SOURCE.")] = None,
    overwrite: Overwrite = False,
    config: Config = None,
    sets: Sets = None,
    fps: Fps = 0.0,
    max_width: MaxWidth = 0,
    mask: Mask = None,
    json: Json = False,
) -> None:
    """Detect objects in a video and write detections.csv, a MOTChallenge file.

    What was detected is written frame by frame, so that Ctrl-C loses nothing.
    """
    from phdtrack.cli.configured import detector_parameters
    from phdtrack.cli.inputs import detected, open_inputs
    from phdtrack.formats import DetectionsWriter

    wanted = Wanted(source, detector=detector, fps=fps, max_width=max_width, mask=mask)
    inputs = open_inputs(wanted, detector_parameters(config, tuple(sets or ())))
    target, result = claim(out or Path("runs") / inputs.info.name, overwrite, (DETECTIONS,)), Output(json)
    frames = boxes = 0
    clock = time.perf_counter()
    with DetectionsWriter(target.file(DETECTIONS)) as writer, progress("detecting", inputs.info.frames) as advance:
        try:
            with ahead(inputs.source) as pictures, ahead(detected(inputs.detector, pictures)) as looked:
                for frame, found, _ in looked:
                    writer.append(frame.number, found)
                    frames, boxes = frames + 1, boxes + len(found)
                    advance(frames)
        except InputError:
            if not frames:
                # Nothing was looked at: an empty file would be taken for "nothing was detected".
                target.clear()
            raise
    seconds = time.perf_counter() - clock
    warnings = [sentence for sentence in (inputs.source.note, inputs.source.problem) if sentence]
    for sentence in warnings:
        result.warn(sentence)
    rate = frames / seconds if seconds > 0 else 0.0
    done = f"{counted(boxes, 'box')} in {counted(frames, 'frame')} by {inputs.described}"
    result.say(f"{done}, {rate:.0f} frames per second: {target.file(DETECTIONS)}")
    result.document(
        {
            "source": source,
            "detector": inputs.described,
            "frames": frames,
            "detections": boxes,
            "frames_per_second": rate,
            "file": str(target.file(DETECTIONS)),
            "warnings": warnings,
        }
    )
