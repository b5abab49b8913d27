"""What the report of a run shows, and the collector that a run loop feeds.

A `Recorder` looks at every step once and keeps numbers per frame plus a handful of pictures: memory does not grow with the
video beyond some hundred bytes a frame. Which frames become heat maps is decided in one pass without knowing how many will
come (see `spread`). Pictures are kept at most ``picture_width`` pixels wide.

Notation: "mass" is the integral of the intensity, the filter's expected number of objects; "clutter mass" the sum of the
posterior probabilities κ/(κ+C) that a frame's detections are false alarms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from phdtrack.errors import InputError
from phdtrack.report.background import still_background
from phdtrack.report.chain import ChainSummary, chain_summary
from phdtrack.report.density import default_cell, density_map
from phdtrack.report.spread import Spread, evenly
from phdtrack.types import F8, I8, ChainInfo, Image, Particles, SequenceInfo, Step, Tracks, Truth

STAGES = ("detect", "filter", "extract", "associate")
NO_IMAGE: Image = np.zeros((0, 0, 3), np.uint8)


@dataclass(frozen=True, slots=True)
class About:
    """What is told of a run in words and single values.

    ``command`` is the line that was run, ``started`` an ISO time, ``seconds`` the wall time of everything,
    ``tracking_seconds`` that of detection and tracking, which overlap (0: not measured), without ``left_out`` frames in
    which kernels were compiled or loaded, ``versions`` and ``scores`` pairs of name and value, ``notes`` sentences to show
    (after how many detections an object is believed, …).
    """

    title: str = ""
    command: str = ""
    seed: int = 0
    started: str = ""
    seconds: float = 0.0
    versions: tuple[tuple[str, str], ...] = ()
    scores: tuple[tuple[str, float], ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tracking_seconds: float = 0.0
    left_out: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Numbers per frame, F frames.

    Attributes
    ----------
    numbers : (F,) frame numbers from 1, ascending.     times : (F,) seconds.
    n_detections : (F,) detections.                     n_estimates : (F,) states extracted.
    mass : (F,) expected number of objects.             clutter_mass : (F,) expected number of false alarms.
    seconds : (F, S) time that each stage took, in the order of ``stages``.
    stages : the S names.
    truth_count : (F,) annotated objects, or (0,) where there is no truth.
    count_range : (F, 2) between which numbers the filter's number of objects lies with 90 % probability; NaN in frames
        without a distribution, (0, 2) where no frame has one.
    """

    numbers: I8
    times: F8
    n_detections: I8
    n_estimates: I8
    mass: F8
    clutter_mass: F8
    seconds: F8
    stages: tuple[str, ...] = STAGES
    truth_count: I8 = field(default_factory=lambda: np.zeros(0, np.int64))
    count_range: F8 = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        per_frame = (self.times, self.n_detections, self.n_estimates, self.mass, self.clutter_mass, self.seconds)
        lengths = {len(self.numbers), *map(len, per_frame)} | ({len(self.truth_count), len(self.count_range)} - {0})
        if len(lengths) != 1 or self.seconds.shape[1:] != (len(self.stages),):
            raise InputError(
                f"expected the same number of frames in every series and a column for each of {self.stages}, "
                f"got lengths {sorted(lengths)} and times of shape {self.seconds.shape}"
            )

    def __len__(self) -> int:
        return len(self.numbers)


@dataclass(frozen=True, slots=True, eq=False)
class HeatMap:
    """The intensity over one frame.

    ``image`` is the frame, scaled down, BGR, (0, 0, 3) where there is none; ``density`` (gh, gw) the expected number of
    objects in each cell of ``cell`` × ``cell`` pixels of the original; ``detections`` and ``estimates`` the boxes (·, 4) of
    that frame, xyxy in original pixels.
    """

    number: int
    image: Image
    density: F8
    cell: float
    detections: F8
    estimates: F8

    @property
    def mass(self) -> float:
        """Expected number of objects inside the frame."""
        return float(self.density.sum())


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """Everything that a report shows. ``background`` is a scaled-down BGR picture of the scene, (0, 0, 3) without video;
    ``chain`` how an MCMC filter's chain moved, None of other filters."""

    info: SequenceInfo
    series: Series
    tracks: Tracks
    about: About = field(default_factory=About)
    heat_maps: tuple[HeatMap, ...] = ()
    background: Image = field(default_factory=lambda: NO_IMAGE)
    chain: ChainSummary | None = None

    @property
    def track_count(self) -> I8:
        """(F,) tracks in each frame."""
        return count_rows(self.tracks.frame, self.series.numbers)

    @property
    def n_objects(self) -> int:
        """Number of identities."""
        return len(np.unique(self.tracks.identity))

    @property
    def false_alarms(self) -> float:
        """Expected number of false alarms among all detections; frames in which it is unknown (NaN) count as none."""
        return float(np.nansum(self.series.clutter_mass))

    def by_identity(self) -> tuple[Tracks, ...]:
        """The rows of each identity, ascending, each in the order of frames."""
        order = np.lexsort((self.tracks.frame, self.tracks.identity))
        cuts = np.flatnonzero(np.diff(self.tracks.identity[order])) + 1
        return tuple(self.tracks.take(index) for index in np.split(order, cuts) if len(index))

    @property
    def frames_per_second(self) -> float:
        """Frames over the wall time of detection and tracking; NaN where no time was measured.

        Without the frames in which kernels were compiled or loaded, see `About`.
        Where only the stages were measured and not the whole, over the sum of these, as if they did not overlap.
        """
        about = self.about
        total = about.tracking_seconds if about.left_out else about.tracking_seconds or float(self.series.seconds.sum())
        return (len(self.series) - about.left_out) / total if total > 0 else float("nan")


