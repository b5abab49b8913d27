"""``phdtrack label``: a page on which a person marks false detections, and births, on frames drawn at random."""

from __future__ import annotations

from typing import Annotated

import typer

from phdtrack.cli.options import (
    Config,
    DetectionsFile,
    Detector,
    Fps,
    FrameSize,
    LabelsFile,
    Mask,
    MaxWidth,
    Recorded,
    Sets,
)
from phdtrack.cli.output import Output, counted
from phdtrack.cli.wanted import Wanted
from phdtrack.errors import InputError


def label(
    source: Recorded = "",
    detections: DetectionsFile = None,
    detector: Detector = "",
    labels: LabelsFile = None,
    frames: Annotated[int, typer.Option("--frames", metavar="N", min=1, help="Frames to look at.")] = 40,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the draw of frames.")] = 0,
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="0: any that is free.")] = 0,
    host: Annotated[
        str, typer.Option("--host", metavar="NAME", help="Address to listen on; others than this machine need a token then.")
    ] = "127.0.0.1",
    suggest: Annotated[bool, typer.Option("--suggest/--no-suggest", help="Look for detections that may be false.")] = True,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    config: Config = None,
    sets: Sets = None,
    frame_size: FrameSize = "",
    fps: Fps = 0.0,
    max_width: MaxWidth = 0,
    mask: Mask = None,
) -> None:
    """Mark false detections and births on frames drawn at random: the page says how. Every click is kept at once.

    Meanwhile a tracker looks for detections that may be false, for a sweep (--no-suggest: it does not). Ctrl-C ends.
    """
    try:
        from phdtrack.label.serve import listen, serve
    except ModuleNotFoundError as error:
        raise InputError(
            f"the page needs the package {error.name}", where="phdtrack label", cure="pip install 'phdtrack[web]'"
        ) from error
    from phdtrack.cli.configured import detector_parameters
    from phdtrack.cli.label_inputs import beside, stills, suggestions, to_label
    from phdtrack.config import load
    from phdtrack.label import LabelStore
    from phdtrack.label.app import label_app
    from phdtrack.label.background import Background, Ready
    from phdtrack.label.hand import clip
    from phdtrack.label.session import Session, sampled
    from phdtrack.label.suggest import NOTHING

    result = Output()
    wanted = Wanted(source, detections, detector, frame_size, fps, max_width, mask)
    file = labels or beside(source, detections)
    found = to_label(wanted, detector_parameters(config, tuple(sets or ())), file, result)
    store = LabelStore.open(file, source or str(detections), found.digest, sampled(found.last, frames, seed))
    numbers = [number for number, _ in store.frames()]
    around = {frame for number in numbers for frame in clip(number, found.last)}
    pictures = stills(found.source, fps, set(numbers), around)
    address = listen(host, port)
    settings, kept = load(config, tuple(sets or ())), file.with_name(file.name.removesuffix(".sqlite") + ".suggestions.json")
    suggester = Background(lambda told: suggestions(found, settings, numbers, kept, told)) if suggest else Ready(NOTHING)
    session = Session(store, found.table, pictures, found.info, suggester)
    progress = store.progress()
    result.say(f"{counted(progress.frames, 'frame')}, {progress.done} of them looked at; the marks are kept in {file}")
    result.say(f"the page: {address.url}   (Ctrl-C ends)")
    if browser:
        import webbrowser

        webbrowser.open(address.url)
    serve(label_app(session), address)
    progress = store.progress()
    result.say(
        f"{progress.done} of {counted(progress.frames, 'frame')} looked at, {progress.false} false, "
        f"{counted(progress.births, 'birth')}: {file}"
    )
