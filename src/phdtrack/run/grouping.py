"""Groups of people on the ground as an observer of a run.

Contours are polygons in WKT (``MULTIPOLYGON``), on the ground in metres and, if there is a camera,
in pixels of the image. Rings that run clockwise on the ground are holes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np

from phdtrack.devices import Camera
from phdtrack.formats.write import Lines
from phdtrack.ground import footprint
from phdtrack.groups.clusters import Grouping
from phdtrack.groups.contours import polygon_area
from phdtrack.groups.group_stages import GroupFrame, GroupStages, carriers, mixture_of, on_ground
from phdtrack.groups.life_cycle import LifeCycleState
from phdtrack.groups.pairs import Pairs
from phdtrack.models import PlaneSensor
from phdtrack.opencv_package import cv2
from phdtrack.protocols import AnyStages, Model
from phdtrack.report.drawing import draw_contours
from phdtrack.report.ground_plan import Plan, PlanScene
from phdtrack.report.pages import lines, render
from phdtrack.run import directory as rundir
from phdtrack.run.directory import RunDirectory
from phdtrack.run.loop import TrackedFrame
from phdtrack.run.observers import Draw, Report, RunObserver
from phdtrack.run.reporter import SILENT, Reporter
from phdtrack.run.running import ground_places
from phdtrack.types import (
    F8,
    I8,
    GaussianMixture,
    Image,
    MeasurementHistory,
    SequenceInfo,
    Tracks,
)
from phdtrack.video import VideoWriter

# Pictures of the report; smallest and usual height of a plan in pixels.
_STILLS = 4
_MIN_HEIGHT = 480
_HEIGHT = 720
# Metres around what a plan shows.
_PLAN_MARGIN = 1.5
_NOWHERE: F8 = np.zeros((2, 0))
_EMPTY = "MULTIPOLYGON EMPTY"
# The files of groups, and their columns.
TABLES = {
    rundir.GROUPS: "frame,time,group,count,deviation,x,y,vx,vy,contours,contours_image",
    rundir.MEMBERS: "frame,group,member",
    rundir.EVENTS: "frame,time,event,group,other",
    rundir.WARNINGS: "frame,time,first,second,seconds,distance,deviation,x,y,probability",
}


class World(NamedTuple):
    """The stages that track, and the model of people on the ground, which is drawn up to
    ``max_distance`` metres from the camera.
    """

    stages: AnyStages
    ground: Model
    max_distance: float


class _GroundFrame(NamedTuple):
    """A frame: its ``number``, its ``time`` in seconds, the measurements (5, N) of all its
    detections on the ground, as rows of tracks count them, the places (2, n) in metres of those
    that were tracked, and the Gaussians that count, if groups are of an intensity.
    """

    number: int
    time: float
    z: F8
    places: F8
    mixture: GaussianMixture | None


class GroupObserver(RunObserver):
    """Finds groups on the ground plane among the corrected tracks when the run has ended, writes,
    draws and reports them.

    Until then it keeps the measurements of each frame and the Gaussians of an intensity: some
    hundred bytes a person.

    Parameters
    ----------
    groups : what makes groups.
    info : the sequence.
    edges : lines (2, K) in metres to draw on the plan.
    world : stages and ground model.
    reporter : shows progress.
    """

    all_tracks = True

    def __init__(
        self,
        groups: GroupStages,
        info: SequenceInfo,
        edges: tuple[F8, ...],
        world: World,
        reporter: Reporter = SILENT,
    ) -> None:
        self._reporter = reporter
        self._groups = groups
        self._info = info
        self._edges = edges
        self._world = world
        sensor = world.ground.sensor
        if isinstance(sensor, PlaneSensor):
            self._camera = sensor.camera
        else:
            self._camera = None
        self._field = _NOWHERE
        if self._camera is not None:
            self._field = footprint(self._camera, (info.width, info.height), world.max_distance)
        self._frames = list[_GroundFrame]()
        self._scenes = list[PlanScene]()

    def take(self, tracked: TrackedFrame) -> None:
        """Keep what is needed of a frame."""
        step = tracked.step
        sensor = self._world.ground.sensor
        grouping = self._groups.grouping
        mixture = None
        z = sensor.measure(step.detections)
        if isinstance(grouping, Grouping):
            usable = np.ascontiguousarray(z[:, np.isfinite(z).all(axis=0)])
            known = mixture_of(
                tracked.state.intensity, step, usable, self._world.stages, grouping.min_weight
            )
            heavy = known.weight >= grouping.min_weight
            mixture = GaussianMixture(
                known.weight[heavy], known.mean[:, heavy], known.covariance[heavy]
            )
        every = sensor.measure(tracked.detected.detections)
        self._frames.append(_GroundFrame(step.number, step.time, every, z[:2], mixture))

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Find and write the groups of all frames among the corrected tracks."""
        known = tracks.select(np.isin(tracks.frame, [seen.number for seen in self._frames]))
        grouping = self._groups.grouping
        if isinstance(grouping, Pairs):
            found = self._by_pairs(known, grouping)
        else:
            found = self._of_intensity(known, grouping)
        with (
            ExitStack() as files,
            self._reporter.progress("grouping", len(self._frames)) as advance,
        ):
            tables = {name: files.enter_context(Lines(directory.file(name))) for name in TABLES}
            for name, head in TABLES.items():
                tables[name].write(head)
            for done, (seen, (frame, place, identity)) in enumerate(
                zip(self._frames, found, strict=True), start=1
            ):
                write_frame(frame, tables, self._camera)
                self._scenes.append(PlanScene(frame, seen.places, place, identity))
                advance(done)

    def _by_pairs(self, tracks: Tracks, pairs: Pairs) -> Iterator[tuple[GroupFrame, F8, I8]]:
        """The groups of each frame, and places (2, n) and identities of its people, by evidence
        about every two.
        """
        model = self._world.ground
        number = np.array([seen.number for seen in self._frames], np.int64)
        start = np.concatenate([[0], np.cumsum([seen.z.shape[1] for seen in self._frames])]).astype(
            np.int64
        )
        time = np.array([seen.time for seen in self._frames]) * model.rate
        z = np.hstack([np.zeros((5, 0)), *(seen.z for seen in self._frames)])
        frames, weights = on_ground(
            tracks, MeasurementHistory(number, time, start, z, np.zeros((0, 3, 3))), model
        )
        state = LifeCycleState()
        labels = pairs.over_time(frames)
        for each, walkers, label, weight in zip(
            number.tolist(), frames, labels, weights, strict=True
        ):
            state, frame = self._groups.people(state, walkers, label, weight, each)
            yield frame, walkers.mean[:2], walkers.identity

    def _of_intensity(
        self, tracks: Tracks, grouping: Grouping
    ) -> Iterator[tuple[GroupFrame, F8, I8]]:
        """The same, frame by frame from the Gaussians that carry the tracks."""
        state = LifeCycleState()
        metres = ground_places(self._world.ground.sensor, tracks.xyxy)
        for seen in self._frames:
            assert seen.mixture is not None
            rows = slice(*np.searchsorted(tracks.frame, [seen.number, seen.number + 1]))
            identity = tracks.identity[rows]
            place = metres[:, rows]
            carrier = carriers(seen.mixture, place, grouping.min_weight)
            state, frame = self._groups.advance(
                state, seen.mixture, identity, carrier, seen.number, seen.time
            )
            yield frame, place, identity

    def drawing(self, directory: RunDirectory, files: ExitStack, *, pictures: bool) -> Draw:
        """A function that draws plan.mp4, with the annotated pictures on its left.

        Parameters
        ----------
        directory, files, pictures : as `RunObserver.drawing` has them.
        """
        left = 0
        height = _HEIGHT
        if pictures:
            height = max(self._info.height, _MIN_HEIGHT)
            wide = self._info.width * self._info.pixel_aspect
            left = 2 * round(wide * height / self._info.height / 2)
        plan = self._plan(height + height % 2)
        scenes = {scene.frame.number: scene for scene in self._scenes}
        file = directory.file(rundir.PLAN)
        video = files.enter_context(
            VideoWriter(file, left + plan.width, plan.height, self._info.fps)
        )

        def draw(number: int, time: float, picture: Image) -> None:
            scene = scenes.get(number)
            if scene is None:
                drawn = plan.ground
            else:
                drawn = plan.draw(scene)
            if left:
                if scene is None:
                    shown = picture
                else:
                    shown = self._with_contours(picture, scene.frame)
                drawn = np.hstack([cv2.resize(shown, (left, plan.height)), drawn])
            video.write(drawn, time)

        return draw

    def report(self) -> Report:
        """Counts, plan, events and warnings."""
        frames = [scene.frame for scene in self._scenes]
        counts = [scene.detections.shape[1] for scene in self._scenes]
        kinds = Counter(event.kind for frame in frames for event in frame.events)
        means: dict[str, list[float] | list[int]] = {
            "people_mean": [frame.people for frame in frames],
            "groups_mean": [frame.named for frame in frames],
            "detections_mean": counts,
        }
        document: dict[str, object] = {
            name: float(np.mean(each)) if each else None for name, each in means.items()
        }
        document |= {
            "identities": len(
                {identity for frame in frames for identity in frame.identity.tolist()} - {0}
            ),
            "events": {kind: kinds[kind] for kind in ("appear", "vanish", "merge", "split")},
            "warnings": sum(len(frame.warnings) for frame in frames),
        }
        known = {
            "found": document,
            "frames": frames,
            "detections": counts,
            "stills": self._stills(),
        }
        return Report(
            {"groups": document}, lines("groups.txt", **known), render("groups.html", **known)
        )

    def _stills(self) -> list[tuple[int, Image]]:
        """The plan at some frames, spread over those with people."""
        shown = [scene for scene in self._scenes if len(scene.frame)]
        plan = self._plan(_HEIGHT)
        chosen = dict.fromkeys(
            ((np.arange(_STILLS) + 0.5) / _STILLS * len(shown)).astype(int).tolist()
            if shown
            else ()
        )
        return [(shown[k].frame.number, plan.draw(shown[k])) for k in chosen]

    def _plan(self, height: int) -> Plan:
        """A plan of the ground on which people were."""
        people = [scene.people for scene in self._scenes]
        centres = [scene.frame.groups.mean[:2, scene.frame.identity > 0] for scene in self._scenes]
        return Plan(
            extent_of(np.hstack([_NOWHERE, *people, *centres])), height, self._field, self._edges
        )

    def _with_contours(self, picture: Image, frame: GroupFrame) -> Image:
        """The picture with the contours that the camera shows."""
        if (camera := self._camera) is None:
            return picture
        shown = [[_in_image(camera, ring) for ring in rings] for rings in frame.contours]
        contours = [[ring for ring in rings if ring.shape[1]] for rings in shown]
        return draw_contours(picture, contours)


