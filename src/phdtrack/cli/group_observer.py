"""Groups of people during a run: `GroupObserver` finds them, `GroupStory` writes, draws and reports them.

Contours are polygons in WKT (``MULTIPOLYGON``), on the ground in metres and, where there is a camera, in pixels of the
image. Rings that run clockwise on the ground are holes.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from phdtrack.cli import run_directory as rundir
from phdtrack.cli.job import places
from phdtrack.cli.observers import Draw, Report, RunObserver
from phdtrack.cli.output import counted
from phdtrack.cli.run_directory import RunDirectory
from phdtrack.formats.write import Lines
from phdtrack.groups import Encounter, Event, LifeCycleState, polygon_area
from phdtrack.groups.pipeline import GroupFrame, GroupStages, carriers, mixture_of
from phdtrack.pipeline import TrackingState
from phdtrack.protocols import AnyStages, Camera
from phdtrack.report.charts import GroupSeries
from phdtrack.report.pages import render
from phdtrack.report.plan import Plan, PlanGroup, PlanScene, draw_contours, extent_of, plan_size
from phdtrack.types import F8, I8, GaussianMixture, Image, Step, Tracks
from phdtrack.video import VideoWriter

# Metres between a row given online and the corrected one of the same person.
_SAME = 0.5
# Pictures of the report; smallest and usual height of a plan in pixels.
_STILLS, _MIN_HEIGHT, _HEIGHT = 4, 480, 720
NOWHERE: F8 = np.zeros((2, 0))
_EMPTY = "MULTIPOLYGON EMPTY"
_HEADS = {
    rundir.GROUPS: "frame,time,group,count,deviation,x,y,vx,vy,contours,contours_image",
    rundir.MEMBERS: "frame,group,member",
    rundir.EVENTS: "frame,time,event,group,other",
    rundir.WARNINGS: "frame,time,first,second,seconds,distance,deviation,x,y,probability",
}


class Surroundings(NamedTuple):
    """What stays the same in all frames: the camera, if any, what it sees (2, K), and lines to be drawn (2, K)."""

    camera: Camera | None = None
    field: F8 = NOWHERE
    edges: tuple[F8, ...] = ()


class GroupStory(RunObserver):
    """Writes every frame's groups, keeps its plan (some hundred bytes a person), and draws and reports it at the end.

    ``picture`` is the width and height of the frames, None where positions are known and nothing was detected.
    """

    draws = True

    def __init__(self, around: Surroundings, fps: float, picture: tuple[int, int] | None = None) -> None:
        self._around, self._fps, self._picture = around, fps, picture
        self._scenes: list[PlanScene] = []
        self._deviation: list[float] = []
        self._events: list[Event] = []
        self._warnings: list[tuple[float, Encounter]] = []

    def open(self, directory: RunDirectory, files: ExitStack) -> None:
        """Open the four tables."""
        self._tables = {name: files.enter_context(Lines(directory.file(name))) for name in _HEADS}
        for name, head in _HEADS.items():
            self._tables[name].write(head)

    def add(self, frame: GroupFrame, people: F8, detections: F8) -> None:
        """Take in a frame, the places (2, n) of its people with identities, those of its detections (2, N)."""
        self._write(frame)
        groups = tuple(_plan_group(frame, g) for g in range(len(frame)))
        encounters = tuple((w.first, w.second, w.seconds) for w in frame.warnings)
        self._scenes.append(PlanScene(frame.number, frame.time, detections, people, frame.member, groups, encounters))
        self._deviation.append(frame.deviation)
        self._events.extend(frame.events)
        self._warnings.extend((frame.time, warned) for warned in frame.warnings)

    def _write(self, frame: GroupFrame) -> None:
        """A frame's rows into the tables; they reach the operating system at once."""
        n, at, groups, camera = frame.number, f"{frame.time:.6f}", frame.groups, self._around.camera
        rows: dict[str, list[str]] = {rundir.GROUPS: []}
        for g, rings in enumerate(frame.contours):
            numbers = [groups.count[g], groups.deviation[g], *groups.mean[:, g]]
            values = ",".join(f"{value:.7g}" for value in numbers)
            image = _EMPTY if camera is None else _polygons(rings, [_in_image(camera, ring) for ring in rings])
            rows[rundir.GROUPS].append(f'{n},{at},{frame.identity[g]},{values},"{_polygons(rings, rings)}","{image}"')
        order = np.lexsort((frame.member, frame.membership))
        rows[rundir.MEMBERS] = [f"{n},{frame.membership[i]},{frame.member[i]}" for i in order]
        rows[rundir.EVENTS] = [f"{e.frame},{e.time:.6f},{e.kind},{e.group},{e.other}" for e in frame.events]
        rows[rundir.WARNINGS] = [
            f"{n},{at},{w.first},{w.second},{w.seconds:.4g},{w.distance:.4g},{w.deviation:.4g},"
            f"{w.place[0]:.7g},{w.place[1]:.7g},{w.probability:.4g}"
            for w in frame.warnings
        ]
        for name, lines in rows.items():
            if lines:
                self._tables[name].write("\n".join(lines))

    def rename(self, name: Callable[[PlanScene], I8]) -> None:
        """Let the people of each scene carry other identities (n,), 0 for none; files are not touched."""
        self._scenes = [replace(scene, identity=name(scene)) for scene in self._scenes]

    def drawing(self, directory: RunDirectory, files: ExitStack, *, pictures: bool) -> Draw:
        """plan.mp4, with the annotated pictures on its left where there are any."""
        left, height = 0, _HEIGHT
        if pictures and self._picture is not None:
            height = max(self._picture[1], _MIN_HEIGHT)
            left = 2 * round(self._picture[0] * height / self._picture[1] / 2)
        plan, scenes = self._plan(height + height % 2), {scene.number: scene for scene in self._scenes}
        size = (left + plan.width, plan.height)
        video = files.enter_context(VideoWriter(directory.file(rundir.PLAN), *size, self._fps))

        def draw(number: int, picture: Image) -> None:
            scene = scenes.get(number, PlanScene(number, 0.0, NOWHERE, NOWHERE, np.zeros(0, np.int64), ()))
            drawn = plan.draw(scene)
            if left:
                shown = self._with_contours(picture, scene.groups)
                shown = cv2.resize(shown, (left, plan.height), interpolation=cv2.INTER_LINEAR)
                drawn = np.hstack([shown, drawn])
            video.write(drawn)

        return draw

    def report(self) -> Report:
        """Counts, plan, events and warnings."""
        scenes, kinds = self._scenes, Counter(event.kind for event in self._events)
        series = GroupSeries(
            times=np.array([scene.time for scene in scenes]),
            people=np.array([scene.people_in_groups for scene in scenes]),
            deviation=np.array(self._deviation),
            groups=np.array([sum(group.identity > 0 for group in scene.groups) for scene in scenes], np.int64),
            detections=np.array([s.detections.shape[1] for s in scenes if self._picture is not None], np.int64),
            events=[(e.time, e.kind, e.group, e.other) for e in sorted(self._events, key=lambda e: e.time)],
            warnings=[(time, w.first, w.second, w.seconds, w.probability) for time, w in self._warnings],
            stills=self._stills(),
        )
        people, groups, detections = (
            float(each.mean()) if len(each) else None for each in (series.people, series.groups, series.detections)
        )
        document: dict[str, object] = {
            "people_mean": people,
            "groups_mean": groups,
            "detections_mean": detections,
            "identities": len({group.identity for scene in scenes for group in scene.groups} - {0}),
            "events": {kind: kinds[kind] for kind in ("appear", "vanish", "merge", "split")},
            "warnings": len(self._warnings),
        }
        if not scenes:
            return Report({"groups": document}, (), render("groups.html", series=series))
        changes = ", ".join(counted(kinds[kind], kind) for kind in ("merge", "split"))
        pairs = len({(warned.first, warned.second) for _, warned in self._warnings})
        said = f"{people:.1f} people in {groups:.1f} groups on average; {changes} of groups, "
        said += f"{counted(pairs, 'pair')} of groups warned of."
        return Report({"groups": document}, (said,), render("groups.html", series=series))

    def _stills(self) -> list[tuple[int, Image]]:
        """The plan at some frames, spread over those with people."""
        shown = [scene for scene in self._scenes if scene.groups]
        if not shown:
            return []
        plan, share = self._plan(_HEIGHT), (np.arange(_STILLS) + 0.5) / _STILLS
        chosen = dict.fromkeys((share * len(shown)).astype(int).tolist())
        return [(shown[k].number, plan.draw(shown[k])) for k in chosen]

    def _plan(self, height: int) -> Plan:
        """A plan of the ground on which people were."""
        people = [scene.people for scene in self._scenes]
        centres = [group.centre[:, None] for scene in self._scenes for group in scene.groups if group.identity]
        extent = extent_of(np.hstack([NOWHERE, *people, *centres]))
        return Plan(extent, *plan_size(extent, height), self._around.field, self._around.edges)

    def _with_contours(self, picture: Image, groups: Iterable[PlanGroup]) -> Image:
        """The picture with the contours that the camera shows."""
        if (camera := self._around.camera) is None:
            return picture
        rings = [(group, [_in_image(camera, ring) for ring in group.contours]) for group in groups]
        shown = [replace(group, contours=tuple(ring for ring in seen if ring.shape[1])) for group, seen in rings]
        return draw_contours(picture, tuple(shown))


