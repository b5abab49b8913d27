"""The Poisson multi-Bernoulli filter with hypotheses about each target: labels and existence inside
the recursion [W15].

Equations: docs/methods.md, Poisson multi-Bernoulli. Docstrings have their numbers as tags, PMB and
the number; most are in `kernels.pmb`. The result is the product of Bernoulli densities that is
nearest to the posterior [W15], but the hypotheses of a target are kept with their pasts instead of
being replaced by their mean. So targets that cannot be separated for some frames are not blurred,
and the past is read from the hypothesis that wins.

Three things that a constant p_D does not say about detectors are hidden states of a hypothesis.

*Occlusion*: misses come in rows. A visible target is detected with the sensor's p_D, an occluded
one never. It changes at rates 1/``mean_visible_time`` and 1/``mean_occluded_time``, a Markov chain
in continuous time that is visible at a first detection. Targets that were never detected may have
been occluded ever since [PMB (18)].

*Static clutter*: some false alarms come again and again in one place. A first detection is static
clutter with probability ``static_clutter_prior``. It stays where it is, which is never known
exactly, and is detected with probability ``static_clutter_detection_probability`` in each frame.
Some targets stand still, too, and are detected as often as other targets. A hypothesis that stands
still is a target with a probability that detections raise and misses lower, [PMB (12)] and [PMB
(13)]; a target may begin to move at any time, [PMB (11)]. What moves, or is detected in most
frames, is soon known to be a target. Static clutter competes for measurements like targets do and
is never reported.

*Lasting clutter*: what a detector takes for a target again and again moves and is detected like
one. Only its scores give it away. With the odds of a score s against lasting false alarms, l(s) =
p(s|target)/p(s|lasting), and against those of a single frame, o(s), a hypothesis that is genuine
with probability ρ has the likelihood q(z)(ρ o(s) + 1 − ρ), and

    log ρ/(1 − ρ) ← log ρ₀/(1 − ρ₀) + k (log ρ/(1 − ρ) − log ρ₀/(1 − ρ₀)) + log l(s)

with ρ₀ = 1 − ``lasting_clutter_prior``; k forgets what scores have said, because those of one
target are alike, and change when it comes nearer. What high scores have once raised far above the
prior is genuine for good: low scores say then that it is partly hidden. Until then each miss says
that it flickers as such clutter does [PMB (21)]. Targets are present as far as they are genuine.

Four things that a model cannot know about every stream and target are found, where the settings ask
for them.

*How often targets are detected.* What moves and is not occluded is counted: how often it was
detected, and how often the sensor's p_D expects it. p_D is lowered, never raised, by the ratio of
the odds [PMB (14)].

*How fast it is.* With a small probability the velocity of a target is new, of any direction and
eight times as wide as usual [PMB (15)]. This hypothesis is added for targets that no measurement is
near, if one in reach is near no target.

*How noisy it is.* All variances of a hypothesis, of its motion and of its measurements, are c times
the model's. What is known of 1/c is what n observations of a variance tell, a gamma distribution.
Innovations then follow Student's t, whose tails keep a target that jumps [WH97 §10.8]. Every
detection adds two observations, of the centre and of the size apart:

    q(z) = |2πS|^(−½) c^(−1) (1 + d²/(nc))^(−n/2 − 1),   c ← (nc + d²)/(n + 2),   n ← n + 2

for each two components, S and d² by the model's noises. Between frames what is known fades towards
the model's noises, which count for n₀ observations: n ← kn + (1 − k)n₀. A new target has n₀ and c =
1. States and gains do not depend on c, covariances are c times as large.

*How agile it is.* A new target has a hypothesis for each factor of the acceleration, all equally
probable; the innovations decide between them. A bank of filters, each with its motion for good [B01
§11.6].

For boxes at constant velocity whose appearance is not known, `kernels.pmb_boxes` does a step in one
call, with the same result. Otherwise the filter knows a model by the arrays that it answers
(`models.gaussian`); `kernels.pmb` computes with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from phdtrack.arrays import chi2_quantile
from phdtrack.errors import (
    Checked,
    InputError,
    NonNegative,
    Positive,
    PositiveCount,
    Probability,
    Share,
)
from phdtrack.filters.undetected import recycled, still_undetected, survived, with_births
from phdtrack.kernels import Records
from phdtrack.kernels.appearance import NO_PASTS, Looks, Pasts, plain
from phdtrack.kernels.box import apart
from phdtrack.kernels.gaussian import Births, Measurements, NewTargets
from phdtrack.kernels.jumps import Jumps
from phdtrack.kernels.pmb import (
    CERTAIN,
    HYPOTHESIS,
    TARGET,
    TINY,
    Layer,
    Scores,
    Settings,
    predicted_layer,
    updated_layer,
)
from phdtrack.kernels.pmb_boxes import stepped_boxes
from phdtrack.kernels.pmb_past import (
    Columns,
    best_trace,
    earlier,
    first_earlier,
    looks_of_targets,
    of_targets,
    present_targets,
    reported_boxes,
    reported_frames,
    scaled,
)
from phdtrack.models.births import MeasurementBirth
from phdtrack.models.box import BoxMotion, BoxSensor
from phdtrack.models.clutter import BoxClutter, ScoredClutter
from phdtrack.models.gaussian import (
    SAME,
    Transform,
    carried,
    measurements,
    moved,
    new_targets,
    predicted_measurements,
)
from phdtrack.models.pasts import carried as carried_pasts
from phdtrack.models.volumes import LOCAL_FACTOR
from phdtrack.protocols import Clutter, Filter, Model
from phdtrack.types import (
    F8,
    I8,
    NO_NUMBERS,
    Estimates,
    GaussianMixture,
    UpdateInfo,
    state_record,
)

# The probability that a target stands still when it is first detected, and the seconds for which,
# on average, it then does.
STANDING = 0.05
MEAN_STANDING_TIME = 2.0
# The probability that a new target is fast, and how many times as wide as usual its velocity is.
FAST_SHARE = 0.1
FAST_SPEED = 8.0
NO_SPEED = np.zeros((0, 2))
# Chances to be detected that the sensor's p_D counts for, and the limits of the p_D learned.
PRIOR_CHANCES = 30.0
LEAST_DETECTION = 0.2
MOST_DETECTION = 0.97
# Frames after which what a score has said of lasting clutter counts for 37 %.
SCORE_MEMORY = 15.0
SCORE_KEPT = math.exp(-1 / SCORE_MEMORY)
# The share of false alarms that are new in each frame, if no stream has shown it.
ANEW = 0.2
# No targets seen for the first time that are given, and no density of boxes that is local.
NOBODY_NEW = (np.zeros(0), np.zeros((0, 6)), np.zeros((0, 6, 6)))
NOWHERE = (0.0, 0.0, 0.0, 0.0)


@lru_cache(maxsize=64)
def _changes(visible: float, occluded: float, seconds: float) -> tuple[float, float]:
    """Probabilities to be occluded ``seconds`` after being visible, and visible after being
    occluded, if targets are visible and occluded for so many seconds on average; 0: for ever.
    """
    if visible == 0:
        return 0.0, 1.0
    rate = 1 / visible + 1 / occluded
    changed = -math.expm1(-rate * seconds) / rate
    return changed / visible, changed / occluded


@lru_cache(maxsize=8)
def _squares(factors: tuple[float, ...]) -> F8:
    """The squares of the factors, as an array."""
    return np.square(factors)


@state_record
class Bernoullis:
    """The state of a Poisson multi-Bernoulli filter.

    Attributes
    ----------
    layers : the targets of the last frames, oldest first.
    ended : (E, 2) frame and hypothesis there of targets that were once confirmed and have been
        deleted since.
    next_label : the label of the next new target.
    undetected : intensity of targets that have never been detected, where births are a mixture
        (`filters.undetected`).
    frame : number of the last layer: how many frames have been predicted.
    detections : how many detections of targets there were, of how many chances, and how many the
        sensor's p_D expected; old ones are forgotten.
    hidden : seconds whose births have been occluded ever since, where γ is a density.
    pasts : what the hypotheses of the last layer have seen of their targets.
    """

    layers: tuple[Layer, ...]
    ended: I8
    next_label: int
    undetected: GaussianMixture
    frame: int = 0
    detections: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hidden: float = 0.0
    pasts: Pasts = NO_PASTS

    def __len__(self) -> int:
        """Number of hypotheses."""
        return len(self.present.hypotheses)

    @property
    def present(self) -> Layer:
        """The last frame's targets."""
        return self.layers[-1]

    @property
    def mass(self) -> float:
        """The expected number of targets."""
        return float(self.present.targets["presence"].sum())


