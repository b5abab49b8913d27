"""What is kept of the groups of a run, to be drawn and told when it is over.

Of every frame the plan's scene is kept, contours included: some hundred bytes a person.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from markupsafe import Markup

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.group_files import in_image
from phdtrack.cli.output import counted
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.groups import Encounter, Event
from phdtrack.groups.pipeline import GroupFrame
from phdtrack.protocols import Camera
from phdtrack.report.charts import GroupSeries
from phdtrack.report.pages import group_sections
from phdtrack.report.plan import Plan, PlanGroup, PlanScene, draw_contours, extent_of, plan_size
from phdtrack.types import F8, I8, Image
from phdtrack.video import VideoWriter

# Pictures of the report; least and usual height of a plan in pixels.
_STILLS, _LEAST, _USUAL = 4, 480, 720


@dataclass(frozen=True, slots=True, eq=False)
class Around:
    """What stays the same in all frames: the camera, if any, what it sees (2, K), and lines to be drawn (2, K)."""

    camera: Camera | None = None
    field: F8 = field(default_factory=lambda: np.zeros((2, 0)))
    edges: tuple[F8, ...] = ()


class Story:
    """Takes in frames; draws and tells at the end. ``raw`` says whether there are detections."""

    def __init__(self, around: Around, *, raw: bool) -> None:
        self._around, self._raw = around, raw
        self._scenes: list[PlanScene] = []
        self._deviation: list[float] = []
        self._detected: list[int] = []
        self._events: list[Event] = []
        self._warnings: list[tuple[float, Encounter]] = []

    @property
    def scenes(self) -> Sequence[PlanScene]:
        """The frames so far."""
        return self._scenes

    def take(self, frame: GroupFrame, people: F8, detections: F8) -> None:
        """Take in a frame, the places (2, n) of its people with identities, those of its detections (2, N)."""
        groups = tuple(_plan_group(frame, g) for g in range(len(frame)))
        encounters = tuple((w.first, w.second, w.seconds) for w in frame.warnings)
        self._scenes.append(PlanScene(frame.number, frame.time, detections, people, frame.member, groups, encounters))
        self._deviation.append(frame.deviation)
        self._detected.append(detections.shape[1])
        self._events.extend(frame.events)
        self._warnings.extend((frame.time, warned) for warned in frame.warnings)

    def rename(self, name: Callable[[PlanScene], I8]) -> None:
        """Let the people of each scene carry other identities (n,), 0 for none; files are not touched."""
        self._scenes = [replace(scene, identity=name(scene)) for scene in self._scenes]

    @contextmanager
    def video(self, directory: RunDirectory, fps: float, *, picture: tuple[int, int] | None) -> Iterator[_Film]:
        """plan.mp4 being drawn; ``picture`` is the size (width, height) of the frames beside it, None for the plan alone."""
        width, height = (0, _USUAL) if picture is None else (picture[0], max(picture[1], _LEAST))
        if picture is not None:
            width = 2 * round(picture[0] * height / picture[1] / 2)
        plan = self._plan(height + height % 2)
        with VideoWriter(directory.file(rundir.PLAN), width + plan.width, plan.height, fps) as video:
            yield _Film(video, plan, width, self._around.camera, {scene.number: scene for scene in self._scenes})

    def section(self) -> Markup:
        """The sections of the report."""
        return group_sections(replace(self._series(), stills=self._stills()))

    def sentences(self) -> tuple[str, ...]:
        """What happened, in words."""
        series = self._series()
        if not len(series):
            return ()
        kinds = Counter(event.kind for event in self._events)
        told = ", ".join(counted(kinds[kind], kind) for kind in ("merge", "split")) + " of groups"
        pairs = len({(warned.first, warned.second) for _, warned in self._warnings})
        return (
            f"{series.people.mean():.1f} people in {series.groups.mean():.1f} groups on average; {told}, "
            f"{counted(pairs, 'pair')} of groups warned of.",
        )

    def document(self) -> dict[str, object]:
        """The same for programs."""
        series = self._series()
        kinds = Counter(event.kind for event in self._events)
        return {
            "groups": {
                "people_mean": float(series.people.mean()) if len(series) else None,
                "groups_mean": float(series.groups.mean()) if len(series) else None,
                "detections_mean": float(series.detections.mean()) if len(series.detections) else None,
                "identities": len({group.identity for scene in self._scenes for group in scene.groups} - {0}),
                "events": {kind: kinds[kind] for kind in ("appear", "vanish", "merge", "split")},
                "warnings": len(self._warnings),
            }
        }

    def _series(self) -> GroupSeries:
        scenes = self._scenes
        return GroupSeries(
            times=np.array([scene.time for scene in scenes]),
            people=np.array([scene.people_in_groups for scene in scenes]),
            deviation=np.array(self._deviation),
            groups=np.array([_named(scene) for scene in scenes], np.int64),
            detections=np.array(self._detected if self._raw else [], np.int64),
            events=[(e.time, e.kind, e.group, e.other) for e in sorted(self._events, key=lambda e: e.time)],
            warnings=[(time, w.first, w.second, w.seconds, w.probability) for time, w in self._warnings],
        )

    def _stills(self) -> list[tuple[int, Image]]:
        """The plan at some frames, spread over those with people."""
        shown = [scene for scene in self._scenes if scene.groups]
        if not shown:
            return []
        plan, share = self._plan(_USUAL), (np.arange(_STILLS) + 0.5) / _STILLS
        chosen = dict.fromkeys((share * len(shown)).astype(int).tolist())
        return [(shown[k].number, plan.draw(shown[k])) for k in chosen]

    def _plan(self, height: int) -> Plan:
        """A plan of the ground on which people were."""
        people = [scene.people for scene in self._scenes]
        centres = [group.centre[:, None] for scene in self._scenes for group in scene.groups if group.identity]
        extent = extent_of(np.hstack([np.zeros((2, 0)), *people, *centres]))
        width, height = plan_size(extent, height)
        return Plan(extent, width, height, self._around.field, self._around.edges)


class _Film:
    """Draws one frame after the other: the annotated picture, the plan beside it."""

    def __init__(
        self, video: VideoWriter, plan: Plan, width: int, camera: Camera | None, scenes: dict[int, PlanScene]
    ) -> None:
        self._video, self._plan, self._width, self._camera, self._scenes = video, plan, width, camera, scenes

    def __call__(self, number: int, picture: Image) -> None:
        """The next frame; ``picture`` is empty where there is none."""
        nobody = PlanScene(number, 0.0, np.zeros((2, 0)), np.zeros((2, 0)), np.zeros(0, np.int64), ())
        scene = self._scenes.get(number, nobody)
        drawn = self._plan.draw(scene)
        if self._width:
            left = picture if self._camera is None else draw_contours(picture, _seen(self._camera, scene.groups))
            size = (self._width, self._plan.height)
            drawn = np.hstack([cv2.resize(left, size, interpolation=cv2.INTER_LINEAR), drawn])
        self._video.write(drawn)


def _named(scene: PlanScene) -> int:
    return sum(group.identity > 0 for group in scene.groups)


def _plan_group(frame: GroupFrame, g: int) -> PlanGroup:
    groups, mean = frame.groups, frame.groups.mean[:, g]
    return PlanGroup(
        int(frame.identity[g]), float(groups.count[g]), float(groups.deviation[g]), mean[:2], mean[2:4], frame.contours[g]
    )


def _seen(camera: Camera, groups: tuple[PlanGroup, ...]) -> tuple[PlanGroup, ...]:
    """The groups with contours in pixels."""
    rings = [tuple(r for r in (in_image(camera, ring) for ring in group.contours) if r.shape[1]) for group in groups]
    return tuple(replace(group, contours=seen) for group, seen in zip(groups, rings, strict=True))
