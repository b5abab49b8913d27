"""Settings from TOML and options, and the stages that they name: the one place that knows every name.

A configuration has sections, one for each part of the model and of the tracker. A section has the fields of the record
that it makes (its docstring explains them) and, where there is a choice, ``kind``:

    preset = "m09"                 # default, m07, m09, fv, m09-mht, e13, d14
    [sensor]
    detection = 0.9
    [birth]
    kind = "measurement"           # measurement, uniform, fixed, scene
    rate = 0.02

On the command line the same is ``--set sensor.detection=0.9``. An unknown name is an error that says the nearest one.
"""

from __future__ import annotations

import datetime
import difflib
import itertools
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, get_type_hints

from phdtrack.config import worlds
from phdtrack.config.kinds import DECIDING, FITTING, FROM_SEQUENCE, MISFITS, SECTIONS
from phdtrack.config.presets import FILTERED, PRESETS, UNFILTERED, USUAL
from phdtrack.detect import BACKGROUND
from phdtrack.errors import InputError
from phdtrack.files import read_toml
from phdtrack.filters import NoFilter, extract
from phdtrack.groups import Grouping
from phdtrack.groups.pipeline import GroupStages
from phdtrack.protocols import AnyStages, NoLearning, Stages
from phdtrack.types import SequenceInfo
from phdtrack.video.ego_motion import GivenWarps, SparseFlow, Standing

Values = dict[str, Any]

# The share of the weight of a person just missed that a Gaussian must have to count as one: E13's 0.25 of 0.297.
_MISSED = 0.84
# Seconds that a run remembers of whose tracks only the newest rows count: longer than anybody is out of sight.
_KEPT = 60.0


@dataclass(frozen=True, slots=True)
class Settings:
    """A checked configuration: the preset's values with those of file and options over them, by section."""

    preset: str
    sections: Mapping[str, Values]

    def as_dict(self) -> dict[str, object]:
        """Every setting with its value, defaults included: what run.json records and `load` reads back."""
        out: dict[str, object] = {"preset": self.preset}
        for name, kinds in SECTIONS.items():
            given = dict(self.sections.get(name, {}))
            kind = given.pop("kind", next(iter(kinds)))
            defaults = {f.name: _default(f) for f in fields(kinds[kind]) if f.name not in FROM_SEQUENCE}
            values = {k: v for k, v in defaults.items() if v is not MISSING} | _usual(self, name, kinds[kind]) | given
            out[name] = ({"kind": kind} if kind else {}) | values
        return out

    @property
    def detector(self) -> Values:
        """Parameters for the detector."""
        return dict(self.sections.get("detector", {}))

    @property
    def camera_motion(self) -> Standing | SparseFlow | GivenWarps:
        """How the camera moves."""
        moving: Standing | SparseFlow | GivenWarps = _record(self, "camera_motion")
        return moving


def load(path: Path | None = None, sets: Sequence[str] = (), preset: str = "") -> Settings:
    """Settings from a TOML file and ``section.name=value`` assignments, over a preset; the last named wins.

    Raises
    ------
    InputError : the file cannot be read, a name is unknown, or a value is of the wrong type or out of bounds.
    """
    document = read_toml(path) if path is not None else {}
    where = str(path) if path is not None else "configuration"
    named = preset or document.pop("preset", "default")
    document.pop("preset", None)
    if not isinstance(named, str) or named not in PRESETS:
        raise _unknown("preset", str(named), list(PRESETS), "preset" if preset else where)
    sections: dict[str, Values] = {name: dict(values) for name, values in PRESETS[named].items()}
    for name, values in _deciding_first(document):
        _overlay(sections, name, values, where)
    # A kind decides which other names there are, wherever it stands among the options, and some which other kinds fit.
    for assignment, (name, key, value) in sorted(
        ((text, _assignment(text)) for text in sets), key=lambda parsed: (parsed[1][1] != "kind", _rank(parsed[1][0]))
    ):
        _overlay(sections, name, {key: value}, f"--set {assignment}")
    return _checked(Settings(named, sections), where)


