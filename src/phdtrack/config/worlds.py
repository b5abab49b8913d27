"""From settings to a model of the world: boxes or points in an image, or people on a ground plane.

A world is chosen by ``motion.kind``; the other parts follow. What depends on the sequence (the frame's size and rate) and on
files (a camera, learned births) is put in here, when the model is built.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from phdtrack.arrays import to_cxcywh
from phdtrack.associate.rejection import FalseTrackRejection
from phdtrack.checks import NonNegative, Positive, PositiveCount, check
from phdtrack.errors import InputError
from phdtrack.ground import CountedFrom, footprint, read_camera
from phdtrack.models import (
    BoxSensor,
    FixedBirth,
    LocalClutter,
    LocalPlaneClutter,
    PlaneSensor,
    PointSensor,
    UniformClutter,
)
from phdtrack.models.followed_rates import FollowRates, priors
from phdtrack.models.followed_scene import FollowScene
from phdtrack.models.learned_scene import ContextBirth, ContextClutter, objects_of
from phdtrack.models.region import EVERYWHERE, PlaneVolume, Region, area, check_region
from phdtrack.models.volume import Volume, image_area, image_volume
from phdtrack.pipeline import ShadowTracker
from phdtrack.protocols import AnyStages, Associator, Birth, Camera, Clutter, Learning, Model
from phdtrack.scene import Scene, read_scene
from phdtrack.scene.clock import clock
from phdtrack.scene.odds import Odds
from phdtrack.scene.online import Following
from phdtrack.scene.rates import RatesSettings
from phdtrack.types import F8, GaussianMixture, SequenceInfo

Boxes = list[tuple[float, float, float, float]]
Places = list[tuple[float, float, float, float, float]]
"""Of each: x, y in metres, weight, standard deviations of position (m) and of velocity (m/s)."""


@dataclass(frozen=True, slots=True)
class TimeSettings:
    """``rate``: time units per second in which the noises and rates are stated; the papers' are per frame at 25 Hz."""

    rate: Positive = 25.0

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Settings of a detector, checked by the detector itself."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """Between pixels and ground, for ``motion.kind=plane``.

    ``file``: a camera (see `camera.read`); empty for detections that are in metres already. ``region``: the ground that
    counts, left, low, right, high in metres; all 0: what the image shows up to ``far`` metres, no border without a camera.
    ``first_pixel``: the number of the first pixel in the detections; 1 in MOTChallenge's files.
    """

    file: str = ""
    region: Region = EVERYWHERE
    far: Positive = 60.0
    first_pixel: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)
        check_region(self.region, "camera.region")


@dataclass(frozen=True, slots=True)
class ClutterSettings:
    """``rate``: expected false alarms per frame; ``volume``: spread over the image, or around each detection (local)."""

    rate: NonNegative = 1.0
    volume: Volume = "image"

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class PointClutterSettings:
    """``rate``: expected false alarms per frame, points spread over the image."""

    rate: NonNegative = 1.0

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class GroundClutterSettings:
    """False alarms on the ground.

    ``rate`` a frame, spread over the ``region`` or around each detection (``local``), or ``density`` a frame and m², which
    is taken instead where it is not 0.
    """

    rate: NonNegative = 0.3
    volume: PlaneVolume = "local"
    density: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class FixedBirthSettings:
    """``boxes``: where objects appear, as left, top, right, bottom; ``rate``: births per time unit at each."""

    boxes: Boxes
    rate: NonNegative = 0.01
    count: PositiveCount = 300

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class PlacesBirthSettings:
    """``places``: where people appear: x, y (m), births per second, deviations of position (m) and velocity (m/s)."""

    places: Places
    count: PositiveCount = 300

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class SceneBirthSettings:
    """``file``: births as `phdtrack learn` has learned them in this scene; ``most``: Jmax, see MeasurementBirth.

    ``beside``: births a time unit around each detection of a box where nothing is known of it, see ContextBirth; 0: none.
    """

    file: str
    most: PositiveCount = 500
    beside: NonNegative = 0.0

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class SceneClutterSettings:
    """``file``: false alarms as `phdtrack learn` has learned them in this scene.

    ``beside``: false alarms a frame around each detection that come to these, see ContextClutter. ``vet``: tracks that stay
    where false alarms are followed are held back, as far as `phdtrack learn` has seen what is followed
    (`associate.rejection`).
    ``sure``: then, too, a live track is confirmed at once where there are so many false alarms for each object, or fewer.
    """

    file: str
    beside: NonNegative = 0.0
    vet: bool = True
    sure: NonNegative = 0.1

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, slots=True)
class LearnSettings:
    """Learning births and false alarms while tracking, see `context.online`.

    Parameters
    ----------
    memory : minutes after which what was seen counts for 37 %.
    wait : seconds until a detection is judged, beyond ``associate.output_delay``.
    most : Jmax, see MeasurementBirth.
    switch : whether several modes of the scene (day, night) are told apart and chosen by evidence.
    schedule : modes by time of day instead, as ``07:00 day, 19:30 night``.
    starts : time of day at which the video begins, for ``schedule``.
    file : what was learned before; of several modes a folder with a file of each, as a run leaves them.
    """

    memory: Positive = 10.0
    wait: NonNegative = 2.0
    most: PositiveCount = 500
    switch: bool = False
    schedule: str = ""
    starts: str = "00:00"
    file: str = ""

    def __post_init__(self) -> None:
        check(self)
        clock(self.schedule, self.starts)
        if self.switch and self.schedule:
            raise InputError("modes are chosen by evidence or by time of day", where="learn.switch", cure="Leave one out")


class Record(Protocol):
    """What makes the record of a section from its settings and from values that are none."""

    def __call__(self, section: str, **more: Any) -> Any:
        """The record of ``section``."""


def build_model(record: Record, kinds: Mapping[str, str], info: SequenceInfo) -> Model:
    """The model that the settings name, for a sequence of this size. Raises `InputError` where they do not go together."""
    size, rate = (float(info.width), float(info.height)), record("time").rate
    if kinds["motion"] == "point":
        point: PointSensor = record("sensor")
        motion = record("motion", births=record("spawn"))
        clutter = UniformClutter(record("clutter").rate, image_area(size))
        return Model(motion, point, _image_birth(record, kinds["birth"], point, size), clutter, rate)
    if kinds["motion"] == "box":
        sensor: BoxSensor = record("sensor")
        remember = sensor.scaling == "previous"
        motion = record("motion", frame_size=size, births=record("spawn"), remember_size=remember)
        birth = _image_birth(record, kinds["birth"], sensor, size)
        return Model(motion, sensor, birth, _box_clutter(record, kinds["clutter"], size), rate)
    ground: CameraSettings = record("camera")
    camera: Camera | None = read_camera(ground.file) if ground.file else None
    if camera is not None and ground.first_pixel:
        camera = CountedFrom(camera, ground.first_pixel)
    region = _region(ground, camera, size)
    person: PlaneSensor = record("sensor", camera=camera, borders=region, frame_size=size)
    # Who has left what can be seen would else live on, as nobody misses him there.
    motion = record("motion", births=record("spawn"), borders=region if person.view else EVERYWHERE)
    birth = _ground_birth(record, kinds["birth"], person, region, size)
    return Model(motion, person, birth, _ground_clutter(record, region), rate, first=rate / info.fps)


def build_associator(record: Record, kinds: Mapping[str, str], info: SequenceInfo) -> Associator[Any]:
    """What gives identities; where a scene has taught which false alarms are followed, whoever stays there is held back."""
    associator: Associator[Any] = record("associate")
    if kinds["clutter"] != "scene":
        return associator
    given: SceneClutterSettings = record("clutter")
    scene = _scene(given.file, (float(info.width), float(info.height)))
    if not given.vet or scene.clutter is None or scene.followed is None or not scene.followed.share:
        return associator
    births = scene.births if kinds["birth"] == "scene" and record("birth").file == given.file else None
    return FalseTrackRejection(
        associator, Odds(scene.clutter, scene.followed, births), given.sure, record("associate").min_track_length
    )


def build_learning(record: Record, alone: AnyStages, info: SequenceInfo) -> FollowScene:
    """What learns the scene from what ``alone`` makes of it. Raises `InputError` where a file to begin with does not fit."""
    settings: LearnSettings = record("learn")
    size, rate = (float(info.width), float(info.height)), record("time").rate
    wait = settings.wait + record("associate").output_delay / info.fps
    rule = Following(*size, rate, 60 * settings.memory, wait, record("sensor").detection, settings.switch)
    scenes = tuple(_scene(file, size) for file in _scene_files(settings.file))
    if any(scene.births is not None and scene.rate != rate for scene in scenes):
        raise InputError(f"births were not learned with {rate:g} time units a second", where=settings.file)
    return FollowScene(
        rule, alone.model, ShadowTracker(alone), settings.most, scenes, clock(settings.schedule, settings.starts)
    )


def build_rates(record: Record, kind: str, model: Model, beside: Learning[Any], info: SequenceInfo) -> Learning[Any]:
    """What learns the rates of ``model`` while tracking, with what else is learned ``beside`` it."""
    if kind == "none":
        return beside
    settings: RatesSettings = record("rates")
    return FollowRates(settings.rule(priors(model), model.rate, record("associate").output_delay / info.fps), beside)


def initial_mixture(kinds: Mapping[str, str], record: Record, values: Boxes | Places) -> GaussianMixture:
    """The intensity before the first frame: boxes of weight 1, or places with their weights."""
    if kinds["motion"] == "plane":
        return _places([place for place in values if len(place) == 5])
    return _boxes(record("sensor"), [box for box in values if len(box) == 4], 1.0)


def _region(ground: CameraSettings, camera: Camera | None, size: tuple[float, float]) -> Region:
    """The ground that counts: as given, or around what the image shows."""
    if ground.region != EVERYWHERE or camera is None:
        return ground.region
    corners = footprint(camera, size, ground.far)
    if corners.shape[1] == 0:
        raise InputError(
            f"the camera shows no ground nearer than {ground.far:g} m in an image of {size[0]:g}x{size[1]:g}",
            where=ground.file,
            cure="Check that the camera is this video's, raise camera.far, or give camera.region",
        )
    (left, low), (right, high) = corners.min(axis=1), corners.max(axis=1)
    return float(left), float(low), float(right), float(high)


def _image_birth(record: Record, kind: str, sensor: BoxSensor | PointSensor, size: tuple[float, float]) -> Birth:
    if kind == "fixed":
        fixed: FixedBirthSettings = record("birth")
        return FixedBirth(_boxes(sensor, fixed.boxes, fixed.rate), fixed.count)
    if kind == "scene":
        return _scene_birth(record, size, sensor.observed)
    birth: Birth = record("birth", frame_size=size)
    return birth


def _scene_birth(record: Record, size: tuple[float, float], observed: tuple[int, ...]) -> ContextBirth:
    settings, rate = record("birth"), record("time").rate
    scene = _scene(settings.file, size)
    if scene.births is None:
        raise InputError("births were not learned in this scene", where=settings.file, cure="Leave birth.kind out")
    if scene.rate != rate:
        raise InputError(
            f"births were learned with {scene.rate:g} time units a second, and there are {rate:g}",
            where=settings.file,
            cure=f"Say --set time.rate={scene.rate:g}, or learn again",
        )
    # What is not shown are the two velocities.
    if scene.births.density.dim != len(observed) + 2:
        raise InputError(
            f"expected births of {len(observed) + 2} components, got {scene.births.density.dim}",
            where=settings.file,
            cure="Learn them with the motion.kind that they are used with",
        )
    if settings.beside > 0 and len(observed) != 4:
        raise InputError("births beside others are of boxes only", where="birth.beside", cure="Leave it out")
    among = objects_of(scene.followed)
    return ContextBirth(scene.births.rate, scene.births.density, observed, settings.most, settings.beside, among)


def _scene(file: str, size: tuple[float, float]) -> Scene:
    """What was learned of a scene whose frames have this size."""
    scene = read_scene(Path(file))
    if (float(scene.width), float(scene.height)) != size:
        raise InputError(
            f"the scene was learned on frames of {scene.width}x{scene.height}, and these are {size[0]:g}x{size[1]:g}",
            where=file,
            cure="Learn it on this video: phdtrack learn",
        )
    return scene


def _scene_files(named: str) -> list[str]:
    """The files of a scene's modes: those of a folder by name, or the file itself."""
    if not Path(named).is_dir() or not named:
        return [named] if named else []
    found = sorted(str(file) for file in Path(named).glob("scene*.json"))
    if not found:
        raise InputError("there is no scene*.json in this folder", where=named, cure="Name a run that has learned")
    return found


