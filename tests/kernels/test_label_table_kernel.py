"""The table of labels against plain definitions."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.associate.labels import NO_TRACKS
from phdtrack.kernels.label_table import LABEL, counted_frame, detected_rows, due_rows
from phdtrack.models import BoxMotion, BoxSensor, MeasurementBirth, UniformClutter
from phdtrack.models.predicted_boxes import SHOWN, on_target
from phdtrack.protocols import Model
from phdtrack.types import F8, I8

WORLD = Model(BoxMotion(), BoxSensor(), MeasurementBirth(), UniformClutter())
# The rates and times of a frame at 25 Hz.
SECOND = (25.0, 0.0, 0.04, 0.8, 0.995)


def table_of(rng: np.random.Generator, label: I8):
    """A table of these labels, with counts and confirmed ones at random."""
    table = np.zeros(len(label), LABEL)
    table["label"] = label
    table["states"] = rng.integers(0, 9, len(label))
    table["confirmed"] = rng.random(len(label)) < 0.3
    table["last"] = -np.inf
    return table


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 5))
def test_detected_rows_are_their_definition(seed: int, n: int, detections: int) -> None:
    """The row of the detection of each state, and whether its label has been confirmed."""
    rng = np.random.default_rng(seed)
    table = table_of(rng, np.sort(rng.permutation(30)[: n + 3]))
    tag = rng.permutation(table["label"])[:n]
    detection = rng.integers(-1, detections, n)
    # Detections that were left out have no measurement.
    row = np.sort(rng.permutation(20)[:detections])
    rows, sure = detected_rows(table, tag, detection, row, 5)
    assert rows.tolist() == [int(row[j]) if j >= 0 else -1 for j in detection]
    known = {int(each): k for k, each in enumerate(table["label"])}
    assert sure.tolist() == [
        bool(table["confirmed"][known[int(each)]] or table["states"][known[int(each)]] >= 5)
        for each in tag
    ]


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 4))
def test_states_are_counted_by_label(seed: int, settled: int, later: int) -> None:
    """A table counts the states with a detection, those of settled moments and those of all, and
    has a record for each label of the moments.
    """
    rng = np.random.default_rng(seed)
    before = table_of(rng, np.sort(rng.permutation(12)[:4]))
    tags = [np.sort(rng.permutation(12)[: rng.integers(0, 6)]) for _ in range(settled + later)]
    found = [rng.integers(-1, 3, len(tag)) for tag in tags]
    times = [float(m + 1) for m in range(len(tags))]
    flat = (
        np.concatenate([np.zeros(0, np.int64), *tags]),
        np.concatenate([np.zeros(0, np.int64), *found]),
        np.array([*times, *map(len, tags)], np.float64),
    )
    tables = counted_frame(
        before, flat, settled, tuple(NO_TRACKS), np.zeros((0, 4)), 5, SECOND, False
    )[:2]
    for table, moments in zip(tables, (settled, settled + later), strict=True):
        states = dict(zip(before["label"].tolist(), before["states"].tolist(), strict=True))
        last = dict.fromkeys(states, -math.inf)
        for tag in flat[0].tolist():
            states.setdefault(tag, 0)
            last.setdefault(tag, -math.inf)
        for m in range(moments):
            for tag, detection in zip(tags[m].tolist(), found[m].tolist(), strict=True):
                if detection >= 0:
                    states[tag] += 1
                    last[tag] = times[m]
        assert table["label"].tolist() == sorted(states)
        assert table["states"].tolist() == [states[label] for label in sorted(states)]
        assert table["last"].tolist() == [last[label] for label in sorted(states)]


def shown(state: F8, covariance: F8, weight: F8, chance: F8, since: float):
    """`due_rows` of confirmed labels 0 … n − 1, none detected, all of which may coast."""
    n = len(weight)
    table = np.zeros(n, LABEL)
    table["label"] = np.arange(n)
    table["states"] = 9
    states = (np.arange(n), np.full(n, -1), np.zeros((n, 4)), weight)
    return due_rows(
        (table, table),
        states,
        (state, covariance, chance),
        np.zeros(0, np.int64),
        np.zeros((2, 64)),
        (0.0, 0.0, 1.0, 25.0),
        (3.0, 0.5, SHOWN),
        (5, 1, 0),
        (True, False, True),
        (since, np.arange(1)),
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_undetected_boxes_are_shown_where_they_lie_on_targets(seed: int) -> None:
    """Without probabilities they are those of `on_target`, digit by digit."""
    rng = np.random.default_rng(seed)
    n = 8
    state = rng.uniform(5, 90, (6, n))
    covariance = np.zeros((n, 6, 6))
    covariance[:, range(6), range(6)] = rng.uniform(0.1, 300, (n, 6))
    chance = on_target(WORLD, state, covariance)
    # On the border the last digit decides; one is shown in any case.
    weight = SHOWN / chance
    weight[::2] = np.nextafter(weight[::2], 2 * weight[::2])
    weight[0] *= 2
    computed = shown(state, covariance, weight, np.zeros(0), -np.inf)
    given_ = shown(state, covariance, weight, chance, -np.inf)
    assert computed[2][1].tolist() == given_[2][1].tolist()
    assert 0 < computed[1] <= n


def test_labels_that_nobody_needs_are_forgotten() -> None:
    """Those that were not detected since a time and are in no open frame have no record after."""
    state = np.full((6, 3), 50.0)
    after, _, _ = shown(state, np.zeros((3, 6, 6)), np.ones(3), np.ones(3), 1.0)
    # All were last detected at time 0; label 0 is open.
    assert after["label"].tolist() == [0]