def write_frame(frame: GroupFrame, tables: Mapping[str, Lines], camera: Camera | None) -> None:
    """Write the groups of a frame into the files of `TABLES`.

    Parameters
    ----------
    frame : the groups.
    tables : the open files, by name.
    camera : for contours in the image; None for none.
    """
    n = frame.number
    at = f"{frame.time:.6f}"
    found = frame.groups
    write = {name: table.write for name, table in tables.items()}
    for g, rings in enumerate(frame.contours):
        values = ",".join(
            f"{value:.7g}" for value in (found.count[g], found.deviation[g], *found.mean[:, g])
        )
        if camera is None:
            image = _EMPTY
        else:
            image = _polygons(rings, [_in_image(camera, ring) for ring in rings])
        write[rundir.GROUPS](
            f'{n},{at},{frame.identity[g]},{values},"{_polygons(rings, rings)}","{image}"'
        )
    for i in np.lexsort((frame.member, frame.membership)):
        write[rundir.MEMBERS](f"{n},{frame.membership[i]},{frame.member[i]}")
    for e in frame.events:
        write[rundir.EVENTS](f"{e.frame},{e.time:.6f},{e.kind},{e.group},{e.other}")
    for w in frame.warnings:
        numbers = (w.seconds, w.distance, w.deviation)
        close = ",".join(f"{value:.4g}" for value in numbers)
        place = f"{w.place[0]:.7g},{w.place[1]:.7g}"
        write[rundir.WARNINGS](f"{n},{at},{w.first},{w.second},{close},{place},{w.probability:.4g}")


