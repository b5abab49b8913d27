"""Settings from a preset, a TOML file and options, checked.

A configuration has sections, one for each part of the model and of the tracker. A section has the settings of the class
that it makes (its docstring explains them) and, where there is a choice, ``kind``:

    preset = "m09"                 # default, m07, m09, fv, m09-mht, e13, d14
    scene = "street.scene.json"    # what `phdtrack learn` has learned; optional
    [sensor]
    detection_probability = 0.9
    [birth]
    kind = "measurement"           # measurement, uniform, fixed, scene

On the command line the same is ``--set sensor.detection_probability=0.9``. A preset is a complete set of values
(`presets.values_of`); what the user says replaces values of it. An unknown name is an error that says the nearest one.
"""

from __future__ import annotations

import datetime
import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from phdtrack.config.kinds import DECIDING, FITTING, MISFITS, SECTIONS, constructor_defaults, first_kind, record, settable
from phdtrack.config.presets import PRESETS, values_of
from phdtrack.errors import InputError
from phdtrack.files import read_toml

Values = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Settings:
    """A preset, and what the user ``given`` says in place of its values, by section."""

    preset: str
    given: Mapping[str, Values]

    def kind(self, section: str) -> str:
        """The kind of a section."""
        said = [table[section]["kind"] for table in (self.given, self._preset()) if "kind" in table.get(section, {})]
        return str(said[0]) if said else first_kind(section)

    def values(self, section: str) -> Values:
        """What the preset and the user say of a section, without its kind: the constructor's defaults complete it."""
        kind, preset = self.kind(section), self._preset()
        first = preset.get(section, {}) if preset.get(section, {}).get("kind", first_kind(section)) == kind else {}
        usual = {**preset.get(f"{section}.{kind}", {}), **first}
        known = settable(section, kind, self.kind("motion"))
        said = {key: value for key, value in self.given.get(section, {}).items() if key != "kind"}
        return {key: value for key, value in usual.items() if key in known} | said

    def build(self, section: str, **more: Any) -> Any:
        """The object that a section makes; of ``more``, which depends on the sequence, it takes what its class knows."""
        values, chosen = self.values(section), record(section, self.kind(section))
        values.pop("initial", None)
        known = {field.name for field in fields(chosen)}
        return chosen(**values, **{key: value for key, value in more.items() if key in known})

    def as_dict(self) -> dict[str, Any]:
        """Every setting with its value: what run.json records and `load` reads back."""
        out: dict[str, Any] = {"preset": self.preset}
        for section in SECTIONS:
            kind = self.kind(section)
            values = {**constructor_defaults(section, kind), **self.values(section)}
            out[section] = {"kind": kind, **values} if kind else values
        return out

    @property
    def detector(self) -> Values:
        """Parameters for the detector, which checks them itself."""
        return dict(self.given.get("detector", {}))

    def _preset(self) -> dict[str, Values]:
        """The preset's values with the user's filter and kind of motion."""
        motion, filter_name = (self.given.get(section, {}).get("kind", "") for section in DECIDING)
        return values_of(self.preset, motion, filter_name)


@dataclass(frozen=True, slots=True)
class _Entry:
    """A value that the user gives, and where: for error messages."""

    section: str
    key: str
    value: Any
    where: str


def load(path: Path | None = None, sets: Sequence[str] = (), preset: str = "", filter_name: str = "") -> Settings:
    """The settings of a preset with those of a TOML file and of options in their place; the last named wins.

    Parameters
    ----------
    path : TOML file; None for none.
    sets : options as ``section.name=value`` or ``scene=FILE``.
    preset : name of the preset; empty for the file's, or ``default``.
    filter_name : the filter, as ``--filter`` names it; empty for the preset's or the file's.

    Raises
    ------
    InputError : the file cannot be read, a name is unknown, or a value is of the wrong type or out of bounds.
    """
    document = read_toml(path) if path is not None else {}
    where = str(path) if path is not None else "configuration"
    named, scene = document.pop("preset", "default"), document.pop("scene", "")
    named = preset or named
    if not isinstance(named, str) or named not in PRESETS:
        raise _unknown("preset", str(named), list(PRESETS), "preset" if preset else where)
    options = [_assignment(text) for text in sets if not _scene_named(text)]
    scene = next((_scene_named(text) for text in reversed(sets) if _scene_named(text)), scene)
    if filter_name:
        for entry in options:
            if (entry.section, entry.key) == ("filter", "kind") and entry.value != filter_name:
                problem = f"--filter {filter_name} and {entry.where} name two filters"
                raise InputError(problem, where="--filter", cure="Leave one out")
        options = [_Entry("filter", "kind", filter_name, "--filter"), *options]
    settings = _laid_over(Settings(named, {}), _entries(document, where))
    if scene:
        options = _taught(settings, str(scene), options)
    settings = _laid_over(settings, options)
    _check(settings, where)
    return settings


