"""One protocol for each symbol of the papers and each stage of the pipeline. The pipeline knows
these and nothing else.

A model is a value of four parts: motion f, p_S; sensor g, p_D; birth γ; clutter κ. Filters,
extractors, associators and smoothers are frozen settings with pure methods: state goes in, state
comes out. A model answers with arrays for all targets at once.

Shapes: states x are (d, L), measurements z are (m, N); both are columns, so that each component is
contiguous. Functions of (z, x) work elementwise and broadcast over everything behind the first
axis: ``z[:, pair_z], x[:, pair_x]`` gives one value per pair, ``z[:, :, None], x[:, None, :]`` the
dense table. ``dt`` is in the model's time unit. What goes in and out of a method is described here,
in its docstring or in that of the class; what implements it says only what is its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from phdtrack.kernels.appearance import Looks
from phdtrack.kernels.gaussian import Births
from phdtrack.kernels.particle_models import SensorNumbers
from phdtrack.types import (
    F8,
    I8,
    STILL,
    Appeared,
    Detections,
    DividedDetections,
    Estimates,
    Exchange,
    MeasurementHistory,
    Particles,
    Return,
    Step,
    Tracks,
    UpdateInfo,
)


class Motion(Protocol):
    """f(x|ξ) and p_S: how targets move and survive.

    Parameters
    ----------
    x : (d, L) states.
    dt : interval in the model's time unit.
    seconds : the same interval in seconds.
    warp : (3, 3) homography from the pixels of the frame before to those of this one.
    """

    @property
    def dim(self) -> int:
        """Number d of state components."""

    @property
    def survival_probability(self) -> float:
        """Probability p_S that a target is still there after one second, wherever it is."""

    def particle_model(self, dt: float, seconds: float) -> Any:
        """The numbers of f over ``dt`` and p_S over ``seconds``: a record of
        `kernels.particle_models`.
        """

    def p_survive(self, x: F8, seconds: float) -> F8:
        """(L,) probability that a target at ``x`` is still there after so many seconds."""

    def transition(self, x: F8, dt: float) -> tuple[F8, F8, F8]:
        """Mean (d, n), Jacobian F (n, d, d) and noise covariance Q (n, d, d) of f(·|x) for the
        columns of ``x`` (d, n).
        """

    def warp_states(self, x: F8, warp: F8) -> F8:
        """(d, L) the states ``x`` (d, L) in the pixels of the next frame; ``warp`` (3, 3) is the
        homography to it.

        Raises `InputError` if states do not lie in the image.
        """

    def warp_jacobian(self, x: F8, warp: F8) -> F8:
        """(L, d, d) Jacobians of `warp_states`."""


class Sensor(Protocol):
    """g(z|x) and p_D: what is measured of a target, and how often it is detected.

    Parameters
    ----------
    x, targets : (d, L) or (d, n) states.
    z : (m, N) measurements, pixels or metres.
    detections : of a frame, boxes in pixels.
    predicted : (r, …) measurements without noise.
    """

    @property
    def observed(self) -> tuple[int, ...]:
        """The rows of the state that a measurement shows; of a linear sensor in the order of its
        first components.
        """

    @property
    def linear(self) -> bool:
        """True if `predicted_measurements` is the ``observed`` rows of the state. Of others
        Gaussians need sigma points.
        """

    def measure(self, detections: Detections) -> F8:
        """(m, N) the measurement vectors of the detections; a column of NaN for one that shows no
        possible state.
        """

    def predicted_measurements(self, x: F8) -> F8:
        """(r, L) the first components of z that targets at ``x`` (d, L) give, noise aside; of a
        linear sensor rows of x.
        """

    def innovation(self, z: F8, predicted: F8) -> F8:
        """(r, …) differences of measurements from predicted ones, z − ``predicted``, elementwise;
        angles the short way round.

        Of the rows of ``z`` the first r count: it may be a predicted measurement, too.
        """

    def covariance(self, z: F8, x: F8) -> F8:
        """(P, r, r) noise covariance R of what `predicted_measurements` gives, for pairs of columns
        of ``z`` (m, P) and ``x`` (d, P).

        With `innovation` it is the Gaussian view of g: d² = εᵀR⁻¹ε. It is the sum of `target_noise`
        and `measurement_noise`.
        """

    @property
    def angles(self) -> tuple[bool, ...]:
        """(r,) which components of `predicted_measurements` are angles in radians, compared the
        short way round.
        """

    def target_noise(self, x: F8) -> F8:
        """(L, r, r) part of R that belongs to targets at ``x`` (d, L); (0, r, r) where none
        does.
        """

    def measurement_noise(self, z: F8) -> F8:
        """(N, r, r) part of R that belongs to the measurements ``z`` (m, N); (0, r, r) where none
        does.
        """

    def p_detect(self, x: F8) -> F8:
        """(L,) detection probability of targets at ``x`` (d, L)."""

    @property
    def occlusion(self) -> bool:
        """True if p_D falls for targets that others hide: then `watching` is called."""

    def watching(self, targets: F8) -> Sensor:
        """The sensor while targets are expected at these states (d, n), of which the nearer hide
        those behind them.
        """

    def particle_model(self, z: F8) -> SensorNumbers:
        """The numbers of g and p_D, and a column for each measurement of ``z`` (m, N), for
        `kernels.particle_models`.
        """

    def gate(self, z: F8) -> tuple[F8, F8]:
        """Rectangles in the position plane outside which g(z|·) is negligible: lower and upper
        corners, each (2, N).
        """

    def states(self, z: F8) -> tuple[F8, F8]:
        """States at rest (d, N) that would give ``z``, and their covariance (N, d, d) when z is all
        that is known.
        """

    def noise(self, x: F8) -> F8:
        """(d, n) standard deviations by which state components at ``x`` are resolved: the scale for
        distances.
        """

    def boxes(self, x: F8) -> F8:
        """(n, 4) the xyxy box that each state predicts in the image."""


class Birth(Protocol):
    """γ(x): where and how often new targets appear, and how newborn particles are drawn.

    Parameters
    ----------
    z, covered : (m, N) measurements, and (N,) the mass predicted at each.
    sensor, seconds, rng : that gave them; the interval T; of the draws.
    """

    def sample(
        self, z: F8, covered: F8, sensor: Sensor, seconds: float, rng: np.random.Generator
    ) -> Particles:
        """Newborn particles of total mass ∫γT."""

    def gaussians(self, z: F8, sensor: Sensor, seconds: float) -> Births:
        """γT around each measurement, and as Gaussians. Raises `InputError` if γ has no such
        form.
        """

    def expected_count(self, z: F8, seconds: float) -> float:
        """∫γT over everything: the expected number of births, those that no measurement of ``z``
        (m, N) shows included.
        """


class Clutter(Protocol):
    """κ(z): where and how often the detector reports what is not a target.

    Parameters
    ----------
    z : (m, N) measurements.
    """

    def intensity(self, z: F8) -> F8:
        """(N,) expected clutter points per frame and unit of measurement volume at ``z`` (m, N)."""


@dataclass(frozen=True, slots=True)
class Model:
    """The four parts of a model of the world, and ``rate``: its time units per second.

    The papers state their noises per frame at 25 Hz; with ``rate`` 25 a frame of such a video has
    dt = 1, one of a 7 Hz video dt = 25/7, and a gap of three frames three times as much. ``first``
    is the interval before the first frame, in time units: what happens in it is predicted and born
    then.

    ``warp`` (3, 3) is how the camera has moved since the last observed frame: the homography that
    takes pixels of that frame to this one's; `types.STILL` where it stands still. States are warped
    before they are predicted.

    ``pace`` is how fast the filter's time runs: at 1 as the clock, at 0.2 a fifth as fast
    (`Stages.longest_interval`). Births go by the clock. ``births_before``: the seconds
    before this frame whose births count at least.

    ``appearance``: what the measurements of the frame look like, and what that is worth; None where
    nothing is known.

    Attributes
    ----------
    motion, sensor, birth, clutter : the four parts.
    """

    motion: Motion
    sensor: Sensor
    birth: Birth
    clutter: Clutter
    rate: float = 25.0
    first: float = 1.0
    warp: F8 = field(default_factory=lambda: STILL, compare=False)
    pace: float = 1.0
    births_before: float = 0.0
    appearance: Looks | None = field(default=None, compare=False)

    def with_clutter(self, clutter: Clutter) -> Model:
        """The same model with other clutter.

        Parameters
        ----------
        clutter : κ(z).
        """
        return self._of_frame(clutter, self.warp, self.appearance)

    def with_warp(self, warp: F8) -> Model:
        """The same model after another motion of the camera.

        Parameters
        ----------
        warp : (3, 3), or `types.STILL`.
        """
        return self._of_frame(self.clutter, warp, self.appearance)

    def with_appearance(self, appearance: Looks | None) -> Model:
        """The same model with what the measurements of another frame look like.

        Parameters
        ----------
        appearance : `Model.appearance`.
        """
        return self._of_frame(self.clutter, self.warp, appearance)

    def _of_frame(self, clutter: Clutter, warp: F8, appearance: Looks | None) -> Model:
        """The same model with what may differ in each frame; `dataclasses.replace` takes several
        times as long.
        """
        return Model(
            self.motion,
            self.sensor,
            self.birth,
            clutter,
            self.rate,
            self.first,
            warp,
            self.pace,
            self.births_before,
            appearance,
        )

    def birth_seconds(self, dt: float) -> float:
        """Seconds whose births are still there after ``dt``: ∫ p_S(t) dt, with p_S = 1 in the last
        second.

        Parameters
        ----------
        dt : interval in the model's time unit.
        """
        seconds = max(dt / (self.rate * self.pace), self.births_before)
        if seconds <= 1.0:
            return seconds
        leaving = self._leaving
        return 1.0 + (math.exp(-leaving) - math.exp(-leaving * seconds)) / leaving

    def survival(self, dt: float) -> float:
        """The probability that a target is still there after ``dt`` by the clock.

        Parameters
        ----------
        dt : interval in the model's time unit.
        """
        return math.exp(-self._leaving * dt / (self.rate * self.pace))

    @property
    def _leaving(self) -> float:
        """How many times a second a target leaves."""
        return max(-math.log(max(self.motion.survival_probability, 1e-300)), 1 / LONGEST_LIFE)

    def warp_states(self, x: F8) -> F8:
        """(d, L) states of the frame before, in the pixels of this one.

        Parameters
        ----------
        x : (d, L) states.
        """
        if len(self.warp):
            return self.motion.warp_states(x, self.warp)
        return x

    def warp_gaussians(self, mean: F8, covariance: F8) -> tuple[F8, F8]:
        """Gaussians (d, L), (L, d, d) of the frame before, in the pixels of this one: to first
        order, J P Jᵀ.

        Parameters
        ----------
        mean, covariance : (d, L) and (L, d, d) of each Gaussian.
        """
        if len(self.warp) == 0:
            return mean, covariance
        slope = self.motion.warp_jacobian(mean, self.warp)
        return self.motion.warp_states(mean, self.warp), slope @ covariance @ slope.transpose(
            0, 2, 1
        )


S = TypeVar("S")
# Mean seconds that a target stays at most, when births of a long gap are counted.
LONGEST_LIFE = 600.0


class Filter(Protocol[S]):
    """The recursion of a filter: predict, update, reduce (resample, or prune and merge).

    Parameters
    ----------
    state : after the frame before; of `update` the predicted one.
    z : (m, N) measurements.
    model : of the present frame; where the camera has moved (`Model.warp`), states are carried into
        its pixels first.
    dt : interval since the frame before, in the model's time unit.
    rng : the filter's randomness.
    """

    def start(self, model: Model, rng: np.random.Generator) -> S:
        """The state before the first frame."""

    def predict(self, state: S, model: Model, dt: float, rng: np.random.Generator) -> S:
        """The predicted state, ``dt`` later, without births: these are made in the update, from its
        measurements.
        """

    def update(
        self, state: S, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[S, UpdateInfo]:
        """The state after the births of the interval and the measurements."""

    def reduce(self, state: S, rng: np.random.Generator) -> S:
        """The same density with fewer particles or components: unless the filter has another form,
        as it is.
        """
        return state

    def step(
        self, state: S, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[S, UpdateInfo]:
        """Predict, update and reduce, for a frame that was observed: their composition, or a faster
        form of it.
        """
        updated, info = self.update(self.predict(state, model, dt, rng), z, model, dt, rng)
        return self.reduce(updated, rng), info


S_contra = TypeVar("S_contra", contravariant=True)


class Extractor(Protocol[S_contra]):
    """From a filter's state to the states of targets."""

    def extract(self, state: S_contra, z: F8, model: Model) -> Estimates:
        """The estimated states; the detection that each rests on is a column of ``z``.

        Parameters
        ----------
        state, z, model : the filter's state, the (m, N) measurements and the model of the frame.
        """


