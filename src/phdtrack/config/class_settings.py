"""From the settings of classes to what each of them is tracked with."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

from phdtrack.config.build import build
from phdtrack.config.registry import ClassOptions, Label
from phdtrack.config.settings import Settings, overlay, parsed_value
from phdtrack.errors import InputError
from phdtrack.multiclass import ClassSettings
from phdtrack.types import SequenceInfo

# What a class may have of its own.
_SECTIONS = (
    "motion",
    "sensor",
    "birth",
    "clutter",
    "filter",
    "extract",
    "associate",
    "smooth",
    "detection_scores",
)
_LIMITS = {"min_score": 0, "min_size": 1}


def build_classes(
    settings: Settings,
    info: SequenceInfo,
    names: Mapping[int, str] | None = None,
    present: Collection[int] | None = None,
    *,
    moving: bool = False,
) -> ClassSettings:
    """How the classes of a sequence are tracked. Raises `InputError` as `build`, for a class that
    there is none of, and for a setting that a class cannot have of its own.

    Parameters
    ----------
    settings : checked settings.
    info : of the sequence.
    names : what its detections call the classes, if they do; before what ``classes.names`` says.
    present : the classes that there are; None where this is not known beforehand.
    moving : as for `build`.
    """
    given: ClassOptions = settings.build("classes")
    usual = build(settings, info, moving=moving)
    known = dict(enumerate(given.names)) | dict(names or {})
    only = tuple(_code(label, known, present, "classes.only") for label in given.only)
    # A file need not have every class that settings speak of.
    said = [label for group in given.together for label in group] + [
        text.partition(".")[0] for text in given.each
    ]
    words = {str(label).lower() for label in said if names}
    missing = {word for word in words if not word.isdecimal()} - {
        name.lower() for name in known.values()
    }
    first = dict[int, int]()
    for group in given.together:
        members = [
            _code(label, known, None, "classes.together")
            for label in group
            if str(label).lower() not in missing
        ]
        first |= dict.fromkeys(members, members[0] if members else 0)
    sections = dict[int, dict[str, dict[str, Any]]]()
    least = dict[int, tuple[float, float]]()
    for text in given.each:
        path, _, value = text.partition("=")
        label, _, rest = path.partition(".")
        if label.lower() in missing:
            continue
        code = _code(label, known, None, f"classes.{text}")
        section, _, key = rest.partition(".")
        if section in _LIMITS and not key:
            limits = [*least.get(code, (-math.inf, 0.0))]
            limits[_LIMITS[section]] = _number(value, f"classes.{text}")
            least[code] = limits[0], limits[1]
        elif section in _SECTIONS and key and key != "kind":
            sections.setdefault(first.get(code, code), {}).setdefault(section, {})[key] = (
                parsed_value(value)
            )
        else:
            cure = (
                f"It may have {', '.join((*_LIMITS, *(f'{name}.…' for name in _SECTIONS)))}; kinds"
                " are those of all classes."
            )
            raise InputError(
                f"a class has no {rest or 'such setting'} of its own",
                where=f"classes.{text}",
                cure=cure,
            )
    own = {
        code: build(overlay(settings, one, "classes"), info, moving=moving)
        for code, one in sections.items()
    }
    # Without a camera positions are in metres, which the image's size says nothing of.
    pictured = settings.kind("motion") != "plane" or settings.build("camera").file
    if pictured:
        size = (float(info.width), float(info.height))
    else:
        size = (0.0, 0.0)
    return ClassSettings(
        usual,
        own,
        first,
        only,
        least,
        names=known,
        limits=settings.build("limits", frame_size=size),
    )


def _code(
    label: Label, names: Mapping[int, str], present: Collection[int] | None, where: str
) -> int:
    """The number of a class. Raises `InputError` where it is not among those ``present``, or no
    class has this name.
    """
    word = str(label).strip()
    found = {name.lower(): code for code, name in names.items()}.get(word.lower())
    if found is None and word.lstrip("-").isdecimal():
        found = int(word)
    there = names if present is None else present
    if found is None or (present is not None and found not in there):
        known = ", ".join(names.get(one, str(one)) for one in sorted(there))
        if known:
            cure = f"There are {known}."
        else:
            cure = "Say what the numbers stand for: classes.names, from class 0 on."
        raise InputError(f"there is no class {word} in these detections", where=where, cure=cure)
    return found


def _number(value: str, where: str) -> float:
    """The value as a number."""
    found = parsed_value(value)
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        raise InputError(f"expected a number, got {value}", where=where)
    return float(found)
