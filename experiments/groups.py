"""Annotated groups of pedestrians, found among true positions and from a filter, with a grid over
both thresholds.

seq_eth and zara01, people seen from above every 0.4 s, and for groups by pairs a simulated tram
stop and square (`experiments.walked_scenes`). Detections are simulated from the annotated
positions: noise of 0.2 m, one of ten missed, Poisson clutter over the walked ground. The GM-PHD
filter on the plane has these rates and default settings otherwise; it runs once per seed and its
people are grouped under every pair of thresholds. No threshold is chosen: E13's own 2 m and 1 m/s
are marked. Of groups by pairs one setting is judged on places that were left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from experiments.common import Options, in_parallel, need_data, table, with_error, write
from experiments.group_scores import GroupScores, LabelledFrame, nearest, score_groups
from experiments.walked_scenes import MARGIN, SIMULATED, WalkedScene, simulated
from phdtrack import config, pipeline
from phdtrack.config import build_groups
from phdtrack.formats.known_positions import KnownPositions, read_positions
from phdtrack.groups.clusters import Grouping
from phdtrack.groups.group_stages import carriers, on_ground
from phdtrack.groups.life_cycle import GroupLifeCycle, LifeCycleState
from phdtrack.groups.pairs import Pairs, PairState, Walkers
from phdtrack.protocols import AnyStages
from phdtrack.run.position_groups import BODY, GAIT
from phdtrack.types import F8, I8, Detections, GaussianMixture, SequenceInfo, Step, Tracks

# Frames per second of the annotated video; every sixth and every tenth is annotated.
SEQUENCES = {"seq_eth": 15.0, "zara01": 25.0}
INTERVAL = 0.4
SEEDS = 5
NEAR = (1.0, 1.5, 2.0, 2.5, 3.0)
SLOW = (0.25, 0.5, 0.75, 1.0, 1.5)
OWN = (2.0, 1.0)
HOLDS = (0.0, 0.5, 1.0)
# The detector: deviation in metres, detection probability, false alarms a frame.
NOISE = 0.2
DETECTION = 0.9
CLUTTER = 0.5
# Parts of a sequence that are overlaid for a crowd.
CROWD = 3
# States farther than this from all true positions are false, metres.
WITHIN = 1.0
# `Pairs.path` that the left-out figures choose among: the default, evidence by seconds alone, as it
# was before, half and twice the default.
SECONDS = 1e-6
PATHS = (Pairs().path, SECONDS, Pairs().path / 2, 2 * Pairs().path)
# Scores of groups by pairs, by kind of people, and whether only past and present frames count.
PairScores = dict[tuple[str, str], GroupScores]


@dataclass(frozen=True, slots=True)
class PairOutcome:
    """Groups by pairs of one run: ``scores`` with default settings; F1 of all frames by kind of
    people and `Pairs.path` in ``tried``.
    """

    scores: PairScores
    tried: dict[tuple[str, float], float]


def known_people(state: F8) -> GaussianMixture:
    """People whose position and velocity (4, n) are known: weight 1 each, as wide as a body."""
    n = state.shape[1]
    cov = np.diag(np.array([BODY, BODY, GAIT, GAIT]) ** 2)
    return GaussianMixture(np.ones(n), state, np.tile(cov, (n, 1, 1)))


def read_groups(path: Path) -> tuple[tuple[int, ...], ...]:
    """The groups of a ``groups.txt`` of ETH and UCY: identities, a group a line. Lines that share
    people are one group.
    """
    found: list[set[int]] = []
    for text in path.read_text(encoding="utf-8").splitlines():
        line = {int(word) for word in text.split()}
        linked = [group for group in found if group & line]
        found = [*(group for group in found if group not in linked), line.union(*linked)]
    return tuple(tuple(sorted(group)) for group in found if group)


@dataclass(frozen=True, slots=True)
class GroupRun:
    """One run: a sequence and the seed of its detections; seed −1: the true positions."""

    sequence: str
    seed: int


@dataclass(frozen=True, slots=True)
class KnownPeople:
    """Accuracy of the people: the ``share`` of the annotated people found within `WITHIN`, the
    number of ``false`` ones a frame, and the root mean squared errors in ``place`` (m) and
    ``velocity`` (m/s) of those found.
    """

    share: float
    false: float
    place: float
    velocity: float


@dataclass(frozen=True, slots=True)
class GroupOutcome:
    """``people``: accuracy of each kind of people, by name; ``grid``: scores of frames for each
    pair of thresholds; ``held``: scores of groups over time with E13's thresholds, by kind of
    people with an identity and hold time; ``pairs``: groups by pairs.
    """

    people: dict[str, KnownPeople]
    grid: dict[tuple[float, float], GroupScores]
    held: dict[tuple[str, float], GroupScores]
    pairs: PairOutcome


@dataclass(frozen=True, slots=True, eq=False)
class People:
    """The people of one frame: ``member`` (n,) identities, ``place`` (2, n) metres, and the
    Gaussian of each, −1 for none.
    """

    member: I8
    place: F8
    carrier: I8


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The estimates in one frame: Gaussians, and people by kind; the first kind is grouped in each
    frame alone, the others, which have identities, over time.
    """

    mixture: GaussianMixture
    people: dict[str, People]


