"""The detector that is simulated from annotated positions, and the pairs that count as together."""

from pathlib import Path

import numpy as np
import pytest

from experiments.groups import (
    CLUTTER,
    DETECTION,
    KNOWN,
    NOISE,
    PATHS,
    PairOutcome,
    People,
    Seen,
    both,
    by_frame,
    detected,
    found_of,
    known,
    known_walkers,
    left_out,
    membership,
    over_time,
    paired,
    read_groups,
    tried_by_place,
)
from experiments.walked_scenes import SIMULATED, WalkedScene, simulated
from phdtrack.formats.known_positions import KnownPositions
from phdtrack.groups.clusters import Grouping


def two_walks() -> WalkedScene:
    """Two frames: 1 and 2 walk together, 3 stands beside them, 4 is far away."""
    state = np.array([[0.0, 1.0, 1.0, 40.0], [0, 0, 1, 0], [1.2, 1.2, 0.0, 1.2], [0, 0, 0, 0]])
    people = KnownPositions(np.repeat([10, 16], 4), np.tile([1, 2, 3, 4], 2), np.tile(state, 2))
    return WalkedScene(
        people, membership(people.identity, [(1, 2)]), np.array([10, 16]), np.array([0.0, 0.4])
    )


def test_lines_of_identities_that_share_people_are_one_group(tmp_path: Path) -> None:
    path = tmp_path / "groups.txt"
    path.write_text("1 2\n\n 3 4 \n5 6\n4 1\n7 7\n")
    assert sorted(read_groups(path)) == [(1, 2, 3, 4), (5, 6), (7,)]


def test_the_detector_has_the_stated_rates_and_noise() -> None:
    rng = np.random.default_rng(0)
    place = np.tile([[100.0], [100.0]], 20)
    frames = [detected(place, (0.0, 0.0, 10.0, 10.0), rng) for _ in range(500)]
    middle = np.concatenate([(found.xyxy[:, :2] + found.xyxy[:, 2:]) / 2 for found in frames])
    true = middle[:, 0] > 50
    assert abs(true.sum() / 10000 - DETECTION) < 4 * (DETECTION * (1 - DETECTION) / 10000) ** 0.5
    assert abs((~true).sum() / 500 - CLUTTER) < 4 * (CLUTTER / 500) ** 0.5
    assert abs(middle[true].std() - NOISE) < 4 * NOISE / (4 * true.sum()) ** 0.5
    assert (middle[~true] >= 0).all()
    assert (middle[~true] <= 10).all()
    assert frames[0].covariance is not None
    assert np.allclose(frames[0].covariance[:, 0, 0], NOISE**2)


def test_true_positions_are_grouped_by_place_and_velocity() -> None:
    scene = two_walks()
    frames = known(scene)
    assert by_frame(scene, frames, Grouping(2.0, 1.0)).f1() == 1.0
    # Who stands beside them belongs to them once his velocity does not count: two of three pairs
    # are false.
    loose = by_frame(scene, frames, Grouping(2.0, 5.0))
    assert (loose.true_positives, loose.false_positives) == (2, 4)
    assert by_frame(scene, frames, Grouping(0.5, 1.0)).recall() == 0.0


def test_groups_over_time_keep_their_identity() -> None:
    scores = over_time(two_walks(), known(two_walks()), KNOWN, Grouping(2.0, 1.0), hold=0.5)
    assert (scores.f1(), scores.switches) == (1.0, 0)


def test_people_who_are_known_have_no_errors() -> None:
    found = found_of(two_walks(), known(two_walks()), KNOWN)
    assert (found.share, found.false, found.place, found.velocity) == (1.0, 0.0, 0.0, 0.0)


def test_who_is_elsewhere_is_false_and_missed() -> None:
    frames = known(two_walks())
    first = frames[0].people[KNOWN]
    far = People(first.member, first.place + [[0.5], [5.0]] * np.array([1, 1, 1, 0]), first.carrier)
    found = found_of(two_walks(), [Seen(frames[0].mixture, {KNOWN: far}), frames[1]], KNOWN)
    assert (found.share, found.false) == (5 / 8, 1.5)


@pytest.mark.parametrize("name", SIMULATED)
def test_simulated_companies_stay_together(name: str) -> None:
    """And strangers keep their distance; the same seed gives the same people."""
    where = simulated(name, 7, duration=60.0)
    again = simulated(name, 7, duration=60.0)
    assert np.array_equal(where.people.state, again.people.state)
    apart = []
    strangers = []
    for number in where.number.tolist():
        lo, hi = np.searchsorted(where.people.frame, [number, number + 1])
        x, y = where.people.state[:2, lo:hi]
        group = where.group[lo:hi]
        i, j = np.triu_indices(hi - lo, 1)
        distance = np.hypot(x[i] - x[j], y[i] - y[j])
        same = (group[i] == group[j]) & (group[i] > 0)
        apart.append(distance[same])
        strangers.append(distance[~same])
    assert np.median(np.concatenate(apart)) < 1.2
    assert np.mean(np.concatenate(strangers) < 0.35) < 0.02


def test_groups_are_found_on_a_simulated_square() -> None:
    where = simulated("square", 12, duration=80.0)
    scores = both(where, "people", known_walkers(where))
    assert scores["people", "all"].f1() > 0.84
    assert scores["people", "so far"].f1() > 0.8


def test_a_left_out_place_does_not_choose_its_setting() -> None:
    """The last path is by far the best in the first place, the second one in all others."""
    best = {"here": PATHS[-1], "there": PATHS[1], "yonder": PATHS[1]}
    by_place = [
        (name, [PairOutcome({}, {("people", path): 0.5 + 0.3 * (path == at) for path in PATHS})])
        for name, at in best.items()
    ]
    found = {one.place: one for one in left_out(tried_by_place(by_place))}
    assert (found["here"].path, found["here"].left_out) == (PATHS[1], 0.5)
    assert found["here"].default == 0.5
    # "here" and "yonder" are even, and the first path of those wins.
    assert found["there"].path == PATHS[1]


def test_the_first_path_is_the_default_one() -> None:
    where = simulated("stop", 7, duration=40.0)
    found = paired([("people", where, known_walkers(where))])
    assert found.tried["people", PATHS[0]] == found.scores["people", "all"].f1()
    assert {path for _, path in found.tried} == set(PATHS)
