"""Reid's tracker by enumeration: every association history; false alarms, births and deaths are
hypotheses of their own.

Linear, one target at a time, no gate, no pruning. A track is (measurements ((frame, index), …),
alive, mean, covariance, and the last frame in which it lived).
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
    last: int


def enumerate_histories(scans, model, dt: float, initial=None):
    """Every history as (weight, false alarms, tracks), not normalised; ``scans`` is a list of (m,
    N).

    Targets that are not detected when they are born never are, as Reid has it. Given ``initial``,
    Gaussians of targets that were there before the first frame, they may be detected later, and
    those of ``initial`` as well.
    """
    rows = list(model.sensor.observed)
    found = [(1.0, (), ())]
    undetected = [] if initial is None else gaussians(initial)
    for k, z in enumerate(scans):
        born = model.birth.gaussians(z, model.sensor, dt / model.rate)
        undetected = [
            unseen(one, model, dt, missed=k > 0) for one in undetected if initial is not None
        ]
        undetected += gaussians(GaussianMixture(born.weight, born.mean.T, born.covariance))
        births = undetected
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
                present = [
                    Track(t.taken, a, t.mean, t.cov, k if a else t.last)
                    for t, a in zip(moved, alive, strict=True)
                ]
                grown.extend(assigned(w, false, present, k, z, births, kappa, model, rows))
        found = grown
    return found


def moved_on(track, model, dt):
    mean, f, q = model.motion.transition(track.mean[:, None], dt)
    return Track(track.taken, True, mean[:, 0], f[0] @ track.cov @ f[0].T + q[0], track.last)


def gaussians(mixture):
    """The Gaussians of a mixture as (weight, mean, covariance)."""
    return list(zip(mixture.weight, mixture.mean.T, mixture.covariance, strict=True))


def unseen(one, model, dt, missed):
    """One Gaussian of undetected targets a frame later; ``missed``: they were not detected in the
    frame before.
    """
    weight, mean, cov = one
    p_d = float(model.sensor.p_detect(mean[:, None])[0]) if missed else 0.0
    p_s = float(model.motion.p_survive(mean[:, None], dt / model.rate)[0])
    on = moved_on(Track((), True, mean, cov, -1), model, dt)
    return weight * (1 - p_d) * p_s, on.mean, on.cov


def assigned(weight, false, tracks, k, z, births, kappa, model, rows):
    """All assignments of a scan: of each measurement to a living track, to one of the b-th births
    (−2 − b), to none (−1).
    """
    p_d = [float(model.sensor.p_detect(t.mean[:, None])[0]) for t in tracks]
    living = [i for i, t in enumerate(tracks) if t.alive]
    for choice in itertools.product(
        [-1, *range(-2, -2 - len(births), -1), *living], repeat=z.shape[1]
    ):
        used = [c for c in choice if c >= 0]
        if len(used) != len(set(used)):
            continue
        w = weight
        now_false = list(false)
        now = list(tracks)
        for i in living:
            if i not in used:
                w *= 1 - p_d[i]
        for j, c in enumerate(choice):
            if c == -1:
                w *= kappa[j]
                now_false.append((k, j))
                continue
            expected, mean, cov = (
                births[-2 - c] if c <= -2 else (1.0, tracks[c].mean, tracks[c].cov)
            )
            noise = model.sensor.covariance(z[:, [j]], mean[:, None])[0]
            new_mean, new_cov, q = corrected(
                mean, cov, z[: len(rows), j], np.eye(len(mean))[rows], noise
            )
            if c <= -2:
                w *= expected * float(model.sensor.p_detect(mean[:, None])[0]) * q
                now.append(Track(((k, j),), True, new_mean, new_cov, k))
            else:
                w *= p_d[c] * q
                now[c] = Track((*tracks[c].taken, (k, j)), True, new_mean, new_cov, k)
        if w > 0:
            yield w, tuple(now_false), tuple(now)


def summed(histories):
    """Probability of each partition of the measurements into sequences; of each sequence in it:
    living, mean, covariance.

    Summed over what of the lone measurements are false alarms and over all times at which targets
    may have left.
    """
    total = sum(w for w, *_ in histories)
    weight = defaultdict(float)
    there = defaultdict(float)
    state = {}
    for w, false, tracks in histories:
        key = frozenset([(one,) for one in false] + [t.taken for t in tracks])
        weight[key] += w / total
        for t in tracks:
            if t.alive:
                there[key, t.taken] += w / total
                state[key, t.taken] = (t.mean, t.cov)
    return dict(weight), {k: v / weight[k[0]] for k, v in there.items()}, state


def lived(histories, partition, taken, frame: int) -> float:
    """Probability, given the partition of the measurements, that the track of this sequence lived
    in the frame.
    """
    total = alive = 0.0
    for w, false, tracks in histories:
        if frozenset([(one,) for one in false] + [t.taken for t in tracks]) == partition:
            total += w
            alive += w * any(t.taken == taken and t.last >= frame for t in tracks)
    return alive / total