@dataclass(frozen=True, slots=True)
class PMB(Checked, Filter[Bernoullis]):
    """Settings of the Poisson multi-Bernoulli filter.

    Parameters
    ----------
    existence_threshold : targets that exist with less probability are deleted, and given back to
        those never detected where births are a mixture; unless that probability has just risen: a
        detection that no existing target explains better may start a target, however rare births
        are; or unless it has a new velocity, which its next detection decides about.
    hypothesis_threshold : hypotheses of a target that are less probable are dropped.
    max_hypotheses : hypotheses kept of a target, the most probable.
    merge_distance : hypotheses of a target that are within so many deviations of a heavier one are
        counted as that one.
    gate_probability : part of the measurements of a hypothesis inside its gate; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    mean_visible_time : seconds for which, on average, a target can be detected at a stretch; 0: for
        ever.
    mean_occluded_time : seconds for which, on average, it then cannot.
    static_clutter_prior : probability that a first detection which is no single false alarm is
        static clutter. Where scores tell lasting false alarms (`ScoredClutter`), none is.
    static_clutter_detection_probability : probability that static clutter is detected in a frame.
    lasting_clutter_prior : probability that a target is a false alarm that lasts, before its scores
        are known; 0, and where scores say nothing: none is.
    history : frames for which the hypotheses of the past are kept: so far back the past is revised.
    noise_freedom : degrees of freedom with which the noises of a new target are known, see above;
        0: they are the model's.
    noise_memory : frames after which what an innovation has shown of a target's noises counts for
        37 %.
    acceleration_factors : a target is followed with each of these multiples of the model's
        acceleration.
    clutter_decay : false alarms that come again do so exp(−clutter_decay (T − 1)) times as often
        where the interval T is longer than a time unit; those that are new in each frame do not
        depend on T. 0: as the model says.
    detection_memory : chances to detect a target after which what they have told of p_D counts for
        37 %; 0: p_D is the sensor's.
    turns_per_second : how often the velocity of a target is new at once, as of a ball that bounces;
        0: never, nor are new targets fast.
    initial : targets before the first frame; a weight is the probability that there is one.
    """

    existence_threshold: Share = 1e-3
    hypothesis_threshold: Share = 0.01
    max_hypotheses: PositiveCount = 10
    merge_distance: NonNegative = 0.1
    gate_probability: Share = 0.9999999
    transform: Transform = "linear"
    mean_visible_time: NonNegative = 5.0
    mean_occluded_time: Positive = 0.3
    static_clutter_prior: Probability = 0.1
    static_clutter_detection_probability: Probability = 0.4
    lasting_clutter_prior: Probability = 0.1
    history: PositiveCount = 10
    noise_freedom: NonNegative = 8.0
    noise_memory: Positive = 4.5
    acceleration_factors: tuple[Positive, ...] = (1.0, 3.1623, 10.0)
    clutter_decay: NonNegative = 0.4
    detection_memory: NonNegative = 2000.0
    turns_per_second: NonNegative = 0.1
    initial: GaussianMixture | None = None

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if self.lasting_clutter_prior == 1:
            problem = "expected a probability below 1, as some targets are genuine"
            raise InputError(problem, where="filter.lasting_clutter_prior")
        if not self.acceleration_factors:
            cure = "Leave it out, or (1,)"
            raise InputError(
                "expected at least one factor", where="filter.acceleration_factors", cure=cure
            )

    def start(self, model: Model, rng: np.random.Generator) -> Bernoullis:
        """The initial targets, with one hypothesis for each factor of the acceleration; none
        without an initial mixture.
        """
        initial = self.initial or GaussianMixture.empty(model.motion.dim)
        n = len(initial)
        motions = len(self.acceleration_factors)
        number = np.arange(n)
        place = np.arange(n * motions) // motions
        targets = np.zeros(n, TARGET)
        hypotheses = np.zeros(n * motions, HYPOTHESIS)
        targets["r"] = targets["presence"] = targets["max_presence"] = np.minimum(
            initial.weight, 1.0
        )
        targets["label"] = number
        targets["begin"] = number * motions
        targets["end"] = (number + 1) * motions
        targets["best"] = targets["begin"]
        hypotheses["target"] = place
        hypotheses["weight"] = 1 / motions
        hypotheses["motion"] = np.arange(n * motions) % motions
        hypotheses["position_scale"] = 1.0
        hypotheses["size_scale"] = 1.0
        hypotheses["freedom"] = self.noise_freedom
        hypotheses["detection"] = hypotheses["parent"] = hypotheses["past"] = -1
        hypotheses["genuine"] = CERTAIN
        layer = Layer(
            targets,
            hypotheses,
            np.ascontiguousarray(initial.mean.T[place]),
            initial.covariance[place],
        )
        return Bernoullis(
            (layer,), np.zeros((0, 2), np.int64), n, GaussianMixture.empty(model.motion.dim)
        )

    def predict(
        self, state: Bernoullis, model: Model, dt: float, rng: np.random.Generator
    ) -> Bernoullis:
        """A further layer: every hypothesis through f, with p_S of its probability; what stands
        still stays where it is [PMB (1)].
        """
        now = state.present
        factor = self._factors
        if len(factor):
            factor = factor[now.hypotheses["motion"]]
        mean, covariance, after = moved(model, now.mean, now.covariance, dt, self.transform, factor)
        now = Layer(now.targets, now.hypotheses, mean, covariance)
        noise = model.sensor.noise(np.ascontiguousarray(mean.T))
        layer = predicted_layer(now, after, noise, *self._chances(dt / model.rate))
        unseen = survived(state.undetected, model, dt, self.transform)
        return Bernoullis(
            (*state.layers[-self.history :], layer),
            state.ended,
            state.next_label,
            unseen,
            state.frame + 1,
            state.detections,
            state.hidden,
            state.pasts,
        )

    def step(
        self, state: Bernoullis, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Bernoullis, UpdateInfo]:
        """Predict and update; in one compiled call for boxes around which targets are born."""
        motion = model.motion
        sensor = model.sensor
        if not (
            self.transform == "linear"
            and type(motion) is BoxMotion
            and type(sensor) is BoxSensor
            and not len(state.undetected)
        ):
            return Filter.step(self, state, z, model, dt, rng)
        first = self._first_seen(state, model, z, dt)
        if first is None:
            return Filter.step(self, state, z, model, dt, rng)
        hidden, new = first
        before, pasts, looks = _with_pasts(state.present, state.pasts, model.appearance)
        known = len(looks.mean) > 0 or len(pasts.rows) > 0
        mean, covariance = carried(model, before.mean, before.covariance)
        scores = self._scores(model.clutter, z)
        layer, clutter, learned, gone, counted, sure, pasts = stepped_boxes(
            (before.targets, before.hypotheses, mean, covariance),
            (tuple(motion.dynamics(dt, dt / model.rate)), self._factors, *sensor.numbers),
            self._chances(dt / model.rate),
            (z, sensor.measurement_noise(z), *self._local_clutter(model, z, dt)),
            new,
            tuple(scores),
            tuple(self._settings(self._gate(4), model, state.detections, scores.prior < CERTAIN)),
            (dt, FAST_SHARE, self._turn(dt, model), FAST_SPEED, self.turns_per_second > 0),
            state.next_label,
            (tuple(pasts), plain(looks)) if known else None,
        )
        layers = (*state.layers[-self.history :], Layer(*layer))
        return self._updated(
            (state, layers, state.frame + 1),
            clutter,
            (learned, gone, counted, sure),
            hidden,
            Pasts(*pasts) if len(looks.free) else state.pasts,
        )

    @property
    def _factors(self) -> F8:
        """The multipliers of the variances of acceleration of each motion; (0,) for none."""
        factors = self.acceleration_factors
        return SAME if factors == (1.0,) else _squares(factors)

    def _chances(
        self, seconds: float
    ) -> tuple[float, float, float, tuple[float, float], tuple[float, float]]:
        """The numbers of `predicted_layer` after ``seconds``."""
        return (
            *self._changes(seconds),
            -seconds / MEAN_STANDING_TIME,
            (self.noise_freedom, math.exp(-1 / self.noise_memory)),
            (self._prior, SCORE_KEPT),
        )

    def _seen(self, model: Model, z: F8, dt: float) -> tuple[F8, Scores, Measurements, float]:
        """κ(z), what scores say of it, the measurements, and the gate in deviations."""
        clutter, scores = self._clutter(model, z, dt)
        seen = measurements(model.sensor, z, clutter)
        self._check_noise(len(seen.period))
        return clutter, scores, seen, self._gate(len(seen.period))

    def _gate(self, components: int) -> float:
        """The gate of measurements of so many components, in deviations."""
        return math.sqrt(chi2_quantile(components, self.gate_probability))

    @property
    def _prior(self) -> float:
        """The log odds that a target is genuine, before its scores are known."""
        lasting = self.lasting_clutter_prior
        if lasting > 0:
            return math.log(1 / lasting - 1)
        return CERTAIN

    def _changes(self, seconds: float) -> tuple[float, float]:
        """Probabilities to be occluded ``seconds`` after being visible, and visible after being
        occluded.
        """
        return _changes(self.mean_visible_time, self.mean_occluded_time, seconds)

    def update(
        self, state: Bernoullis, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[Bernoullis, UpdateInfo]:
        """Every target with the probabilities of the measurements that it may have, and new
        targets [PMB (2)–(10)].

        `UpdateInfo.clutter_probability` counts static clutter and clutter that lasts as false
        alarms.
        """
        now = state.present
        clutter, scores, seen, gate = self._seen(model, z, dt)
        # Predicted measurements of known targets; first detections λ̂(z) of new ones: PMB (5)
        ahead = predicted_measurements(model.sensor, now.mean, now.covariance, self.transform)
        births, hidden = self._births(state, model, z, dt)
        new = new_targets(model, births, seen, gate, self.transform)
        # Gate, associate by belief propagation, update each target: PMB (3), (4), (7) to (10)
        settings = self._settings(gate, model, state.detections, scores.prior < CERTAIN)
        # As plain tuples: Numba looks up the class of every named one, which takes as long as some
        # kernels.
        now, pasts, looks = _with_pasts(now, state.pasts, model.appearance)
        layer, learned, gone, weak, counted, sure, pasts = updated_layer(
            *map(tuple, (now, ahead, seen, new, scores, settings)),
            state.next_label,
            tuple(self._jumps(now, model, dt)),
            (tuple(pasts), plain(looks)),
        )
        layers = (*state.layers[:-1], layer)
        after, info = self._updated(
            (state, layers, state.frame),
            clutter,
            (learned, gone, counted, sure),
            hidden,
            Pasts(*pasts) if len(looks.free) else state.pasts,
        )
        # Recycle deleted targets into the undetected ones: PMB (6)
        if len(births.weight):
            after = replace(after, undetected=self._undetected(births, model, now, weak))
        return after, info

    def _updated(
        self,
        before: tuple[Bernoullis, tuple[Layer, ...], int],
        clutter: F8,
        found: tuple[tuple[Any, ...], I8, tuple[float, float, float], I8],
        hidden: float,
        pasts: Pasts,
    ) -> tuple[Bernoullis, UpdateInfo]:
        """The state and the record after an update.

        Parameters
        ----------
        before : the state before it, the layers after it, and the number of the last one.
        clutter : (N,) κ(z).
        found : of `updated_layer` what was learned, which targets are gone, what was counted, and
            which targets are sure.
        hidden, pasts : those of `Bernoullis` after it.
        """
        state, layers, frame = before
        learned, gone, counted, sure = found
        predicted, born, mass, evidence, false_alarm, vanished, detected = learned
        info = UpdateInfo(
            predicted,
            born,
            mass,
            evidence,
            clutter,
            false_alarm,
            vanished,
            NO_NUMBERS,
            detected,
            sure,
        )
        targets = layers[-1].targets
        next_label = state.next_label
        if len(targets):
            next_label = max(next_label, int(targets["label"][-1]) + 1)
        after = Bernoullis(
            layers,
            self._with_ended(state.ended, frame, gone),
            next_label,
            state.undetected,
            frame,
            self._remembered(state.detections, counted),
            hidden,
            pasts,
        )
        return after, info

    def _births(self, state: Bernoullis, model: Model, z: F8, dt: float) -> tuple[Births, float]:
        """λ⁺ at the measurements ``z`` (m, N), and `Bernoullis.hidden` after this frame [PMB (2)],
        [PMB (18)].
        """
        births = with_births(state.undetected, model, z, dt)
        more, hidden = self._visible(state, model, dt)
        density, mean, covariance = births.around
        return Births(NewTargets(density * more, mean, covariance), *births[1:]), hidden

    def _visible(self, state: Bernoullis, model: Model, dt: float) -> tuple[float, float]:
        """The ratio of the targets that can be detected for the first time to those born in the
        interval, as some of these are hidden and some of earlier ones appear; and
        `Bernoullis.hidden` after it [PMB (18)].
        """
        if self.mean_visible_time == 0:
            return 1.0, 0.0
        occluded = self.mean_occluded_time / (self.mean_visible_time + self.mean_occluded_time)
        _, reappear = self._changes(dt / (model.rate * model.pace))
        seconds = model.birth_seconds(dt)
        hidden = state.hidden * model.survival(dt)
        visible = (1 - occluded) * seconds + reappear * hidden
        more = visible / max(seconds, TINY)
        return more, occluded * seconds + (1 - reappear) * hidden

    def _first_seen(
        self, state: Bernoullis, model: Model, z: F8, dt: float
    ) -> tuple[float, tuple[Any, ...]] | None:
        """`Bernoullis.hidden` after a frame of boxes, and its `kernels.pmb_boxes.FirstSeen`; None
        where births are a mixture.
        """
        birth = model.birth
        if type(birth) is MeasurementBirth and birth.births_per_detection:
            more, hidden = self._visible(state, model, dt)
            rate = birth.births_per_detection
            return hidden, (NOBODY_NEW, (rate, model.birth_seconds(dt), more, LOCAL_FACTOR))
        births, hidden = self._births(state, model, z, dt)
        if len(births.weight):
            return None
        p_detect = model.sensor.p_detect(z)
        density, mean, covariance = births.around
        return hidden, ((p_detect * density, mean, covariance), NOWHERE)

    def _local_clutter(
        self, model: Model, z: F8, dt: float
    ) -> tuple[F8, tuple[float, float, float, float]]:
        """κ(z) of boxes as `kernels.pmb_boxes.Seen` has it: in numbers where it is local."""
        base, more, again = self._false_alarms(model, dt)
        if type(base) is BoxClutter and not base.clutter_per_frame:
            return NO_NUMBERS, (base.clutter_per_detection, more, again, LOCAL_FACTOR)
        return base.intensity(z) * more * again, NOWHERE

    def _learned(self, counted: tuple[float, float, float]) -> float:
        """The odds of p_D as a multiple of the sensor's, by `Bernoullis.detections`."""
        hits, chances, expected = counted
        if not (self.detection_memory and chances > 0):
            return 1.0
        usual = min(max(expected / chances, 0.01), 0.99)
        learned = (PRIOR_CHANCES * usual + hits) / (PRIOR_CHANCES + chances)
        learned = min(max(learned, LEAST_DETECTION), MOST_DETECTION)
        return learned / (1 - learned) * (1 - usual) / usual

    def _remembered(
        self, before: tuple[float, float, float], counted: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """`Bernoullis.detections` with those of a frame; old ones are forgotten."""
        if not self.detection_memory:
            return before
        kept = max(1 - counted[1] / self.detection_memory, 0.0)
        return (
            kept * before[0] + counted[0],
            kept * before[1] + counted[1],
            kept * before[2] + counted[2],
        )

    def _clutter(self, model: Model, z: F8, dt: float) -> tuple[F8, Scores]:
        """κ(z) (N,) without scores, and what the scores say of each measurement."""
        base, more, again = self._false_alarms(model, dt)
        return base.intensity(z) * more * again, self._scores(model.clutter, z)

    def _false_alarms(self, model: Model, dt: float) -> tuple[Clutter, float, float]:
        """The false alarms without scores, how many times as many there are, and how many of these
        come again after a longer interval than a time unit.
        """
        base = model.clutter
        anew = ANEW
        more = 1.0
        if isinstance(base, ScoredClutter):
            anew = base.anew
            more = base.more
            base = base.base
        interval = dt / model.pace
        if self.clutter_decay and interval > 1:
            again = math.exp(-self.clutter_decay * (interval - 1))
            return base, more, anew + (1 - anew) * again
        return base, more, 1.0

    def _scores(self, clutter: Clutter, z: F8) -> Scores:
        """The evidence of the scores of the measurements ``z`` (m, N). Only scores tell false
        alarms that last from targets.
        """
        if isinstance(clutter, ScoredClutter):
            lasting = clutter.missing[0] > 0 or np.count_nonzero(clutter.log_odds) > 0
            prior = self._prior if lasting else CERTAIN
            return Scores(clutter.odds, clutter.log_odds, prior, clutter.missing)
        nothing = np.zeros(z.shape[1])
        return Scores(nothing + 1, nothing, CERTAIN, (0.0, 0.0))

    def _check_noise(self, components: int) -> None:
        """Raise `InputError` if noises cannot be learned of so many measured components."""
        if self.noise_freedom and components not in (2, 4):
            raise InputError(
                "noises are learned of measurements with 2 or 4 components, these have"
                f" {components}",
                where="filter.noise_freedom",
                cure="Use 0, the model's noises",
            )

    def _settings(
        self, gate: float, model: Model, counted: tuple[float, float, float], lasting: bool
    ) -> Settings:
        """The settings of the kernel; ``counted``: `Bernoullis.detections`. If scores tell
        ``lasting`` false alarms, none is static.
        """
        learned = self._learned(counted)
        clutter = self.static_clutter_prior
        if isinstance(model.clutter, ScoredClutter):
            clutter *= min(model.clutter.more, 1.0)
        standing = (1 - clutter) * STANDING
        prior = 0.0
        genuine = CERTAIN
        if clutter > 0 and not lasting:
            prior = clutter + standing
            genuine = math.log(standing / clutter) if standing else -CERTAIN
        return Settings(
            self.existence_threshold,
            self.hypothesis_threshold,
            float(self.max_hypotheses),
            self.merge_distance,
            gate,
            prior,
            genuine,
            min(learned, 1.0),
            learned,
            self.static_clutter_detection_probability,
            self.noise_freedom,
            len(self.acceleration_factors),
        )

    def _jumps(self, now: Layer, model: Model, dt: float) -> Jumps:
        """How the velocities of targets may be new [PMB (15)]; for none if the sensor is not
        linear.
        """
        speed = NO_SPEED
        turn = 0.0
        if self.turns_per_second and self.transform == "linear":
            columns = np.ascontiguousarray(now.mean.T)
            speed = np.ascontiguousarray(model.sensor.noise(columns)[2:4].T)
            turn = self._turn(dt, model)
        return Jumps(dt, FAST_SHARE, turn, speed, FAST_SPEED)

    def _turn(self, dt: float, model: Model) -> float:
        """The probability that the velocity of a target is new after the interval ``dt``."""
        return -math.expm1(-self.turns_per_second * dt / model.rate)

    def _with_ended(self, ended: I8, frame: int, gone: I8) -> I8:
        """`Bernoullis.ended` of a frame with the hypotheses of targets that are deleted now, and
        without those that are too long ago.
        """
        # The oldest come first.
        if len(ended) and frame - ended[0, 0] > self.history:
            ended = ended[frame - ended[:, 0] <= self.history]
        if len(gone):
            fresh = np.stack([np.full(len(gone), frame - 1), gone], axis=1)
            ended = np.vstack([ended, fresh])
        return ended

    def _undetected(self, births: Births, model: Model, now: Layer, weak: F8) -> GaussianMixture:
        """The births that stay undetected, and of the targets ``now`` those that are deleted, which
        exist with ``weak`` (T,).
        """
        target = np.flatnonzero((weak > 0) & (now.targets["best"] >= 0))
        at = now.targets["best"][target]
        r = now.targets["r"][target]
        weight = weak[target] * now.targets["presence"][target] / np.maximum(r, TINY)
        return recycled(
            still_undetected(births, model),
            weight,
            now.mean[at],
            scaled(now.covariance, now.hypotheses, at),
        )


@dataclass(frozen=True, slots=True)
class BestBernoullis(Checked):
    """Settings of the extraction from Bernoulli targets.

    Parameters
    ----------
    min_weight : targets that exist with less probability are not reported. A target that was
        detected again later existed.
    merge_iou : of targets whose boxes overlap by more (IoU) the one that has been followed for
        longer is reported; 1: all.
    """

    min_weight: Share = 0.5
    merge_iou: Share = 0.8

    def extract(self, state: Bernoullis, z: F8, model: Model) -> Estimates:
        """The best hypothesis of each target, by label; their weight is the probability that the
        target exists.

        `Estimates.past` are the same targets, and those that have ended since, in the frames
        before; None for frames of which the same is reported as a frame ago.
        """
        layers = state.layers
        frames = list[Estimates | None]()
        if len(layers) == 1:
            trace = best_trace(layers[0].targets)
            return self._reported(state, self._columns(layers[0], trace, model), model, ())
        columns, past_columns, now, before, same = self._newest(state, model)
        for back in range(1, len(layers)):
            after = layers[-back]
            then = layers[-back - 1]
            if back > 1:
                past = (state.ended, state.frame - back)
                now, before, same = earlier(
                    now,
                    before,
                    after.hypotheses,
                    then.targets,
                    then.hypotheses,
                    past,
                    False,
                    self.min_weight,
                )
                if not same:
                    past_columns = self._columns(then, now, model)
            if same:
                break
            frames.append(Estimates(*past_columns))
        unchanged = (None,) * (len(layers) - 1 - len(frames))
        return self._reported(state, columns, model, (*unchanged, *reversed(frames)))

    def _newest(
        self, state: Bernoullis, model: Model
    ) -> tuple[Columns, Columns, Records, Records, bool]:
        """The columns of the present and of the frame before it; the traces of that frame, as seen
        now and as seen a frame ago; and whether both report the same: then that frame's columns
        tell nothing.
        """
        newest = state.layers[-1]
        then = state.layers[-2]
        past = (state.ended, state.frame - 1)
        if type(model.sensor) is BoxSensor:
            columns, past_columns, traces, same = reported_frames(
                tuple(newest), tuple(then), past, self.min_weight, self.merge_iou
            )
            return columns, past_columns, *traces, same
        present, now, before, same = first_earlier(newest[:2], then[:2], past, self.min_weight)
        columns = self._columns(newest, present, model)
        if same:
            return columns, columns, now, before, same
        return columns, self._columns(then, now, model), now, before, same

    def _reported(
        self,
        state: Bernoullis,
        columns: Columns,
        model: Model,
        past: tuple[Estimates | None, ...],
    ) -> Estimates:
        """The targets of the present with what their pasts look like."""
        now = state.present
        if model.appearance is None or not len(state.pasts.rows):
            return Estimates(*columns, past)
        label = columns[-1]
        looks = looks_of_targets(now.targets, now.hypotheses, label, *state.pasts)
        return Estimates(*columns, past, *looks)

    def _columns(self, layer: Layer, trace: Records, model: Model) -> Columns:
        """The columns of `Estimates`, up to the labels, of targets of enough presence, without
        those that overlap one followed for longer.
        """
        columns: Columns
        if type(model.sensor) is BoxSensor:
            columns = reported_boxes(tuple(layer), trace, self.min_weight, self.merge_iou)
            return columns
        target = present_targets(trace, self.min_weight)
        boxes = model.sensor.boxes(np.ascontiguousarray(layer.mean[trace["place"][target]].T))
        # Labels rise with the frame in which a target began.
        left = without_overlaps(boxes, self.merge_iou)
        mean, covariance, weight, detection, label = of_targets(tuple(layer), trace, target[left])
        return mean, covariance, weight, boxes[left], detection, label


def _with_pasts(now: Layer, pasts: Pasts, looks: Looks | None) -> tuple[Layer, Pasts, Looks]:
    """The targets, their pasts, and what a frame looks like, as of `carried`."""
    before = now.hypotheses["past"]
    past, pasts, looks = carried_pasts(before, pasts, looks)
    if past is before:
        return now, pasts, looks
    hypotheses = now.hypotheses.copy()
    hypotheses["past"] = past
    return now._replace(hypotheses=hypotheses), pasts, looks


def without_overlaps(boxes: F8, merge_iou: float) -> I8:
    """Which of the boxes (n, 4) are left without those that overlap an earlier one that is left by
    more; 1: all.
    """
    if merge_iou >= 1 or len(boxes) < 2:
        return np.arange(len(boxes))
    return np.asarray(apart(boxes, boxes[:, 0].argsort(), merge_iou))
