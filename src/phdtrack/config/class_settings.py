"""From the settings of classes to the stages that track each of them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, cast

from phdtrack.config.build import build
from phdtrack.config.sections import ClassOptions, Label
from phdtrack.config.settings import Settings, Values, overlay
from phdtrack.errors import InputError, did_you_mean
from phdtrack.multiclass import ClassSettings
from phdtrack.types import SequenceInfo

if TYPE_CHECKING:
    from phdtrack.config.section_types import Sections

# The sections of which a class may have values of its own.
SECTIONS = (
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
# The limits that a class may have, and what they are without it.
_LEAST: Values = {"min_score": -math.inf, "min_size": 0.0}


def build_classes(
    settings: Settings,
    info: SequenceInfo,
    names: Mapping[int, str] | None = None,
    present: Collection[int] | None = None,
    *,
    moving: bool = False,
) -> ClassSettings:
    """The stages of each class of a sequence. Raises `InputError` as `build`, for an unknown class,
    and for a setting that a class cannot have of its own.

    Parameters
    ----------
    settings : checked settings.
    info : of the sequence.
    names : the detector's names of the classes, if it has any; before ``classes.names``.
    present : the classes that occur; None if this is not known beforehand.
    moving : as for `build`.

    Returns
    -------
    The stages of every class, and what holds for all of them.
    """
    options: ClassOptions = settings.build("classes")
    known = dict(enumerate(options.names)) | dict(names or {})
    # A file need not contain every class that the settings name.
    stated = [*settings.of_classes, *(label for group in options.together for label in group)]
    absent = _absent(stated, known) if names else set()
    first = dict[int, int]()
    for group in options.together:
        members = [
            _number_of(label, known, None, "classes.together")
            for label in group
            if str(label).lower() not in absent
        ]
        first |= dict.fromkeys(members, members[0])
    own = {
        _number_of(label, known, None, f"classes.{label}"): values
        for label, values in settings.of_classes.items()
        if label.lower() not in absent
    }
    # Without a camera positions are in metres, and the image's size says nothing about them.
    in_pixels = settings.kind("motion") != "plane" or settings.build("camera").file
    size = (float(info.width), float(info.height)) if in_pixels else (0.0, 0.0)
    return ClassSettings(
        build(settings, info, moving=moving),
        {
            number: build(
                overlay(settings, cast("Sections", values), "classes"), info, moving=moving
            )
            for number, values in _own_sections(own, first).items()
        },
        first,
        tuple(_number_of(label, known, present, "classes.only") for label in options.only),
        {number: _least(values) for number, values in own.items() if values.keys() & _LEAST},
        names=known,
        limits=settings.build("limits", frame_size=size),
    )


def _own_sections(
    own: Mapping[int, Values], first: Mapping[int, int]
) -> dict[int, dict[str, Values]]:
    """The sections that classes have of their own, by class; classes that are tracked together
    share the values of the ``first``. Raises `InputError` for anything else but the limits.
    """
    sections = dict[int, dict[str, Values]]()
    for number, values in own.items():
        for name, value in values.items():
            if name in _LEAST:
                continue
            if name not in SECTIONS or not isinstance(value, Mapping) or "kind" in value:
                known = ", ".join((*_LEAST, *(f"{section}.…" for section in SECTIONS)))
                raise InputError(
                    f"a class cannot have {name} = {value} of its own",
                    where="classes",
                    cure=f"It may have {known}; kinds hold for all classes.",
                )
            stated = sections.setdefault(first.get(number, number), {})
            stated[name] = {**stated.get(name, {}), **value}
    return sections


def _least(values: Values) -> tuple[float, float]:
    """The least score and the least length of a box's longer side of a class."""
    stated = {**_LEAST, **values}
    for name in _LEAST:
        if isinstance(stated[name], bool) or not isinstance(stated[name], (int, float)):
            raise InputError(f"expected a number, got {stated[name]}", where=f"classes, {name}")
    return float(stated["min_score"]), float(stated["min_size"])


def _absent(labels: Iterable[Label], known: Mapping[int, str]) -> set[str]:
    """The names, in lower case, of classes that the detector does not have."""
    words = {str(label).lower() for label in labels if not str(label).isdecimal()}
    return words - {name.lower() for name in known.values()}


def _number_of(
    label: Label, names: Mapping[int, str], present: Collection[int] | None, where: str
) -> int:
    """The number of a class. Raises `InputError` if it is not among those ``present``, or no class
    has this name.
    """
    word = str(label).strip()
    numbers = {name.lower(): number for number, name in names.items()}
    found = numbers.get(word.lower())
    if found is None and word.lstrip("-").isdecimal():
        found = int(word)
    there = names if present is None else present
    if found is None or (present is not None and found not in there):
        known = [names.get(number, str(number)) for number in sorted(there)]
        if known:
            cure = did_you_mean(word.lower(), known)
        else:
            cure = "Say what the numbers stand for: classes.names, from class 0 on."
        raise InputError(f"there is no class {word} in these detections", where=where, cure=cure)
    return found
