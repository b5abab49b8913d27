"""``phdtrack compare``: filters side by side, on the same sequences, detections, clutter and seeds."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.options import Config, Iou, Json, MaxWidth, Preset, SceneFile, Sets
from phdtrack.cli.output import Output, progress
from phdtrack.cli.scoring import check_iou
from phdtrack.errors import InputError

if TYPE_CHECKING:
    from phdtrack.compare import Plan

DOCUMENT, CELLS, EACH, FRAMES = "compare.json", "compare.csv", "runs.csv", "worst"
FILES = (rundir.REPORT, CELLS, EACH, DOCUMENT)
# A comparison takes hours: the pace of the last half minute would tell nothing of its end.
PACE = 24 * 3600.0


def compare(
    sequences: Annotated[
        list[str],
        typer.Argument(metavar="SEQUENCE", help="Folders as MOTChallenge lays them out (seqinfo.ini, gt, det), or videos."),
    ],
    filters: Annotated[
        str,
        typer.Option("--filters", metavar="NAME,...", help="The first is what others are compared to; default: pmb,none."),
    ] = "",
    detections: Annotated[
        str,
        typer.Option(
            "--detections",
            metavar="NAME|FILE,...",
            help="public for det_public/det.txt of each sequence, or [NAME=]FILE; {} in it stands for the sequence's name. "
            "Default: all that a folder has.",
        ),
    ] = "",
    detectors: Annotated[
        str, typer.Option("--detectors", metavar="NAME,...", help="Detectors to run on the videos, each of them once.")
    ] = "",
    clutter: Annotated[
        str, typer.Option("--clutter", metavar="F,...", help="Rates of false alarms to add, Poisson, boxes per frame.")
    ] = "0",
    seeds: Annotated[int, typer.Option("--seeds", metavar="N", min=1, help="How many seeds, from 1.")] = 5,
    variants: Annotated[
        list[str] | None,
        typer.Option(
            "--variant",
            metavar="NAME=SETTINGS",
            help="Another method: the first filter with these settings, as "
            "few=filter.particles_per_target=100,sensor.detection_probability=0.8; "
            "filter.kind and preset may be among them. May be given again.",
        ),
    ] = None,
    preset: Preset = "",
    config: Config = None,
    sets: Sets = None,
    scene: SceneFile = None,
    truth: Annotated[
        str, typer.Option("--truth", metavar="FILE", help="Annotated objects of a video; {} stands for its name.")
    ] = "",
    max_width: MaxWidth = 0,
    iou: Iou = 0.5,
    scores: Annotated[
        str,
        typer.Option("--scores", metavar="NAME,...", help="What to show, as MOTA,IDF1,ms; the CSV files hold everything."),
    ] = "",
    worst: Annotated[
        int,
        typer.Option(
            "--worst", metavar="N", min=0, help="Frames to show of each sequence: N where filters differ most, N worst."
        ),
    ] = 2,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where everything is kept.")] = Path("runs/compare"),
    jobs: Annotated[int, typer.Option("--jobs", metavar="N", min=0, help="Processes; 0: one per core.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Run everything anew, also what is kept already.")] = False,
    json: Json = False,
) -> None:
    """Compare filters: one table, with confidence intervals over seeds, plots, and the frames in which they differ most.

    Every run is kept. The same command again takes up what is there, after Ctrl-C too, and runs only what is missing or
    what is decided by something that has changed: a setting, a file, phdtrack itself. What --scene has taught holds for
    every filter. A run that fails is told in the table, the others go on, and the exit status is 1.
    """
    from phdtrack.cli.compare_results import Results, tell, write
    from phdtrack.compare import check_scores, plan, run, steps, summary
    from phdtrack.compare.worst import worst_frames
    from phdtrack.report import write_run

    result = Output(json)
    ours = (out / DOCUMENT).is_file()
    rundir.check(out, overwrite or ours, FILES)
    check_iou(iou)
    wanted = check_scores(listed(scores))
    made = plan(
        sequences,
        filters=listed(filters),
        detections=listed(detections),
        detectors=listed(detectors),
        clutter=rates(clutter),
        seeds=seeds,
        variants=variants or (),
        preset=preset,
        file=config,
        sets=(*(() if scene is None else (f"scene={scene}",)), *(sets or ())),
        truth=truth,
        max_width=max_width,
        iou=iou,
    )
    directory = rundir.claim(out, True, FILES)
    # Whatever ends this, the next one knows the folder for its own.
    write_run(directory.file(DOCUMENT), {"complete": False})
    compile_for(result, made)
    began, processes = time.perf_counter(), jobs or os.cpu_count() or 1
    with progress("comparing", steps(made), PACE) as advance:
        comparison = run(made, out, processes, anew=overwrite, advance=advance)
    results = Results(comparison, summary(comparison), wanted, time.perf_counter() - began, processes == 1)
    write(results, list(worst_frames(comparison, worst)), directory)
    tell(result, results, directory)
    if comparison.failed:
        raise typer.Exit(1)


def listed(text: str) -> tuple[str, ...]:
    """What stands between commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def rates(text: str) -> tuple[float, ...]:
    """Numbers between commas. Raises `InputError` for what is none."""
    try:
        return tuple(float(part) for part in listed(text))
    except ValueError:
        raise InputError(f"expected numbers as 0,5,10, got {text!r}", where="--clutter") from None


def compile_for(out: Output, plan: Plan) -> None:
    """Kernels that the filters will call, once, before processes would compile them beside each other."""
    from phdtrack.cli.first_use import announced

    for name in dict.fromkeys(method.filter_name for method in plan.methods):
        with announced(out, name):
            continue
