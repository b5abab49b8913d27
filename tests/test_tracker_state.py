"""Checkpoints of the tracker: what is saved, how it goes on from there, and what is refused."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from phdtrack import Tracker, config
from phdtrack.errors import InputError
from phdtrack.filters import NoFilter
from phdtrack.types import SequenceInfo
from tracker_cases import PARTICLES, SIZE, boxes, equal, feed, street, tracker_of


@pytest.fixture(scope="module")
def scene():
    """Frames of detections with clutter."""
    return street()


@pytest.mark.parametrize("section", [
    {},
    {"associate": {"output_delay": 3}},
    {"sensor": {"scaling": "previous"}},
    {"filter": {"kind": "none"}},
    {"filter": {"kind": "mht"}, "associate": {"output_delay": 3}},
    {"learn": {"kind": "online", "memory": 0.05, "verdict_delay": 0.3}},
    {"filter": PARTICLES},
    {"filter": PARTICLES, "associate": {"output_delay": 3}},
    {"filter": PARTICLES, "sensor": {"scaling": "previous"}},
    {"filter": PARTICLES, "learn": {"kind": "online", "memory": 0.05, "verdict_delay": 0.3}},
], ids=[
    "default", "delay", "previous size", "none", "mht", "learning",
    "particles", "particles, delay", "particles, previous size", "particles, learning",
])  # fmt: skip
@pytest.mark.parametrize("carry", [lambda d: d, lambda d: pickle.loads(pickle.dumps(d))], ids=["dict", "pickled"])
def test_a_resumed_run_is_bit_identical(section, carry, scene):
    whole, first, second = (tracker_of(**section) for _ in range(3))
    wanted = feed(whole, scene)
    feed(first, scene[:35])
    saved = first.state_dict()
    feed(first, scene[5:30])
    second.update(boxes(0))
    second.load_state_dict(carry(saved))
    rest = feed(second, scene[35:])
    assert all(equal(x, y) for x, y in zip(rest, wanted[35:], strict=True))
    assert equal(second.tracks(), whole.tracks())
    assert equal(second.flush(), whole.flush())


@pytest.mark.parametrize("kind", ["pmb", "particle-phd"])
def test_a_saved_state_may_be_used_twice_and_written_into(kind: str, scene):
    tracker = tracker_of(filter={"kind": kind})
    feed(tracker, scene[:20])
    saved = tracker.state_dict()
    results = []
    for _ in range(2):
        other = tracker_of(filter={"kind": kind})
        other.load_state_dict(saved)
        results.append(feed(other, scene[20:30]))
    assert all(equal(a, b) for a, b in zip(*results, strict=True))
    overwrite(saved)
    assert all(equal(a, b) for a, b in zip(feed(tracker, scene[20:30]), results[0], strict=True))


def overwrite(value) -> None:
    """Every array within set to 0."""
    if isinstance(value, np.ndarray):
        value[...] = 0
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        overwrite(item)


@pytest.mark.parametrize("kind", ["pmb", "particle-phd"])
def test_a_saved_state_holds_plain_values_only(kind: str, scene):
    tracker = tracker_of(filter={"kind": kind})
    feed(tracker, scene[:10])

    def check(value):
        if isinstance(value, dict):
            for key, item in value.items():
                assert isinstance(key, str)
                check(item)
        elif isinstance(value, list):
            for item in value:
                check(item)
        else:
            assert value is None or type(value) in (bool, int, float, str, np.ndarray, np.float64), type(value)

    check(tracker.state_dict())


def test_the_state_before_the_first_frame_can_be_saved(scene):
    tracker = tracker_of()
    tracker.load_state_dict(tracker_of().state_dict())
    assert all(equal(a, b) for a, b in zip(feed(tracker, scene[:5]), feed(tracker_of(), scene[:5]), strict=True))


def test_the_state_of_an_earlier_version_is_told():
    with pytest.raises(InputError, match=r"^load_state_dict: this state is of format 1, .* reads format 8"):
        tracker_of().load_state_dict(tracker_of().state_dict() | {"format": 1})


def damaged(saved) -> dict[str, object]:
    fields = saved["state"]["fields"]
    return {
        "nothing": None,
        "a list": [],
        "empty": {},
        "another format": saved | {"format": 99},
        "no state": {k: v for k, v in saved.items() if k != "state"},
        "no randomness": saved | {"random": {}},
        "a number": saved | {"state": 3},
        "another record": saved | {"state": {"record": "phdtrack.associate.history:History", "fields": {}}},
        "an unknown record": saved | {"state": {"record": "os.system", "fields": {}}},
        "no fields": saved | {"state": {"record": "phdtrack.pipeline:TrackingState", "fields": []}},
        "a missing field": saved | {"state": {"record": "phdtrack.pipeline:TrackingState", "fields": {"number": 3}}},
        "an unknown record inside": saved | {
            "state": {"record": "phdtrack.pipeline:TrackingState", "fields":
                      fields | {"intensity": {"record": "Mystery", "fields": {}}}}
        },
    }  # fmt: skip


@pytest.mark.parametrize("how", damaged(Tracker(SIZE).state_dict()))
def test_what_is_no_saved_state_is_told_and_changes_nothing(how: str):
    tracker, plain = tracker_of(), tracker_of()
    for k in range(10):
        tracker.update(boxes(k))
        plain.update(boxes(k))
    with pytest.raises(InputError, match="load_state_dict"):
        tracker.load_state_dict(damaged(tracker.state_dict())[how])
    assert equal(tracker.update(boxes(10)), plain.update(boxes(10)))


@pytest.mark.parametrize("filter_", ["pmb", "particle-phd", "gm-phd", "gm-cphd", "mht", "mcmc"])
def test_a_state_of_other_settings_is_told(filter_: str):
    saved, other = (tracker_of(filter={"kind": filter_}, sensor={"scaling": s}) for s in ("previous", "particle"))
    saved.update(boxes(0))
    with pytest.raises(InputError, match=r"expected states of 6 components, got 8"):
        other.load_state_dict(saved.state_dict())


def test_a_state_of_ones_own_that_cannot_be_saved_is_told():
    class Odd:
        """A state that no checkpoint knows."""

        mass = 0.0

    class OddFilter(NoFilter):
        def start(self, model, rng):
            return Odd()

    made = config.build(config.load(), SequenceInfo(*SIZE, 25.0))
    with pytest.raises(InputError, match="Odd"):
        Tracker(stages=replace(made, filter=OddFilter())).state_dict()
