"""From settings to the stages of the pipeline: the model of the world, filter, extraction,
identities, learning.

``motion.kind`` chooses the world: boxes or points in an image, or people on a ground plane. What
depends on the sequence (the frame's size and rate) and on files (a camera, a learned scene) is
added here. Parts that were not chosen are not imported.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from phdtrack.config.sections import CameraSettings
from phdtrack.config.settings import Settings, load, overlay
from phdtrack.errors import InputError
from phdtrack.models.volumes import EVERYWHERE, Region, area, image_area
from phdtrack.protocols import AnyStages, Associator, Model, Stages
from phdtrack.smooth.online import DetectionShare
from phdtrack.types import SequenceInfo

if TYPE_CHECKING:
    from phdtrack.config.section_types import Sections
    from phdtrack.devices import Camera
    from phdtrack.groups.group_stages import GroupStages
    from phdtrack.scene import Scene

Size = tuple[float, float]
# The share of the weight of a person just missed that a Gaussian must have to count as one: E13's
# 0.25 of 0.297.
_MISSED = 0.84


def build(
    settings: Settings, info: SequenceInfo, filter_name: str = "", *, moving: bool = False
) -> AnyStages:
    """The stages that the settings name, for a sequence. Raises `InputError` if they do not go
    together, a file cannot be read, or they name a motion of the camera that the caller does not
    compensate.

    Parameters
    ----------
    settings : checked settings.
    info : width and height of the frames in pixels, frames per second.
    filter_name : a filter in place of ``filter.kind``; empty for that one.
    moving : whether the caller compensates the camera's motion.

    Returns
    -------
    The model of the world, filter, extractor, associator and the optional stages.
    """
    if not moving and settings.kind("camera_motion") != "none":
        cure = "Use phdtrack track --camera-motion, or Tracker.update(warp=…)"
        raise InputError(
            "the camera's motion is not followed here", where="camera_motion.kind", cure=cure
        )
    if filter_name:
        chosen = cast("Sections", {"filter": {"kind": filter_name}})
        settings = overlay(settings, chosen, "--filter")
    size = (float(info.width), float(info.height))
    scene = _learned_scene(settings, size)
    model = _model(settings, size, info.fps)
    if scene is not None:
        model = _with_scene(model, scene)
    # Weights are the probability that a target exists. The best hypothesis of PMBM and MHT has
    # those that it believes in, nearly all with 1.
    existence = settings.kind("filter") != "none" and settings.kind("extract") == "bernoullis"
    smoother = settings.build("smooth", frame_size=size, existence=existence)
    time = settings.build("time")
    associator = _associator(settings, scene)
    filter_ = settings.build("filter", frame_size=size)
    if settings.kind("filter") == "none":
        from phdtrack.filters.none import Raw

        return Stages(
            model,
            filter_,
            Raw(),
            associator,
            smoother=smoother,
            appearance=settings.build("appearance"),
            longest_interval=time.longest_interval,
            births_before=time.births_before,
        )
    # Births or clutter at fixed pixels hold for a camera that stands still.
    fixed = settings.kind("birth") == "places" or (
        scene is not None and (scene.births is not None or scene.clutter is not None)
    )
    explainer = settings.build("merged_measurements")
    # A detection of several targets is the box of none of them.
    shares = smoother.detection_share and explainer is None
    return Stages(
        model,
        filter_,
        settings.build("extract"),
        associator,
        settings.build("detection_scores"),
        explainer,
        smoother,
        DetectionShare() if shares else None,
        None if fixed else settings.build("common_motion", frame_size=size),
        settings.build("appearance"),
        time.longest_interval,
        time.births_before,
    )


def build_groups(settings: Settings, stages: AnyStages | None = None) -> GroupStages:
    """The stages that find groups, their life cycle and warnings; ``stages`` of the filter before
    them, None for known positions.

    If the intensity of a filter is grouped, ``groups.min_weight`` is, unless stated, no more than
    0.84 of the weight (1 − p_D) p_S of a person just missed once, at E13's 7 frames a second, so
    that one miss drops no person whatever the detection probability. With E13's values that is the
    default.

    Parameters
    ----------
    settings : checked settings.
    stages : of the filter before them; None for known positions.

    Returns
    -------
    The stages.
    """
    from phdtrack.groups.clusters import Grouping
    from phdtrack.groups.group_stages import GroupStages

    intensity = settings.kind("groups") == "intensity"
    stated = "min_weight" in settings.given.get("groups", {})
    if stages is not None and intensity and not stated:
        survival = settings.build("motion").survival_probability ** (1 / 7)
        missed = (1 - settings.build("sensor").detection_probability) * survival
        weight = min(Grouping().min_weight, _MISSED * missed)
        settings = overlay(settings, {"groups": {"min_weight": weight}})
    return GroupStages(
        settings.build("groups"),
        settings.build("contours"),
        encounters=settings.build("encounters"),
    )


def ground_model(settings: Settings, info: SequenceInfo) -> Model:
    """The model of people on the ground that the ``camera`` of the settings shows, whatever world
    they are tracked in.

    Parameters
    ----------
    settings : checked settings, with the camera in ``camera``.
    info : size of the frames in pixels, and their rate.

    Returns
    -------
    The model, positions in metres.
    """
    camera = cast("Sections", {"camera": settings.given.get("camera", {})})
    ground = overlay(load(None, ("motion.kind=plane",)), camera)
    return build(ground, info).model


def _model(settings: Settings, size: Size, fps: float) -> Model:
    """The model of the world, in an image or on the ground. Raises `InputError` if its parts do
    not go together.
    """
    rate = settings.build("time").units_per_second
    plane = settings.kind("motion") == "plane"
    camera, region = _ground(settings.build("camera"), size) if plane else (None, EVERYWHERE)
    sensor = settings.build("sensor", camera=camera, borders=region, frame_size=size)
    motion = settings.build(
        "motion",
        frame_size=size,
        # A target that has left the visible ground would live on, as it is never missed there.
        borders=region if plane and sensor.view else EVERYWHERE,
    )
    birth = settings.build("birth", frame_size=size, borders=region)
    volume = image_area(size) if settings.kind("clutter") == "point" else 0.0
    clutter = settings.build("clutter", frame_size=size, borders=region, volume=volume)
    if plane and clutter.clutter_per_frame and not clutter.density:
        area(region, "clutter.clutter_per_frame on the ground")
    return Model(motion, sensor, birth, clutter, rate, first=rate / fps if plane else 1.0)


def _ground(ground: CameraSettings, size: Size) -> tuple[Camera | None, Region]:
    """The camera, and the ground that counts: the region, or around what the image shows."""
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


def _learned_scene(settings: Settings, size: Size) -> Scene | None:
    """The parts of the learned scene that are used, None without a scene. Raises `InputError` if
    the scene does not fit the frames, the time unit or the motion.
    """
    options = settings.build("scene")
    if not options.file:
        return None
    if settings.kind("motion") != "box":
        problem = f"a learned scene does not fit motion.kind={settings.kind('motion')}"
        raise InputError(problem, where=options.file, cure="Use motion.kind=box, or no scene")
    from phdtrack.scene import read_scene

    scene = read_scene(Path(options.file))
    if (float(scene.width), float(scene.height)) != size:
        problem = (
            f"the scene was learned on frames of {scene.width}x{scene.height}, and these are"
            f" {size[0]:g}x{size[1]:g}"
        )
        cure = "Learn it on this video: phdtrack learn"
        raise InputError(problem, where=options.file, cure=cure)
    if "births" not in options.use:
        scene = replace(scene, births=None)
    if "clutter" not in options.use:
        scene = replace(scene, clutter=None)
    rate = settings.build("time").units_per_second
    if scene.births is not None and scene.rate != rate:
        problem = (
            f"births were learned with {scene.rate:g} time units a second, and there are {rate:g}"
        )
        cure = f"Say --set time.units_per_second={scene.rate:g}, or learn again"
        raise InputError(problem, where=options.file, cure=cure)
    return scene


def _with_scene(model: Model, scene: Scene) -> Model:
    """The model with what was learned: births and false alarms over the frame in place of uniform
    ones, in addition to those around each detection.
    """
    from phdtrack.models.scene import SceneBirth, SceneClutter

    birth: Any = model.birth
    clutter: Any = model.clutter
    if scene.births is not None:
        birth = SceneBirth(
            scene.births.rate * model.rate,
            scene.births.density,
            birth.particles,
            birth.births_per_detection,
            None if scene.followed is None else scene.followed.objects.density,
        )
    if scene.clutter is not None:
        clutter = SceneClutter(
            scene.clutter.rate, scene.clutter.density, clutter.clutter_per_detection
        )
    return replace(model, birth=birth, clutter=clutter)


def _associator(settings: Settings, scene: Scene | None) -> Associator[Any]:
    """The associator; false tracks are rejected if a scene has taught which false alarms are
    followed.
    """
    associator: Associator[Any] = settings.build("associate")
    if scene is None or scene.clutter is None:
        return associator
    if scene.followed is None or not scene.followed.share:
        return associator
    from phdtrack.associate.rejection import FalseTrackRejection
    from phdtrack.models.scene import FalseAlarmRatio

    ratio = FalseAlarmRatio(scene.clutter, scene.followed, scene.births)
    shortest = settings.build("associate").min_track_length
    return FalseTrackRejection(associator, ratio, min_track_length=shortest)
