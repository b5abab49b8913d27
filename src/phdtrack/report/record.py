"""What the report of a run shows, and the recorder that collects it while the run goes on.

A `Recorder` keeps numbers per frame and a handful of pictures, so that memory does not grow with the video beyond some
hundred bytes a frame. Which frames become heat maps is decided in one pass without knowing how many frames there will be
(`EvenSample`). Pictures are kept at most ``picture_width`` pixels wide.

A heat map is the intensity D over position [M07 Fig. 1]: the particles' weights, which sum to the expected number of
objects, are added up in small cells of the frame; velocity and size are integrated away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import cv2
import numpy as np

from phdtrack.errors import InputError
from phdtrack.report.rendering import lines
from phdtrack.types import F8, I8, ChainInfo, Image, Particles, SequenceInfo, Step, Tracks, Truth

T = TypeVar("T")
STAGES = ("detect", "filter", "extract", "associate")
NO_IMAGE: Image = np.zeros((0, 0, 3), np.uint8)
LOW_EFFECTIVE = 20.0
"""Effective samples below which positions are doubtful: their error by chance is 1/√20 = 22 % of their posterior spread."""
_CELLS_ACROSS = 128
# Mean distance of the frames from their median, in grey levels, up to which the camera counts as fixed: crowds and noise
# stay below, a turned camera lies far above.
_FIXED_CAMERA = 10.0


@dataclass(frozen=True, slots=True)
class About:
    """What is said of a run in words and single values.

    Attributes
    ----------
    title, command, started : the heading, the line that was run, an ISO time.
    seed : of everything random.
    seconds : wall time of everything.
    versions, scores : pairs of name and value.
    warnings, notes : sentences to show.
    tracking_seconds : wall time of detection and tracking, which overlap; 0 where not measured.
    left_out : frames in which kernels were compiled or loaded; ``tracking_seconds`` is without them.
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
    numbers : (F,) frame numbers from 1, ascending.
    times : (F,) seconds.
    n_detections, n_estimates : (F,) detections, states extracted.
    mass : (F,) expected number of objects, the integral of the intensity.
    clutter_mass : (F,) expected number of false alarms, the sum of κ/(κ + C) over the detections.
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

    @property
    def known_mass(self) -> F8:
        """The expected numbers of objects in the frames in which the filter gives one."""
        return self.mass[np.isfinite(self.mass)]


