"""``phdtrack simulate`` and ``phdtrack demo``: scenes with known truth, as files, and tracked with
a filter and without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from phdtrack.cli import options as given
from phdtrack.cli.evaluate import score_table
from phdtrack.cli.options import option
from phdtrack.cli.output import Output, counted
from phdtrack.cli.track import command_line
from phdtrack.errors import InputError, did_you_mean, needed
from phdtrack.files import write_text
from phdtrack.formats import write_detections, write_truth
from phdtrack.run import directory as rundir
from phdtrack.run.pipeline_threads import ahead
from phdtrack.run.preparation import prepare
from phdtrack.run.reporter import Reporter
from phdtrack.run.requests import RunRequest, SourceRequest, TrackingRequest
from phdtrack.simulate import (
    NAMED,
    Look,
    Rendered,
    Scene,
    default_detector,
    default_look,
    make_scene,
)
from phdtrack.video import VideoWriter

TRUTH = "gt/gt.txt"
DETECTIONS = "det/det.txt"
SEQINFO = "seqinfo.ini"
VIDEO = "scene.mp4"
FILES = dict.fromkeys((TRUTH, DETECTIONS, SEQINFO, VIDEO), "")
DEMO_TRUTH = "scene_gt.txt"
WITHOUT = "without-filter"
FRAMES = 300
_LOOK = (
    "The look of the video, as wave=0.3: noise, flicker, plants, wave, lamps, shadow or blown."
    " Repeatable."
)


def simulate(
    name: Annotated[str, typer.Argument(metavar="SCENE", help=f"{', '.join(NAMED)}.")],
    output: Output,
    out: given.Out = None,
    overwrite: given.Overwrite = False,
    seed: given.Seed = 0,
    frames: Annotated[int, option("N", "Number of frames. Default: that of the scene.", min=0)] = 0,
    p_detect: Annotated[
        float | None,
        option("P", "Probability that an object is detected. Default: that of the scene."),
    ] = None,
    clutter: Annotated[
        float | None,
        option("F", "False alarms per frame, on average. Default: those of the scene."),
    ] = None,
    places: Annotated[
        int | None, option("N", "Places with persistent false alarms. Default: those of the scene.")
    ] = None,
    jitter: Annotated[
        float | None,
        option("F", "Error of boxes, as a share of their size. Default: that of the scene."),
    ] = None,
    sets: Annotated[
        list[str] | None,
        option("NAME=VALUE", "A setting of the scene, as arrivals=0.8. Repeatable.", "--set"),
    ] = None,
    look: Annotated[
        list[str] | None,
        option("NAME=VALUE", _LOOK),
    ] = None,
    video: given.Video = True,
) -> None:
    """Simulate a scene: truth, detections of it, and a video.

    The files are laid out as MOTChallenge does (gt/gt.txt, det/det.txt, seqinfo.ini), so that
    `phdtrack track --detections` finds size and rate.
    """
    if name not in NAMED:
        raise InputError(
            f"no scene is called {name!r}", where="SCENE", cure=did_you_mean(name, NAMED)
        )
    world = NAMED[name]
    model = default_detector(NAMED[name])
    picture = default_look(name)
    values = {
        "p_detect": p_detect,
        "clutter_rate": clutter,
        "places": places,
        "jitter": jitter,
        "jitter_size": jitter,
    }
    said: dict[str, Any] = {key: value for key, value in values.items() if value is not None}
    picture = replace(picture, **_assigned(look or [], picture, "--look"))
    changes = _assigned(sets or [], world, "--set") | ({"frames": frames} if frames else {})
    scene = make_scene(name, seed, replace(model, **said), **changes)
    if video:
        # Before any file is written.
        needed("av")
        needed("cv2")
    target = rundir.claim(out, overwrite, FILES, name=name)
    info = scene.info
    write_truth(target.file(TRUTH), scene.truth)
    write_detections(target.file(DETECTIONS), scene.detections)
    lines = [
        "[Sequence]",
        f"name={info.name}",
        f"frameRate={info.fps:g}",
        f"seqLength={info.frames}",
    ]
    lines += [f"imWidth={info.width}", f"imHeight={info.height}", ""]
    write_text(target.file(SEQINFO), "\n".join(lines))
    if video:
        _render_video(scene, seed, target.file(VIDEO), picture, output)
    found = {
        "frames": info.frames,
        "objects": len(np.unique(scene.truth.identity)),
        "detections": len(scene.detections),
    }
    files = [str(file) for file in target.written()]
    numbers = ", ".join(counted(count, noun[:-1]) for noun, count in found.items())
    output.say(f"{name}: {numbers}, in {target.path}", *(f"  {file}" for file in files))
    output.document({"scene": name, "seed": seed, **found, "files": files})


def demo(
    output: Output,
    out: Annotated[Path, option("DIR", "Directory to write into.")] = Path("demo-run"),
    overwrite: given.Overwrite = False,
    seed: given.Seed = 7,
) -> None:
    """Render a street and track the people in it, with the filter and without.

    Light flickers, leaves wave and are blown past the camera: the detector takes many of them for
    objects. The directory holds the scene (scene.mp4, scene_gt.txt), the run with the filter, and
    in without-filter the one without.
    """
    rundir.check(out / WITHOUT, overwrite)
    directory = rundir.claim(out, overwrite, {VIDEO: "", DEMO_TRUTH: ""} | rundir.RUN_FILES)
    movie = directory.file(VIDEO)
    truth = directory.file(DEMO_TRUTH)
    scene = make_scene("street", seed, frames=FRAMES, arrivals=0.6)
    write_truth(truth, scene.truth)
    # No blinking lamps: they stay lit for seconds, and what is seen coherently for seconds is an
    # object to any filter.
    look = Look(flicker=0.05, plants=4, wave=0.06, blown=16.0, lamps=0)
    _render_video(scene, seed, movie, look, output)
    output.say(
        f"The scene: {movie}, {scene.info.frames} frames, flickering light, leaves in the wind."
    )
    places = {"with filter": directory, "without": rundir.claim(out / WITHOUT, overwrite)}
    results = {}
    for (title, place), filter_name in zip(places.items(), ("pmb", "none"), strict=True):
        request = RunRequest(
            SourceRequest(str(movie)),
            TrackingRequest(filter_name, seed=seed, truth=truth),
            video_size=0,
            checkpoint_every=0.0,
        )
        result = results[title] = prepare(request, command_line()).run(place, output)
        output.warn(result.unreported)
        if result.stop is not None:
            raise result.stop
    output.say()
    scores = {title: result.scores for title, result in results.items()}
    score_table(output, {title: one for title, one in scores.items() if one is not None})
    output.say("", f"Look at {directory.file(rundir.VIDEO)} and {directory.file(rundir.REPORT)},")
    output.say(f"and at the same without the filter in {out / WITHOUT}.")
    with_filter, without_filter = (result.document for result in results.values())
    output.document({"with_filter": with_filter, "without_filter": without_filter})


def _render_video(scene: Scene, seed: int, path: Path, look: Look, reporter: Reporter) -> None:
    """Write the scene as an mp4 file."""
    info = scene.info
    rng = np.random.default_rng(seed)
    with (
        VideoWriter(path, info.width, info.height, info.fps) as writer,
        reporter.progress("rendering", info.frames) as advance,
        ahead(Rendered(scene, rng, look)) as frames,
    ):
        for frame in frames:
            writer.write(frame.image)
            advance(frame.number)


def _assigned(texts: Sequence[str], settings: Any, option: str) -> dict[str, Any]:
    """The values that texts as "frames=100" give to numeric fields of the record ``settings``."""
    kinds = {field.name: type(getattr(settings, field.name)) for field in fields(settings)}
    numeric = {key: kind for key, kind in kinds.items() if kind in (int, float)}
    found = dict[str, Any]()
    for text in texts:
        key, _, value = (part.strip() for part in text.partition("="))
        where = f"{option} {text}"
        if not value:
            raise InputError("expected NAME=VALUE", where=where)
        if key not in numeric:
            problem = f"this scene has no setting {key} that is a number"
            raise InputError(problem, where=where, cure=did_you_mean(key, numeric))
        try:
            found[key] = numeric[key](value)
        except ValueError:
            if numeric[key] is int:
                expected = "a whole number"
            else:
                expected = "a number"
            raise InputError(f"expected {expected}, got {value!r}", where=where) from None
    return found
