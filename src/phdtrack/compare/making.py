"""The plan of a comparison from the words of a command line, or of a program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from phdtrack import config
from phdtrack.compare.footage import Wanted, cases
from phdtrack.compare.methods import methods
from phdtrack.compare.records import Plan


def plan(
    sequences: Sequence[str],
    *,
    filters: Sequence[str] = (),
    detections: Sequence[str] = (),
    detectors: Sequence[str] = (),
    clutter: Sequence[float] = (0.0,),
    seeds: int = 5,
    variants: Sequence[str] = (),
    preset: str = "",
    file: Path | None = None,
    sets: Sequence[str] = (),
    truth: str = "",
    max_width: int = 0,
    iou: float = 0.5,
) -> Plan:
    """What `phdtrack compare` compares; every input has been opened and every setting checked.

    Parameters
    ----------
    sequences : folders as MOTChallenge lays them out, or videos.
    filters : by the names of configuration; the first is what the others are compared to.
    detections, detectors : names of sets that the folders have, or files; detectors by name. Neither: what there is.
    clutter : rates of added clutter, boxes per frame.
    seeds : how many, from 1.
    variants : ``NAME=section.name=value,…``, each a further method.
    preset, file, sets : settings, as everywhere.
    truth : a file; in it, and in files of detections, ``{}`` stands for the sequence's name.

    Raises
    ------
    InputError : anything that cannot be read, or that does not go together.
    """
    chosen = methods(filters, variants, preset, file, sets)
    parameters = tuple(config.load(file, [text for text in sets if text.strip().startswith("detector.")]).detector.items())
    wanted = Wanted(tuple(detections), tuple(detectors), parameters, max_width, truth)
    found = cases(sequences, wanted)
    for case in found:
        for method in chosen:
            config.build(method.settings, case.info)
    return Plan(found, chosen, tuple(clutter), tuple(range(1, seeds + 1)), iou)
