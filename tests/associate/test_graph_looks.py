"""What states look like as evidence for links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from association_cases import links, matching_of, model_of, open_edges, seen_as, states
from hypothesis import given, settings
from hypothesis import strategies as st

from appearance_cases import TURN, D, frame_of, prototypes, tracker_of, turned_rightly
from phdtrack.associate.graph import GraphMatching, GraphState
from phdtrack.kernels.appearance import Law, Looks
from phdtrack.types import Appeared, Estimates, UpdateInfo
from reference import appearance_twin as twin
from reference.graph_twin import gains

LAW = Law(0.7, 0.8, -0.05, 0.12, 0.0, 0.2, 0.4, 0.6, 0.15, 0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 60.0)
PEOPLE = prototypes(6)
SEEDS = st.integers(0, 2**32 - 1)


def looks_of(who: list[int], k: int, law: Law = LAW) -> Looks:
    """Views of people at frame k, at 25 frames a second; −1: nothing is known."""
    rng = np.random.default_rng([k, len(who)])
    known = np.array(who, np.int64) >= 0
    raw = PEOPLE[np.maximum(np.array(who, np.int64), 0)].reshape(-1, D)
    raw = (raw + rng.normal(0, 0.05, raw.shape)) * known[:, None]
    raw /= np.maximum(np.linalg.norm(raw, axis=1), 1e-9)[:, None]
    mean = PEOPLE.mean(axis=0) / 2
    seen = np.array([twin.direction(row, mean) for row in raw]).reshape(-1, D)
    free = np.where(known, 1.0, 0.0)
    return Looks(
        raw.astype(np.float32),
        (seen * known[:, None]).astype(np.float32),
        mean.astype(np.float32),
        free,
        law,
        k / 25,
        3.0,
    )


def linked(
    frames: list[Estimates], who: list[list[int]], matching: GraphMatching | None = None
) -> list[GraphState]:
    """The states after each frame."""
    matching = matching or matching_of()
    state = matching.start()
    out = []
    for k, (estimates, here) in enumerate(zip(frames, who, strict=True)):
        model = replace(model_of(), appearance=looks_of(here, k))
        z = estimates.state[[0, 1, 4, 5]]
        state, _ = matching.extend(state, estimates, z, seen_as(z), k + 1, 1.0, model)
        out.append(state)
    return out


def meeting(turned: bool) -> tuple[list[Estimates], list[list[int]]]:
    """Two at rest, whose states say nothing of where they go; at the fifth frame they are in one
    place, and may have changed sides.
    """
    side = [[100.0, 100.0], [106.0, 100.0]]
    frames = [states(side) for _ in range(5)] + [states([[103.0, 100.0]])]
    frames += [states(side) for _ in range(5)]
    who = [[0, 1]] * 5 + [[-1]] + [[1, 0] if turned else [0, 1]] * 5
    return frames, who


@pytest.mark.parametrize("turned", [False, True])
def test_looks_decide_who_came_out_where(turned: bool):
    frames, who = meeting(turned)
    found = links(linked(frames, who)[-1])
    # The vertices before are 8 and 9, 10 is both, 11 and 12 come after.
    across = {(11, 9), (12, 8)}
    straight = {(11, 8), (12, 9)}
    assert len(found & (across if turned else straight)) >= 1
    assert not found & (straight if turned else across)


def test_looks_that_are_not_known_decide_nothing():
    frames, who = meeting(turned=True)
    nobody = [[-1] * len(here) for here in who]
    plain = links(linked(frames, nobody)[-1])
    model = model_of()
    matching = matching_of()
    state = matching.start()
    for k, estimates in enumerate(frames):
        z = estimates.state[[0, 1, 4, 5]]
        state, _ = matching.extend(state, estimates, z, seen_as(z), k + 1, 1.0, model)
    assert links(state) == plain


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_gains_are_those_of_motion_and_of_looks(seed: int):
    """Each edge of two frames by the definition: the second state's own past is the first's."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 5, 2).tolist()
    frames = [states(100 + rng.uniform(0, 20, (count, 2))) for count in (n, m)]
    who = [rng.integers(-1, 6, count).tolist() for count in (n, m)]
    matching = matching_of()
    after = linked(frames, who, matching)[-1]
    # All pairs, also those that gain nothing by motion alone.
    loose = replace(matching, loose_end_distance=6.0)
    shift = 0.5 * (6.0**2 - 4.0**2)
    wanted = {}
    earlier, later = looks_of(who[0], 0), looks_of(who[1], 1)
    for (b, a), gain in gains(frames, [1.0, 1.0], loose, model_of()).items():
        past = twin.followed_by(None, a, earlier)
        total = gain - shift + twin.pair_ratio(past, b - n, later)
        if total > 0:
            wanted[b, a] = total
    found = open_edges(after.window)
    assert found.keys() == wanted.keys()
    for pair, gain in found.items():
        assert gain == pytest.approx(wanted[pair], abs=1e-4)


