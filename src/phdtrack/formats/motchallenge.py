"""What the classes in the truth of MOT16, MOT17 and MOT20 mean for the scores.

The truth of these benchmarks has a flag in column 7 and a class in column 8. Pedestrians (class 1) with flag 1 are scored.
People on vehicles (2), static persons (7), distractors (8), reflections (12), and in MOT20 other vehicles (6), whatever
their flag, are not scored, and neither is output that matches them. All other rows are left out. This is the benchmark's
own preprocessing as TrackEval does it, but for one thing that a `Truth` cannot say: there, rows that are left out still
take part in the matching by which distractors find the output to remove.

MOT15 has no classes: a row with 0 in column 7 is left out, all others are scored.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from phdtrack.formats.rows import Rows, Rule, enforce

MOT16_DISTRACTORS = (2, 7, 8, 12)
MOT20_DISTRACTORS = (2, 6, 7, 8, 12)
_PEDESTRIAN, _LAST_CLASS = 1, 13


def usual_distractors(path: Path) -> tuple[int, ...]:
    """The distractor classes of the benchmark that the path names: those of MOT20 where a folder is called after it."""
    mot20 = any(part.upper().startswith("MOT20") for part in path.absolute().parts)
    return MOT20_DISTRACTORS if mot20 else MOT16_DISTRACTORS


def judge(rows: Rows, distractors: Collection[int]) -> Rows:
    """The rows with their classes turned into confidence (0 where a row is left out) and distractor marks.

    Rows without classes, which includes those where every class is −1, come back as they are.

    Raises
    ------
    InputError : a class is none of the benchmark's 1–13.
    """
    label, flag = rows.class_id, rows.confidence
    if label is None or flag is None or (label == -1).all():
        return replace(rows, class_id=None)
    known = np.isin(label, np.arange(1, _LAST_CLASS + 1))
    cure = "Truth of 8 or 9 columns has a MOTChallenge class in column 8; with 10 columns (MOT15) it has none."
    enforce(rows.origin, [Rule(~known, lambda i: f"expected a class from 1 to {_LAST_CLASS}, came {label[i]:.15g}", cure)])
    ignore = np.isin(label, list(distractors))
    scored = (label == _PEDESTRIAN) & (flag != 0) & ~ignore
    return replace(rows, confidence=scored.astype(float), distractor=ignore.astype(float), class_id=None)
