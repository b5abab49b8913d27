"""What happened is told anew when later frames show it: against following every hypothesis back at
every frame.
"""

from __future__ import annotations

import numpy as np
import pytest
from mht_cases import FRAME, RNG, boxes, run, told, walk
from pmb_cases import world

from phdtrack.arrays import iou
from phdtrack.filters import PMB, BestBernoullis
from phdtrack.filters.pmb import Bernoullis


def traced(state: Bernoullis, model, min_weight: float, merge_iou: float) -> list[dict[int, tuple]]:
    """Of each frame before the present one, oldest first: by label, where the target was and which
    detection it had.
    """
    last = len(state.layers) - 1
    starts = [(last, int(place)) for place in state.present.targets["best"] if place >= 0]
    starts += [(last - state.frame + int(frame), int(place)) for frame, place in state.ended]
    frames: list[dict[int, tuple]] = [{} for _ in range(last)]
    for frame, place in starts:
        presence = 0.0
        for number in range(frame, -1, -1):
            layer = state.layers[number]
            target = layer.hypotheses["target"][place]
            presence = max(presence, layer.targets["presence"][target])
            if number < last and presence >= min_weight:
                label = int(layer.targets["label"][target])
                assert label not in frames[number]
                frames[number][label] = (
                    layer.mean[place],
                    int(layer.hypotheses["detection"][place]),
                )
            place = int(layer.hypotheses["parent"][place])
            if place < 0:
                break
    out = []
    for frame in frames:
        kept: dict[int, tuple] = {}
        for label in sorted(frame):
            box = model.sensor.boxes(frame[label][0][:, None])
            if all(
                iou(box, model.sensor.boxes(mean[:, None]))[0, 0] <= merge_iou
                for mean, _ in kept.values()
            ):
                kept[label] = frame[label]
        out.append(kept)
    return out


def scene(
    rng: np.random.Generator, frames: int, detection: float, close: float
) -> list[np.ndarray]:
    """People who come, walk among each other, are often missed, and go; false alarms; now and then
    nobody looked.
    """
    start = rng.uniform([200, 150], [200 + close, 150 + close], (7, 2))
    velocity = rng.normal(0, 3, (7, 2))
    begin = rng.integers(0, 20, 7)
    end = rng.integers(30, frames, 7)
    scans = []
    for k in range(frames):
        there = (rng.random(7) < detection) & (begin <= k) & (k < end)
        here = start + k * velocity + 3 * rng.standard_normal((7, 2))
        scans.append(boxes(*here[there], *rng.uniform([0, 0], FRAME, (rng.poisson(3), 2))))
    return scans


@pytest.mark.parametrize("depth", [1, 4, 10])
@pytest.mark.parametrize("seed", range(6))
def test_replaying_what_is_told_gives_what_tracing_back_gives(seed: int, depth: int):
    rng = np.random.default_rng(seed)
    detection = (0.6, 0.75, 0.9)[seed % 3]
    model = world(detection=detection, clutter=1e-8, birth=1e-8, survival=0.95)
    filter_ = PMB(history=depth, existence_threshold=1e-2)
    extractor = BestBernoullis(merge_iou=(1.0, 0.5)[seed % 2])
    state = filter_.start(model, RNG)
    shown = []
    revised = 0
    silent = 0
    for k, z in enumerate(scene(rng, 60, detection, (60, 300)[seed % 2])):
        state = (
            filter_.predict(state, model, 1.0, RNG)
            if k % 17 == 16
            else filter_.step(state, z, model, 1.0, RNG)[0]
        )
        found = extractor.extract(state, z, model)
        assert len(found.past) == min(k + 1, depth)
        for back, past in enumerate(reversed(found.past)):
            if past is None:
                silent += 1
            elif len(shown) > back:
                revised += back > 0
                shown[-1 - back] = past
        for past, wanted in zip(
            reversed(shown), reversed(traced(state, model, 0.5, extractor.merge_iou)), strict=False
        ):
            assert past.tag.tolist() == list(wanted), k
            assert past.detection.tolist() == [d for _, d in wanted.values()], k
            np.testing.assert_array_equal(
                past.state.T, np.array([x for x, _ in wanted.values()]).reshape(-1, 6)
            )
        shown.append(found)
    assert silent > 0
    assert depth == 1 or revised > 0


def test_an_ended_target_is_still_told_of_where_it_was():
    """Soon after the last detection nobody is there; the frames before show him until they are no
    longer told of.
    """
    model = world(detection=0.9, survival=0.8)
    path = walk((200, 200), (2, 2), 12)
    scans = [boxes(here) for here in path] + [boxes()] * 20
    filter_ = PMB(mean_visible_time=0.0)
    for n in range(18, 33):
        state, _ = run(filter_, scans[:n], model)
        seen = [
            frame
            for frame in traced(state, model, 0.5, 1.0)
            if any(d >= 0 for _, d in frame.values())
        ]
        assert len(seen) == max(0, 10 - (n - 13))
        assert len(told(state, model)) == 0
    assert len(state) == state.ended.size == 0, "and then forgotten"
