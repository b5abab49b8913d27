"""From a request to a plan: filters and variants become methods with checked settings."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

from phdtrack import config
from phdtrack.compare.case_files import (
    cases_of,
    cases_of_pair,
    detector_settings,
    is_file,
)
from phdtrack.compare.plans import Method, Plan, Request, Run
from phdtrack.config.registry import SECTIONS
from phdtrack.errors import InputError, did_you_mean
from phdtrack.run.descriptors import picture_describer
from phdtrack.run.scored_files import check_listed

# Sections whose settings belong to one kind of filter; other settings apply to all.
_FILTER_SECTIONS = ("filter", "extract", "associate")
_NEXT_SETTING = re.compile(r",(?=\s*(?:preset|[a-z]+\.[a-z_]+)\s*=)")


def plan(request: Request) -> Plan:
    """The plan of `phdtrack compare`, with every input opened and every setting checked.

    Raises `InputError` for anything that cannot be read, or is inconsistent.

    Parameters
    ----------
    request : what to compare.

    Returns
    -------
    The plan for `run`.
    """
    if not request.sequences and not request.pairs:
        raise InputError(
            "nothing to compare on", where="SEQUENCE", cure="Name folders of sequences, or videos."
        )
    for option, names in (("--detections", request.detections), ("--truth", (request.truth,))):
        for name in names:
            if len(request.sequences) > 1 and is_file(name) and "{}" not in name:
                raise InputError(
                    f"{name} cannot belong to {len(request.sequences)} sequences",
                    where=option,
                    cure="Use {} for the name of the sequence in the names of files.",
                )
    check_listed(request.labelled)
    methods = _methods(request)
    parameters = _values(request, "detector")
    embedding = _values(request, "embedding")
    # Unknown detectors are an error even if no sequence uses them.
    detector_settings(request.detectors, parameters)
    found = [cases_of(word, request, parameters, embedding) for word in request.sequences]
    found += [cases_of_pair(*pair, request, parameters, embedding) for pair in request.pairs]
    cases = tuple(case for each in found for case in each)
    # Unknown words, and networks that cannot be used, are an error before anything runs.
    for appearance in {one.appearance for one in cases if one.appearance}:
        picture_describer(appearance, embedding)
    for case in cases:
        for method in methods:
            settings = Run(case, 0.0, method, 1).settings
            config.build(settings, case.info, moving=True)
    seeds = tuple(range(1, request.seeds + 1))
    return Plan(cases, methods, tuple(request.clutter), seeds, request.iou)


def _values(request: Request, section: str) -> dict[str, Any]:
    """The values that the request states of a section."""
    texts = [text for text in request.sets if _section(text) == section]
    return request.load(texts).values(section)


def _section(text: str) -> str:
    """The section of ``section.name=value``."""
    return text.strip().split(".")[0]


def _methods(request: Request) -> tuple[Method, ...]:
    """One method for each filter, then one for each variant."""
    kind = [text for text in request.sets if text.replace(" ", "").startswith("filter.kind=")]
    if kind and request.filters:
        raise InputError(
            "--filters already names the filters",
            where=f"--set {kind[0]}",
            cure="Leave one of them out.",
        )
    shared = [text for text in request.sets if _section(text) not in _FILTER_SECTIONS]
    own = [text for text in request.sets if text not in (*shared, *kind)]
    names = tuple(request.filters)
    if not names:
        names = tuple(dict.fromkeys((request.load([*shared, *kind]).kind("filter"), "none")))
    for name in names:
        if name not in SECTIONS["filter"]:
            raise InputError(
                f"unknown kind of filter: {name}",
                where="--filters",
                cure=did_you_mean(name, SECTIONS["filter"]),
            )
    chosen = [_applicable([*shared, f"filter.kind={name}"], own, request) for name in names]
    for text in own:
        if not any(text in texts for texts in chosen):
            # Raises an error that names the nearest setting.
            request.load((f"filter.kind={names[0]}", text))
    filters = [Method(name, request.load(texts)) for name, texts in zip(names, chosen, strict=True)]
    variants = [_variant(text, chosen[0], shared, request) for text in request.variants]
    return (*filters, *variants)


def _applicable(texts: list[str], own: list[str], request: Request) -> list[str]:
    """The ``texts``, which name a filter, and those of ``own`` that this filter has."""
    # The kinds of extraction and association come first: other settings depend on them.
    for text in sorted(own, key=lambda text: ".kind" not in text.partition("=")[0]):
        with suppress(InputError):
            request.load([*texts, text])
            texts = [*texts, text]
    return texts


def _variant(text: str, first: list[str], shared: list[str], request: Request) -> Method:
    """A variant of the ``first`` method, or of the ``shared`` settings if it names a preset or
    another filter.
    """
    name, _, rest = text.partition("=")
    if not name or "=" not in rest:
        raise InputError(
            "expected NAME=section.name=value",
            where=f"--variant {text}",
            cure="For example: --variant few=filter.particles_per_target=100",
        )
    parts = [part.strip() for part in _NEXT_SETTING.split(rest)]
    presets = [part.partition("=")[2].strip() for part in parts if part.startswith("preset")]
    changes = [part for part in parts if not part.startswith("preset")]
    base = first
    if presets or any(part.startswith("filter.kind") for part in parts):
        base = shared
    try:
        return Method(name, request.load([*base, *changes], presets[-1] if presets else ""))
    except InputError as error:
        raise InputError(error.problem, where=f"--variant {name}", cure=error.cure) from None
