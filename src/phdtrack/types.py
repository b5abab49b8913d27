"""The records that flow through phdtrack: one type at each arrow of the pipeline, frozen, arrays
inside.

    frame ─detect→ Detections ─predict, update→ (Particles, UpdateInfo) ─extract→ Estimates
    ─associate→ Tracks

Conventions, stated once:

* Boxes in records are ``xyxy`` (left, top, right, bottom) in pixels of the original video.
* Frame numbers are 1-based, as MOTChallenge writes them.
* Times are seconds. A model's interval ``dt`` is in the model's own time unit
  (`protocols.Model.rate` units a second).
* States are columns: an array of L states of dimension d has shape (d, L), so that each component
  is contiguous. Rows 0 and 1 of every state are its position.
* Nothing is None where an empty array will do; no function writes into an array that it received.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import DTypeLike, NDArray

from phdtrack.errors import needed
from phdtrack.row_data import Columns, stacked

if TYPE_CHECKING:
    from phdtrack.kernels.appearance import Looks

T = TypeVar("T")


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def state_record(cls: type[T]) -> type[T]:
    """Make a class a dataclass with slots, for states of which each frame makes new ones.

    To type checkers it is frozen. To Python it is not, because making a frozen one takes five
    times as long.

    Parameters
    ----------
    cls : a class with annotated fields.
    """
    return dataclass(slots=True, eq=False)(cls)


F8 = NDArray[np.float64]
F4 = NDArray[np.float32]
Real = NDArray[np.floating[Any]]
I8 = NDArray[np.int64]
Bool = NDArray[np.bool_]
Ints = I8 | int
Image = NDArray[np.uint8]


class SupportsArray(Protocol):
    """An array of NumPy, or an object that NumPy makes one of, as a tensor on the CPU."""

    def __array__(self) -> NDArray[Any]:
        """The numbers."""


# Numbers as callers give them. NumPy's `ArrayLike` would take a word for an array.
Vector = SupportsArray | Sequence[float | np.number[Any]]
Matrix = SupportsArray | Sequence[SupportsArray | Sequence[float | np.number[Any]]]
# Empty arrays, which nobody can write into: those of all records are the same.
NO_NUMBERS: F8 = np.zeros(0)
NO_INTEGERS: I8 = np.zeros(0, np.int64)
NO_DESCRIPTORS: F4 = np.zeros((0, 0), np.float32)
NO_PAIRS: I8 = np.zeros((0, 2), np.int64)
# Stands for a (3, 3) homography between the pixels of two frames: there is none.
STILL: F8 = np.zeros((0, 3))
# The highest frame number: three years at a hundred a second. Products of it with a picture's size
# are exact.
LAST_FRAME = 10_000_000_000


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """The facts about a sequence before its frames are read; ``frames`` is 0 if their number is not
    known (headers lie), ``pixel_aspect`` the width of a pixel as displayed, divided by its height.
    """

    width: int
    height: int
    fps: float
    frames: int = 0
    name: str = ""
    pixel_aspect: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture of a video: ``number`` from 1, ``time`` in seconds from the stream, ``picture``:
    its ``image``, or a `devices.Picture`, of which that is made when it is asked for."""

    number: int
    time: float
    picture: Any

    @property
    def image(self) -> Image:
        """(H, W, 3) BGR uint8."""
        return self.picture if isinstance(self.picture, np.ndarray) else self.picture.bgr()


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """The measurements of one frame.

    Attributes
    ----------
    xyxy : (N, 4) float64, pixels.
    confidence, class_id : (N,) float64, int64; 1 and 0 where the detector gives none.
    covariance : (N, 4, 4) of (centre x, centre y, width, height) in pixels², or None where the
        detector states none.
    observed : False for a frame without detection (predict only), which is not the same as an empty
        frame.
    row : (N,) int64, the number of each detection in its frame as the caller gave it, from 0 and
        ascending. It goes with a detection through every selection, and `Tracks.detection` is it.
    embeddings : (N, D) float32, what each box looks like, of any length and scale; a row of zeros
        or NaN where this is not known. None where nothing is known of any.
    """

    xyxy: F8
    confidence: F8
    class_id: I8
    covariance: F8 | None = None
    observed: bool = True
    row: I8 = field(default_factory=lambda: NO_INTEGERS)
    embeddings: F4 | None = None

    def __post_init__(self) -> None:
        if len(self.row) != len(self.xyxy):
            object.__setattr__(self, "row", np.arange(len(self.xyxy)))

    @classmethod
    def empty(cls, *, observed: bool = True) -> Detections:
        """No boxes: an empty frame, or one that was not observed."""
        return cls(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64), observed=observed)

    @classmethod
    def of(
        cls,
        xyxy: Matrix,
        confidence: Vector | None = None,
        class_id: Vector | None = None,
        embeddings: Matrix | None = None,
    ) -> Detections:
        """Detections of boxes: copies, in the types of this record; values are not checked.

        Parameters
        ----------
        xyxy, confidence, class_id : (N, 4) boxes, and (N,) of each; None: 1 and 0.
        embeddings : (N, D), what each looks like; None: not known.
        """
        boxes = np.array(xyxy, dtype=np.float64).reshape(-1, 4)
        n = len(boxes)
        if confidence is None:
            score = np.ones(n)
        else:
            score = np.array(confidence, dtype=np.float64).reshape(n)
        if class_id is None:
            label = np.zeros(n, np.int64)
        else:
            label = np.array(class_id, dtype=np.int64).reshape(n)
        look = None
        if embeddings is not None:
            look = np.array(embeddings, dtype=np.float32).reshape(n, -1 if n else 0)
        return cls(boxes, score, label, None, True, np.arange(n), look)

    def __len__(self) -> int:
        return len(self.xyxy)

    def select(self, index: I8 | Bool) -> Detections:
        """The detections at ``index`` (integers or a mask), in that order.

        Parameters
        ----------
        index : (K,) integers, or (N,) a mask.
        """
        cov = None if self.covariance is None else self.covariance[index]
        look = None if self.embeddings is None else self.embeddings[index]
        return Detections(
            self.xyxy[index],
            self.confidence[index],
            self.class_id[index],
            cov,
            self.observed,
            self.row[index],
            look,
        )

    def numbered(self) -> Detections:
        """The same detections, as those of a frame of their own: numbered from 0."""
        return Detections(
            self.xyxy,
            self.confidence,
            self.class_id,
            self.covariance,
            self.observed,
            np.arange(len(self)),
            self.embeddings,
        )


