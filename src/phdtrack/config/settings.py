"""Settings from a preset, a TOML file and options, checked.

A configuration has sections, one for each part of the model and of the tracker. A section has the
settings of the class that it makes, which explains them, and, if there is a choice, ``kind``:

    preset = "m09"                 # see `presets`
    scene = "street.scene.json"    # what `phdtrack learn` has learned; optional
    [sensor]
    detection_probability = 0.9
    [filter]
    kind = "gm-phd"

On the command line the same is ``--set sensor.detection_probability=0.9``. A value that a preset
or the user states holds for every kind of its section that has a setting of this name, except that
a preset's [filter] is of its own filter. What nobody states is the default of the part itself. An
unknown name is an error that names the nearest one.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from phdtrack.config.presets import PRESETS, preset_values, usual_preset
from phdtrack.config.registry import (
    DECIDING,
    FITTING,
    LIMITS,
    MIXTURES,
    SECTIONS,
    constructor_defaults,
    record,
    settable,
)
from phdtrack.config.sections import Nothing, gaussians_at
from phdtrack.errors import InputError, did_you_mean
from phdtrack.files import read_toml

if TYPE_CHECKING:
    from phdtrack.config.section_types import Sections

Values = dict[str, Any]
# Seconds that a run over a stream remembers. Its corrected rows are final after half a minute and
# are made every half minute, so that each has half a minute of its past at least, and is smoothed
# three times.
STREAM_HISTORY = 90.0
# The greatest number of a class in a table of names.
_LAST_CLASS = 9999
# Sections whose settings the part checks that they are of.
_CHECKED_BY_PART = ("detector", "embedding")
# Sections with two rates, of which one is 0: in the neighbourhood of a box, and everywhere.
_RATES = {
    "birth": ("births_per_detection", "births_per_second"),
    "clutter": ("clutter_per_detection", "clutter_per_frame"),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """A preset and the values that a user states in place of its.

    Attributes
    ----------
    named : the preset that was named; empty for the usual one.
    given : the user's values by section.
    detector : the package's own detector that makes the boxes, if one does.
    """

    named: str
    given: Mapping[str, Values]
    detector: str = ""

    @property
    def preset(self) -> str:
        """The name of the preset."""
        if self.named:
            return self.named
        motion, filter_name = (
            self.given.get(section, {}).get("kind", SECTIONS[section][0]) for section in DECIDING
        )
        return usual_preset(motion, filter_name, self.detector)

    def kind(self, section: str) -> str:
        """The kind of a section: the user's, or the preset's. Another filter than the preset's
        brings its own extraction and association.

        Parameters
        ----------
        section : one of `registry.SECTIONS`.
        """
        stated = self.given.get(section, {}).get("kind")
        if stated is not None:
            return str(stated)
        usual = self._preset_kind(section)
        if section not in DECIDING:
            for deciding in DECIDING:
                kind = self.kind(deciding)
                fitting = FITTING[deciding, kind].get(section, (usual,))
                if usual not in fitting or kind != self._preset_kind(deciding):
                    usual = fitting[0]
        return usual

    def values(self, section: str) -> Values:
        """The values that the preset and the user state of a section, without its kind. Detectors
        and networks check their settings themselves.

        Parameters
        ----------
        section : one of `registry.SECTIONS`.
        """
        given = self.given.get(section, {})
        if section in _CHECKED_BY_PART:
            return dict(given)
        kind = self.kind(section)
        preset = preset_values(self.preset).get(section, {})
        if section == "filter" and preset.get("kind", kind) != kind:
            # The preset's values are of its own filter.
            preset = {}
        if section == "limits":
            preset = LIMITS[self.kind("filter")]
        stated = {**preset, **given}
        return {name: stated[name] for name in settable(section, kind) if name in stated}

    def build(self, section: str, **more: Any) -> Any:
        """The object that a section makes; of ``more``, which depends on the sequence, it takes the
        fields that its class has.

        Parameters
        ----------
        section : one of `registry.SECTIONS`.
        **more : values of fields that come from the sequence.
        """
        chosen = record(section, self.kind(section))
        if chosen is Nothing:
            return None
        values = self.values(section) | more
        values |= {name: gaussians_at(values[name]) for name in MIXTURES if name in values}
        names = {field.name for field in fields(chosen)}
        return chosen(**{name: value for name, value in values.items() if name in names})

    @property
    def of_classes(self) -> dict[str, Values]:
        """The settings that classes have of their own, by name or number."""
        given = self.given.get("classes", {})
        return {label: dict(own) for label, own in given.items() if isinstance(own, Mapping)}

    def as_dict(self) -> dict[str, Any]:
        """Every setting with its value: what run.json records and `load` reads back."""
        out: dict[str, Any] = {"preset": self.preset}
        for section in SECTIONS:
            kind = self.kind(section)
            values = {**constructor_defaults(section, kind), **self.values(section)}
            stated = {name: value for name, value in values.items() if value is not None}
            out[section] = {"kind": kind, **stated} if kind else stated
        out["classes"] |= self.of_classes
        return out

    def _preset_kind(self, section: str) -> str:
        """The kind that the preset states, or the first one."""
        return str(preset_values(self.preset).get(section, {}).get("kind", SECTIONS[section][0]))


class _Entry(NamedTuple):
    """A value that the user states, and where: for error messages."""

    section: str
    key: str
    value: Any
    where: str


def load(
    path: Path | None = None,
    sets: Sequence[str] = (),
    preset: str = "",
    filter_name: str = "",
    detector: str = "",
) -> Settings:
    """The settings of a preset with those of a TOML file and of options in their place; the last
    named wins. Raises `InputError` if the file cannot be read, a name is unknown, or a value is of
    the wrong type or out of bounds.

    Parameters
    ----------
    path : TOML file; None for none.
    sets : options as ``section.name=value`` or ``scene=FILE``.
    preset : name of the preset; empty for the file's, or the usual one (`presets.USUAL`).
    filter_name : the filter, as ``--filter`` names it; empty for the preset's or the file's.
    detector : the detector that makes the boxes; empty for those of a file or a caller.

    Returns
    -------
    The checked settings.
    """
    document, where = ({}, "configuration") if path is None else (read_toml(path), str(path))
    stated = document.pop("preset", "")
    named = preset or stated
    if named != "" and named not in PRESETS:
        raise _unknown("preset", str(named), PRESETS, "preset" if preset else where)
    options = [_assignment(text) for text in sets]
    if filter_name:
        for entry in options:
            if entry[:2] == ("filter", "kind") and entry.value != filter_name:
                problem = f"--filter {filter_name} and {entry.where} name two filters"
                raise InputError(problem, where="--filter", cure="Leave one out")
        options = [_Entry("filter", "kind", filter_name, "--filter"), *options]
    settings = _replaced(Settings(named, {}, detector), _entries(document, where))
    settings = _replaced(settings, options)
    _check(settings, where)
    return settings


def overlay(settings: Settings, sections: Sections, where: str = "settings") -> Settings:
    """``settings`` with the values of ``sections`` in place of theirs. Raises `InputError` as
    `load`.

    Parameters
    ----------
    settings : what is changed.
    sections : values by section and name, see `section_types`.
    where : who asks, for error messages.

    Returns
    -------
    The checked settings; the given ones are unchanged.
    """
    merged = _replaced(settings, _entries(sections, where))
    _check(merged, where)
    return merged


def for_run(settings: Settings, *, endless: bool) -> Settings:
    """The settings of a whole run: all of a file is remembered, and of a stream without end as much
    as its final rows need, unless the user states ``associate.history``.

    Parameters
    ----------
    settings : checked settings.
    endless : whether the source is a stream without end.

    Returns
    -------
    The settings with ``associate.history``.
    """
    if "history" in settings.given.get("associate", {}):
        return settings
    history = STREAM_HISTORY if endless else 0.0
    return overlay(settings, {"associate": {"history": history}}, "the run")


def _entries(sections: Mapping[str, Any], where: str) -> list[_Entry]:
    """The values of a document. Raises `InputError` for an unknown section, or one that is no
    table.
    """
    entries: list[_Entry] = []
    for section, values in sections.items():
        if section not in SECTIONS:
            raise _unknown("section", section, list(SECTIONS), where)
        if section == "scene" and isinstance(values, (str, Path)):
            values = {"file": str(values)}
        if not isinstance(values, Mapping):
            raise InputError(
                f"expected a section [{section}] with names and values, got {values!r}", where=where
            )
        if section == "classes":
            # A class may be called by its number, and have its settings as a table.
            values = {str(name): value for name, value in values.items()}
            if "names" in values:
                values["names"] = _in_order(values["names"])
        entries += [_Entry(section, name, value, where) for name, value in values.items()]
    return entries


def _in_order(names: Any) -> Any:
    """Names of classes by number as a list, in which a class without a name has its number; what is
    no such table stays as it is.
    """
    if not isinstance(names, Mapping) or not names:
        return names
    words = [str(number) for number in names]
    if not all(word.isdecimal() and int(word) <= _LAST_CLASS for word in words):
        return names
    known = {int(word): name for word, name in zip(words, names.values(), strict=True)}
    return [known.get(number, str(number)) for number in range(max(known) + 1)]


def _replaced(settings: Settings, entries: Iterable[_Entry]) -> Settings:
    """``settings`` with the entries in place of theirs. Kinds come first: they decide which other
    names there are.
    """
    given = {section: dict(values) for section, values in settings.given.items()}
    merged = Settings(settings.named, given, settings.detector)
    kinds = [
        entry for entry in entries if entry.key == "kind" and entry.section not in _CHECKED_BY_PART
    ]
    for section, _, kind, where in kinds:
        known = SECTIONS[section]
        if known == ("",):
            problem = f"[{section}] comes in one kind only, got kind = {kind!r}"
            raise InputError(problem, where=where)
        if kind not in known:
            raise _unknown(f"kind of {section}", str(kind), known, where)
        given.setdefault(section, {})["kind"] = kind
    stated_now = {entry.section for entry in kinds}
    for deciding in stated_now & set(DECIDING):
        for section, fitting in FITTING[deciding, merged.kind(deciding)].items():
            # A kind that was stated earlier, for another filter or kind of motion.
            earlier = given.get(section, {}).get("kind", fitting[0])
            if section not in stated_now and earlier not in fitting:
                del given[section]["kind"]
    for entry in entries:
        if entry not in kinds:
            _state(merged, given, entry)
    return merged


def _state(settings: Settings, given: dict[str, Values], entry: _Entry) -> None:
    """Put an entry into ``given``, the user's values of ``settings``."""
    section, key, value, _ = entry
    values = given.setdefault(section, {})
    if section in _CHECKED_BY_PART:
        values[key] = value
        return
    own = key not in settable(section, settings.kind(section))
    if section == "classes" and own and isinstance(value, Mapping):
        values[key] = _merged(values.get(key), value)
        return
    value = _checked(settings, entry)
    values[key] = value
    rates = _RATES.get(section, ())
    if key in rates and value:
        # Of the two rates the one that is named last holds.
        other = rates[1 - rates.index(key)]
        if other in settable(section, settings.kind(section)):
            values[other] = 0.0


