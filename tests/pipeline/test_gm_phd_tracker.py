"""The GM-PHD filter by name: in a loop of one's own, across a checkpoint, and from the command line."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from phdtrack import Tracker
from phdtrack.types import Detections, GaussianMixture
from tracker_cases import two_people


@pytest.mark.parametrize("preset", ["default", "m07", "m09", "fv"])
def test_two_people_are_two_tracks(preset: str):
    tracker = Tracker((640, 480), filter="gm-phd", preset=preset)
    for boxes in two_people(50):
        tracker.update(boxes)
    assert isinstance(tracker.state.intensity, GaussianMixture)
    tracks = tracker.tracks()
    longest = np.unique(tracks.identity, return_counts=True)[1]
    assert np.count_nonzero(longest >= 40) == 2
    assert tracker.step is not None
    assert tracker.step.info.mass == pytest.approx(2, abs=0.6)


def test_a_checkpoint_goes_on_as_if_nothing_had_been():
    whole, first = (Tracker((640, 480), filter={"kind": "gm-phd", "max_components": 50}) for _ in range(2))
    boxes = two_people(30)
    for found in boxes[:15]:
        whole.update(found)
        first.update(found)
    resumed = Tracker((640, 480), filter={"kind": "gm-phd", "max_components": 50})
    resumed.load_state_dict(pickle.loads(pickle.dumps(first.state_dict())))
    for found in boxes[15:]:
        np.testing.assert_array_equal(whole.update(found).xyxy, resumed.update(found).xyxy)
    np.testing.assert_array_equal(whole.state.intensity.covariance, resumed.state.intensity.covariance)
    np.testing.assert_array_equal(whole.state.intensity.tag, resumed.state.intensity.tag)
    assert whole.state.intensity.fresh == resumed.state.intensity.fresh > 2


def test_a_frame_that_nobody_looked_at_is_predicted():
    tracker = Tracker((640, 480), filter="gm-phd")
    for found in two_people(10):
        tracker.update(found)
    before = tracker.state.intensity
    tracker.update(Detections.empty(observed=False))
    after = tracker.state.intensity
    assert len(after) == len(before)
    np.testing.assert_allclose(after.weight, 0.997 * before.weight)