A = TypeVar("A")
C = TypeVar("C")


class Associator(Protocol[A]):
    """From states to identities.

    Parameters
    ----------
    state : after the last frame.
    model : of that frame.
    """

    def start(self) -> A:
        """The state before the first frame."""

    def extend(
        self,
        state: A,
        estimates: Estimates,
        z: F8,
        detections: Detections,
        number: int,
        dt: float,
        model: Model,
    ) -> tuple[A, Tracks]:
        """The state with those of frame ``number``, and the online rows that are now final.

        If the detections are not observed, the estimates are predicted from the last observed
        frame: they continue tracks in this frame's rows, and change nothing that follows.

        Parameters
        ----------
        state, dt : of the frame before, and the model time since the last observed frame.
        estimates, number : the extracted states and the frame number.
        z, detections : the (m, N) measurements, and what was measured; rows of tracks name a
            detection by its ``row``.
        model : of this frame; states of earlier frames are warped if the camera has moved
            (`Model.warp`).
        """

    def flush(self, state: A, model: Model) -> Tracks:
        """The online rows still held back by the output delay; the sequence has ended."""

    def finish(self, state: A, model: Model) -> Tracks:
        """The corrected, bridged and cleaned tracks of everything taken in so far."""

    def measurements(self, state: A) -> MeasurementHistory:
        """The measurements of everything that is remembered, with every frame of the corrected
        tracks.
        """

    def returns(self, state: A) -> tuple[Return, ...]:
        """The identities that targets have taken again, oldest first."""
        return ()

    def exchanges(self, state: A) -> tuple[Exchange, ...]:
        """The identities that targets have exchanged, oldest first."""
        return ()

    def appeared(self, state: A, seen: Appeared) -> Appeared:
        """The looks of the newest frame's targets, and which of these motion leaves no doubt of: as
        the filter has them, or by links where it has no labels.

        Parameters
        ----------
        state, seen : after the frame, and as the filter has it.
        """
        return seen

    def oldest(self, state: A) -> int:
        """The number of the first frame that is remembered, 0 before the first one."""

    def numbered_after(self, state: A, identity: int) -> A:
        """The state that numbers new online tracks from ``identity`` + 1 on; all that it has
        numbered are lower.
        """


