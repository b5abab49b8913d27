"""``phdtrack settings``: settings as TOML that ``--config`` reads back.

The meaning of each setting is what the docstring of its class says under Parameters.
"""

from __future__ import annotations

import inspect
import json
import re
import textwrap
from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Annotated, Any

import typer

from phdtrack.cli import options as given
from phdtrack.cli.output import Output
from phdtrack.config import Settings, load
from phdtrack.config.presets import PRESETS
from phdtrack.config.registry import SECTIONS, record

# The ten settings that people need first, besides preset and scene; of two rates the one that
# holds.
MAIN = {
    "motion": ("acceleration", "noise_variance", "survival_probability"),
    "sensor": ("detection_probability", "box_noise"),
    "birth": ("births_per_second", "births_per_detection"),
    "clutter": ("clutter_per_frame", "clutter_per_detection"),
    "filter": ("kind",),
    "associate": ("min_track_length", "max_coast", "output_delay"),
}
_RATES = {name for section in ("birth", "clutter") for name in MAIN[section]}


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
            key = name if name.isidentifier() else json.dumps(name, ensure_ascii=False)
            out.append(f"{key} = {toml_value(value)}{words}")
    return "\n".join(out)


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, (bool, str)):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    if isinstance(value, Mapping):
        inside = (f"{json.dumps(name)} = {toml_value(own)}" for name, own in value.items())
        return f"{{{', '.join(inside)}}}"
    return repr(value)


def meanings(kind: type[Any]) -> dict[str, str]:
    """Meaning of each parameter, or attribute, of a class, from its docstring, in one line."""
    # What a kind has of another stands there.
    text = inspect.cleandoc(kind.__doc__ or "")
    above = [one for one in kind.__mro__[1:-1] if is_dataclass(one)]
    found = {name: words for one in above for name, words in meanings(one).items()}
    found |= dict(re.findall(r"``(\w+)``: ([^;.]+)", text))
    section = re.search(r"^(?:Parameters|Attributes)\n-{10}\n((?:.+\n?)*)", text, re.MULTILINE)
    entries = section[1] if section else ""
    for names, words in re.findall(r"^([\w, ]+?) : (.*(?:\n    .*)*)", entries, re.MULTILINE):
        found |= dict.fromkeys(names.split(", "), words)
    # The first sentence of each, on one line.
    said = {
        name: re.split(r"(?<=[^.\d])\. ", " ".join(words.split()))[0]
        for name, words in found.items()
    }
    return {name: words.rstrip(".").replace("`", "") for name, words in said.items()}
