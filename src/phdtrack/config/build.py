"""From settings to the stages of the pipeline: the model of the world, filter, extraction,
identities, learning.

``motion.kind`` chooses the world: boxes or points in an image, or people on a ground plane. What
depends on the sequence (the frame's size and rate) and on files (a camera, a learned scene) is put
in here. Parts that were not chosen are not imported.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from phdtrack.config.registry import CameraSettings, SceneClutterSettings
from phdtrack.config.settings import Settings, load, overlay
from phdtrack.errors import InputError
from phdtrack.models.volumes import EVERYWHERE, Region, area, image_area
from phdtrack.protocols import AnyStages, Associator, Birth, Clutter, Model, Stages
from phdtrack.smooth.online import DetectionShare
from phdtrack.types import SequenceInfo

if TYPE_CHECKING:
    from phdtrack.devices import Camera
    from phdtrack.groups.group_stages import GroupStages
    from phdtrack.scene import Scene

Size = tuple[float, float]
# The share of the weight of a person just missed that a Gaussian must have to count as one: E13's
# 0.25 of 0.297.
_MISSED = 0.84
# For corrected tracks of what a background detector found: how far its centre must get to be an
# object, and for how long its detections carry it on.
_OF_BACKGROUND = {"min_extent": 0.75, "max_continuation": 1.0}


def build(
    settings: Settings, info: SequenceInfo, filter_name: str = "", *, moving: bool = False
) -> AnyStages:
    """The stages that the settings name, for a sequence. Raises `InputError` where they do not go
    together, a file cannot be read, or they name a motion of the camera and the caller would not
    follow it.

    Parameters
    ----------
    settings : checked settings.
    info : width and height of the frames in pixels, frames per second.
    filter_name : a filter in place of ``filter.kind``; empty for that one.
    moving : whether the caller compensates the camera's motion.
    """
    if not moving and settings.kind("camera_motion") != "none":
        cure = "Use phdtrack track --camera-motion, or Tracker.update(warp=…)"
        raise InputError(
            "the camera's motion is not followed here", where="camera_motion.kind", cure=cure
        )
    if filter_name:
        settings = overlay(settings, {"filter": {"kind": filter_name}}, "--filter")
    size = (float(info.width), float(info.height))
    model = _model(settings, size, info.fps)
    associator = _associator(settings, size)
    smoother = settings.build("smooth", frame_size=size)
    slowest = settings.build("time").longest_interval
    if settings.kind("filter") == "none":
        from phdtrack.filters.none import Raw

        return Stages(
            model,
            settings.build("filter"),
            Raw(),
            associator,
            smoother=smoother,
            longest_interval=slowest,
        )
    filter_ = settings.build("filter", frame_size=size)
    scores = settings.build("detection_scores")
    explainer = settings.build("merged_measurements")
    # Births or clutter that lie at pixels hold for a camera that stands still.
    placed = {settings.kind("birth"), settings.kind("clutter")} & {"places", "scene"}
    if placed:
        camera = None
    else:
        camera = settings.build("common_motion", frame_size=size)
    # A detection of several targets says of none where it is.
    if smoother.detection_share and explainer is None:
        online = DetectionShare()
    else:
        online = None
    extractor = settings.build("extract")
    return Stages(
        model, filter_, extractor, associator, scores, explainer, smoother, online, camera, slowest
    )


def for_detector(settings: Settings, detector: str) -> Settings:
    """The settings for detections of this detector. Those of a background model get the
    merged-measurement model; corrected tracks go on while it still sees a part of an object, and
    what never goes anywhere has none.

    Settings that choose otherwise, or cannot have it, stay as they are.
    """
    from phdtrack.detect import BACKGROUND

    plain = settings.kind("motion") == "box" and settings.kind("filter") != "none"
    if detector not in BACKGROUND or not plain:
        return settings
    fresh: dict[str, dict[str, Any]] = {}
    if "merged_measurements" not in settings.given:
        fresh["merged_measurements"] = {"kind": "explained"}
    given = settings.given.get("smooth", {})
    fresh["smooth"] = {name: value for name, value in _OF_BACKGROUND.items() if name not in given}
    return overlay(settings, fresh, "--detector")


def build_groups(settings: Settings, stages: AnyStages | None = None) -> GroupStages:
    """What makes groups, their life cycle and warnings; ``stages`` where a filter comes before,
    None for known positions.

    Where the intensity of a filter is grouped, ``groups.min_weight`` is, unless given, no more than
    0.84 of the weight (1 − p_D) p_S of a person just missed once, at E13's 7 frames a second, so
    that one miss drops no person whatever the detection probability. With E13's values that is the
    default.
    """
    from phdtrack.groups.clusters import Grouping
    from phdtrack.groups.group_stages import GroupStages

    read = settings.kind("groups") == "intensity" and "min_weight" not in settings.given.get(
        "groups", {}
    )
    if stages is not None and read:
        survival = settings.build("motion").survival_probability ** (1 / 7)
        missed = (1 - settings.build("sensor").detection_probability) * survival
        settings = overlay(
            settings, {"groups": {"min_weight": min(Grouping().min_weight, _MISSED * missed)}}
        )
    return GroupStages(
        *(settings.build(section) for section in ("groups", "contours", "life_cycle", "encounters"))
    )


def ground_model(settings: Settings, info: SequenceInfo) -> Model:
    """The model of people on the ground that the ``camera`` of the settings shows, whatever world
    they are tracked in.
    """
    ground = overlay(
        load(None, ("motion.kind=plane",)), {"camera": settings.given.get("camera", {})}
    )
    return build(ground, info).model


def _model(settings: Settings, size: Size, fps: float) -> Model:
    """The model of the world, in an image or on the ground. Raises `InputError` where its parts do
    not go together.
    """
    rate = settings.build("time").units_per_second
    plane = settings.kind("motion") == "plane"
    camera, region = _ground(settings.build("camera"), size) if plane else (None, EVERYWHERE)
    sensor = settings.build("sensor", camera=camera, borders=region, frame_size=size)
    motion = settings.build(
        "motion",
        frame_size=size,
        # A target that has left what can be seen would else live on, as it is never missed there.
        borders=region if plane and sensor.view else EVERYWHERE,
    )
    birth = _birth(settings, size, region)
    clutter = _clutter(settings, size, region)
    if "scene" in (settings.kind("birth"), settings.kind("clutter")):
        from phdtrack.models.scene import in_one_volume

        birth, clutter = in_one_volume(birth, clutter)
    return Model(motion, sensor, birth, clutter, rate, first=rate / fps if plane else 1.0)


def _ground(ground: CameraSettings, size: Size) -> tuple[Camera | None, Region]:
    """The camera, and the ground that counts: as given, or around what the image shows."""
    from phdtrack.ground import CountedFrom, footprint, read_camera

    camera: Camera | None = read_camera(ground.file) if ground.file else None
    if camera is not None and ground.first_pixel:
        camera = CountedFrom(camera, ground.first_pixel)
    if ground.region != EVERYWHERE or camera is None:
        return camera, ground.region
    corners = footprint(camera, size, ground.max_distance)
    if corners.shape[1] == 0:
        problem = (
            f"the camera shows no ground nearer than {ground.max_distance:g} m in an image of"
            f" {size[0]:g}x{size[1]:g}"
        )
        cure = (
            "Check that the camera is this video's, raise camera.max_distance, or give"
            " camera.region"
        )
        raise InputError(problem, where=ground.file, cure=cure)
    left, low = corners.min(axis=1).tolist()
    right, high = corners.max(axis=1).tolist()
    return camera, (left, low, right, high)


def _birth(settings: Settings, size: Size, region: Region) -> Birth:
    """Where targets appear. Raises `InputError` where births were not learned, or for another
    rate.
    """
    kind = settings.kind("birth")
    birth = settings.build("birth", frame_size=size, borders=region)
    if kind != "scene":
        made: Birth = birth
        return made
    from phdtrack.models.scene import SceneBirth

    rate = settings.build("time").units_per_second
    scene = _scene(birth.file, size, rate)
    if scene.births is None:
        raise InputError(
            "births were not learned in this scene", where=birth.file, cure="Leave birth.kind out"
        )
    if scene.followed is None:
        among = None
    else:
        among = scene.followed.objects.density
    per_second = scene.births.rate * rate
    return SceneBirth(
        per_second, scene.births.density, birth.particles, birth.births_per_detection, among
    )


def _clutter(settings: Settings, size: Size, region: Region) -> Clutter:
    """Where false alarms are: in an image of this size, or on the ground in ``region``."""
    kind = settings.kind("clutter")
    if kind == "point":
        volume = image_area(size)
    else:
        volume = 0.0
    given = settings.build("clutter", frame_size=size, borders=region, volume=volume)
    if kind != "scene":
        if kind == "ground" and given.clutter_per_frame and not given.density:
            area(region, "clutter.clutter_per_frame on the ground")
        made: Clutter = given
        return made
    from phdtrack.models.scene import SceneClutter

    scene = _scene(given.file, size)
    if scene.clutter is None:
        raise InputError(
            "false alarms were not learned in this scene",
            where=given.file,
            cure="Leave clutter.kind out",
        )
    return SceneClutter(scene.clutter.rate, scene.clutter.density, given.clutter_per_detection)


def _associator(settings: Settings, size: Size) -> Associator[Any]:
    """What gives identities; false tracks are rejected where a scene has taught which false alarms
    are followed.
    """
    associator: Associator[Any] = settings.build("associate")
    given = settings.build("clutter")
    if not isinstance(given, SceneClutterSettings) or not given.reject_false_tracks:
        return associator
    from phdtrack.associate.rejection import FalseTrackRejection
    from phdtrack.models.scene import FalseAlarmRatio

    scene = _scene(given.file, size)
    if scene.clutter is None or scene.followed is None or not scene.followed.share:
        return associator
    same = settings.kind("birth") == "scene" and settings.build("birth").file == given.file
    false = FalseAlarmRatio(scene.clutter, scene.followed, scene.births if same else None)
    return FalseTrackRejection(
        associator,
        false,
        given.immediate_confirmation,
        settings.build("associate").min_track_length,
    )


def _scene(file: str, size: Size, rate: float = 0.0) -> Scene:
    """What was learned of a scene whose frames have this size, and its births at ``rate``, if
    given.
    """
    from phdtrack.scene import read_scene

    scene = read_scene(Path(file))
    if (float(scene.width), float(scene.height)) != size:
        problem = (
            f"the scene was learned on frames of {scene.width}x{scene.height}, and these are"
            f" {size[0]:g}x{size[1]:g}"
        )
        raise InputError(problem, where=file, cure="Learn it on this video: phdtrack learn")
    if rate and scene.births is not None and scene.rate != rate:
        problem = (
            f"births were learned with {scene.rate:g} time units a second, and there are {rate:g}"
        )
        cure = f"Say --set time.units_per_second={scene.rate:g}, or learn again"
        raise InputError(problem, where=file, cure=cure)
    return scene
