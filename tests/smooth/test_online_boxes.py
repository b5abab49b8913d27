"""Boxes of online rows: the learned share against its definition, and the truth nearer than filter
and detector have it.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phdtrack.kernels.box import LARGE, MEMORY, TINY_VARIANCE, agreement
from phdtrack.smooth.online import MOST, PRIOR, DetectionShare, ShareState
from phdtrack.types import Detections, Tracks
from tracker_cases import feed, street, tracker_of


def sides(xyxy: np.ndarray) -> np.ndarray:
    """(n, 2, 2) twice the centres, and the sizes, of boxes."""
    return np.stack([xyxy[:, 2:] + xyxy[:, :2], xyxy[:, 2:] - xyxy[:, :2]], axis=1)


def plain(then, between, now, ratio, kept, sums):
    """`agreement` as it is defined."""
    sums = sums * [kept, kept, kept, 1]
    for i, name in enumerate(then[0]):
        if name not in between[0] or name not in now[0]:
            continue
        j = between[0].tolist().index(name)
        k = now[0].tolist().index(name)
        z, m, a, b = (
            sides(x)[0] for x in (then[1][[i]], then[2][[i]], between[1][[j]], now[1][[k]])
        )
        steps = (m - z) / z[1]
        told = (a - (b - a) * ratio - z) / z[1]
        for part, axis in np.ndindex(2, 2):
            step = steps[part, axis]
            sums[part, 2] += 1
            sums[part, 3] += (abs(step) - sums[part, 3]) / min(sums[part, 2], MEMORY)
            weight = 1 / (1 + (step / (LARGE * sums[part, 3] + TINY_VARIANCE)) ** 2)
            sums[part, :2] += weight * step * np.array([told[part, axis], step])
    return sums


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(0, 6), min_size=3, max_size=3),
    st.floats(0.2, 4.0),
)
@settings(max_examples=60, deadline=None)
def test_sums_equal_their_definition(seed: int, counts: list[int], ratio: float):
    rng = np.random.default_rng(seed)

    def some(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        corner = rng.uniform(0, 400, (n, 2))
        xyxy = np.hstack([corner, corner + rng.uniform(1, 90, (n, 2))])
        return rng.permutation(8)[:n], xyxy, xyxy + rng.normal(0, 3, (n, 4))

    then, between, now = (some(n) for n in counts)
    before = np.abs(rng.normal(0, 1, (2, 4)))
    got = agreement(then, between[:2], now[:2], ratio, 0.9, before)
    np.testing.assert_allclose(
        got, plain(then, between, now, ratio, 0.9, before), rtol=1e-9, atol=1e-12
    )


def shown(detector: float, filtered: float, frames: int = 300, targets: int = 5, seconds=0.04):
    """The mean square error of what is shown in the second half, and the shares at the end.

    Targets walk with accelerations; seen boxes and filtered ones have independent errors of these
    deviations, pixels.
    """
    rng = np.random.default_rng(5)
    online = DetectionShare()
    state = online.start()
    errors = []
    time = 0.0
    place = rng.uniform(100, 500, (targets, 2))
    speed = rng.normal(0, 2, (targets, 2))
    for number in range(1, frames + 1):
        step = seconds * (1 + rng.integers(0, 2))
        time += step
        place = place + speed * step / 0.04
        speed = speed + rng.normal(0, 0.05, speed.shape)
        true = np.hstack([place, place + np.array([40.0, 90.0])])
        seen = true + rng.normal(0, detector, true.shape)
        m = true + rng.normal(0, filtered, true.shape)
        order = rng.permutation(targets)
        detections = Detections.of(seen[order])
        rows = Tracks.of(
            np.full(targets, number),
            np.arange(1, targets + 1),
            m,
            np.ones(targets),
            np.argsort(order),
        )
        state, rows = online.advance(state, rows, detections, number, time, number)
        errors.append(np.square(rows.xyxy - true).mean())
    return np.mean(errors[frames // 2 :]), state.share


@pytest.mark.parametrize(("detector", "filtered"), [(0.5, 3.0), (3.0, 0.5), (2.0, 2.0)])
def test_learned_share_is_as_accurate_as_the_best_share(detector: float, filtered: float):
    """Independent errors of variances r and s are best weighed with a = r/(r + s); then the error
    is rs/(r + s).
    """
    error, share = shown(detector, filtered)
    r = detector**2
    s = filtered**2
    # Regressions on 3000 sides, of references with a variance of up to 13 r: the standard error of
    # a is below 0.07.
    np.testing.assert_allclose(share, r / (r + s), atol=0.2)
    # An error of a adds its square times r + s.
    assert error < r * s / (r + s) + (r + s) * 0.1**2


def test_share_starts_in_the_middle_and_stays_bounded():
    np.testing.assert_allclose(ShareState().share, PRIOR)
    assert ShareState(sums=np.array([[9.0, 1, 90, 1], [-9, 1, 90, 1]])).share == (MOST, 0)


def test_rows_without_detection_are_unchanged(rng):
    online = DetectionShare()
    box = np.array([[10.0, 20, 30, 60], [50, 50, 80, 120]])
    rows = Tracks.of(np.array([1, 1]), np.array([1, 2]), box, np.ones(2), np.array([-1, 0]))
    _, out = online.advance(online.start(), rows, Detections.of(box[1:] + 2), 1, 0.0, 1)
    np.testing.assert_array_equal(out.xyxy, [box[0], box[1] + 1])


def test_delayed_rows_use_detections_of_their_own_frames():
    scene = street()
    late = tracker_of(preset="default", associate={"output_delay": 3})
    rows = Tracks.concatenate([*feed(late, scene), late.flush()])
    plainly = tracker_of(
        preset="default", associate={"output_delay": 3}, smooth={"detection_share": False}
    )
    without = Tracks.concatenate([*feed(plainly, scene), plainly.flush()])
    np.testing.assert_array_equal(rows.frame, without.frame)
    seen = np.array([xyxy[k] if k >= 0 else np.full(4, np.nan) for xyxy, k in _named(rows, scene)])
    held = rows.detection >= 0
    # Between the filter's box and the detection's, or beyond the filter's by half at most.
    a, m, z = (sides(x[held]) for x in (rows.xyxy, without.xyxy, seen))
    assert (np.abs(a - z) <= MOST * np.abs(m - z) + 1e-9).all()
    assert np.abs(a - m).max() > 0.1
    np.testing.assert_array_equal(rows.xyxy[~held], without.xyxy[~held])


def test_frames_without_tracks_are_not_kept_for_ever():
    online = DetectionShare()
    state = online.start()
    found = Detections.of(np.array([[10.0, 20, 30, 60]]))
    for number in range(1, 101):
        oldest = max(1, number - 4)
        state, _ = online.advance(state, Tracks.empty(), found, number, number / 25, oldest)
    assert [frame[0] for frame in state.waiting] == [96, 97, 98, 99, 100]


def test_empty_frames_are_not_kept():
    tracker = tracker_of(preset="default", associate={"output_delay": 3})
    for _ in range(20):
        tracker.update(np.zeros((0, 4)))
    assert tracker.state.online_boxes.waiting == ()


def _named(rows: Tracks, scene):
    return [
        (scene[number - 1].xyxy, k)
        for number, k in zip(rows.frame.tolist(), rows.detection.tolist(), strict=True)
    ]


def test_filter_boxes_are_shown_if_asked():
    assert tracker_of().stages.online is not None
    assert tracker_of(preset="mot15").stages.online is None
    # A detection of several targets says of none where it is.
    assert (
        tracker_of(preset="default", merged_measurements={"kind": "explained"}).stages.online
        is None
    )
