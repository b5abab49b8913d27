"""``phdtrack tune``: choose settings on annotated sequences, and say what the choice risks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from phdtrack import compare as comparing
from phdtrack.cli.compare import SETS, ResultFolder, listed, run_plan
from phdtrack.cli.options import one_of, option
from phdtrack.cli.output import Output
from phdtrack.cli.show_settings import toml_value
from phdtrack.cli.track import command_line
from phdtrack.compare.plans import Plan
from phdtrack.compare.tuning import (
    CANDIDATES,
    DEFAULT,
    TUNED_SCORES,
    Tuning,
    check_sequences,
    check_truth,
    tuning,
)
from phdtrack.config import Settings
from phdtrack.files import write_text
from phdtrack.report import write_run

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


def tune(
    sequences: Annotated[
        list[str],
        typer.Argument(metavar="SEQUENCE...", help="Two or more folders as MOTChallenge's."),
    ],
    output: Output,
    detections: Annotated[
        str,
        option("NAMES", SETS),
    ] = "",
    truth: Annotated[str, option("FILE", "Annotated objects; {} stands for the sequence.")] = "",
    score: Annotated[
        str,
        option(
            "|".join(TUNED_SCORES),
            "The score of corrected tracks to choose by",
            callback=lambda value: one_of(value, *TUNED_SCORES),
        ),
    ] = "HOTA",
    variants: Annotated[list[str] | None, option("NAME=SETTINGS", _CANDIDATE, "--variant")] = None,
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
    the best settings on the others are scored on it. If that gains nothing, the default stays. The
    settings file is for --config of every command.

    Every run is kept: the same command again takes up what is there, after Ctrl-C too.
    """
    check_sequences(sequences)
    folder = ResultFolder(out, DOCUMENT, _FILES, overwrite)
    candidates = [f"{one.name}={one.sets}" for one in CANDIDATES]
    wanted = comparing.Request(
        sequences,
        filters=("pmb",),
        detections=listed(detections),
        truth=truth,
        seeds=1,
        variants=(*candidates, *(variants or ())),
    )
    plan = _with_default(comparing.plan(wanted))
    check_truth(plan)
    directory = folder.claim()
    found = tuning(run_plan(plan, folder, jobs, output, "tuning"), score)
    settings = {method.name: method.settings for method in plan.methods}
    told = sentences(found)
    write_text(directory.file(SETTINGS), _as_file(settings[found.chosen], told))
    document = {"complete": True, "command": command_line(), **_document(found)}
    write_run(directory.file(DOCUMENT), document)
    meant = {one.name: one.meant_for for one in CANDIDATES}
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
    out = [
        f"On sequences that were left out, the choice has {score} {chosen:.3f}, the default"
        f" {default:.3f}: {found.gain:+.3f}."
    ]
    if found.best != DEFAULT:
        out.append(
            f"On the sequences that it was chosen on, {found.best} is {found.apparent:+.3f} ahead."
            " Expect the former elsewhere, not the latter."
        )
    lost = [fold for fold in found.folds if fold.gain < 0]
    if lost:
        worst = found.worst
        out.append(
            f"Risk: on {len(lost)} of {count} sequences the choice lost, most on {worst.sequence}:"
            f" {worst.gain:+.3f} with {worst.chosen}."
        )
    else:
        out.append(f"Risk: on none of these {count} sequences the choice lost.")
    if found.chosen == DEFAULT:
        out.append("The default stays: choosing gains nothing on sequences that were left out.")
    else:
        out.append(f"Chosen: {found.chosen}.")
        if not found.gain.clear:
            out.append("The gain is within what chance gives: the default would do as well.")
    if count < _ENOUGH:
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
        "scores": dict(zip(found.names, found.table.tolist(), strict=True)),
        "folds": [{**asdict(fold), "gain": fold.gain} for fold in found.folds],
    }