def overlay(settings: Settings, sections: Mapping[str, Mapping[str, Any]], where: str = "settings") -> Settings:
    """``settings`` with the values of ``sections`` over them."""
    merged = {name: dict(values) for name, values in settings.sections.items()}
    for name, values in _deciding_first(sections):
        _overlay(merged, name, values, where)
    return _checked(Settings(settings.preset, merged), where)


def _checked(settings: Settings, where: str) -> Settings:
    for name in SECTIONS:
        if name != "detector":
            _record(settings, name, where, dry=True)
    _fits(settings, where)
    return settings


def _usual(settings: Settings, section: str, record: type[Any]) -> Values:
    """What is usual with the filter, of what the section's record knows: the default of boxes in the image.

    What the section's first kind knows is usual with that one alone: a rate is another's with other kinds.
    """
    if settings.preset != "default" or _kind(settings.sections, "motion") != "box":
        return {}
    first, known = next(iter(SECTIONS[section].values())), {f.name for f in fields(record)}
    if section != "filter" and record is not first:
        known -= {f.name for f in fields(first)}
    usual = FILTERED[_kind(settings.sections, "filter")].get(section, {})
    return {key: value for key, value in usual.items() if key in known}


def _rank(section: str) -> int:
    """The order to lay sections over others: those whose kind decides others' first."""
    return DECIDING.index(section) if section in DECIDING else len(DECIDING)


