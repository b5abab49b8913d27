"""``phdtrack reproduce``: a paper's experiment again, its figures beside ours."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from phdtrack.commands.options import Json
from phdtrack.commands.output import Output

ELSEWHERE = Path("phdtrack-results")


def reproduce(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The experiment: m07, d14, e13, vo, ...; see --list.")] = "",
    runs: Annotated[
        int, typer.Option("--runs", metavar="N", min=0, help="Seeds of each case; 0: as many as the experiment has.")
    ] = 0,
    quick: Annotated[
        bool, typer.Option("--quick", help="A short form, to see that it works: its figures are no results.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help=f"Where page and pictures go; default: docs/results in a checkout, {ELSEWHERE} else and where --runs or "
            "--quick shorten it.",
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            "--data", metavar="DIR", help="The real sequences; default: $PHDTRACK_DATA, or shared/data beside a checkout."
        ),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(
            "--keep", metavar="DIR", help="Keep the outcome of every run there, and do not run again what is there."
        ),
    ] = None,
    names: Annotated[bool, typer.Option("--list", help="Say what there is, and stop.")] = False,
    json: Json = False,
) -> None:
    """Run an experiment of the papers again and print its page: the paper's figures beside ours, and where data differ."""
    from phdtrack.reproduce.common import RESULTS, Options
    from phdtrack.reproduce.experiments import EXPERIMENTS, find

    result = Output(json)
    if names or not name:
        result.table(["", ""], [[key, one.about] for key, one in EXPERIMENTS.items()], words=(0, 1))
        result.document({key: one.about for key, one in EXPERIMENTS.items()})
        return
    if data is not None:
        # The environment, because the experiment's worker processes read it too.
        os.environ["PHDTRACK_DATA"] = str(data)
    experiment, shortened = find(name), quick or runs > 0
    page = experiment.run(Options(runs, quick, out or (ELSEWHERE if shortened else RESULTS), keep))
    text = page.read_text(encoding="utf-8")
    result.say(text)
    result.document({"experiment": name, "page": str(page), "text": text})
