"""What a comparison leaves: tables on the terminal, compare.csv, runs.csv, compare.json, report.html, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.compare import CELLS, DOCUMENT, EACH, FRAMES
from phdtrack.cli.configured import versions
from phdtrack.cli.output import Output, counted
from phdtrack.cli.track import command_line
from phdtrack.compare import Comparison, Outcome, Summary
from phdtrack.compare.page import comparison_page, described, notes, sentences
from phdtrack.compare.tables import document_of, head, lines_of, shown, sparse, write_cells, write_runs
from phdtrack.compare.worst import WorstFrame, write_frames
from phdtrack.report import About, write_run
from phdtrack.report.rendering import duration
from phdtrack.report.run_json import json_value, write_text

MOST_WARNINGS = 12
# What decides a run, in words.
MEANINGS = {
    "phdtrack": "versions of phdtrack",
    "sources": "sources of phdtrack",
    "sequence": "size, rate or length of a sequence",
}


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """A comparison with its summary; ``wanted`` are the scores asked for, ``seconds`` what it took this time.

    ``alone``: its runs ran one after the other.
    """

    comparison: Comparison
    summary: Summary
    wanted: tuple[str, ...]
    seconds: float
    alone: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know of the numbers."""
        comparison = self.comparison
        return notes(self.summary, comparison.plan.seeds, alone=self.alone, kept=comparison.reused > 0)

    @property
    def scores(self) -> tuple[str, ...]:
        """The scores to show."""
        return shown(self.summary, self.wanted)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know, each sentence once."""
        said = [f"{run} failed: {reason}" for run, reason in self.comparison.failed]
        said += [outcome.warning for _, outcome in self.comparison.runs if isinstance(outcome, Outcome) and outcome.warning]
        each = tuple(dict.fromkeys(said))
        more = len(each) - MOST_WARNINGS
        return each if more < 1 else (*each[:MOST_WARNINGS], f"and {more} more, see {EACH}")

    @property
    def sentence(self) -> str:
        """What was run, and how much of it was there already."""
        comparison = self.comparison
        reused = f", {comparison.reused} of them kept from before" if comparison.reused else ""
        if comparison.outdated:
            said = " and ".join(MEANINGS.get(name, name) for name in comparison.outdated)
            reused += f", others run again because of other {said}"
        return f"{counted(len(comparison.found), 'run')}{reused}, in {duration(self.seconds)}: {described(comparison.plan)}."

    @property
    def document(self) -> dict[str, object]:
        """For programs."""
        comparison = self.comparison
        return {
            "complete": True,
            "command": command_line(),
            "runs": len(comparison.found),
            "reused": comparison.reused,
            "outdated": comparison.outdated,
            "failed": [{"run": str(run), "reason": reason} for run, reason in comparison.failed],
            "seconds": self.seconds,
            "warnings": self.warnings,
            "rows": [document_of(row) for row in self.summary.rows],
            "directory": str(comparison.folder),
        }


def write(results: Results, frames: Sequence[WorstFrame], directory: rundir.RunDirectory) -> None:
    """Everything but the runs, which are there already. Pictures of an earlier comparison go."""
    comparison, place = results.comparison, directory.file
    write_cells(place(CELLS), results.summary)
    write_runs(place(EACH), comparison)
    for old in (directory.path / FRAMES).glob("*-clutter-*-frame-*.png"):
        old.unlink()
    write_frames(directory.path / FRAMES, frames)
    about = About(
        title="Comparison of " + ", ".join(method.name for method in comparison.plan.methods),
        command=command_line(),
        seed=comparison.plan.seeds[0],
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=results.seconds,
        versions=versions(),
        warnings=results.warnings,
        notes=results.notes,
    )
    page = comparison_page(comparison, results.summary, results.scores, frames, about)
    write_text(place(rundir.REPORT), page)
    write_run(place(DOCUMENT), json_value(results.document))


def tell(out: Output, results: Results, directory: rundir.RunDirectory) -> None:
    """The table, who is ahead of the first and by how much, and where everything lies."""
    found, names, plan = results.summary, results.scores, results.comparison.plan
    for warning in results.warnings:
        out.warn(warning)
    out.table(head(names), sparse(lines_of(found.rows, names)), words=(0, 1, 3))
    apart = [row for row in found.widest if row.ahead]
    if apart:
        out.say()
        out.say(f"Difference to {plan.methods[0].name}, seed by seed:")
        out.table(head(names), sparse(lines_of(apart, names, ahead=True)), words=(0, 1, 3))
    out.say()
    for sentence in (results.sentence, *sentences(plan, found), *results.notes):
        out.say(sentence)
    out.say()
    for file, meaning in _meanings(directory.path):
        out.say(f"  {file}  {meaning}")
    out.document(json_value(results.document))


def _meanings(folder: Path) -> list[tuple[Path, str]]:
    pairs = [
        (folder / rundir.REPORT, "tables, plots, the worst frames"),
        (folder / CELLS, "every score with its interval, a row for each line of the table"),
        (folder / EACH, "every run, and the folder it is kept in"),
        (folder / FRAMES, "the worst frames as pictures"),
    ]
    return [(file, meaning) for file, meaning in pairs if file.is_file() or (file.is_dir() and any(file.iterdir()))]
