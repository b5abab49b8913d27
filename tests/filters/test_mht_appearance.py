"""What boxes look like as evidence in the PMBM and the MHT filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mht_cases import EVERYTHING, boxes, partitions, told, world

from appearance_cases import TURN, D, prototypes, turned_rightly
from phdtrack.filters import PMBM
from phdtrack.filters.hypotheses import Hypotheses
from phdtrack.kernels.appearance import Law, Looks
from phdtrack.types import F8, UpdateInfo
from reference import appearance_twin as twin
from reference.mht_twin import enumerate_histories, summed

RNG = np.random.default_rng(0)
LAW = Law(0.7, 0.8, -0.05, 0.12, 0.0, 0.2, 0.4, 0.6, 0.15, 0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 60.0)
LOOKS = prototypes(6)
# Two targets that cross, seen three times: in the second scan they are in one place.
CROSSING = [
    boxes((290, 200), (310, 200)),
    boxes((299, 200), (301, 200)),
    boxes((310, 202), (290, 198)),
]
# Who each measurement is of; −1: nobody, who looks like nothing known.
WHO = [(0, 1), (1, 0), (1, 0)]
SCENES = {
    "two that cross": (CROSSING, WHO),
    "one of them is missed": (
        [CROSSING[0], CROSSING[1][:, :1], CROSSING[2]],
        [WHO[0], (0,), (0, 1)],
    ),
    "unknown when they meet": (CROSSING, [(0, 1), (-1, -1), (1, 0)]),
    "a third one comes": (
        [boxes((300, 200)), boxes((303, 199), (310, 205)), boxes((308, 202), (313, 203))],
        [(0,), (2, 0), (0, 2)],
    ),
}


def seen(who: tuple[int, ...], k: int) -> Looks:
    """The looks of a scan, at k seconds: each is free in part."""
    rng = np.random.default_rng([k, len(who)])
    raw = np.array([LOOKS[one] if one >= 0 else np.zeros(D) for one in who]).reshape(-1, D)
    raw = raw + rng.normal(0, 0.1, raw.shape) * (np.array(who) >= 0)[:, None]
    raw /= np.maximum(np.linalg.norm(raw, axis=1), 1e-9)[:, None]
    mean = LOOKS.mean(axis=0) / 2
    known = np.array(who) >= 0
    direction = np.array([twin.direction(row, mean) for row in raw]).reshape(-1, D)
    return Looks(
        raw.astype(np.float32),
        (direction * known[:, None]).astype(np.float32),
        mean.astype(np.float32),
        np.where(known, rng.uniform(0.4, 1, len(who)), 0.0),
        LAW,
        float(k),
        2.0,
    )


def tracked(
    filter_: PMBM, scans: list[F8], looks: list[Looks]
) -> tuple[Hypotheses, list[UpdateInfo]]:
    """The last state, and what each update brought."""
    model = world()
    state = filter_.start(model, RNG)
    infos = []
    for z, here in zip(scans, looks, strict=True):
        state, info = filter_.step(state, z, replace(model, appearance=here), 1.0, RNG)
        infos.append(info)
    return state, infos


def ratio_of(taken: tuple[tuple[int, int], ...], looks: list[Looks]) -> tuple[float, object]:
    """The log-likelihood ratio of a track's measurements, one after the other, and its past."""
    past = None
    total = 0.0
    for k, j in taken:
        total += twin.pair_ratio(past, j, looks[k])
        past = twin.followed_by(past, j, looks[k])
    return total, past


