"""From options to methods: filters under the same settings, and variants of the first one."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from phdtrack import config
from phdtrack.compare.records import Method
from phdtrack.errors import InputError

# Sections whose settings belong to one kind of filter; those of others stand for all.
OWN = ("filter", "extract", "associate")
_NEXT = re.compile(r",(?=\s*(?:preset|[a-z]+\.[a-z_]+)\s*=)")


def methods(
    filters: Sequence[str] = (),
    variants: Sequence[str] = (),
    preset: str = "",
    file: Path | None = None,
    sets: Sequence[str] = (),
) -> tuple[Method, ...]:
    """One method for each filter and each variant, ``NAME=section.name=value,…`` over the first filter's settings.

    A setting of a filter, its extraction or its association stands for those filters that have it. Without names of
    filters: that of the settings, and none.

    Raises
    ------
    InputError : an unknown name, a value out of range, a setting that none of the filters has.
    """
    said = [text for text in sets if text.replace(" ", "").startswith("filter.kind=")]
    if said and filters:
        raise InputError("--filters says which filters there are", where=f"--set {said[0]}", cure="Leave one of them out.")
    sets = [text for text in sets if text not in said]
    names = tuple(filters) or _usual(config.load(file, [*_shared(sets), *said], preset))
    chosen = [_chosen(name, preset, file, sets) for name in names]
    taken = {text for _, used in chosen for text in used}
    for text in sets:
        if text not in taken:
            config.load(file, (f"filter.kind={names[0]}", text), preset)  # refuses, and says which name is near
    out = [Method(name, settings) for name, (settings, _) in zip(names, chosen, strict=True)]
    return (*out, *(_variant(text, names[0], preset, file, chosen[0][1]) for text in variants))


def _chosen(name: str, preset: str, file: Path | None, sets: Sequence[str]) -> tuple[config.Settings, tuple[str, ...]]:
    """The settings under this filter, and which of ``sets`` have a place in them."""
    kinds = [text for text in _own(sets) if ".kind" in text.partition("=")[0] and not text.startswith("filter.")]
    start = (*_shared(sets), f"filter.kind={name}", *kinds)
    try:
        known = config.load(file, start, preset).as_dict()
    except InputError as error:
        cure = error.cure if error.where.endswith(f"filter.kind={name}") else ""
        raise InputError(error.problem, where="--filters" if cure else error.where, cure=cure or error.cure) from None
    used = [text for text in _own(sets) if text not in kinds and _has(known, text)]
    return config.load(file, (*start, *used), preset), (*_shared(sets), *kinds, *used)


def _variant(text: str, first: str, preset: str, file: Path | None, sets: Sequence[str]) -> Method:
    name, equals, rest = text.partition("=")
    if not name or not equals or "=" not in rest:
        cure = "For example: --variant few=filter.particles_per_target=100"
        raise InputError("expected NAME=section.name=value", where=f"--variant {text}", cure=cure)
    own = _NEXT.split(rest)
    presets = [part.partition("=")[2].strip() for part in own if part.strip().startswith("preset")]
    own = [part.strip() for part in own if not part.strip().startswith("preset")]
    kinds = [part for part in own if part.startswith("filter.kind")]
    if presets or kinds:
        # Another filter has other settings: only what all filters share goes along.
        sets = _shared(sets)
    base = kinds or ([] if presets else [f"filter.kind={first}"])
    try:
        settings = config.load(file, (*sets, *base, *(part for part in own if part not in kinds)), (presets or [preset])[-1])
    except InputError as error:
        raise InputError(error.problem, where=f"--variant {name}", cure=error.cure) from None
    return Method(name, settings)


def _usual(settings: config.Settings) -> tuple[str, ...]:
    """The filter of the settings, and none to compare with."""
    return tuple(dict.fromkeys((Method("", settings).filter_name, "none")))


def _has(known: dict[str, object], text: str) -> bool:
    section, _, name = text.partition("=")[0].strip().partition(".")
    values = known.get(section)
    return isinstance(values, dict) and (name in values or name == "initial")


def _own(sets: Sequence[str]) -> list[str]:
    return [text for text in sets if text.strip().split(".")[0] in OWN]


def _shared(sets: Sequence[str]) -> list[str]:
    return [text for text in sets if text.strip().split(".")[0] not in OWN]