def test_pasts_follow_links():
    """A state's past is all that its track has seen, old ones forgotten."""
    frames = [states([[100.0 + 3 * k, 100.0]], velocity=[[3.0, 0.0]]) for k in range(8)]
    who = [[0] if k != 4 else [-1] for k in range(8)]
    past = None
    for k, state in enumerate(linked(frames, who)):
        past = twin.followed_by(past, 0, looks_of(who[k], k))
        known = state.looks
        assert past is not None
        assert len(known.past) == len(state.window.since)
        place = known.past[-1]
        np.testing.assert_allclose(known.pasts.looks[place, 0], past.mean(3.0), atol=1e-5)
        assert known.pasts.rows["time"][place] == past.time[-1]
        assert known.pasts.rows["number"][place] == pytest.approx(past.number)


def test_pasts_are_forgotten_with_the_window():
    frames = [states([[100.0, 100.0], [400.0, 100.0]]) for _ in range(120)]
    state = linked(frames, [[0, 1]] * 120)[-1]
    assert len(state.looks.past) == len(state.window.since) <= 2 * 52
    assert len(state.looks.pasts.rows) <= 2 * 52
    assert state.looks.past.min() == 0


def seen_by(estimates: Estimates) -> Appeared:
    return Appeared(looks_of([0] * len(estimates), 0), estimates, UpdateInfo.without_update(0).sure)


def test_links_without_doubt_are_verdicts():
    """Two far apart, one of them missed for a while, and two in one place."""
    matching = matching_of()
    far = [states([[100.0, 100.0], [400.0, 100.0]]) for _ in range(4)]
    state = linked(far, [[0, 1]] * 4, matching)[-1]
    appeared = matching.appeared(state, seen_by(far[-1]))
    label = appeared.estimates.tag
    np.testing.assert_array_equal(appeared.sure, np.stack([label, [0, 1]], axis=1))
    assert (appeared.estimates.appearance_count > 0).all()
    np.testing.assert_array_equal(appeared.estimates.followed, np.sort(label))

    missed = [*far, states([[100.0, 100.0]])]
    state = linked(missed, [*[[0, 1]] * 4, [0]], matching)[-1]
    appeared = matching.appeared(state, seen_by(missed[-1]))
    np.testing.assert_array_equal(appeared.sure, np.stack([label, [0, -1]], axis=1))

    close = [states([[100.0, 100.0], [101.0, 100.0]]) for _ in range(4)]
    state = linked(close, [[0, 1]] * 4, matching)[-1]
    assert len(matching.appeared(state, seen_by(close[-1])).sure) == 0


def test_verdicts_do_not_look_at_appearance():
    far = [states([[100.0, 100.0], [400.0, 100.0]]) for _ in range(4)]
    for who in ([[0, 1]] * 4, [[0, 1], [1, 0]] * 2, [[0, 0]] * 4):
        sure = linked(far, who)[-1].looks.sure
        assert sure[:, 1].tolist() == [0, 1]
        assert len(np.unique(sure[:, 0])) == 2


@pytest.mark.parametrize("filter_", ["gm-phd", "particle-phd", "none"])
def test_looks_tell_filters_without_labels(filter_: str):
    """Without looks half of the scenes are right, by chance."""
    hidden = range(TURN - 3, TURN + 2)
    kind = {"filter": {"kind": filter_}}
    assert turned_rightly(hidden, 12.0, 8, **kind) == 8
    assert turned_rightly(hidden, 12.0, 8, **kind, appearance={"kind": "none"}) <= 6


def test_lessons_are_learned_from_links():
    tracker = tracker_of(filter={"kind": "gm-phd"})
    for k in range(100):
        tracker.update(frame_of([0, 1, 2], k, PEOPLE))
    seen = tracker.state.appearance
    law = tracker.stages.appearance.law(seen.lessons)
    assert law.weight > 0.2
    assert law.same > 0.6 > 0.2 > law.other
