"""M07 Table 1 on the paper's own kind of detector: change detection at QCIF, 176 × 144 pixels.

Every video of the data that has boxes of objects, and three rendered scenes. Frames are shrunk to
QCIF before anything else happens; the truth is scaled alike, which changes no overlap. All methods
get the same boxes. A section of m07.md.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from experiments.claims import Claim, claims_table, decided
from experiments.common import Case, Options, ScoredCase, filled, in_parallel, need_data, table
from experiments.m07_table import (
    FEW,
    FORMS,
    FOUR,
    METHODS,
    MT,
    RATES,
    SEEDS,
    TableResults,
    TableRun,
    ahead,
    jobs_of,
    scored,
)
from experiments.m09_scenes import RENDERED, frames_of, simulated
from experiments.verdicts import all_hold, rule, with_seeds
from experiments.video_kinds import SHORT, VIDEOS
from phdtrack.detect import make_detector
from phdtrack.formats import ignoring, read_truth
from phdtrack.report.pages import counted
from phdtrack.types import Detections, DetectionTable, Frame, SequenceInfo, Truth
from phdtrack.video import open_source

QCIF = (176, 144)
SCENE_FRAMES = 500
# M07 Table 1: PHD-MT and MT.
PRINTED = {
    "102a01": ((0.61, 0.54, 0.65, 0.53), (0.58, 0.49, 0.60, 0.48)),
    "102a03": ((0.60, 0.16, 0.60, 0.15), (0.59, -0.58, 0.57, -0.58)),
    "102a11": ((0.59, 0.28, 0.59, 0.28), (0.58, 0.27, 0.58, 0.27)),
    "201c01": ((0.37, 0.44, 0.39, 0.43), (0.36, 0.36, 0.37, 0.35)),
}
# Shares of the time in the paper: change detector, PHD filter, clustering and association.
PRINTED_SHARES = (0.64, 0.34, 0.02)
PRINTED_SPEED = 6.0


FILMED = tuple(video for video in VIDEOS if not video.rendered)
# Clutter is added to these, which are short and have boxes on every frame.
FULL = (SHORT, "OneLeaveShop1cor")


@dataclass(frozen=True, slots=True, eq=False)
class SmallCase:
    """A video at QCIF with the boxes of the change detector; ``seconds`` that it took a frame."""

    case: Case
    seconds: float


def prepared(name: str) -> SmallCase:
    """A video or a rendered scene by its name, detected at QCIF."""
    if name in RENDERED:
        scene = simulated(name, SCENE_FRAMES)
        frames: Iterator[Frame] = iter(frames_of(name, SCENE_FRAMES))
        return _detected(name, frames, scene.info, scene.truth)
    video = next(one for one in FILMED if one.name == name)
    source = open_source(need_data() / video.source)
    truth = read_truth(need_data() / video.truth)
    if video.ignored:
        truth = ignoring(truth, need_data() / video.ignored)
    return _detected(name, iter(source), source.info, truth)


def _detected(name: str, frames: Iterator[Frame], info: SequenceInfo, truth: Truth) -> SmallCase:
    detector = make_detector("change")
    numbers = []
    boxes = [np.zeros((0, 4))]
    spent = []
    for frame in frames:
        image = cv2.resize(frame.image, QCIF, interpolation=cv2.INTER_AREA)
        began = time.perf_counter()
        found = detector(Frame(frame.number, frame.time, image))
        spent.append(time.perf_counter() - began)
        numbers.append(np.full(len(found), frame.number))
        boxes.append(found.xyxy)
    small = np.array([QCIF[0] / info.width, QCIF[1] / info.height] * 2)
    regions = truth.regions.copy()
    regions[:, 1:] *= small
    return SmallCase(
        Case(
            name,
            SequenceInfo(*QCIF, info.fps, len(numbers), name),
            replace(truth, xyxy=truth.xyxy * small, regions=regions),
            DetectionTable(np.concatenate(numbers), Detections.of(np.concatenate(boxes))),
        ),
        float(np.median(spent)),
    )


def work(job: tuple[TableRun, SmallCase]) -> ScoredCase:
    """One run, scored."""
    run, small = job
    return scored(run, small.case, METHODS[run.method])


@dataclass(frozen=True, slots=True, eq=False)
class SmallResults:
    """All runs, and the ``detector``'s seconds a frame by video."""

    runs: TableResults
    detector: Mapping[str, float]

    @property
    def swept(self) -> tuple[str, ...]:
        """The videos to which clutter is added."""
        return tuple(name for name in self.runs.cases if name in FULL)

    def _as_detected(self, method: str) -> list[tuple[float, ScoredCase]]:
        """The detector's seconds a frame and the scores of a method's runs without added
        clutter.
        """
        return [
            (self.detector[run.case], found)
            for run, found in self.runs.scored.items()
            if run.rate == 0 and run.method == method
        ]

    def shares(self, method: str) -> tuple[float, float, float]:
        """Shares of the time of a frame: detector, filter, and extraction with association."""
        each = [
            (detector, found.stages[0], found.stages[1] + found.stages[2])
            for detector, found in self._as_detected(method)
        ]
        total = np.sum(each, axis=0)
        a, b, c = (total / total.sum()).tolist()
        return a, b, c

    def speed(self, method: str) -> float:
        """Frames a second, detector included, in the median video."""
        each = [
            1 / (detector + found.seconds_per_frame)
            for detector, found in self._as_detected(method)
        ]
        return float(np.median(each))


