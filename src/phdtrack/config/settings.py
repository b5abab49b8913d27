"""Settings from a preset, a TOML file and options, checked.

A configuration has sections, one for each part of the model and of the tracker. A section has the
settings of the class that it makes, which explains them, and, where there is a choice, ``kind``:

    preset = "m09"                 # default, mot15, m07, m09, fv, m09-mht, e13, d14
    scene = "street.scene.json"    # what `phdtrack learn` has learned; optional
    [sensor]
    detection_probability = 0.9
    [birth]
    kind = "measurement"           # measurement, uniform, scene

On the command line the same is ``--set sensor.detection_probability=0.9``. A preset is a complete
set of values (`presets.values_of`); what the user says replaces values of it. An unknown name is an
error that says the nearest one.
"""

from __future__ import annotations

import datetime
import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

from phdtrack.config.presets import PRESETS, values_of
from phdtrack.config.registry import (
    DECIDING,
    FITTING,
    MIXTURES,
    SECTIONS,
    Nothing,
    constructor_defaults,
    first_kind,
    gaussians_at,
    record,
    settable,
)
from phdtrack.errors import InputError, did_you_mean
from phdtrack.files import read_toml

Values = dict[str, Any]
# Sections with two rates, of which one is 0: in the neighbourhood of a box, and everywhere.
_RATES = {
    "birth": ("births_per_detection", "births_per_second"),
    "clutter": ("clutter_per_detection", "clutter_per_frame"),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """A preset, and what the user ``given`` says in place of its values, by section."""

    preset: str
    given: Mapping[str, Values]

    def kind(self, section: str) -> str:
        """The kind of a section."""
        said = {**self._preset().get(section, {}), **self.given.get(section, {})}
        return str(said.get("kind", first_kind(section)))

    def values(self, section: str) -> Values:
        """What the preset and the user say of a section, without its kind: the constructor's
        defaults complete it.

        What was said for another filter or kind of motion, and has no meaning with this one, is
        left out. A detector checks its settings itself.
        """
        if section == "detector":
            return dict(self.given.get(section, {}))
        kind = self.kind(section)
        preset = self._preset()
        usual = preset.get(section, {})
        fits = usual.get("kind", first_kind(section)) == kind
        said = {
            **preset.get(f"{section}.{kind}", {}),
            **(usual if fits else {}),
            **self.given.get(section, {}),
        }
        known = settable(section, kind, self.kind("motion"))
        return {key: value for key, value in said.items() if key in known}

    def build(self, section: str, **more: Any) -> Any:
        """The object that a section makes; of ``more``, which depends on the sequence, it takes
        what its class knows.
        """
        chosen = record(section, self.kind(section))
        values = {"initial": None} | self.values(section) | more
        if chosen is Nothing:
            return None
        values |= {name: gaussians_at(values[name]) for name in MIXTURES if values.get(name)}
        return chosen(
            **{field.name: values[field.name] for field in fields(chosen) if field.name in values}
        )

    def as_dict(self) -> dict[str, Any]:
        """Every setting with its value: what run.json records and `load` reads back."""
        out: dict[str, Any] = {"preset": self.preset}
        for section in SECTIONS:
            kind = self.kind(section)
            values = {**constructor_defaults(section, kind), **self.values(section)}
            out[section] = {"kind": kind, **values} if kind else values
        return out

    def _preset(self) -> dict[str, Values]:
        """The preset's values with the user's filter and kind of motion."""
        motion, filter_name = (self.given.get(section, {}).get("kind", "") for section in DECIDING)
        return values_of(self.preset, motion, filter_name)


class _Entry(NamedTuple):
    """A value that the user gives, and where: for error messages."""

    section: str
    key: str
    value: Any
    where: str


def load(
    path: Path | None = None, sets: Sequence[str] = (), preset: str = "", filter_name: str = ""
) -> Settings:
    """The settings of a preset with those of a TOML file and of options in their place; the last
    named wins. Raises `InputError` where the file cannot be read, a name is unknown, or a value is
    of the wrong type or out of bounds.

    Parameters
    ----------
    path : TOML file; None for none.
    sets : options as ``section.name=value`` or ``scene=FILE``.
    preset : name of the preset; empty for the file's, or ``default``.
    filter_name : the filter, as ``--filter`` names it; empty for the preset's or the file's.
    """
    document, where = ({}, "configuration") if path is None else (read_toml(path), str(path))
    given = document.pop("preset", "default")
    scene = document.pop("scene", "")
    named = preset or given
    if not isinstance(named, str) or named not in PRESETS:
        raise _unknown("preset", str(named), list(PRESETS), "preset" if preset else where)
    options = [_assignment(text) for text in sets]
    scene = next(
        (str(entry.value) for entry in reversed(options) if entry.section == "scene"), str(scene)
    )
    options = [entry for entry in options if entry.section != "scene"]
    if filter_name:
        for entry in options:
            if entry[:2] == ("filter", "kind") and entry.value != filter_name:
                problem = f"--filter {filter_name} and {entry.where} name two filters"
                raise InputError(problem, where="--filter", cure="Leave one out")
        options = [_Entry("filter", "kind", filter_name, "--filter"), *options]
    settings = _replaced(Settings(named, {}), _entries(document, where))
    settings = _replaced(settings, _with_scene(settings, scene, options) if scene else options)
    _check(settings, where)
    return settings


def overlay(
    settings: Settings, sections: Mapping[str, Mapping[str, Any]], where: str = "settings"
) -> Settings:
    """``settings`` with the values of ``sections`` in place of theirs. Raises `InputError` as
    `load`.

    Parameters
    ----------
    settings : what is changed.
    sections : values by section and name.
    where : who asks, for error messages.
    """
    merged = _replaced(settings, _entries(sections, where))
    _check(merged, where)
    return merged


def _entries(sections: Mapping[str, Any], where: str) -> list[_Entry]:
    """The values of a document. Raises `InputError` where a section is none."""
    for section, values in sections.items():
        if section not in SECTIONS:
            raise _unknown("section", section, list(SECTIONS), where)
        if not isinstance(values, Mapping):
            raise InputError(
                f"expected a section [{section}] with names and values, got {values!r}", where=where
            )
    given = [
        _Entry(section, key, value, where)
        for section, values in sections.items()
        for key, value in values.items()
    ]
    return [entry for one in given for entry in _of_classes(one)]


def _of_classes(entry: _Entry) -> list[_Entry]:
    """The entry, or as ``classes.each`` has it where it is a table of the settings of one class."""
    section, key, value, where = entry
    if section != "classes" or not isinstance(value, Mapping):
        return [entry]
    out = []
    for name, inner in value.items():
        if isinstance(inner, Mapping):
            pairs = [(f"{name}.{one}", last) for one, last in inner.items()]
        else:
            pairs = [(name, inner)]
        out += [
            _Entry("classes", "each", (f"{key}.{path}={json.dumps(last)}",), where)
            for path, last in pairs
        ]
    return out


def _replaced(settings: Settings, entries: Iterable[_Entry]) -> Settings:
    """``settings`` with the entries in place of theirs. ClassSettings come first: they decide which other
    names there are.
    """
    given = {section: dict(values) for section, values in settings.given.items()}
    kinds = [entry for entry in entries if entry.key == "kind" and entry.section != "detector"]
    for section, _, kind, where in kinds:
        known = list(SECTIONS[section])
        if known == [""]:
            raise InputError(
                f"[{section}] comes in one kind only, got kind = {kind!r}", where=where
            )
        if kind not in known:
            raise _unknown(f"kind of {section}", str(kind), known, where)
        # Another kind has other settings.
        same = given.get(section, {}).get("kind", settings.kind(section)) == kind
        given[section] = {**(given.get(section, {}) if same else {}), "kind": kind}
    named = {entry.section for entry in kinds}
    merged = Settings(settings.preset, given)
    for deciding in named & set(DECIDING):
        for section, fitting in FITTING.get((deciding, merged.kind(deciding)), {}).items():
            # Said before, for another filter or kind of motion.
            if (
                section not in named
                and given.get(section, {}).get("kind", fitting[0]) not in fitting
            ):
                del given[section]["kind"]
    for entry in entries:
        if entry not in kinds:
            if entry.section == "detector":
                value = entry.value
            else:
                value = _checked(merged, entry)
            if entry[:2] == ("classes", "each"):
                value = (*given.get("classes", {}).get("each", ()), *value)
            given.setdefault(entry.section, {})[entry.key] = value
            rates = _RATES.get(entry.section, ())
            if entry.key in rates and value:
                # Of the two rates the one that is named last holds.
                other = rates[1 - rates.index(entry.key)]
                if other in settable(entry.section, merged.kind(entry.section), ""):
                    given[entry.section][other] = 0.0
    return merged


def _checked(settings: Settings, entry: _Entry) -> Any:
    """The value of an entry as the type that its setting has, within its bounds."""
    from pydantic import TypeAdapter, ValidationError

    section, key, value, where = entry
    motion = settings.kind("motion")
    known = settable(section, settings.kind(section), motion)
    if key not in known:
        others = [kind for kind in SECTIONS[section] if key in settable(section, kind, motion)]
        if others:
            owner = f"{section}.kind={' or '.join(others)}"
        else:
            owner = ""
        raise _unknown(f"setting of [{section}]", key, list(known), where, owner)
    try:
        # A list may stand for a tuple and 5.0 for 5, but neither true nor "0.9" for a number.
        return TypeAdapter(known[key]).validate_python(value, strict=isinstance(value, (bool, str)))
    except ValidationError as error:
        message = error.errors()[0]["msg"].lower()
        raise InputError(f"{section}.{key}: {message}, got {value!r}", where=where) from None


def _check(settings: Settings, where: str) -> None:
    """Raise `InputError` where a section lacks a value, its values contradict each other, or kinds
    do not fit.
    """
    kinds = {section: settings.kind(section) for section in SECTIONS}
    for section in settings.given:
        if section == "detector":
            continue
        said = {
            *constructor_defaults(section, kinds[section]),
            *settings.values(section),
            "initial",
        }
        for key in settable(section, kinds[section], ""):
            if key not in said:
                raise InputError(
                    f"[{section}] of kind {kinds[section]} needs a value for {key}", where=where
                )
        settings.build(section, frame_size=(1.0, 1.0))
    for deciding in kinds:
        for section, fitting in FITTING[deciding, kinds[deciding]].items():
            kind = kinds[section]
            if kind not in fitting:
                # A filter that names no extraction has none; births that name no filter go with
                # all.
                unnamed, cure = (
                    ((), f"Leave {section}.kind out, or use")
                    if deciding in DECIDING
                    else ((kind,), "Use")
                )
                others = [
                    k
                    for k in SECTIONS[deciding]
                    if kind in FITTING[deciding, k].get(section, unnamed)
                ]
                if others:
                    elsewhere = f"; it goes with {deciding}.kind={' or '.join(others)}"
                else:
                    elsewhere = ""
                problem = f"{section}.kind={kind} does not fit {deciding}.kind={kinds[deciding]}"
                raise InputError(
                    problem, where=where, cure=f"{cure} {' or '.join(fitting)}{elsewhere}"
                )


def _with_scene(settings: Settings, file: str, options: list[_Entry]) -> list[_Entry]:
    """``options`` after those that put what a learned scene knows in place of ``settings``; a kind
    in ``options`` wins.

    A part that was learned is a density over the whole frame. Where nothing is added around each
    detection, the other part, if it was not learned, is spread over the frame too: else one of the
    two would explain everything.
    """
    from phdtrack.scene import read_scene

    said = {entry.section: entry.value for entry in options if entry.key == "kind"}
    scene = read_scene(Path(file))
    parts = {"birth": scene.births, "clutter": scene.clutter}
    learned = [
        name
        for name, part in parts.items()
        if part is not None and said.get(name, "scene") == "scene"
    ]
    options = [
        *_entries({name: {"kind": "scene", "file": file} for name in learned}, "--scene"),
        *options,
    ]
    merged = _replaced(settings, options)
    each = {name: merged.values(name).get(key, 0.0) for name, (key, _) in _RATES.items()}
    if merged.kind("motion") != "box" or all(each[name] > 0 for name in learned):
        return options
    others = {
        name: {_RATES[name][1]: each[name]}
        for name in parts
        if name not in learned and each[name] > 0
    }
    return [*_entries(others, "--scene"), *options]


def _assignment(text: str) -> _Entry:
    """The entry of ``section.name=value``, or of ``scene=FILE``; the value is TOML, or a word
    without quotes.
    """
    path, equals, value = (part.strip() for part in text.partition("="))
    section, _, key = path.partition(".")
    if path == "scene" and value:
        return _Entry("scene", "", value.strip("'\""), text)
    if not equals or not key:
        cure = "For example: --set sensor.detection_probability=0.9"
        raise InputError("expected section.name=value", where=f"--set {text}", cure=cure)
    if section not in SECTIONS:
        raise _unknown("section", section, list(SECTIONS), f"--set {text}")
    if section == "classes" and "." in key:
        return _Entry("classes", "each", (f"{key}={value}",), f"--set {text}")
    return _Entry(section, key, parsed_value(value), f"--set {text}")


def parsed_value(value: str) -> Any:
    """A value that was written as TOML, or a word without quotes."""
    try:
        # TOML wants a digit before the point; people who type .1 mean a number.
        plain = re.sub(r"^([+-]?)\.(?=\d)", r"\g<1>0.", value)
        parsed = tomllib.loads(f"value = {plain}")["value"]
        # No setting is a moment; TOML takes 19:30:00 for one.
        if isinstance(parsed, (datetime.date, datetime.time)):
            parsed = value
        else:
            parsed = parsed
    except (ValueError, RecursionError):
        parsed = value
    return parsed


def _unknown(what: str, name: str, known: Sequence[str], where: str, owner: str = "") -> InputError:
    """Says the nearest name, or all; ``owner`` is where else there is one of this name."""
    if owner:
        cure = f"It goes with {owner}; here there are {', '.join(known) or 'none'}."
    else:
        cure = did_you_mean(name, known)
    return InputError(f"unknown {what}: {name}", where=where, cure=cure)