def _ground_birth(record: Record, kind: str, person: PlaneSensor, region: Region, size: tuple[float, float]) -> Birth:
    if kind == "places":
        fixed: PlacesBirthSettings = record("birth")
        return FixedBirth(_places(fixed.places), fixed.count)
    if kind == "scene":
        return _scene_birth(record, size, person.observed)
    birth: Birth = record("birth", borders=region)
    return birth


def _box_clutter(record: Record, kind: str, size: tuple[float, float]) -> Clutter:
    if kind == "scene":
        given: SceneClutterSettings = record("clutter")
        scene = _scene(given.file, size)
        if scene.clutter is None:
            raise InputError("false alarms were not learned in this scene", where=given.file, cure="Leave clutter.kind out")
        return ContextClutter(scene.clutter.rate, scene.clutter.density, given.beside)
    clutter: ClutterSettings = record("clutter")
    return LocalClutter(clutter.rate) if clutter.volume == "local" else UniformClutter(clutter.rate, image_volume(size))


def _ground_clutter(record: Record, region: Region) -> Clutter:
    clutter: GroundClutterSettings = record("clutter")
    if clutter.density > 0:
        return UniformClutter(clutter.density, 1.0)
    if clutter.volume == "local":
        return LocalPlaneClutter(clutter.rate)
    return UniformClutter(clutter.rate, area(region, "clutter.rate on the ground"))