def extent_of(places: F8) -> tuple[float, float, float, float]:
    """Left, low, right, high in metres of the ground to draw, at least 8 m wide and high.

    It holds all ``places`` (2, N), NaN if unknown, except the outermost hundredth on each side,
    which may be false alarms.
    """
    known = places[:, np.isfinite(places).all(axis=0)]
    low, high = np.quantile(known, [0.01, 0.99], axis=1) if known.size else np.zeros((2, 2))
    middle = (low + high) / 2
    half = np.maximum((high - low) / 2 + _PLAN_MARGIN, 4.0)
    left, below = (middle - half).tolist()
    right, above = (middle + half).tolist()
    return left, below, right, above


def _in_image(camera: Camera, ring: F8) -> F8:
    """(2, K) the ring (2, K) of ground points in pixels, closed, without the points that no pixel
    shows; (2, 0) if fewer than three are left.
    """
    pixel = camera.pixels(ring)
    seen = pixel[:, np.isfinite(pixel).all(axis=0)]
    if seen.shape[1] < 3:
        return _NOWHERE
    if np.array_equal(seen[:, 0], seen[:, -1]):
        return seen
    return np.hstack([seen, seen[:, :1]])


def _polygons(rings: Sequence[F8], drawn: Sequence[F8]) -> str:
    """WKT of closed rings (2, K) on the ground, the first point last; clockwise ones are holes of
    the ring around them.

    ``drawn`` are the rings to write, perhaps in another plane, in which they may run the other way
    round.
    """
    text = ["(" + ", ".join(f"{x:.6g} {y:.6g}" for x, y in ring.T) + ")" for ring in drawn]
    shown = [k for k, ring in enumerate(drawn) if ring.shape[1]]
    outer = {k: [text[k]] for k in shown if polygon_area(rings[k]) > 0}
    for k in shown:
        around = next(
            (o for o in outer if k not in outer and _inside(rings[k][:, 0], rings[o])), None
        )
        if around is not None:
            outer[around].append(text[k])
    if outer:
        return (
            "MULTIPOLYGON ("
            + ", ".join("(" + ", ".join(part) + ")" for part in outer.values())
            + ")"
        )
    return _EMPTY


def _inside(point: F8, ring: F8) -> bool:
    outline = np.ascontiguousarray(ring.T.astype(np.float32))[:, None]
    return bool(cv2.pointPolygonTest(outline, (float(point[0]), float(point[1])), False) >= 0)