class Smoother(Protocol):
    """From corrected tracks to smoothed ones, when everything is known."""

    def smooth(self, tracks: Tracks, measurements: MeasurementHistory, model: Model) -> Tracks:
        """The tracks joined and smoothed, with identities from 1 in order of appearance.

        Parameters
        ----------
        tracks, measurements, model : corrected tracks, what their rows rest on, and the model of
            the last frame.
        """


class Explainer(Protocol[C]):
    """The merged-measurement model: which detections are of several targets, or pieces of one.

    Parameters
    ----------
    state : after the frame before; for `advance` the one that `explain` gave.
    divided : the detections of this frame that `explain` gave.
    detections, z : of the frame, and their (m, N) measurements.
    model, dt : of the frame, and the interval since the one before in the model's time unit.
    estimates : the states, each of which rests on one of the divided detections.
    """

    def start(self) -> C:
        """The state before the first frame."""

    def explain(
        self, state: C, detections: Detections, z: F8, model: Model, dt: float
    ) -> tuple[C, DividedDetections]:
        """The state for `advance`, and the detections that the filter is to be given of a frame."""

    def advance(
        self, state: C, divided: DividedDetections, estimates: Estimates, model: Model, dt: float
    ) -> C:
        """The state after a frame, with the filter's estimates."""


