"""From the settings of classes to the stages that track each of them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from phdtrack.config.build import build
from phdtrack.config.sections import ClassOptions, Label
from phdtrack.config.settings import Settings, Values, overlay, parsed_value
from phdtrack.errors import InputError
from phdtrack.multiclass import ClassSettings
from phdtrack.types import SequenceInfo

# The sections of which a class may have values of its own.
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
    """
    options: ClassOptions = settings.build("classes")
    known = dict(enumerate(options.names)) | dict(names or {})
    # A file need not contain every class that the settings name.
    absent = _absent(options, known) if names else set()
    first = dict[int, int]()
    for group in options.together:
        members = [
            _number_of(label, known, None, "classes.together")
            for label in group
            if str(label).lower() not in absent
        ]
        first |= dict.fromkeys(members, members[0])
    own = _ClassValues()
    for text in options.each:
        label = text.partition(".")[0]
        if label.lower() not in absent:
            own.add(text, _number_of(label, known, None, f"classes.{text}"), first)
    # Without a camera positions are in metres, and the image's size says nothing about them.
    in_pixels = settings.kind("motion") != "plane" or settings.build("camera").file
    size = (float(info.width), float(info.height)) if in_pixels else (0.0, 0.0)
    return ClassSettings(
        build(settings, info, moving=moving),
        {
            number: build(overlay(settings, values, "classes"), info, moving=moving)
            for number, values in own.sections.items()
        },
        first,
        tuple(_number_of(label, known, present, "classes.only") for label in options.only),
        own.least,
        names=known,
        limits=settings.build("limits", frame_size=size),
    )


@dataclass(slots=True)
class _ClassValues:
    """Values that classes have of their own: sections by class, and by class the least score and
    the least length of a box's longer side.
    """

    sections: dict[int, dict[str, Values]] = field(default_factory=dict)
    least: dict[int, tuple[float, float]] = field(default_factory=dict)

    def add(self, text: str, number: int, first: Mapping[int, int]) -> None:
        """Add ``CLASS.section.name=value``, or one of the limits, of the class with this number;
        classes that are tracked together share the values of the ``first``. Raises `InputError` for
        any other setting.
        """
        path, _, value = text.partition("=")
        setting = path.partition(".")[2]
        section, _, key = setting.partition(".")
        score, side = self.least.get(number, (-math.inf, 0.0))
        if setting == "min_score":
            self.least[number] = (_number(value, f"classes.{text}"), side)
        elif setting == "min_size":
            self.least[number] = (score, _number(value, f"classes.{text}"))
        elif section in _SECTIONS and key and key != "kind":
            values = self.sections.setdefault(first.get(number, number), {})
            values.setdefault(section, {})[key] = parsed_value(value)
        else:
            sections = ", ".join(f"{name}.…" for name in _SECTIONS)
            raise InputError(
                f"a class has no {setting or 'such setting'} of its own",
                where=f"classes.{text}",
                cure=f"It may have min_score, min_size, {sections}; kinds hold for all classes.",
            )


def _absent(options: ClassOptions, known: Mapping[int, str]) -> set[str]:
    """The names, in lower case, of classes that the settings state and the detector does not
    have.
    """
    stated = [str(label) for group in options.together for label in group]
    stated += [text.partition(".")[0] for text in options.each]
    words = {label.lower() for label in stated if not label.isdecimal()}
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
        known = ", ".join(names.get(number, str(number)) for number in sorted(there))
        if known:
            cure = f"There are {known}."
        else:
            cure = "Say what the numbers stand for: classes.names, from class 0 on."
        raise InputError(f"there is no class {word} in these detections", where=where, cure=cure)
    return found


def _number(value: str, where: str) -> float:
    """The value as a number."""
    number: Any = parsed_value(value)
    if isinstance(number, bool) or not isinstance(number, (int, float)):
        raise InputError(f"expected a number, got {value}", where=where)
    return float(number)
