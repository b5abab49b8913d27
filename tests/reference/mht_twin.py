"""Reid's tracker by enumeration: every association history; false alarms, births and deaths are hypotheses of their own.

Linear, one target at a time, no gate, no pruning. A track is (measurements ((frame, index), …), alive, mean, covariance).
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from phdtrack.types import GaussianMixture
from reference.gm_twin import corrected


@dataclass(frozen=True)
class Track:
    taken: tuple
    alive: bool
    mean: np.ndarray
    cov: np.ndarray


def enumerate_histories(scans, model, dt: float):
    """Every history as (weight, false alarms, tracks), not normalised; ``scans`` is a list of (m, N)."""
    rows = list(model.sensor.observed)
    found = [(1.0, (), ())]
    for k, z in enumerate(scans):
        born = model.birth.gaussians(z, model.sensor, dt / model.rate)
        births = GaussianMixture(born.weight, born.mean.T, born.covariance)
        assert len(births) == 1, "one place of birth, so that a new target is one Gaussian"
        kappa = model.clutter.intensity(z)
        grown = []
        for weight, false, tracks in found:
            moved = [moved_on(track, model, dt) if track.alive else track for track in tracks]
            for alive in itertools.product(*[[True, False] if t.alive else [False] for t in moved]):
                w = weight
                for track, stays in zip(moved, alive, strict=True):
                    if track.alive:
                        p = float(model.motion.p_survive(track.mean[:, None], dt / model.rate)[0])
                        w *= p if stays else 1 - p
                present = [Track(t.taken, a, t.mean, t.cov) for t, a in zip(moved, alive, strict=True)]
                grown.extend(assigned(w, false, present, k, z, births, kappa, model, rows))
        found = grown
    return found


def moved_on(track, model, dt):
    mean, f, q = model.motion.transition(track.mean[:, None], dt)
    return Track(track.taken, True, mean[:, 0], f[0] @ track.cov @ f[0].T + q[0])


def assigned(weight, false, tracks, k, z, births, kappa, model, rows):
    """All assignments of a scan: of each measurement to a living track, to a new one (−2) or to none (−1)."""
    p_d = [float(model.sensor.p_detect(t.mean[:, None])[0]) for t in tracks]
    living = [i for i, t in enumerate(tracks) if t.alive]
    for choice in itertools.product([-1, -2, *living], repeat=z.shape[1]):
        used = [c for c in choice if c >= 0]
        if len(used) != len(set(used)):
            continue
        w, now_false, now = weight, list(false), list(tracks)
        for i in living:
            if i not in used:
                w *= 1 - p_d[i]
        for j, c in enumerate(choice):
            if c == -1:
                w *= kappa[j]
                now_false.append((k, j))
                continue
            mean, cov = (births.mean[:, 0], births.covariance[0]) if c == -2 else (tracks[c].mean, tracks[c].cov)
            noise = model.sensor.covariance(z[:, [j]], mean[:, None])[0]
            new_mean, new_cov, q = corrected(mean, cov, z[: len(rows), j], np.eye(len(mean))[rows], noise)
            if c == -2:
                w *= births.weight[0] * float(model.sensor.p_detect(mean[:, None])[0]) * q
                now.append(Track(((k, j),), True, new_mean, new_cov))
            else:
                w *= p_d[c] * q
                now[c] = Track((*tracks[c].taken, (k, j)), True, new_mean, new_cov)
        if w > 0:
            yield w, tuple(now_false), tuple(now)


def summed(histories):
    """Probability of each partition of the measurements into sequences; of each sequence in it: living, mean, covariance.

    Summed over what of the lone measurements are false alarms and over all times at which targets may have left.
    """
    total = sum(w for w, *_ in histories)
    weight, there, state = defaultdict(float), defaultdict(float), {}
    for w, false, tracks in histories:
        key = frozenset([(one,) for one in false] + [t.taken for t in tracks])
        weight[key] += w / total
        for t in tracks:
            if t.alive:
                there[key, t.taken] += w / total
                state[key, t.taken] = (t.mean, t.cov)
    return dict(weight), {k: v / weight[k[0]] for k, v in there.items()}, state