class CameraEstimator(Protocol[C]):
    """Estimates the camera's motion from the detections of a frame.

    Parameters
    ----------
    state : of `with_targets`: the one that `between` gave.
    estimates : states of targets, in this frame's pixels.
    """

    def start(self) -> C:
        """The state before the first frame."""

    def between(self, state: C, z: F8, model: Model, dt: float, given: F8) -> tuple[C, F8]:
        """The state for `with_targets`, and the homography since the last frame; `types.STILL`
        if the camera stands still.

        Parameters
        ----------
        state : after the frame before.
        z, model, dt : of the frame its (m, N) measurements, and the interval in the model's time
            unit.
        given : (3, 3) the motion that was given from outside; `types.STILL` if none was.
        """

    def with_targets(self, state: C, estimates: Estimates) -> C:
        """The state with the targets of this frame, which those of the next are compared with."""


class Learning(Protocol[C]):
    """Learning while tracking.

    Parameters
    ----------
    state : what was learned up to the frame before.
    model : of this frame.
    step : everything that the frame brought.
    """

    def start(self) -> C:
        """The state before the first frame."""

    def model(self, state: C, model: Model) -> Model:
        """``model`` with what was learned so far; as it is where only scores are learned."""
        return model

    def with_scores(self, state: C, model: Model, detections: Detections) -> Model:
        """A model with what the scores of a frame's detections say; the same where they are not
        learned.

        Parameters
        ----------
        state, model, detections : what was learned, the model as `model` gave it, and the frame's
            detections.
        """
        return model

    def advance(self, state: C, step: Step) -> C:
        """Take in what one frame brought."""


