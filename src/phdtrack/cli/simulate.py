"""``phdtrack simulate`` and ``phdtrack demo``: scenes with known truth, as files, and tracked with a filter and without."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.options import Json, Overwrite, Seed, Wanted
from phdtrack.cli.output import Output, counted, progress
from phdtrack.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from phdtrack.simulate import DetectorModel, Look, Scene

TRUTH = "gt/gt.txt"
DETECTIONS = "det/det.txt"
SEQINFO = "seqinfo.ini"
VIDEO = "scene.mp4"
FILES = (TRUTH, DETECTIONS, SEQINFO, VIDEO)
# The scene of the demonstration.
SCENE = "street"
FRAMES = 300
DEMO_TRUTH = "scene_gt.txt"
WITHOUT = "without-filter"
ARRIVALS = 0.6
FLICKER, PLANTS, WAVE, BLOWN = 0.05, 4, 0.06, 16.0
# No blinking lamps: they stay lit for seconds, and what is seen coherently for seconds is an object to any filter.
LAMPS = 0


def simulate(
    name: Annotated[
        str,
        typer.Argument(
            metavar="SCENE",
            help="street, crossing, occlusion, crowd, corridor, yard, garden, arcade, empty.",
        ),
    ],
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where to write; default: runs/SCENE.")] = None,
    overwrite: Overwrite = False,
    seed: Seed = 0,
    frames: Annotated[int, typer.Option("--frames", metavar="N", min=0, help="Number of frames; 0: as the scene has.")] = 0,
    p_detect: Annotated[float | None, typer.Option("--p-detect", metavar="P", help="Detection probability.")] = None,
    clutter: Annotated[float | None, typer.Option("--clutter", metavar="F", help="Poisson false alarms per frame.")] = None,
    places: Annotated[int | None, typer.Option("--places", metavar="N", help="Places with persistent false alarms.")] = None,
    jitter: Annotated[
        float | None, typer.Option("--jitter", metavar="F", help="Error of boxes, as a fraction of their size.")
    ] = None,
    sets: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Another setting of the scene, as arrivals=0.8.")
    ] = None,
    look: Annotated[
        list[str] | None,
        typer.Option("--look", metavar="NAME=VALUE", help="How the video looks: wave=0.3, lamps=8, noise, flicker, …"),
    ] = None,
    video: Annotated[bool, typer.Option("--video/--no-video", help="Render the scene as a video, too.")] = True,
    json: Json = False,
) -> None:
    """Simulate a scene: truth, detections of it, and a video.

    The files are laid out as MOTChallenge does (gt/gt.txt, det/det.txt, seqinfo.ini), so that `phdtrack track --detections`
    finds size and rate.
    """
    import numpy as np

    from phdtrack.formats import write_detections, write_truth
    from phdtrack.simulate import make_scene

    model = detector_model(name, p_detect, clutter, places, jitter)
    picture = look_settings(name, look or [])
    scene = make_scene(name, seed, model, **scene_settings(name, [*(sets or []), *([f"frames={frames}"] if frames else [])]))
    target, result = rundir.claim(out or Path("runs") / name, overwrite, FILES), Output(json)
    write_truth(target.file(TRUTH), scene.truth)
    write_detections(target.file(DETECTIONS), scene.detections)
    target.file(SEQINFO).write_text(seqinfo(scene), encoding="utf-8")
    if video:
        render_video(scene, np.random.default_rng(seed), target.file(VIDEO), picture)
    objects = len(set(scene.truth.identity.tolist()))
    parts = [(scene.info.frames, "frame"), (objects, "object"), (len(scene.detections), "detection")]
    result.say(f"{name}: {', '.join(counted(*part) for part in parts)}, in {target.path}")
    files = [str(file) for file in target.written()]
    result.say("\n".join(f"  {file}" for file in files))
    result.document(
        {
            "scene": name,
            "seed": seed,
            "frames": scene.info.frames,
            "objects": objects,
            "detections": len(scene.detections),
            "files": files,
        }
    )


def detector_model(
    name: str, p_detect: float | None, clutter: float | None, places: int | None, jitter: float | None
) -> DetectorModel | None:
    """The scene's own detector with what the options change; None for a name that `make_scene` will refuse."""
    from phdtrack.simulate import NAMED, default_detector

    if name not in NAMED:
        return None
    own = default_detector(NAMED[name])
    return replace(
        own,
        p_detect=own.p_detect if p_detect is None else p_detect,
        clutter_rate=own.clutter_rate if clutter is None else clutter,
        places=own.places if places is None else places,
        jitter=own.jitter if jitter is None else jitter,
        jitter_size=own.jitter_size if jitter is None else jitter,
    )


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where to write.")] = Path("demo-run"),
    overwrite: Overwrite = False,
    seed: Seed = 7,
    json: Json = False,
) -> None:
    """Render a street and track the people in it, with the filter and without.

    Light flickers, leaves wave and are blown past the camera: the detector takes many of them for objects.
    The directory holds the scene (scene.mp4, scene_gt.txt), the run with the filter, and in without-filter the one
    without.
    """
    import numpy as np

    from phdtrack.cli.evaluate import score_table
    from phdtrack.cli.job import announced, run
    from phdtrack.cli.settings import Choice, chosen
    from phdtrack.cli.track import command_line, prepare
    from phdtrack.formats import write_truth
    from phdtrack.simulate import Look, make_scene

    result = Output(json)
    rundir.check(out / WITHOUT, overwrite)
    directory = rundir.claim(out, overwrite, (VIDEO, DEMO_TRUTH, *rundir.RUN_FILES))
    scene = make_scene(SCENE, seed, frames=FRAMES, arrivals=ARRIVALS)
    write_truth(directory.file(DEMO_TRUTH), scene.truth)
    look = Look(flicker=FLICKER, plants=PLANTS, wave=WAVE, blown=BLOWN, lamps=LAMPS)
    render_video(scene, np.random.default_rng(seed), directory.file(VIDEO), look)
    result.say(f"The scene: {directory.file(VIDEO)}, {scene.info.frames} frames, flickering light, leaves in the wind.")
    outcomes = []
    for filter_name, place in (("pmb", directory), ("none", rundir.claim(out / WITHOUT, overwrite))):
        choice = Choice(filter_name, seed=seed, truth=directory.file(DEMO_TRUTH))
        job = prepare(Wanted(str(directory.file(VIDEO))), choice, chosen(choice), command_line(), video=True)
        with announced(result):
            outcome = run(job, place)
        for warning in outcome.warnings:
            result.warn(warning)
        if outcome.stop is not None:
            raise outcome.stop
        outcomes.append(outcome)
    result.say()
    pairs = zip(("with filter", "without"), outcomes, strict=True)
    score_table(result, [(title, outcome.scores) for title, outcome in pairs if outcome.scores is not None])
    result.say()
    result.say(f"Look at {directory.file(rundir.VIDEO)} and {directory.file(rundir.REPORT)},")
    result.say(f"and at the same without the filter in {out / WITHOUT}.")
    result.document({"with_filter": outcomes[0].document, "without_filter": outcomes[1].document})


