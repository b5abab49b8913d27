"""``phdtrack demo``: the main job on a rendered scene, with the filter and without, and both scores side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.options import Json, Overwrite, Seed
from phdtrack.cli.output import Output
from phdtrack.cli.wanted import Wanted

SCENE = "street"
FRAMES = 300
VIDEO = "scene.mp4"
TRUTH = "scene_gt.txt"
WITHOUT = "without-filter"
ARRIVALS = 0.6
FLICKER, PLANTS, WAVE, BLOWN = 0.05, 4, 0.06, 16.0
# No blinking lamps: they stay lit for seconds, and what is seen coherently for seconds is an object to any filter.
LAMPS = 0


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

    from phdtrack.cli.configured import Choice, chosen, prepare
    from phdtrack.cli.first_use import announced
    from phdtrack.cli.job import run
    from phdtrack.cli.scene_files import render_video
    from phdtrack.cli.scoring import score_table
    from phdtrack.cli.track import command_line
    from phdtrack.formats import write_truth
    from phdtrack.simulate import Look, make_scene

    result = Output(json)
    rundir.check(out / WITHOUT, overwrite)
    directory = rundir.claim(out, overwrite, (VIDEO, TRUTH, *rundir.RUN_FILES))
    scene = make_scene(SCENE, seed, frames=FRAMES, arrivals=ARRIVALS)
    write_truth(directory.file(TRUTH), scene.truth)
    look = Look(flicker=FLICKER, plants=PLANTS, wave=WAVE, blown=BLOWN, lamps=LAMPS)
    render_video(scene, np.random.default_rng(seed), directory.file(VIDEO), look)
    result.say(f"The scene: {directory.file(VIDEO)}, {scene.info.frames} frames, flickering light, leaves in the wind.")
    outcomes = []
    for filter_name, place in (("pmb", directory), ("none", rundir.claim(out / WITHOUT, overwrite))):
        choice = Choice(filter_name, seed=seed, truth=directory.file(TRUTH))
        job = prepare(Wanted(str(directory.file(VIDEO))), choice, chosen(choice), command_line(), video=True)
        with announced(result, filter_name):
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
