"""Errors of identity: each kind has cases made by hand, they add up to the switches of MOTA, and
names do not matter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from metric_cases import perfect, random_case, tracks_of, truth_of

from phdtrack.metrics import Errors, IdentityError, evaluate, explain
from phdtrack.types import Tracks, Truth

seeds = st.integers(0, 2**32 - 1)


def story(objects: dict[int, str]) -> Errors:
    """The errors of objects, each in a lane of its own, whose tracks are named frame by frame: a
    letter is a track (a: 1), a dot a frame without one, a space a frame without the object.
    """
    truth: list[tuple[int, int, list[int]]] = []
    tracks: list[tuple[int, int, list[int]]] = []
    for identity, names in objects.items():
        box = [100 * identity, 0, 100 * identity + 20, 40]
        for frame, name in enumerate(names, start=1):
            if name != " ":
                truth.append((frame, identity, box))
            if name.isalpha():
                tracks.append((frame, ord(name) - ord("a") + 1, box))
    sides = [[list(column) for column in zip(*rows, strict=True)] for rows in (truth, tracks)]
    return explain(truth_of(*sides[0]), tracks_of(*sides[1]))


def swap(frame: int, objects: tuple[int, int], tracks: tuple[int, int], boxes: int):
    return IdentityError("swap", frame, objects, tracks, boxes)


def transfer(frame: int, objects: tuple[int, int], track: int, boxes: int):
    return IdentityError("transfer", frame, objects, (track,), boxes)


def broken(frame: int, one: int, tracks: tuple[int, int], boxes: int):
    return IdentityError("break", frame, (one,), tracks, boxes)


@pytest.mark.parametrize(
    ("objects", "expected"),
    [
        # In one frame; one after the other; both hidden meanwhile.
        ({1: "aaabb", 2: "bbbaa"}, [swap(4, (2, 1), (2, 1), 4)]),
        ({1: "aaa.bb", 2: "bbb..a"}, [swap(5, (2, 1), (2, 1), 3)]),
        ({1: "aa   bb", 2: "bb   aa"}, [swap(6, (2, 1), (2, 1), 4)]),
        # There and back again.
        (
            {1: "aabba", 2: "bbaab"},
            [swap(3, (2, 1), (2, 1), 4), swap(5, (2, 1), (1, 2), 2)],
        ),
        # To an object that had no track before, and to one whose own has ended.
        ({1: "aaa", 2: "   aa"}, [transfer(4, (1, 2), 1, 2)]),
        ({1: "aaa..", 2: "bb.aa"}, [transfer(4, (1, 2), 1, 2)]),
        # Its first object has a new track, a third one's goes on as before.
        (
            {1: "aaabb", 2: "   aa", 3: "ccccc"},
            [broken(4, 1, (1, 2), 2), transfer(4, (1, 2), 1, 2)],
        ),
        # Away, and back to the same object.
        ({1: "aa.aa", 2: "  a  "}, [transfer(3, (1, 2), 1, 1), transfer(4, (2, 1), 1, 1)]),
        # Three in a ring.
        (
            {1: "aab", 2: "bbc", 3: "cca"},
            [transfer(3, (2, 1), 2, 1), transfer(3, (3, 2), 3, 1), transfer(3, (1, 3), 1, 1)],
        ),
        # A new track, at once and after a while; an old one takes it again.
        ({1: "aabbb"}, [broken(3, 1, (1, 2), 2)]),
        ({1: "aa..bbb"}, [broken(5, 1, (1, 2), 2)]),
        ({1: "aabaa"}, [broken(3, 1, (1, 2), 1), broken(4, 1, (2, 1), 1)]),
        # A gap is no error of identity, nor is a track that begins late.
        ({1: "aa..aa", 2: "..bbbb"}, []),
        ({1: "......"}, []),
    ],
)
def test_each_kind_is_told_apart(objects: dict[int, str], expected: list[IdentityError]):
    if not any(map(str.isalpha, "".join(objects.values()))):
        objects = objects | {9: "z"}
    found = story(objects)
    assert sorted(found.identity) == sorted(expected)
    counts = found.identity_sums()
    for kind in ("swap", "transfer", "break"):
        assert counts[f"{kind}s"] == sum(each.kind == kind for each in expected)


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_they_add_up_to_the_switches(seed: int):
    truth, tracks = random_case(np.random.default_rng(seed), objects=6)
    errors = explain(truth, tracks)
    sums = errors.identity_sums()
    switches = evaluate(truth, tracks).id_switches
    least = 2 * sums["swaps"] + sums["breaks"]
    assert least <= switches <= least + sums["transfers"]
    assert [each.frame for each in errors.identity] == sorted(
        each.frame for each in errors.identity
    )
    assert all(each.boxes > 0 for each in errors.identity)


def relabelled(rows: Truth | Tracks, rng: np.random.Generator) -> dict[int, int]:
    """Other names for the identities."""
    old = np.unique(rows.identity).tolist()
    names = (1 + rng.permutation(5 * len(old))[: len(old)]).tolist()
    return dict(zip(old, names, strict=True))


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_names_do_not_matter(seed: int):
    """Perfect tracks have no errors under any names; those of others are the same."""
    rng = np.random.default_rng(seed)
    truth, tracks = random_case(rng, objects=5)
    for rows in (perfect(truth), tracks):
        name = relabelled(rows, rng)
        identity = np.array([name[one] for one in rows.identity.tolist()], np.int64)
        other = explain(truth, replace(rows, identity=identity)).identity
        usual = explain(truth, rows).identity
        renamed = [each._replace(tracks=tuple(name[t] for t in each.tracks)) for each in usual]
        assert list(other) == renamed
    assert explain(truth, perfect(truth)).identity == ()


def test_the_worst_take_most_boxes_out_of_their_identity():
    errors = story({1: "aaaabaaa", 2: "ccccdddd"})
    assert [each.frame for each in errors.worst_identity(2)] == [5, 5]
    assert errors.worst_identity(1) == [broken(5, 2, (3, 4), 4)]
    assert errors.as_dict(1)["identity"] == {"swaps": 0, "transfers": 0, "breaks": 3}
    (first,) = errors.as_dict(1)["worst_identity"]
    assert first == {"kind": "break", "frame": 5, "objects": (2,), "tracks": (3, 4), "boxes": 4}


def test_errors_have_the_numbers_of_labelled_frames():
    errors = story({1: "aabb.", 2: "bbaa."}).in_frames(np.array([10, 20, 30, 40, 50]))
    assert [each.frame for each in errors.identity] == [30]
    assert errors.last.tolist() == [40, 40]
    assert errors.track_last.tolist() == [40, 40]