@dataclass(frozen=True, slots=True)
class StageTime:
    """Milliseconds per frame of one stage: mean, median and 95th percentile; ``share`` of the whole (0–1)."""

    name: str
    mean: float
    median: float
    high: float
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class HeatMap:
    """The intensity over one frame.

    Attributes
    ----------
    number : of the frame, from 1.
    image : (h, w, 3) the frame, scaled down, BGR; (0, 0, 3) where there is none.
    density : (gh, gw) expected number of objects in each cell.
    cell : side of a cell, pixels of the original.
    detections, estimates : (·, 4) boxes of that frame, xyxy in pixels of the original.
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


@dataclass(frozen=True, slots=True)
class ChainSummary:
    """How well the Markov chain of an MCMC filter moved over the frames of a run.

    Attributes
    ----------
    acceptance : by the name of a move, how many of those proposed were accepted (0–1), mean over frames with any.
    effective : mean number of effective samples over the frames with targets; NaN without such frames.
    low : share of these frames (0–1) in which it was below `LOW_EFFECTIVE`.
    """

    acceptance: Mapping[str, float]
    effective: float
    low: float

    @property
    def sentence(self) -> str:
        """The same in words."""
        return " ".join(lines("chain.txt", chain=self, known=math.isfinite(self.effective)))

    @property
    def warning(self) -> str:
        """What to do where the chain moved too little; empty where it moved well enough."""
        if not self.low > 0.5:
            return ""
        return (
            f"the chain moved little: in {100 * self.low:.0f} % of the frames its samples are worth fewer than "
            f"{LOW_EFFECTIVE:.0f} independent ones; more filter.samples, or a greater filter.thin, make positions surer"
        )


def chain_summary(frames: Sequence[ChainInfo]) -> ChainSummary | None:
    """The chains of all frames in one summary; None without any."""
    if not frames:
        return None
    shares: dict[str, list[float]] = {}
    for frame in frames:
        for name, proposed, accepted in zip(frame.moves, frame.proposed.tolist(), frame.accepted.tolist(), strict=True):
            if proposed:
                shares.setdefault(name, []).append(accepted / proposed)
    effective = np.array([frame.effective for frame in frames])
    known = effective[np.isfinite(effective)]
    return ChainSummary(
        {name: float(np.mean(each)) for name, each in shares.items()},
        float(known.mean()) if len(known) else math.nan,
        float((known < LOW_EFFECTIVE).mean()) if len(known) else 0.0,
    )


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """Everything that a report shows.

    Attributes
    ----------
    info, series, about : the sequence, numbers per frame, words and single values.
    tracks : the corrected tracks of the whole run.
    heat_maps : the frames that are shown with the intensity over them.
    background : (h, w, 3) BGR picture of the scene, scaled down; (0, 0, 3) without video.
    chain : of an MCMC filter, None of others.
    """

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

    @property
    def lifetimes(self) -> I8:
        """(n,) number of boxes of each identity."""
        return np.unique(self.tracks.identity, return_counts=True)[1]

    @property
    def seconds_of_video(self) -> float:
        """From the first to the last frame."""
        times = self.series.times
        return float(times[-1] - times[0]) if len(times) > 1 else 0.0

    def by_identity(self) -> tuple[Tracks, ...]:
        """The rows of each identity, ascending, each in the order of frames."""
        order = np.lexsort((self.tracks.frame, self.tracks.identity))
        cuts = np.flatnonzero(np.diff(self.tracks.identity[order])) + 1
        return tuple(self.tracks.take(index) for index in np.split(order, cuts) if len(index))

    @property
    def frames_per_second(self) -> float:
        """Frames over the wall time of detection and tracking; NaN where no time was measured.

        Frames in which kernels were compiled or loaded do not count (see `About`). Where only the stages were measured and
        not the whole, it is the frames over the sum of the stages, as if they did not overlap.
        """
        about = self.about
        total = about.tracking_seconds if about.left_out else about.tracking_seconds or float(self.series.seconds.sum())
        return (len(self.series) - about.left_out) / total if total > 0 else math.nan

    @property
    def stage_times(self) -> tuple[StageTime, ...]:
        """One row for each stage, and one for their sum; empty without frames."""
        table = 1000 * self.series.seconds
        if not len(table):
            return ()
        names, table = (*self.series.stages, "together"), np.column_stack([table, table.sum(axis=1)])
        share = table.sum(axis=0) / max(float(table[:, -1].sum()), 1e-12)
        columns = (table.mean(axis=0), np.median(table, axis=0), np.quantile(table, 0.95, axis=0), share)
        return tuple(StageTime(name, *each) for name, each in zip(names, np.array(columns).T.tolist(), strict=True))


def sentences(record: RunRecord) -> tuple[str, ...]:
    """What happened in a run, in a few sentences for the report, the terminal and ``run.json``."""
    return lines("summary.txt", record=record, known_speed=math.isfinite(record.frames_per_second))


def count_rows(frame: I8, numbers: I8) -> I8:
    """(F,) how many entries of ``frame`` (M,) equal each of ``numbers`` (F,)."""
    ordered = np.sort(frame)
    return np.searchsorted(ordered, numbers, side="right") - np.searchsorted(ordered, numbers, side="left")


class Recorder:
    """Collects a `RunRecord` while a run goes on: `add` every frame in order, `record` at the end or when it breaks off.

    Parameters
    ----------
    info : the sequence. Pictures need its width and height; numbers do not.
    heat_maps : how many frames to show with the intensity over them.
    picture_width : width to which kept frames are scaled down, pixels.
    """

    def __init__(self, info: SequenceInfo, *, heat_maps: int = 4, picture_width: int = 800) -> None:
        self._info, self._wanted, self._picture_width = info, heat_maps, picture_width
        self._rows: list[tuple[float, ...]] = []
        self._chains: list[ChainInfo] = []
        self._kept: EvenSample[tuple[Image, HeatMap | None]] = EvenSample(3 * heat_maps)

    def add(self, image: Image | None, step: Step, particles: Particles | None, detect_seconds: float) -> None:
        """Take in one frame.

        Parameters
        ----------
        image : (H, W, 3) BGR, None without video.
        step : what the tracker made of the frame.
        particles : the filter's, None where it has none.
        detect_seconds : time that detection took, seconds.
        """
        info = step.info
        row = (step.number, step.time, len(step.detections), len(step.estimates), info.mass, info.clutter_probability.sum())
        self._rows.append((*row, *_likely_range(info.cardinality), detect_seconds, *step.seconds))
        if info.chain is not None:
            self._chains.append(info.chain)
        index = len(self._rows)
        if not (self._kept.wants(index) and self._info.width > 0 and self._info.height > 0):
            return
        small, heat = NO_IMAGE if image is None else _shrunk(image, self._picture_width), None
        if particles is not None:
            cell = default_cell(self._info)
            density = density_map(particles, self._info, cell)
            heat = HeatMap(step.number, small, density, cell, step.detections.xyxy, step.estimates.xyxy)
        self._kept.put(index, (small, heat))

    @property
    def chain(self) -> ChainSummary | None:
        """How the chain of an MCMC filter has moved so far; None of other filters."""
        return chain_summary(self._chains)

    def record(self, tracks: Tracks, about: About, truth: Truth | None = None) -> RunRecord:
        """Everything so far; collecting may go on.

        Parameters
        ----------
        tracks : the corrected tracks of the whole run.
        about : words and single values.
        truth : annotated objects, None where there are none.

        Returns
        -------
        The record.
        """
        maps = tuple(heat for _, heat in self._kept.items if heat is not None)
        images = [image for image, _ in self._kept.items if image.size]
        background = still_background(images) if images else NO_IMAGE
        return RunRecord(self._info, self._series(truth), tracks, about, evenly(maps, self._wanted), background, self.chain)

    def _series(self, truth: Truth | None) -> Series:
        table = np.array(self._rows, dtype=np.float64).reshape(-1, 8 + len(STAGES))
        numbers, ranges = table[:, 0].astype(np.int64), table[:, 6:8]
        return Series(
            numbers=numbers,
            times=table[:, 1],
            n_detections=table[:, 2].astype(np.int64),
            n_estimates=table[:, 3].astype(np.int64),
            mass=table[:, 4],
            clutter_mass=table[:, 5],
            seconds=table[:, 8:],
            truth_count=np.zeros(0, np.int64) if truth is None else count_rows(truth.frame[~truth.distractor], numbers),
            count_range=ranges if np.isfinite(ranges).any() else ranges[:0],
        )


class EvenSample(Generic[T]):
    """Keeps at most ``capacity`` items of a stream of unknown length, spread evenly over all of them.

    Items whose index is a multiple of the stride are kept. When more than the capacity are held, every other one is
    dropped and the stride doubles: the same stream keeps the same items, and once it has reached the capacity at least
    half of it is held.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = max(1, capacity)
        self._stride = 1
        self._kept: list[tuple[int, T]] = []

    def wants(self, index: int) -> bool:
        """Whether item ``index`` (from 1, ascending) would be kept: ask before making an expensive item."""
        return index % self._stride == 0

    def put(self, index: int, item: T) -> None:
        """Offer item ``index`` (from 1, ascending)."""
        if not self.wants(index):
            return
        self._kept.append((index, item))
        while len(self._kept) > self._capacity:
            self._stride *= 2
            self._kept = [pair for pair in self._kept if self.wants(pair[0])]

    @property
    def items(self) -> tuple[T, ...]:
        """Everything held, in the order of the stream."""
        return tuple(item for _, item in self._kept)


