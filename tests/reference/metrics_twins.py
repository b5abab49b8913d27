"""Plain twins of the metrics: loops over boxes, and all mappings tried one after the other. For a
handful of boxes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

Box = tuple[float, float, float, float]
Pairs = tuple[tuple[int, int], ...]


def overlap(a: Box, b: Box) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    shared = width * height
    return shared / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - shared)


def partial_mappings(n: int, m: int) -> Iterator[Pairs]:
    """All one-to-one mappings of some of n into some of m."""
    for size in range(min(n, m) + 1):
        for chosen in combinations(range(n), size):
            for into in permutations(range(m), size):
                yield tuple(zip(chosen, into, strict=True))


def by_frame(rows) -> dict[int, list[tuple[int, Box]]]:
    frames: dict[int, list[tuple[int, Box]]] = {}
    for frame, identity, box in zip(rows.frame, rows.identity, rows.xyxy, strict=True):
        frames.setdefault(int(frame), []).append((int(identity), tuple(float(v) for v in box)))
    return frames


def best_mapping(truth: list[Box], output: list[Box], threshold: float, kept: Pairs = ()) -> Pairs:
    """Largest (number of kept pairs, total overlap) among mappings of pairs at IoU ≥ threshold."""
    best: Pairs = ()
    value = (0, 0.0)
    for pairs in partial_mappings(len(truth), len(output)):
        iou = [overlap(truth[i], output[j]) for i, j in pairs]
        if all(v >= threshold for v in iou):
            this = (sum(pair in kept for pair in pairs), math.fsum(iou))
            if this > value:
                best = pairs
                value = this
    return best


def moda_modp(truth, tracks, threshold: float) -> tuple[float, float]:
    """Means of MODA(k) over frames with truth, of MODP(k) over frames with a mapped pair."""
    gt = by_frame(truth)
    out = by_frame(tracks)
    moda = []
    modp = []
    for k in sorted(set(gt) | set(out)):
        t = [box for _, box in gt.get(k, [])]
        o = [box for _, box in out.get(k, [])]
        pairs = best_mapping(t, o, threshold)
        if t:
            wrong = len(t) + len(o) - 2 * len(pairs)
            moda.append(1 - wrong / len(t))
        if pairs:
            modp.append(math.fsum(overlap(t[i], o[j]) for i, j in pairs) / len(pairs))
    return _mean(moda), _mean(modp)


@dataclass(frozen=True)
class Tracking:
    mota: float
    mota_log: float
    motp: float
    switches: int
    delays: dict[int, int]
    false_tracks: int


def tracking(truth, tracks, threshold: float) -> Tracking:
    """MOTA and its kin, the delay from the first annotated to the first mapped frame, and output
    that is nobody's.
    """
    gt = by_frame(truth)
    out = by_frame(tracks)
    wrong = switches = boxes = 0.0
    log_switches = 0.0
    ious = []
    before: dict[int, int] = {}
    last: dict[int, int] = {}
    appeared: dict[int, int] = {}
    delays: dict[int, int] = {}
    mapped: set[int] = set()
    for k in sorted(set(gt) | set(out)):
        t = gt.get(k, [])
        o = out.get(k, [])
        kept = tuple(
            (i, j) for i, (a, _) in enumerate(t) for j, (b, _) in enumerate(o) if before.get(a) == b
        )
        pairs = best_mapping([box for _, box in t], [box for _, box in o], threshold, kept)
        boxes += len(t)
        wrong += len(t) + len(o) - 2 * len(pairs)
        ious += [overlap(t[i][1], o[j][1]) for i, j in pairs]
        for name, _ in t:
            appeared.setdefault(name, k)
        if t and o:
            before = {t[i][0]: o[j][0] for i, j in pairs}
            here = sum(last.get(a, b) != b for a, b in before.items())
            switches += here
            log_switches += math.log(1 + here)
            last |= before
            mapped |= set(before.values())
            for name in before:
                delays.setdefault(name, k - appeared[name])
    names = {name for rows in out.values() for name, _ in rows}
    return Tracking(
        1 - (wrong + switches) / boxes if boxes else math.nan,
        1 - (wrong + log_switches) / boxes if boxes else math.nan,
        _mean(ious),
        int(switches),
        delays,
        len(names - mapped),
    )


def ospa(distance: list[list[float]], n: int, m: int, c: float, p: float) -> float:
    if max(n, m) == 0:
        return 0.0
    least = min(
        math.fsum(min(distance[i][j], c) ** p for i, j in pairs)
        for pairs in partial_mappings(n, m)
        if len(pairs) == min(n, m)
    )
    return ((least + c**p * abs(n - m)) / max(n, m)) ** (1 / p)


def gospa(distance: list[list[float]], n: int, m: int, c: float, p: float) -> float:
    """α = 2, in its form over partial mappings."""
    return _gospa_power(distance, n, m, c, p) ** (1 / p)


def _gospa_power(distance, n: int, m: int, c: float, p: float) -> float:
    return min(
        math.fsum(distance[i][j] ** p for i, j in pairs) + c**p / 2 * (n + m - 2 * len(pairs))
        for pairs in partial_mappings(n, m)
    )


def tgospa_power(distance, there, given, c: float, p: float, gamma: float) -> float:
    """The least T-GOSPA^p over mappings that are 0 or 1, by dynamic programming over all of
    them.
    """
    frames = len(distance)
    n = len(there[0])
    m = len(given[0])
    states = list(partial_mappings(n, m))
    value = dict.fromkeys(states, 0.0)
    for k in range(frames):
        if k:
            value = {
                s: min(value[r] + gamma**p / 2 * len(set(r) ^ set(s)) for r in states)
                for s in states
            }
        for s in states:
            alone_t = [
                i for i in range(n) if there[k][i] and not any(a == i and given[k][b] for a, b in s)
            ]
            alone_o = [
                j for j in range(m) if given[k][j] and not any(b == j and there[k][a] for a, b in s)
            ]
            near = [min(distance[k][a][b], c) ** p for a, b in s if there[k][a] and given[k][b]]
            value[s] += math.fsum(near) + c**p / 2 * (len(alone_t) + len(alone_o))
    return min(value.values())


def _mean(values: list[float]) -> float:
    return math.fsum(values) / len(values) if values else math.nan


def track_distance(distance, there, given, c: float, q: float) -> float:
    """OSPA(2)'s distance between two trajectories over the frames given: lists over the frames; c
    where one is absent.
    """
    costs = []
    for d, t, o in zip(distance, there, given, strict=True):
        if t and o:
            costs.append(min(d, c) ** q)
        elif t or o:
            costs.append(c**q)
    return (math.fsum(costs) / len(costs)) ** (1 / q)


def ospa2(distance, there, given, c: float, p: float, q: float) -> float:
    """OSPA(2) over all frames: OSPA between the trajectories that are present, by
    `track_distance`.
    """
    frames = range(len(distance))
    t = [i for i in range(len(there[0])) if any(there[k][i] for k in frames)]
    o = [j for j in range(len(given[0])) if any(given[k][j] for k in frames)]
    base = [
        [
            track_distance(
                [distance[k][i][j] for k in frames],
                [there[k][i] for k in frames],
                [given[k][j] for k in frames],
                c,
                q,
            )
            for j in o
        ]
        for i in t
    ]
    return ospa(base, len(t), len(o), c, p)


def ata(truth, tracks) -> float:
    gt = _lives(truth)
    out = _lives(tracks)
    share = []
    for a in gt.values():
        row = []
        for b in out.values():
            together = [overlap(a[k], b[k]) for k in set(a) & set(b)]
            row.append(math.fsum(together) / len(set(a) | set(b)))
        share.append(row)
    stda = max(
        math.fsum(share[i][j] for i, j in pairs) for pairs in partial_mappings(len(gt), len(out))
    )
    return stda / ((len(gt) + len(out)) / 2)


def _lives(rows) -> dict[int, dict[int, Box]]:
    lives: dict[int, dict[int, Box]] = {}
    for frame, found in by_frame(rows).items():
        for name, box in found:
            lives.setdefault(name, {})[frame] = box
    return lives
