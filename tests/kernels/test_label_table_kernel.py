"""The table of labels against plain definitions."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.label_table import detected_rows


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 5))
def test_detected_rows_are_their_definition(seed: int, n: int, detections: int) -> None:
    """The row of the detection of each state, and whether its label has been confirmed."""
    rng = np.random.default_rng(seed)
    label = np.sort(rng.permutation(30)[: n + 3])
    counts = rng.integers(0, 9, len(label))
    confirmed = rng.random(len(label)) < 0.3
    table = label, np.zeros_like(label), counts, np.zeros(len(label)), confirmed
    tag = rng.permutation(label)[:n]
    detection = rng.integers(-1, detections, n)
    # Detections that were left out have no measurement.
    row = np.sort(rng.permutation(20)[:detections])
    rows, sure = detected_rows(table, tag, detection, row, 5)
    assert rows.tolist() == [int(row[j]) if j >= 0 else -1 for j in detection]
    known = {int(each): k for k, each in enumerate(label)}
    assert sure.tolist() == [
        bool(confirmed[known[int(each)]] or counts[known[int(each)]] >= 5) for each in tag
    ]