def evenly(items: tuple[T, ...], count: int) -> tuple[T, ...]:
    """At most ``count`` of the items, evenly spaced, the last one among them."""
    if len(items) <= count:
        return items
    index = np.linspace(len(items), 0, count, endpoint=False)[::-1].round().astype(int) - 1
    return tuple(items[i] for i in index)


def default_cell(info: SequenceInfo) -> float:
    """Side of a heat map's cell in pixels, about 128 cells across the longer side of the frame; at least one pixel."""
    return max(1.0, round(max(info.width, info.height) / _CELLS_ACROSS))


def density_map(particles: Particles, info: SequenceInfo, cell: float, *, smooth: int = 2) -> F8:
    """The expected number of objects in each cell of the frame [M07 Fig. 1].

    Its sum is the mass of the particles whose position lies inside the frame: at the borders the edge row stands in for its
    missing neighbour, so that smoothing loses nothing.

    Parameters
    ----------
    particles : (d, N) states with x and y, pixels, in rows 0 and 1, and their weights.
    info : the size of the frame.
    cell : side of a cell, pixels.
    smooth : passes with the kernel (1, 2, 1)/4 along both axes, against the grain of few particles.

    Returns
    -------
    (gh, gw) numbers; row 0 is the top of the frame, the last row and column may reach beyond its edge.

    Raises
    ------
    InputError : the cell or the frame has no size.
    """
    if not (cell > 0 and info.width > 0 and info.height > 0):
        raise InputError(
            f"expected a cell and a frame of positive size, got a cell of {cell} and a frame of {info.width}×{info.height}",
            cure="Give the frame size of the sequence.",
        )
    shape = (int(np.ceil(info.height / cell)), int(np.ceil(info.width / cell)))
    x, y = particles.state[0], particles.state[1]
    inside = (x >= 0) & (y >= 0) & (x < info.width) & (y < info.height)
    place = (y[inside] / cell).astype(np.int64) * shape[1] + (x[inside] / cell).astype(np.int64)
    grid: F8 = np.bincount(place, particles.weight[inside], shape[0] * shape[1]).astype(np.float64).reshape(shape)
    for _ in range(2 * smooth):
        padded = np.pad(grid, ((1, 1), (0, 0)), "edge")
        grid = ((padded[:-2] + 2 * grid + padded[2:]) / 4).T
    return np.ascontiguousarray(grid)