@dataclass(frozen=True, slots=True, eq=False)
class DetectionTable:
    """The detections of a whole sequence: ``frame`` (M,) int64 from 1, ascending, beside
    ``detections`` with M rows.

    ``empty`` counts the boxes of width or height 0 that the file has besides, ``names`` are those
    that it gives classes. ``file_row`` (M,) is the row of each in the file, from 0, of ``rows``
    that the file has; by default those of a file of these rows alone.
    """

    frame: I8
    detections: Detections
    empty: int = 0
    names: Mapping[int, str] = field(default_factory=dict)
    file_row: I8 = field(default_factory=lambda: NO_INTEGERS)
    rows: int = 0

    def __post_init__(self) -> None:
        if len(self.file_row) != len(self.frame):
            object.__setattr__(self, "file_row", np.arange(len(self.frame)))
        object.__setattr__(self, "rows", max(self.rows, len(self.frame)))

    def __len__(self) -> int:
        return len(self.frame)

    def at(self, number: int) -> Detections:
        """The detections of frame ``number``; empty if the table has none."""
        return self.detections.select(self.places(number)).numbered()

    def places(self, number: int) -> I8:
        """(N,) the places of the detections of frame ``number`` in the table."""
        lo, hi = np.searchsorted(self.frame, [number, number + 1])
        return np.arange(lo, hi)

    def select(self, index: I8 | Bool) -> DetectionTable:
        """The detections at ``index`` (integers or a mask), in that order."""
        return replace(
            self,
            frame=self.frame[index],
            detections=self.detections.select(index),
            file_row=self.file_row[index],
        )

    @property
    def last(self) -> int:
        """The highest frame number, 0 for an empty table."""
        if len(self.frame):
            return int(self.frame[-1])
        return 0


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Annotated objects: ``frame`` (M,) from 1, ``identity`` (M,), ``xyxy`` (M, 4) pixels.

    ``distractor`` (M,) marks rows that do not count, and whose matched output does not count either
    (MOT16 and later). Output that matches no row does not count where more than half of it lies in
    one of ``regions`` (R, 5): frame (0: all), left, top, right, bottom; nor where it is at most
    ``least_height`` pixels high, if that is above 0 (KITTI).
    """

    frame: I8
    identity: I8
    xyxy: F8
    distractor: Bool
    regions: F8 = field(default_factory=lambda: np.zeros((0, 5)))
    least_height: float = 0.0

    def __len__(self) -> int:
        return len(self.frame)


class _Weighted:
    """Parts with weights whose sum is the expected number of targets."""

    __slots__ = ()
    weight: F8

    def __len__(self) -> int:
        return len(self.weight)

    @property
    def mass(self) -> float:
        """The integral of the intensity: the expected number of targets."""
        return float(self.weight.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Particles(_Weighted):
    """A weighted particle set.

    Attributes
    ----------
    state : (d, L) float64.
    weight : (L,) float64 ≥ 0, whose sum is the expected number of targets.
    start : (R + 1,) where runs of neighbouring particles begin, 0 … L; (0,) where the order says
        nothing.
    """

    state: F8
    weight: F8
    start: I8 = field(default_factory=lambda: NO_INTEGERS)


@dataclass(frozen=True, slots=True, eq=False)
class ParticleBlocks:
    """Particles in blocks of neighbours: what the particle filters carry from frame to frame.

    A block is a run of at most 256 particles that lie close together: what is near one of them is
    found once for all.

    Attributes
    ----------
    state : (d, L) C-contiguous; float32 for boxes, 24 bytes a particle, float64 for others.
    start : (B + 1,) int64 ascending from 0 to L: block b holds the columns start[b] … start[b + 1]
        − 1.
    unit : weight of a particle whose share is 1.
    share : (L,) of the state's type, weights in units; (0,) where all are 1, as after resampling.
    """

    state: Real
    start: I8
    unit: float
    share: Real = field(default_factory=lambda: np.zeros(0, np.float32))

    @classmethod
    def empty(cls, dim: int, dtype: DTypeLike = np.float32) -> ParticleBlocks:
        """No particles of dimension ``dim``."""
        return cls(np.zeros((dim, 0), dtype), np.zeros(1, np.int64), 0.0, np.zeros(0, dtype))

    def __len__(self) -> int:
        return int(self.start[-1])

    @property
    def weight(self) -> F8:
        """(L,) weights."""
        weight: F8 = (
            self.unit * self.share.astype(np.float64)
            if len(self.share)
            else np.full(len(self), self.unit)
        )
        return weight

    @property
    def mass(self) -> float:
        """The integral of the intensity: the expected number of targets."""
        return self.unit * (
            float(self.share.sum(dtype=np.float64)) if len(self.share) else len(self)
        )

    def particles(self) -> Particles:
        """The same intensity as plain particles; a copy in float64."""
        return Particles(self.state.astype(np.float64), self.weight)


@dataclass(frozen=True, slots=True, eq=False)
class GaussianMixture(_Weighted):
    """A weighted sum of Gaussians.

    Attributes
    ----------
    weight : (J,) float64 ≥ 0.      mean : (d, J) float64.      covariance : (J, d, d) float64.
    """

    weight: F8
    mean: F8
    covariance: F8

    @classmethod
    def empty(cls, dim: int) -> GaussianMixture:
        """No Gaussians of dimension ``dim``."""
        return cls(np.zeros(0), np.zeros((dim, 0)), np.zeros((0, dim, dim)))


@state_record
class UpdateInfo:
    """The results of an update besides the new state.

    Attributes
    ----------
    mass_predicted, mass_born, mass : before the update with the newborn, of the newborn, and after
        the update.
    evidence, clutter : (N,) C(z_j) = ∫ p_D g(z_j|x) D⁺(x) dx and κ(z_j), per unit of measurement
        volume.
    clutter_probability : (N,) posterior probability that each detection is a false alarm. It is
        κ/(κ + C) for PHD filters, and 1 if κ + C = 0.
    vanished : number of detections with κ + C = 0, whose term is 0 by definition.
    cardinality : probabilities of 0, 1, 2, … targets after the update; (0,) from filters that carry
        none.
    detected : ∫ p_D D⁺, the expected number of detections of targets; NaN from filters that do not
        compute it.
    sure : (K, 2) the labels of targets, ascending, that exist and of whose detection motion alone
        leaves no doubt, and the measurement that each has, −1 for none; from filters that use
        appearance.
    """

    mass_predicted: float
    mass_born: float
    mass: float
    evidence: F8
    clutter: F8
    clutter_probability: F8
    vanished: int = 0
    cardinality: F8 = field(default_factory=lambda: NO_NUMBERS)
    detected: float = math.nan
    sure: I8 = field(default_factory=lambda: NO_PAIRS)

    @classmethod
    def without_update(cls, mass: float) -> UpdateInfo:
        """The record of a frame that was predicted only, with this mass."""
        nothing = np.zeros(0)
        return cls(mass, 0.0, mass, nothing, nothing, nothing)

    @property
    def log_evidence(self) -> float:
        """Σ log(κ + C) − ∫ p_D D⁺, without terms of 0: for a PHD filter log p(Z) of the frame,
        except ∫ κ.
        """
        total = self.clutter + self.evidence
        return float(np.log(total[total > 0]).sum()) - self.detected


def false_alarm_share(clutter: F8, evidence: F8) -> F8:
    """(N,) κ/(κ + C), the posterior probability of a false alarm in the PHD update; 1 if κ + C = 0.

    Parameters
    ----------
    clutter, evidence : (N,) κ(z) and C(z), see `UpdateInfo`.
    """
    total = clutter + evidence
    return np.divide(clutter, total, out=np.ones_like(total), where=total > 0)


@dataclass(frozen=True, slots=True, eq=False)
class DividedDetections:
    """The detections that the filter gets in place of a frame's N: merged measurements divided,
    fragments united, and without those that show no possible state.

    Attributes
    ----------
    detections : the N′ detections that the filter gets, one for each target.
    source : (N′,) the detection that each rests on; several rest on a merged one.
    part : (N,) the first of the N′ that each detection went into, −1 for none.
    target : (N′,) the expected target that each belongs to, −1 for none.
    changed : False if these are the frame's detections as they were.
    """

    detections: Detections
    source: I8
    part: I8
    target: I8
    changed: bool = False

    @classmethod
    def unchanged(cls, detections: Detections) -> DividedDetections:
        """The detections as they were, assigned to no target."""
        same = np.arange(len(detections))
        return cls(detections, same, same, np.full(len(same), -1))

    def select(self, usable: Bool) -> DividedDetections:
        """The same without the detections that are not ``usable`` (N′,)."""
        number = np.where(usable, np.cumsum(usable) - 1, -1)
        return DividedDetections(
            self.detections.select(usable),
            self.source[usable],
            number[self.part],
            self.target[usable],
            changed=True,
        )

    def in_frame(self, info: UpdateInfo) -> UpdateInfo:
        """The record of an update with the N′ detections, in terms of the frame's N.

        A detection that several targets share is a false alarm of its first part, or the target
        that explains it best. One that went into none is a false alarm.
        """
        if not self.changed or len(info.evidence) != len(self.source):
            return info
        density = info.clutter + info.evidence
        false_alarms = self._first(info.clutter_probability * density)
        targets = self._largest((1 - info.clutter_probability) * density)
        return replace(
            info,
            evidence=self._largest(info.evidence),
            clutter=self._first(info.clutter),
            clutter_probability=false_alarm_share(false_alarms, targets),
        )

    def _first(self, values: F8) -> F8:
        """(N,) of ``values`` (N′,) that of the first part of each detection, 0 without any."""
        first: F8 = np.append(values, 0.0)[self.part]
        return first

    def _largest(self, values: F8) -> F8:
        """(N,) of ``values`` (N′,) the largest of the parts of each detection, 0 without any."""
        largest = self._first(values)
        np.maximum.at(largest, self.source, values)
        return largest


# The row of a state that is only predicted.
_NO_ROW: I8 = np.full(1, -1)


def row_of(row: I8, detection: I8) -> I8:
    """(n,) `Detections.row` of the detection that each state rests on, −1 for none.

    Parameters
    ----------
    row : (N,) that of each measurement.
    detection : (n,) the measurement of each state, −1 for none.
    """
    rows: I8 = np.concatenate((row, _NO_ROW))[detection]
    return rows


@state_record
class Estimates:
    """The states extracted from one frame's intensity, before they have identities.

    Attributes
    ----------
    state : (d, n) float64.      covariance : (n, d, d) float64.
    weight : (n,) mass of the intensity behind each state.
    xyxy : (n, 4) the box that each state predicts in the image, pixels.
    detection : (n,) column of the frame's measurements that each state rests on, −1 if it is only
        predicted; in a `Step` the `Detections.row` of it.
    tag : (n,) the label of the target that each state is of, its own for life, of filters that
        follow targets one by one; (0,) of others.
    past : the states of the frames before this one, oldest first, ending with the frame just
        before, as this frame sees them, None if that is as the frame before saw them: for
        filters that revise the past. Empty: the past stands. One frame's reaches no further back
        than the last one's did.
    appearance, appearance_count : (n, D) what the past of each target looks like, and of how many
        independent descriptors that is the mean, 0 where it is not known; (0, 0), (0,) without.
    followed : the labels of all targets that the filter still follows, however doubtful, where
        ``appearance`` is known.
    """

    state: F8
    covariance: F8
    weight: F8
    xyxy: F8
    detection: I8
    tag: I8 = field(default_factory=lambda: NO_INTEGERS)
    past: tuple[Estimates | None, ...] = ()
    appearance: F4 = field(default_factory=lambda: NO_DESCRIPTORS)
    appearance_count: F8 = field(default_factory=lambda: NO_NUMBERS)
    followed: I8 = field(default_factory=lambda: NO_INTEGERS)

    @classmethod
    def empty(cls, dim: int) -> Estimates:
        """No states of dimension ``dim``."""
        return cls(
            np.zeros((dim, 0)),
            np.zeros((0, dim, dim)),
            np.zeros(0),
            np.zeros((0, 4)),
            np.zeros(0, np.int64),
        )

    def __len__(self) -> int:
        return len(self.weight)

    def in_rows(self, row: I8) -> Estimates:
        """The states of the present with `Detections.row` for each detection; ``row`` (n,) is that
        of each measurement.
        """
        rows = row_of(row, self.detection)
        return Estimates(self.state, self.covariance, self.weight, self.xyxy, rows, self.tag)

    def select(self, index: I8 | Bool) -> Estimates:
        """The states at ``index`` (integers or a mask), in that order."""
        state = np.ascontiguousarray(self.state[:, index])
        tag = self.tag[index] if len(self.tag) else self.tag
        boxes = self.xyxy[index]
        found = self.detection[index]
        return Estimates(
            state, self.covariance[index], self.weight[index], boxes, found, tag, self.past
        )


class Return(NamedTuple):
    """An identity that was given back: of which label to which, with what odds, and when.

    ``ended``, ``began``: frame and `Detections.row` of the last detection before, and of the first
    one after.
    """

    earlier: int
    later: int
    identity: int
    odds: float
    time: float
    ended: tuple[int, int]
    began: tuple[int, int]


class Exchange(NamedTuple):
    """Two targets that had taken each other's identity, and have exchanged them again.

    ``labels``: of both. ``identities``: what they had until then. ``odds``: that it was so.
    ``frame``: the number of the first one in which each has its own again.
    """

    labels: tuple[int, int]
    identities: tuple[int, int]
    odds: float
    frame: int


@dataclass(frozen=True, slots=True, eq=False)
class MeasurementHistory:
    """The measurements of F frames end to end, which corrected tracks are smoothed with.

    Attributes
    ----------
    number, time : (F,) frame numbers, ascending, and times in the model's time units.
    start : (F + 1,) frame f has the columns start[f] … start[f + 1] − 1 of ``z``, ascending by
        ``row``.
    z : (m, Z) measurements.
    warp : (F, 3, 3) the camera's motion since the frame before; (0, 3, 3) if it stood still.
    row, class_id, score : (Z,) of the detections that were measured, see `Detections`; without
        them all detections of a frame were measured, and class and score are 0.
    embeddings : (Z, D) what each looks like, zeros where it is not known; (0, 0) without.
    pace : (F,) how fast the model's time ran before each frame, 1 as fast as the clock; without it
        it always did.
    """

    number: I8
    time: F8
    start: I8
    z: F8
    warp: F8
    row: I8 = field(default_factory=lambda: NO_INTEGERS)
    class_id: I8 = field(default_factory=lambda: NO_INTEGERS)
    score: F8 = field(default_factory=lambda: NO_NUMBERS)
    embeddings: F4 = field(default_factory=lambda: NO_DESCRIPTORS)
    pace: F8 = field(default_factory=lambda: NO_NUMBERS)

    def __post_init__(self) -> None:
        count = self.z.shape[1]
        if len(self.pace) != len(self.time):
            object.__setattr__(self, "pace", np.ones(len(self.time)))
        if len(self.row) != count:
            first = np.repeat(self.start[:-1], np.diff(self.start))
            object.__setattr__(self, "row", np.arange(count) - first)
        if len(self.score) != count:
            object.__setattr__(self, "class_id", np.zeros(count, np.int64))
            object.__setattr__(self, "score", np.zeros(count))

    def seconds(self, rate: float) -> F8:
        """(F,) the seconds of the frames by the clock, of the first one 0.

        Parameters
        ----------
        rate : of the model's time units a second of its time.
        """
        steps = np.diff(self.time, prepend=self.time[:1]) / (rate * self.pace)
        return np.cumsum(steps)

    def columns(self, tracks: Tracks) -> I8:
        """(M,) the column of the detection that each row of the tracks rests on, −1 for none."""
        span = 1 + max(self.row.max(initial=0), tracks.detection.max(initial=0))
        frame = np.repeat(np.arange(len(self.number)), np.diff(self.start))
        place = np.searchsorted(self.number, tracks.frame)
        column = np.searchsorted(frame * span + self.row, place * span + tracks.detection)
        return np.where(tracks.detection >= 0, column, -1)


def _column(values: Any, n: int, dtype: type[np.generic]) -> NDArray[Any]:
    """(n,) the ``values``, an array of as many or a number that stands for all."""
    if isinstance(values, np.ndarray):
        return np.asarray(values, dtype)
    return np.full(n, values, dtype)


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Rows of tracks, of one frame (online) or of a whole sequence (offline, sorted by frame, then
    identity).

    `save` writes them to a file, `load` reads them from one. `phdtrack.export_tracks` and
    `phdtrack.read_tracks` do the same with more options.

    Attributes
    ----------
    frame, identity : (M,) int64 from 1.
    xyxy : (M, 4) float64, pixels.
    confidence : (M,) float64 in [0, 1], the probability that the object exists, by all that the
        tracker knows of it; the detector's score of a row is that of its ``detection``.
    detection : (M,) `Detections.row` of the detection that the row rests on: its index among the
        detections of that frame as the caller gave them; −1: predicted or bridged.
    confirmed : (M,) bool; False for rows given before the track was long enough to be confirmed.
    class_id : (M,) int64; 0 if no classes are known.
    data : by name, what `Tracker.update` got as ``data`` of each row's detection: arrays (M, …). A
        row that no detection supports (`predicted`) has an empty entry: zeros, False, an empty
        text, or None among Python objects. Corrected tracks have none.
    """

    frame: I8
    identity: I8
    xyxy: F8
    confidence: F8
    detection: I8
    confirmed: Bool
    class_id: I8 = field(default_factory=lambda: NO_INTEGERS)
    data: Columns = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not len(self.class_id):
            object.__setattr__(self, "class_id", np.zeros(len(self.frame), np.int64))

    def __repr__(self) -> str:
        """A line about the rows: arrays of thousands of them tell nothing."""
        rows = f"Tracks: {len(self.frame)} rows"
        if not len(self.frame):
            return f"<{rows}>"
        count = len(np.unique(self.identity))
        return f"<{rows}, {count} identities, frames {self.frame.min()} to {self.frame.max()}>"

    @classmethod
    def empty(cls) -> Tracks:
        """No rows."""
        none = np.zeros(0, np.int64)
        return cls(none, none, np.zeros((0, 4)), np.zeros(0), none, np.zeros(0, np.bool_))

    @classmethod
    def of(
        cls,
        frame: Ints,
        identity: Ints,
        xyxy: F8,
        confidence: F8 | float,
        detection: Ints,
        confirmed: Bool | bool = True,
    ) -> Tracks:
        """Rows in the order of ``xyxy``; of the other columns a number stands for all.

        Parameters
        ----------
        frame, identity, detection : (M,) as above, or one for all.
        xyxy : (M, 4) pixels.
        confidence : (M,) or one for all; more than 1 counts as 1.
        confirmed : (M,) as above, or one for all.
        """
        n = len(xyxy)
        return cls(
            _column(frame, n, np.int64),
            _column(identity, n, np.int64),
            xyxy,
            np.minimum(1.0, _column(confidence, n, np.float64)),
            _column(detection, n, np.int64),
            _column(confirmed, n, np.bool_),
        )

    @classmethod
    def concatenate(cls, parts: list[Tracks]) -> Tracks:
        """All rows, sorted by frame, then identity.

        Parameters
        ----------
        parts : rows of any frames, none twice.
        """
        parts = parts or [cls.empty()]
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS
        }
        columns["data"] = stacked([part.data for part in parts], [len(part) for part in parts])
        order = np.lexsort((columns["identity"], columns["frame"]))
        return cls(**columns).select(order)

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, index: I8 | Bool) -> Tracks:
        """The rows at ``index`` (integers or a mask), in that order.

        Parameters
        ----------
        index : (K,) integers, or (M,) a mask.
        """
        columns: dict[str, Any] = {name: getattr(self, name)[index] for name in _COLUMNS}
        return Tracks(**columns, data={name: each[index] for name, each in self.data.items()})

    def __getitem__(self, index: int | slice | I8 | Bool) -> Tracks:
        """The rows at ``index``: one, a slice, integers or a mask, in that order."""
        return self.select(np.atleast_1d(np.arange(len(self))[index]))

    def with_class(self, class_id: I8) -> Tracks:
        """The same rows, of the classes (M,)."""
        return Tracks(
            self.frame,
            self.identity,
            self.xyxy,
            self.confidence,
            self.detection,
            self.confirmed,
            class_id,
            self.data,
        )

    def with_boxes(self, xyxy: F8) -> Tracks:
        """The same rows with other boxes (M, 4)."""
        return Tracks(
            self.frame,
            self.identity,
            xyxy,
            self.confidence,
            self.detection,
            self.confirmed,
            self.class_id,
            self.data,
        )

    def save(
        self, path: str | PathLike[str], kind: str = "", names: Mapping[int, str] | None = None
    ) -> None:
        """Write the rows to a file in the format of its suffix; replaces an existing file.

        ``.csv``, ``.parquet``, ``.jsonl``, ``.json`` (COCO), ``.xml`` (CVAT) or ``.txt``
        (MOTChallenge); `phdtrack.export_tracks` describes them. ``data`` is not saved. Raises
        `InputError` for an unknown suffix or format, and for a file that cannot be written.

        Parameters
        ----------
        path : the file; boxes in pixels, frames from 1 except in KITTI and CVAT.
        kind : the format, for one that no suffix stands for, as kitti.
        names : the names of the classes by number; None: their numbers are written.
        """
        import_module(_FILES).export_tracks(path, self, kind, names)

    @classmethod
    def load(cls, path: str | PathLike[str], first_frame: int | None = None) -> Tracks:
        """The rows of a file of tracks, sorted by frame, then identity.

        All formats that `save` writes, and those of other trackers: `phdtrack.read_tracks`
        describes them. Raises `InputError` if the file is missing or malformed; the message names
        the line.

        Parameters
        ----------
        path : the file. The content decides the format, not the suffix.
        first_frame : the number that the file gives the first frame; None: as usual in its format.
        """
        loaded: Tracks = import_module(_FILES).read_tracks(path, first_frame=first_frame)
        return loaded

    def to_dataframe(self) -> Any:
        """A pandas DataFrame, a row each, with left, top, right, bottom for boxes, and `data`.
        `InputError` without pandas.
        """
        boxes = dict(zip(("left", "top", "right", "bottom"), self.xyxy.T, strict=True))
        own = {name: getattr(self, name) for name in _COLUMNS if name != "xyxy"} | boxes
        given = {name: list(column) for name, column in self.data.items() if name not in own}
        return needed("pandas").DataFrame(own | given)

    def to_supervision(self) -> Any:
        """supervision's Detections: identities are ``tracker_id``, ``mask`` of `data` is the mask,
        the rest ``data``. `InputError` without supervision.
        """
        data = {name: column for name, column in self.data.items() if name != "mask"}
        data |= {name: getattr(self, name) for name in ("frame", "detection", "confirmed")}
        known = {
            "confidence": self.confidence,
            "class_id": self.class_id,
            "tracker_id": self.identity,
        }
        if "mask" in self.data:
            known["mask"] = self.data["mask"].astype(np.bool_)
        return needed("supervision").Detections(self.xyxy.astype(np.float32), data=data, **known)

    @property
    def predicted(self) -> Bool:
        """(M,) True where no detection supports the row."""
        return self.detection < 0

    def __iter__(self) -> Iterator[tuple[int, F8]]:
        """Pairs (identity, xyxy) in row order."""
        return ((int(i), box) for i, box in zip(self.identity, self.xyxy, strict=True))


