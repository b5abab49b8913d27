"""The targets that are expected in a frame: those that the last frames showed, moved on.

Extraction drops a target that was missed once, or that another one covers; it is expected for a while all the same, with
the probability that it is still there: after a miss r ← r (1 − p_D)/(1 − r p_D), and r ← r p_S with time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from phdtrack.protocols import Model
from phdtrack.types import F8, I8, Bool, Estimates

# Of a target that is there for sure: no evidence is beyond doubt, and after some misses it is believed to have gone.
SUREST = 0.99
# A target that is less likely to be there explains nothing.
LEAST = 0.1
# Squared deviations in the plane within which an estimate can be an expected target: 99 % of two dimensions.
NEAR = 9.21


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """The targets before a frame, or after it.

    Attributes
    ----------
    state : (d, n).      covariance : (n, d, d).
    existence : (n,) probability that each is there.
    hidden : (n,) seconds for which each was part of a blob and neither its left nor its right edge was to be seen.
    pieces : (n,) seconds for which each was seen in pieces.
    alone : (n,) seconds for which each had a blob of its own.
    size : (n, 2) width and height when each was last seen whole.
    """

    state: F8
    covariance: F8
    existence: F8
    hidden: F8
    pieces: F8
    alone: F8
    size: F8

    @classmethod
    def nobody(cls) -> Expected:
        """Before anything was seen."""
        none = np.zeros(0)
        return cls(np.zeros((0, 0)), np.zeros((0, 0, 0)), none, none, none, none, np.zeros((0, 2)))

    def __len__(self) -> int:
        return len(self.existence)

    def take(self, index: I8 | Bool) -> Expected:
        """The targets at ``index`` (integers or a mask)."""
        return Expected(
            np.ascontiguousarray(self.state[:, index]),
            self.covariance[index],
            self.existence[index],
            self.hidden[index],
            self.pieces[index],
            self.alone[index],
            self.size[index],
        )


def predicted(targets: Expected, model: Model, dt: float) -> Expected:
    """The targets ``dt`` later."""
    if not len(targets):
        return targets
    state, before = model.carried_gaussians(np.ascontiguousarray(targets.state), targets.covariance)
    mean, jacobian, noise = model.motion.transition(np.ascontiguousarray(state), dt)
    covariance = jacobian @ before @ jacobian.transpose(0, 2, 1) + noise
    there = targets.existence * model.motion.p_survive(targets.state, dt)
    return replace(targets, state=mean, covariance=covariance, existence=there)


def seen(targets: Expected, who: I8, estimates: Estimates, model: Model, span: float, patience: float) -> Expected:
    """The targets after a frame: its ``estimates``, and those expected that it does not show but that may be there.

    Parameters
    ----------
    targets : those expected in the frame.
    who : (N,) the target that explains each detection, −1 for none, in the numbers that ``estimates.detection`` has.
    span : seconds since the frame before. Who is not shown is hidden for so much longer.
    patience : seconds after which those who are hidden are expected no more.
    """
    of = continued(targets, who, estimates, model)
    left = np.ones(len(targets), np.bool_)
    left[of[of >= 0]] = False
    found = np.zeros(len(targets), np.bool_)
    found[who[who >= 0]] = True
    p = model.sensor.p_detect(targets.state) if len(targets) else np.zeros(0)
    r = targets.existence
    there = np.where(found, r, r * (1 - p) / np.maximum(1 - r * p, 1 - SUREST))
    left &= (there > LEAST) & (targets.hidden + span <= patience)
    known, n = of >= 0, len(estimates)
    kept = replace(targets, existence=there, hidden=targets.hidden + span).take(left)
    size = model.sensor.expected(estimates.state)[2:4].T if n else np.zeros((0, 2))
    torn = np.append(targets.pieces > 0, False)[of] & known
    new = Expected(
        estimates.state,
        estimates.covariance,
        np.minimum(estimates.weight, SUREST),
        np.where(known, np.append(targets.hidden, 0.0)[of], 0.0),
        np.where(known, np.append(targets.pieces, 0.0)[of], 0.0),
        np.where(known, np.append(targets.alone, 0.0)[of], 0.0),
        np.where(torn[:, None], np.append(targets.size, [[0.0, 0.0]], axis=0)[of], size),
    )
    if not n or not len(kept):
        return kept if not n else new
    return Expected(
        np.concatenate([new.state, kept.state], axis=1),
        np.concatenate([new.covariance, kept.covariance]),
        np.concatenate([new.existence, kept.existence]),
        np.concatenate([new.hidden, kept.hidden]),
        np.concatenate([new.pieces, kept.pieces]),
        np.concatenate([new.alone, kept.alone]),
        np.concatenate([new.size, kept.size]),
    )


def continued(targets: Expected, who: I8, estimates: Estimates, model: Model) -> I8:
    """(k,) the expected target that each estimate continues, −1 for none.

    The one that explains its detection; where none does the nearest that is left, within the gate.
    """
    of: I8 = np.append(who, -1)[estimates.detection].astype(np.int64)
    first = np.zeros(len(of), np.bool_)
    first[np.unique(of, return_index=True)[1]] = True
    of = np.where(first, of, -1)
    free = np.setdiff1d(np.arange(len(targets)), of)
    lost = np.flatnonzero(of < 0)
    if not len(free) or not len(lost):
        return of
    step = estimates.state[:2, lost, None] - targets.state[:2, None, free]
    spread = targets.covariance[free, :2, :2] + np.square(model.sensor.noise(targets.state[:, free])[:2]).T[
        :, :, None
    ] * np.eye(2)
    distance = np.einsum("aij,jab,bij->ij", step, np.linalg.inv(spread), step)
    for k in np.argsort(distance, axis=None, kind="stable"):
        i, j = divmod(int(k), len(free))
        if distance[i, j] > NEAR:
            break
        of[lost[i]] = free[j]
        distance[i, :], distance[:, j] = np.inf, np.inf
    return of