class AppearanceModel(Protocol[C]):
    """The worth of what boxes look like, learned while tracking.

    Parameters
    ----------
    state : what was learned up to the frame before.
    """

    def start(self) -> C:
        """The state before the first frame."""

    def looks(self, state: C, detections: Detections, time: float) -> tuple[C, Looks | None]:
        """The state for `advance`, and what a frame looks like; None where nothing is known.

        Parameters
        ----------
        state, detections, time : after the frame before; of the frame; seconds.
        """

    def known(self, state: C) -> Looks | None:
        """The law that was learned so far, with no detections; None where nothing was."""

    def advance(self, state: C, sure: I8, looks: Looks | None) -> C:
        """The state after a frame.

        Parameters
        ----------
        state, looks : from `looks`.
        sure : (K, 2) of `UpdateInfo.sure`.
        """


class OnlineBoxes(Protocol):
    """From online rows to the boxes that are shown.

    Parameters
    ----------
    state : after the last frame.
    tracks : online rows, boxes in pixels.
    """

    def start(self) -> Any:
        """The state before the first frame."""

    def advance(
        self,
        state: Any,
        tracks: Tracks,
        detections: Detections,
        number: int,
        time: float,
        oldest: int,
    ) -> tuple[Any, Tracks]:
        """The state after the frame, and the rows with the boxes that are shown.

        Parameters
        ----------
        state : after the frame before.
        tracks, detections : online rows, of this frame or with an output delay of earlier ones;
            detections of this frame.
        number, time : of this frame; seconds.
        oldest : number of the first frame of which rows may still come.
        """

    def shown(self, state: Any, tracks: Tracks) -> tuple[Any, Tracks]:
        """The state after rows that were held back, and the rows."""


@dataclass(frozen=True, slots=True)
class Stages(Generic[S, A]):
    """The parts of one tracker; None for what is not done.

    Attributes
    ----------
    model : of the world.
    filter, extractor, associator : from measurements to states, to estimates of targets, to
        identities.
    detection_scores : what scores say, learned while tracking.
    explainer : the merged-measurement model.
    smoother : of corrected tracks.      online : boxes of online rows.
    camera : what finds the camera's motion in the detections.
    appearance : what boxes look like, as evidence.
    longest_interval : seconds between pictures up to which targets move as in videos; 0: however
        long it is.
    births_before : seconds before the first frame whose births are expected in it.
    """

    model: Model
    filter: Filter[S]
    extractor: Extractor[S]
    associator: Associator[A]
    detection_scores: Learning[Any] | None = None
    explainer: Explainer[Any] | None = None
    smoother: Smoother | None = None
    online: OnlineBoxes | None = None
    camera: CameraEstimator[Any] | None = None
    appearance: AppearanceModel[Any] | None = None
    longest_interval: float = 0.2
    births_before: float = 0.0


AnyStages = Stages[Any, Any]