def count_rows(frame: I8, numbers: I8) -> I8:
    """(F,) how many entries of ``frame`` (M,) equal each of ``numbers`` (F,)."""
    ordered = np.sort(frame)
    return np.searchsorted(ordered, numbers, side="right") - np.searchsorted(ordered, numbers, side="left")


@dataclass(frozen=True, slots=True, eq=False)
class _Snapshot:
    """A frame kept for pictures; ``heat_map`` is None where the filter keeps no particles."""

    image: Image
    heat_map: HeatMap | None


class Recorder:
    """Collects a `RunRecord` while a run goes on: `add` every frame in order, `record` at the end or when it breaks off.

    Parameters
    ----------
    info : the sequence. Pictures need its width and height; numbers do not.
    heat_maps : how many frames to show with the intensity over them.
    picture_width : width in pixels to which kept frames are scaled down.
    cell : side of a heat map's cell in pixels; 0 chooses by the frame size.
    """

    def __init__(self, info: SequenceInfo, *, heat_maps: int = 4, picture_width: int = 800, cell: float = 0.0) -> None:
        self._info = info
        self._wanted, self._picture_width = heat_maps, picture_width
        self._cell = cell if cell > 0 else default_cell(info)
        self._rows: list[tuple[float, ...]] = []
        self._ranges: list[tuple[float, float]] = []
        self._chains: list[ChainInfo] = []
        self._snapshots: Spread[_Snapshot] = Spread(3 * heat_maps)

    def add(self, image: Image | None, step: Step, particles: Particles | None, detect_seconds: float) -> None:
        """Take in one frame: its picture (BGR, None without video), what came of it, the filter's particles (None where the
        filter has none) and the time in seconds that detection took."""
        info = step.info
        row = (step.number, step.time, len(step.detections), len(step.estimates), info.mass, info.clutter_probability.sum())
        self._rows.append((*row, detect_seconds, *step.seconds))
        self._ranges.append(_likely(info.cardinality))
        if info.chain is not None:
            self._chains.append(info.chain)
        index = len(self._rows)
        if self._snapshots.wants(index) and self._info.width > 0 and self._info.height > 0:
            self._snapshots.put(index, self._snapshot(image, step, particles))

    @property
    def chain(self) -> ChainSummary | None:
        """How the chain of an MCMC filter has moved so far; None of other filters."""
        return chain_summary(self._chains)

    def record(self, tracks: Tracks, about: About, truth: Truth | None = None) -> RunRecord:
        """Everything so far, with the corrected ``tracks`` of the whole run. Does not end the collecting."""
        snapshots = self._snapshots.items
        maps = tuple(s.heat_map for s in snapshots if s.heat_map is not None)
        images = [s.image for s in snapshots if s.image.size]
        background = still_background(images) if images else NO_IMAGE
        return RunRecord(self._info, self._series(truth), tracks, about, evenly(maps, self._wanted), background, self.chain)

    def _series(self, truth: Truth | None) -> Series:
        table = np.array(self._rows, dtype=np.float64).reshape(-1, 6 + len(STAGES))
        numbers = table[:, 0].astype(np.int64)
        expected = np.zeros(0, np.int64) if truth is None else count_rows(truth.frame[~truth.distractor], numbers)
        return Series(
            numbers=numbers,
            times=table[:, 1],
            n_detections=table[:, 2].astype(np.int64),
            n_estimates=table[:, 3].astype(np.int64),
            mass=table[:, 4],
            clutter_mass=table[:, 5],
            seconds=table[:, 6:],
            truth_count=expected,
            count_range=self._count_range(),
        )

    def _count_range(self) -> F8:
        """(F, 2), or (0, 2) where the filter never had a distribution of the number."""
        ranges = np.array(self._ranges).reshape(-1, 2)
        return ranges if np.isfinite(ranges).any() else ranges[:0]

    def _snapshot(self, image: Image | None, step: Step, particles: Particles | None) -> _Snapshot:
        small = NO_IMAGE if image is None else _shrunk(image, self._picture_width)
        if particles is None:
            return _Snapshot(small, None)
        density = density_map(particles, self._info, self._cell)
        heat = HeatMap(step.number, small, density, self._cell, step.detections.xyxy, step.estimates.xyxy)
        return _Snapshot(small, heat)


def _likely(cardinality: F8) -> tuple[float, float]:
    """The 5 % and 95 % quantiles of a distribution over 0, 1, 2, …; NaN where there is none."""
    if not len(cardinality):
        return math.nan, math.nan
    low, high = np.searchsorted(np.cumsum(cardinality), (0.05, 0.95))
    return float(low), float(min(high, len(cardinality) - 1))


def _shrunk(image: Image, width: int) -> Image:
    """A copy at most ``width`` pixels wide, never enlarged."""
    import cv2

    high, wide = image.shape[:2]
    if wide <= width:
        return image.copy()
    size = (width, max(1, round(high * width / wide)))
    small: Image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return small
