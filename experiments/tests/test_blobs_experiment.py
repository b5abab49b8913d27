"""The meetings of the experiment with blobs: their video, detections and scores."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.common import Case
from experiments.meetings import (
    APART,
    ASPECT,
    PARTINGS,
    TALL,
    Leave,
    Parting,
    filmed,
    leaving,
    meeting,
    touching,
)
from phdtrack.types import I8, Tracks


@pytest.fixture(scope="module", params=PARTINGS)
def case(request: pytest.FixtureRequest) -> Case:
    return filmed((request.param, 3))


def centres(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """The horizontal positions of both people in the frames that show both."""
    truth = case.truth
    both = np.intersect1d(truth.frame[truth.identity == 1], truth.frame[truth.identity == 2])
    one, two = (truth.xyxy[(truth.identity == who) & np.isin(truth.frame, both)] for who in (1, 2))
    return one[:, [0, 2]].mean(axis=1), two[:, [0, 2]].mean(axis=1)


@pytest.mark.parametrize("parting", PARTINGS)
@pytest.mark.parametrize("seed", range(3))
def test_two_meet_walk_as_one_and_part(parting: Parting, seed: int) -> None:
    one, two = centres(filmed((parting, seed), detector=False))
    distance = two - one
    wide = ASPECT * TALL
    assert distance[0] > 3 * wide
    assert abs(distance[-1]) > 3 * wide
    # Who crosses leaves on the other side.
    assert (distance[-1] < 0) == (parting == "crossing")
    together = (np.abs(distance) < (APART[1] + 0.1) * wide).sum() / 25
    assert meeting(parting, seed).together - 0.5 < together < meeting(parting, seed).together + 1.0


def test_the_detector_sees_two_then_one_then_two(case: Case) -> None:
    first, last = touching(case.truth)
    count = np.array([len(case.table.at(number)) for number in range(1, case.info.frames + 1)])
    assert np.median(count[first - 25 : first - 5]) == 2
    assert (count[first + 10 : last - 10] == 1).mean() > 0.5
    assert np.median(count[last + 5 : last + 20]) == 2


def named(case: Case, identity: I8) -> Tracks:
    """Tracks where the truth is, of other names."""
    n = len(case.truth)
    truth = case.truth
    return Tracks(
        truth.frame, identity, truth.xyxy, np.ones(n), np.full(n, -1), np.ones(n, np.bool_)
    )


def test_identities_after_a_blob_are_kept_apart(case: Case) -> None:
    true = case.truth.identity
    frame = case.truth.frame
    late = frame > touching(case.truth)[1] - 5
    expected: dict[Leave, I8] = {
        "right": true + 4,
        "swapped": np.where(late, 3 - true, true),
        "new": np.where(late & (true == 2), 9, true),
    }
    for leave, identity in expected.items():
        assert leaving(case, named(case, identity)) == leave
    rows = named(case, true)
    assert leaving(case, rows.select(~late | (true == 1))) == "lost"
