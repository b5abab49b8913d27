"""``phdtrack compare``: filters side by side, on the same sequences, detections, clutter and seeds.

It leaves tables on the terminal, compare.csv, runs.csv, compare.json and report.html.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import typer

from phdtrack import compare as comparing
from phdtrack.cli import options as given
from phdtrack.cli.options import option
from phdtrack.cli.output import PACE, Output, counted, without_numbers
from phdtrack.cli.track import command_line
from phdtrack.compare import Comparison, Plan
from phdtrack.compare.results import Results
from phdtrack.compare.runs import ComparedRun
from phdtrack.config import build_classes
from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.report import About, write_run
from phdtrack.report.pages import lines
from phdtrack.run import directory as rundir
from phdtrack.run.choices import only_classes, scene_settings
from phdtrack.run.directory import RunDirectory
from phdtrack.run.preparation import begun_run
from phdtrack.run.requests import DEFAULT_APPEARANCE, ReadingRequest
from phdtrack.tracker import Tracker

DOCUMENT = "compare.json"
CELLS = "compare.csv"
EACH = "runs.csv"
FILES = {
    rundir.REPORT: "the tables, as a page",
    CELLS: "every score with its interval, a row for each line of the table",
    EACH: "every run, and the folder it is kept in",
    DOCUMENT: "",
}
MOST_WARNINGS = 12
_VARIANT = (
    "Another method, as few=filter.history=5,preset=m09: the first filter with these settings."
    " Repeatable."
)
SETS = "Sets of the folders, or files with {} in place of the sequence. Default: all sets."
_LOOKS = (
    "Tell objects apart by how they look: by their colours, onnx:FILE, or none. Default:"
    f" {DEFAULT_APPEARANCE}."
)


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """Options of what to compare on the sequences."""

    filters: Annotated[
        str, option("NAMES", "Others are compared to the first one. Default: pmb,none.")
    ] = ""
    detections: Annotated[
        str,
        option("NAMES", SETS),
    ] = ""
    detectors: Annotated[str, option("NAMES", "Detectors to run on the videos, each once.")] = ""
    clutter: Annotated[str, option("RATES", "False alarms to add, boxes per frame, as 0,5,10.")] = (
        "0"
    )
    seeds: Annotated[int, option("N", "How many seeds", min=1)] = 5
    variants: Annotated[list[str] | None, option("NAME=SETTINGS", _VARIANT, "--variant")] = None
    preset: given.Preset = ""
    config: given.Config = None
    sets: given.Sets = None
    scene: given.SceneFile = None
    truth: Annotated[
        str, option("FILE", "Annotated objects of a video; {} stands for its name.")
    ] = ""
    labelled: given.Labelled = ""
    reading: ReadingRequest = field(default_factory=ReadingRequest)
    max_width: given.MaxWidth = None
    appearance: Annotated[str, option("NAME", _LOOKS)] = ""
    iou: given.Iou = 0.5
    classes: given.Classes = ""
    max_file_size: given.MaxFileSize = ""

    def plan(self, sequences: list[str]) -> Plan:
        """Every sequence with these detections, methods, rates of clutter and seeds. Raises
        `InputError` for mistakes.
        """
        try:
            rates = tuple(float(part) for part in listed(self.clutter))
        except ValueError:
            raise InputError(
                f"expected numbers as 0,5,10, got {self.clutter!r}", where="--clutter"
            ) from None
        wanted = comparing.Request(
            sequences,
            filters=listed(self.filters),
            detections=listed(self.detections),
            detectors=listed(self.detectors),
            max_width=self.max_width,
            truth=self.truth,
            labelled=self.labelled,
            reading=self.reading,
            appearance=self.appearance,
            clutter=rates,
            seeds=self.seeds,
            variants=self.variants or (),
            preset=self.preset,
            file=self.config,
            sets=(*scene_settings(self.scene), *(self.sets or ()), *only_classes(self.classes)),
            iou=self.iou,
        )
        return comparing.plan(wanted)


def compare(
    sequences: Annotated[
        list[str],
        typer.Argument(metavar="SEQUENCE...", help="Folders as MOTChallenge's, or videos."),
    ],
    output: Output,
    options: PlanOptions,
    scores: Annotated[
        str, option("NAMES", "Scores to show, as MOTA,IDF1,ms; the CSV files hold all.")
    ] = "",
    out: Annotated[Path, option("DIR", "Directory in which everything is kept.")] = Path(
        "runs/compare"
    ),
    jobs: Annotated[int, option("N", "Processes at once. Default: one per core.", min=0)] = 0,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Run everything anew, also what is kept already.")
    ] = False,
) -> None:
    """Compare filters: one table, with confidence intervals over seeds.

    Every run is kept. The same command again takes up what is there, after Ctrl-C too, and runs
    only what is missing or what is decided by something that has changed: a setting, a file,
    phdtrack itself. What --scene has taught holds for every filter. A run that fails is named in
    the table, the others go on, and the exit status is 1.
    """
    folder = ResultFolder(out, DOCUMENT, FILES, overwrite)
    wanted = comparing.check_scores(listed(scores))
    made = options.plan(sequences)
    directory = folder.claim()
    names = ", ".join(method.name for method in made.methods)
    begun = begun_run(f"Comparison of {names}", command_line(), made.seeds[0])
    clock = time.perf_counter()
    comparison = run_plan(made, folder, jobs, output, "comparing")
    begun = replace(begun, seconds=time.perf_counter() - clock)
    finish(output, comparison, wanted, directory, begun, in_turn=processes(jobs) == 1)
    if comparison.failed:
        raise typer.Exit(1)


class ResultFolder:
    """A folder for a comparison's runs, which the same command takes up again.

    Parameters
    ----------
    path : the folder.
    document : the file that tells that the folder is one of this command.
    files : what it writes besides, with what each is.
    overwrite : whether files of anything else may be replaced, and kept runs are run anew.

    Raises
    ------
    InputError : the folder has files of something else.
    """

    def __init__(
        self, path: Path, document: str, files: Mapping[str, str], overwrite: bool
    ) -> None:
        ours = (path / document).is_file()
        rundir.check(path, overwrite or ours, files)
        self.path = path
        self.anew = overwrite
        self._document = document
        self._files = files

    def claim(self) -> RunDirectory:
        """The directory, from now on this command's."""
        directory = rundir.claim(self.path, True, self._files)
        # Whatever ends this, the next one knows the folder for its own.
        write_run(directory.file(self._document), {"complete": False})
        return directory