KNOWN = "true positions"
STATES = "states"
ONLINE = "online rows"
CORRECTED = "corrected tracks"
IN_CROWD = "true positions, in a crowd"


@lru_cache(maxsize=2)
def scene(name: str) -> WalkedScene:
    """A sequence with its groups."""
    folder = need_data() / "groups" / name
    people = read_positions(folder / "obsmat.txt")
    number = np.unique(people.frame)
    return WalkedScene(
        people,
        membership(people.identity, read_groups(folder / "groups.txt")),
        number,
        (number - number[0]) / SEQUENCES[name],
    )


def membership(identity: I8, groups: Sequence[Sequence[int]]) -> I8:
    """(M,) the group from 1 of each identity, 0 for none."""
    of = {who: number for number, group in enumerate(groups, start=1) for who in group}
    return np.array([of.get(who, 0) for who in identity.tolist()], np.int64)


def detected(
    place: F8, region: tuple[float, float, float, float], rng: np.random.Generator
) -> Detections:
    """Detections in metres, with covariances, of people at ``place`` (2, n)."""
    seen = place[:, rng.random(place.shape[1]) < DETECTION]
    seen = seen + NOISE * rng.standard_normal(seen.shape)
    false = rng.uniform(np.array(region[:2]), np.array(region[2:]), (rng.poisson(CLUTTER), 2)).T
    point = np.concatenate([seen, false], axis=1).T
    point = point[rng.permutation(len(point))]
    n = len(point)
    covariance = np.tile(NOISE**2 * np.eye(4), (n, 1, 1))
    return Detections(
        np.hstack([point - 0.3, point + 0.3]), np.ones(n), np.zeros(n, np.int64), covariance
    )


def settings_of(where: WalkedScene) -> config.Settings:
    """Default settings on the ground, with the detector's own rates."""
    sets = (
        "motion.kind=plane",
        f"camera.region={list(where.region)}",
        f"sensor.detection_probability={DETECTION}",
        f"clutter.clutter_per_frame={CLUTTER}",
        # Detections in metres have no boxes that could overlap.
        "extract.merge_iou=1.0",
        # All frames are grouped at the end.
        "associate.history=0",
    )
    return config.load(None, sets)


def known(where: WalkedScene) -> list[Seen]:
    """Frames of people whose positions, velocities and identities are known."""
    out = []
    for number in where.number.tolist():
        here = where.people.at(number)
        out.append(
            Seen(
                known_people(here.state),
                {KNOWN: People(here.identity, here.state[:2], np.arange(len(here)))},
            )
        )
    return out


def filtered(where: WalkedScene, stages: AnyStages, lightest: float, seed: int) -> list[Seen]:
    """Frames from the filter: its extracted states, the confirmed online rows and the corrected
    tracks.
    """
    drawn = np.random.default_rng([seed, 1])
    rng = np.random.default_rng(seed)
    state = pipeline.start(stages, rng)
    steps: list[tuple[GaussianMixture, Step]] = []
    for k, (number, time) in enumerate(
        zip(where.number.tolist(), where.time.tolist(), strict=True), start=1
    ):
        found = detected(where.people.at(number).state[:2], where.region, drawn)
        state, step = pipeline.advance(stages, state, found, k, time, rng)
        steps.append((state.intensity, step))
    tracks = pipeline.finish(stages, state)
    out = []
    for mixture, step in steps:
        here = {
            STATES: (np.arange(len(step.estimates)), step.estimates.state[:2]),
            ONLINE: _rows(step.tracks.select(step.tracks.confirmed)),
            CORRECTED: _rows(tracks.select(tracks.frame == step.number)),
        }
        people = {
            name: People(who, at, carriers(mixture, at, lightest))
            for name, (who, at) in here.items()
        }
        out.append(Seen(mixture, people))
    return out


