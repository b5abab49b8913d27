"""Missing tracks that are shown by evidence: in streams where they come back, or do not; the kernel
that counts.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from association_cases import measured, model_of, run, same
from hypothesis import given
from hypothesis import strategies as st
from test_labels import seen

from inner_kernels import from_python
from phdtrack.associate.labels import PATIENCE, REMEMBERED, Labelled, LabelledState
from phdtrack.kernels.coasting import (
    STEPS,
    Followed,
    Reported,
    after_frame,
    is_returning,
    step_of,
)
from phdtrack.state import from_bytes, to_bytes, unpack
from phdtrack.types import Estimates

MODEL = model_of()
EVIDENCE = Labelled(min_track_length=3, max_coast=0.08, coast_by_evidence=True)
SEEN = 5
GAP = 6


def lives(ends: list[str], speed: float = 5.0) -> list[Estimates]:
    """One target after the other: five detections, six frames without, then found as predicted,
    elsewhere, or never.
    """
    frames = []
    for label, end in enumerate(ends, start=1):
        frames += [seen((label, speed * k, 0 if k < SEEN else -1)) for k in range(SEEN + GAP)]
        frames += (
            [seen((label, speed * (SEEN + GAP) + {"back": 4.0, "elsewhere": 40.0}[end]))]
            if end != "never"
            else []
        )
    return frames


def shown(rows, label: int) -> int:
    """For how many frames it is shown without a detection."""
    return int((rows.predicted & (rows.identity == label)).sum())


def test_track_that_returns_as_predicted_is_shown_while_missing():
    """At 25 frames a second two frames are ``max_coast``, and five who came back outweigh it."""
    online = run(EVIDENCE, lives(["back"] * 8)).online
    assert [shown(online, label) for label in range(1, 9)] == [2] * 4 + [GAP] * 4
    assert (
        run(replace(EVIDENCE, coast_by_evidence=False), lives(["back"] * 8)).online.predicted
    ).sum() == 8 * 2
    assert not run(replace(EVIDENCE, bridge_gaps=False), lives(["back"] * 8)).online.predicted.any()


@pytest.mark.parametrize(("end", "first"), [("elsewhere", 4), ("never", 5)])
def test_who_does_not_come_back_is_not_shown(end: str, first: int):
    """Four who were found elsewhere outweigh ``max_coast``; who is never found is missing for .8 s
    before it is known.
    """
    online = run(EVIDENCE, lives([end] * 12)).online
    assert [shown(online, label) for label in range(1, 13)] == [2] * first + [0] * (12 - first)
    changed = run(EVIDENCE, lives([end] * 12 + ["back"] * 30)).online
    assert shown(changed, 42) == GAP, "a stream may change"


@pytest.mark.parametrize("interval", [25 / 120, 2.5, 25 * 300.0])
def test_frames_may_be_of_any_length(interval: float):
    """120 a second, 10 a second, one in five minutes; nothing is shown at first."""
    frames = lives(["back"] * 8, 5 * interval)
    online = run(
        replace(EVIDENCE, max_coast=0.0), frames, intervals=[interval] * len(frames)
    ).online
    assert [shown(online, label) for label in range(1, 9)] == [0] * 4 + [GAP] * 4


def test_frames_left_out_change_nothing():
    """Of the gaps every other frame is left out, from the sixth life on: what is left is shown as
    before.
    """
    frames = lives(["back"] * 10)
    kept = []
    steps = []
    for k, frame in enumerate(frames):
        place = k % (SEEN + GAP + 1)
        if k < 6 * (SEEN + GAP + 1) or not (SEEN <= place < SEEN + GAP and place % 2):
            kept.append(frame)
            steps.append(float(k - (sum(map(int, steps)) - 1)) if steps else 1.0)
    online = run(EVIDENCE, kept, intervals=steps).online
    assert [shown(online, label) for label in range(7, 11)] == [GAP // 2] * 4


def test_the_share_of_those_found_is_what_it_is_in_the_stream():
    """Of 1000 one in three is not found: within four standard errors, that of the last 200 with
    fading weights.
    """
    rng = np.random.default_rng(1)
    state = EVIDENCE.start()
    for number, estimates in enumerate(
        lives([("back", "elsewhere")[int(rng.random() < 1 / 3)] for _ in range(1000)]), start=1
    ):
        state, _ = EVIDENCE.extend(state, estimates, *measured(estimates), number, 1.0, MODEL)
    found, lost = state.followed.verdicts[:, step_of(np.array([GAP / 25]))[0]]
    assert found / (found + lost) == pytest.approx(
        2 / 3, abs=4 * math.sqrt(2 / 9 / (2 * REMEMBERED - 1))
    )
    assert found + lost < REMEMBERED + 1e-9


def test_who_is_missing_is_remembered_for_a_while_only():
    """A new target vanishes with every frame, for ever."""
    frames = [
        seen(*((k - j, 30.0 * (k - j), 0 if j < 3 else -1) for j in range(5) if k >= j))
        for k in range(200)
    ]
    sizes = [len(state.followed.label) for state in run(EVIDENCE, frames).states]
    assert max(sizes) == sizes[-1] == 3 + PATIENCE * 25


def test_a_saved_state_goes_on_as_if_nothing_had_happened():
    frames = lives(["back", "never"] * 4 + ["back"] * 8)
    whole = run(EVIDENCE, frames)
    at = 101
    state = unpack(from_bytes(to_bytes(whole.states[at - 1])), LabelledState)
    assert len(state.followed.label)
    for number, estimates in enumerate(frames[at:], start=at + 1):
        state, rows = EVIDENCE.extend(state, estimates, *measured(estimates), number, 1.0, MODEL)
        assert same(rows, whole.emitted[number - 1])


def plain(before: Followed, reported: Reported, now, interval, patience, kept):
    """The definition of `after_frame`: (label, last, age, box, speed) of each that is followed, and
    the verdicts.
    """
    verdicts = before.verdicts.copy()
    ahead = before.xyxy + interval * before.speed
    old = {int(label): i for i, label in enumerate(before.label)}
    new = {int(label): j for j, label in enumerate(reported.label)}
    gone = {label for label, i in old.items() if now - before.last[i] > patience}
    for label, i in old.items():
        found = label in new and reported.last[new[label]] == now
        if before.age[i] > 0 and (found or label in gone):
            steps = slice(0, min(max(round(3 * math.log2(before.age[i] * 240)), 0), STEPS - 1) + 1)
            verdicts[:, steps] *= kept
            verdicts[
                0 if found and iou(ahead[i], reported.xyxy[new[label]]) >= 0.5 else 1, steps
            ] += 1
    rows = [
        (n, before.last[i], before.age[i], ahead[i], before.speed[i])
        for n, i in old.items()
        if n not in gone | new.keys()
    ]
    for label, j in new.items():
        age = now - reported.last[j]
        box = reported.xyxy[j]
        speed = (box - before.xyxy[old[label]]) / interval if label in old else np.zeros(4)
        rows.append(
            (
                label,
                reported.last[j],
                age if reported.confirmed[j] and age <= patience else 0.0,
                box,
                speed,
            )
        )
    return sorted(rows, key=lambda row: row[0]), verdicts


def iou(a, b) -> float:
    wide, high = (max(min(a[k + 2], b[k + 2]) - max(a[k], b[k]), 0.0) for k in (0, 1))
    return wide * high / (sum((c[2] - c[0]) * (c[3] - c[1]) for c in (a, b)) - wide * high)


@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 6))
def test_the_kernel_is_its_definition(seed: int, n: int, m: int):
    rng = np.random.default_rng(seed)
    label = np.sort(rng.permutation(9)[:n])
    tag = rng.permutation(9)[:m]
    last = 10 - rng.integers(1, 12, n) / 10
    since = 10 - rng.integers(0, 12, m) / 10 * (rng.random(m) < 0.6)
    corner = rng.uniform(0, 20, (n + m, 2))
    boxes = np.hstack([corner, corner + rng.uniform(20, 40, (n + m, 2))])
    verdicts = rng.uniform(0, 9, (2, STEPS))
    age = rng.uniform(0, 1, n) * (10 - last) * (rng.random(n) < 0.8)
    speed = rng.uniform(-9, 9, (n, 4))
    before = Followed(label, last, age, boxes[:n], speed, verdicts.copy())
    reported = Reported(tag, np.argsort(tag), boxes[n:], since, rng.random(m) < 0.8)
    after = after_frame(before, reported, 10.0, 0.2, 0.75, 0.9)
    rows, wanted = plain(before, reported, 10.0, 0.2, 0.75, 0.9)
    assert after.label.tolist() == [row[0] for row in rows]
    for column, name in enumerate(("last", "age", "xyxy", "speed"), start=1):
        np.testing.assert_allclose(
            getattr(after, name),
            np.array([r[column] for r in rows]).reshape(getattr(after, name).shape),
        )
    np.testing.assert_allclose(after.verdicts, wanted, rtol=1e-12)
    np.testing.assert_array_equal(before.verdicts, verdicts)
    found, lost = verdicts[:, step_of(age)]
    expected = rng.random(n) < 0.5
    [returns] = from_python(is_returning)
    assert [returns(verdicts, *each, 3.0, 0.5) for each in zip(age, expected, strict=True)] == (
        found + 3 * expected > (found + lost + 3) / 2
    ).tolist()
