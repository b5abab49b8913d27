"""From a request to settings: the same for every command."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from phdtrack.config import Settings, load, overlay
from phdtrack.config.registry import settable
from phdtrack.run.requests import TrackingRequest

if TYPE_CHECKING:
    from phdtrack.config.section_types import Sections


def chosen_settings(
    tracking: TrackingRequest, first: Sequence[str] = (), *, detector: str = ""
) -> Settings:
    """The settings of a request: those of preset and file, then of ``first``, then of the options,
    each in place of those before.

    Parameters
    ----------
    tracking : the options.
    first : settings as ``--set`` takes them.
    detector : name of the detector that makes the boxes; empty for those of a file.
    """
    sets = [*first, *(tracking.sets or ()), *only_classes(tracking.classes)]
    settings = load(tracking.config, sets, tracking.preset, tracking.filter_name, detector)
    if tracking.max_detections is not None:
        settings = overlay(
            settings, {"limits": {"max_detections": tracking.max_detections}}, "--max-detections"
        )
    if tracking.reidentify_within is not None:
        settings = overlay(
            settings,
            {"appearance": {"reidentify_within": tracking.reidentify_within}},
            "--reidentify-within",
        )
    if tracking.threads is None:
        return settings
    stated = {name: {"threads": tracking.threads} for name in _parallel(settings)}
    return overlay(settings, cast("Sections", stated), "--threads")


def _parallel(settings: Settings) -> list[str]:
    """Filter and extraction, if they can use more than one thread."""
    return [
        name for name in ("filter", "extract") if "threads" in settable(name, settings.kind(name))
    ]


def unused_options(
    tracking: TrackingRequest, settings: Settings, *, described: bool
) -> tuple[str, ...]:
    """Sentences about options of tracking that have no effect without another one.

    Parameters
    ----------
    tracking, settings : the options, and the settings that they lead to.
    described : whether it is known what the boxes look like.
    """
    found = list[str]()
    if tracking.reidentify_within is not None and not described:
        found.append(
            "--reidentify-within has no effect: it is not known what the objects look like. Say"
            " --appearance, for example colours, or leave it out."
        )
    if tracking.threads is not None and not _parallel(settings):
        found.append(
            f"--threads has no effect: the filter {settings.kind('filter')} has one thread. Say"
            " --filter particle-phd or particle-cphd, or leave it out."
        )
    return tuple(found)


def only_classes(text: str) -> list[str]:
    """The settings that ``--classes`` stands for, as ``--set`` takes them."""
    if text:
        return [f"classes.only={json.dumps([word.strip() for word in text.split(',')])}"]
    return []


def scene_settings(scene: Path | None, camera_motion: str = "") -> list[str]:
    """The settings that a learned scene and a moving camera stand for, as ``--set`` takes them."""
    sets = []
    if scene is not None:
        sets.append(f"scene={scene}")
    if camera_motion in ("none", "flow"):
        sets.append(f"camera_motion.kind={camera_motion}")
    elif camera_motion:
        sets += ["camera_motion.kind=file", f"camera_motion.file={json.dumps(camera_motion)}"]
    return sets
