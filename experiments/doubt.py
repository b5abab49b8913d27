"""Does the share of doubtful boxes agree with the truth? Warnings beside MOTA, video by video.

A run is *bad* below a MOTA of .4 and *good* from .7 on; between them a warning is neither right nor
wrong. The warning errs if it is missing from a bad run, or stands at a good one. Both rates are
shown for the threshold as shipped, and for thresholds chosen without the kind of scene on which
they are judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common import table
from phdtrack.errors import InputError
from phdtrack.files import load, read_json
from phdtrack.report.doubtful_tracks import DOUBTFUL, DoubtfulTracks
from phdtrack.run.directory import RUN

BAD = 0.4
GOOD = 0.7
# Thresholds that are tried.
_THRESHOLDS = np.round(np.arange(0.05, 0.96, 0.05), 2)


@dataclass(frozen=True, slots=True)
class JudgedRun:
    """A run whose tracks were scored, and judged without the truth.

    Attributes
    ----------
    name, kind, detector : the video, the kind of its scene, and what detected.
    mota : the score of its tracks.
    doubtful : what the run says of itself.
    """

    name: str
    kind: str
    detector: str
    mota: float
    doubtful: DoubtfulTracks

    @classmethod
    def of(
        cls, name: str, kind: str, run: Path | Mapping[str, Any], mota: float | None = None
    ) -> JudgedRun:
        """The judgement in a run.

        Parameters
        ----------
        name, kind : the video, and the kind of its scene.
        run : its directory, or the JSON of ``phdtrack track --json``.
        mota : of its tracks; None: the score in the run's JSON (``--truth``).

        Raises
        ------
        InputError : the run does not judge its tracks: its detections are from a file, or from a
            detector of objects.
        """
        if isinstance(run, Path):
            run = read_json(run / RUN, load(run / RUN))
        if mota is None:
            mota = float(run["scores"]["MOTA"])
        detector = str(run["input"].get("detector", "detections from a file"))
        found = run["doubtful_boxes"]
        if found is None:
            raise InputError(
                f"expected a run with a background detector, got one with {detector}", where=name
            )
        return cls(name, kind, detector, mota, DoubtfulTracks(**found))

    def verdict(self, threshold: float = DOUBTFUL) -> str:
        """``missed`` or ``false warning`` if the judgement is wrong, else ``right``, or ``either``
        between bad and good.
        """
        warns = self.doubtful.boxes > 0 and self.doubtful.share >= threshold
        if self.mota < BAD:
            return "right" if warns else "missed"
        if self.mota >= GOOD:
            return "false warning" if warns else "right"
        return "either"


@dataclass(frozen=True, slots=True)
class ErrorRates:
    """How many warnings of bad runs are missing, and of how many; the same of false warnings of
    good runs.
    """

    missed: int
    bad: int
    false: int
    good: int

    @classmethod
    def of(cls, runs: Sequence[JudgedRun], threshold: float = DOUBTFUL) -> ErrorRates:
        """The errors with a threshold."""
        verdicts = [run.verdict(threshold) for run in runs]
        return cls(
            missed=verdicts.count("missed"),
            bad=sum(run.mota < BAD for run in runs),
            false=verdicts.count("false warning"),
            good=sum(run.mota >= GOOD for run in runs),
        )

    def __add__(self, other: ErrorRates) -> ErrorRates:
        return ErrorRates(
            missed=self.missed + other.missed,
            bad=self.bad + other.bad,
            false=self.false + other.false,
            good=self.good + other.good,
        )

    @property
    def mean(self) -> float:
        """The mean of both rates."""
        return (self.missed / max(1, self.bad) + self.false / max(1, self.good)) / 2

    @property
    def cells(self) -> tuple[str, str]:
        """Both as "1 of 6"."""
        return f"{self.missed} of {self.bad}", f"{self.false} of {self.good}"


def best_threshold(runs: Sequence[JudgedRun]) -> float:
    """The threshold with the lowest mean of both error rates; of several the middle one."""
    means = np.array([ErrorRates.of(runs, threshold).mean for threshold in _THRESHOLDS])
    return float(np.median(_THRESHOLDS[means == means.min()]))


def left_out(runs: Sequence[JudgedRun]) -> ErrorRates:
    """The errors if the threshold for each kind of scene is chosen on the other kinds."""
    total = ErrorRates(0, 0, 0, 0)
    for kind in sorted({run.kind for run in runs}):
        inside = [run for run in runs if run.kind == kind]
        outside = [run for run in runs if run.kind != kind]
        total += ErrorRates.of(inside, best_threshold(outside))
    return total


def doubt_table(runs: Sequence[JudgedRun]) -> str:
    """A table with a row for each run, worst MOTA first."""
    rows = []
    for run in sorted(runs, key=lambda run: run.mota):
        doubtful = run.doubtful
        shares = (doubtful.share, doubtful.inside_ends, doubtful.size_jumps, doubtful.no_motion)
        cells = [f"{100 * share:.0f} %" for share in shares]
        rows.append([run.name, run.kind, run.detector, run.mota, *cells, run.verdict()])
    head = ("video", "kind", "detector", "MOTA", "doubtful boxes")
    signs = ("begin and end inside", "height jumps", "no motion", "warning")
    return table((*head, *signs), rows)


def error_table(runs: Sequence[JudgedRun]) -> str:
    """A table of both error rates, as shipped and with whole kinds of scenes left out."""
    shipped = f"at {100 * DOUBTFUL:.0f} %, as shipped"
    rows = [
        (shipped, *ErrorRates.of(runs).cells),
        ("chosen without the kind of scene it is judged on", *left_out(runs).cells),
    ]
    head = ("threshold", f"no warning, MOTA < {BAD:g}", f"warning, MOTA ≥ {GOOD:g}")
    return table(head, rows)
