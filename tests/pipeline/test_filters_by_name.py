"""The MCMC filter on real detections."""

from __future__ import annotations

import pytest

from phdtrack import Tracker, evaluate
from phdtrack.formats import read_detections, read_truth


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
