"""The groups that go along with a run of `phdtrack groups`: from every step's intensity and tracks to files and pictures."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from phdtrack.cli.ground import places
from phdtrack.cli.group_files import GroupFiles
from phdtrack.cli.group_story import Around, Story
from phdtrack.cli.job import Draw
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.groups import LifeCycleState
from phdtrack.groups.pipeline import GroupStages, carriers, mixture_of
from phdtrack.protocols import AnyStages
from phdtrack.report.plan import PlanScene
from phdtrack.types import F8, I8, GaussianMixture, SequenceInfo, Step, Tracks

# Metres between a row given online and the corrected one of the same person.
_SAME = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    """A frame whose online rows are still held back."""

    number: int
    time: float
    mixture: GaussianMixture
    detections: F8


class GroupCompanion:
    """Groups beside a run on the ground plane.

    Members are the identities of the confirmed online rows. A frame's rows come ``delay`` frames later; until then its
    mixture waits.
    """

    def __init__(self, settings: GroupStages, stages: AnyStages, info: SequenceInfo, around: Around, delay: int) -> None:
        self._settings, self._stages, self._info, self._delay = settings, stages, info, delay
        self._story = Story(around, raw=True)
        self._camera = around.camera
        self._state, self._waiting = LifeCycleState(), deque[_Waiting]()
        self._files: GroupFiles | None = None

    @contextmanager
    def open(self, directory: RunDirectory) -> Iterator[None]:
        """The files, open while the run lasts."""
        with GroupFiles(directory, self._camera) as self._files:
            yield
        self._files = None

    def take(self, step: Step, intensity: object) -> None:
        """Take in a step; the frame whose rows it brings is told."""
        sensor, lightest = self._stages.model.sensor, self._settings.grouping.min_weight
        z = sensor.measure(step.detections)
        usable = np.ascontiguousarray(z[:, np.isfinite(z).all(axis=0)])
        mixture = mixture_of(intensity, step, usable, self._stages, lightest)
        self._waiting.append(_Waiting(step.number, step.time, mixture, places(sensor, step.detections.xyxy)))
        if len(self._waiting) > self._delay:
            self._tell(self._waiting.popleft(), step.tracks)

    def flush(self, rows: Tracks) -> None:
        """Tell the frames that are left."""
        while self._waiting:
            self._tell(self._waiting.popleft(), rows)

    def finish(self, tracks: Tracks) -> None:
        """On the plan people carry the identities of the corrected tracks, as in the annotated video beside it."""
        place = places(self._stages.model.sensor, tracks.xyxy)

        def corrected(scene: PlanScene) -> I8:
            lo, hi = np.searchsorted(tracks.frame, [scene.number, scene.number + 1])
            return nearest(scene.people, place[:, lo:hi], tracks.identity[lo:hi])

        self._story.rename(corrected)

    def drawing(self, directory: RunDirectory, *, pictures: bool) -> AbstractContextManager[Draw]:
        """plan.mp4, with the annotated pictures on its left where there are any."""
        size = (self._info.width, self._info.height) if pictures else None
        return self._story.video(directory, self._info.fps, picture=size)

    def section(self) -> Markup:
        """Counts, plan, events and warnings for the report."""
        return self._story.section()

    def sentences(self) -> tuple[str, ...]:
        """What happened, in words."""
        return self._story.sentences()

    def document(self) -> dict[str, object]:
        """What happened, for programs."""
        return self._story.document()

    def _tell(self, waiting: _Waiting, tracks: Tracks) -> None:
        rows = tracks.take((tracks.frame == waiting.number) & tracks.confirmed)
        place = places(self._stages.model.sensor, rows.xyxy)
        carrier = carriers(waiting.mixture, place, self._settings.grouping.min_weight)
        self._state, frame = self._settings.advance(
            self._state, waiting.mixture, rows.identity, carrier, waiting.number, waiting.time
        )
        if self._files is not None:
            self._files.write(frame)
        at = np.searchsorted(rows.identity, frame.member)
        self._story.take(frame, place[:, at], waiting.detections)


def nearest(people: F8, place: F8, identity: I8) -> I8:
    """(n,) the identity (M,) of the row at the nearest ``place`` (2, M) to each of the ``people`` (2, n); 0 where none is
    near."""
    apart = np.hypot(*(people[:, :, None] - place[:, None]))
    apart = np.where(np.isfinite(apart), apart, np.inf)
    if apart.size == 0:
        return np.zeros(people.shape[1], np.int64)
    closest = apart.argmin(axis=1)
    return np.where(apart.min(axis=1) < _SAME, identity[closest], 0)
