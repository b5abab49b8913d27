"""Groups among people whose positions are known, without a video, a detector or a filter."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack

import numpy as np

from phdtrack.formats.known_positions import KnownPositions
from phdtrack.formats.write import Lines
from phdtrack.groups.group_stages import GroupFrame, GroupStages
from phdtrack.groups.life_cycle import LifeCycleState
from phdtrack.groups.pairs import Pairs, Walkers
from phdtrack.run.directory import RunDirectory
from phdtrack.run.grouping import TABLES, write_frame
from phdtrack.types import F8, GaussianMixture

# Deviations of a person whose position and velocity are known, metres and metres per second: body
# width, gait.
BODY = 0.3
GAIT = 0.1
# Seconds before and after, in which a person's positions give the velocity where a file has none.
SLOPE = 0.5


def group_positions(
    people: KnownPositions, fps: float, stages: GroupStages, directory: RunDirectory
) -> dict[str, object]:
    """Find the groups of all frames, and write them as ``phdtrack groups`` does.

    Parameters
    ----------
    people : who is where, in which frame.
    fps : frames per second of the frame numbers.
    stages : what makes groups.
    directory : of the files, which are those of `TABLES`.

    Returns
    -------
    Mean numbers of people and groups, the number of groups, and of events of each kind.
    """
    frames = walkers_of(people, fps)
    known = [np.zeros((len(one.identity), 4, 4)) for one in frames]
    exact = [one._replace(covariance=none) for one, none in zip(frames, known, strict=True)]
    numbers = np.unique(people.frame).tolist()
    labels = None
    if isinstance(stages.grouping, Pairs):
        labels = stages.grouping.over_time(exact)
    found = list[GroupFrame]()
    state = LifeCycleState()
    with ExitStack() as files:
        tables = {name: files.enter_context(Lines(directory.file(name))) for name in TABLES}
        for name, head in TABLES.items():
            tables[name].write(head)
        for k, (number, one) in enumerate(zip(numbers, frames, strict=True)):
            weight = np.ones(len(one.identity))
            if labels is not None:
                state, frame = stages.people(state, one, labels[k], weight, number)
            else:
                mixture = GaussianMixture(weight, one.mean, one.covariance)
                carrier = np.arange(len(weight))
                state, frame = stages.advance(
                    state, mixture, one.identity, carrier, number, one.time
                )
            write_frame(frame, tables, None)
            found.append(frame)
    return _summary(found)


def walkers_of(people: KnownPositions, fps: float) -> list[Walkers]:
    """The people of each frame that has any, as wide as a body.

    Parameters
    ----------
    people : who is where, in which frame.
    fps : frames per second.
    """
    velocity = people.state[2:].copy()
    unknown = ~np.isfinite(velocity).all(axis=0)
    velocity[:, unknown] = _slopes(people, fps)[:, unknown]
    number, first = np.unique(people.frame, return_index=True)
    ends = [*first[1:], len(people)][: len(first)]
    covariance = np.diag(np.array([BODY, BODY, GAIT, GAIT]) ** 2)
    return [
        Walkers(
            people.identity[a:b],
            np.vstack([people.state[:2, a:b], velocity[:, a:b]]),
            np.tile(covariance, (b - a, 1, 1)),
            float(frame - number[0]) / fps,
        )
        for frame, a, b in zip(number.tolist(), first, ends, strict=True)
    ]


def _slopes(people: KnownPositions, fps: float) -> F8:
    """(2, M) velocities in metres per second: slopes of lines through a person's positions within
    `SLOPE` seconds, and at least through those of the neighbouring frames; 0 if there is one only.
    """
    velocity = np.zeros((2, len(people)))
    for one in np.unique(people.identity):
        rows = np.flatnonzero(people.identity == one)
        time = people.frame[rows] / fps
        for k, row in enumerate(rows):
            near = np.abs(time - time[k]) <= SLOPE
            near[max(0, k - 1) : k + 2] = True
            offset = time[near] - time[near].mean()
            if len(offset) > 1:
                place = people.state[:2, rows[near]]
                velocity[:, row] = (place * offset).sum(axis=1) / (offset**2).sum()
    return velocity


def _summary(frames: list[GroupFrame]) -> dict[str, object]:
    kinds = Counter(event.kind for frame in frames for event in frame.events)
    identities = {identity for frame in frames for identity in frame.identity.tolist()} - {0}
    return {
        "frames": len(frames),
        "people_mean": float(np.mean([frame.people for frame in frames])) if frames else None,
        "groups_mean": float(np.mean([frame.named for frame in frames])) if frames else None,
        "identities": len(identities),
        "events": {kind: kinds[kind] for kind in ("appear", "vanish", "merge", "split")},
        "warnings": sum(len(frame.warnings) for frame in frames),
    }
