"""HOTA, CLEAR and identity scores against TrackEval, on random and on real sequences."""

import numpy as np
import pytest
from metric_cases import REAL, close, random_case, real_case
from trackeval_oracle import Figures, figures, pooled

from phdtrack.metrics import Scores, evaluate, pool
from phdtrack.metrics.scores import hota_per_alpha
from phdtrack.types import Tracks


def compare(ours: Scores, theirs: Figures) -> None:
    """For an empty side TrackEval returns 0 by convention, and we return NaN or the value of the
    formula.
    """
    clear = theirs.clear
    hota = theirs.hota
    identity = theirs.identity
    assert (ours.id_switches, ours.misses, ours.false_positives) == (
        clear["IDSW"],
        clear["CLR_FN"],
        clear["CLR_FP"],
    )
    assert (ours.fragments, ours.mostly_tracked, ours.mostly_lost) == (
        clear["Frag"],
        clear["MT"],
        clear["ML"],
    )
    assert ours.matches == clear["CLR_TP"]
    assert ours.counts.identity_matches == identity["IDTP"]
    if ours.truth_boxes:
        close(ours.N_MODA, clear["MODA"])
        close(ours.MOTA, clear["MOTA"])
    if ours.matches:
        close(ours.MOTP, clear["MOTP"])
    if ours.truth_boxes + ours.output_boxes:
        close(ours.IDF1, identity["IDF1"])
        close(ours.HOTA, np.mean(hota["HOTA"]))
        close(ours.DetA, np.mean(hota["DetA"]))
        close(ours.AssA, np.mean(hota["AssA"]))
        close(hota_per_alpha(ours.counts)[0], hota["HOTA"])
        if ours.iou == 0.5:
            close([ours.SFDA, ours.ATA_matched], [theirs.vace["SFDA"], theirs.vace["ATA"]])


@pytest.mark.parametrize("distractors", [False, True])
@pytest.mark.parametrize("seed", range(25))
def test_random_sequences_agree_with_trackeval(seed: int, distractors: bool):
    rng = np.random.default_rng(seed)
    objects = int(rng.integers(1, 9))
    truth, tracks = random_case(rng, objects=objects, distractors=distractors)
    for threshold in (0.5, 0.3):
        ours = evaluate(truth, tracks, frames=32, iou=threshold)
        compare(ours, figures(truth, tracks, 32, threshold))


def test_pooled_sequences_agree_with_trackeval():
    cases = [
        random_case(np.random.default_rng(50 + i), objects=3 + i, frames=15 + 5 * i)
        for i in range(4)
    ]
    cases.append((cases[0][0], Tracks.empty()))
    ours = pool([evaluate(truth, tracks, frames=40) for truth, tracks in cases])
    theirs = pooled([figures(truth, tracks, 40) for truth, tracks in cases])
    compare(ours, theirs)
    assert ours.frames == 5 * 40


@pytest.mark.data
@pytest.mark.parametrize(("sequence", "detector"), REAL)
def test_real_sequences(data, sequence: str, detector: str):
    truth, tracks = real_case(data, sequence, detector)
    ours = evaluate(truth, tracks)
    assert ours.id_switches > 0
    assert ours.fragments > 0
    compare(ours, figures(truth, tracks, ours.frames))