def _merged(earlier: Any, later: Any) -> Any:
    """Nested tables, those of ``later`` in place of the same ones of ``earlier``."""
    if not isinstance(earlier, Mapping) or not isinstance(later, Mapping):
        return later
    return {**earlier, **{name: _merged(earlier.get(name), own) for name, own in later.items()}}


def _checked(settings: Settings, entry: _Entry) -> Any:
    """The value of an entry as the type that its setting has, within its bounds."""
    from pydantic import TypeAdapter, ValidationError

    section, key, value, where = entry
    known = settable(section, settings.kind(section))
    if key not in known:
        others = [kind for kind in SECTIONS[section] if key in settable(section, kind)]
        owner = f"{section}.kind={' or '.join(others)}" if others else ""
        raise _unknown(f"setting of [{section}]", key, list(known), where, owner)
    if (section, key) == ("filter", "initial") and settings.kind("motion") != "plane":
        cure = "Use motion.kind=plane, or leave it out"
        raise InputError("filter.initial is of places on the ground", where=where, cure=cure)
    try:
        # A list may stand for a tuple and 5.0 for 5, but neither true nor "0.9" for a number.
        return TypeAdapter(known[key]).validate_python(value, strict=isinstance(value, (bool, str)))
    except ValidationError as error:
        message = error.errors()[0]["msg"].lower()
        raise InputError(f"{section}.{key}: {message}, got {value!r}", where=where) from None