def overlay(settings: Settings, sections: Mapping[str, Mapping[str, Any]], where: str = "settings") -> Settings:
    """``settings`` with the values of ``sections`` in place of theirs.

    Parameters
    ----------
    settings : what is changed.
    sections : values by section and name.
    where : who asks, for error messages.

    Raises
    ------
    InputError : as `load`.
    """
    merged = _laid_over(settings, _entries(sections, where))
    _check(merged, where)
    return merged


def _entries(sections: Mapping[str, Any], where: str) -> list[_Entry]:
    found = []
    for section, values in sections.items():
        if section not in SECTIONS:
            raise _unknown("section", section, list(SECTIONS), where)
        if not isinstance(values, Mapping):
            raise InputError(f"expected a section [{section}] with names and values, got {values!r}", where=where)
        found += [_Entry(section, key, value, where) for key, value in values.items()]
    return found


def _laid_over(settings: Settings, entries: Iterable[_Entry]) -> Settings:
    """``settings`` with the entries in place of theirs. Kinds come first: they decide which other names there are."""
    given = {section: dict(values) for section, values in settings.given.items()}
    entries = list(entries)
    for entry in entries:
        if entry.section not in SECTIONS:
            raise _unknown("section", entry.section, list(SECTIONS), entry.where)
        if entry.key == "kind" and entry.section != "detector":
            kinds = list(SECTIONS[entry.section])
            if kinds == [""]:
                problem = f"[{entry.section}] comes in one kind only, got kind = {entry.value!r}"
                raise InputError(problem, where=entry.where)
            if not isinstance(entry.value, str) or entry.value not in kinds:
                raise _unknown(f"kind of {entry.section}", str(entry.value), kinds, entry.where)
            if given.get(entry.section, {}).get("kind", settings.kind(entry.section)) != entry.value:
                # Another kind has other settings.
                given[entry.section] = {}
            given.setdefault(entry.section, {})["kind"] = entry.value
    named = {entry.section for entry in entries if entry.key == "kind"}
    merged = Settings(settings.preset, given)
    for deciding in named & set(DECIDING):
        for section, fitting in FITTING.get((deciding, merged.kind(deciding)), {}).items():
            if section in given and section not in named:
                # Said before, of another filter or kind of motion: what does not fit goes.
                if given[section].get("kind", fitting[0]) not in fitting:
                    del given[section]["kind"]
                known = settable(section, merged.kind(section), merged.kind("motion"))
                given[section] = {key: value for key, value in given[section].items() if key in known or key == "kind"}
    for entry in entries:
        if entry.section == "detector" or entry.key != "kind":
            value = entry.value if entry.section == "detector" else _checked(merged, entry)
            given.setdefault(entry.section, {})[entry.key] = value
    return merged


def _checked(settings: Settings, entry: _Entry) -> Any:
    """The value of an entry as the type that its setting has, within its bounds."""
    from pydantic import TypeAdapter, ValidationError

    section, key, value = entry.section, entry.key, entry.value
    motion = settings.kind("motion")
    known = settable(section, settings.kind(section), motion)
    if key not in known:
        others = [kind for kind in SECTIONS[section] if key in settable(section, kind, motion)]
        owner = f"{section}.kind={' or '.join(others)}" if others else ""
        raise _unknown(f"setting of [{section}]", key, list(known), entry.where, owner)
    try:
        # A list may stand for a tuple and 5.0 for 5, but neither true nor "0.9" for a number.
        return TypeAdapter(known[key]).validate_python(value, strict=isinstance(value, (bool, str)))
    except ValidationError as error:
        message = error.errors()[0]["msg"].lower()
        raise InputError(f"{section}.{key}: {message}, got {value!r}", where=entry.where) from None