def _rows(rows: Tracks) -> tuple[I8, F8]:
    return rows.identity, middles(rows)


def middles(rows: Tracks) -> F8:
    """(2, M) positions of tracks of detections in metres: the centres of their boxes."""
    return np.stack([rows.xyxy[:, 0] + rows.xyxy[:, 2], rows.xyxy[:, 1] + rows.xyxy[:, 3]]) / 2


def by_frame(where: WalkedScene, frames: Sequence[Seen], grouping: Grouping) -> GroupScores:
    """Scores of groups found in each frame alone."""
    return score_groups(_clusters(where, frames, grouping), WITHIN)


def _clusters(
    where: WalkedScene, frames: Sequence[Seen], grouping: Grouping
) -> Iterator[LabelledFrame]:
    for k, seen in enumerate(frames):
        people = next(iter(seen.people.values()))
        yield LabelledFrame(
            *_truth(where, k),
            _group(grouping.groups(seen.mixture).label, people.carrier),
            people.place,
        )


def over_time(
    where: WalkedScene, frames: Sequence[Seen], name: str, grouping: Grouping, hold: float
) -> GroupScores:
    """Scores of the groups that people of kind ``name`` have accepted."""
    return score_groups(_lives(where, frames, name, grouping, GroupLifeCycle(hold)), WITHIN)


def _lives(
    where: WalkedScene,
    frames: Sequence[Seen],
    name: str,
    grouping: Grouping,
    living: GroupLifeCycle,
) -> Iterator[LabelledFrame]:
    state = LifeCycleState()
    for k, seen in enumerate(frames):
        people = seen.people[name]
        label = grouping.groups(seen.mixture).label
        used = _group(label, people.carrier) > 0
        member = people.member[used]
        carrier = people.carrier[used]
        weight = seen.mixture.weight[carrier]
        time = float(where.time[k])
        state, accepted, _ = living.extend(state, member, label[carrier], weight, k + 1, time)
        yield LabelledFrame(*_truth(where, k), accepted, people.place[:, used])


def tracked(where: WalkedScene, seed: int) -> list[Walkers]:
    """The people of corrected tracks of the PMB filter, in every frame."""
    settings = settings_of(where)
    stages = config.build(settings, SequenceInfo(0, 0, 1 / INTERVAL, len(where.number), ""), "pmb")
    drawn = np.random.default_rng([seed, 1])
    rng = np.random.default_rng(seed)
    state = pipeline.start(stages, rng)
    for k, (number, time) in enumerate(
        zip(where.number.tolist(), where.time.tolist(), strict=True), start=1
    ):
        found = detected(where.people.at(number).state[:2], where.region, drawn)
        state, _ = pipeline.advance(stages, state, found, k, time, rng)
    seen = stages.associator.measurements(state.association)
    walkers, _ = on_ground(pipeline.finish(stages, state), seen, stages.model)
    return walkers


def known_walkers(where: WalkedScene) -> list[Walkers]:
    """The true people of every frame."""
    out = []
    for number, time in zip(where.number.tolist(), where.time.tolist(), strict=True):
        here = where.people.at(number)
        out.append(Walkers(here.identity, here.state, np.zeros((len(here), 4, 4)), time))
    return out


def folded(where: WalkedScene, times: int) -> WalkedScene:
    """A crowd: parts of the sequence at the same time, whose people are strangers to each other."""
    length = len(where.number) // times
    people = where.people
    place = np.searchsorted(where.number, people.frame)
    part = place // length
    frame = where.number[place % length]
    kept = part < times
    order = np.flatnonzero(kept)[np.lexsort((people.identity[kept], part[kept], frame[kept]))]
    apart = part[order] * (int(people.identity.max()) + 1)
    group = where.group[order]
    return WalkedScene(
        KnownPositions(frame[order], people.identity[order] + apart, people.state[:, order]),
        np.where(group > 0, group + part[order] * (int(where.group.max()) + 1), 0),
        where.number[:length],
        where.time[:length],
    )