def run_all(options: Options) -> SmallResults:
    """Detect in all videos, and do all runs."""
    names = (SHORT,) if options.quick else (*(one.name for one in FILMED), *RENDERED)
    rates = RATES[::2] if options.quick else RATES
    found = in_parallel(prepared, names, "m07, change detection at QCIF", options)
    cases = dict(zip(names, found, strict=True))
    jobs = jobs_of(
        {name: rates if name in FULL else rates[:1] for name in names}, options.number(SEEDS, FEW)
    )
    done = in_parallel(work, [(job, cases[job.case]) for job in jobs], "m07 at QCIF", options)
    runs = TableResults(dict(zip(jobs, done, strict=True)), names, rates)
    return SmallResults(runs, {name: one.seconds for name, one in cases.items()})


def section(found: SmallResults, judged: Sequence[Claim], options: Options) -> str:
    """The section of the page."""
    printed = [
        (f"*M07's {name}*", *(f"{b:.2f} / {a:.2f}" for a, b in zip(phd, mt, strict=True)))
        for name, (phd, mt) in PRINTED.items()
    ]
    runs = found.runs
    rows = [(name, *runs.cells(name, 0, 2)) for name in runs.cases]
    swept = [
        (name, rate, *runs.cells(name, rate, 2)) for name in found.swept for rate in runs.rates[1:]
    ]
    return filled(
        "m07_qcif",
        claims=claims_table(judged),
        rule=rule(),
        seeds=counted(options.number(SEEDS, FEW), "seed"),
        scene_frames=SCENE_FRAMES,
        rendered=len(RENDERED),
        sparse=sum(bool(video.ignored) for video in FILMED),
        pairs=table(("video", *FOUR), [*printed, *rows]),
        swept=table(("video", "clutter added", *FOUR), swept),
        times=_times(found),
    )


def _times(found: SmallResults) -> str:
    rows = [
        (
            "M07, Pentium IV",
            *(f"{100 * share:.0f} %" for share in PRINTED_SHARES),
            f"{PRINTED_SPEED:g}",
        )
    ]
    for method in FORMS:
        shares = (f"{100 * share:.0f} %" for share in found.shares(method))
        rows.append((method, *shares, f"{found.speed(method):.0f}"))
    return table(
        ("", "change detector", "filter", "extraction, association", "frames a second"), rows
    )


def claims(found: SmallResults) -> list[Claim]:
    """The claims of M07 Table 1 and of its times, in each form."""
    return [
        *(ahead(found.runs, form, 0, _ABOUT) for form in FORMS),
        *(ahead(found.runs, form, 0, _ABOUT, ("MOTA",)) for form in FORMS),
        *(_rises(found, form) for form in FORMS),
        *(_mended(found, form) for form in FORMS),
        *(_slowest(found, form) for form in FORMS[:2]),
    ]


_ABOUT = "change detector, QCIF"


def _rises(found: SmallResults, form: str) -> Claim:
    runs = found.runs
    gains = {
        name: [np.array(runs.gaps(name, rate, form, "MOTA")) for rate in runs.rates]
        for name in found.swept
    }
    mean = np.mean([[each.mean() for each in gain] for gain in gains.values()], axis=0)
    figures = (
        f"MOTA {', '.join(f'{gain:+.2f}' for gain in mean)} with"
        f" {', '.join(map(str, runs.rates))} false alarms a frame added"
    )
    return Claim(
        "PHD-MT gains most where clutter is heavy",
        "+.73 on 102a03, +.01 to +.08 elsewhere",
        form,
        with_seeds(figures, runs.seeds(runs.rates[-1], form)),
        {
            name: all_hold(decided((b - a).tolist()) for a, b in itertools.pairwise(gain))
            for name, gain in gains.items()
        },
    )


def _mended(found: SmallResults, form: str) -> Claim:
    """Where MT is below zero, PHD-MT is not."""
    runs = found.runs
    low = {
        f"{name} +{rate}" if rate else name: (name, rate)
        for name in runs.cases
        for rate in (runs.rates if name in FULL else runs.rates[:1])
        if runs.mean(name, rate, MT, "MOTA") < 0
    }
    middle = [
        np.median([runs.mean(*case, method, "MOTA") for case in low.values()]) if low else np.nan
        for method in (MT, form)
    ]
    figures = f"{middle[0]:.2f}, {middle[1]:.2f} in the median of {len(low)}"
    return Claim(
        "where MT is below 0, PHD-MT is above (MOTA)",
        "−.58, .15 on 102a03",
        form,
        with_seeds(figures, runs.seeds(runs.rates[-1], form)),
        {name: decided(runs.each(*case, form, "MOTA")) for name, case in low.items()},
    )


def _slowest(found: SmallResults, form: str) -> Claim:
    detector, filter_, rest = found.shares(form)
    return Claim(
        "time: most for the change detector, then the PHD filter, then the rest",
        "64, 34, 2 %; 6 frames a second",
        form,
        f"{100 * detector:.0f}, {100 * filter_:.0f}, {100 * rest:.0f} %;"
        f" {found.speed(form):.0f} frames a second",
        {"": detector > filter_ > rest},
    )