def _check(settings: Settings, where: str) -> None:
    """Raise `InputError` if a section lacks a value, its values contradict each other, or kinds do
    not fit.
    """
    kinds = {section: settings.kind(section) for section in SECTIONS}
    world = str(preset_values(settings.preset).get("motion", {}).get("kind", SECTIONS["motion"][0]))
    if kinds["motion"] != world:
        problem = f"preset {settings.preset} is for motion.kind={world}, not {kinds['motion']}"
        raise InputError(problem, where=where, cure="Leave the preset or motion.kind out")
    for section in settings.given:
        if section in _CHECKED_BY_PART:
            continue
        kind = kinds[section]
        stated = {*constructor_defaults(section, kind), *settings.values(section)}
        missing = [name for name in settable(section, kind) if name not in stated]
        if missing:
            problem = f"[{section}] of kind {kind} needs a value for {missing[0]}"
            raise InputError(problem, where=where)
        settings.build(section, frame_size=(1.0, 1.0))
    for deciding, kind in kinds.items():
        for section, fitting in FITTING[deciding, kind].items():
            if kinds[section] not in fitting:
                problem = f"{section}.kind={kinds[section]} does not fit {deciding}.kind={kind}"
                cure = f"Use {section}.kind={' or '.join(fitting)}, or another {deciding}.kind"
                raise InputError(problem, where=where, cure=cure)


