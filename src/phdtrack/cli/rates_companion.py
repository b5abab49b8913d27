"""What goes along with a run that learns its rates: their course in the report and in run.json."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import asdict

from markupsafe import Markup

from phdtrack.cli.job import Draw
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.cli.steps import Steps
from phdtrack.models.followed_rates import FollowRates
from phdtrack.report.pages import rates_section
from phdtrack.scene.rates import Rates
from phdtrack.types import Step, Tracks

# Of the course, in run.json.
_MOST_TOLD = 500


class RatesCompanion:
    """Takes down the rates each time that they are learned."""

    def __init__(self, learning: FollowRates, steps: Steps) -> None:
        self._rule, self._steps = learning.rule, steps
        self._told: list[Rates] = []

    @contextmanager
    def open(self, directory: RunDirectory) -> Iterator[None]:
        """There are no files."""
        yield

    def take(self, step: Step, intensity: object) -> None:
        """Take down what this frame taught."""
        last = self._steps.rates
        if last.number == step.number:
            self._told.append(last)

    def flush(self, rows: Tracks) -> None:
        """Nothing is learned of rows that come late."""

    def finish(self, tracks: Tracks) -> None:
        """Nothing is left to do."""

    def drawing(self, directory: RunDirectory, *, pictures: bool) -> AbstractContextManager[Draw]:
        """There is no video of it."""
        return nullcontext(lambda number, picture: None)

    def section(self) -> Markup:
        """Their course."""
        return rates_section(self._told, self._rule)

    def sentences(self) -> tuple[str, ...]:
        """What is known at the end."""
        if not self._told:
            return ("no rates were learned: the run is too short",)
        last, priors = self._told[-1], self._rule.priors
        said = [f"objects are detected in {100 * last.detection:.0f} % of frames (set: {100 * priors.detection:.0f} %)"]
        if priors.clutter_each:
            said.append(f"{100 * last.clutter:.0f} % of the detections are false alarms")
        else:
            said.append(f"{last.clutter:.2f} false alarms a frame (set: {priors.clutter:g})")
        if last.lowest < 1 < last.highest:
            said.append(f"the best scores count {last.highest:.2f} : 1 for an object, the worst 1 : {1 / last.lowest:.2f}")
        limits = f"; kept within limits: {', '.join(last.limited)}" if last.limited else ""
        return (f"estimated from the stream: {'; '.join(said)}{limits}",)

    def document(self) -> dict[str, object]:
        """Their course, thinned to 500 entries."""
        every = len(self._told) // _MOST_TOLD + 1
        course = [asdict(one) for k, one in enumerate(self._told) if k % every == 0 or k == len(self._told) - 1]
        return {"rates": {"set": asdict(self._rule.priors), "used": asdict(self._rule.learns), "course": course}}
