"""From simulated and real detections to scored tracks: what the filter is for."""

from __future__ import annotations

import pytest

from phdtrack import Tracker
from phdtrack.formats import read_detections, read_truth
from phdtrack.metrics import Scores, evaluate, pool
from phdtrack.simulate import DetectorModel, make_scene
from phdtrack.types import Tracks

SCENES = (("corridor", DetectorModel(clutter_rate=10)), ("street", DetectorModel(clutter_rate=10)))


def scores(filter_name: str, seeds=(1, 5), frames: int = 150) -> tuple[Scores, Scores]:
    """Corrected and online tracks, pooled over scenes and seeds."""
    corrected = []
    online = []
    for name, detector in SCENES:
        for seed in seeds:
            scene = make_scene(name, seed, detector, frames=frames, lead_in=-5.0)
            tracker = Tracker(
                (scene.info.width, scene.info.height),
                fps=scene.info.fps,
                seed=seed,
                filter=filter_name,
            )
            rows = Tracks.concatenate(
                [tracker.update(scene.detections.at(k)) for k in range(1, frames + 1)]
            )
            corrected.append(evaluate(scene.truth, tracker.tracks(), frames=frames))
            online.append(evaluate(scene.truth, rows.select(rows.confirmed), frames=frames))
    return pool(corrected), pool(online)


@pytest.fixture(scope="module", params=["pmb", "particle-phd"])
def filtered(request):
    return scores(request.param)


@pytest.fixture(scope="module")
def unfiltered():
    return scores("none")


@pytest.mark.parametrize("which", [0, 1], ids=["corrected", "online"])
def test_the_filter_beats_association_alone_in_clutter(filtered, unfiltered, which: int):
    ours = filtered[which]
    theirs = unfiltered[which]
    assert ours.MODA > theirs.MODA + 0.03
    assert ours.MOTA > theirs.MOTA + 0.03
    assert ours.false_positives < theirs.false_positives


def test_the_filter_is_good_and_not_only_better(filtered):
    assert filtered[0].MODA > 0.85
    assert filtered[0].MOTA > 0.85
    assert filtered[0].truth_objects >= 10, "there is something to track"


def test_correction_does_not_harm(filtered):
    assert filtered[0].MOTA >= filtered[1].MOTA - 0.01


@pytest.mark.data
def test_real_detections(data):
    """TUD-Campus: ahead of the association on raw detections in MOTA, and labels alone give sane
    identities.
    """
    folder = data / "mot15" / "TUD-Campus"
    found = read_detections(folder / "det_public" / "det.txt")
    truth = read_truth(folder / "gt" / "gt.txt")

    def scored(**sections):
        tracker = Tracker((640, 480), fps=25, **sections)
        for k in range(1, 72):
            tracker.update(found.at(k))
        return evaluate(truth, tracker.tracks())

    assert scored(filter="mcmc").MOTA > scored(filter="none").MOTA + 0.1
    assert scored(filter="mcmc", associate={"kind": "labelled"}).IDF1 > 0.4
