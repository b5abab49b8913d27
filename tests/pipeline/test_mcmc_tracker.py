"""The MCMC filter by name: in a loop of one's own, across a checkpoint, with identities of its own, on real detections."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from phdtrack import Tracker, evaluate
from phdtrack.filters.intensities import JointSamples
from phdtrack.formats import read_detections, read_truth
from phdtrack.types import Detections
from tracker_cases import two_people


@pytest.mark.parametrize("preset", ["default", "m07", "m09", "fv"])
@pytest.mark.parametrize("kind", ["graph", "labelled"])
def test_two_people_are_two_tracks(preset: str, kind: str):
    tracker = Tracker(
        (640, 480), filter={"kind": "mcmc", "samples": 400}, preset=preset, associate={"kind": kind}
    )  # fmt: skip
    for boxes in two_people(50):
        tracker.update(boxes)
    assert isinstance(tracker.state.intensity, JointSamples)
    tracks = tracker.tracks()
    longest = np.unique(tracks.identity, return_counts=True)[1]
    assert np.count_nonzero(longest >= 40) == 2
    assert tracker.step is not None
    info = tracker.step.info
    assert info.mass == pytest.approx(2, abs=0.6)
    assert info.cardinality.argmax() == 2
    assert info.chain is not None
    assert info.chain.effective > 20
    assert dict(zip(info.chain.moves, info.chain.proposed, strict=True))["update"] > 300


def test_a_checkpoint_goes_on_as_if_nothing_had_been():
    setting = {"kind": "mcmc", "samples": 100, "min_weight": 0.01}
    whole, first = (Tracker((640, 480), filter=setting) for _ in range(2))
    boxes = two_people(24)
    for found in boxes[:12]:
        whole.update(found)
        first.update(found)
    resumed = Tracker((640, 480), filter=setting)
    resumed.load_state_dict(pickle.loads(pickle.dumps(first.state_dict())))
    for found in boxes[12:]:
        np.testing.assert_array_equal(whole.update(found).xyxy, resumed.update(found).xyxy)
    np.testing.assert_array_equal(whole.state.intensity.state, resumed.state.intensity.state)
    np.testing.assert_array_equal(whole.state.intensity.label, resumed.state.intensity.label)


def test_a_frame_that_nobody_looked_at_is_predicted():
    tracker = Tracker((640, 480), filter={"kind": "mcmc", "samples": 200})
    for found in two_people(10):
        tracker.update(found)
    before = tracker.state.intensity
    tracker.update(Detections.empty(observed=False))
    after = tracker.state.intensity
    np.testing.assert_array_equal(after.label, before.label)
    np.testing.assert_allclose(after.chance, 0.997 * before.chance)
    np.testing.assert_array_equal(after.origin, before.state)


@pytest.mark.data
def test_real_detections(data):
    """TUD-Campus: ahead of the association on raw detections in MOTA, and labels alone give sane identities."""
    folder = data / "mot15" / "TUD-Campus"
    found, truth = read_detections(folder / "det_public" / "det.txt"), read_truth(folder / "gt" / "gt.txt")

    def scored(**sections):
        tracker = Tracker((640, 480), fps=25, **sections)
        for k in range(1, 72):
            tracker.update(found.at(k))
        return evaluate(truth, tracker.tracks())

    assert scored(filter="mcmc").MOTA > scored(filter="none").MOTA + 0.1
    assert scored(filter="mcmc", associate={"kind": "labelled"}).IDF1 > 0.4