def by_pairs(where: WalkedScene, walkers: Sequence[Walkers], labels: Iterable[I8]) -> GroupScores:
    """Scores of groups, ``labels`` (n,) of each frame, with the default life cycle."""

    def frames() -> Iterator[LabelledFrame]:
        state = LifeCycleState()
        for k, (here, label) in enumerate(zip(walkers, labels, strict=True)):
            weight = np.ones(len(label))
            time = float(where.time[k])
            state, accepted, _ = GroupLifeCycle().extend(
                state, here.identity, label, weight, k + 1, time
            )
            yield LabelledFrame(*_truth(where, k), accepted, here.mean[:2])

    return score_groups(frames(), WITHIN)


def online(walkers: Sequence[Walkers]) -> Iterator[I8]:
    """The groups of each frame from past and present frames."""
    state = PairState()
    for here in walkers:
        state, label = Pairs().extend(state, here)
        yield label


def both(where: WalkedScene, kind: str, walkers: Sequence[Walkers]) -> PairScores:
    """Scores of groups by pairs, with and without later frames."""
    return {
        (kind, "so far"): by_pairs(where, walkers, online(walkers)),
        (kind, "all"): by_pairs(where, walkers, Pairs().over_time(walkers)),
    }


def paired(people: Iterable[tuple[str, WalkedScene, Sequence[Walkers]]]) -> PairOutcome:
    """Groups by pairs of some kinds of people, with default settings and with the other `PATHS`."""
    scores: PairScores = {}
    tried = {}
    for kind, where, walkers in people:
        scores |= both(where, kind, walkers)
        tried[kind, PATHS[0]] = scores[kind, "all"].f1()
        for path in PATHS[1:]:
            labels = Pairs(path=path).over_time(walkers)
            tried[kind, path] = by_pairs(where, walkers, labels).f1()
    return PairOutcome(scores, tried)


def found_of(where: WalkedScene, frames: Sequence[Seen], name: str) -> KnownPeople:
    """The accuracy of the people of kind ``name``."""
    place = [np.zeros(0)]
    velocity = [np.zeros(0)]
    false = 0
    for k, seen in enumerate(frames):
        here = where.people.at(int(where.number[k]))
        people = seen.people[name]
        rows, columns = nearest(here.state[:2], people.place, WITHIN)
        place.append(((here.state[:2, rows] - people.place[:, columns]) ** 2).sum(axis=0))
        false += people.place.shape[1] - len(columns)
        carried = people.carrier[columns] >= 0
        means = seen.mixture.mean[2:, people.carrier[columns[carried]]]
        velocity.append(((here.state[2:, rows[carried]] - means) ** 2).sum(axis=0))
    off = np.concatenate(place)
    slip = np.concatenate(velocity)
    rms = float(np.sqrt(off.mean())), float(np.sqrt(slip.mean()))
    return KnownPeople(len(off) / len(where.people), false / len(where.number), *rms)


def _truth(where: WalkedScene, k: int) -> tuple[I8, F8]:
    """Annotated groups and places in the frame at place ``k``."""
    lo, hi = np.searchsorted(where.people.frame, [where.number[k], where.number[k] + 1])
    return where.group[lo:hi], where.people.state[:2, lo:hi]


def _group(label: I8, carrier: I8) -> I8:
    """(n,) the cluster from 1 of each person's Gaussian; 0 if there is none or its weight is too
    low.
    """
    return np.where(carrier >= 0, np.append(label, -1)[carrier] + 1, 0)


def work(job: GroupRun) -> GroupOutcome:
    """One run: the filter once, then all groupings."""
    where = scene(job.sequence)
    lightest = Grouping().min_weight
    if job.seed < 0:
        frames = known(where)
        crowd = folded(where, CROWD)
        pairs = paired(
            [(KNOWN, where, known_walkers(where)), (IN_CROWD, crowd, known_walkers(crowd))]
        )
    else:
        pairs = paired([(CORRECTED, where, tracked(where, job.seed))])
        settings = settings_of(where)
        info = SequenceInfo(0, 0, 1 / INTERVAL, len(where.number), job.sequence)
        stages = config.build(settings, info, "gm-phd")
        # As in the product: so low that one miss removes nobody.
        read = config.overlay(
            settings, {"filter": {"kind": "gm-phd"}, "groups": {"kind": "intensity"}}
        )
        grouping = build_groups(read, stages).grouping
        assert isinstance(grouping, Grouping)
        lightest = grouping.min_weight
        frames = filtered(where, stages, lightest, job.seed)
    grid = {
        (near, slow): by_frame(where, frames, Grouping(near, slow, lightest))
        for near in NEAR
        for slow in SLOW
    }
    names = tuple(frames[0].people)
    held = {
        (name, hold): over_time(where, frames, name, Grouping(*OWN, lightest), hold)
        for name in names
        if name != STATES
        for hold in HOLDS
    }
    return GroupOutcome({name: found_of(where, frames, name) for name in names}, grid, held, pairs)


