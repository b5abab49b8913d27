"""Presets, from ``presets.toml``, and the values of one with any filter and kind of motion.

`phdtrack settings --all` prints these values, completed by the defaults of the classes'
constructors.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from phdtrack.config.registry import FITTING, first_kind
from phdtrack.files import read_toml

Table = Mapping[str, Mapping[str, Any]]


def _complete(tables: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Each table of sections, with those of the one that it is based on."""
    found: dict[str, dict[str, Any]] = {}
    for name, sections in tables.items():
        found[name] = dict(found.get(sections.pop("based-on", ""), {}))
        for section, values in sections.items():
            found[name][section] = {key: _as_given(value) for key, value in values.items()}
    return found


def _as_given(value: Any) -> Any:
    """A value as the types of settings have it: numbers in a tuple, places as a list of tuples."""
    if not isinstance(value, list):
        return value
    if isinstance(value[0], list):
        return [tuple(place) for place in value]
    return tuple(value)


_FILE = read_toml(Path(__file__).with_name("presets.toml"))
_ON_THE_GROUND: Table = _FILE.pop("on-the-ground")
_DEFAULT_ON_THE_GROUND: Table = _FILE.pop("default-on-the-ground")
_WITH: Mapping[str, Table] = _complete(_FILE.pop("default-with"))
_WITH_ALL: Mapping[str, Table] = _FILE.pop("with")
PRESETS: Mapping[str, Table] = _complete(_FILE)


def _table(preset: str, motion: str, filter_name: str) -> Table:
    """The preset's values; the default's are of boxes and of its filter, with other filters there
    are others.
    """
    if preset != "default" or (motion or "box", filter_name or "pmb") == ("box", "pmb"):
        return PRESETS[preset]
    if (motion or "box") == "box":
        return _WITH.get(filter_name, _WITH["others"])
    return {}


def values_of(preset: str, motion: str = "", filter_name: str = "") -> dict[str, dict[str, Any]]:
    """The values of a preset by section, with their ``kind``; what a section leaves out has its
    constructor's default.

    Parameters
    ----------
    preset : a name of `PRESETS`.
    motion, filter_name : other kinds of ``[motion]`` and ``[filter]`` than the preset's; empty for
        the preset's. Sections whose kind does not fit get the first that does, and keep the values
        that both kinds of a section know.
    """
    table = {
        section: dict(values) for section, values in _table(preset, motion, filter_name).items()
    }
    moving, filtering = (
        table.get(section, {}).get("kind", first_kind(section)) for section in ("motion", "filter")
    )
    motion = motion or moving
    filter_name = filter_name or filtering
    if motion != moving:
        table["motion"] = {"kind": motion}
        for section, kinds in FITTING["motion", motion].items():
            table[section] = {"kind": kinds[0]}
    if filter_name != filtering:
        # What the default has with a filter is of this one.
        table["filter"] = {
            **(table.get("filter", {}) if preset == "default" else {}),
            "kind": filter_name,
        }
        for section, kinds in FITTING["filter", filter_name].items():
            table[section] = table.get(section, {}) | {"kind": kinds[0]}
    more = [_WITH_ALL.get(filter_name, {}), *([_ON_THE_GROUND] if motion == "plane" else [])]
    if (preset, motion, filter_name) == ("default", "plane", "pmb"):
        more.append(_DEFAULT_ON_THE_GROUND)
    if filter_name == "none":
        # A raw detection has no known velocity, so that the links of true tracks gain less than
        # those of filtered states.
        more.append({"associate": {"min_link_gain": 0.6}})
    for added in more:
        for section, values in added.items():
            table[section] = {**values, **table.get(section, {})}
    return table
