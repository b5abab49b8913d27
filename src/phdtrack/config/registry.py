"""Every name that a configuration may have: sections, their kinds, the settings of each, and which
go together, from ``registry.toml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, get_type_hints

from phdtrack.config.sections import Places
from phdtrack.files import read_toml

_KINDS = {
    section: {"": kinds} if "class" in kinds else kinds
    for section, kinds in read_toml(Path(__file__).with_name("registry.toml")).items()
}
# section → its kinds, the default first; one without a name if there is no choice.
SECTIONS: Mapping[str, tuple[str, ...]] = {
    section: tuple(kinds) for section, kinds in _KINDS.items()
}
# Section and kind → the kinds of other sections that it goes together with, the default first.
FITTING: Mapping[tuple[str, str], Mapping[str, tuple[str, ...]]] = {
    (section, kind): {
        other: tuple(fitting)
        for other, fitting in entry.items()
        if other in _KINDS and other != "limits"
    }
    for section, kinds in _KINDS.items()
    for kind, entry in kinds.items()
}
# Filter → its values of [limits].
LIMITS: Mapping[str, Mapping[str, int]] = {
    kind: entry.get("limits", {}) for kind, entry in _KINDS["filter"].items()
}
# The sections whose kinds decide those of others.
DECIDING = ("motion", "filter")
# Fields that come from the sequence, or from the other parts of a tracker.
_FROM_SEQUENCE = {"frame_size", "camera", "hiders", "borders", "volume", "existence"}
# Fields that are mixtures of Gaussians, which a user gives as `Places`.
MIXTURES = ("places", "initial")


@cache
def record(section: str, kind: str) -> type[Any]:
    """The dataclass of this kind, imported now."""
    found: type[Any] = resolve_name(_KINDS[section][kind]["class"])
    return found


@cache
def settable(section: str, kind: str) -> Mapping[str, Any]:
    """The names that a user may set, and the type of each, bounds included."""
    chosen = record(section, kind)
    hints = get_type_hints(chosen, include_extras=True)
    hidden = {*_FROM_SEQUENCE, *_KINDS[section][kind].get("arguments", ())}
    names = [field.name for field in fields(chosen) if field.name not in hidden]
    return {name: Places if name in MIXTURES else hints[name] for name in names}


@cache
def constructor_defaults(section: str, kind: str) -> Mapping[str, Any]:
    """The defaults of the settings that have one."""
    defaults = {field.name: field.default for field in fields(record(section, kind))}
    return {
        name: defaults[name] for name in settable(section, kind) if defaults[name] is not MISSING
    }
