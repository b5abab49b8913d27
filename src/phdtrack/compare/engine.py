"""A comparison from plan to results: what is kept already is taken, everything else is run and kept.

First every detector looks at every video once. Then each cell runs with its first seed, and where another seed may give
something else, because clutter was added or something was drawn at random, with the others.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from phdtrack.compare.digest import Contents, changed, decides_detections, decides_run, digest
from phdtrack.compare.parallel import Failed, outcomes
from phdtrack.compare.records import Cell, Detecting, Plan, Run
from phdtrack.compare.store import DETECTIONS, Outcome, kept, read_about
from phdtrack.compare.work import Look, Track
from phdtrack.errors import InputError

LOOKS = "detections"
Advance = Callable[[int], None]
Found = dict[Path, Outcome | Failed]


def silent(done: int) -> None:
    """Nobody wants to know how far it got."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """The results of a plan, kept in ``folder``.

    ``found`` holds, by `Run.place`, what came of the runs that were needed: where nothing is random, the first seed stands
    for all (`outcome`). ``detected`` are, by `Case.place`, the folders of what detectors saw. ``reused``: runs that were
    there already; ``outdated``: what had changed for runs that were there and ran again, by the names in ``decided_by``.
    """

    plan: Plan
    folder: Path
    found: Mapping[Path, Outcome | Failed]
    detected: Mapping[Path, Path | Failed]
    reused: int = 0
    outdated: tuple[str, ...] = ()

    def outcome(self, cell: Cell, seed: int) -> Outcome | Failed:
        """Of a cell at a seed."""
        own = self.found.get(Run(cell, seed).place)
        return self.found[Run(cell, self.plan.seeds[0]).place] if own is None else own

    @property
    def runs(self) -> list[tuple[Run, Outcome | Failed]]:
        """All runs that were needed, in the plan's order."""
        return [(run, self.found[run.place]) for run in self.plan.runs if run.place in self.found]

    @property
    def failed(self) -> list[tuple[Run, str]]:
        """The runs that came to nothing, and why."""
        return [(run, result.reason) for run, result in self.runs if isinstance(result, Failed)]


def run(plan: Plan, folder: Path, jobs: int = 1, *, anew: bool = False, advance: Advance = silent) -> Comparison:
    """Run what is not kept in ``folder`` yet, ``jobs`` at a time; ``anew`` trusts nothing that is there.

    The results do not depend on ``jobs``. ``advance`` is told how many of `steps` are done. Whatever ends this call, what is
    done by then is kept, and taken up by the next. With ``jobs`` above 1 a program calls this under
    ``if __name__ == "__main__"``, as everywhere where processes are started.

    Raises
    ------
    InputError : the folder cannot be written into, or an input has gone since it was planned.
    """
    _writable(folder)
    work = _Work(plan, folder, jobs, anew, advance)
    work.detect()
    first = [run for run in plan.runs if run.seed == plan.seeds[0]]
    work.track(first)
    others = [run for run in plan.runs if run.seed != plan.seeds[0]]
    needed = [run for run in others if run.cell.rate or work.random(run.cell)]
    work.count(len(others) - len(needed))
    work.track(needed)
    return Comparison(plan, folder, work.found, work.detected, work.reused, tuple(work.outdated))


def steps(plan: Plan) -> int:
    """What `run` tells ``advance`` at the end: looks of detectors and runs."""
    return sum(isinstance(case.seen, Detecting) for case in plan.cases) + len(plan.runs)


class _Work:
    """What is done so far."""

    def __init__(self, plan: Plan, folder: Path, jobs: int, anew: bool, advance: Advance) -> None:
        self._plan, self._folder, self._jobs, self._anew, self._advance = plan, folder, jobs, anew, advance
        self._contents = Contents()
        self._digests: dict[Path, str] = {}
        self.found: Found = {}
        self.detected: dict[Path, Path | Failed] = {}
        self.reused = self._done = 0
        # A dictionary keeps the order.
        self.outdated: dict[str, None] = {}

    def count(self, number: int = 1) -> None:
        """So many steps more are done, or not needed."""
        self._done += number
        self._advance(self._done)

    def detect(self) -> None:
        """Every detector on its videos, where that is not kept."""
        looks = []
        for case in self._plan.cases:
            decided_by = decides_detections(case, self._contents)
            self._digests[case.place] = digest(decided_by)
            if not isinstance(case.seen, Detecting):
                continue
            look = Look(case, self._folder / LOOKS / case.place, digest(decided_by), decided_by)
            self.detected[case.place] = look.place
            there = read_about(look.place).get("digest") == look.digest and (look.place / DETECTIONS).is_file()
            if there and not self._anew:
                self.count()
            else:
                looks.append(look)
        for number, result in outcomes(looks, self._jobs):
            if isinstance(result, Failed):
                self.detected[looks[number].case.place] = result
            self.count()

    def track(self, runs: Sequence[Run]) -> None:
        """These runs, where they are not kept."""
        tracks = []
        for run in runs:
            detected = self.detected.get(run.cell.case.place)
            if isinstance(detected, Failed):
                self.found[run.place] = detected
                self.count()
                continue
            decided_by = decides_run(run, self._digests[run.cell.case.place], self._plan.iou, self._contents)
            track = Track(run, self._plan.iou, self._folder / run.place, detected, digest(decided_by), decided_by)
            before = None if self._anew else kept(track.place, track.digest)
            if before is None:
                tracks.append(track)
                earlier = read_about(track.place).get("decided_by", {})
                if earlier and not self._anew:
                    self.outdated |= dict.fromkeys(changed(earlier, decided_by))
            else:
                self.found[run.place] = before
                self.reused += 1
                self.count()
        for number, result in outcomes(tracks, self._jobs):
            self.found[tracks[number].run.place] = result
            self.count()

    def random(self, cell: Cell) -> bool:
        """Whether another seed may give something else."""
        first = self.found[Run(cell, self._plan.seeds[0]).place]
        return isinstance(first, Failed) or first.drawn


def _writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = f"cannot be written into ({error.strerror or error})"
        raise InputError(problem, where=folder, cure="Choose another folder.") from error
