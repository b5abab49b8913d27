"""The Gaussian-mixture PHD filter [V06, E13 §4]: the intensity is a mixture, each Gaussian of which
has a Kalman filter.

Equations: docs/methods.md, PHD. A measurement touches only the Gaussians in whose gate it is, so
that the cost grows linearly with the number of targets. A mixture grows with every measurement;
`GMPHD.reduce` prunes, merges and caps it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from phdtrack.arrays import GATE, chi2_quantile
from phdtrack.errors import Checked, Count, NonNegative, Share
from phdtrack.filters.cardinality import UpdateTerms
from phdtrack.kernels.gaussian import Expected, Measurements
from phdtrack.kernels.gm_merge import Merging, Rows, merged_rows
from phdtrack.kernels.gm_update import Newborn, Reach, mixture_of, phd_step, terms_of
from phdtrack.models.gaussian import (
    Transform,
    measurements,
    moved,
    predicted_measurements,
    row_numbers,
)
from phdtrack.protocols import Filter, Model
from phdtrack.types import F8, GaussianMixture, UpdateInfo, false_alarm_share

# Mass within this region of a detection explains it, M(z), and births around it have the mass of γ
# there.
REGION = 0.99
# Gaussians at most, unless the settings say otherwise.
MOST = 3000
# Pairs of a Gaussian and a measurement from which on light ones are left out at once.
HEAP = 50_000
_NONE = np.zeros((0, 0))
_NOTHING = np.zeros((0, 0, 0))


class Frame(NamedTuple):
    """The model's answers about a frame: the arguments of `kernels.gm_update`.

    Attributes
    ----------
    rows : the predicted Gaussians, and behind them the births that are Gaussians.
    expected : the measurements that they predict.
    measurements : the measurements.
    newborn : births around the measurements.
    reach : how far Gaussians reach.
    """

    rows: Rows
    expected: Expected
    measurements: Measurements
    newborn: Newborn
    reach: Reach


@dataclass(frozen=True, slots=True)
class GaussianSettings(Checked):
    """Settings of the GM-PHD and the GM-CPHD filter; the defaults are E13's, without its cap.

    Parameters
    ----------
    weight_threshold : Gaussians that weigh less are dropped.
    merge_distance : Mahalanobis distance (not squared) up to which a Gaussian is united with a
        stronger one, in its own covariance.
    max_components : J_max, Gaussians kept, the heaviest; 0: 3000. In practice there are some for
        each target, and for each false alarm as long as one that was not seen again takes to fade,
        log(weight / weight_threshold) / −log(1 − p_D) frames. E13's is 100.
    gate_probability : part of the measurements of a Gaussian inside its gate; those beyond do not
        touch it; 1: no gate.
    transform : ``linear`` by Jacobians, or ``unscented`` by sigma points.
    initial : the intensity before the first frame.
    """

    weight_threshold: NonNegative = 1e-5
    merge_distance: NonNegative = 2.0
    max_components: Count = 0
    gate_probability: Share = GATE
    transform: Transform = "linear"
    initial: GaussianMixture | None = None


@dataclass(frozen=True, slots=True)
class GMPHD(GaussianSettings, Filter[GaussianMixture]):
    """The GM-PHD filter."""

    def start(self, model: Model, rng: np.random.Generator) -> GaussianMixture:
        """The initial intensity; empty without one."""
        return self.initial or GaussianMixture.empty(model.motion.dim)

    def predict(
        self, state: GaussianMixture, model: Model, dt: float, rng: np.random.Generator
    ) -> GaussianMixture:
        """Every Gaussian through f, weighed with p_S [V06 (24)–(29)]."""
        if len(state) == 0:
            return state
        rows = self._predicted(state, model, dt)
        alive = rows.weight > 0
        return _mixture(Rows._make(column[alive] for column in rows))

    def update(
        self, state: GaussianMixture, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[GaussianMixture, UpdateInfo]:
        """Add the births, then update every Gaussian with every measurement within its gate [V06
        (32)–(38)].

        The mass that explains a detection, which decides where targets are born, is that of the
        Gaussians within the 99 % region of it. Where κ(z) + C(z) = 0 the detection's term is 0 and
        counted in ``info.vanished``. The mixture is not reduced.
        """
        return self.terms(state, z, model, dt, rng).phd()

    def terms(
        self, state: GaussianMixture, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> UpdateTerms:
        """The terms of the update with the births.

        Parameters
        ----------
        state, model, dt, rng : as in `update`.
        z : (m, N) measurements.
        """
        frame = self._frame(_rows_of(state), z, model, dt)
        t = terms_of(*frame)

        def weighed(missed: float, detected: F8) -> GaussianMixture:
            # Of a heap of targets what pruning would drop is not made.
            least = float(self.weight_threshold) if len(t.pairs) > HEAP else 0.0
            rows, mass = mixture_of(*frame[:-1], t, (missed, detected), least)
            if least and len(rows.weight):
                rows = rows._replace(weight=rows.weight * (mass / rows.weight.sum()))
            return _mixture(rows)

        return UpdateTerms(
            t.predicted, t.born, t.missed, t.evidence, frame.measurements.clutter, weighed
        )

    def reduce(self, state: GaussianMixture, rng: np.random.Generator) -> GaussianMixture:
        """Prune, merge, cap: the strongest first, with all that are near it, moment-matched [V06
        Table II, E13 §4].

        The rest gets the mass of what is dropped, so that the expected number stays.
        """
        axes = tuple(range(len(state.mean)))
        return GaussianMixture(*merged_rows(_rows_of(state), axes, self._merging, state.mass))

    def step(
        self, state: GaussianMixture, z: F8, model: Model, dt: float, rng: np.random.Generator
    ) -> tuple[GaussianMixture, UpdateInfo]:
        """Predict, update and reduce; Gaussians that pruning would drop are not made."""
        # Predict [V06 (24)–(29)], with the births
        frame = self._frame(self._predicted(state, model, dt), z, model, dt)
        axes = tuple(range(frame.rows.mean.shape[1]))
        new = frame.newborn
        # Update [V06 (32)–(38)]; prune, merge and cap [V06 Table II]
        # As plain tuples: Numba looks up the class of every named one, which takes a quarter of a
        # step of ten targets.
        weight, mean, covariance, evidence, (predicted, born, mass), vanished = phd_step(
            tuple(frame.rows),
            tuple(frame.expected),
            tuple(frame.measurements),
            (tuple(new.around), *new[1:-1], tuple(new.expected)),
            tuple(frame.reach),
            tuple(self._merging),
            axes,
        )
        clutter = frame.measurements.clutter
        false_alarm = false_alarm_share(clutter, evidence)
        # ∫ p_D D⁺, as ∫ D = ∫ (1 − p_D) D⁺ + Σ C/(κ + C)
        detected = predicted - mass + float((1 - false_alarm).sum())
        info = UpdateInfo(
            predicted, born, mass, evidence, clutter, false_alarm, vanished, detected=detected
        )
        return GaussianMixture(weight, mean, covariance), info

    def _predicted(self, state: GaussianMixture, model: Model, dt: float) -> Rows:
        """The predicted Gaussians, of weight 0 where none survives."""
        rows = _rows_of(state)
        _, _, after = moved(model, rows.mean, rows.covariance, dt, self.transform)
        return Rows(rows.weight * after.p_survive, after.mean, after.covariance)

    def _frame(self, rows: Rows, z: F8, model: Model, dt: float) -> Frame:
        """The model's answers about a frame with these measurements and predicted Gaussians."""
        sensor = model.sensor
        predicted = len(rows.weight)
        # Births γ(x)
        born = model.birth.gaussians(z, sensor, model.birth_seconds(dt))
        if len(born.weight):
            rows = Rows(*(np.concatenate(parts) for parts in zip(rows, born[1:], strict=True)))
        around = born.around
        # Measurements with κ(z), and those that the Gaussians predict
        seen = measurements(sensor, z, model.clutter.intensity(z))
        observed = row_numbers(sensor.observed)
        volume, stretch = _newborn_shape(len(observed))
        ahead = predicted_measurements(sensor, rows.mean, rows.covariance, self.transform)
        if self.transform == "unscented":
            covariance = around.covariance.copy()
            covariance[:, observed[:, None], observed] *= stretch - 1
            newborn = predicted_measurements(sensor, around.mean, covariance, self.transform)
        else:
            p_detect = sensor.p_detect(np.ascontiguousarray(around.mean.T))
            newborn = Expected(observed, _NONE, _NOTHING, _NOTHING, _NOTHING, p_detect)
        r = len(seen.period)
        gate = math.sqrt(chi2_quantile(r, self.gate_probability))
        region = chi2_quantile(r, REGION)
        reach = Reach(gate, region, predicted)
        return Frame(rows, ahead, seen, Newborn(around, observed, volume, stretch, newborn), reach)

    @property
    def _merging(self) -> Merging:
        """The settings of a reduction."""
        return Merging(
            float(self.weight_threshold),
            float(self.merge_distance),
            self.max_components or MOST,
            True,
        )


@lru_cache(maxsize=8)
def _newborn_shape(n: int) -> tuple[float, float]:
    """V_n r₀ⁿ and 1 + a of `kernels.gm_update` in n dimensions."""
    volume = math.pi ** (n / 2) / math.gamma(n / 2 + 1) * chi2_quantile(n, REGION) ** (n / 2)
    return volume, volume ** (2 / n) / (2 * math.pi)


def _rows_of(state: GaussianMixture) -> Rows:
    """A Gaussian a row, in the layout that the kernels are compiled for."""
    ordered = np.ascontiguousarray
    return Rows(ordered(state.weight), ordered(state.mean.T), ordered(state.covariance))


def _mixture(rows: Rows) -> GaussianMixture:
    """The mixture of Gaussians that are rows."""
    return GaussianMixture(rows.weight, np.ascontiguousarray(rows.mean.T), rows.covariance)
