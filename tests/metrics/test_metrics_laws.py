"""Laws that hold for every sequence: invariances, extremes, empty sides; refusal of bad input."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from metric_cases import close, perfect, random_case, tracks_of, truth_of

from phdtrack.errors import InputError
from phdtrack.metrics import evaluate, pool
from phdtrack.types import Tracks, Truth

NONE = truth_of([], [], [])
SHARES = ["MODA", "N_MODA", "MODP", "MOTA", "MOTA_log", "MOTP", "IDF1", "HOTA"]
NAMES = [
    *SHARES,
    "OSPA",
    "GOSPA",
    "OSPA2",
    "SFDA",
    "ATA",
    "id_switches",
    "misses",
    "false_positives",
    "fragments",
    "frames",
]
seeds = st.integers(0, 2**32 - 1)


def take(truth: Truth, index) -> Truth:
    return truth_of(
        truth.frame[index], truth.identity[index], truth.xyxy[index], truth.distractor[index]
    )


def integral(truth: Truth, tracks: Tracks) -> tuple[Truth, Tracks]:
    """A random case with boxes on a coarse grid, so that assignments often tie."""
    t, o = (4 * np.round(rows.xyxy / 4) for rows in (truth, tracks))
    return truth_of(truth.frame, truth.identity, t, truth.distractor), tracks_of(
        tracks.frame, tracks.identity, o
    )


@given(seeds, st.booleans())
@settings(max_examples=40, deadline=None)
def test_order_of_rows_does_not_matter(seed: int, coarse: bool):
    rng = np.random.default_rng(seed)
    truth, tracks = random_case(rng, objects=6, distractors=True)
    if coarse:
        truth, tracks = integral(truth, tracks)
    shuffled = evaluate(
        take(truth, rng.permutation(len(truth))), tracks.select(rng.permutation(len(tracks)))
    )
    assert shuffled.as_dict() == evaluate(truth, tracks).as_dict()


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_names_of_identities_do_not_matter(seed: int):
    rng = np.random.default_rng(seed)
    truth, tracks = random_case(rng, objects=6)
    names = rng.permutation(5000)
    renamed = tracks_of(tracks.frame, names[tracks.identity], tracks.xyxy)
    people = truth_of(truth.frame, names[truth.identity] - 2500, truth.xyxy)
    ours = evaluate(people, renamed).as_dict()
    theirs = evaluate(truth, tracks).as_dict()
    assert ours == pytest.approx(theirs, abs=1e-12)


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_part_of_a_sequence_is_scored_alone(seed: int):
    truth, tracks = random_case(np.random.default_rng(seed), objects=6, distractors=True)
    last = int(truth.frame.max(initial=4))
    part = evaluate(truth, tracks, first=4, frames=last).as_dict()
    cut = take(truth, truth.frame >= 4), tracks.select(tracks.frame >= 4)
    early = replace(cut[0], frame=cut[0].frame - 3), replace(cut[1], frame=cut[1].frame - 3)
    assert part == evaluate(*early, frames=last - 3).as_dict()


@given(seeds, st.booleans())
@settings(max_examples=25, deadline=None)
def test_perfect_output_has_perfect_scores(seed: int, distractors: bool):
    truth, _ = random_case(np.random.default_rng(seed), objects=5, distractors=distractors)
    assume(not truth.distractor.all())
    # A person under a distractor of exactly her size would be taken out with it: keep them apart.
    truth = truth_of(
        truth.frame, truth.identity, truth.xyxy + 1000 * truth.distractor[:, None], truth.distractor
    )
    scores = evaluate(truth, perfect(truth))
    for name in (*SHARES, "SFDA", "ATA", "ATA_matched", "DetA", "AssA", "IDP", "IDR"):
        close(getattr(scores, name), 1, 1e-12)
    for name in ("OSPA", "GOSPA", "OSPA2", "count_error_mean", "count_error_rms", "delay_mean"):
        close(getattr(scores, name), 0, 1e-12)
    assert (scores.id_switches, scores.misses, scores.false_positives, scores.false_tracks) == (
        0,
        0,
        0,
        0,
    )


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_clutter_lowers_accuracy_only(seed: int):
    rng = np.random.default_rng(seed)
    truth, tracks = random_case(rng, objects=4)
    far = tracks_of([1, 2, 3], [9000, 9000, 9001], [[5000, 5000, 5050, 5050]] * 3)
    before = evaluate(truth, tracks, frames=30)
    after = evaluate(truth, Tracks.concatenate([tracks, far]), frames=30)
    assert (after.false_positives, after.false_tracks) == (
        before.false_positives + 3,
        before.false_tracks + 2,
    )
    close(after.GOSPA, before.GOSPA + 3 * 0.5 / 30)
    assert (after.misses, after.id_switches) == (before.misses, before.id_switches)
    if len(truth):
        close(after.MOTA, before.MOTA - 3 / len(truth))
        assert after.HOTA <= before.HOTA
    close(after.MOTP, before.MOTP, 0)


def test_pooling_is_associative():
    parts = [evaluate(*random_case(np.random.default_rng(i), objects=2 + i)) for i in range(4)]
    assert pool(parts[:1]).as_dict() == parts[0].as_dict()
    nested = pool([pool(parts[:2]), pool(parts[2:])]).as_dict()
    assert nested == pytest.approx(pool(parts).as_dict(), abs=1e-12)


def test_scores_without_output_or_truth():
    truth, tracks = random_case(np.random.default_rng(0))
    scores = evaluate(truth, Tracks.empty())
    assert (scores.MODA, scores.MOTA, scores.IDF1, scores.HOTA) == (0, 0, 0, 0)
    assert np.isnan([scores.MOTP, scores.MODP, scores.delay_mean]).all()
    assert (scores.misses, scores.false_positives, scores.objects_found) == (len(truth), 0, 0)
    close(scores.GOSPA, len(truth) / 2 / scores.frames)
    scores = evaluate(NONE, tracks)
    assert np.isnan([scores.MODA, scores.MOTA]).all()
    assert (scores.IDF1, scores.HOTA, scores.misses, scores.false_positives) == (
        0,
        0,
        0,
        len(tracks),
    )
    assert scores.false_tracks == len(np.unique(tracks.identity))


def test_undefined_scores_are_null_in_json():
    scores = evaluate(NONE, Tracks.empty(), frames=7)
    values = json.loads(json.dumps(scores.as_dict(), allow_nan=False))
    assert list(values)[: len(NAMES)] == NAMES
    assert all(values[name] is None for name in SHARES)
    assert (values["OSPA"], values["GOSPA"], values["misses"], values["frames"]) == (0, 0, 0, 7)
    assert evaluate(NONE, Tracks.empty()).as_dict()["OSPA"] is None


def test_rows_after_the_last_frame_are_ignored():
    truth, tracks = random_case(np.random.default_rng(8), frames=40)
    early = evaluate(take(truth, truth.frame <= 20), tracks.select(tracks.frame <= 20), frames=20)
    assert evaluate(truth, tracks, frames=20).as_dict() == early.as_dict()


BOX = [0, 0, 10, 10]
GOOD = truth_of([1], [1], [BOX]), tracks_of([1], [1], [BOX])


@pytest.mark.parametrize(
    ("truth", "tracks", "message"),
    [
        (GOOD[0], tracks_of([0], [1], [BOX]), "tracks: expected frame numbers from 1, got 0"),
        (GOOD[0], tracks_of([3, 3], [2, 2], [BOX, BOX]), "tracks, frame 3: .*identity 2 twice"),
        (truth_of([3, 3], [2, 2], [BOX, BOX]), GOOD[1], "truth, frame 3: .*identity 2 twice"),
        (
            GOOD[0],
            tracks_of([5], [6], [[0, 0, np.nan, 1]]),
            "tracks, frame 5, identity 6: expected finite boxes",
        ),
        (truth_of([5], [6], [[100, 100, 20, 50]]), GOOD[1], "left, top, width, height"),
        (replace(GOOD[0], identity=np.ones(2, np.int64)), GOOD[1], r"xyxy \(M, 4\)"),
    ],
)
def test_bad_rows_are_refused(truth, tracks, message: str):
    with pytest.raises(InputError, match=message):
        evaluate(truth, tracks)


@pytest.mark.parametrize("option", [{"iou": 0.0}, {"iou": 1.5}, {"iou": math.nan}, {"frames": -1}])
def test_settings_out_of_range_are_refused(option):
    with pytest.raises(InputError, match=next(iter(option))):
        evaluate(*GOOD, **option)


def test_pools_need_parts_of_one_kind():
    with pytest.raises(InputError, match="at least one"):
        pool([])
    with pytest.raises(InputError, match="same settings"):
        pool([evaluate(*GOOD), evaluate(*GOOD, iou=0.7)])


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("frame", [1, 2]),
        ("frame", np.array([1.0, 2.5])),
        ("distractor", np.zeros(3, np.bool_)),
        ("distractor", np.zeros(2, int)),
    ],
)
def test_columns_of_another_type_are_refused(column: str, value: object):
    truth = truth_of([1, 2], [1, 1], [[0, 0, 9, 9]] * 2)
    with pytest.raises(InputError, match="truth: expected arrays of whole numbers"):
        evaluate(replace(truth, **{column: value}), perfect(truth))


@pytest.mark.parametrize(
    ("part", "word"),
    [({"first": 0}, "first"), ({"first": 5}, "first"), ({"frames": 1.5}, "frames")],
)
def test_invalid_frame_numbers_are_refused(part: dict[str, int], word: str):
    truth = truth_of([1, 2], [1, 1], [[0, 0, 9, 9]] * 2)
    with pytest.raises(InputError, match=f"{word}: expected"):
        evaluate(truth, perfect(truth), **part)
