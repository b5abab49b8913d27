"""From options to settings (`chosen`), and ``phdtrack settings``, which prints them as TOML that
``--config`` reads back.

The meaning of each setting is what the docstring of its class says under Parameters.
"""

from __future__ import annotations

import inspect
import json
import re
import textwrap
from collections.abc import Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from phdtrack import pipeline
from phdtrack.cli import options as given
from phdtrack.cli.options import TrackingOptions
from phdtrack.cli.output import Output
from phdtrack.config import Settings, load, overlay
from phdtrack.config.presets import PRESETS
from phdtrack.config.registry import SECTIONS, record, settable
from phdtrack.filters import NoFilter
from phdtrack.protocols import AnyStages
from phdtrack.report.pages import lines
from phdtrack.types import F8, Detections, SequenceInfo

# An object detected so often in a row must have been reported; after more than _SLOW detections the
# user is warned.
_TRIED = 25
_SLOW = 5
# The ten settings that people need first, besides preset and scene: of two rates the one that holds.
MAIN = {
    "motion": ("acceleration", "noise_variance", "survival_probability"),
    "sensor": ("detection_probability", "box_noise"),
    "birth": ("births_per_second", "births_per_detection"),
    "clutter": ("clutter_per_frame", "clutter_per_detection"),
    "filter": ("kind",),
    "associate": ("min_track_length", "max_coast", "output_delay"),
}
_RATES = {name for section in ("birth", "clutter") for name in MAIN[section]}


def chosen(options: TrackingOptions, first: Sequence[str] = (), *, detector: str = "") -> Settings:
    """The settings of the options: those of preset and file, then of ``first``, then of the
    options, each in place of those before.

    ``detector`` is the name of the detector that makes the boxes, empty for boxes of a file.
    """
    sets = [*first, *(options.sets or ()), *only_classes(options.classes)]
    settings = load(options.config, sets, options.preset, options.filter_name, detector)
    if options.max_detections is not None:
        settings = overlay(
            settings, {"limits": {"max_detections": options.max_detections}}, "--max-detections"
        )
    if options.threads is None:
        return settings
    # Filter and extraction, if they can use more than one.
    parallel = [
        name for name in ("filter", "extract") if "threads" in settable(name, settings.kind(name))
    ]
    return overlay(settings, {name: {"threads": options.threads} for name in parallel}, "--threads")


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


def settings(
    output: Output,
    preset: given.Preset = "",
    filter_name: given.Filter = "",
    config: given.Config = None,
    sets: given.Sets = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Every setting, not only the ten to know first.")
    ] = False,
) -> None:
    """Print settings as TOML, with units and meaning, for --config to read back.

    Without options these are the defaults. A preset is a complete set of values; --config and --set
    replace some of them.
    """
    found = load(config, sets or (), preset, filter_name)
    output.say(as_toml(found, everything=everything))
    output.document(found.as_dict())


def as_toml(found: Settings, *, everything: bool) -> str:
    """The settings as a TOML file; all of them, or kinds and the ten to know with what differs from
    the preset.
    """
    presets = textwrap.wrap(f"Presets: {', '.join(PRESETS)}.", 98, break_on_hyphens=False)
    out = [*(f"# {line}" for line in presets), f'preset = "{found.preset}"']
    for section, values in found.as_dict().items():
        if section == "preset":
            continue
        stated = found.given.get(section, {})
        shown = dict(values)
        if not everything:
            first = {
                name for name in MAIN.get(section, ()) if name not in _RATES or values.get(name)
            }
            names = {*first, *stated, *(["kind"] if stated else [])}
            shown = {name: value for name, value in values.items() if name in names}
        if not shown:
            continue
        meaning = meanings(record(section, found.kind(section)))
        meaning["kind"] = ", ".join(SECTIONS[section])
        out += ["", f"[{section}]"]
        for name, value in shown.items():
            words = f"  # {meaning[name]}" if name in meaning else ""
            out.append(f"{name} = {toml_value(value)}{words}")
    return "\n".join(out)


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, (bool, str)):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(value)


def meanings(kind: type[Any]) -> dict[str, str]:
    """What the docstring of a class says of each of its parameters, in one line."""
    # What a kind has of another stands there.
    text = inspect.cleandoc(kind.__doc__ or "")
    above = [one for one in kind.__mro__[1:-1] if is_dataclass(one)]
    found = {name: words for one in above for name, words in meanings(one).items()}
    found |= dict(re.findall(r"``(\w+)``: ([^;.]+)", text))
    _, _, parameters = text.partition("Parameters\n----------\n")
    for names, words in re.findall(
        r"^([\w, ]+?) : (.*(?:\n    .*)*)", parameters.split("\n\n")[0], re.MULTILINE
    ):
        found |= dict.fromkeys(names.split(", "), words)
    # The first sentence of each, on one line.
    said = {
        name: re.split(r"(?<=[^.\d])\. ", " ".join(words.split()))[0]
        for name, words in found.items()
    }
    return {name: words.rstrip(".").replace("`", "") for name, words in said.items()}


def confirmation(stages: AnyStages, info: SequenceInfo, boxes: F8) -> tuple[str, ...]:
    """After how many detections of the usual size of ``boxes`` (n, 4) an object is reported: a
    note, and a warning where it takes long; nothing without boxes or a filter."""
    if isinstance(stages.filter, NoFilter) or not len(boxes):
        return ()
    width, height = np.median(boxes[:, 2:] - boxes[:, :2], axis=0)
    needed = detections_needed(stages, info, (float(width), float(height)))
    return lines("confirmation.txt", needed=needed, tried=_TRIED, slow=_SLOW)


def detections_needed(stages: AnyStages, info: SequenceInfo, size: tuple[float, float]) -> int:
    """Detections in a row of an object up to its first state; 0 for more than 25.

    The ratio of the densities of births and of clutter decides it, which settings do not show. So
    it is tried: an object of ``size`` (width, height in pixels) moves through the middle of the
    frame, by a tenth of its width a frame, and is detected in every frame: what stands still from
    its first frame on may be a false alarm that lasts.
    """
    centre = np.array([info.width, info.height]) / 2
    half = np.array(size) / 2
    box = np.concatenate([centre - half, centre + half])
    step = np.array([0.1 * size[0], 0, 0.1 * size[0], 0])
    frames = (
        (k, k / info.fps, Detections.of(box + (k - _TRIED / 2) * step))
        for k in range(1, _TRIED + 1)
    )
    steps = pipeline.run(stages, frames, np.random.default_rng(0))
    return next((step.number for _, step in steps if len(step.estimates)), 0)
