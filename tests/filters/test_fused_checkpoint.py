"""Blocks of particles in checkpoints, in a tracker, and beside frames that nobody looked at."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from fused_cases import NOTHING, identical, level

from phdtrack import Tracker
from phdtrack.tracker import pack, unpack
from phdtrack.types import Detections, ParticleBlocks

SETTINGS = {"filter": {"kind": "particle-phd", "particles_per_target": 200}, "birth": {"particles": 200}}


def frames(seed: int, count: int) -> list:
    """Two walkers, clutter, empty frames, and frames that nobody looked at."""
    rng, out = np.random.default_rng(seed), []
    for k in range(count):
        boxes = np.array([[100.0 + 3 * k, 100, 140 + 3 * k, 200], [500.0 - 3 * k, 250, 540 - 3 * k, 350]])
        boxes = boxes + rng.normal(0, 1, (2, 4))
        corner = rng.uniform(0, 400, 2)
        clutter = np.concatenate([corner, corner + rng.uniform(20, 60, 2)])[None]
        kinds = {7: Detections.empty(observed=False), 5: np.zeros((0, 4)), 3: np.vstack([boxes, clutter])}
        out.append(kinds.get(k % 8, boxes))
    return out


def test_packing_keeps_every_bit():
    state = level(np.random.default_rng(1), 3, 200)
    again = unpack(pickle.loads(pickle.dumps(pack(state))))
    identical(again, state)
    assert again.state.dtype == np.float32
    assert again.start.dtype == np.int64
    assert again.state.flags.c_contiguous
    assert isinstance(again, ParticleBlocks)
    identical(unpack(pack(NOTHING)), NOTHING)


@pytest.mark.parametrize("after", [4, 6, 8, 17])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_resumed_tracker_goes_on_bit_for_bit(after: int, threads: int):
    """Saved after a frame with clutter, an empty one, one that nobody looked at, and later."""
    scans = frames(2, 30)
    settings = SETTINGS | {"filter": SETTINGS["filter"] | {"threads": threads}}
    whole, first, second = Tracker((640, 480), **SETTINGS), Tracker((640, 480), **settings), Tracker((640, 480), **settings)
    for k, found in enumerate(scans):
        whole.update(found)
        if k < after:
            first.update(found)
        if k == after - 1:
            second.load_state_dict(pickle.loads(pickle.dumps(first.state_dict())))
        if k >= after:
            second.update(found)
            a, b = whole.state.intensity, second.state.intensity
            assert type(a) is type(b)
            np.testing.assert_array_equal(a.state, b.state)
            assert whole.step.info.mass == second.step.info.mass
    assert isinstance(whole.state.intensity, ParticleBlocks)
    np.testing.assert_array_equal(whole.tracks().xyxy, second.tracks().xyxy)
    assert len(whole.tracks()) > 40