def render_video(scene: Scene, rng: np.random.Generator, path: Path, look: Look | None = None) -> None:
    """Write the scene as an mp4 file; ``look`` None for the renderer's own."""
    from phdtrack.cli.inputs import ahead
    from phdtrack.simulate import render
    from phdtrack.video import VideoWriter

    info = scene.info
    with (
        VideoWriter(path, info.width, info.height, info.fps) as writer,
        progress("rendering", info.frames) as advance,
        ahead(render(scene, rng, look)) as frames,
    ):
        for frame in frames:
            writer.write(frame.image)
            advance(frame.number)


def seqinfo(scene: Scene) -> str:
    """The text of seqinfo.ini."""
    info = scene.info
    about = {"name": info.name, "frameRate": f"{info.fps:g}", "seqLength": info.frames}
    size = {"imWidth": info.width, "imHeight": info.height}
    return "\n".join(["[Sequence]", *(f"{key}={value}" for key, value in (about | size).items()), ""])


def scene_settings(name: str, assignments: Sequence[str]) -> dict[str, int | float]:
    """The settings of scene ``name`` that ``assignments`` ("frames=100") give; empty for a scene that does not exist.

    Raises
    ------
    InputError : not of the form NAME=VALUE, no number setting has this name, or the value is no number of its type.
    """
    from phdtrack.simulate import NAMED

    if name not in NAMED:
        return {}
    world = NAMED[name]
    types = {f.name: type(getattr(world, f.name)) for f in fields(world)}
    numeric = {key: kind for key, kind in types.items() if kind in (int, float)}
    return dict(_assigned(text, numeric, "--set") for text in assignments)


def look_settings(name: str, assignments: Sequence[str]) -> Look:
    """The look of scene ``name`` with what ``assignments`` ("wave=0.2") change.

    Raises
    ------
    InputError : not of the form NAME=VALUE, there is no such setting, or the value is no number of its type, or impossible.
    """
    from phdtrack.simulate import default_look

    look = default_look(name)
    numeric: dict[str, type[int] | type[float]] = {f.name: type(getattr(look, f.name)) for f in fields(look)}
    # Each is a number of its own field's type, which a dictionary of all of them cannot say.
    changed: dict[str, Any] = dict(_assigned(text, numeric, "--look") for text in assignments)
    return replace(look, **changed)


def _assigned(text: str, numeric: dict[str, type[int] | type[float]], option: str) -> tuple[str, int | float]:
    key, equals, value = (part.strip() for part in text.partition("="))
    where = f"{option} {text}"
    if not equals or not key:
        raise InputError("expected NAME=VALUE", where=where)
    if key not in numeric:
        close = difflib.get_close_matches(key, numeric, 1)
        cure = f"Did you mean {close[0]}?" if close else f"There are {', '.join(numeric)}."
        raise InputError(f"this scene has no setting {key} that is a number", where=where, cure=cure)
    kind = numeric[key]
    try:
        return key, kind(value)
    except ValueError:
        wanted = "a whole number" if kind is int else "a number"
        raise InputError(f"expected {wanted}, got {value!r}", where=where) from None
