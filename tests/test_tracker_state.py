"""Saved states of the tracker: what they hold, how it continues from them, and what is refused."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from phdtrack import Tracker, config
from phdtrack.errors import InputError
from phdtrack.filters import NoFilter
from phdtrack.state import FORMAT, blocks, from_bytes, settings_digest, to_bytes, unpack
from phdtrack.types import F8, Detections, Particles, SequenceInfo
from tracker_cases import PARTICLES, SIZE, boxes, equal, feed, street, tracker_of


@pytest.fixture(scope="module")
def scene():
    """Frames of detections with clutter."""
    return street()


DELAY = {"associate": {"output_delay": 3}}


@pytest.mark.parametrize("section", [
    {}, DELAY, {"merged_measurements": {"kind": "explained"}},
    {"preset": "default"},
    *({"filter": {"kind": kind}} for kind in ("none", "gm-phd", "gm-cphd", "particle-cphd")),
    {"filter": {"kind": "mht"}, **DELAY},
    {"filter": {"kind": "mcmc", "samples": 50, "min_weight": 0.01}},
    *({"filter": PARTICLES, **more} for more in ({}, DELAY)),
], ids=str)  # fmt: skip
def test_a_resumed_run_is_bit_identical(section, scene):
    whole, first, second = (tracker_of(**section) for _ in range(3))
    wanted = feed(whole, scene)
    feed(first, scene[:35])
    saved = pickle.dumps(first.state_dict())
    feed(first, scene[5:30])
    second.update(boxes(0))
    second.load_state_dict(pickle.loads(saved))
    rest = feed(second, scene[35:])
    assert all(equal(x, y) for x, y in zip(rest, wanted[35:], strict=True))
    assert equal(second.tracks(), whole.tracks())
    assert equal(second.flush(), whole.flush())


def test_a_state_of_several_classes_is_restored():
    first, second = (tracker_of(classes={"together": [[1, 2]]}) for _ in range(2))
    for k in range(20):
        first.update(Detections.of(boxes(k), class_id=[1, 3]))
    second.load_state_dict(first.state_dict())
    for k in range(20, 25):
        found = Detections.of(boxes(k), class_id=[2, 3])
        assert equal(first.update(found), second.update(found))
    assert equal(first.tracks(), second.tracks())


@pytest.mark.parametrize("kind", ["pmb", "particle-phd"])
def test_a_state_can_be_loaded_twice(kind: str, scene):
    tracker = tracker_of(filter={"kind": kind})
    feed(tracker, scene[:20])
    saved = tracker.state_dict()
    results = []
    for _ in range(2):
        other = tracker_of(filter={"kind": kind})
        other.load_state_dict(saved)
        results.append(feed(other, scene[20:30]))
    assert all(equal(a, b) for a, b in zip(*results, strict=True))


def test_a_state_holds_plain_values_only(scene):
    tracker = tracker_of()
    feed(tracker, scene[:10])
    saved = tracker.state_dict()
    assert {key: type(value) for key, value in saved.items()} == {
        "format": int, "frame_size": str, "dim": int, "settings": str, "state": bytes,
    }  # fmt: skip


def cut(saved: dict) -> dict:
    return saved | {"state": saved["state"][:-1]}


def flipped(saved: dict) -> dict:
    content = bytearray(saved["state"])
    content[len(content) // 2] ^= 4
    return saved | {"state": bytes(content)}


@pytest.mark.parametrize(("change", "message"), [
    (cut, "cut off or changed"),
    (flipped, "cut off or changed"),
    (lambda saved: saved | {"state": b"PK" + saved["state"]}, "begins with other bytes"),
    (lambda saved: saved | {"format": 1}, f"format 1, and this version .* reads format {FORMAT}"),
    (lambda saved: saved | {"frame_size": "1920x1080"}, "frames of 640x480, got one of 1920x1080"),
    (lambda saved: saved | {"state": "text"}, "expected a state of a tracker"),
    (lambda saved: {}, "expected a state of a tracker"),
    (lambda saved: None, "expected a state of a tracker"),
    (lambda saved: [], "expected a state of a tracker"),
    (lambda saved: saved | {"more": 1}, "expected a state of a tracker"),
])  # fmt: skip
def test_a_damaged_state_is_refused_and_changes_nothing(change, message: str):
    tracker = tracker_of()
    plain = tracker_of()
    for k in range(10):
        tracker.update(boxes(k))
        plain.update(boxes(k))
    with pytest.raises(InputError, match=f"^load_state_dict: .*{message}"):
        tracker.load_state_dict(change(tracker.state_dict()))
    assert equal(tracker.update(boxes(10)), plain.update(boxes(10)))


@pytest.mark.parametrize("filter_", ["pmb", "particle-phd", "gm-phd", "gm-cphd", "mht", "mcmc"])
def test_a_state_of_other_components_is_refused(filter_: str):
    saved, other = (
        tracker_of(filter={"kind": filter_}, motion={"kind": kind}) for kind in ("point", "box")
    )
    saved.update(boxes(0))
    with pytest.raises(InputError, match="expected states of 6 components, got 4"):
        other.load_state_dict(saved.state_dict())


@pytest.mark.parametrize("other", [
    {"filter": {"kind": "gm-phd"}}, DELAY, {"sensor": {"detection_probability": 0.71}},
], ids=str)  # fmt: skip
def test_a_state_of_other_settings_is_refused(other, scene):
    saved = tracker_of()
    feed(saved, scene[:8])
    with pytest.raises(InputError, match="a tracker with the same settings"):
        tracker_of(**other).load_state_dict(saved.state_dict())


def test_a_state_of_other_numbers_is_accepted_on_demand(scene):
    saved = tracker_of()
    feed(saved, scene[:8])
    other = tracker_of(sensor={"detection_probability": 0.71})
    other.load_state_dict(saved.state_dict(), same_settings=False)
    assert other.state.number == 8
    with pytest.raises(InputError, match="expected GaussianMixture, got Bernoullis"):
        tracker_of(filter={"kind": "gm-phd"}).load_state_dict(
            saved.state_dict(), same_settings=False
        )


def test_a_state_of_an_unknown_type_is_refused():
    class Odd:
        """A state that is no dataclass."""

        mass = 0.0

    class OddFilter(NoFilter):
        def start(self, model, rng):
            return Odd()

    made = config.build(config.load(), SequenceInfo(*SIZE, 25.0))
    with pytest.raises(InputError, match="Odd"):
        Tracker(stages=replace(made, filter=OddFilter())).state_dict()


# Bytes


def test_bytes_give_back_what_was_saved():
    value = {"x": (1, 2.5, [None, True, "é"]), 3: np.arange(6).reshape(2, 3), "raw": b"\0\xff"}
    back = from_bytes(to_bytes(value))
    assert back["x"] == value["x"]
    assert back["raw"] == value["raw"]
    assert np.array_equal(back[3], value[3])
    with pytest.raises(InputError, match="a value of type object cannot be saved"):
        to_bytes([object()])
    with pytest.raises(InputError, match="a value of type ndarray cannot be saved"):
        to_bytes(np.array([object()]))


def test_blocks_end_at_the_first_damaged_one(tmp_path):
    parts = [to_bytes({"number": k}) for k in range(4)]
    path = tmp_path / "log"
    path.write_bytes(b"".join(parts[:3]) + parts[3][:-1])
    with path.open("rb") as file:
        found = list(blocks(file))
    assert [value["number"] for _, value in found] == [0, 1, 2]
    assert [end for end, _ in found] == [len(parts[0]) * k for k in (1, 2, 3)]


@pytest.mark.parametrize("hint", [int, str, dict[int, float], F8, tuple[float, int], Particles])
def test_a_value_of_another_type_is_refused(hint):
    with pytest.raises(InputError, match=r"^state: expected .*, got float"):
        unpack(0.5, hint)


def test_a_whole_number_becomes_a_float():
    """Kernels would be compiled anew for whole numbers."""
    found = unpack(from_bytes(to_bytes((0, 1))), tuple[float, ...])
    assert found == (0.0, 1.0)
    assert all(type(one) is float for one in found)


def test_the_digest_depends_on_types_and_values():
    values = [1, 1.0, True, "1", (1,), [1], {"a": 1}, np.arange(3), np.arange(3.0), None]
    digests = [settings_digest(value) for value in values]
    assert len(set(digests)) == len(values)
    assert settings_digest({"a": 1, "b": 2}) == settings_digest({"b": 2, "a": 1})
    assert settings_digest(np.float64(0.5)) == settings_digest(0.5)


# What is remembered


# A frame a second.
SLOW = {"fps": 1.0, "filter": {"kind": "none"}, "time": {"longest_interval": 0.0}}


def seldom(k: int) -> np.ndarray:
    """Somebody comes every 20 seconds."""
    return boxes(k % 20) if k % 20 < 16 else np.zeros((0, 4))


def test_memory_is_bounded_by_the_history():
    bounded = tracker_of(**SLOW, associate={"history": 60})
    whole = tracker_of(**SLOW, associate={"history": 0})
    sizes = []
    for k in range(400):
        bounded.update(seldom(k))
        if k < 100:
            whole.update(seldom(k))
        if k in (199, 299, 399):
            sizes.append(len(to_bytes(bounded.state_dict())))
    assert max(sizes) < 1.5 * min(sizes), "except for the 32 frames that are forgotten at once"
    assert 280 < bounded.tracks().frame.min() <= 341
    assert whole.tracks().frame.min() < 10


def test_what_is_forgotten_by_default_is_reported_once(caplog):
    tracker = tracker_of(**SLOW)
    assert tracker.stages.associator.history == 600
    for k in range(700):
        tracker.update(seldom(k))
    assert tracker.tracks().frame.min() > 1
    said = [record.getMessage() for record in caplog.records if "forgotten" in record.getMessage()]
    assert len(said) == 1
    assert "associate={'history': 0}" in said[0]


def test_memory_of_classes_is_bounded_too():
    tracker = tracker_of(fps=5.0, associate={"history": 4.0})
    sizes = []
    for k in range(300):
        tracker.update(Detections.of(boxes(k % 40), class_id=[1, 2]))
        if k in (139, 299):
            sizes.append(len(tracker.state_dict()["state"]))
    assert sizes[1] < 1.2 * sizes[0]


def test_identities_can_be_left_out():
    tracker = tracker_of()
    tracker.skip_identities(40)
    for k in range(10):
        rows = tracker.update(boxes(k))
    assert set(rows.identity) == {41, 42}
    assert tracker.highest == 42