def _boxes(sensor: BoxSensor | PointSensor, boxes: Boxes, weight: float) -> GaussianMixture:
    """Gaussians about given boxes, as uncertain as one detection of each."""
    xyxy: F8 = np.array(boxes, dtype=np.float64).reshape(-1, 4)
    if not np.isfinite(xyxy).all() or (xyxy[:, 2:] <= xyxy[:, :2]).any():
        raise InputError("expected boxes as left, top, right, bottom with left < right and top < bottom", where="boxes")
    mean, cov = sensor.states(to_cxcywh(xyxy))
    return GaussianMixture(np.full(len(xyxy), weight), mean, cov)


def _places(places: Places) -> GaussianMixture:
    """Gaussians at rest at given places of the ground."""
    x, y, weight, position, velocity = np.array(places, dtype=np.float64).reshape(-1, 5).T
    whole = np.isfinite(x + y + weight + position + velocity) & (weight >= 0) & (position > 0) & (velocity > 0)
    if not whole.all():
        raise InputError(
            "expected places as x, y, a weight from 0, deviations of position and of velocity above 0", where="places"
        )
    nothing = np.zeros(len(x))
    cov = np.square(np.stack([position, position, velocity, velocity], axis=1))[:, :, None] * np.eye(4)
    return GaussianMixture(weight.copy(), np.stack([x, y, nothing, nothing]), cov)