# The package that reads and writes files. It imports this module, so this one loads it by name when
# a file is read or written.
_FILES = "phdtrack.formats"
# The arrays of rows, in order.
_COLUMNS = tuple(name for name in Tracks.__slots__ if name != "data")


class Appeared(NamedTuple):
    """The looks of the measurements and the targets of a frame, as a pipeline sees them.

    ``looks``: of the measurements, and what similarity says. ``estimates``: the targets, each with
    its measurement. ``sure``: see `UpdateInfo.sure`.
    """

    looks: Looks
    estimates: Estimates
    sure: I8


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """Everything that one frame brought: what a pipeline yields and what sinks and reports read.

    ``tracks`` are the online rows that became final with this frame: with an output delay they
    belong to an earlier one. ``seconds`` (filter, extract, associate) is the time each stage took.
    ``unusable`` counts the detections that tell nothing of any state, as one whose foot is above
    the horizon: no row rests on them. ``warp`` (3, 3) is the camera's motion since the frame
    before, observed or not; `STILL` for none. ``appeared`` is what targets and detections look
    like, one of each pipeline that knows it.
    """

    number: int
    time: float
    detections: Detections
    info: UpdateInfo
    estimates: Estimates
    tracks: Tracks
    seconds: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))
    unusable: int = 0
    warp: F8 = field(default_factory=lambda: STILL)
    appeared: tuple[Appeared, ...] = ()
