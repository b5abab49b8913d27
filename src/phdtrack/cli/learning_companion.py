"""What goes along with a run that learns its scene: the scene's files, and what is told of the learning."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from markupsafe import Markup

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.job import Draw
from phdtrack.cli.output import counted
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.cli.steps import Steps
from phdtrack.models.followed_scene import FollowScene
from phdtrack.report.pages import learning_section
from phdtrack.scene import write_scene
from phdtrack.scene.modes import Mode
from phdtrack.scene.online import Relearned
from phdtrack.types import Step, Tracks

# Of what was learned over time, in run.json.
_MOST_TOLD = 500


class LearningCompanion:
    """Writes what was learned, for another run to begin with: one file for each mode, that of the active one first."""

    def __init__(self, learning: FollowScene, steps: Steps, source: str) -> None:
        self._learning, self._steps, self._source = learning, steps, source
        self._told: list[Relearned] = []
        self._directory: RunDirectory | None = None

    @contextmanager
    def open(self, directory: RunDirectory) -> Iterator[None]:
        """Remembers where the files go."""
        self._directory = directory
        yield

    def take(self, step: Step, intensity: object) -> None:
        """Take down what this frame taught."""
        last = self._steps.learned.known.last
        if last is not None and last.number == step.number:
            self._told.append(last)

    def flush(self, rows: Tracks) -> None:
        """Nothing is learned of rows that come late."""

    def finish(self, tracks: Tracks) -> None:
        """Write the scenes."""
        if self._directory is None:
            return
        for file, mode in zip(rundir.SCENES, self._modes(), strict=False):
            write_scene(self._directory.file(file), self._learning.scene(mode, self._source))

    def _modes(self) -> list[Mode]:
        """All that know something, the active one first."""
        known = self._steps.learned.known
        others = [mode for k, mode in enumerate(known.modes) if k != known.active]
        return [mode for mode in (known.mode, *others) if mode.trusted]

    def drawing(self, directory: RunDirectory, *, pictures: bool) -> AbstractContextManager[Draw]:
        """There is no video of it."""
        return nullcontext(lambda number, picture: None)

    def section(self) -> Markup:
        """Rates over time, and what changed."""
        rule = self._learning.rule
        return learning_section(self._told, rule.memory / 60, rule.rate)

    def sentences(self) -> tuple[str, ...]:
        """What is known at the end, and how often it went out of use."""
        if not self._told:
            return ("nothing was learned of the scene: the run is too short",)
        last, rule = self._told[-1], self._learning.rule
        births = f"{last.births * rule.rate * 60:.1f} births a minute{_unused(last.births_used)}"
        alarms = f"{last.clutter:.2f} false alarms a frame{_unused(last.clutter_used)}"
        dropped = sum("out of use" in sentence for one in self._told for sentence in one.said)
        names = [mode.name for mode in self._modes()]
        modes = f"; modes: {', '.join(names)}" if len(names) > 1 else ""
        drops = f"; what was learned went out of use {counted(dropped, 'time')}" if dropped else ""
        return (f"learned of the scene: {alarms}, {births}{modes}{drops}",)

    def document(self) -> dict[str, object]:
        """The same with its course, thinned to 500 entries, all that say something among them."""
        every = max(1, len(self._told) // _MOST_TOLD + 1)
        kept = [one for k, one in enumerate(self._told) if k % every == 0 or one.said or k == len(self._told) - 1]
        course = [
            {
                "frame": one.number,
                "seconds": one.time,
                "mode": one.mode,
                "births_per_minute": one.births * self._learning.rule.rate * 60,
                "false_alarms_per_frame": one.clutter,
                "births_gain": one.birth_gain,
                "false_alarms_gain": one.clutter_gain,
                "births_used": one.births_used,
                "false_alarms_used": one.clutter_used,
                "said": list(one.said),
            }
            for one in kept
        ]
        return {"learning": {"memory_minutes": self._learning.rule.memory / 60, "course": course}}


def _unused(used: bool) -> str:
    return "" if used else " (not in use)"
