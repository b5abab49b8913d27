"""``phdtrack tune``: choose settings on annotated sequences, and say what the choice risks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

import typer

from phdtrack import compare as comparing
from phdtrack import config as configuring
from phdtrack.cli import options as given
from phdtrack.cli.compare import SETS, ResultFolder, listed, run_plan
from phdtrack.cli.options import one_of, option
from phdtrack.cli.output import Output
from phdtrack.cli.show_settings import toml_value
from phdtrack.cli.track import command_line
from phdtrack.compare.plans import Plan
from phdtrack.compare.tuning import (
    DEFAULT,
    PARTS,
    TUNED_SCORES,
    Tuning,
    candidates,
    check_truth,
    inputs,
    tuning,
)
from phdtrack.config import Settings
from phdtrack.errors import InputError
from phdtrack.files import write_text
from phdtrack.report import write_run
from phdtrack.run.requests import ReadingRequest

SETTINGS = "tuned.toml"
DOCUMENT = "tune.json"
_FILES = {SETTINGS: "the settings, for --config", DOCUMENT: "every score"}
_CANDIDATE = (
    "Another candidate, as few=filter.max_hypotheses=5. Each more makes the choice riskier."
    " Repeatable."
)
_SCORES = ", ".join(TUNED_SCORES)
# Sequences from which on the interval tells something.
_ENOUGH = 5


_SEQUENCES = (
    "Folders as MOTChallenge's; or files in turns, as TRUTH DETECTIONS TRUTH DETECTIONS; or two"
    " folders of such files."
)


@dataclass(frozen=True, slots=True)
class TuneOptions:
    """Options of what is tuned, and of how its files are read."""

    detections: Annotated[str, option("NAMES", SETS)] = ""
    truth: Annotated[str, option("FILE", "Annotated objects; {} stands for the sequence.")] = ""
    frame_size: given.FrameSize = ""
    fps: given.Fps = 0.0
    reading: ReadingRequest = field(default_factory=ReadingRequest)
    filter_name: given.Filter = ""
    preset: given.Preset = ""
    config: given.Config = None
    sets: given.Sets = None
    variants: Annotated[list[str] | None, option("NAME=SETTINGS", _CANDIDATE, "--variant")] = None

    def request(self, words: Sequence[str]) -> comparing.Request:
        """The runs on these paths. Raises `InputError` for mistakes."""
        sequences, pairs = inputs(words)
        unused = {"--detections": self.detections, "--truth": self.truth}
        for name, value in unused.items():
            if pairs and value:
                raise InputError(
                    "the files of truth and detections are named already",
                    where=f"{name} {value}",
                    cure="Leave it out, or name folders of sequences.",
                )
        sets = self.sets or []
        kind = self.filter_name or configuring.load(self.config, sets, self.preset).kind("filter")
        tried = [f"{one.name}={one.sets}" for one in candidates(kind)]
        return comparing.Request(
            sequences,
            pairs=pairs,
            frame_size=self.frame_size,
            fps=self.fps,
            reading=self.reading,
            filters=(kind,),
            detections=listed(self.detections),
            truth=self.truth,
            seeds=1,
            preset=self.preset,
            file=self.config,
            sets=[text for text in sets if text.replace(" ", "") != f"filter.kind={kind}"],
            variants=(*tried, *(self.variants or ())),
        )


def tune(
    sequences: Annotated[list[str], typer.Argument(metavar="SEQUENCE...", help=_SEQUENCES)],
    output: Output,
    options: TuneOptions,
    score: Annotated[
        str,
        option(
            "|".join(TUNED_SCORES),
            "The score of corrected tracks to choose by",
            callback=lambda value: one_of(value, *TUNED_SCORES),
        ),
    ] = "HOTA",
    out: Annotated[Path, option("DIR", "Directory in which everything is kept.")] = Path(
        "runs/tune"
    ),
    jobs: Annotated[int, option("N", "Processes at once. Default: one per core.", min=0)] = 0,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Run everything anew, also what is kept already.")
    ] = False,
) -> None:
    """Choose settings for your own sequences, and report what the choice is worth on others.

    The default and a few other settings track every sequence. Each sequence is left out in turn:
    the best settings on the others are scored on it. A single sequence is divided in time into five
    parts, and each part is left out. If the choice gains nothing, the default stays. The file with
    the settings is for --config of every command.

    Every run is kept: the same command again takes up what is there, after Ctrl-C too.
    """
    folder = ResultFolder(out, DOCUMENT, _FILES, overwrite)
    plan = _with_default(comparing.plan(options.request(sequences)))
    check_truth(plan)
    directory = folder.claim()
    found = tuning(run_plan(plan, folder, jobs, output, "tuning"), score)
    settings = {method.name: method.settings for method in plan.methods}
    told = sentences(found)
    write_text(directory.file(SETTINGS), _as_file(settings[found.chosen], told))
    document = {"complete": True, "command": command_line(), **_document(found)}
    write_run(directory.file(DOCUMENT), document)
    kind = plan.methods[0].settings.kind("filter")
    meant = {one.name: one.meant_for for one in candidates(kind)}
    head = ("settings", score, "to the default", "chosen", "meant for")
    output.table(head, _rows(found, meant), words=(0, 4))
    output.say("", *told, "", *directory.listing())
    output.document({**document, "directory": str(out)})


def _with_default(plan: Plan) -> Plan:
    """The plan with its first method called the default."""
    first, *others = plan.methods
    return replace(plan, methods=(first._replace(name=DEFAULT), *others))


def _rows(found: Tuning, meant: dict[str, str]) -> list[tuple[str, ...]]:
    """A row of the table for each candidate, the best first."""
    order = sorted(found.names, key=lambda name: -found.mean(name).mean)
    return [
        (
            name,
            f"{found.mean(name).mean:.3f}",
            "" if name == DEFAULT else f"{found.ahead(name):+.3f}",
            f"{found.times(name)} of {len(found.folds)}",
            meant.get(name, "" if name == DEFAULT else "as given"),
        )
        for name in order
    ]


def sentences(found: Tuning) -> list[str]:
    """Sentences: what was chosen, what that is worth on other sequences, and what it risks.

    Parameters
    ----------
    found : the result.
    """
    score = found.score
    count = len(found.folds)
    chosen = sum(fold.score for fold in found.folds) / count
    default = sum(fold.default for fold in found.folds) / count
    noun = "parts" if found.parts_of else "sequences"
    out = []
    if found.parts_of:
        out.append(
            f"{found.parts_of} is one sequence, so no other can be left out: it was divided in time"
            f" into {PARTS} parts, and each was left out in turn."
        )
    out.append(
        f"On {noun} that were left out, the choice has {score} {chosen:.3f}, the default"
        f" {default:.3f}: {found.gain:+.3f}."
    )
    if found.best != DEFAULT:
        out.append(
            f"On the {noun} that it was chosen on, {found.best} is {found.apparent:+.3f} ahead."
            " Expect the former elsewhere, not the latter."
        )
    lost = [fold for fold in found.folds if fold.gain < 0]
    if lost:
        worst = found.worst
        out.append(
            f"Risk: on {len(lost)} of {count} {noun} the choice lost, most on {worst.sequence}:"
            f" {worst.gain:+.3f} with {worst.chosen}."
        )
    else:
        out.append(f"Risk: on none of these {count} {noun} the choice lost.")
    if found.chosen == DEFAULT:
        out.append(f"The default stays: choosing gains nothing on {noun} that were left out.")
    else:
        out.append(f"Chosen: {found.chosen}.")
        if not found.gain.clear:
            out.append("The gain is within what chance gives: the default would do as well.")
    if found.parts_of:
        out.append(
            f"Parts of one sequence resemble each other: {_ENOUGH} or more sequences tell more."
        )
    elif count < _ENOUGH:
        out.append(f"{count} sequences tell little: use {_ENOUGH} or more.")
    return out


def _as_file(settings: Settings, told: Sequence[str]) -> str:
    """A settings file, with the sentences as comments."""
    lines = [f"# {sentence}" for sentence in told]
    if settings.named:
        lines += ["", f"preset = {toml_value(settings.named)}"]
    for section, values in settings.given.items():
        lines += ["", f"[{section}]"]
        lines += [f"{name} = {toml_value(value)}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def _document(found: Tuning) -> dict[str, object]:
    """The result for programs."""
    return {
        "score": found.score,
        "chosen": found.chosen,
        "best": found.best,
        "gain": found.gain.mean,
        "gain_half": found.gain.half,
        "apparent_gain": found.apparent,
        "sequences": found.sequences,
        "parts_of": found.parts_of,
        "scores": dict(zip(found.names, found.table.tolist(), strict=True)),
        "folds": [{**asdict(fold), "gain": fold.gain} for fold in found.folds],
    }