@pytest.mark.parametrize(
    "name", [pytest.param("two that cross", marks=pytest.mark.slow), *list(SCENES)[1:]]
)
def test_hypotheses_are_weighed_by_their_pasts(name: str):
    """Every history by enumeration, times the likelihood ratios of its tracks."""
    scans, who = SCENES[name]
    looks = [seen(one, k) for k, one in enumerate(who)]
    histories = [
        (weight * np.exp(sum(ratio_of(track.taken, looks)[0] for track in tracks)), false, tracks)
        for weight, false, tracks in enumerate_histories(scans, world(), 1.0)
    ]
    wanted, there, _ = summed(histories)
    state, infos = tracked(EVERYTHING, scans, looks)
    found = partitions(state, scans)
    assert found.keys() == wanted.keys()
    for key, (weight, leaves) in found.items():
        assert weight == pytest.approx(wanted[key], rel=1e-4), key
        for sequence, leaf in leaves.items():
            assert state.leaves.r[leaf] == pytest.approx(there.get((key, sequence), 0.0), rel=1e-4)
            _, past = ratio_of(sequence, looks)
            place = state.leaves.past[leaf]
            assert (place < 0) == (past is None)
            if past is not None:
                np.testing.assert_allclose(state.pasts.looks[place, 0], past.mean(2.0), atol=1e-5)
                assert state.pasts.rows["number"][place] == pytest.approx(past.number)
    last = len(scans) - 1
    total = sum(weight for weight, *_ in histories)
    false = [
        sum(weight for weight, alarms, _ in histories if (last, j) in alarms) / total
        for j in range(scans[-1].shape[1])
    ]
    np.testing.assert_allclose(infos[-1].clutter_probability, false, rtol=1e-4)


def test_looks_decide_which_crossing_is_the_best():
    """By motion they go on; if the looks say so, they have turned round."""
    straight = [seen(one, k) for k, one in enumerate([(0, 1), (0, 1), (0, 1)])]
    turned = [seen(one, k) for k, one in enumerate([(0, 1), (-1, -1), (1, 0)])]
    model = replace(world(), appearance=turned[-1])
    firsts = []
    for looks in (straight, turned):
        scans = [CROSSING[0], boxes((300, 200), (300, 200)), CROSSING[2]]
        state, _ = tracked(EVERYTHING, scans, looks)
        estimates = told(state, model)
        at = estimates.tag.argsort()
        firsts.append(estimates.detection[at].tolist())
        assert estimates.appearance.shape == (2, D)
        assert (estimates.appearance_count >= 1).all()
        assert np.isin(estimates.tag, estimates.followed).all()
    assert firsts == [[0, 1], [1, 0]]


def test_verdicts_do_not_look_at_appearance():
    """Two far from each other are sure, whatever they look like; two in one place are not."""
    scans = [boxes((220, 200), (380, 200)), boxes((221, 200), (379, 200))]
    for who in ((0, 1), (1, 0), (-1, -1)):
        looks = [seen(one, k) for k, one in enumerate([(0, 1), who])]
        _, infos = tracked(replace(EVERYTHING, gate_probability=0.9999998), scans, looks)
        assert len(infos[0].sure) == 0
        np.testing.assert_array_equal(infos[1].sure, [[0, 0], [1, 1]])
    looks = [seen(one, k) for k, one in enumerate(WHO)]
    _, infos = tracked(EVERYTHING, CROSSING, looks)
    assert not (infos[1].sure[:, 1] >= 0).any()


def test_a_missed_target_stays_known():
    scans = [*[boxes((300 + k, 200)) for k in range(4)], boxes()]
    looks = [seen((0,) * z.shape[1], k) for k, z in enumerate(scans)]
    state, infos = tracked(EVERYTHING, scans, looks)
    assert infos[3].sure.tolist() == [[0, 0]]
    assert set(infos[4].sure[:, 1].tolist()) <= {-1}
    assert state.pasts.rows["time"][state.leaves.past[state.leaves.past >= 0]].max() == 3.0


@pytest.mark.parametrize("filter_", ["mht", "pmbm"])
def test_looks_tell_who_came_out_where(filter_: str):
    """Without them half of the scenes are right, by chance."""
    hidden = range(TURN - 10, TURN)
    kind = {"filter": {"kind": filter_}}
    assert turned_rightly(hidden, 30.0, 8, **kind) == 8
    assert turned_rightly(hidden, 30.0, 8, **kind, appearance={"kind": "none"}) <= 6
