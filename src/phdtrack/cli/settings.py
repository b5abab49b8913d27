"""From options to settings (`chosen`), and ``phdtrack settings``, which prints them as TOML that ``--config`` reads back.

The meaning of each setting is what the docstring of its class says under Parameters.
"""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from phdtrack.cli.options import Config, Json, Preset, Sets
from phdtrack.cli.output import Output

if TYPE_CHECKING:
    from phdtrack.config import Settings

# The settings to know, besides preset, scene and filter.
MAIN = {
    "motion": ("acceleration", "survival_probability"),
    "sensor": ("detection_probability", "box_noise"),
    "birth": ("births_per_second",),
    "clutter": ("clutter_per_frame",),
    "associate": ("min_track_length", "max_coast", "output_delay"),
}


@dataclass(frozen=True, slots=True)
class Choice:
    """How to track. Empty text and None stand for an option that was not given; ``truth`` is the file to score against."""

    filter_name: str = ""
    preset: str = ""
    config: Path | None = None
    sets: tuple[str, ...] = ()
    seed: int = 0
    truth: Path | None = None
    threads: int | None = None
    scene: Path | None = None
    learn_online: bool = False
    camera_motion: str = ""


def chosen(choice: Choice) -> Settings:
    """The settings: those of preset and file with the options in their place.

    Raises
    ------
    InputError : a file that cannot be read, an unknown name, options that do not go together.
    """
    from phdtrack.config import load, overlay
    from phdtrack.config.kinds import settable

    sets = list(choice.sets)
    if choice.scene is not None:
        sets.insert(0, f"scene={choice.scene}")
    if choice.learn_online:
        sets.insert(0, "learn.kind=online")
    if choice.camera_motion in ("none", "flow"):
        sets.insert(0, f"camera_motion.kind={choice.camera_motion}")
    elif choice.camera_motion:
        sets[:0] = ["camera_motion.kind=file", f"camera_motion.file={json.dumps(choice.camera_motion)}"]
    settings = load(choice.config, sets, choice.preset, choice.filter_name)
    if choice.threads is None:
        return settings
    # Filter and extraction, where they can use more than one.
    sharing = [name for name in ("filter", "extract") if "threads" in settable(name, settings.kind(name), "")]
    return overlay(settings, {name: {"threads": choice.threads} for name in sharing}, "--threads")


def settings(
    preset: Preset = "",
    filter_name: Annotated[str, typer.Option("--filter", metavar="NAME", help="Another filter than the preset's.")] = "",
    config_file: Config = None,
    sets: Sets = None,
    everything: Annotated[bool, typer.Option("--all", help="Every setting, not only the dozen to know.")] = False,
    json: Json = False,
) -> None:
    """Print settings as TOML, with units and meaning, for --config to read back.

    Without options these are the defaults. A preset is a complete set of values; --config and --set put others in place.
    """
    from phdtrack.config import load

    found, out = load(config_file, tuple(sets or ()), preset, filter_name), Output(json)
    out.say(as_toml(found, everything=everything))
    out.document(found.as_dict())


def as_toml(found: Settings, *, everything: bool) -> str:
    """The settings as a TOML file; all of them, or kinds and the dozen to know with what differs from the preset."""
    from phdtrack.config.kinds import SECTIONS, record
    from phdtrack.config.presets import PRESETS

    names = ", ".join(PRESETS)
    lines = [f'preset = "{found.preset}"  # {names}', '# scene = "FILE"  # what `phdtrack learn` has learned of this scene']
    for section, values in found.as_dict().items():
        if section == "preset":
            continue
        kind, kinds = found.kind(section), list(SECTIONS[section])
        given = found.given.get(section, {})
        shown = {k: v for k, v in values.items() if everything or k in MAIN.get(section, ()) or k in given}
        if section == "filter":
            shown = {"kind": kind, **shown}
        shown = {key: value for key, value in shown.items() if key != "kind" or everything or section == "filter" or given}
        if not shown:
            continue
        lines += ["", f"[{section}]"]
        meaning = meanings(record(section, kind))
        for key, value in shown.items():
            words = f"{', '.join(kinds)}" if key == "kind" else meaning.get(key, "")
            line = f"{key} = {toml_value(value)}"
            lines.append(f"{line}  # {words}" if words else line)
    return "\n".join(lines)


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(value)


def meanings(kind: type[Any]) -> dict[str, str]:
    """What the docstring of a class says of each of its parameters, in one line."""
    text = inspect.cleandoc(kind.__doc__ or "")
    found = dict(re.findall(r"``(\w+)``: ([^;.]+)", text))
    _, _, parameters = text.partition("Parameters\n----------\n")
    for names, words in re.findall(r"^([\w, ]+?) : (.*(?:\n    .*)*)", parameters.split("\n\n")[0], re.MULTILINE):
        found |= dict.fromkeys(names.split(", "), words)
    # The first sentence of each, on one line.
    said = {name: re.split(r"(?<=[^.\d])\. ", " ".join(words.split()))[0] for name, words in found.items()}
    return {name: words.rstrip(".").replace("`", "") for name, words in said.items()}