def _check(settings: Settings, where: str) -> None:
    """Raise `InputError` where a section lacks a value, its values contradict each other, or kinds do not fit."""
    for section in settings.given:
        if section == "detector":
            continue
        kind, values = settings.kind(section), settings.values(section)
        needed = [key for key in settable(section, kind, "") if key not in constructor_defaults(section, kind)]
        missing = [key for key in needed if key not in values and key != "initial"]
        if missing:
            raise InputError(f"[{section}] of kind {kind} needs a value for {missing[0]}", where=where)
        settings.build(section, frame_size=(1.0, 1.0))
    for deciding in DECIDING:
        for section, fitting in FITTING.get((deciding, settings.kind(deciding)), {}).items():
            kind = settings.kind(section)
            if kind not in fitting:
                others = [k for (d, k), f in FITTING.items() if d == deciding and kind in f.get(section, ())]
                elsewhere = f"; it goes with {deciding}.kind={' or '.join(others)}" if others else ""
                raise InputError(
                    f"{section}.kind={kind} does not fit {deciding}.kind={settings.kind(deciding)}",
                    where=where,
                    cure=f"Leave {section}.kind out, or use {' or '.join(fitting)}{elsewhere}",
                )
    filter_name = settings.kind("filter")
    for (section, kind), instead in MISFITS.get(filter_name, {}).items():
        if settings.kind(section) == kind:
            raise InputError(
                f"{section}.kind={kind} has no form that filter.kind={filter_name} can carry",
                where=where,
                cure=f"Use {instead}, or filter.kind=particle-phd",
            )


def _taught(settings: Settings, file: str, options: list[_Entry]) -> list[_Entry]:
    """``options`` after those that put what a learned scene knows in place of ``settings``; a kind in ``options`` wins.

    A part that was learned is a density over the whole frame. Where nothing is added around each detection, the other
    part, if it was not learned, is spread over the frame too: else one of the two would explain everything.
    """
    from phdtrack.scene import read_scene

    said = {entry.section: entry.value for entry in options if entry.key == "kind"}
    if _laid_over(settings, [e for e in options if e.key == "kind"]).kind("learn") == "online":
        return [_Entry("learn", "kind", "online", "--scene"), _Entry("learn", "file", file, "--scene"), *options]
    scene = read_scene(Path(file))
    parts = {"birth": scene.births, "clutter": scene.clutter}
    learned = [name for name, part in parts.items() if part is not None and said.get(name, "scene") == "scene"]
    pairs = [(name, key, value) for name in learned for key, value in (("kind", "scene"), ("file", file))]
    options = [*(_Entry(*pair, "--scene") for pair in pairs), *options]
    merged = _laid_over(settings, options)
    if merged.kind("motion") != "box" or all(merged.values(name).get("around_detections", 0) > 0 for name in learned):
        return options
    others = [name for name in parts if "volume" in settable(name, merged.kind(name), "box")]
    return [*(_Entry(name, "volume", "image", "--scene") for name in others), *options]


def _scene_named(text: str) -> str:
    """The file of ``scene=FILE``; empty for another option."""
    name, _, value = text.partition("=")
    return value.strip().strip("'\"") if name.strip() == "scene" else ""


def _assignment(text: str) -> _Entry:
    """The entry of ``section.name=value``; the value is TOML, or a word without quotes."""
    path, equals, value = text.partition("=")
    section, dot, key = path.strip().partition(".")
    if not equals or not dot or not key:
        raise InputError(
            "expected section.name=value", where=f"--set {text}", cure="For example: --set sensor.detection_probability=0.9"
        )
    # TOML wants a digit before the point; people who type .1 mean a number.
    plain = re.sub(r"^([+-]?)\.(?=\d)", r"\g<1>0.", value.strip())
    try:
        parsed = tomllib.loads(f"value = {plain}")["value"]
        # No setting is a moment; TOML takes 19:30:00 for one.
        parsed = value.strip() if isinstance(parsed, (datetime.date, datetime.time)) else parsed
    except tomllib.TOMLDecodeError:
        parsed = value.strip()
    return _Entry(section, key, parsed, f"--set {text}")


def _unknown(what: str, name: str, known: Sequence[str], where: str, owner: str = "") -> InputError:
    """Says the nearest name, or all; ``owner`` is where else there is one of this name."""
    close = difflib.get_close_matches(name, known, 1)
    cure = f"Did you mean {close[0]}?" if close else f"There are {', '.join(known) or 'none'}."
    cure = f"It goes with {owner}; here there are {', '.join(known) or 'none'}." if owner else cure
    return InputError(f"unknown {what}: {name}", where=where, cure=cure)
