"""``phdtrack simulate``: a scene with known truth, laid out as MOTChallenge does, with a video of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phdtrack.cli.options import Json, Overwrite, Seed
from phdtrack.cli.output import Output, counted
from phdtrack.cli.run_directory import claim
from phdtrack.cli.settings import look_settings, scene_settings

if TYPE_CHECKING:
    from phdtrack.simulate import DetectorModel

TRUTH = "gt/gt.txt"
DETECTIONS = "det/det.txt"
SEQINFO = "seqinfo.ini"
VIDEO = "scene.mp4"
FILES = (TRUTH, DETECTIONS, SEQINFO, VIDEO)


def simulate(
    name: Annotated[
        str,
        typer.Argument(
            metavar="SCENE",
            help="street, crossing, occlusion, crowd, corridor, yard, garden, arcade, empty, constant.",
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

    from phdtrack.cli.scene_files import render_video, seqinfo
    from phdtrack.formats import write_detections, write_truth
    from phdtrack.simulate import make_scene

    model = detector_model(name, p_detect, clutter, places, jitter)
    picture = look_settings(name, look or [])
    scene = make_scene(name, seed, model, **scene_settings(name, [*(sets or []), *([f"frames={frames}"] if frames else [])]))
    target, result = claim(out or Path("runs") / name, overwrite, FILES), Output(json)
    write_truth(target.file(TRUTH), scene.truth)
    write_detections(target.file(DETECTIONS), scene.detections)
    target.file(SEQINFO).write_text(seqinfo(scene.info), encoding="utf-8")
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