def simulated_pairs(job: GroupRun) -> PairOutcome:
    """Groups by pairs in a simulated place, one for each seed."""
    where = simulated(job.sequence, job.seed)
    return paired(
        [(KNOWN, where, known_walkers(where)), (CORRECTED, where, tracked(where, job.seed))]
    )


def main(options: Options) -> Path:
    """Run everything and write groups.md."""
    seeds = options.number(SEEDS, 1)
    names = tuple(SEQUENCES)[: 1 if options.quick else None]
    jobs = [GroupRun(name, seed) for name in names for seed in range(-1, seeds)]
    outcomes = dict(zip(jobs, in_parallel(work, jobs, "groups", options), strict=True))
    places = [GroupRun(name, seed) for name in SIMULATED for seed in range(seeds)]
    found = in_parallel(simulated_pairs, places, "groups, simulated", options)
    return write(
        "groups", options, **figures(outcomes, dict(zip(places, found, strict=True)), seeds)
    )


def figures(
    outcomes: dict[GroupRun, GroupOutcome], places: dict[GroupRun, PairOutcome], seeds: int
) -> dict[str, object]:
    """The values of the page's placeholders."""
    sources = _sources(outcomes, seeds)
    by_place = [(name, [out.pairs for out in found]) for name, _, found in sources]
    by_place += [
        (name, [out for run, out in places.items() if run.sequence == name]) for name in SIMULATED
    ]
    left = left_out(tried_by_place(by_place))
    return {
        "seeds": seeds,
        "noise": NOISE,
        "detection": DETECTION,
        "clutter": CLUTTER,
        "margin": MARGIN,
        "within": WITHIN,
        "scenes": table(
            ("sequence", "frames", "people", "groups", "pairs in all frames"),
            [_size(name) for name in dict.fromkeys(job.sequence for job in outcomes)],
        ),
        "people": table(
            ("sequence", "people", "found", "false a frame", "place, m", "velocity, m/s"),
            [
                (name, kind, *_known_by(kind, found))
                for name, _, found in sources
                for kind in found[0].people
            ],
        ),
        "grids": "\n".join(
            f"### {name}, {source}\n\n{_grid(found)}" for name, source, found in sources
        ),
        "pairs": table(
            (
                "sequence",
                "people",
                "by what was seen",
                "F1",
                "precision",
                "recall",
                "identity switches",
            ),
            [row for name, runs in by_place for row in _pair_rows(name, runs)],
        ),
        "paths": ", ".join(_path(path) for path in PATHS),
        "left_out": _left_out_table(left),
        "mean_default": f"{np.mean([one.default for one in left]):.3f}",
        "mean_left_out": f"{np.mean([one.left_out for one in left]):.3f}",
        "crowd": CROWD,
        "lives": table(
            ("sequence", "people", "hold, s", "F1", "precision", "recall", "identity switches"),
            [
                (
                    name,
                    kind,
                    f"{hold:g}",
                    *_means([out.held[kind, hold] for out in found]),
                    _switches(found, kind, hold),
                )
                for name, _, found in sources
                for kind, hold in found[0].held
            ],
        ),
        "own": "{:g} m and {:g} m/s".format(*OWN),
        "compared": _compared_table(sources),
    }


@dataclass(frozen=True, slots=True)
class LeftOut:
    """F1 of one kind of people in a place: with the ``default`` settings, and with the ``path``
    that is best in the other places.
    """

    place: str
    kind: str
    default: float
    path: float
    left_out: float


# F1 of all frames, the mean over the seeds, by place, kind of people and `Pairs.path`.
Tried = dict[tuple[str, str, float], float]


def tried_by_place(by_place: Iterable[tuple[str, Sequence[PairOutcome]]]) -> Tried:
    """The means over the runs of each place."""
    return {
        (name, kind, path): float(np.mean([run.tried[kind, path] for run in runs]))
        for name, runs in by_place
        for kind, path in runs[0].tried
    }