def _assignment(text: str) -> _Entry:
    """The entry of ``section.name=value``, or of ``scene=FILE``; the value is TOML, or a word
    without quotes.
    """
    path, equals, value = (part.strip() for part in text.partition("="))
    section, _, key = path.partition(".")
    if path == "scene" and value:
        return _Entry("scene", "file", value.strip("'\""), "--scene")
    if not equals or not key:
        cure = "For example: --set sensor.detection_probability=0.9"
        raise InputError("expected section.name=value", where=f"--set {text}", cure=cure)
    if section not in SECTIONS:
        raise _unknown("section", section, list(SECTIONS), f"--set {text}")
    key, *inner = key.split(".")
    stated = _parsed(value)
    for name in reversed(inner):
        stated = {name: stated}
    return _Entry(section, key, stated, f"--set {text}")


def _parsed(value: str) -> Any:
    """A value that was written as TOML, or a word without quotes."""
    # TOML needs a digit before the point; people who type .1 mean a number.
    plain = re.sub(r"^([+-]?)\.(?=\d)", r"\g<1>0.", value)
    try:
        return tomllib.loads(f"value = {plain}")["value"]
    except (ValueError, RecursionError):
        return value


def _unknown(what: str, name: str, known: Sequence[str], where: str, owner: str = "") -> InputError:
    """The error for an unknown name, with the nearest one, or all; ``owner`` is where else there is
    one of this name.
    """
    if owner:
        cure = f"It goes with {owner}; here there are {', '.join(known) or 'none'}."
    else:
        cure = did_you_mean(name, known)
    return InputError(f"unknown {what}: {name}", where=where, cure=cure)