class GroupObserver(RunObserver):
    """Finds groups during a run on the ground plane; ``story`` takes them in.

    Members are the identities of the confirmed online rows. A frame's rows come ``delay`` frames later; until then its
    number, time, mixture and the places of its detections wait.
    """

    def __init__(self, settings: GroupStages, stages: AnyStages, delay: int, story: GroupStory) -> None:
        self._settings, self._stages, self._delay, self._story = settings, stages, delay, story
        self._state, self._waiting = LifeCycleState(), deque[tuple[int, float, GaussianMixture, F8]]()

    def take(self, step: Step, state: TrackingState) -> None:
        """Take in a step; the frame whose rows it brings is grouped."""
        sensor, min_weight = self._stages.model.sensor, self._settings.grouping.min_weight
        z = sensor.measure(step.detections)
        usable = np.ascontiguousarray(z[:, np.isfinite(z).all(axis=0)])
        mixture = mixture_of(state.intensity, step, usable, self._stages, min_weight)
        self._waiting.append((step.number, step.time, mixture, places(sensor, step.detections.xyxy)))
        if len(self._waiting) > self._delay:
            self._group(step.tracks)

    def flush(self, rows: Tracks) -> None:
        """Group the frames that are left."""
        while self._waiting:
            self._group(rows)

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Give people on the plan the identities of the corrected tracks, as in the annotated video."""
        place = places(self._stages.model.sensor, tracks.xyxy)

        def corrected(scene: PlanScene) -> I8:
            lo, hi = np.searchsorted(tracks.frame, [scene.number, scene.number + 1])
            return nearest(scene.people, place[:, lo:hi], tracks.identity[lo:hi])

        self._story.rename(corrected)

    def _group(self, tracks: Tracks) -> None:
        """Group the first frame that waits."""
        number, time, mixture, detections = self._waiting.popleft()
        rows = tracks.take((tracks.frame == number) & tracks.confirmed)
        place = places(self._stages.model.sensor, rows.xyxy)
        carrier = carriers(mixture, place, self._settings.grouping.min_weight)
        self._state, frame = self._settings.advance(self._state, mixture, rows.identity, carrier, number, time)
        self._story.add(frame, place[:, np.searchsorted(rows.identity, frame.member)], detections)


def nearest(people: F8, place: F8, identity: I8) -> I8:
    """(n,) the identity (M,) of the row at the nearest ``place`` (2, M) to each of the ``people`` (2, n); 0 where none is
    near."""
    apart = np.hypot(*(people[:, :, None] - place[:, None]))
    apart = np.where(np.isfinite(apart), apart, np.inf)
    if apart.size == 0:
        return np.zeros(people.shape[1], np.int64)
    closest = apart.argmin(axis=1)
    return np.where(apart.min(axis=1) < _SAME, identity[closest], 0)


def _in_image(camera: Camera, ring: F8) -> F8:
    """(2, K) the ring (2, K) of ground points in pixels, closed, without the points that no pixel shows; (2, 0) where fewer
    than three are left."""
    pixel = camera.pixels(ring)
    seen = pixel[:, np.isfinite(pixel).all(axis=0)]
    if seen.shape[1] < 3:
        return NOWHERE
    return seen if np.array_equal(seen[:, 0], seen[:, -1]) else np.hstack([seen, seen[:, :1]])


def _polygons(rings: Sequence[F8], drawn: Sequence[F8]) -> str:
    """WKT of closed rings (2, K) on the ground, the first point last; clockwise ones are holes of the ring around them.

    ``drawn`` are the rings as they are to be written, maybe in another plane, where they may run the other way round.
    """
    text = ["(" + ", ".join(f"{x:.6g} {y:.6g}" for x, y in ring.T) + ")" for ring in drawn]
    shown = [k for k, ring in enumerate(drawn) if ring.shape[1]]
    outer = {k: [text[k]] for k in shown if polygon_area(rings[k]) > 0}
    for k in shown:
        around = [o for o in outer if k not in outer and _inside(rings[k][:, 0], rings[o])]
        for o in around[:1]:
            outer[o].append(text[k])
    return "MULTIPOLYGON (" + ", ".join("(" + ", ".join(part) + ")" for part in outer.values()) + ")" if outer else _EMPTY


def _inside(point: F8, ring: F8) -> bool:
    outline = np.ascontiguousarray(ring.T.astype(np.float32))[:, None]
    return bool(cv2.pointPolygonTest(outline, (float(point[0]), float(point[1])), False) >= 0)


def _plan_group(frame: GroupFrame, g: int) -> PlanGroup:
    groups, mean = frame.groups, frame.groups.mean[:, g]
    return PlanGroup(
        int(frame.identity[g]), float(groups.count[g]), float(groups.deviation[g]), mean[:2], mean[2:4], frame.contours[g]
    )