def still_background(images: Sequence[Image]) -> Image:
    """(H, W, 3) the scene without what moves, from at least one frame (BGR); frames of another size than the first are
    left out.

    With a fixed camera it is the median. With a moving camera a median would mix several views: then it is the middle frame.
    """
    same = [image for image in images if image.shape == images[0].shape]
    stack = np.stack(same)
    median = np.median(stack, axis=0).astype(np.uint8)
    fixed = np.abs(stack.astype(np.int16) - median).mean() <= _FIXED_CAMERA
    return median if fixed else same[len(same) // 2].copy()


def _likely_range(cardinality: F8) -> tuple[float, float]:
    """The 5 % and 95 % quantiles of a distribution over 0, 1, 2, …; NaN without one."""
    if not len(cardinality):
        return math.nan, math.nan
    low, high = np.searchsorted(np.cumsum(cardinality), (0.05, 0.95))
    return float(low), float(min(high, len(cardinality) - 1))


def _shrunk(image: Image, width: int) -> Image:
    """A copy at most ``width`` pixels wide, never enlarged."""
    high, wide = image.shape[:2]
    if wide <= width:
        return image.copy()
    small: Image = cv2.resize(image, (width, max(1, round(high * width / wide))), interpolation=cv2.INTER_AREA)
    return small
