"""``phdtrack track``: from a video or from detections to tracks."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from dataclasses import replace

from phdtrack.addresses import shown
from phdtrack.cli import options as given
from phdtrack.cli.output import Output
from phdtrack.errors import InputError
from phdtrack.run import directory as rundir
from phdtrack.run.directory import RunDirectory
from phdtrack.run.preparation import PreparedRun, claim_directory, is_complete, prepare
from phdtrack.run.requests import RunRequest
from phdtrack.run.video import RunResult
from phdtrack.run.window import Viewer, Window, check_windows


def track(
    request: RunRequest,
    output: Output,
    max_file_size: given.MaxFileSize = "",
    display: given.Display = False,
) -> None:
    """Track the objects in a video, or in a file of detections.

    Without a network or a file, moving regions are tracked: counts are approximate. Better, and
    with the names of classes, is a network, exported once:

    \b
      yolo export model=yolo11n.pt format=onnx
      phdtrack track VIDEO --detector onnx:yolo11n.onnx --classes person,car

    RF-DETR is exported by model.export() in Python. The page "Use your own detector, in your own
    loop" of the documentation lists other networks.

    The run's directory holds tracks.csv (MOTChallenge), detections.csv, states.csv, annotated.mp4,
    report.html and run.json. A video that is cut short is tracked as far as it goes, with a
    warning. Ctrl-C saves partial results; --resume continues, also after a run was killed.
    """
    run_and_print(output, prepare_with_window(request, display=display), request)


def prepare_with_window(request: RunRequest, *, display: bool) -> PreparedRun:
    """The run that a request stands for, shown in a window if the user wants it. Raises
    `InputError` if there can be no window, or nothing in it.
    """
    if not display:
        return prepare(request, command_line())
    check_windows()
    prepared = prepare(request, command_line())
    inputs = prepared.inputs
    if not inputs.pictures:
        cure = "Name the video beside --detections."
        raise InputError("there are no pictures to show", where="--display", cure=cure)
    options = prepared.options
    names: Mapping[int, str] | None = None
    if inputs.names is not None and prepared.classes.apart:
        names = prepared.classes.names
    window = Window("phdtrack")
    viewer = Viewer(window, inputs.info, names, request.output.blur, options.delay)
    # Detections of an earlier run have no pictures.
    return replace(prepared, options=replace(options, viewer=viewer, detect_again=True))


def command_line() -> str:
    """The command line of this process, without passwords."""
    return shlex.join(["phdtrack", *map(shown, sys.argv[1:])])


def run_and_print(output: Output, prepared: PreparedRun, request: RunRequest) -> RunDirectory:
    """Run, print the results, and give the run's directory. Raises what ended the run before its
    time: that decides the exit status.
    """
    directory = claim_directory(prepared, request)
    resume = request.output.resume
    if resume and is_complete(prepared, directory):
        output.say(f"The run in {directory.path} is complete: there is nothing to resume.")
        return directory
    checkpoints = [directory.file(name) for name in (rundir.KNOWN, rundir.DETECTED)]
    if resume and not any(file.exists() for file in checkpoints):
        output.note("There is no checkpoint to resume from: the run begins with the first frame.")
    result = prepared.run(directory, output, resume=resume)
    print_result(output, result, directory)
    if result.stop is not None:
        raise result.stop
    return directory


def print_result(output: Output, result: RunResult, directory: RunDirectory) -> None:
    """Print summary, files, warnings and scores."""
    output.warn(result.unreported)
    output.say(*result.summary, "", *directory.listing())
    if result.scores is not None:
        # Loaded only if there are scores.
        from phdtrack.cli.evaluate import score_table

        output.say()
        score_table(output, {"": result.scores})
    output.document(result.document)