def processes(jobs: int) -> int:
    """How many processes ``jobs`` stand for; 0: one for each core.

    Parameters
    ----------
    jobs : as the user says it.
    """
    return jobs or os.cpu_count() or 1


def run_plan(made: Plan, folder: ResultFolder, jobs: int, output: Output, title: str) -> Comparison:
    """Do what is missing of a plan, with a bar that shows how far it is.

    Parameters
    ----------
    made, folder : the plan, and where its runs are kept.
    jobs : processes at once; 0: one for each core.
    output, title : shows the bar, under this title.
    """
    # Once, before several processes would each compile them.
    info = made.cases[0].info
    for method in {method.settings.kind("filter"): method for method in made.methods}.values():
        Tracker(stages=build_classes(method.settings, info, moving=True), fps=info.fps).warm_up()
    with output.progress(title, comparing.steps(made), PACE) as advance:
        return comparing.run(made, folder.path, processes(jobs), anew=folder.anew, advance=advance)


def listed(text: str) -> tuple[str, ...]:
    """The words between commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def finish(
    out: Output,
    comparison: Comparison,
    wanted: Sequence[str],
    directory: RunDirectory,
    begun: About,
    *,
    in_turn: bool,
) -> None:
    """Write everything but the runs, which are there already, and say who is ahead of the first
    method by how much.
    """
    found = Results.of(comparison, wanted)
    notes = found.notes(in_turn=in_turn)
    warnings = doubts(comparison)
    found.write_cells(directory.file(CELLS))
    found.write_runs(directory.file(EACH))
    write_text(
        directory.file(rundir.REPORT), found.page(replace(begun, warnings=warnings, notes=notes))
    )
    document = {
        "complete": True,
        "command": begun.command,
        "runs": len(comparison.results),
        "reused": comparison.reused,
        "outdated": comparison.outdated,
        "failed": [{"run": str(run), "reason": reason} for run, reason in comparison.failed],
        "seconds": begun.seconds,
        "warnings": warnings,
        "rows": found.rows,
        "over_sequences": found.means,
        "directory": str(comparison.folder),
    }
    write_run(directory.file(DOCUMENT), document)
    out.warn(warnings)
    out.table(*found.table(found.rows), words=(0, 1, 3))
    if apart := [row for row in comparing.widest(found.rows) if row.ahead]:
        out.say("", "* The best on the same input, and what chance does not tell apart from it.")
        out.say("", f"Difference to {comparison.plan.methods[0].name}, seed by seed:")
        out.table(*found.table(apart, ahead=True), words=(0, 1, 3))
    if found.means:
        out.say("", "Mean over the sequences, each with the same weight, ± 95 % over sequences:")
        out.table(*found.table(found.means), words=(0, 1, 3))
        apart = [row for row in found.means if row.ahead]
        out.say("", f"Difference to {comparison.plan.methods[0].name}, sequence by sequence:")
        out.table(*found.table(apart, ahead=True), words=(0, 1, 3))
    if (errors := found.errors()).rows:
        out.say("", "Errors by cause:")
        out.table(*errors, words=(0, 1, 3))
    done = lines(
        "comparison_done.txt", comparison=comparison, seconds=begun.seconds, plan=found.described()
    )
    out.say("", *done, *found.sentences(), *notes, "", *directory.listing())
    out.document(document)


def doubts(comparison: Comparison) -> tuple[str, ...]:
    """Sentences that a user should know, each once."""
    said = [f"{run} failed: {reason}" for run, reason in comparison.failed]
    said += [
        result.warning
        for _, result in comparison.runs
        if isinstance(result, ComparedRun) and result.warning
    ]
    said += _tracking_warnings(comparison)
    each = tuple(dict.fromkeys(said))
    more: tuple[str, ...]
    if len(each) > MOST_WARNINGS:
        more = (f"and {len(each) - MOST_WARNINGS} more, see {EACH}",)
    else:
        more = ()
    return (*each[:MOST_WARNINGS], *more)


def _tracking_warnings(comparison: Comparison) -> list[str]:
    """The warnings of trackers, each once, with the first run that has it."""
    runs = dict[str, list[str]]()
    for run, result in comparison.runs:
        if isinstance(result, ComparedRun):
            for sentence in result.tracking_warnings:
                runs.setdefault(without_numbers(sentence), []).append(f"{run}: {sentence}")
    return [
        first + (f" ({counted(len(more), 'more run')} like it)" if more else "")
        for first, *more in runs.values()
    ]
