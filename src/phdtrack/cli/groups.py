"""``phdtrack groups``: groups of people on the ground, from a video or detections.

Contours are polygons in WKT (``MULTIPOLYGON``), on the ground in metres and, where there is a
camera, in pixels of the image. Rings that run clockwise on the ground are holes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, NamedTuple

import cv2
import numpy as np

from phdtrack import config
from phdtrack.cli import options as given
from phdtrack.cli.options import RunOptions, SourceOptions, TrackingOptions, option
from phdtrack.cli.output import Output, progress
from phdtrack.cli.show_settings import chosen, scene_settings
from phdtrack.cli.track import finish, prepare
from phdtrack.config import Settings, build_groups, ground_model
from phdtrack.devices import Camera
from phdtrack.errors import InputError
from phdtrack.files import load
from phdtrack.formats.write import Lines
from phdtrack.ground import footprint
from phdtrack.groups.clusters import Grouping
from phdtrack.groups.contours import polygon_area
from phdtrack.groups.group_stages import GroupFrame, GroupStages, carriers, mixture_of, on_ground
from phdtrack.groups.life_cycle import LifeCycleState
from phdtrack.groups.pairs import Pairs
from phdtrack.models import PlaneSensor
from phdtrack.pipeline import TrackingState
from phdtrack.protocols import AnyStages, Model
from phdtrack.report.drawing import draw_contours
from phdtrack.report.ground_plan import Plan, PlanScene
from phdtrack.report.pages import lines, render
from phdtrack.run import directory as rundir
from phdtrack.run.detection_log import EVERY
from phdtrack.run.directory import RunDirectory
from phdtrack.run.observers import Draw, Report, RunObserver
from phdtrack.run.video import places
from phdtrack.types import (
    F8,
    I8,
    Detections,
    GaussianMixture,
    Image,
    MeasurementHistory,
    SequenceInfo,
    Step,
    Tracks,
)
from phdtrack.video import VideoWriter

INTENSITY_FILTER = "gm-phd"
# Pictures of the report; smallest and usual height of a plan in pixels.
_STILLS = 4
_MIN_HEIGHT = 480
_HEIGHT = 720
# Metres around what a plan shows.
_PLAN_MARGIN = 1.5
_NOWHERE: F8 = np.zeros((2, 0))
_EMPTY = "MULTIPOLYGON EMPTY"
_HEADS = {
    rundir.GROUPS: "frame,time,group,count,deviation,x,y,vx,vy,contours,contours_image",
    rundir.MEMBERS: "frame,group,member",
    rundir.EVENTS: "frame,time,event,group,other",
    rundir.WARNINGS: "frame,time,first,second,seconds,distance,deviation,x,y,probability",
}


def groups(
    source: SourceOptions,
    options: TrackingOptions,
    output: Output,
    to: RunOptions,
    camera: Annotated[
        Path | None,
        option("FILE", "From pixels to the ground: Tsai XML, OpenCV, homography, TOML."),
    ] = None,
    edges: Annotated[
        Path | None,
        option("FILE", "Lines to draw on the plan, as road edges: x y in metres a line."),
    ] = None,
    video: given.Video = True,
    checkpoint_every: given.CheckpointEvery = EVERY,
) -> None:
    """Find groups of people on the ground, in a video or in a file of detections.

    The run's directory holds what that of `phdtrack track` does, and groups.csv (counts, places,
    contours), members.csv, events.csv, warnings.csv and plan.mp4: the ground from above beside the
    annotated video.
    """
    options = replace(options, sets=[*scene_settings(to.scene), *(options.sets or ())])
    settings = _ground_settings(options, camera)
    job = prepare(source, options, settings, to, video=video)
    stages = job.stages
    info = job.inputs.info
    reach = settings.build("camera").max_distance
    if settings.kind("motion") == "plane":
        model = stages.model
    else:
        model = ground_model(settings, info)
    grouping = build_groups(settings, stages)
    observer = GroupObserver(grouping, info, _read_edges(edges), World(stages, model, reach))
    # A group may have members of several classes.
    kinds = replace(job.kinds, apart=False)
    job = replace(
        job,
        kinds=kinds,
        ground=model.sensor,
        observers=(*job.observers, observer),
        every=checkpoint_every,
    )
    finish(output, job, to)


def _ground_settings(options: TrackingOptions, camera: Path | None) -> Settings:
    """The settings with this camera. Where groups are of an intensity, that of a filter of
    Gaussians on the ground plane.

    Raises `InputError` where there is no camera, or groups of an intensity are asked for in another
    world or of no filter.
    """
    said = config.load(options.config, options.sets or (), options.preset)
    usual = list[str]()
    if said.kind("groups") == "intensity":
        if said.kind("motion") == "box" and "kind" not in said.given.get("motion", {}):
            usual.append("motion.kind=plane")
        if (
            not options.filter_name
            and said.kind("filter") == "pmb"
            and "kind" not in said.given.get("filter", {})
        ):
            usual.append(f"filter.kind={INTENSITY_FILTER}")
    settings = chosen(options, usual)
    if camera is not None:
        settings = config.overlay(settings, {"camera": {"file": str(camera)}}, "--camera")
    if settings.kind("motion") not in ("box", "plane"):
        cure = "Use motion.kind=box or plane, or leave it out."
        raise InputError(
            "groups are of people in an image or on the ground", where="motion.kind", cure=cure
        )
    if settings.kind("groups") == "intensity":
        if settings.kind("motion") != "plane":
            cure = "Use motion.kind=plane, or groups.kind=pairs."
            raise InputError(
                "groups of an intensity are found on the ground", where="motion.kind", cure=cure
            )
        if settings.kind("filter") in ("none", "pmb", "mht", "mcmc"):
            cure = f"Use --filter {INTENSITY_FILTER}, or groups.kind=pairs."
            raise InputError(
                "this filter has no intensity",
                where=f"--filter {settings.kind('filter')}",
                cure=cure,
            )
    if not settings.build("camera").file:
        cure = "Name a file of the camera; phdtrack calibrate makes one of four points or more."
        raise InputError("where pixels are on the ground is not known", where="--camera", cure=cure)
    return settings


def _read_edges(path: Path | None) -> tuple[F8, ...]:
    """Lines (2, K) in metres: a point ``x y`` or ``x,y`` on each line of text, an empty line
    between one edge and the next.

    Raises `InputError` where the file is missing, or a line is not two numbers.
    """
    edges: list[list[tuple[float, float]]] = [[]]
    if path is not None:
        text = load(path).decode("utf-8-sig", errors="replace")
    else:
        text = ""
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            edges.append([])
            continue
        try:
            x, y = map(float, words)
        except ValueError:
            problem = f"expected a point of an edge, x and y in metres, got '{line.strip()[:40]}'"
            raise InputError(problem, where=f"{path}, line {number}") from None
        edges[-1].append((x, y))
    return tuple(np.array(edge).T for edge in edges if len(edge) > 1)


class World(NamedTuple):
    """Where detections are followed, and the model of people on the ground, which is shown up to
    ``max_distance`` metres from the camera."""

    stages: AnyStages
    ground: Model
    max_distance: float


class _Seen(NamedTuple):
    """A frame: its ``number``, its ``time`` in seconds, what the ground's sensor measures of all
    its detections (5, N), as rows of tracks count them, the places (2, n) in metres of those that
    were tracked, and the Gaussians that count, where groups are of an intensity."""

    number: int
    time: float
    z: F8
    places: F8
    mixture: GaussianMixture | None


class GroupObserver(RunObserver):
    """Finds groups on the ground plane among the corrected tracks when the run has ended, writes,
    draws and reports them.

    Until then it keeps of each frame the measurements, of an intensity its Gaussians, and the plan:
    some hundred bytes a person."""

    all_tracks = True

    def __init__(
        self, groups: GroupStages, info: SequenceInfo, edges: tuple[F8, ...], world: World
    ) -> None:
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
        self._seen = list[_Seen]()
        self._scenes = list[PlanScene]()

    def take(self, found: Detections, step: Step, state: TrackingState) -> None:
        """Keep what is needed of a frame."""
        sensor = self._world.ground.sensor
        grouping = self._groups.grouping
        mixture = None
        z = sensor.measure(step.detections)
        if isinstance(grouping, Grouping):
            usable = np.ascontiguousarray(z[:, np.isfinite(z).all(axis=0)])
            known = mixture_of(
                state.intensity, step, usable, self._world.stages, grouping.min_weight
            )
            heavy = known.weight >= grouping.min_weight
            mixture = GaussianMixture(
                known.weight[heavy], known.mean[:, heavy], known.covariance[heavy]
            )
        self._seen.append(_Seen(step.number, step.time, sensor.measure(found), z[:2], mixture))

    def finish(self, directory: RunDirectory, tracks: Tracks) -> None:
        """Find and write the groups of all frames among the corrected tracks."""
        # What stopped the run may have come between tracking a frame and taking it in here.
        known = tracks.select(np.isin(tracks.frame, [seen.number for seen in self._seen]))
        grouping = self._groups.grouping
        if isinstance(grouping, Pairs):
            found = self._by_pairs(known, grouping)
        else:
            found = self._of_intensity(known, grouping)
        with ExitStack() as files, progress("grouping", len(self._seen)) as advance:
            tables = {name: files.enter_context(Lines(directory.file(name))) for name in _HEADS}
            for name, head in _HEADS.items():
                tables[name].write(head)
            for done, (seen, (frame, place, identity)) in enumerate(
                zip(self._seen, found, strict=True), start=1
            ):
                self._write(frame, tables)
                self._scenes.append(PlanScene(frame, seen.places, place, identity))
                advance(done)

    def _by_pairs(self, tracks: Tracks, pairs: Pairs) -> Iterator[tuple[GroupFrame, F8, I8]]:
        """The groups of each frame, and places (2, n) and identities of its people, by evidence
        about every two.
        """
        model = self._world.ground
        number = np.array([seen.number for seen in self._seen], np.int64)
        start = np.concatenate([[0], np.cumsum([seen.z.shape[1] for seen in self._seen])]).astype(
            np.int64
        )
        time = np.array([seen.time for seen in self._seen]) * model.rate
        z = np.hstack([np.zeros((5, 0)), *(seen.z for seen in self._seen)])
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
        metres = places(self._world.ground.sensor, tracks.xyxy)
        for seen in self._seen:
            assert seen.mixture is not None
            rows = slice(*np.searchsorted(tracks.frame, [seen.number, seen.number + 1]))
            identity = tracks.identity[rows]
            place = metres[:, rows]
            carrier = carriers(seen.mixture, place, grouping.min_weight)
            state, frame = self._groups.advance(
                state, seen.mixture, identity, carrier, seen.number, seen.time
            )
            yield frame, place, identity

    def _write(self, frame: GroupFrame, tables: Mapping[str, Lines]) -> None:
        """A frame into the tables."""
        n = frame.number
        at = f"{frame.time:.6f}"
        found = frame.groups
        camera = self._camera
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
            write[rundir.WARNINGS](
                f"{n},{at},{w.first},{w.second},{close},{place},{w.probability:.4g}"
            )

    def drawing(self, directory: RunDirectory, files: ExitStack, *, pictures: bool) -> Draw:
        """plan.mp4, with the annotated pictures on its left where there are any."""
        left = 0
        height = _HEIGHT
        if pictures:
            height = max(self._info.height, _MIN_HEIGHT)
            left = 2 * round(self._info.width * height / self._info.height / 2)
        plan = self._plan(height + height % 2)
        scenes = {scene.frame.number: scene for scene in self._scenes}
        file = directory.file(rundir.PLAN)
        video = files.enter_context(
            VideoWriter(file, left + plan.width, plan.height, self._info.fps)
        )

        def draw(number: int, picture: Image) -> None:
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
            video.write(drawn)

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


def extent_of(places: F8) -> tuple[float, float, float, float]:
    """Left, low, right, high in metres of the ground to show, at least 8 m wide and high.

    It holds all ``places`` (2, N), NaN where not known, but the outermost hundredth on each side,
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
    shows; (2, 0) where fewer than three are left."""
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

    ``drawn`` are the rings as they are to be written, maybe in another plane, where they may run
    the other way round.
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
