"""The GM-PHD and the MCMC filter by name in a loop of one's own: presets, identities, real detections."""

from __future__ import annotations

import numpy as np
import pytest

from phdtrack import Tracker, evaluate
from phdtrack.filters.intensities import JointSamples
from phdtrack.formats import read_detections, read_truth
from phdtrack.types import GaussianMixture
from tracker_cases import two_people

GAUSSIANS, CHAIN = {"kind": "gm-phd"}, {"kind": "mcmc", "samples": 400}


@pytest.mark.parametrize("preset", ["default", "m07", "m09", "fv"])
@pytest.mark.parametrize(
    ("filter_", "associate"), [(GAUSSIANS, {}), (CHAIN, {"kind": "graph"}), (CHAIN, {"kind": "labelled"})],
    ids=["gm-phd", "mcmc, graph", "mcmc, labelled"],
)  # fmt: skip
def test_two_people_are_two_tracks(preset: str, filter_, associate):
    tracker = Tracker((640, 480), filter=filter_, preset=preset, associate=associate)
    for boxes in two_people(50):
        tracker.update(boxes)
    assert isinstance(tracker.state.intensity, JointSamples if filter_ is CHAIN else GaussianMixture)
    longest = np.unique(tracker.tracks().identity, return_counts=True)[1]
    assert np.count_nonzero(longest >= 40) == 2
    info = tracker.step.info
    assert info.mass == pytest.approx(2, abs=0.6)
    if filter_ is CHAIN:
        assert info.cardinality.argmax() == 2
        assert info.chain.effective > 20
        assert dict(zip(info.chain.moves, info.chain.proposed, strict=True))["update"] > 300


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