def left_out(tried: Tried) -> list[LeftOut]:
    """For each place the path with the highest mean F1 over the kinds of people in the others, and
    what it gives in this one; of equal ones the first.
    """
    out = []
    for place, kind in dict.fromkeys((place, kind) for place, kind, _ in tried):
        others = dict.fromkeys((name, who) for name, who, _ in tried if name != place)
        best = max(PATHS, key=lambda path: sum(tried[name, who, path] for name, who in others))
        scores = tried[place, kind, PATHS[0]], tried[place, kind, best]
        out.append(LeftOut(place, kind, scores[0], best, scores[1]))
    return out


def _path(path: float) -> str:
    return "by seconds alone" if path == SECONDS else f"{path:g} m"


def _left_out_table(found: Sequence[LeftOut]) -> str:
    return table(
        ("sequence", "people", "F1, defaults", "chosen on the others", "F1, left out"),
        [
            (one.place, one.kind, f"{one.default:.3f}", _path(one.path), f"{one.left_out:.3f}")
            for one in found
        ],
    )


def _compared_table(sources: Sequence[tuple[str, str, list[GroupOutcome]]]) -> str:
    """F1 with E13's thresholds and with the best ones; precision and recall with E13's."""
    rows = []
    for name, source, found in sources:
        grid = {
            thresholds: float(np.mean([out.grid[thresholds].f1() for out in found]))
            for thresholds in found[0].grid
        }
        near, slow = max(grid, key=lambda thresholds: grid[thresholds])
        own = _means([out.grid[OWN] for out in found])
        rows.append((name, source, *own, f"{near:g} m, {slow:g} m/s", f"{grid[near, slow]:.3f}"))
    return table(
        ("sequence", "people", "F1", "precision", "recall", "best in the grid", "F1 there"), rows
    )


def _sources(
    outcomes: dict[GroupRun, GroupOutcome], seeds: int
) -> list[tuple[str, str, list[GroupOutcome]]]:
    """Sequence, source of the people, and the outcomes of all seeds."""
    out = []
    for name in dict.fromkeys(job.sequence for job in outcomes):
        out.append((name, "true positions and velocities", [outcomes[GroupRun(name, -1)]]))
        out.append((name, "filtered", [outcomes[GroupRun(name, seed)] for seed in range(seeds)]))
    return out


def _known_by(kind: str, found: Sequence[GroupOutcome]) -> list[str]:
    parts = [out.people[kind] for out in found]
    return [
        with_error([getattr(part, name) for part in parts], digits)
        for name, digits in (("share", 3), ("false", 2), ("place", 3), ("velocity", 3))
    ]


def _grid(found: Sequence[GroupOutcome]) -> str:
    """F1, with precision and recall, for each pair of thresholds; E13's own in bold."""
    rows = []
    for near in NEAR:
        cells = []
        for slow in SLOW:
            scores = [outcome.grid[near, slow] for outcome in found]
            precision = np.mean([one.precision() for one in scores])
            recall = np.mean([one.recall() for one in scores])
            cell = f"{with_error([one.f1() for one in scores])} ({precision:.2f}, {recall:.2f})"
            cells.append(f"**{cell}**" if (near, slow) == OWN else cell)
        rows.append((f"{near:g} m", *cells))
    return table(("T_p, T_v", *(f"{slow:g} m/s" for slow in SLOW)), rows)


def _means(found: Sequence[GroupScores]) -> tuple[str, str, str]:
    """F1, precision and recall."""
    return (
        with_error([scores.f1() for scores in found]),
        with_error([scores.precision() for scores in found]),
        with_error([scores.recall() for scores in found]),
    )


def _switches(found: Sequence[GroupOutcome], kind: str, hold: float) -> str:
    return with_error([float(outcome.held[kind, hold].switches) for outcome in found], 1)


def _pair_rows(name: str, found: Sequence[PairOutcome]) -> list[tuple[str, ...]]:
    """A row of the table of groups by pairs for each kind of people, of some runs."""
    return [
        (
            name,
            kind,
            when,
            *_means([out.scores[kind, when] for out in found]),
            with_error([float(out.scores[kind, when].switches) for out in found], 1),
        )
        for kind, when in found[0].scores
    ]


def _size(name: str) -> tuple[object, ...]:
    where = scene(name)
    groups = len(np.unique(where.group[where.group > 0]))
    pairs = sum(_pairs(_truth(where, k)[0]) for k in range(len(where.number)))
    return name, len(where.number), len(np.unique(where.people.identity)), groups, pairs


def _pairs(group: I8) -> int:
    """Number of pairs in one frame that are in one group."""
    size = np.bincount(group[group > 0])
    return int((size * (size - 1)).sum()) // 2