def _deciding_first(sections: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return sorted(sections.items(), key=lambda section: _rank(section[0]))


def _kind(sections: Mapping[str, Values], name: str) -> str:
    kind: str = sections.get(name, {}).get("kind", next(iter(SECTIONS[name])))
    return kind


def _fits(settings: Settings, where: str) -> None:
    """Raise `InputError` where a section's kind cannot do with another's."""
    kinds = {name: _kind(settings.sections, name) for name in SECTIONS}
    for deciding in DECIDING:
        for section, fitting in FITTING.get((deciding, kinds[deciding]), {}).items():
            if kinds[section] not in fitting:
                raise InputError(
                    f"{section}.kind={kinds[section]} does not fit {deciding}.kind={kinds[deciding]}",
                    where=where,
                    cure=f"Leave {section}.kind out, or use {' or '.join(fitting)}"
                    f"{_elsewhere(section, kinds[section], deciding)}",
                )
    for (section, kind), instead in MISFITS.get(kinds["filter"], {}).items():
        if kinds[section] == kind:
            raise InputError(
                f"{section}.kind={kind} has no form that filter.kind={kinds['filter']} can carry",
                where=where,
                cure=f"Use {instead}, or filter.kind=particle-phd",
            )


def _elsewhere(section: str, kind: str, deciding: str) -> str:
    """The kinds of the deciding section that this kind fits."""
    others = [k for (d, k), fitting in FITTING.items() if d == deciding and kind in fitting.get(section, ())]
    return f"; it goes with {deciding}.kind={' or '.join(others)}" if others else ""


def build(settings: Settings, info: SequenceInfo, filter_name: str = "", *, moving: bool = False) -> AnyStages:
    """The stages that the settings name, for a sequence of this size; ``filter_name`` overrides ``filter.kind``.

    Raises `InputError` where settings do not go together, or name a motion of the camera and the caller, who is not
    ``moving``, would pass over it.
    """
    if not moving and not isinstance(settings.camera_motion, Standing):
        cure = "Use phdtrack track --camera-motion, or Tracker.update(warp=…)"
        raise InputError("the camera's motion is not followed here", where="camera_motion.kind", cure=cure)
    if filter_name:
        settings = overlay(settings, {"filter": {"kind": filter_name}}, "--filter")
    kinds = {name: _kind(settings.sections, name) for name in SECTIONS}
    record = partial(_record, settings)
    model, associator = worlds.build_model(record, kinds, info), worlds.build_associator(record, kinds, info)
    if kinds["filter"] == "none":
        return Stages(model, NoFilter(), extract.Raw(), associator, smoother=record("smooth"))
    values = settings.sections.get("filter", {}).get("initial", [])
    initial = worlds.initial_mixture(kinds, record, values) if values else None
    size = (float(info.width), float(info.height))
    rates = worlds.build_rates(record, kinds["rates"], model, NoLearning(), info)
    parts = record("filter", initial=initial, frame_size=size), record("extract"), associator
    stages = Stages(model, *parts, rates, record("blobs"), smoother=record("smooth"))
    if kinds["learn"] == "none":
        return stages
    scene = worlds.build_learning(record, replace(stages, associator=replace(record("associate"), history=_KEPT)), info)
    return replace(stages, learning=worlds.build_rates(record, kinds["rates"], model, scene, info))


def seen_by(settings: Settings, detector: str) -> Settings:
    """Blobs are explained where a background model finds them, unless the settings say otherwise or cannot."""
    kinds = {name: _kind(settings.sections, name) for name in ("motion", "sensor", "filter")}
    plain = kinds["motion"] == "box" and kinds["sensor"] == "box" and kinds["filter"] != "none"
    if detector not in BACKGROUND or not plain or "blobs" in settings.sections:
        return settings
    return overlay(settings, {"blobs": {"kind": "explained"}}, "--detector")


def build_groups(settings: Settings, stages: AnyStages | None = None) -> GroupStages:
    """What makes groups, lives and warnings; ``stages`` where a filter comes before, None for known positions.

    Behind a filter ``groups.min_weight`` is, unless given, no more than 0.84 of the weight (1 − p_D) p_S of a person just
    missed once, so that one miss drops nobody whatever the detection probability. With E13's values that is the default.
    """
    if stages is not None and "min_weight" not in settings.sections.get("groups", {}):
        missed = (1 - _record(settings, "sensor").detection) * _record(settings, "motion").survival
        settings = overlay(settings, {"groups": {"min_weight": min(Grouping().min_weight, _MISSED * missed)}})
    record = partial(_record, settings)
    return GroupStages(record("groups"), record("contours"), record("life_cycle"), record("encounters"))


def _record(settings: Settings, section: str, where: str = "configuration", dry: bool = False, **more: Any) -> Any:
    """The record of a section, made of its values and of ``more``; with ``dry`` only checked."""
    values = dict(settings.sections.get(section, {}))
    kinds = SECTIONS[section]
    kind = values.pop("kind", next(iter(kinds)))
    values.pop("initial", None)
    record = kinds[kind]
    known = {f.name for f in fields(record)}
    values = _usual(settings, section, record) | values
    if dry:
        required = [f.name for f in fields(record) if _default(f) is MISSING and f.name not in values]
        missing = [name for name in required if name not in FROM_SEQUENCE]
        if missing:
            raise InputError(f"[{section}] of kind {kind} needs a value for {missing[0]}", where=where)
        more = {"frame_size": (1.0, 1.0)} if "frame_size" in known else {}
    return record(**values, **{k: v for k, v in more.items() if k in known})


def _overlay(sections: dict[str, Values], name: str, values: Mapping[str, Any], where: str) -> None:
    """Put ``values`` over section ``name``, checking names, types and bounds."""
    if name not in SECTIONS:
        raise _unknown("section", name, list(SECTIONS), where)
    if not isinstance(values, Mapping):
        raise InputError(f"expected a section [{name}] with names and values, got {values!r}", where=where)
    section = sections.setdefault(name, {})
    if name == "detector":
        section.update(values)
        return
    kinds = SECTIONS[name]
    if "kind" in values:
        if "" in kinds:
            raise InputError(f"[{name}] comes in one kind only, got kind = {values['kind']!r}", where=where)
        if not isinstance(values["kind"], str) or values["kind"] not in kinds:
            raise _unknown(f"kind of {name}", str(values["kind"]), list(kinds), where)
        before = section.get("kind", next(iter(kinds)))
        if values["kind"] != before:
            # Another kind has other fields; those of the preset's kind do not belong to it.
            section.clear()
        section["kind"] = values["kind"]
        if name in DECIDING:
            _follow(sections, name, values["kind"], before)
    record = kinds[section.get("kind", next(iter(kinds)))]
    hints = get_type_hints(record, include_extras=True)
    known = [f.name for f in fields(record) if f.name not in FROM_SEQUENCE]
    if name == "filter" and record is not NoFilter:
        known.append("initial")
        hints = hints | {"initial": worlds.Places if _kind(sections, "motion") == "plane" else worlds.Boxes}
    for key, value in values.items():
        if key == "kind":
            continue
        if key not in known:
            others = [kind for kind, other in kinds.items() if key in {f.name for f in fields(other)}]
            raise _unknown(f"setting of [{name}]", key, known, where, f"{name}.kind={' or '.join(others)}" if others else "")
        section[key] = _typed(f"{name}.{key}", value, hints[key], where)


def _follow(sections: dict[str, Values], deciding: str, kind: str, before: str) -> None:
    """Give the sections that a kind decides kinds that fit, with those of their values that these have too.

    A kind that nobody chose, as which counts the first that fitted the kind ``before``, is the first that fits. On the
    ground plane, of points, and without a filter other values are usual too, which a change of kind may have dropped.
    """
    usual = {section: fitting[0] for section, fitting in FITTING.get((deciding, before), {}).items()}
    for section, fitting in FITTING.get((deciding, kind), {}).items():
        given = sections.get(section, {})
        chosen = given.get("kind") in fitting and given["kind"] != usual.get(section)
        if not chosen and _kind(sections, section) != fitting[0]:
            known = {f.name for f in fields(SECTIONS[section][fitting[0]])} if deciding == "filter" else set()
            sections[section] = {key: value for key, value in given.items() if key in known} | {"kind": fitting[0]}
    more = USUAL.get(_kind(sections, "motion"), {}), UNFILTERED if _kind(sections, "filter") == "none" else {}
    for section, values in itertools.chain.from_iterable(part.items() for part in more):
        known = {f.name for f in fields(SECTIONS[section][_kind(sections, section)])}
        for key, value in values.items():
            if key in known:
                sections.setdefault(section, {}).setdefault(key, value)


def _typed(key: str, value: Any, hint: Any, where: str) -> Any:
    """``value`` as the type that the field states, within its bounds."""
    from pydantic import TypeAdapter, ValidationError

    try:
        # A list may stand for a tuple and 5.0 for 5, but neither true nor "0.9" for a number.
        return TypeAdapter(hint).validate_python(value, strict=isinstance(value, (bool, str)))
    except ValidationError as error:
        raise InputError(f"{key}: {error.errors()[0]['msg'].lower()}, got {value!r}", where=where) from None


def _assignment(text: str) -> tuple[str, str, Any]:
    """Section, name and value of ``section.name=value``; the value is TOML, or a word without quotes."""
    path, equals, value = text.partition("=")
    section, dot, key = path.strip().partition(".")
    if not equals or not dot or not key:
        raise InputError(
            "expected section.name=value", where=f"--set {text}", cure="For example: --set sensor.detection=0.9"
        )
    # TOML wants a digit before the point; people who type .1 mean a number.
    plain = re.sub(r"^([+-]?)\.(?=\d)", r"\g<1>0.", value.strip())
    try:
        parsed = tomllib.loads(f"value = {plain}")["value"]
        # No setting is a moment; TOML takes 19:30:00 for one.
        return section, key, value.strip() if isinstance(parsed, (datetime.date, datetime.time)) else parsed
    except tomllib.TOMLDecodeError:
        return section, key, value.strip()


def _default(field: Any) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _unknown(what: str, name: str, known: Sequence[str], where: str, owner: str = "") -> InputError:
    """Says the nearest name, or all; ``owner`` is where else there is one of this name."""
    close = difflib.get_close_matches(name, known, 1)
    cure = f"Did you mean {close[0]}?" if close else f"There are {', '.join(known) or 'none'}."
    cure = f"It goes with {owner}; here there are {', '.join(known) or 'none'}." if owner else cure
    return InputError(f"unknown {what}: {name}", where=where, cure=cure)
